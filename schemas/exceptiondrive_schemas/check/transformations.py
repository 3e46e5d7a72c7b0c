"""Mistakes of trajectory files, as transformations that mend them: axes, units, times, order.

`exceptiondrive convert` applies them; `source_fit` tries them. Pure Python, for client and server alike.
"""

from __future__ import annotations  # array[float] is not subscriptable at runtime before 3.12

import math
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

from exceptiondrive_schemas.protocol import GeometrySection

Point = tuple[float, float]
Points = Sequence[Point]

SAME_TIME_S = 1e-6


@dataclass(eq=False)  # not frozen: that takes five times as long to create, once per sample
class Compared:
    """One sample: the recorded drive and the file's answer, flat (x1, y1, x2, y2, ...)."""

    recorded: Points
    flat_source: array[float]
    flat_edited: array[float] | None

    @cached_property
    def source(self) -> Points:
        """The waypoints of the source trajectory."""
        return _points(self.flat_source)

    @property
    def edited(self) -> Points | None:
        """The waypoints of the edited trajectory, if there is one."""
        return None if self.flat_edited is None else _points(self.flat_edited)


@dataclass(frozen=True)
class Transformation:
    """A simple mistake and its mend.

    Attributes:
        looks_like: Description of the file, to follow "looks like".
        option: The option of `exceptiondrive convert` that mends it; None if none can.
        apply: Returns mended points and the recorded ones at the same times.
        by_hand: What the planner's author must do if no conversion can.
    """

    looks_like: str
    option: str | None
    apply: Callable[[Compared], tuple[Points, Points] | None]
    by_hand: str | None = None


def _points(flat: Sequence[float]) -> Points:
    return list(zip(flat[::2], flat[1::2], strict=True))


def rotated(points: Points, quarter_turns: int) -> list[Point]:
    """Turn points counter-clockwise by quarter turns about the origin."""
    turns: tuple[Callable[[Point], Point], ...] = (
        lambda point: point,
        lambda point: (-point[1], point[0]),
        lambda point: (-point[0], -point[1]),
        lambda point: (point[1], -point[0]),
    )
    return list(map(turns[quarter_turns % 4], points))


def swapped(points: Points) -> list[Point]:
    """Exchange x and y."""
    return [(y, x) for x, y in points]


def mirrored(points: Points) -> list[Point]:
    """Negate y."""
    return [(x, -y) for x, y in points]


def scaled(points: Points, factor: float) -> list[Point]:
    """Multiply every coordinate."""
    return [(x * factor, y * factor) for x, y in points]


def summed(points: Points) -> list[Point]:
    """Add up increments to positions."""
    total_x = total_y = 0.0
    positions = []
    for x, y in points:
        total_x, total_y = total_x + x, total_y + y
        positions.append((total_x, total_y))
    return positions


def at_times(points: Points, time_step_s: float, times_s: Sequence[float]) -> list[Point]:
    """Return the positions at given times, on straight lines between the waypoints.

    Args:
        points: Waypoints at one, two, ... time steps; (0, 0) is prepended.
        time_step_s: Time between two of them.
        times_s: Times from 0 to the last waypoint's.
    """
    whole = [(0.0, 0.0), *points]
    found = []
    for time_s in times_s:
        index = min(int(time_s / time_step_s + 1e-9), len(points) - 1)
        share = time_s / time_step_s - index
        (x0, y0), (x1, y1) = whole[index], whole[index + 1]
        found.append((x0 + share * (x1 - x0), y0 + share * (y1 - y0)))
    return found


def of_source(
    looks_like: str,
    option: str | None,
    change: Callable[[Points], Points],
    by_hand: str | None = None,
) -> Transformation:
    """Return a transformation of each source trajectory alone, at its own times."""
    return Transformation(
        looks_like, option, lambda sample: (change(sample.source), sample.recorded), by_hand
    )


def _exchange_sides(sample: Compared) -> tuple[Points, Points] | None:
    return None if sample.edited is None else (sample.edited, sample.recorded)


def _with_step(given_s: float, wanted_s: float, sample: Compared) -> tuple[Points, Points]:
    """Treat the source as waypoints `given_s` apart, and compare up to where both reach."""
    step_s = min(given_s, wanted_s)
    reach_s = min(given_s * len(sample.source), wanted_s * len(sample.recorded))
    times_s = [step_s * step for step in range(1, round(reach_s / step_s) + 1)]
    return (
        at_times(sample.source, given_s, times_s),
        at_times(sample.recorded, wanted_s, times_s),
    )


UNITS_M: Mapping[str, float] = {
    "millimetres": 0.001,
    "centimetres": 0.01,
    "feet": 0.3048,
}
"""Units of trajectories other than metres, each in metres."""
SPATIAL: tuple[Transformation, ...] = (
    of_source("mirrored (y to the right)", "--mirror", mirrored),
    of_source("x and y exchanged (x left, y forward)", "--swap", swapped),
    of_source("x right / y forward", "--rotate -90", partial(rotated, quarter_turns=-1)),
    of_source("x left / y backward", "--rotate 90", partial(rotated, quarter_turns=1)),
    of_source("x backward / y right", "--rotate 180", partial(rotated, quarter_turns=2)),
    *(
        of_source(unit, f"--unit {unit}", partial(scaled, factor=metres))
        for unit, metres in UNITS_M.items()
    ),
    of_source("increments instead of positions", "--cumulative", summed),
    of_source("reversed in time", "--reverse", lambda points: points[::-1]),
)
"""Other frames, units or meanings of the numbers."""
TIME_FACTORS = (0.1, 0.2, 0.4, 0.5, 1.0, 2.0, 5.0)
MIRROR = SPATIAL[0]
EXCHANGE = Transformation("source and edited exchanged", "--exchange", _exchange_sides)
"""If edits are slight, a right file fits when exchanged, too, but much better unchanged."""


def of_time(geometry: GeometrySection, n_given: int) -> Iterator[Transformation]:
    """Yield other time steps of the waypoints; with too few for the horizon there is no mend."""
    for factor in TIME_FACTORS:
        given_s = factor * geometry.time_step_s
        n_needed = waypoints_needed(geometry, given_s)
        cut = " --truncate" if n_given > n_needed else ""
        count = "" if n_given == geometry.waypoints else f"{n_given} "
        looks_like = [f"{count}waypoints {given_s:g} s apart"]
        if n_given < n_needed:
            end_s = given_s * n_given
            looks_like.append(
                f"(the last at {end_s:g} s, where {geometry.horizon_s:g} s are wanted)"
            )
        if n_given == geometry.waypoints:
            looks_like.append(f"or like a planner at {factor:g} times the recorded speed")
        yield Transformation(
            " ".join(looks_like),
            None if n_given < n_needed else f"--time-step-s {given_s:g}{cut}",
            partial(_with_step, given_s, geometry.time_step_s),
            f"let the planner plan {geometry.horizon_s:g} s ahead" if n_given < n_needed else None,
        )


def waypoints_needed(geometry: GeometrySection, time_step_s: float) -> int:
    """Return the number of waypoints with this time step that reach the protocol's horizon."""
    return math.ceil((geometry.horizon_s - SAME_TIME_S) / time_step_s)
