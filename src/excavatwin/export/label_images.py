"""``labels/<photo>.png``: the refined label image of each photo, a palette PNG whose values are class ids."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import PurePath

import numpy as np
from jaxtyping import UInt8
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from excavatwin.scene.taxonomy import NOT_OBSERVED, PALETTE, TaskClass, class_name


def encode_label_image(label: UInt8[np.ndarray, "H W"]) -> bytes:
    """PNG bytes: 255 = not observed; the palette is that of every other file; class names are in its text chunk."""
    image = Image.fromarray(np.ascontiguousarray(label, np.uint8), mode="P")
    palette = np.zeros((256, 3), np.uint8)
    for k, rgb in PALETTE.items():
        palette[int(k)] = rgb
    image.putpalette(palette.tobytes())
    text = PngInfo()
    text.add_text("Classes", ", ".join(f"{int(k)} {class_name(k)}" for k in (*TaskClass, NOT_OBSERVED)))
    stream = io.BytesIO()
    image.save(stream, "PNG", pnginfo=text, optimize=False)
    return stream.getvalue()


def label_file_names(names: Sequence[str]) -> dict[str, str]:
    """Photo name -> file name below ``labels/``: its stem, or its full name where two photos share a stem."""
    flat = {name: name.replace("\\", "/").strip("/").replace("/", "_") for name in names}
    stems = [PurePath(f).stem.casefold() for f in flat.values()]
    files: dict[str, str] = {}
    for name, file in flat.items():
        unique = stems.count(PurePath(file).stem.casefold()) == 1
        files[name] = f"{PurePath(file).stem if unique else file}.png"
    return files
