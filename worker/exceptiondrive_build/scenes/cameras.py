"""Where a point of the ground stands in a camera's picture."""

import numpy as np

from exceptiondrive_build.scenes.keyframe import Camera
from exceptiondrive_scoring.aliases import FloatArray

NEAR_M = 0.3
"""What is nearer to the image plane than this is cut off."""


def projection(camera: Camera) -> FloatArray:
    """(3, 4): takes (x, y, z, 1) of the ego frame to (u depth, v depth, depth)."""
    matrix: FloatArray = np.array(camera.intrinsic) @ np.array(camera.camera_from_ego)
    return matrix


def project(camera: Camera, points_m: FloatArray) -> FloatArray:
    """Pixels of points, as `view_points` of the nuScenes devkit has them.

    Args:
        camera: Calibration.
        points_m: (n, 2) on the ground, or (n, 3), in the ego frame.

    Returns:
        (n, 2) pixels, inside of the picture or not; NaN behind the camera.
    """
    seen = _seen(camera, points_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(seen[:, 2:] >= NEAR_M, seen[:, :2] / seen[:, 2:], np.nan)


def ground_polygon(camera: Camera, corners_m: FloatArray) -> FloatArray:
    """The part of a polygon on the ground that is in front of a camera, in pixels.

    Args:
        camera: Calibration.
        corners_m: (n, 2) in the ego frame, in order round it.

    Returns:
        (k, 2) corners, inside of the picture or not; k = 0 where all of it is behind the camera.
    """
    seen = _seen(camera, corners_m)
    cut = []
    for here, there in zip(seen, np.roll(seen, -1, axis=0), strict=True):
        if here[2] >= NEAR_M:
            cut.append(here)
        if (here[2] >= NEAR_M) != (there[2] >= NEAR_M):
            cut.append(here + (there - here) * (NEAR_M - here[2]) / (there[2] - here[2]))
    found = np.array(cut).reshape(-1, 3)
    pixels: FloatArray = found[:, :2] / found[:, 2:]
    return pixels


def _seen(camera: Camera, points_m: FloatArray) -> FloatArray:
    n_points, n_axes = points_m.shape
    rest = np.zeros((n_points, 3 - n_axes))
    seen: FloatArray = np.hstack([points_m, rest, np.ones((n_points, 1))]) @ projection(camera).T
    return seen
