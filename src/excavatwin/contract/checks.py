"""The contract of one view, checked in order; each function raises at the first thing that is wrong."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64, Integer, UInt8

from excavatwin.contract.labels import label_mistakes
from excavatwin.errors import ObservationError

#: How far a rotation may be from orthonormal (float32 chains of rotations reach 1e-5).
ORTHONORMAL_TOLERANCE = 1e-3


def numeric(array: np.ndarray, key: str, where: str) -> np.ndarray:
    """The array, if it holds real numbers."""
    if array.dtype.kind not in "fiub":
        raise ObservationError(f"{where}: {key} has dtype {array.dtype}; expected real numbers.")
    return array


def checked_points(points: np.ndarray, where: str) -> Float32[np.ndarray, "H W 3"]:
    """Points (H, W, 3) as float32; a point with any NaN is no point at all."""
    numeric(points, "points", where)
    if points.ndim != 3 or points.shape[-1] != 3 or min(points.shape) < 2:
        raise ObservationError(f"{where}: points has shape {points.shape}; expected (H, W, 3), one point per pixel.")
    infinite = np.isinf(points).any(-1)
    if infinite.any():
        raise ObservationError(
            f"{where}: points has an infinite coordinate at {_count(infinite)}, {_first(infinite)}; "
            "write NaN where there is no point."
        )
    P = np.ascontiguousarray(points, np.float32)
    nothing: np.ndarray = np.asarray(np.isnan(P).any(axis=-1))
    if np.any(nothing != np.isnan(P).all(axis=-1)):
        P = np.where(nothing[..., None], np.float32(np.nan), P)
    return P


def check_precision(points: Float32[np.ndarray, "H W 3"], centre: Float64[np.ndarray, "3"], where: str) -> None:
    """Refuse coordinates so large that float32 steps show at the distance from which they are seen."""
    sample = points.reshape(-1, 3)[:: max(1, points.size // 60_000)]
    sample = sample[~np.isnan(sample[:, 0])]
    if not len(sample):
        return
    largest = float(np.abs(sample).max())
    step = float(np.spacing(np.float32(largest)))
    reach = float(np.median(np.linalg.norm(sample - centre, axis=-1)))
    if step > 1e-4 * reach:
        raise ObservationError(
            f"{where}: points lie at coordinates up to {largest:.6g}, where float32 keeps steps of {step:.2g} only, "
            f"too coarse for what is seen from {reach:.3g} away; subtract a common origin from points and poses."
        )


def checked_layer(
    layer: np.ndarray, key: str, points: Float32[np.ndarray, "H W 3"], where: str, channels: int | None = None
) -> Float32[np.ndarray, "*shape"]:
    """A non-negative layer (H, W) or (H, W, channels) on the lattice of the points, as float32.

    It must be finite wherever there is a point; elsewhere what is not finite becomes 0.
    """
    numeric(layer, key, where)
    expected = points.shape[:2] if channels is None else (*points.shape[:2], channels)
    if layer.shape != expected:
        raise ObservationError(
            f"{where}: {key} has shape {layer.shape} but its points are {points.shape[0]} x {points.shape[1]} pixels; "
            f"expected {expected}, on the same pixels as the points{_transposed(layer.shape, expected)}."
        )
    values = np.ascontiguousarray(layer, np.float32)
    broken = ~np.isfinite(values)
    if broken.any():
        at: np.ndarray = broken if channels is None else np.asarray(broken.any(axis=-1))
        wrong = at & ~np.isnan(points[..., 0])
        if wrong.any():
            raise ObservationError(
                f"{where}: {key} is not finite at {_count(wrong)} that have a point, {_first(wrong)}; expected "
                "finite numbers >= 0."
            )
        values = np.where(broken, np.float32(0), values)
    negative = values < 0
    if negative.any():
        at = negative if channels is None else np.asarray(negative.any(axis=-1))
        raise ObservationError(
            f"{where}: {key} is negative at {_count(at)} (down to {values.min():.3g}), {_first(at)}; expected >= 0"
            f"{'; logits need exp or sigmoid first' if channels or values.min() < -1 else ''}."
        )
    return values


def checked_labels(
    labels: np.ndarray, ids: set[int], meaning: str, shape: tuple[int, int], where: str
) -> Integer[np.ndarray, "H W"]:
    """Label image (H, W) whose values are among ``ids``, or 255 = not segmented."""
    if labels.dtype.kind not in "iu":
        raise ObservationError(f"{where}: labels has dtype {labels.dtype}; expected whole numbers such as uint8.")
    if labels.ndim == 3:
        raise ObservationError(f"{where}: {label_mistakes(labels, ids)[0]}")
    if labels.shape != shape:
        raise ObservationError(
            f"{where}: labels is {' x '.join(map(str, labels.shape))} but its points are {shape[0]} x {shape[1]} "
            f"pixels; segment the same lattice, or resize the mask by nearest neighbour"
            f"{_transposed(labels.shape, shape)}."
        )
    strange = [int(v) for v in np.unique(labels) if int(v) not in ids and int(v) != 255]
    if strange:
        at = labels == strange[0]
        cause = "".join(f"; most likely {mistake.cause}" for mistake in label_mistakes(labels, ids))
        raise ObservationError(
            f"{where}: labels holds {strange[0]} at {_count(at)}, {_first(at)}; expected {meaning}, or 255 = none"
            f"{cause}."
        )
    return labels


def checked_pose(T: np.ndarray, where: str) -> Float64[np.ndarray, "4 4"]:
    """A rigid camera-to-world pose."""
    numeric(T, "T_world_cam", where)
    if T.shape != (4, 4):
        hint = "; append the row 0 0 0 1" if T.shape == (3, 4) else ""
        raise ObservationError(f"{where}: T_world_cam has shape {T.shape}; expected (4, 4){hint}.")
    T = T.astype(np.float64)
    if not np.isfinite(T).all():
        raise ObservationError(f"{where}: T_world_cam is not finite; leave out views without a pose.")
    if not np.allclose(T[3], (0, 0, 0, 1), atol=1e-6):
        columns = np.allclose(T[:, 3], (0, 0, 0, 1), atol=1e-6)
        hint = "; it is transposed (row-vector convention): save T.T" if columns else ""
        raise ObservationError(f"{where}: the last row of T_world_cam is {_row(T[3])}; expected 0 0 0 1{hint}.")
    R = T[:3, :3]
    det = float(np.linalg.det(R))
    scale = float(np.cbrt(abs(det)))
    error = float(np.abs(R.T @ R - np.eye(3)).max())
    if error > ORTHONORMAL_TOLERANCE:
        if scale > 0 and np.abs(R.T @ R / scale**2 - np.eye(3)).max() < ORTHONORMAL_TOLERANCE:
            hint = f"it is a rotation times {scale:.6g}: scale the translations and the points, not the rotation"
        else:
            hint = "expected an orthonormal matrix"
        raise ObservationError(
            f"{where}: the rotation of T_world_cam is off by {error:.3g} (R'R against identity); {hint}."
        )
    if det < 0:
        raise ObservationError(
            f"{where}: the rotation of T_world_cam has determinant {det:.3f}, a mirror: the axes are left-handed; "
            "flip one axis so that x is right, y down, z forward."
        )
    return T


def checked_intrinsics(K: np.ndarray, shape: tuple[int, int], where: str) -> Float64[np.ndarray, "3 3"]:
    """Intrinsics in pixels of the lattice (H, W)."""
    numeric(K, "K", where)
    if K.shape != (3, 3):
        raise ObservationError(f"{where}: K has shape {K.shape}; expected (3, 3): fx 0 cx / 0 fy cy / 0 0 1.")
    K = K.astype(np.float64)
    H, W = shape
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    if not np.isfinite(K).all() or not np.allclose(K[2], (0, 0, 1), atol=1e-6):
        hint = "; it is transposed: save K.T" if np.allclose(K[:, 2], (0, 0, 1), atol=1e-6) else ""
        raise ObservationError(f"{where}: the last row of K is {_row(K[2])}; expected 0 0 1{hint}.")
    if min(fx, fy) <= 0:
        raise ObservationError(f"{where}: K has focal lengths {fx:.6g}, {fy:.6g}; expected positive pixels.")
    if fx < min(10, 0.1 * W) and max(cx, cy) < 2:
        raise ObservationError(
            f"{where}: K has fx = {fx:.4g}, cx = {cx:.4g}, which is normalised by the image size; multiply its rows by "
            f"{W} and {H}."
        )
    if not (0.1 * W < fx < 50 * W and 0.2 < fx / fy < 5 and -W < cx < 2 * W and -H < cy < 2 * H):
        raise ObservationError(
            f"{where}: K (fx {fx:.6g}, fy {fy:.6g}, cx {cx:.6g}, cy {cy:.6g}) does not fit an image of {W} x {H} px; "
            "give K in pixels of this lattice."
        )
    return K


def checked_image(image: np.ndarray, shape: tuple[int, int], where: str) -> UInt8[np.ndarray, "H W 3"]:
    """RGB image on the lattice."""
    if image.shape != (*shape, 3):
        raise ObservationError(f"{where}: images has shape {image.shape}; expected {(*shape, 3)}, as the points.")
    if image.dtype != np.uint8:
        raise ObservationError(f"{where}: images has dtype {image.dtype}; expected uint8, 0..255.")
    return np.ascontiguousarray(image)


def checked_up(up: object) -> Float64[np.ndarray, "3"]:
    """Unit vector against gravity."""
    vector = np.asarray(up, float)
    if vector.shape != (3,) or not np.isfinite(vector).all() or np.linalg.norm(vector) < 1e-9:
        raise ObservationError(f"up is {up}; expected three finite numbers, the direction against gravity.")
    return vector / np.linalg.norm(vector)


def checked_scale(metres_per_unit: object) -> float | None:
    """Metric scale; NaN and a missing value mean that it is not known."""
    value = np.asarray(metres_per_unit, float)
    if value.size != 1 or not (np.isnan(value).all() or (np.isfinite(value).all() and value.item() > 0)):
        raise ObservationError(f"metres_per_unit is {metres_per_unit}; expected one positive number.")
    return None if np.isnan(value.item()) else float(value.item())


def _count(at: np.ndarray) -> str:
    n = int(at.sum())
    return f"{n} pixel{'s' if n != 1 else ''}"


def _first(at: np.ndarray) -> str:
    row, col = np.argwhere(at)[0]
    return f"first at row {row}, column {col}"


def _row(row: Float[np.ndarray, "n"]) -> str:
    return " ".join(f"{v:.4g}" for v in row)


def _transposed(found: tuple[int, ...], expected: tuple[int, ...]) -> str:
    swapped = found[:2] == expected[:2][::-1] and expected[0] != expected[1]
    return " (rows and columns are swapped)" if swapped else ""
