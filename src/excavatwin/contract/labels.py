"""Label images: whole numbers that name classes, and what they become when they are treated as pictures."""

from __future__ import annotations

from collections.abc import Set

import numpy as np
from jaxtyping import Integer, Shaped

from excavatwin.contract.findings import Finding, refusal

NOT_SEGMENTED = 255
#: Distance of the pixels that a value lies between -> share of jumps beyond which values are interpolated, not ids.
_BETWEEN = {1: 0.2, 2: 0.3, 4: 0.3}
_FEWEST = 60


def label_mistakes(labels: Shaped[np.ndarray, "H W *c"], ids: Set[int], where: str = "labels") -> tuple[Finding, ...]:
    """What is wrong with one label image.

    Args:
        labels: as read from its file.
        ids: what it may hold, besides 255 = not segmented.
        where: what to call it.
    """
    if labels.ndim == 3:
        return (_coloured(labels, where),)
    if labels.ndim != 2:
        return (refusal(f"{where} has shape {labels.shape}", remedy="give one id per pixel, (H, W)"),)
    if labels.dtype.kind == "f":
        if not np.isfinite(labels).all() or np.abs(labels - np.round(labels)).max() > 1e-6:
            return (_interpolated(f"{where} holds values that are no whole numbers"),)
        labels = labels.astype(np.int64)
    strange = sorted(int(v) for v in np.unique(labels) if int(v) not in ids and int(v) != NOT_SEGMENTED)
    share = between(labels)
    if share is not None:
        return (_interpolated(f"at {share:.0%} of the class borders of {where} stand ids of other classes between"),)
    if strange:
        return (_out_of_range(labels, ids, strange, where),)
    return ()


def between(labels: Integer[np.ndarray, "H W"]) -> float | None:
    """Share of borders with ids in between, if it is that of interpolated labels; else None.

    Two classes meet at a border and no third lies between them by number, except by chance (a few per cent).
    """
    whole = np.where(labels == NOT_SEGMENTED, 0, labels).astype(np.int32)
    for reach, limit in _BETWEEN.items():
        jumps = found = 0
        for rows in (whole, whole.T):
            a, b, c = rows[:, : -2 * reach], rows[:, reach:-reach], rows[:, 2 * reach :]
            low, high = np.minimum(a, c), np.maximum(a, c)
            jump = high - low >= 2
            jumps += int(jump.sum())
            found += int((jump & (b > low) & (b < high)).sum())
        if jumps >= _FEWEST and found > limit * jumps:
            return found / jumps
    return None


def _coloured(labels: Shaped[np.ndarray, "H W c"], where: str) -> Finding:
    few = len(np.unique(labels.reshape(-1, labels.shape[-1])[::7], axis=0))
    same = bool((labels[..., :1] == labels[..., :3]).all())
    if same:
        return refusal(
            f"{where} has {labels.shape[-1]} equal channels",
            "the ids were saved as a grey RGB image",
            "keep one channel",
        )
    return refusal(
        f"{where} has shape {labels.shape} and {few} different colours",
        "the labels are RGB-coded: colours of a palette instead of ids",
        "look up the id of each colour, or save a palette PNG and read its indices",
        colours=float(few),
    )


def _interpolated(what: str) -> Finding:
    return refusal(
        what,
        "the labels were resized with interpolation: values between two ids are other classes",
        "resize label images by nearest neighbour (Pillow NEAREST, cv2.INTER_NEAREST)",
    )


def _out_of_range(labels: Integer[np.ndarray, "H W"], ids: Set[int], strange: list[int], where: str) -> Finding:
    listed = ", ".join(map(str, strange[:5])) + (", ..." if len(strange) > 5 else "")
    share = float(np.isin(labels, strange).mean())
    what = f"{where} holds {listed} at {share:.1%} of its pixels, which are no ids (there are {min(ids)}..{max(ids)})"
    if strange == [max(ids) + 1] and not (labels == min(ids)).any():
        return refusal(what, "the labels are counted from 1 where ids count from 0", "subtract 1", share=share)
    if labels.max() > 255 and (labels % 256).max() > max(ids):
        return refusal(
            what, "colours are packed into one number (RGB-coded labels)", "look up the id of each colour", share=share
        )
    return refusal(
        what,
        "the ids are those of another vocabulary, or grey values of a palette image",
        "name the class mapping that they belong to, and read the indices of a palette PNG, not its colours",
        share=share,
    )
