"""Capture: photos and videos as they lie on the user's disk, and what their files say about the camera."""

from excavatwin.capture.photos import Capture, find_photos, open_capture, read_photo
from excavatwin.capture.video import VideoSampling

__all__ = ["Capture", "VideoSampling", "find_photos", "open_capture", "read_photo"]
