"""Depth of footprints in a hazard region, which tells intrusions apart that all have HCC 0.

It ranks nothing and is in no sheet: it orders samples for people who have the regions.
"""

import itertools

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.footprint import footprints
from exceptiondrive_scoring.kinematics import positions_of_waypoints, steps


def intrusion_depth_m(
    edited_m: FloatArray, regions_m: FloatArray, geometry: GeometrySection
) -> FloatArray:
    """Return how far the deepest footprint would have to be moved to be clear of the region's hull.

    By separating axes: the shortest way over the directions of the footprint's sides and of all
    lines through two corners of the region, which include those of its hull. If the tube touches
    the region only between two footprints, the depth is 0.

    Args:
        edited_m: (N, T, 2) waypoints, NaN where missing.
        regions_m: (N, 4, 2) corners.
        geometry: The footprint.

    Returns:
        (N,) metres, 0 where no footprint meets it, NaN where the trajectory is missing.
    """
    at = positions_of_waypoints(edited_m)
    boxes = footprints(at, steps(at), geometry)
    corners = np.stack(boxes.corners_m(), axis=-1)  # (4, T + 1, N, 2)
    region = np.moveaxis(regions_m, 1, 0)[:, np.newaxis]  # (4, 1, N, 2)
    ahead = np.stack([boxes.cos, boxes.sin], axis=-1)  # (T + 1, N, 2)
    sides = [region[j] - region[i] for i, j in itertools.combinations(range(4), 2)]
    ways_out = [
        _way_out_m(corners, region, axis)
        for axis in (ahead, _turned_left(ahead), *(_turned_left(side) for side in sides))
    ]
    depth: FloatArray = np.maximum(np.min(ways_out, axis=0), 0.0).max(axis=0)
    return depth


def _turned_left(vectors: FloatArray) -> FloatArray:
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def _way_out_m(corners: FloatArray, region: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the shorter way out along an axis, (T + 1, N); below 0 where the two are apart.

    Two coincident corners define no axis: the way out is then infinite.
    """
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    unit = axis / np.where(length == 0, 1.0, length)
    ours, theirs = (corners * unit).sum(axis=-1), (region * unit).sum(axis=-1)
    way_out: FloatArray = np.minimum(
        ours.max(axis=0) - theirs.min(axis=0), theirs.max(axis=0) - ours.min(axis=0)
    )
    return np.where(length[..., 0] == 0, np.inf, way_out)
