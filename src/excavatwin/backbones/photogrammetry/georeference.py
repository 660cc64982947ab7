"""From an arbitrary frame to an upright and, where GPS allows it, metric and georeferenced one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from excavatwin.backbones.photogrammetry.gravity import Up, angle, up_from_cameras, up_from_gimbal
from excavatwin.backbones.photogrammetry.placement import Placement, SparsePoints
from excavatwin.backbones.photogrammetry.similarity import Similarity, fit_similarity, scale_doubt, tilt_doubt
from excavatwin.scene.frames import rotation_between
from excavatwin.scene.observations import Georeference
from excavatwin.scene.photo import GpsFix, Photo

MOST_TILT = 2.0
"""GPS positions decide the vertical only when they fix it to this [deg]."""
MOST_SCALE = 0.15
"""GPS positions give the scale only when they fix it to this (one standard deviation)."""
WORTH_TILT = 0.3
"""A vertical that is better known than this is no doubt worth a sentence [deg]."""
WORTH_SCALE = 0.005
"""The same of the scale."""


def upright(placement: Placement, photos: Sequence[Photo]) -> Placement:
    """The placement with +z up, its origin near the scene, metric and georeferenced when the GPS positions allow it.

    The vertical comes from GPS positions that determine it, else from gimbal tags, else from cameras and terrain. With
    a vertical from elsewhere, GPS still gives heading, scale and position (four parameters, horizontal first).
    """
    return uprighting(placement, photos)[0]


def uprighting(placement: Placement, photos: Sequence[Photo]) -> tuple[Placement, Float64[np.ndarray, "4 4"]]:
    """As ``upright``, with the similarity [[s R, t], [0, 1]] from the old frame into the new one beside it."""
    cameras = placement.cameras
    centres = np.array([camera.T_R_cam[:3, 3] for camera in cameras])
    of_name = {photo.name: photo for photo in photos}
    fixes = [of_name[camera.name].gps if camera.name in of_name else None for camera in cameras]
    gimbals = {photo.name: photo.gimbal for photo in photos if photo.gimbal is not None}
    local = up_from_gimbal(cameras, gimbals) or up_from_cameras(cameras, placement.points.xyz)
    doubts = list(placement.doubts)
    used = [i for i, fix in enumerate(fixes) if fix is not None]
    epsg, world = project([fix for fix in fixes if fix is not None]) if len(used) >= 3 else (None, np.empty((0, 3)))
    up, whole = _vertical(centres[used], world, local, doubts)
    R = rotation_between(up.direction, np.array([0.0, 0.0, 1.0]))
    flat = _level(centres[used] @ R.T, world, doubts) if epsg is not None else None
    if up.doubt > WORTH_TILT:
        doubts.append(f"The vertical comes from {_said(up.source)} and is good to about {up.doubt:.1f} degrees.")
    if flat is None or epsg is None:
        origin = np.median(placement.points.xyz, axis=0) if len(placement.points.xyz) else centres.mean(0)
        moved = _moved(placement, 1.0, R, -R @ origin)
        local_frame = replace(moved, up_from=up.source, up_doubt=up.doubt, doubts=tuple(doubts))
        return local_frame, _matrix(1.0, R, -R @ origin)
    if whole is not None and up.source == "gps":
        scale, R, t, residual = whole.scale, whole.rotation, whole.translation, whole.residual
    else:
        scale, turn, t, residual = flat
        R = turn @ R
    origin = np.round(np.median(scale * placement.points.xyz @ R.T + t, axis=0))
    moved = _moved(placement, scale, R, t - origin)
    in_metres = replace(
        moved,
        up_from=up.source,
        up_doubt=up.doubt,
        metres_per_unit=1.0,
        georeference=Georeference(epsg, (float(origin[0]), float(origin[1]), float(origin[2])), float(residual)),
        doubts=tuple(doubts),
    )
    return in_metres, _matrix(scale, R, t - origin)


def project(fixes: Sequence[GpsFix]) -> tuple[int, Float64[np.ndarray, "n 3"]]:
    """UTM zone (EPSG) of the middle of the fixes, and easting, northing, altitude [m]; unknown altitudes are NaN."""
    from pyproj import Transformer

    lonlat = np.array([(fix.longitude, fix.latitude) for fix in fixes])
    longitude, latitude = np.median(lonlat, axis=0)
    zone = int((longitude + 180) // 6) % 60 + 1
    epsg = (32600 if latitude >= 0 else 32700) + zone
    east, north = Transformer.from_crs(4326, epsg, always_xy=True).transform(lonlat[:, 0], lonlat[:, 1])
    altitude = [np.nan if fix.altitude is None else fix.altitude for fix in fixes]
    return epsg, np.stack([east, north, altitude], axis=1)


def _vertical(
    centres: Float64[np.ndarray, "n 3"], world: Float64[np.ndarray, "n 3"], local: Up, doubts: list[str]
) -> tuple[Up, Similarity | None]:
    """GPS gravity when the positions determine it and cameras do not contradict, else the local one."""
    good = np.isfinite(world).all(axis=1) if len(world) else np.empty(0, bool)
    fit = fit_similarity(centres[good], world[good] - world[good].mean(0)) if good.sum() >= 4 else None
    if fit is None:
        return local, None
    doubt = tilt_doubt(fit, centres[good])
    up = Up(fit.rotation.T @ np.array([0.0, 0.0, 1.0]), doubt, "gps")
    apart = angle(up.direction, local.direction)
    if doubt > MOST_TILT:
        doubts.append(
            f"GPS positions are too nearly on one line, or too noisy ({fit.residual:.1f} m), to tell the vertical "
            f"(good to {min(doubt, 90):.0f} degrees only), so it was not taken from them."
        )
        return local, None
    if apart > 3 * float(np.hypot(doubt, local.doubt)) + 2:
        doubts.append(
            f"GPS positions and {_said(local.source)} disagree on the vertical by {apart:.0f} degrees: "
            "GPS was not believed."
        )
        return local, None
    if doubt > local.doubt:
        return local, None
    back = world[good].mean(0)
    return up, replace(fit, translation=fit.translation + back)


def _level(
    centres: Float64[np.ndarray, "n 3"], world: Float64[np.ndarray, "n 3"], doubts: list[str]
) -> tuple[float, Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"], float] | None:
    """Heading, scale and position of upright camera centres: horizontal first, then one height for all."""
    middle = np.nanmean(world, axis=0) if np.isfinite(world[:, 2]).any() else np.array([*world[:, :2].mean(0), np.nan])
    fit = fit_similarity(centres[:, :2], (world - middle)[:, :2])
    doubt = scale_doubt(fit, centres[:, :2]) if fit is not None else np.inf
    if fit is None or doubt > MOST_SCALE or fit.scale <= 0:
        spread = np.ptp(world[:, :2], axis=0).max()
        doubts.append(
            f"GPS was not used: {len(world)} positions within {spread:.0f} m do not fix the scale to {MOST_SCALE:.0%}."
        )
        return None
    rejected = int((~fit.inliers).sum())
    if rejected:
        doubts.append(f"{rejected} GPS position(s) that disagree with the others were not used.")
    if doubt > WORTH_SCALE:
        doubts.append(
            f"Scale from GPS positions that the cameras fit to {fit.residual:.2f} m horizontally: good to about "
            f"{doubt:.1%}."
        )
    return _with_height(fit, centres, world, middle, doubts)


def _with_height(
    fit: Similarity,
    centres: Float64[np.ndarray, "n 3"],
    world: Float64[np.ndarray, "n 3"],
    middle: Float64[np.ndarray, "3"],
    doubts: list[str],
) -> tuple[float, Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"], float]:
    turn = np.eye(3)
    turn[:2, :2] = fit.rotation
    lift = world[:, 2] - fit.scale * centres[:, 2]
    known = np.isfinite(lift)
    if known.any():
        height = float(np.median(lift[known]))
        doubts.append("Elevations stand on the altitude that the camera wrote, whose datum differs between makers.")
    else:
        height = 0.0
        doubts.append("The photos carry no altitude: elevations are relative to an arbitrary level.")
    t = np.array([*(fit.translation + middle[:2]), height])
    error = fit.scale * centres @ turn.T + t - world
    error[~known, 2] = 0
    residual = float(np.sqrt((error[fit.inliers] ** 2).sum(1).mean()))
    return fit.scale, turn, t, residual


def _said(source: str) -> str:
    words = {"gps": "GPS positions", "gimbal": "gimbal angles", "cameras": "the way the cameras were held and flown"}
    return words.get(source, "the way the cameras were held and flown and the mean slope of the ground")


def _matrix(scale: float, R: Float64[np.ndarray, "3 3"], t: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """p -> scale R p + t."""
    S = np.eye(4)
    S[:3, :3], S[:3, 3] = scale * R, t
    return S


def _moved(placement: Placement, scale: float, R: Float64[np.ndarray, "3 3"], t: Float64[np.ndarray, "3"]) -> Placement:
    """The placement under p -> scale R p + t."""
    cameras = []
    for camera in placement.cameras:
        T = camera.T_R_cam.copy()
        T[:3, :3] = R @ T[:3, :3]
        T[:3, 3] = scale * R @ T[:3, 3] + t
        cameras.append(replace(camera, T_R_cam=T))
    points = placement.points
    return replace(
        placement,
        cameras=tuple(cameras),
        points=SparsePoints(scale * points.xyz @ R.T + t, points.visible, points.error),
    )
