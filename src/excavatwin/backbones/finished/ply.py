"""Vertices of PLY files (Turk, 1994): ascii and binary, x, y and z only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
#: A header longer than this is none [bytes].
_HEADER = 1 << 20


@dataclass(frozen=True)
class PlyVertices:
    """Where the vertices lie in a file."""

    path: Path
    order: str
    """Byte order, empty for ascii."""
    count: int
    properties: tuple[tuple[str, str], ...]
    """(name, numpy type) of every property of a vertex."""
    start: int
    """Offset of the first vertex [bytes]; in ascii files of the first line after the header."""
    lines_before: int
    """Lines between the header and the first vertex of an ascii file."""

    def chunks(self, size: int) -> Iterator[Float64[np.ndarray, "n 3"]]:
        """Positions, ``size`` at a time.

        Raises:
            InputError: the file ends before its last vertex.
        """
        yield from self._binary(size) if self.order else self._ascii(size)

    def _binary(self, size: int) -> Iterator[Float64[np.ndarray, "n 3"]]:
        dtype = np.dtype([(name, self.order + kind) for name, kind in self.properties])
        if self.path.stat().st_size < self.start + self.count * dtype.itemsize:
            raise InputError(f"{self.path} ends before its {self.count} vertices; copy it again.")
        if not self.count:
            return
        rows = np.memmap(self.path, dtype, "r", self.start, (self.count,))
        for first in range(0, self.count, size):
            part = rows[first : first + size]
            yield np.stack([part[axis].astype(np.float64) for axis in "xyz"], axis=1)

    def _ascii(self, size: int) -> Iterator[Float64[np.ndarray, "n 3"]]:
        columns = [[name for name, _ in self.properties].index(axis) for axis in "xyz"]
        with self.path.open("rb") as file:
            file.seek(self.start)
            for _ in islice(file, self.lines_before):
                pass
            left = self.count
            while left:
                lines = list(islice(file, min(size, left)))
                try:
                    rows = np.loadtxt(lines, usecols=columns, ndmin=2)
                except ValueError as error:
                    raise InputError(f"{self.path} holds a vertex that is no row of numbers ({error}).") from error
                if len(rows) < min(size, left):
                    raise InputError(f"{self.path} ends before its {self.count} vertices; copy it again.")
                yield rows
                left -= len(rows)


def ply_vertices(path: Path) -> PlyVertices:
    """Read the header.

    Raises:
        InputError: it is no PLY file, has no vertices with x, y and z, or lists where vertices should begin.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER)
    end = head.find(b"end_header")
    if not head.startswith(b"ply") or end < 0:
        raise InputError(f"{path} is not a PLY file; its header should begin with 'ply' and close with 'end_header'.")
    start = head.find(b"\n", end) + 1
    order = None
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for line in head[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            order = _ORDERS.get(words[1])
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"] and elements:
            elements[-1][2].append((words[-1], _TYPES.get(words[1], "list")))
    if order is None:
        raise InputError(f"{path} has no format line that PLY knows; expected ascii or binary_little_endian.")
    skipped = lines = 0
    for name, count, properties in elements:
        listed = any(kind == "list" for _, kind in properties)
        if name == "vertex":
            if listed or not {"x", "y", "z"} <= {one for one, _ in properties}:
                raise InputError(f"{path} has vertices without plain x, y and z; export the cloud with coordinates.")
            return PlyVertices(path, order, count, tuple(properties), start + skipped, lines)
        if listed and order:
            raise InputError(f"{path} lists {name} before its vertices; export the vertices first.")
        skipped += 0 if listed else count * sum(np.dtype(kind).itemsize for _, kind in properties) * bool(order)
        lines += count
    raise InputError(f"{path} has no vertices; give a point cloud.")
