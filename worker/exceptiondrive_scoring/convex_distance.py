"""Exact distance between hull(A, B), A and B two footprints, and a convex region piece.

The hull is never built. Each edge of hull(A, B) is covered by edges of A, edges of B and *links*
from a corner of A to a corner of B, and all of these lie inside the hull. So looking at all of them
in place of the true boundary is exact: what lies inside the hull is never nearer than the hull.

* Two disjoint convex polygons are as far apart as the nearest pair (vertex of one, edge of other).
* They are disjoint exactly if the normal of some edge of one of them separates them. The hull's
  extent along a normal is the larger of A's and B's, and a rectangle's extent has a closed form.

Four things are looked at, each for a separating gap and for a least distance: rectangle A and
rectangle B, in their own frames, where distance and extent are a few comparisons; the links; and
the edges of the region piece.

Of the 16 links 8 suffice. A link is an edge of the hull only if both its corners are outermost in
one direction, and a rectangle's corner is outermost in one quadrant of directions. Turn B by an
angle in [0, 90] degrees against A: its quadrant j then meets only A's quadrants j and j + 1.

Arrays are `(feature, column)`; a column is one pair of a tube piece and a region piece.
"""

from typing import NamedTuple

import numpy as np

from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.footprint import Extent, Footprints

SHORTEST_EDGE_M = 1e-15
LINK_START = np.array([0, 1, 2, 3, 1, 2, 3, 0])
LINK_END = np.array([4, 5, 6, 7, 4, 5, 6, 7])
"""Corners 0..3 of A and 4..7 of B: links j-j and (j + 1)-j."""
NEXT_CORNER = np.array([1, 2, 3, 0])


class _Points(NamedTuple):
    x: FloatArray
    y: FloatArray


class _Edges(NamedTuple):
    """Segments: start, unit direction and length, each (edge, column)."""

    start: _Points
    along: _Points
    length: FloatArray


class _Seen(NamedTuple):
    """Widest separating gap, not positive if none, and least square distance; each (column,)."""

    gap: FloatArray
    square: FloatArray


def hull_distance_m(
    a: Footprints, b: Footprints, region_x_m: FloatArray, region_y_m: FloatArray
) -> FloatArray:
    """Euclidean distance of hull(A, B) and a convex piece; 0 where they share a point.

    Args:
        a: Footprints, arrays of shape (n,).
        b: Footprints of the same size, arrays of shape (n,).
        region_x_m: (4, n) corners of the piece, counter-clockwise; corners may repeat.
        region_y_m: (4, n).

    Returns:
        (n,) metres.
    """
    region = _Points(region_x_m, region_y_m)
    hull = _corners_paired_by_quadrant(a, b)
    of_a = _rectangle_against_region(a, b, region)
    of_b = _rectangle_against_region(b, a, region)
    of_links = _links_against_region(a, b, hull, region)
    of_region = _region_edges_against_hull(region, hull)
    gaps, squares = zip(of_a, of_b, of_links, of_region, strict=True)
    distance = np.sqrt(np.minimum.reduce(squares))
    return np.where(np.maximum.reduce(gaps) > 0, distance, 0.0)


def gap_along_axes(
    ahead: FloatArray, left: FloatArray, extent: Extent
) -> tuple[FloatArray, FloatArray]:
    """Gaps, ahead and left, between points (..., 4, n) and an extent; negative where they meet."""
    return (
        np.maximum(ahead.min(axis=-2) - extent.high_x, extent.low_x - ahead.max(axis=-2)),
        np.maximum(left.min(axis=-2) - extent.high_y, extent.low_y - left.max(axis=-2)),
    )


def _rectangle_against_region(box: Footprints, other: Footprints, region: _Points) -> _Seen:
    ahead, left = box.local(region.x, region.y)
    gap = np.maximum(*gap_along_axes(ahead, left, box.extent_with(other)))
    return _Seen(gap, box.square_outside(ahead, left).min(axis=0))


