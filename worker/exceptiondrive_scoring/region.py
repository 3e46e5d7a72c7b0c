"""Hazard regions H_i: closed simple quadrilaterals, cut into convex pieces once per split."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import BoolArray, FloatArray


@dataclass(frozen=True)
class PreparedRegions:
    """Convex pieces of N regions, corners counter-clockwise, corner-major.

    The first N pieces belong to the samples in order; the second pieces of concave regions, which
    are rare, follow. A triangle repeats its last corner.

    Attributes:
        x_m: (4, P) longitudinal coordinates of the corners.
        y_m: (4, P) lateral coordinates of the corners.
        sample: (P,) index of the sample that each piece belongs to.
        n_samples: N.
    """

    x_m: FloatArray
    y_m: FloatArray
    sample: NDArray[np.intp]
    n_samples: int


def signed_area_m2(corners_m: FloatArray) -> FloatArray:
    """Area of each quadrilateral, (N, 4, 2) -> (N,); positive if counter-clockwise."""
    diagonal = corners_m[:, 2] - corners_m[:, 0]
    other = corners_m[:, 3] - corners_m[:, 1]
    area: FloatArray = (diagonal[:, 0] * other[:, 1] - diagonal[:, 1] * other[:, 0]) / 2
    return area


def is_far(corners_m: FloatArray, geometry: GeometrySection) -> BoolArray:
    """Whether a corner of each region lies beyond `max_region_distance_m`; (N, 4, 2) -> (N,)."""
    with np.errstate(over="ignore"):  # a distance that overflows is too far, too
        away_m = np.hypot(corners_m[..., 0], corners_m[..., 1]).max(axis=1)
    far: BoolArray = away_m > geometry.max_region_distance_m
    return far


def is_small(corners_m: FloatArray, geometry: GeometrySection) -> BoolArray:
    """Whether each region has less than `min_region_area_m2`; (N, 4, 2) -> (N,)."""
    small: BoolArray = np.abs(signed_area_m2(corners_m)) < geometry.min_region_area_m2
    return small


def crosses_itself(corners_m: FloatArray) -> BoolArray:
    """Whether each region crosses or touches itself; (N, 4, 2) -> (N,).

    It crosses itself where two corners turn the wrong way, and touches itself where one turns back.
    """
    corners = counter_clockwise(corners_m)
    turns_m2 = _turns_m2(corners)
    ahead = ((corners - np.roll(corners, 1, 1)) * (np.roll(corners, -1, 1) - corners)).sum(axis=2)
    turns_back = (turns_m2 == 0) & (ahead < 0)
    crosses: BoolArray = ((turns_m2 < 0).sum(axis=1) > 1) | turns_back.any(axis=1)
    return crosses


def _turns_m2(corners_m: FloatArray) -> FloatArray:
    """Return the cross product of the sides at each corner, (N, 4); below 0 at a right turn."""
    incoming = corners_m - np.roll(corners_m, 1, axis=1)
    outgoing = np.roll(corners_m, -1, axis=1) - corners_m
    turns: FloatArray = incoming[..., 0] * outgoing[..., 1] - incoming[..., 1] * outgoing[..., 0]
    return turns


def counter_clockwise(corners_m: FloatArray) -> FloatArray:
    """Return the corners in counter-clockwise order, (N, 4, 2); the argument is not modified."""
    clockwise = signed_area_m2(corners_m) < 0
    ordered: FloatArray = np.where(clockwise[:, None, None], corners_m[:, ::-1], corners_m)
    return ordered


def prepare_regions(regions_m: FloatArray) -> PreparedRegions:
    """Cut every region, (N, 4, 2) finite corners, into one or two convex pieces.

    A concave quadrilateral has exactly one reflex corner; the diagonal from there cuts it into two
    triangles. Corners may be given in either orientation.

    Raises:
        ValueError: A region crosses itself.
    """
    corners = counter_clockwise(np.asarray(regions_m, dtype=np.float64).reshape(-1, 4, 2))
    reflex = _turns_m2(corners) < 0
    if (reflex.sum(axis=1) > 1).any():
        raise ValueError("a hazard region crosses itself; the split has to be repaired")
    concave = np.flatnonzero(reflex.any(axis=1))
    first, second = _cut_at_reflex_corner(corners[concave], reflex[concave])
    pieces = np.concatenate([corners, second])
    pieces[concave] = first
    sample = np.concatenate([np.arange(len(corners)), concave])
    x_m, y_m = np.ascontiguousarray(pieces.transpose(2, 1, 0))
    return PreparedRegions(x_m, y_m, sample, len(corners))


def _cut_at_reflex_corner(
    corners: FloatArray, reflex: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Triangles (r, r + 1, r + 2) and (r, r + 2, r + 3), r the reflex corner."""
    turn = (reflex.argmax(axis=1)[:, None] + np.arange(4)) % 4
    from_reflex = np.take_along_axis(corners, turn[..., None], axis=1)
    return from_reflex[:, [0, 1, 2, 2]], from_reflex[:, [0, 2, 3, 3]]
