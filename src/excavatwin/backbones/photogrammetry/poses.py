"""Photos to camera poses: incremental structure from motion (Schönberger and Frahm, CVPR 2016) over pycolmap."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pycolmap

from excavatwin.backbones.photogrammetry.calibration import USUAL_FOCAL, Calibration, calibrate
from excavatwin.backbones.photogrammetry.features import Features, extract
from excavatwin.backbones.photogrammetry.matching import Pair, choose_pairs, match_pairs
from excavatwin.backbones.photogrammetry.placement import PlacedCamera, Placement, SparsePoints
from excavatwin.backbones.photogrammetry.placing import Placing
from excavatwin.errors import InputError, OutputError, ReconstructionError
from excavatwin.scene.frames import invert_rigid
from excavatwin.scene.observations import Unplaced
from excavatwin.scene.photo import Photo
from excavatwin.scene.progress import Progress, silent

LEAST_VIEWS = 3
"""A point of the map needs a photo and two others that confirm it."""
ADVICE = "take photos that overlap their neighbours by 70 % or more, sharp, from moving positions"


def structure_from_motion(photos: Sequence[Photo], settings: Placing, progress: Progress = silent) -> Placement:
    """Poses and sparse points in an arbitrary frame (``up_from`` is ``unknown``: not upright yet).

    Of several blocks that do not hang together the largest is kept; the photos of the others are named.

    Raises:
        InputError: fewer than three readable photos.
        ReconstructionError: no block of three photos hangs together.
    """
    if len(photos) < LEAST_VIEWS:
        raise InputError(f"Found {len(photos)} photo(s), but a map needs at least {LEAST_VIEWS}; {ADVICE}.")
    features, unplaced = extract(photos, settings.long_side, settings.max_features, settings.contrast, progress)
    if len(features) < LEAST_VIEWS:
        raise InputError(
            f"Only {len(features)} of {len(photos)} photos could be read ({unplaced[0].reason}); copy them again."
        )
    cameras = _cameras(features)
    of_photo = [cameras[item.photo.camera] for item in features]
    pairs = choose_pairs(features, settings.neighbours, settings.exhaustive_up_to, settings.ratio)
    with _quiet(settings.seed):
        verified = match_pairs(features, of_photo, pairs, settings.ratio, settings.seed, progress)
        blocks = _map(features, of_photo, verified, settings, progress)
        block = _largest(blocks, len(features), verified)
        prior = {camera.camera_id: float(camera.focal_length) for camera in cameras.values()}
        adjusted, calibration = calibrate(block, {i: prior[i] for i in block.cameras})
        if calibration.focal_refined and abs(calibration.change) > 0.01:
            # tracks were built with the wrong lens: build them again with the right one
            for camera in cameras.values():
                if adjusted.exists_camera(camera.camera_id):  # else all photos of this lens are outside the block
                    camera.focal_length = adjusted.camera(camera.camera_id).focal_length
            again = _map(features, of_photo, verified, settings, progress)
            if again and max(model.num_reg_images() for model in again) >= block.num_reg_images():
                blocks, block = again, _largest(again, len(features), verified)
                adjusted, calibration = calibrate(block, {i: prior[i] for i in block.cameras})
    unplaced += _left_out(features, verified, block, blocks)
    return _placement(adjusted, features, calibration, unplaced)


def _cameras(features: Sequence[Features]) -> dict[str, pycolmap.Camera]:
    """One camera per lens, of the size of the shrunk photos."""
    cameras: dict[str, pycolmap.Camera] = {}
    for item in features:
        photo = item.photo
        if photo.camera in cameras:
            continue
        width, height = photo.width * item.scale, photo.height * item.scale
        focal = (photo.focal or USUAL_FOCAL * max(photo.width, photo.height)) * item.scale
        camera = pycolmap.Camera(
            model="SIMPLE_RADIAL",
            width=round(width),
            height=round(height),
            params=[focal, width / 2, height / 2, 0.0],
            camera_id=len(cameras) + 1,
        )
        camera.has_prior_focal_length = photo.focal is not None
        cameras[photo.camera] = camera
    return cameras


def _map(
    features: Sequence[Features],
    cameras: Sequence[pycolmap.Camera],
    verified: Mapping[Pair, pycolmap.TwoViewGeometry],
    settings: Placing,
    progress: Progress,
) -> list[pycolmap.Reconstruction]:
    """All blocks that incremental mapping finds; image ids are positions in ``features`` plus one."""
    options = pycolmap.IncrementalPipelineOptions()
    options.extract_colors = False
    options.min_model_size = LEAST_VIEWS
    options.num_threads = options.mapper.num_threads = 1  # repeats to the last bit, and loses no time at this size
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = settings.seed
    known = all(camera.has_prior_focal_length for camera in cameras)
    options.ba_refine_focal_length = options.mapper.abs_pose_refine_focal_length = not known
    placed = 0

    def advance(by: int) -> None:
        nonlocal placed
        placed = min(placed + by, len(features))
        progress("mapping", placed, len(features))

    progress("mapping", 0, len(features))
    with tempfile.TemporaryDirectory(prefix="excavatwin-") as folder:
        database = Path(folder) / "features.db"
        try:
            _write_database(database, features, cameras, verified)
        except RuntimeError as error:  # of SQLite, which has but one word for it
            raise OutputError(
                f"The temporary folder {Path(folder).parent} cannot be written: the disk is full or read-only; "
                "free some space, or set TMPDIR to another folder."
            ) from error
        models = pycolmap.incremental_mapping(
            database, folder, folder, options, "", lambda: advance(2), lambda: advance(1)
        )
    progress("mapping", len(features), len(features))
    return list(models.values())


def _write_database(
    path: Path,
    features: Sequence[Features],
    cameras: Sequence[pycolmap.Camera],
    verified: Mapping[Pair, pycolmap.TwoViewGeometry],
) -> None:
    database = pycolmap.Database.open(path)
    try:
        for camera in {camera.camera_id: camera for camera in cameras}.values():
            database.write_camera(camera, True)
            rig = pycolmap.Rig(rig_id=camera.camera_id)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, True)
        for image_id, (item, camera) in enumerate(zip(features, cameras, strict=True), 1):
            image = pycolmap.Image(name=item.photo.name, camera_id=camera.camera_id, image_id=image_id)
            database.write_image(image, True)
            frame = pycolmap.Frame(frame_id=image_id, rig_id=camera.camera_id)
            frame.add_data_id(image.data_id)
            database.write_frame(frame, True)
            database.write_keypoints(image_id, item.keypoints)
        for (i, j), geometry in verified.items():
            database.write_two_view_geometry(i + 1, j + 1, geometry)
    finally:
        database.close()


def _largest(
    blocks: Sequence[pycolmap.Reconstruction], n: int, verified: Mapping[Pair, pycolmap.TwoViewGeometry]
) -> pycolmap.Reconstruction:
    best = max(blocks, key=lambda block: (block.num_reg_images(), block.num_points3D()), default=None)
    if best is None or best.num_reg_images() < LEAST_VIEWS:
        raise ReconstructionError(
            f"No {LEAST_VIEWS} of the {n} photos could be placed together ({len(verified)} pairs of them share "
            f"features); {ADVICE}."
        )
    return best


def _left_out(
    features: Sequence[Features],
    verified: Mapping[Pair, pycolmap.TwoViewGeometry],
    kept: pycolmap.Reconstruction,
    blocks: Sequence[pycolmap.Reconstruction],
) -> list[Unplaced]:
    """Why each readable photo outside the kept block is outside."""
    partners: dict[int, int] = {}
    for i, j in verified:
        partners[i], partners[j] = partners.get(i, 0) + 1, partners.get(j, 0) + 1
    inside = set(kept.reg_image_ids())
    left: list[Unplaced] = []
    for i, item in enumerate(features):
        if i + 1 in inside:
            continue
        other = next((block for block in blocks if i + 1 in block.reg_image_ids()), None)
        if other is not None:
            reason = f"belongs to a detached block of {other.num_reg_images()} photos that shares no view with the map"
        elif i not in partners:
            reason = f"shares too few features with any other photo ({len(item.keypoints)} features found in it)"
        else:
            reason = f"overlaps {partners[i]} other photo(s) too little to be placed"
        left.append(Unplaced(item.photo.name, reason))
    return left


def _placement(
    model: pycolmap.Reconstruction, features: Sequence[Features], calibration: Calibration, unplaced: list[Unplaced]
) -> Placement:
    """The model in our nouns, photos in the order in which they were given, lens in pixels of the full photo."""
    ids = sorted(model.point3D_ids())
    row = {point_id: i for i, point_id in enumerate(ids)}
    points = [model.point3D(point_id) for point_id in ids]
    cameras, visible = [], []
    for image_id in sorted(model.reg_image_ids()):
        item, image = features[image_id - 1], model.image(image_id)
        lens = model.camera(image.camera_id)
        seen = [point for point in image.points2D if point.has_point3D()]
        pose = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        f, _, _, *radial = lens.params
        world = np.array([model.point3D(point.point3D_id).xyz for point in seen]).reshape(-1, 3)
        uv = np.asarray(lens.img_from_cam(world @ pose[:3, :3].T + pose[:3, 3])).reshape(-1, 2)
        error = np.linalg.norm(uv - np.array([point.xy for point in seen]).reshape(-1, 2), axis=1)
        photo = item.photo
        K = np.array([[f / item.scale, 0, photo.width / 2], [0, f / item.scale, photo.height / 2], [0, 0, 1]])
        k1, k2 = (*radial, 0.0)[:2]
        rows = np.array(sorted({row[point.point3D_id] for point in seen}), np.int64)  # one place may give two features
        placed = PlacedCamera(
            name=photo.name,
            width=photo.width,
            height=photo.height,
            K_photo=K,
            distortion=(float(k1), float(k2), 0.0, 0.0),
            T_R_cam=invert_rigid(pose),
            n_points=len(rows),
            reprojection_error=float(np.nanmedian(error)) / item.scale if len(seen) else float("nan"),
        )
        cameras.append(placed)
        visible.append(rows)
    known = all(features[i - 1].photo.focal is not None for i in model.reg_image_ids())
    doubts = () if known or calibration.focal_refined else (_unknown_focal(),)
    return Placement(
        cameras=tuple(cameras),
        points=SparsePoints(
            xyz=np.array([point.xyz for point in points]).reshape(-1, 3),
            visible=tuple(visible),
            error=np.array([point.error for point in points]),
        ),
        unplaced=tuple(unplaced),
        doubts=doubts,
        calibration=calibration.sentence(known),
        source={"poses": f"pycolmap {pycolmap.__version__} incremental mapping", "sparse points": str(len(points))},
    )


def _unknown_focal() -> str:
    return (
        f"The photos do not tell their focal length and their views cannot observe it: {USUAL_FOCAL} of the long side "
        "was assumed, so heights may be stretched by tens of per cent; add oblique photos or the focal length."
    )


@contextmanager
def _quiet(seed: int) -> Iterator[None]:
    """No log lines of pycolmap, and its random numbers from ``seed``."""
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    pycolmap.set_random_seed(seed)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level
