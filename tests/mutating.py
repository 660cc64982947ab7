"""How sound observations (tests/sound_views.py) are broken on purpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from excavatwin.scene.observations import Observations, View
from sound_views import changed, one_hot

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
Change = Callable[[Observations], Observations]


@dataclass(frozen=True)
class Mutation:
    """One mistake."""

    mistake: str
    change: Change
    named: str
    """What the first finding must say."""
    by: str
    """What tells: numbers, views, photos, pictures, witness."""
    mode: str = "crop"
    """Which sound observations it is made in."""


def each(change: Callable[[View], View]) -> Change:
    return lambda observations: changed(observations, change)


def bare(view: View, **fields: object) -> View:
    """A view with fields that the tests' own shape checks would refuse; users run without them."""
    made = replace(view)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


def in_camera(view: View) -> np.ndarray:
    return (view.points.astype(float) - view.T_R_cam[:3, 3]) @ view.T_R_cam[:3, :3]


def in_world(p_cam: np.ndarray, T: np.ndarray) -> np.ndarray:
    return (p_cam @ T[:3, :3].T + T[:3, 3]).astype(np.float32)


def only_pose(f: Callable[[np.ndarray], np.ndarray]) -> Change:
    return each(lambda view: replace(view, T_R_cam=f(view.T_R_cam)))


def unprojected(f: Callable[[np.ndarray], np.ndarray]) -> Change:
    """The depth unprojected with a wrong pose: every view meets its own pixels."""
    return each(lambda view: replace(view, T_R_cam=f(view.T_R_cam), points=in_world(in_camera(view), f(view.T_R_cam))))


def transposed(T: np.ndarray) -> np.ndarray:
    return np.block([[T[:3, :3].T, T[:3, 3:]], [T[3:]]])


def half_inverted(T: np.ndarray) -> np.ndarray:
    return np.block([[T[:3, :3], -T[:3, :3].T @ T[:3, 3:]], [T[3:]]])


def only_K(f: Callable[[np.ndarray], np.ndarray]) -> Change:
    return each(lambda view: replace(view, K_cam=f(view.K_cam)))


def unprojected_K(f: Callable[[np.ndarray], np.ndarray]) -> Change:
    def change(view: View) -> View:
        K, z = f(view.K_cam), in_camera(view)[..., 2]
        v, u = np.mgrid[: view.shape[0], : view.shape[1]] + 0.5
        p_cam = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=-1)
        K_photo = np.linalg.inv(np.vstack([view.lattice.affine, [0, 0, 1]])) @ K
        points = in_world(p_cam, view.T_R_cam)
        return replace(view, K_cam=K, points=points, lattice=replace(view.lattice, K_photo=K_photo))

    return each(change)


