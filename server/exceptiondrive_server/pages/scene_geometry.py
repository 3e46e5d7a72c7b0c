"""A few lines of plane geometry for drawings. Scores never come from here.

Positions are (x forward, y left) in metres, as in the protocol's frame.
"""

import itertools
import math
from collections.abc import Sequence

Position = tuple[float, float]
Outline = tuple[Position, ...]


def headings_rad(
    trajectory: Sequence[Position], hold_m: float, reverse_above_deg: float
) -> tuple[float, ...]:
    """Return the heading at each waypoint (PROTOCOL.md 2): 0 at the start, held on short steps."""
    headings = [0.0]
    for before, here in itertools.pairwise(trajectory):
        step = (here[0] - before[0], here[1] - before[1])
        if math.hypot(*step) <= hold_m:
            headings.append(headings[-1])
            continue
        heading = math.atan2(step[1], step[0])
        turn = abs(math.remainder(heading - headings[-1], math.tau))
        if math.degrees(turn) > reverse_above_deg:
            heading = math.remainder(heading + math.pi, math.tau)
        headings.append(heading)
    return tuple(headings)


def footprint(
    position: Position, heading_rad: float, length_m: float, width_m: float, ahead_m: float
) -> Outline:
    """Return the four corners of the vehicle rectangle at one time step."""
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    corners = []
    for along, across in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        x, y = ahead_m + along * length_m / 2, across * width_m / 2
        corners.append((position[0] + x * cos - y * sin, position[1] + x * sin + y * cos))
    return tuple(corners)


def convex_hull(positions: Sequence[Position]) -> Outline:
    """Return the corners of the convex hull, counter-clockwise (monotone chain)."""
    ordered = sorted(set(positions))
    if len(ordered) < 3:
        return tuple(ordered)
    lower, upper = _half_hull(ordered), _half_hull(ordered[::-1])
    return tuple(lower[:-1] + upper[:-1])


def _half_hull(ordered: Sequence[Position]) -> list[Position]:
    chain: list[Position] = []
    for position in ordered:
        while len(chain) >= 2 and _turn(chain[-2], chain[-1], position) <= 0:
            chain.pop()
        chain.append(position)
    return chain


def _turn(a: Position, b: Position, c: Position) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def nearest_positions(first: Outline, second: Outline) -> tuple[Position, Position]:
    """Return the closest pair of positions on the edges of two outlines that do not meet."""
    best = (math.inf, first[0], second[0])
    for corners, edges, is_swapped in ((first, second, False), (second, first, True)):
        for corner in corners:
            for a, b in zip(edges, edges[1:] + edges[:1], strict=True):
                foot = _foot(corner, a, b)
                distance = math.dist(corner, foot)
                if distance < best[0]:
                    pair = (foot, corner) if is_swapped else (corner, foot)
                    best = (distance, *pair)
    return best[1], best[2]


def _foot(p: Position, a: Position, b: Position) -> Position:
    """Return the position on segment a-b that is nearest to p."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    share = 0.0 if length == 0 else ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length
    share = min(max(share, 0.0), 1.0)
    return (a[0] + share * dx, a[1] + share * dy)
