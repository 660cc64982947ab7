"""Perfect observations: what frozen models would deliver if they never erred, or erred by a known amount."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from excavatwin.scene.observations import Observations, View
from excavatwin.scene.taxonomy import K
from excavatwin.simulation.camera import Camera
from excavatwin.simulation.render import pixel_rays, render_view
from excavatwin.simulation.site import DigSite


def exact_observations(
    site: DigSite,
    cameras: Sequence[Camera],
    *,
    evidence: str = "truth",
    metres_per_unit: float = 1.0,
    R_R_M: Float64[np.ndarray, "3 3"] | None = None,
    t_R_M: Float64[np.ndarray, "3"] | None = None,
    declare: bool = True,
    range_noise: float = 0.0,
    wrong: float = 0.0,
    samples: int = 1,
    seed: int = 0,
) -> Observations:
    """Observations of a site in frame R, with p_R = (R_R_M p_M) / metres_per_unit + t_R_M.

    Args:
        evidence: ``"truth"`` is one-hot from the true classes, ``"none"`` is all zero.
        declare: whether the observations tell ``up`` and ``metres_per_unit``.
        range_noise: standard deviation of the depth, relative to it.
        wrong: share of patches of 16 x 16 pixels whose evidence is for another class, drawn anew in every view.
        samples: rays per pixel along each axis, for the images.

    Raises:
        ValueError: ``evidence`` is neither of its two values.
    """
    if evidence not in ("truth", "none"):
        raise ValueError(f"evidence is {evidence!r}; it can be 'truth' or 'none'.")
    R = np.eye(3) if R_R_M is None else np.asarray(R_R_M, float)
    t = np.zeros(3) if t_R_M is None else np.asarray(t_R_M, float)
    rng = np.random.default_rng(seed)
    views = []
    for number, camera in enumerate(cameras):
        rendered = render_view(site, camera, samples=samples)
        T_R_cam = np.eye(4)
        T_R_cam[:3, :3] = R @ camera.T_M_cam[:3, :3]
        T_R_cam[:3, 3] = R @ camera.T_M_cam[:3, 3] / metres_per_unit + t
        depth = rendered.depth.astype(float) / metres_per_unit
        depth = depth * (1 + range_noise * rng.normal(size=depth.shape))
        points = T_R_cam[:3, 3] + depth[..., None] * (pixel_rays(camera) @ T_R_cam[:3, :3].T)
        label = mistaken(rendered.label, wrong, rng) if wrong else rendered.label
        views.append(
            View(
                name=f"view_{number:03d}",
                points=points.astype(np.float32),
                confidence=np.where(np.isfinite(depth), 8.0, 0.0).astype(np.float32),
                evidence=one_hot(label) if evidence == "truth" else np.zeros((*label.shape, K), np.float32),
                T_R_cam=T_R_cam,
                K_cam=camera.K_cam,
                image=rendered.image if samples else None,
            )
        )
    return Observations(
        tuple(views),
        up=R[:, 2].copy() if declare else None,
        metres_per_unit=metres_per_unit if declare else None,
        source={"reconstructor": "simulation", "segmenter": f"simulation ({evidence})"},
    )


def one_hot(label: UInt8[np.ndarray, "H W"]) -> Float32[np.ndarray, "H W K"]:
    """Evidence 1 for the class of each pixel; zero in the sky."""
    return (label[..., None] == np.arange(1, K + 1)).astype(np.float32)


def mistaken(label: UInt8[np.ndarray, "H W"], share: float, rng: np.random.Generator) -> UInt8[np.ndarray, "H W"]:
    """The labels with a share of 16 x 16 patches given to one random class each."""
    rows, cols = (-(-n // 16) for n in label.shape)
    wrong = np.where(rng.random((rows, cols)) < share, rng.integers(1, K + 1, (rows, cols)), 0)
    spread = np.kron(wrong, np.ones((16, 16), int))[: label.shape[0], : label.shape[1]]
    return np.where((spread > 0) & (label <= K), spread, label).astype(np.uint8)
