"""Views of long sequences on disk: three files for all of them, however many there are."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from excavatwin.errors import OutputError
from excavatwin.scene.observations import View

_LAYERS = (("points", np.float32), ("confidence", np.float32), ("image", np.uint8))


class Shelf:
    """Takes views one at a time and gives them back together, as parts of memory-mapped files.

    One file for each layer, not for each view: every mapped file keeps a descriptor open, and systems allow a program
    a thousand or so.
    """

    def __init__(self, folder: Path | None) -> None:
        """Into an existing folder; None keeps everything in memory."""
        self._folder = folder
        self._views: list[View] = []

    def add(self, view: View) -> None:
        """Put a view away.

        Raises:
            OutputError: the disk is full.
        """
        if self._folder is None:
            self._views.append(view)
            return
        places: dict[str, Any] = {}
        for name, dtype in _LAYERS:
            layer = getattr(view, name)
            if layer is not None:
                self._append(name, np.ascontiguousarray(layer, dtype))
                places[name] = np.broadcast_to(dtype(0), layer.shape)  # one number in memory
        self._views.append(replace(view, **places))

    def views(self) -> tuple[View, ...]:
        """All views, writable."""
        if self._folder is None or not self._views:
            return tuple(self._views)
        layers = {}
        for name, dtype in _LAYERS:
            path = self._folder / f"{name}.bin"
            if path.is_file():
                layers[name] = np.memmap(path, dtype, "r+")
        found, at = [], dict.fromkeys(layers, 0)
        for view in self._views:
            parts: dict[str, Any] = {}
            for name, layer in layers.items():
                place = getattr(view, name)
                if place is not None:
                    parts[name] = layer[at[name] : at[name] + place.size].reshape(place.shape)
                    at[name] += place.size
            found.append(replace(view, **parts))
        return tuple(found)

    def _append(self, name: str, array: np.ndarray) -> None:
        assert self._folder is not None
        try:
            with (self._folder / f"{name}.bin").open("ab") as file:
                file.write(array.tobytes())
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise
            raise OutputError(f"{self._folder} is full ({error.strerror}); free some space on its disk.") from error
