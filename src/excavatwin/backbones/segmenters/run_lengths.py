"""Run-length encoded masks of COCO: counts of zeros and ones in turn, down the columns, plain or packed as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from excavatwin.errors import InputError


def decoded(counts: Sequence[int] | str | bytes, height: int, width: int) -> Bool[np.ndarray, "h w"]:
    """The mask.

    Raises:
        InputError: the counts do not add up to the size.
    """
    runs = np.asarray(unpacked(counts) if isinstance(counts, (str, bytes)) else counts, np.int64)
    if runs.sum() != height * width or (runs < 0).any():
        raise InputError(
            f"a run-length mask covers {runs.sum()} pixels, but its size says {height} x {width}; export it again."
        )
    values = np.arange(len(runs)) % 2 == 1
    return np.repeat(values, runs).reshape(width, height).T


def unpacked(text: str | bytes) -> list[int]:
    """Counts from COCO's text: 5 bits a character from "0" on, the sixth says that more follow.

    The fifth bit of a number's last character is its sign; from the fourth count on, numbers are differences to the
    count two before.

    Raises:
        InputError: the text ends within a count.
    """
    counts: list[int] = []
    value = shift = 0
    for char in text.encode() if isinstance(text, str) else text:
        bits = char - 48
        value |= (bits & 0x1F) << shift
        shift += 5
        if bits & 0x20:
            continue
        if bits & 0x10:
            value -= 1 << shift
        counts.append(value + (counts[-2] if len(counts) > 2 else 0))
        value = shift = 0
    if shift:
        raise InputError("a run-length mask ends within a number; its file is damaged, export it again.")
    return counts
