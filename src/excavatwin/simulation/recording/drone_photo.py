"""A photo as a drone writes it: JPEG with EXIF and XMP, whose position is a little wrong."""

from __future__ import annotations

from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image, TiffImagePlugin

from excavatwin.scene.observations import Georeference
from excavatwin.simulation.camera import Camera

PLACE = Georeference(32632, (691000.0, 5334000.0, 520.0), 0.0)
"""Where the made-up sites lie; altitudes are above the ellipsoid."""
SENSOR = 6.4
"""Width of the sensor [mm]."""
SIGMA = (0.02, 0.03)
"""Standard deviation of the written positions, horizontal and vertical, as of RTK [m]."""


def write_photo(
    file: Path | BinaryIO,
    image: UInt8[np.ndarray, "H W 3"],
    camera: Camera,
    error: Float64[np.ndarray, "3"],
    time: datetime,
    sigma: tuple[float, float] = SIGMA,
    model: str = "sample camera",
) -> None:
    """Write a JPEG with the EXIF and XMP that a drone writes.

    Args:
        error: of the written position, east, north, up [m].
        sigma: accuracy that the photo claims for its position, horizontal and vertical [m].
        model: of the camera.
    """
    import pyproj

    easting, northing, altitude = np.array(PLACE.origin) + camera.T_M_cam[:3, 3] + error
    utm = pyproj.Proj(PLACE.epsg)
    longitude, latitude = utm(easting, northing, inverse=True)
    convergence = utm.get_factors(longitude, latitude).meridian_convergence
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0132] = "ExcavaTwin", model, f"{time:%Y:%m:%d %H:%M:%S}"
    detail = exif.get_ifd(0x8769)
    detail[0x9003] = f"{time:%Y:%m:%d %H:%M:%S}"
    detail[0x920A] = rational(camera.focal / camera.width * SENSOR, 10000)
    detail[0xA405] = equivalent_focal(camera)
    detail[0xA002], detail[0xA003] = camera.width, camera.height
    gps = exif.get_ifd(0x8825)
    gps[0] = b"\x02\x03\x00\x00"
    gps[1], gps[2] = "N" if latitude >= 0 else "S", sexagesimal(abs(latitude))
    gps[3], gps[4] = "E" if longitude >= 0 else "W", sexagesimal(abs(longitude))
    gps[5], gps[6] = b"\x00", rational(altitude, 1000)
    gps[18] = "WGS-84"
    xmp = drone_xmp(camera, convergence, sigma)
    Image.fromarray(image).save(
        file, format="JPEG", quality=90, subsampling=2, optimize=True, exif=exif.tobytes(), xmp=xmp
    )


def equivalent_focal(camera: Camera) -> int:
    """Focal length on a frame of 36 mm x 24 mm with the same diagonal angle, as EXIF's whole number [mm]."""
    return round(camera.focal * np.hypot(36, 24) / np.hypot(camera.width, camera.height))


def rational(value: float, denominator: int) -> TiffImagePlugin.IFDRational:
    """A number as EXIF writes it."""
    return TiffImagePlugin.IFDRational(Fraction(round(value * denominator), denominator))


def sexagesimal(degrees: float) -> tuple[TiffImagePlugin.IFDRational, ...]:
    """Degrees, minutes and seconds; the seconds to 0.03 mm on the ground."""
    minutes = degrees % 1 * 60
    return rational(int(degrees), 1), rational(int(minutes), 1), rational(minutes % 1 * 60, 1_000_000)


def drone_xmp(camera: Camera, convergence: float, sigma: tuple[float, float]) -> bytes:
    """Attitude and position accuracy in the tags that DJI's drones use; yaw is clockwise from true north."""
    forward, right, down = camera.T_M_cam[:3, 2], camera.T_M_cam[:3, 0], camera.T_M_cam[:3, 1]
    # Looking straight down, the top of the picture tells the heading.
    ahead = forward if np.hypot(*forward[:2]) > 1e-6 else -down
    yaw = np.rad2deg(np.arctan2(ahead[0], ahead[1])) + convergence
    pitch = np.rad2deg(np.arcsin(np.clip(forward[2], -1, 1)))
    roll = np.rad2deg(np.arctan2(-right[2], -down[2]))
    tags = {
        "GimbalYawDegree": f"{(yaw + 180) % 360 - 180:+.2f}",
        "GimbalPitchDegree": f"{pitch:+.2f}",
        "GimbalRollDegree": f"{roll:+.2f}",
        "RtkStdLat": f"{sigma[0]:.5f}",
        "RtkStdLon": f"{sigma[0]:.5f}",
        "RtkStdHgt": f"{sigma[1]:.5f}",
    }
    attributes = " ".join(f'drone-dji:{name}="{value}"' for name, value in tags.items())
    return (
        '<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
        f'{attributes}/></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()
