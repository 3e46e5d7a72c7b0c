"""Clearance: Euclidean distance of collision tube and hazard region (docs/protocol.md section 2).

The tube is a union of convex pieces and the region of one or two, so the clearance is the least
distance over all pairs of pieces. Most pairs cannot be the nearest; two bounds, both cheap in the
frame of a footprint, show which can:

* from above: the distance of a region corner and a footprint (0 settles the sample);
* from below: the gap of two boxes, one around the tube piece, one around the region piece.

The promising pairs go to `convex_distance` in two rounds, the best one of each region piece first,
so that its result prunes the rest. Pruning never changes the result: a pair is left out only if
its lower bound is not below a distance that is attained.
"""

import math
from collections.abc import Iterator

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import BoolArray, FloatArray, IntArray
from exceptiondrive_scoring.convex_distance import gap_along_axes, hull_distance_m
from exceptiondrive_scoring.footprint import Footprints, footprints
from exceptiondrive_scoring.kinematics import positions, steps
from exceptiondrive_scoring.region import PreparedRegions

BLOCK_COLUMNS = 640
"""Columns treated at once: the temporaries of a block stay in the processor's cache."""
EXACT_COLUMNS = 2048
"""The same for exact distances, whose arrays have no time axis: they are smaller, so more fit."""


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
    at = positions(points_m)
    return clearance_of_footprints_m(footprints(at, steps(at), geometry), regions, geometry)


def touches_start(regions: PreparedRegions, geometry: GeometrySection) -> BoolArray:
    """Whether each of N regions meets the footprint at t = 0, where a standing car is; (N,)."""
    origin_m = np.zeros((regions.n_samples, 1, 2))
    touches: BoolArray = clearance_m(origin_m, regions, geometry) <= geometry.contact_tolerance_m
    return touches


def clearance_so_far_m(
    points_m: FloatArray, regions: PreparedRegions, geometry: GeometrySection
) -> FloatArray:
    """Clearance of the area swept until each time step: of the tube cut off at that step.

    The arguments are those of `clearance_m`.

    Returns:
        (N, T + 1) metres, non-increasing in time: the footprint's at step 0, `clearance_m` at T.
    """
    at = positions(points_m)
    boxes = footprints(at, steps(at), geometry)
    ends = range(1, len(boxes.x_m) + 1)
    columns = [clearance_of_footprints_m(boxes[:end], regions, geometry) for end in ends]
    return np.stack(columns, axis=-1)


def clearance_of_footprints_m(
    boxes: Footprints, regions: PreparedRegions, geometry: GeometrySection
) -> FloatArray:
    """Clearance of every sample from its footprints, (T + 1, N); (N,) metres."""
    swept = geometry.collision_tube == "hulls" and len(boxes.x_m) > 1
    above, column, below = _bounds_m(boxes, regions, swept=swept)
    nearest, sample = _least_by_sample(above, regions), regions.sample.take(column)

    def look(piece: IntArray, place: IntArray) -> None:
        distance = _exact_m(boxes, regions, piece, column.take(place), swept=swept)
        np.minimum.at(nearest, sample.take(place), distance)

    best, every = below.argmin(axis=0), np.arange(len(column))
    first = np.flatnonzero(below[best, every] < nearest.take(sample))
    look(best.take(first), first)
    below[best, every] = np.inf
    look(*np.divmod(np.flatnonzero(below < nearest.take(sample)), max(1, len(column))))
    return nearest


def _bounds_m(
    boxes: Footprints, regions: PreparedRegions, *, swept: bool
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Upper bound per region piece, (P,); the pieces that it does not settle, (Q,); lower bounds.

    Lower bounds are of each pair of a tube piece and an unsettled region piece, (pieces, Q).
    """
    above = np.empty(len(regions.sample))
    below = [np.empty((len(boxes.x_m) - swept, 0))]
    for block in _blocks(len(regions.sample), BLOCK_COLUMNS):
        local = boxes.of_samples(regions.sample[block])
        ahead, left = local.local(regions.x_m[:, block], regions.y_m[:, block])
        above[block] = np.sqrt(local.square_outside(ahead, left).min(axis=(0, 1)))
        apart = np.flatnonzero(above[block])
        places = (axis.take(apart, -1) for axis in (ahead, left))
        below.append(_box_gap_m(local.of_samples(apart), *places, swept=swept))
    return above, np.flatnonzero(above), np.concatenate(below, axis=1)


def _box_gap_m(
    boxes: Footprints, ahead: FloatArray, left: FloatArray, *, swept: bool
) -> FloatArray:
    """Gap of the boxes around tube piece and region piece, in the frame of the later footprint."""
    first = 1 if swept else 0
    extent = boxes.own_extent()
    if swept:
        later = boxes[1:]
        extent = later.extent_with(later.extent_of(boxes[:-1]))
    gap_x, gap_y = gap_along_axes(ahead[first:], left[first:], extent)
    np.maximum(gap_x, 0.0, out=gap_x)
    np.maximum(gap_y, 0.0, out=gap_y)
    gap: FloatArray = np.sqrt(gap_x * gap_x + gap_y * gap_y)
    return gap


def _least_by_sample(per_piece: FloatArray, regions: PreparedRegions) -> FloatArray:
    least = per_piece[: regions.n_samples].copy()
    further = slice(regions.n_samples, None)
    np.minimum.at(least, regions.sample[further], per_piece[further])
    return least


def _exact_m(
    boxes: Footprints,
    regions: PreparedRegions,
    piece: IntArray,
    column: IntArray,
    *,
    swept: bool,
) -> FloatArray:
    """Exact distance of chosen pairs (tube piece, region piece), (n,) metres."""
    distance = np.empty(len(piece))
    for block in _blocks(len(piece), EXACT_COLUMNS):
        step, sample = piece[block], regions.sample.take(column[block])
        earlier = boxes.at(step, sample)
        later = boxes.at(step + 1, sample) if swept else earlier
        region_x, region_y = regions.x_m.take(column[block], 1), regions.y_m.take(column[block], 1)
        distance[block] = hull_distance_m(earlier, later, region_x, region_y)
    return distance


def _blocks(n_columns: int, usual: int) -> Iterator[slice]:
    """Yield blocks of about the usual size: a short last block would take nearly as long."""
    width = math.ceil(n_columns / max(1, round(n_columns / usual)))
    yield from (slice(begin, begin + width) for begin in range(0, n_columns, width or 1))
