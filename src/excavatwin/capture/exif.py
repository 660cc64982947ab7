"""What a photo's own metadata says: size as displayed, focal length, position, attitude, time (EXIF 2.3, DJI XMP)."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from excavatwin.capture.cameras import Lens, focal_pixels
from excavatwin.scene.photo import Gimbal, GpsFix, Photo

if TYPE_CHECKING:
    from PIL import Image

# Tag numbers of EXIF 2.3 (JEITA CP-3451C).
ORIENTATION, MAKE, MODEL, DATE_TIME, XML_PACKET = 0x0112, 0x010F, 0x0110, 0x0132, 0x02BC
EXIF_IFD, GPS_IFD = 0x8769, 0x8825
DATE_TIME_ORIGINAL, SUBSEC_ORIGINAL, FOCAL_LENGTH, FOCAL_35MM = 0x9003, 0x9291, 0x920A, 0xA405
PIXEL_X, PIXEL_Y, PLANE_X, PLANE_UNIT, DIGITAL_ZOOM = 0xA002, 0xA003, 0xA20E, 0xA210, 0xA404
LAT_REF, LAT, LON_REF, LON, ALT_REF, ALT, STATUS, H_ERROR = 1, 2, 3, 4, 5, 6, 9, 31
#: Millimetres per FocalPlaneResolutionUnit: inch, centimetre, and the unofficial millimetre and micrometre.
UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}


def describe_photo(image: Image.Image, path: Path) -> Photo:
    """The photo of an opened, not necessarily decoded file. Damaged or missing metadata reads as "not told"."""
    main, detail, gps = _directories(image)
    swap = transposed(main.get(ORIENTATION))
    width, height = image.size[::-1] if swap else image.size
    lens = _lens(main, detail)
    focal, source = focal_pixels(lens, max(image.size), min(image.size))
    xmp = _xmp(image, main)
    name = lens.model if lens.model.startswith(lens.make) else f"{lens.make} {lens.model}"
    optics = "".join(
        f" {value:g}{unit}" for value, unit in ((lens.focal_mm, "mm"), (lens.focal_35mm, "mm-eq")) if value
    )
    zoom = f" zoom {lens.zoom:g}" if lens.zoom != 1 else ""
    return Photo(
        name=path.name,
        path=path,
        width=width,
        height=height,
        camera=f"{name.strip() or 'unknown camera'} {width}x{height}{optics}{zoom}",
        focal=focal,
        focal_source=source,
        gps=_gps_fix(gps, xmp),
        gimbal=_gimbal(xmp),
        time=_time(main, detail),
    )


def transposed(orientation: Any) -> bool:
    """Whether an EXIF orientation swaps rows and columns (values 5 to 8)."""
    return orientation in (5, 6, 7, 8)


def _directories(image: Image.Image) -> tuple[dict[int, Any], dict[int, Any], dict[int, Any]]:
    try:
        exif = image.getexif()
        return dict(exif), dict(exif.get_ifd(EXIF_IFD)), dict(exif.get_ifd(GPS_IFD))
    except Exception:  # Pillow raises half a dozen types on broken EXIF; the picture itself may be fine
        return {}, {}, {}


def _lens(main: dict[int, Any], detail: dict[int, Any]) -> Lens:
    resolution = _positive(detail.get(PLANE_X))
    pixels = [side for tag in (PIXEL_X, PIXEL_Y) if (side := _positive(detail.get(tag)))]
    zoom = _positive(detail.get(DIGITAL_ZOOM)) or 1.0
    return Lens(
        make=_text(main.get(MAKE)),
        model=_text(main.get(MODEL)),
        focal_mm=_positive(detail.get(FOCAL_LENGTH)),
        focal_35mm=_positive(detail.get(FOCAL_35MM)),
        pitch_mm=UNIT_MM.get(int(_positive(detail.get(PLANE_UNIT)) or 2), 25.4) / resolution if resolution else None,
        recorded=(max(pixels), min(pixels)) if len(pixels) == 2 else None,
        zoom=max(zoom, 1.0),
    )


def _gps_fix(gps: dict[int, Any], xmp: str) -> GpsFix | None:
    latitude, longitude = _degrees(gps.get(LAT)), _degrees(gps.get(LON))
    if latitude is None or longitude is None or latitude > 90 or longitude > 180:
        return None
    if _text(gps.get(STATUS)).upper() == "V" or (latitude == 0 and longitude == 0):  # void, or never filled
        return None
    altitude = _number(gps.get(ALT))
    if altitude is not None and gps.get(ALT_REF) in (1, b"\x01", "1"):
        altitude = -altitude
    rtk = [_xmp_number(xmp, f"RtkStd{axis}") for axis in ("Lat", "Lon", "Hgt")]
    horizontal = max(rtk[0], rtk[1]) if rtk[0] and rtk[1] else _positive(gps.get(H_ERROR))
    return GpsFix(
        latitude=-latitude if _text(gps.get(LAT_REF)).upper().startswith("S") else latitude,
        longitude=-longitude if _text(gps.get(LON_REF)).upper().startswith("W") else longitude,
        altitude=altitude,
        sigma_horizontal=horizontal,
        sigma_vertical=rtk[2] or None,
    )


def _gimbal(xmp: str) -> Gimbal | None:
    yaw, pitch, roll = (_xmp_number(xmp, f"Gimbal{axis}Degree") for axis in ("Yaw", "Pitch", "Roll"))
    if yaw is None or pitch is None or roll is None:
        return None
    return Gimbal(yaw, pitch, roll)


def _time(main: dict[int, Any], detail: dict[int, Any]) -> float | None:
    stamp = _text(detail.get(DATE_TIME_ORIGINAL)) or _text(main.get(DATE_TIME))
    try:
        seconds = datetime.strptime(stamp, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
    fraction = _text(detail.get(SUBSEC_ORIGINAL))
    return seconds + (float(f"0.{fraction}") if fraction.isdigit() else 0.0)


def _xmp(image: Image.Image, main: dict[int, Any]) -> str:
    """The XMP packet as text; it sits in APP1 (JPEG), tag 700 (TIFF) or an iTXt chunk (PNG)."""
    for packet in (image.info.get("xmp"), main.get(XML_PACKET), image.info.get("XML:com.adobe.xmp")):
        if isinstance(packet, bytes):
            return packet.decode("utf-8", "replace")
        if isinstance(packet, str):
            return packet
    return ""


def _xmp_number(xmp: str, name: str) -> float | None:
    """A number of DJI's namespace, written as an attribute or as an element."""
    found = re.search(rf":{name}\s*(?:=\s*[\"']|>)\s*([-+0-9.eE]+)", xmp)
    return _number(found.group(1)) if found else None


def _degrees(triple: Any) -> float | None:
    """Unsigned degrees of an EXIF triple (degrees, minutes, seconds)."""
    try:
        parts = [_number(part) for part in triple]
    except TypeError:
        return None
    if not parts or any(part is None or part < 0 for part in parts):
        return None
    return sum(part / 60**power for power, part in enumerate(parts) if part is not None)


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _text(value: Any) -> str:
    """An EXIF string without the NUL padding that DJI and others leave."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return value.split("\0")[0].strip() if isinstance(value, str) else ""
