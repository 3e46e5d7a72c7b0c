"""The collision tube as polygons, for drawing. Scoring never builds it (see `clearance`)."""

from itertools import pairwise

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.footprint import footprints_m

Corner = tuple[float, float]


def tube_pieces_m(points_m: FloatArray, geometry: GeometrySection) -> list[FloatArray]:
    """Convex pieces whose union is the collision tube of one trajectory.

    Args:
        points_m: (T + 1, 2) positions, the origin first.
        geometry: Footprint, heading rule, kind of tube.

    Returns:
        T hulls of consecutive footprints (or the T + 1 footprints), each (k, 2) corners in metres,
        counter-clockwise.
    """
    boxes = footprints_m(points_m[None], geometry)[0]
    if geometry.collision_tube == "footprints":
        return list(boxes)
    return [convex_hull(np.concatenate(pair)) for pair in pairwise(boxes)]


def convex_hull(points: FloatArray) -> FloatArray:
    """Corners of the convex hull, counter-clockwise: (n, 2) -> (k, 2) (monotone chain)."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    lower, upper = _chain(ordered), _chain(ordered[::-1])
    return np.array(lower[:-1] + upper[:-1])


def _chain(points: list[Corner]) -> list[Corner]:
    """The part of the hull that turns left from the first point to the last."""
    chain: list[Corner] = []
    for point in points:
        while len(chain) >= 2 and _turn(chain[-2], chain[-1], point) <= 1e-12:
            chain.pop()
        chain.append(point)
    return chain


def _turn(a: Corner, b: Corner, c: Corner) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
