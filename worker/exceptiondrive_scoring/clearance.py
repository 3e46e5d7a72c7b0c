"""Clearance: Euclidean distance of collision tube and hazard region (PROTOCOL.md section 2).

The tube is a union of convex pieces and the region of one or two, so the clearance is the least
distance over all pairs of pieces. Most pairs cannot be the nearest; two bounds, both cheap in the
frame of a footprint, show which can:

* from above: the distance of a region corner and a footprint (0 settles the sample);
* from below: the gap of two boxes, one around the tube piece, one around the region piece.

The promising pairs go to `convex_distance` in two rounds, the best one of each region piece first,
so that its result prunes the rest. Pruning never changes the result: a pair is left out only if
its lower bound is not below a distance that is attained.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.convex_distance import hull_distance_m
from exceptiondrive_scoring.footprint import Footprints, footprints
from exceptiondrive_scoring.region import PreparedRegions

BLOCK_COLUMNS = 640
"""Region pieces bounded at once: the temporaries of a block stay in the processor's cache."""


def clearance_m(
    points_m: FloatArray, regions: PreparedRegions, geometry: GeometrySection
) -> FloatArray:
    """Clearance of every sample, exact also when far away; 0 on contact.

    Args:
        points_m: (N, T + 1, 2) finite positions, the origin first.
        regions: Prepared regions of the same N samples.
        geometry: Heading rule, footprint, kind of tube.

    Returns:
        (N,) metres.
    """
    x_m = np.ascontiguousarray(points_m[..., 0].T)
    y_m = np.ascontiguousarray(points_m[..., 1].T)
    boxes = footprints(x_m, y_m, geometry)
    swept = geometry.collision_tube == "hulls" and len(x_m) > 1
    above, below = _bounds_m(boxes, regions, swept=swept)
    nearest = _least_by_sample(above, regions)
    best = below.argmin(axis=0)
    columns = np.arange(below.shape[1])
    for first_round in (True, False):
        is_best = np.zeros(below.shape, dtype=np.bool_)
        is_best[best, columns] = True
        open_pairs = (below < nearest.take(regions.sample)) & (is_best == first_round)
        piece, column = np.nonzero(open_pairs)
        distance = _exact_m(boxes, regions, piece, column, swept=swept)
        np.minimum.at(nearest, regions.sample.take(column), distance)
    return nearest


def _bounds_m(
    boxes: Footprints, regions: PreparedRegions, *, swept: bool
) -> tuple[FloatArray, FloatArray]:
    """Upper bound per region piece, (P,), and lower bound per pair of pieces, (pieces, P)."""
    n_pieces = len(boxes.x_m) - 1 if swept else len(boxes.x_m)
    above = np.empty(len(regions.sample))
    below = np.empty((n_pieces, len(regions.sample)))
    for begin in range(0, len(regions.sample), BLOCK_COLUMNS):
        block = slice(begin, begin + BLOCK_COLUMNS)
        local = _take(boxes, regions.sample[block])
        ahead, left = _region_in_footprint_frames(
            local, regions.x_m[:, block], regions.y_m[:, block]
        )
        above[block] = _corner_distance_m(local, ahead, left)
        below[:, block] = _box_gap_m(local, ahead, left, swept=swept)
    return above, below


def _take(boxes: Footprints, sample: NDArray[np.intp]) -> Footprints:
    return replace(
        boxes,
        x_m=boxes.x_m.take(sample, 1),
        y_m=boxes.y_m.take(sample, 1),
        cos=boxes.cos.take(sample, 1),
        sin=boxes.sin.take(sample, 1),
    )


