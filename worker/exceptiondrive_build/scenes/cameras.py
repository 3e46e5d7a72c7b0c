"""Projection of points on the ground into a camera's picture."""

import numpy as np

from exceptiondrive_build.scenes.keyframe import Camera
from exceptiondrive_scoring.aliases import FloatArray

NEAR_M = 0.3
"""Points nearer to the image plane than this are clipped."""


def projection(camera: Camera) -> FloatArray:
    """Return the (3, 4) matrix from (x, y, z, 1) of the ego frame to (u depth, v depth, depth)."""
    matrix: FloatArray = np.array(camera.intrinsic) @ np.array(camera.camera_from_ego)
    return matrix


def project(camera: Camera, points_m: FloatArray) -> FloatArray:
    """Return the pixels of points, like `view_points` of the nuScenes devkit.

    Args:
        camera: Calibration.
        points_m: (n, 2) on the ground, or (n, 3), in the ego frame.

    Returns:
        (n, 2) pixels, inside the picture or not; NaN behind the camera.
    """
    n_points, n_axes = points_m.shape
    rest = np.zeros((n_points, 3 - n_axes))
    seen = np.hstack([points_m, rest, np.ones((n_points, 1))]) @ projection(camera).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(seen[:, 2:] >= NEAR_M, seen[:, :2] / seen[:, 2:], np.nan)
