"""Protocol buffers' wire format, as much as reading Objectron needs: fields by number, without generated classes.

A message is a row of (key, value), key = number * 8 + kind, with kinds 0 varint, 1 eight bytes, 2 counted bytes and
5 four bytes (protobuf.dev, "Encoding"). Numbers of a repeated field come one by one or packed into one value.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64

from excavatwin.errors import InputError

VARINT, EIGHT, COUNTED, FOUR = 0, 1, 2, 5


class Message:
    """Fields of one message, by number; nested messages stay bytes until they are asked for."""

    def __init__(self, content: bytes | memoryview) -> None:
        """Split into fields.

        Raises:
            InputError: the bytes end inside a field, or hold a kind that is not one of the four.
        """
        self._fields: dict[int, list[tuple[int, int | memoryview]]] = {}
        for number, kind, value in _fields(memoryview(content)):
            self._fields.setdefault(number, []).append((kind, value))

    def messages(self, number: int) -> list[Message]:
        """Nested messages of a field."""
        return [Message(value) for kind, value in self._fields.get(number, ()) if isinstance(value, memoryview)]

    def message(self, number: int) -> Message:
        """The last nested message of a field, or an empty one."""
        return (self.messages(number) or [Message(b"")])[-1]

    def floats(self, number: int) -> Float64[np.ndarray, "n"]:
        """All values of a field of ``float``, packed or one by one."""
        values = (value for _, value in self._fields.get(number, ()) if not isinstance(value, int))
        joined = b"".join(bytes(value) for value in values)
        if len(joined) % 4:
            raise InputError(f"field {number} holds {len(joined)} bytes, not floats; the file is damaged.")
        return np.frombuffer(joined, "<f4").astype(np.float64)

    def number(self, number: int, default: float = 0.0) -> float:
        """The last value of a field of ``float`` or ``double``."""
        for kind, value in reversed(self._fields.get(number, [])):
            if isinstance(value, memoryview) and kind in (FOUR, EIGHT):
                return float(struct.unpack("<f" if kind == FOUR else "<d", value)[0])
        return default

    def integer(self, number: int, default: int = 0) -> int:
        """The last value of a field of ``int32`` or an enumeration; negative ones are written in 64 bits."""
        for _, value in reversed(self._fields.get(number, [])):
            if isinstance(value, int):
                return value - (1 << 64) if value >> 63 else value
        return default

    def text(self, number: int) -> str:
        """The last value of a field of ``string``."""
        for kind, value in reversed(self._fields.get(number, [])):
            if kind == COUNTED and isinstance(value, memoryview):
                return bytes(value).decode("utf-8", "replace")
        return ""


def split_stream(content: bytes) -> list[bytes]:
    """Messages that follow each other, each behind its length as a little-endian uint32.

    Raises:
        InputError: the last one is cut off.
    """
    found: list[bytes] = []
    at = 0
    while at < len(content):
        end = at + 4 + int.from_bytes(content[at : at + 4], "little")
        if at + 4 > len(content) or end > len(content):
            raise InputError(f"message {len(found)} ends at byte {end} of {len(content)}; the file is cut off.")
        found.append(content[at + 4 : end])
        at = end
    return found


def _fields(content: memoryview) -> Iterator[tuple[int, int, int | memoryview]]:
    at = 0
    while at < len(content):
        key, at = _varint(content, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = _varint(content, at)
            yield number, kind, value
            continue
        if kind == COUNTED:
            length, at = _varint(content, at)
        elif kind in (EIGHT, FOUR):
            length = 8 if kind == EIGHT else 4
        else:
            raise InputError(f"byte {at} begins a field of kind {kind}; this is no protocol buffer.")
        if at + length > len(content):
            raise InputError(f"a field of {length} bytes begins at byte {at} of {len(content)}; the file is cut off.")
        yield number, kind, content[at : at + length]
        at += length


def _varint(content: memoryview, at: int) -> tuple[int, int]:
    """A number of 7 bits a byte, least significant first, and where it ends."""
    value = shift = 0
    while at < len(content) and shift < 70:
        byte = content[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise InputError(f"a number at byte {at} of {len(content)} does not end; this is no protocol buffer.")