def _region_in_footprint_frames(
    boxes: Footprints, x_m: FloatArray, y_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Region corners ahead and left of every footprint's centre, two (T + 1, 4, P) arrays."""
    cos, sin = boxes.cos[:, None], boxes.sin[:, None]
    ahead = x_m * cos
    ahead += y_m * sin
    ahead -= (boxes.x_m * boxes.cos + boxes.y_m * boxes.sin)[:, None]
    left = y_m * cos
    left -= x_m * sin
    left -= (boxes.y_m * boxes.cos - boxes.x_m * boxes.sin)[:, None]
    return ahead, left


def _corner_distance_m(boxes: Footprints, ahead: FloatArray, left: FloatArray) -> FloatArray:
    """Least distance of a region corner and a footprint, (P,): never below the clearance."""
    outside_x = np.maximum(np.abs(ahead) - boxes.half_length_m, 0.0)
    outside_y = np.maximum(np.abs(left) - boxes.half_width_m, 0.0)
    outside_x *= outside_x
    outside_y *= outside_y
    outside_x += outside_y
    least: FloatArray = np.sqrt(outside_x.min(axis=(0, 1)))
    return least


def _box_gap_m(
    boxes: Footprints, ahead: FloatArray, left: FloatArray, *, swept: bool
) -> FloatArray:
    """Gap of the boxes around tube piece and region piece, in the frame of the later footprint."""
    behind_m, ahead_m, right_m, left_m = _extent_in_own_frame(boxes, swept=swept)
    first = 1 if swept else 0
    x, y = ahead[first:], left[first:]
    gap_x = np.maximum(x.min(axis=1) - ahead_m, behind_m - x.max(axis=1))
    gap_y = np.maximum(y.min(axis=1) - left_m, right_m - y.max(axis=1))
    gap: FloatArray = np.hypot(np.maximum(gap_x, 0.0), np.maximum(gap_y, 0.0))
    return gap


def _extent_in_own_frame(boxes: Footprints, *, swept: bool) -> tuple[FloatArray, ...]:
    """Extent of every tube piece in the frame of its later footprint: four (pieces, P) arrays."""
    length, width = boxes.half_length_m, boxes.half_width_m
    if not swept:
        ones = np.ones_like(boxes.x_m)
        return -length * ones, length * ones, -width * ones, width * ones
    cos, sin = boxes.cos[1:], boxes.sin[1:]
    step_x, step_y = -np.diff(boxes.x_m, axis=0), -np.diff(boxes.y_m, axis=0)
    ahead, left = step_x * cos + step_y * sin, step_y * cos - step_x * sin
    turn_cos = np.abs(cos * boxes.cos[:-1] + sin * boxes.sin[:-1])
    turn_sin = np.abs(cos * boxes.sin[:-1] - sin * boxes.cos[:-1])
    reach_x = length * turn_cos + width * turn_sin
    reach_y = length * turn_sin + width * turn_cos
    return (
        np.minimum(ahead - reach_x, -length),
        np.maximum(ahead + reach_x, length),
        np.minimum(left - reach_y, -width),
        np.maximum(left + reach_y, width),
    )


def _least_by_sample(per_piece: FloatArray, regions: PreparedRegions) -> FloatArray:
    least = per_piece[: regions.n_samples].copy()
    further = slice(regions.n_samples, None)
    np.minimum.at(least, regions.sample[further], per_piece[further])
    return least


def _exact_m(
    boxes: Footprints,
    regions: PreparedRegions,
    piece: NDArray[np.intp],
    column: NDArray[np.intp],
    *,
    swept: bool,
) -> FloatArray:
    """Exact distance of chosen pairs (tube piece, region piece), (n,) metres."""
    distance = np.empty(len(piece))
    for begin in range(0, len(piece), BLOCK_COLUMNS):
        block = slice(begin, begin + BLOCK_COLUMNS)
        sample = regions.sample.take(column[block])
        earlier = _pick(boxes, piece[block], sample)
        later = _pick(boxes, piece[block] + 1, sample) if swept else earlier
        region_x, region_y = regions.x_m.take(column[block], 1), regions.y_m.take(column[block], 1)
        distance[block] = hull_distance_m(earlier, later, region_x, region_y)
    return distance


def _pick(boxes: Footprints, step: NDArray[np.intp], sample: NDArray[np.intp]) -> Footprints:
    flat = step * boxes.x_m.shape[1] + sample
    return replace(
        boxes,
        x_m=boxes.x_m.take(flat),
        y_m=boxes.y_m.take(flat),
        cos=boxes.cos.take(flat),
        sin=boxes.sin.take(flat),
    )
