"""Bring a planner's own trajectories into the form and frame of a submission. Pure.

The steps run in one order, each only if asked for or needed, and each says what it did:
heading column away, swap of axes, sensor to rear axle, t = 0 away, horizon cut.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

from exceptiondrive.errors import InvalidArgumentError

Waypoints = tuple[tuple[float, ...], ...]
FollowedPoint = Literal["sensor", "rear-axle"]

AT_ORIGIN_M = 0.05
"""A first point as near to the origin as this is the car at t = 0."""


@dataclass(frozen=True)
class RawPair:
    """One sample as a planner wrote it: rows of x, y and perhaps a heading."""

    sample_id: str
    source: Waypoints | None
    edited: Waypoints | None

    @property
    def given(self) -> tuple[Waypoints, ...]:
        """The trajectories that are there."""
        return tuple(side for side in (self.source, self.edited) if side is not None)


@dataclass(frozen=True)
class ConversionPlan:
    """What to do.

    Attributes:
        waypoints: How many points the protocol takes.
        swap_axes: From x right / y forward to x forward / y left: (x, y) -> (y, -x).
        origin_offset_m: How far the origin of the given frame sits ahead of the rear axle.
        follows: Whether the given points are where that sensor goes, or where the rear axle goes.
        truncate: Cut longer horizons.
    """

    waypoints: int
    swap_axes: bool = False
    origin_offset_m: float = 0.0
    follows: FollowedPoint = "sensor"
    truncate: bool = False


@dataclass(frozen=True)
class Conversion:
    """The converted pairs, and a sentence for each thing that was done."""

    pairs: tuple[RawPair, ...]
    done: tuple[str, ...]


def convert(pairs: tuple[RawPair, ...], plan: ConversionPlan) -> Conversion:
    """Carry out a plan.

    Raises:
        InvalidArgumentError: A trajectory is too short, too long, or not made of points.
    """
    done: list[str] = []
    pairs = _without_headings(pairs, done)
    if plan.swap_axes:
        pairs = _each(pairs, swap_axes)
        done.append("swapped x right / y forward to x forward / y left: (x, y) -> (y, -x)")
    if plan.origin_offset_m:
        pairs = _to_rear_axle(pairs, plan, done)
    pairs = _without_start(pairs, plan.waypoints, done)
    return Conversion(_cut(pairs, plan, done), tuple(done))


def swap_axes(points: Waypoints) -> Waypoints:
    """Turn x right / y forward into x forward / y left."""
    return tuple((y, -x) for x, y in points)


def shift_origin(points: Waypoints, offset_m: float) -> Waypoints:
    """Move the origin back by `offset_m`: the same points, seen from the rear axle."""
    return tuple((x + offset_m, y) for x, y in points)


def sensor_to_rear_axle(points: Waypoints, offset_m: float) -> Waypoints:
    """Where the rear axle goes when a point `offset_m` ahead of it goes through `points`.

    The axle trails the sensor at a fixed distance and, wheels not slipping, moves along its own
    heading: at each step it lies behind the sensor on the line to where it was before. A standing
    car stays at (0, 0) and straight motion is unchanged, which a mere shift would both spoil.

    Args:
        points: (T, 2) sensor positions, metres, in the sensor's own frame at t = 0.
        offset_m: Distance of the sensor ahead of the rear axle.

    Returns:
        (T, 2) rear axle positions, metres, in the rear axle's frame at t = 0.
    """
    axle, heading = (0.0, 0.0), (1.0, 0.0)
    path = []
    for x, y in shift_origin(points, offset_m):
        ahead = (x - axle[0], y - axle[1])
        length = math.hypot(*ahead)
        if length > 1e-9:
            turned = (ahead[0] / length, ahead[1] / length)
            is_reversed = turned[0] * heading[0] + turned[1] * heading[1] < 0
            heading = (-turned[0], -turned[1]) if is_reversed else turned
        axle = (x - offset_m * heading[0], y - offset_m * heading[1])
        path.append(axle)
    return tuple(path)


def _each(
    pairs: tuple[RawPair, ...], change: Callable[[Waypoints], Waypoints]
) -> tuple[RawPair, ...]:
    return tuple(
        replace(
            pair,
            source=None if pair.source is None else change(pair.source),
            edited=None if pair.edited is None else change(pair.edited),
        )
        for pair in pairs
    )


def _trajectories(pairs: tuple[RawPair, ...]) -> Iterator[tuple[str, Waypoints]]:
    for pair in pairs:
        for side, points in (("source", pair.source), ("edited", pair.edited)):
            if points is not None:
                yield f"{pair.sample_id}: {side}", points


def _without_headings(pairs: tuple[RawPair, ...], done: list[str]) -> tuple[RawPair, ...]:
    n_with_heading = 0
    for where, points in _trajectories(pairs):
        widths = {len(point) for point in points}
        if not widths <= {2} and not widths <= {3}:
            raise InvalidArgumentError(
                "wrong_waypoint_shape",
                f"{where}: every waypoint must be [x, y] or [x, y, heading].",
            )
        if not all(math.isfinite(number) for point in points for number in point):
            raise InvalidArgumentError(
                "non_finite",
                f"{where} holds a number that is not finite.",
                "Write null where the planner failed.",
            )
        n_with_heading += widths == {3}
    if n_with_heading == 0:
        return pairs
    done.append(f"left out the heading (third column) of {n_with_heading} trajectories")
    return _each(pairs, lambda points: tuple(point[:2] for point in points))


def _to_rear_axle(
    pairs: tuple[RawPair, ...], plan: ConversionPlan, done: list[str]
) -> tuple[RawPair, ...]:
    offset_m = plan.origin_offset_m
    if plan.follows == "rear-axle":
        done.append(f"moved the origin {offset_m:g} m back to the rear axle: x -> x + {offset_m:g}")
        return _each(pairs, lambda points: shift_origin(points, offset_m))
    done.append(
        f"turned the path of a point {offset_m:g} m ahead of the rear axle into the path of the "
        "rear axle"
    )
    return _each(pairs, lambda points: sensor_to_rear_axle(points, offset_m))


def _without_start(
    pairs: tuple[RawPair, ...], waypoints: int, done: list[str]
) -> tuple[RawPair, ...]:
    """Leave out the point at t = 0 where every trajectory has it and a point to spare."""
    given = [points for _, points in _trajectories(pairs)]
    has_start = bool(given) and all(
        len(points) > waypoints and math.hypot(*points[0]) <= AT_ORIGIN_M for points in given
    )
    if not has_start:
        return pairs
    done.append(
        f"left out the first point of {len(given)} trajectories: within {AT_ORIGIN_M} m of the "
        "origin, it is t = 0"
    )
    return _each(pairs, lambda points: points[1:])


def _cut(pairs: tuple[RawPair, ...], plan: ConversionPlan, done: list[str]) -> tuple[RawPair, ...]:
    lengths = [(where, len(points)) for where, points in _trajectories(pairs)]
    short = [(where, length) for where, length in lengths if length < plan.waypoints]
    if short:
        raise InvalidArgumentError(
            "wrong_waypoint_count",
            f"{len(short)} trajectories have fewer than {plan.waypoints} waypoints, the first: "
            f"{short[0][0]} has {short[0][1]}.",
            "Nothing is made up: let the planner give them, or write null.",
        )
    long = [(where, length) for where, length in lengths if length > plan.waypoints]
    if not long:
        return pairs
    if not plan.truncate:
        raise InvalidArgumentError(
            "wrong_waypoint_count",
            f"{len(long)} trajectories have more than {plan.waypoints} waypoints, the first: "
            f"{long[0][0]} has {long[0][1]}.",
            f"Add --truncate to keep the first {plan.waypoints} (0.5 s apart).",
        )
    done.append(f"cut {len(long)} trajectories to their first {plan.waypoints} waypoints")
    return _each(pairs, lambda points: points[: plan.waypoints])
