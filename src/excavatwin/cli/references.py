"""``--reference``: a known distance between two pixels of one photo."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from excavatwin.errors import InputError

if TYPE_CHECKING:
    from excavatwin.geometry.scale import Reference

_NUMBER = r"\s*([0-9]*\.?[0-9]+)\s*"
_PATTERN = re.compile(rf"(?P<photo>.+):{_NUMBER},{_NUMBER}:{_NUMBER},{_NUMBER}={_NUMBER}(?:m\s*)?")


def parse_reference(text: str) -> Reference:
    """``"PHOTO:x1,y1:x2,y2=METRES"`` -> a reference length; pixels count from the photo's top left corner.

    Raises:
        InputError: the text does not have this form, or its two pixels or its length make no distance.
    """
    from excavatwin.geometry.scale import Reference

    match = _PATTERN.fullmatch(text.strip())
    if match is None:
        raise InputError(
            f"--reference {text!r} is not understood; "
            'write "PHOTO:x1,y1:x2,y2=METRES", such as "IMG_9400.JPG:1200,840:1510,861=4.2".'
        )
    x1, y1, x2, y2, metres = (float(number) for number in match.groups()[1:])
    if metres <= 0 or (x1, y1) == (x2, y2):
        raise InputError(f"--reference {text!r} is no distance; give two different pixels and a length above zero.")
    return Reference(view=match["photo"].strip(), a=(x1, y1), b=(x2, y2), metres=metres)


def format_reference(reference: Any) -> str:
    """The text that ``parse_reference`` takes back."""
    (x1, y1), (x2, y2) = reference.a, reference.b
    return f"{reference.view}:{x1!r},{y1!r}:{x2!r},{y2!r}={reference.metres!r}"


def is_reference(kind: Any) -> bool:
    """Whether a type is that of a reference length, without importing it."""
    return getattr(kind, "__qualname__", "") == "Reference"