def _links_against_region(a: Footprints, b: Footprints, hull: _Points, region: _Points) -> _Seen:
    start = _Points(hull.x.take(LINK_START, 0), hull.y.take(LINK_START, 0))
    end = _Points(hull.x.take(LINK_END, 0), hull.y.take(LINK_END, 0))
    links = _edges(start, end)
    left = _left_of(links.along, region)
    low, high = _extent_left_of(links.along, a, b)
    gap = np.maximum(left.min(axis=1) - high, low - left.max(axis=1)).max(axis=0)
    return _Seen(gap, _square_distances(links, left, region).min(axis=(0, 1)))


def _region_edges_against_hull(region: _Points, hull: _Points) -> _Seen:
    edges = _edges(region, _Points(*(axis.take(NEXT_CORNER, 0) for axis in region)))
    left = _left_of(edges.along, hull)
    right_of_region = _left_of_start(edges) - left.max(axis=1)
    gap = np.where(edges.length < SHORTEST_EDGE_M, -np.inf, right_of_region).max(axis=0)
    return _Seen(gap, _square_distances(edges, left, hull).min(axis=(0, 1)))


def _corners_paired_by_quadrant(a: Footprints, b: Footprints) -> _Points:
    """Corners of the one and of the other, (8, n), the other turned left by 0 to 90 degrees."""
    (ax, ay), (bx, by) = a.corners_m(), b.corners_m()
    b_is_right_of_a = a.cos * b.sin < a.sin * b.cos
    one = _Points(np.where(b_is_right_of_a, bx, ax), np.where(b_is_right_of_a, by, ay))
    other = _Points(np.where(b_is_right_of_a, ax, bx), np.where(b_is_right_of_a, ay, by))
    obtuse = a.cos * b.cos + a.sin * b.sin < 0
    if obtuse.any():
        other = _Points(*(np.where(obtuse, np.roll(c, 1, axis=0), c) for c in other))
    return _Points(np.concatenate([one.x, other.x]), np.concatenate([one.y, other.y]))


def _edges(start: _Points, end: _Points) -> _Edges:
    """An edge of no length gets the direction +x: its distance is then that of a point."""
    x, y = end.x - start.x, end.y - start.y
    length = np.sqrt(x * x + y * y)
    is_point = length < SHORTEST_EDGE_M
    inverse = 1 / np.where(is_point, 1.0, length)
    return _Edges(start, _Points(np.where(is_point, 1.0, x * inverse), y * inverse), length)


def _left_of(along: _Points, points: _Points) -> FloatArray:
    """Coordinate of every point along every edge's left normal, (edge, point, column)."""
    left: FloatArray = along.x[:, None] * points.y
    left -= along.y[:, None] * points.x
    return left


def _left_of_start(edges: _Edges) -> FloatArray:
    left: FloatArray = edges.along.x * edges.start.y - edges.along.y * edges.start.x
    return left


def _extent_left_of(along: _Points, a: Footprints, b: Footprints) -> tuple[FloatArray, FloatArray]:
    """Extent of hull(A, B) along every edge's left normal: two (edge, column) arrays."""
    (a_low, a_high), (b_low, b_high) = (_rectangle_extent(along, box) for box in (a, b))
    return np.minimum(a_low, b_low), np.maximum(a_high, b_high)


def _rectangle_extent(along: _Points, box: Footprints) -> tuple[FloatArray, FloatArray]:
    centre = along.x * box.y_m - along.y * box.x_m
    ahead = np.abs(along.x * box.sin - along.y * box.cos)
    aside = np.abs(along.x * box.cos + along.y * box.sin)
    radius = box.half_length_m * ahead + box.half_width_m * aside
    return centre - radius, centre + radius


def _square_distances(edges: _Edges, left: FloatArray, points: _Points) -> FloatArray:
    """Square distance of every point and every edge, (edge, point, column).

    Across the edge the distance is that of the line; along it, what lies beyond half the length
    from the middle. Nothing is masked.
    """
    half = edges.length / 2
    middle = edges.along.x * edges.start.x + edges.along.y * edges.start.y + half
    across = left - _left_of_start(edges)[:, None]
    beyond = edges.along.x[:, None] * points.x
    beyond += edges.along.y[:, None] * points.y
    beyond -= middle[:, None]
    np.abs(beyond, out=beyond)
    beyond -= half[:, None]
    np.maximum(beyond, 0.0, out=beyond)
    beyond *= beyond
    across *= across
    beyond += across
    return beyond
