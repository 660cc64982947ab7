"""Mistakes of convention, made on purpose: each with the words by which the validator must name it.

``TABLE`` is the table of docs/validation.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from excavatwin.scene.frames import invert_rigid
from mutating import (
    FLIP,
    Mutation,
    depth,
    each,
    enlarged,
    half_inverted,
    in_camera,
    moved,
    one_pose,
    only_K,
    only_pose,
    ray_length,
    scaled,
    transposed,
    unprojected,
    unprojected_K,
)
from mutations_of_pictures import CLASSES, CONFIDENCES, LATTICES, LAYERS, PICTURES

_POSE, _UNPROJECTED = "pose wrong, points right", "depth unprojected with the wrong pose"
POSES = [
    Mutation(f"world-to-camera pose ({_POSE})", only_pose(invert_rigid), "the pose is world-to-camera", "numbers"),
    Mutation(
        f"world-to-camera pose ({_UNPROJECTED})",
        unprojected(invert_rigid),
        "the poses are world-to-camera (inverted)",
        "views",
    ),
    Mutation(f"OpenGL axes ({_POSE})", only_pose(lambda T: T @ FLIP), "the camera axes are OpenGL's", "numbers"),
    Mutation(f"OpenGL axes ({_UNPROJECTED})", unprojected(lambda T: T @ FLIP), "the camera axes are OpenGL's", "views"),
    Mutation(
        f"world-to-camera, OpenGL axes ({_POSE})",
        only_pose(lambda T: invert_rigid(T @ FLIP)),
        "the pose is world-to-camera with OpenGL axes",
        "numbers",
    ),
    Mutation(
        f"world-to-camera, OpenGL axes ({_UNPROJECTED})",
        unprojected(lambda T: invert_rigid(T @ FLIP)),
        "the poses are world-to-camera with OpenGL axes",
        "views",
    ),
    Mutation(
        f"world-to-camera, OpenGL axes, turned without inverting ({_UNPROJECTED})",
        unprojected(lambda T: FLIP @ invert_rigid(T) @ FLIP),
        "the poses are world-to-camera with OpenGL axes",  # the same but for a turn of the world
        "views",
    ),
    Mutation(f"rotation transposed ({_POSE})", only_pose(transposed), "the rotation is transposed", "numbers"),
    Mutation(f"rotation transposed ({_UNPROJECTED})", unprojected(transposed), "the rotation is transposed", "views"),
    Mutation(
        "rotation camera-to-world, translation world-to-camera",
        unprojected(half_inverted),
        "the translation is that of world-to-camera",
        "views",
    ),
    Mutation("4 x 4 matrix transposed", only_pose(lambda T: T.T.copy()), "it is transposed", "numbers"),
    Mutation(
        "scale left in the rotation",
        only_pose(lambda T: T * np.array([2.5, 2.5, 2.5, 1.0])),
        "it is a rotation times 2.5",
        "numbers",
    ),
    Mutation(
        "left-handed axes",
        only_pose(lambda T: T @ np.diag([-1.0, 1, 1, 1])),
        "a mirror: the axes are left-handed",
        "numbers",
    ),
    Mutation(
        "points in camera coordinates",
        each(lambda view: replace(view, points=in_camera(view).astype(np.float32))),
        "the points are in camera coordinates",
        "numbers",
    ),
    Mutation("points in camera coordinates, poses lost", one_pose, "the poses are lost", "views"),
]
DEPTHS = [
    Mutation("length of the ray as depth", depth(ray_length), "the depth is the length of the ray", "views"),
    Mutation(
        "depth along rays of unit length", depth(lambda p: 1 / ray_length(p)), "with rays of unit length", "views"
    ),
    Mutation("depth in millimetres, poses in metres", depth(lambda p: 1000.0), "the depth is in millimetres", "views"),
    Mutation("depth in metres, poses in millimetres", depth(lambda p: 1e-3), "the poses are in millimetres", "views"),
    Mutation(
        "everything in millimetres, declared as metres",
        each(enlarged),
        "millimetres are declared as metres",
        "numbers",
    ),
]
CAMERAS = [
    Mutation("K half a pixel off", only_K(moved(-0.5, -0.5)), "pixel centres at whole numbers", "numbers"),
    Mutation(
        "K half a pixel off (depth unprojected with it)",
        unprojected_K(moved(-0.5, -0.5)),
        "half a pixel: K counts pixel centres at whole numbers",
        "numbers",
    ),
    Mutation("crop forgotten in K", only_K(moved(0, 25)), "K does not belong to this lattice (crop", "numbers"),
    Mutation(
        "crop forgotten in K (depth unprojected with it)",
        unprojected_K(moved(0, 25)),
        "the crop is forgotten in K",
        "views",
    ),
    Mutation(
        "padding forgotten in K",
        only_K(moved(0, -45)),
        "K does not belong to this lattice (crop, padding",
        "numbers",
        "pad",
    ),
    Mutation(
        "padding forgotten in K (depth unprojected with it)",
        unprojected_K(moved(0, -45)),
        "the padding is forgotten in K",
        "views",
        "pad",
    ),
    Mutation("K of the photo on the lattice", only_K(scaled(2)), "K belongs to an image 2 times as large", "numbers"),
    Mutation(
        "K of the photo (depth unprojected with it)",
        unprojected_K(scaled(2)),
        "K belongs to an image 2 times as large",
        "views",
    ),
    Mutation(
        "K normalised by the image size",
        only_K(lambda K: K / np.array([[364.0], [224], [1]])),
        "normalised by the image size",
        "numbers",
    ),
    Mutation(
        "x and y of K swapped (depth unprojected with it)",
        unprojected_K(lambda K: K[np.ix_((1, 0, 2), (1, 0, 2))]),
        "x and y of K are swapped",
        "views",
    ),
    Mutation("K transposed", only_K(lambda K: K.T.copy()), "it is transposed", "numbers"),
]
TABLE = [*POSES, *DEPTHS, *CAMERAS, *LATTICES, *PICTURES, *LAYERS, *CLASSES, *CONFIDENCES]
