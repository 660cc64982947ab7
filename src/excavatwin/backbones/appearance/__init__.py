"""Segmenter "appearance": training-free evidence for the task classes from colour and texture, without weights."""

from excavatwin.backbones.appearance.segmenter import Appearance

__all__ = ["Appearance"]