def moved(dx: float, dy: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda K: K + np.array([[0, 0, dx], [0, 0, dy], [0, 0, 0]])


def scaled(k: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda K: K * np.array([[k], [k], [1.0]])


def depth(f: Callable[[np.ndarray], np.ndarray | float]) -> Change:
    """The depth times a factor of the camera's points."""
    return each(lambda view: replace(view, points=in_world(in_camera(view) * f(in_camera(view)), view.T_R_cam)))


def ray_length(p_cam: np.ndarray) -> np.ndarray:
    return np.linalg.norm(p_cam, axis=-1, keepdims=True) / p_cam[..., 2:]


def image(f: Callable[[np.ndarray], np.ndarray]) -> Change:
    return each(lambda view: bare(view, image=np.ascontiguousarray(f(view.image))))


def evidence(f: Callable[[np.ndarray], np.ndarray]) -> Change:
    return each(lambda view: bare(view, evidence=np.ascontiguousarray(f(view.evidence))))


def shifted(dx: float, dy: float) -> Callable[[np.ndarray], np.ndarray]:
    M = np.array([[1.0, 0, dx], [0, 1, dy]])

    def shift(layers: np.ndarray) -> np.ndarray:
        size = layers.shape[1::-1]
        one = [
            cv2.warpAffine(np.ascontiguousarray(layers[..., k]), M, size, borderMode=cv2.BORDER_REPLICATE)
            for k in range(layers.shape[-1])
        ]
        return np.stack(one, axis=-1)

    return shift


def lattice(f: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Another affine, and intrinsics of the photo worked out with it, as adapters of networks do."""

    def change(view: View) -> View:
        affine = f(view.lattice.affine)
        K_photo = np.linalg.inv(np.vstack([affine, [0, 0, 1]])) @ view.K_cam
        return replace(view, lattice=replace(view.lattice, affine=affine, K_photo=K_photo))

    return each(change)


def other_K_photo(view: View) -> View:
    return replace(view, lattice=replace(view.lattice, K_photo=scaled(0.5)(view.lattice.K_photo)))


def swapped_size(observations: Observations) -> Observations:
    return changed(
        observations,
        lambda view: replace(view, lattice=replace(view.lattice, width=view.lattice.height, height=view.lattice.width)),
    )


def squeezed(middle: bool) -> Callable[[np.ndarray], np.ndarray]:
    """Evidence of a picture padded to a square, resized to the lattice with its padding."""

    def squeeze(layers: np.ndarray) -> np.ndarray:
        H, W = layers.shape[:2]
        top = (W - H) // 2 if middle else 0
        square = np.zeros((W, W, layers.shape[2]), np.float32)
        square[top : top + H] = layers
        return np.stack([cv2.resize(square[..., k], (W, H)) for k in range(layers.shape[2])], axis=-1)

    return squeeze


def middle_square(layers: np.ndarray) -> np.ndarray:
    H, W = layers.shape[:2]
    cut = np.ascontiguousarray(layers[:, (W - H) // 2 : (W + H) // 2])
    return np.stack([cv2.resize(np.ascontiguousarray(cut[..., k]), (W, H)) for k in range(5)], axis=-1)


def ids(f: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Labels put through ``f`` before they become evidence; what is no id is lost."""

    def change(view: View) -> View:
        hot = one_hot(view).evidence
        label = f(np.where(hot.any(-1), hot.argmax(-1) + 1, 0))
        return replace(view, evidence=(label[..., None] == np.arange(1, 6)).astype(np.float32))

    return each(change)


def one_more(label: np.ndarray) -> np.ndarray:
    return np.where(label > 0, label + 1, 0)


def one_less(label: np.ndarray) -> np.ndarray:
    return np.maximum(label - 1, 0)


def shuffled(label: np.ndarray) -> np.ndarray:
    return np.array([0, 3, 5, 1, 2, 4])[label]


def bytes_(evidence: np.ndarray) -> np.ndarray:
    return 255 * (evidence > 0.4).astype(np.float32)


def resized_labels(label: np.ndarray) -> np.ndarray:
    H, W = label.shape
    small = cv2.resize(label.astype(np.uint8), (W // 3, H // 3), interpolation=cv2.INTER_NEAREST)
    return cv2.resize(small, (W, H), interpolation=cv2.INTER_LINEAR)


def enlarged(view: View) -> View:
    T = view.T_R_cam.copy()
    T[:3, 3] *= 1000
    return replace(view, points=1000 * view.points, T_R_cam=T)


def one_pose(observations: Observations) -> Observations:
    return changed(
        observations, lambda view: replace(view, points=in_camera(view).astype(np.float32), T_R_cam=np.eye(4))
    )


def next_image(observations: Observations) -> Observations:
    views = observations.views
    return replace(
        observations,
        views=tuple(replace(view, image=views[i - 1].image) for i, view in enumerate(views)),
    )


def errors_for_confidence(observations: Observations) -> Observations:
    """Depth errors in patches, as networks have them, and their size as confidence."""
    rng = np.random.default_rng(3)

    def change(view: View) -> View:
        error = cv2.resize(rng.normal(0, 0.01, (9, 15)), view.shape[::-1], interpolation=cv2.INTER_CUBIC)[..., None]
        points = in_world(in_camera(view) * (1 + error), view.T_R_cam)
        return replace(view, points=points, confidence=(1 + np.abs(error[..., 0])).astype(np.float32))

    return changed(observations, change)
