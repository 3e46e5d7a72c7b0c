"""Exact distance between hull(A, B), A and B two footprints, and a convex region piece.

The hull is never built. Its edges are edges of A, edges of B and *links* from a corner of A to a
corner of B. All edges of A and B are examined instead of only those on the hull: points inside the
hull are never nearer than the hull.

* Two disjoint convex polygons are as far apart as the nearest pair (vertex of one, edge of other).
* They are disjoint exactly if the normal of some edge of one of them separates them. The hull's
  extent along a normal is the larger of A's and B's, and a rectangle's extent has a closed form.

Four things are examined, each for a separating gap and for a least distance: rectangle A and
rectangle B, in their own frames, where distance and extent are a few comparisons; the links; and
the edges of the region piece.

About two of the 16 links are edges of the hull. A corner of a rectangle is its outermost in one
quadrant of directions. Turn B by an angle in [0, 90] degrees against A: its quadrant j then meets
only A's quadrants j and j + 1, in arcs between an axis of one and an axis of the other. Within an
arc the outermost corner of each is fixed, and which of the two lies further out changes at most
once, as the arc is less than a half turn: their link is a hull edge exactly if it changes.

Arrays are `(feature, column)`; a column is one pair of a tube piece and a region piece.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_scoring.aliases import BoolArray, FloatArray
from exceptiondrive_scoring.footprint import Extent, Footprints

T = TypeVar("T", bound=np.generic)
SHORTEST_EDGE_M = 1e-15
EQUALLY_FAR_M = 1e-13
"""If the reach of two rectangles differs by less than this, the first counts as the outermost."""
NEXT = np.array([1, 2, 3, 0])
"""Index of the next corner or axis, counter-clockwise."""
LINK_START = np.array([0, 1, 2, 3, 1, 2, 3, 0])
LINK_END = np.array([4, 5, 6, 7, 4, 5, 6, 7])
"""Corners 0..3 of A and 4..7 of B: links j-j and (j + 1)-j."""


class _Points(NamedTuple):
    x: FloatArray
    y: FloatArray


class _Edges(NamedTuple):
    """Segments: start, unit direction and length, each (edge, column)."""

    start: _Points
    along: _Points
    length: FloatArray


class _Sides(NamedTuple):
    """Edges, and points that may lie left of them."""

    edges: _Edges
    left: FloatArray
    """(edge, point, column)"""
    points: _Points


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
    b_from_a, a_from_b = a.extent_of(b), b.extent_of(a)
    corners, is_edge = _hull(a, b, b_from_a, a_from_b)
    in_frames = [box.local(region.x, region.y) for box in (a, b)]
    column, links = _links(corners, is_edge, region)
    sides = _region_edges(region, corners)
    gaps = (
        *gap_along_axes(*in_frames[0], a.extent_with(b_from_a)),
        *gap_along_axes(*in_frames[1], b.extent_with(a_from_b)),
        _gap_of_region_edges(sides),
    )
    gap = np.maximum.reduce(gaps)
    np.maximum.at(gap, column, _gap_of_links(links, a[column], b[column]))
    apart = np.flatnonzero(gap > 0)  # only these need a distance
    squares = (
        *(
            box.square_outside(*_take_columns(place, apart)).min(axis=0)
            for box, place in zip((a, b), in_frames, strict=True)
        ),
        _square_distances(sides, apart),
    )
    square = np.zeros(len(gap))
    square[apart] = np.minimum.reduce(squares)
    far = np.flatnonzero(gap.take(column) > 0)
    np.minimum.at(square, column.take(far), _square_distances(links, far))
    distance: FloatArray = np.sqrt(square)
    return distance


def _take_columns(columns: Iterable[FloatArray], which: NDArray[np.intp]) -> Iterator[FloatArray]:
    return (each.take(which, -1) for each in columns)


def gap_along_axes(
    ahead: FloatArray, left: FloatArray, extent: Extent
) -> tuple[FloatArray, FloatArray]:
    """Gaps, ahead and left, between points (..., 4, n) and an extent; negative where they meet."""
    return (
        np.maximum(ahead.min(axis=-2) - extent.high_x, extent.low_x - ahead.max(axis=-2)),
        np.maximum(left.min(axis=-2) - extent.high_y, extent.low_y - left.max(axis=-2)),
    )


def _links(
    corners: _Points, is_edge: BoolArray, region: _Points
) -> tuple[NDArray[np.intp], _Sides]:
    """Links that are edges of a hull, (1, m), and the column of each, ascending."""
    column, link = np.nonzero(is_edge.T)
    start, end = (corner.take(link) * len(is_edge.T) + column for corner in (LINK_START, LINK_END))
    ends = (_Points(*(axis.take(at)[None] for axis in corners)) for at in (start, end))
    links, region = _edges(*ends), _Points(*_take_columns(region, column))
    return column, _Sides(links, _left_of(links.along, region), region)


def _gap_of_links(links: _Sides, a: Footprints, b: Footprints) -> FloatArray:
    low, high = _extent_left_of(links.edges.along, a, b)
    gap: FloatArray = np.maximum(links.left.min(axis=1) - high, low - links.left.max(axis=1))[0]
    return gap


def _region_edges(region: _Points, hull: _Points) -> _Sides:
    edges = _edges(region, _Points(*(axis.take(NEXT, 0) for axis in region)))
    return _Sides(edges, _left_of(edges.along, hull), hull)


def _gap_of_region_edges(sides: _Sides) -> FloatArray:
    right_of_region = _left_of_start(sides.edges) - sides.left.max(axis=1)
    is_point = sides.edges.length < SHORTEST_EDGE_M
    gap: FloatArray = np.where(is_point, -np.inf, right_of_region).max(axis=0)
    return gap


def _hull(
    a: Footprints, b: Footprints, b_from_a: Extent, a_from_b: Extent
) -> tuple[_Points, BoolArray]:
    """Corners of two footprints, (8, column); which links are edges of their hull, (link, column).

    The corners of the first come first, then those of the second, which is rotated left against it
    by 0 to 90 degrees.
    """
    pairing = _Pairing(a.cos * b.sin < a.sin * b.cos, a.cos * b.cos + a.sin * b.sin < 0)
    (ax, ay), (bx, by) = a.corners_m(), b.corners_m()
    corners = _Points(np.concatenate(pairing.of(ax, bx)), np.concatenate(pairing.of(ay, by)))
    a_is_outermost, still = pairing.of(
        _beyond_m(b_from_a, a) <= EQUALLY_FAR_M, _beyond_m(a_from_b, b) >= -EQUALLY_FAR_M
    )
    then = a_is_outermost.take(NEXT, 0)
    return corners, np.concatenate([still != then, then != still.take(NEXT, 0)])


class _Pairing(NamedTuple):
    """Which of A and B is the first, and by how many corners the second is rotated: both (n,)."""

    b_is_right_of_a: BoolArray
    is_obtuse: BoolArray

    def of(self, of_a: NDArray[T], of_b: NDArray[T]) -> tuple[NDArray[T], NDArray[T]]:
        """Reorder values of the corners or axes of A and of B, (4, n) each, accordingly."""
        one = np.where(self.b_is_right_of_a, of_b, of_a)
        other = np.where(self.b_is_right_of_a, of_a, of_b)
        if self.is_obtuse.any():
            other = np.where(self.is_obtuse, np.roll(other, 1, axis=0), other)
        return one, other


def _beyond_m(extent: Extent, box: Footprints) -> FloatArray:
    """Return how far an extent reaches beyond a footprint along each of its axes; (4, n)."""
    length, width = box.half_length_m, box.half_width_m
    low_x, high_x, low_y, high_y = extent
    return np.array([high_x - length, high_y - width, -low_x - length, -low_y - width])


def _edges(start: _Points, end: _Points) -> _Edges:
    """Build edges; one of length zero gets the direction +x, so its distance is that of a point."""
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


def _square_distances(sides: _Sides, which: NDArray[np.intp]) -> FloatArray:
    """Return the least square distance between any point and any edge, for some columns.

    The part across the edge is the distance from its line; the part along it is what lies beyond
    half the length from its middle. Nothing is masked.
    """
    start, along = (_Points(*_take_columns(each, which)) for each in sides.edges[:2])
    points, half = (
        _Points(*_take_columns(sides.points, which)),
        sides.edges.length.take(which, -1) / 2,
    )
    middle = along.x * start.x + along.y * start.y + half
    across = sides.left.take(which, -1)
    across -= (along.x * start.y - along.y * start.x)[:, None]
    beyond = along.x[:, None] * points.x
    beyond += along.y[:, None] * points.y
    beyond -= middle[:, None]
    np.abs(beyond, out=beyond)
    beyond -= half[:, None]
    np.maximum(beyond, 0.0, out=beyond)
    beyond *= beyond
    across *= across
    beyond += across
    least: FloatArray = beyond.min(axis=(0, 1))
    return least
