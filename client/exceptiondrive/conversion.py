"""Bring a planner's own trajectories into the form and frame of a submission.

The steps run in one order, each only if asked for or needed, and each says what it did: camera
frame, heading columns away, axes exchanged, other units to metres, turned, mirrored, time reversed,
increments added up, source and edited exchanged, sensor to rear axle, t = 0 away, time step,
horizon, and what is still invalid to null. Pure.
"""

import itertools
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check.source_fit import AT_ORIGIN_M, FROM_ORIGIN, MIN_COMPARED
from exceptiondrive_schemas.check.transformations import (
    UNITS_M,
    at_times,
    mirrored,
    rotated,
    scaled,
    summed,
    swapped,
    waypoints_needed,
)
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import GeometrySection

Waypoints = tuple[tuple[float, ...], ...]
FollowedPoint = Literal["sensor", "rear-axle"]

MAX_WIDTH = 8
"""Columns of a waypoint: x and y, and what is left out."""
MOVES_M = 2.0
"""What ends farther from the origin moves."""


@dataclass(frozen=True)
class RawPair:
    """One sample as a planner wrote it: rows of x and y, and perhaps of times and headings."""

    sample_id: str
    source: Waypoints | None
    edited: Waypoints | None


@dataclass(frozen=True)
class ConversionPlan:
    """What to do.

    Attributes:
        geometry: Waypoints, time step and bounds of the protocol.
        camera: The columns are x right, y down, z ahead.
        swap: Exchange x and y.
        unit: What the numbers are, one of `UNITS_M`; None: metres.
        rotate_deg: Turn counter-clockwise by 90, -90 or 180 degrees; -90 makes x forward / y left of
            x right / y forward.
        mirror: Turn y to the other side.
        reverse: Turn the order of the waypoints round.
        cumulative: Add up increments.
        exchange: Take source as edited, and edited as source.
        origin_offset_m: How far the origin of the given frame sits ahead of the rear axle.
        follows: Whether the given points are where that sensor goes, or where the rear axle goes.
        time_step_s: Time between two given waypoints; None: that of the protocol, as is.
        truncate: Cut longer horizons; only where the time step is said.
        null_invalid: Write null for a trajectory that is still invalid.
    """

    geometry: GeometrySection
    camera: bool = False
    swap: bool = False
    unit: str | None = None
    rotate_deg: int = 0
    mirror: bool = False
    reverse: bool = False
    cumulative: bool = False
    exchange: bool = False
    origin_offset_m: float = 0.0
    follows: FollowedPoint = "sensor"
    time_step_s: float | None = None
    truncate: bool = False
    null_invalid: bool = False

    @property
    def step_s(self) -> float:
        """Time between two given waypoints."""
        return self.geometry.time_step_s if self.time_step_s is None else self.time_step_s

    @property
    def n_needed(self) -> int:
        """How many given waypoints reach the protocol's horizon."""
        return waypoints_needed(self.geometry, self.step_s)


@dataclass(frozen=True)
class Conversion:
    """The converted pairs, a sentence for each thing that was done, and what became null."""

    pairs: tuple[RawPair, ...]
    done: tuple[str, ...]
    nulled: tuple[str, ...] = ()


@dataclass
class _Work:
    """Pairs on their way, and what was done to them."""

    plan: ConversionPlan
    pairs: tuple[RawPair, ...]
    done: list[str] = field(default_factory=list)
    nulled: list[str] = field(default_factory=list)

    def change(self, change: Callable[[Waypoints], Waypoints], sentence: str) -> None:
        """Change every trajectory, and say so."""
        self.pairs = tuple(
            replace(
                pair,
                source=None if pair.source is None else change(pair.source),
                edited=None if pair.edited is None else change(pair.edited),
            )
            for pair in self.pairs
        )
        self.done.append(sentence)

    def given(self) -> Iterator[tuple[str, Waypoints]]:
        """Yield every trajectory that is there, and where."""
        for pair in self.pairs:
            for side, points in (("source", pair.source), ("edited", pair.edited)):
                if points is not None:
                    yield f"{pair.sample_id}: {side}", points

    def refuse(self, fault_of: Callable[[Waypoints], str | None], code: str, advice: str) -> None:
        """Refuse trajectories with a fault, or write null in their place where that was asked for.

        Raises:
            InvalidArgumentError: There is one, and it is not to become null.
        """
        wrong = {where: fault for where, points in self.given() if (fault := fault_of(points))}
        if not wrong:
            return
        if not self.plan.null_invalid:
            where, fault = next(iter(wrong.items()))
            trajectories = counted(len(wrong), "trajectory is wrong", "trajectories are wrong")
            raise InvalidArgumentError(code, f"{trajectories}, the first: {where} {fault}.", advice)
        self.nulled += [f"{where} {fault}" for where, fault in wrong.items()]
        self.pairs = tuple(
            replace(
                pair,
                source=None if f"{pair.sample_id}: source" in wrong else pair.source,
                edited=None if f"{pair.sample_id}: edited" in wrong else pair.edited,
            )
            for pair in self.pairs
        )


def convert(pairs: tuple[RawPair, ...], plan: ConversionPlan) -> Conversion:
    """Carry out a plan.

    Raises:
        InvalidArgumentError: A trajectory is too short, too long, or not made of points.
    """
    work = _Work(plan, pairs)
    work.refuse(
        _shape_fault,
        "wrong_waypoint_shape",
        "Every waypoint begins with x and y, all of them finite numbers. Write null where the planner "
        "failed; --null-invalid does it for you.",
    )
    if plan.camera:
        _from_camera(work)
    _leave_out_columns(work)
    unit_m = UNITS_M[plan.unit] if plan.unit else 1.0
    for is_asked, change, sentence in (
        (plan.swap, swapped, "exchanged x and y: (x, y) -> (y, x)"),
        (
            plan.unit is not None,
            lambda points: scaled(points, unit_m),
            f"took {plan.unit} as metres: x {unit_m:.6g}",
        ),
        (
            plan.rotate_deg != 0,
            lambda points: rotated(points, plan.rotate_deg // 90),
            f"turned by {plan.rotate_deg} degrees: {_ROTATION_WORDS.get(plan.rotate_deg, '')}",
        ),
        (plan.mirror, mirrored, "mirrored: (x, y) -> (x, -y)"),
        (plan.reverse, lambda points: points[::-1], "reversed the order of the waypoints"),
        (plan.cumulative, summed, "added up increments to positions"),
    ):
        if is_asked:
            work.change(_as_waypoints(change), sentence)
    if plan.exchange:
        work.pairs = tuple(
            replace(pair, source=pair.edited, edited=pair.source) for pair in work.pairs
        )
        work.done.append("exchanged source and edited")
    if plan.origin_offset_m:
        _to_rear_axle(work)
    _fit_horizon(work, " beside t = 0" if _leave_out_start(work) else "")
    if plan.null_invalid:
        work.refuse(lambda points: _bounds_fault(points, plan.geometry), "", "")
    if work.nulled:
        n_nulled, n_samples = len(work.nulled), len(work.pairs)
        trajectories = counted(n_nulled, "trajectory", "trajectories")
        work.done.append(f"wrote null for {trajectories} of {counted(n_samples, 'sample')}")
    return Conversion(work.pairs, tuple(work.done), tuple(work.nulled))


_ROTATION_WORDS = {-90: "(x, y) -> (y, -x)", 90: "(x, y) -> (-y, x)", 180: "(x, y) -> (-x, -y)"}


def _as_waypoints(change: Callable[..., Iterable[tuple[float, ...]]]) -> Callable[..., Waypoints]:
    return lambda points: tuple(change(points))


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


def _shape_fault(points: Waypoints) -> str | None:
    widths = {len(point) for point in points}
    if len(widths) > 1 or not widths <= set(range(2, MAX_WIDTH + 1)):
        return f"has waypoints that are not all [x, y] with the same columns, at most {MAX_WIDTH}"
    if not all(math.isfinite(number) for point in points for number in point):
        return "holds a number that is not finite"
    return None


def _bounds_fault(points: Waypoints, geometry: GeometrySection) -> str | None:
    farthest_m = max(abs(number) for point in points for number in point)
    if farthest_m > geometry.max_coordinate_m:
        return f"has a coordinate of {farthest_m:.6g} m, out of bounds"
    longest_m = max(map(math.dist, [(0.0, 0.0), *points[:-1]], points))
    if longest_m > geometry.max_step_m:
        return f"has a step of {longest_m:.2f} m"
    return None


def _from_camera(work: _Work) -> None:
    work.refuse(
        lambda points: "has no third column" if points and len(points[0]) < 3 else None,
        "wrong_waypoint_shape",
        "Camera coordinates are x right, y down, z ahead; --rotate -90 turns x right / z ahead.",
    )
    wide = [points for _, points in work.given() if points and len(points[0]) > 3]
    n_times = 1 if wide and _begins_with_times(wide) else 0
    words = ", behind a column of times" if n_times else ""
    work.change(
        lambda points: tuple(
            (z, -x)
            for x, _, z, *_ in (point[n_times if len(point) > 3 else 0 :] for point in points)
        ),
        f"took camera coordinates{words}: (x right, y down, z ahead) -> (z, -x)",
    )


def _leave_out_columns(work: _Work) -> None:
    """Keep x and y: the first two columns, behind one of times or of headings where there is one."""
    wide = [points for _, points in work.given() if points and len(points[0]) > 2]
    if not wide:
        return
    x, y, words = 0, 1, "the first two columns as x and y"
    if _begins_with_times(wide):
        x, y, words = 1, 2, "x and y behind a column of times"
    elif _begins_with_headings(wide):
        x, y, words = 1, 2, "x and y behind a column of headings in radians"
    elif _is_level(wide):
        x, y, words = 0, 2, "the first and third columns as x and y, around a column of zeros"
    trajectories = counted(len(wide), "trajectory", "trajectories")
    work.change(
        lambda points: tuple((point[x], point[y]) if len(point) > 2 else point for point in points),
        f"kept {words}, of {trajectories}, and left out the rest",
    )


def _is_level(trajectories: Sequence[Waypoints]) -> bool:
    """Whether the second column is zero everywhere, as a height is, and the third is no heading."""
    second, third = (
        max(abs(point[column]) for points in trajectories for point in points) for column in (1, 2)
    )
    return second == 0.0 and third > math.tau


def _begins_with_headings(trajectories: Sequence[Waypoints]) -> bool:
    """Whether the first column stays within a turn and neither of the next two does: x and y."""
    first, *others = (
        max(abs(point[column]) for points in trajectories for point in points)
        for column in (0, 1, 2)
    )
    return first <= math.tau < min(others)


def _begins_with_times(trajectories: Sequence[Waypoints]) -> bool:
    """Whether the first column rises and is the same in trajectories that are not the same."""
    first, *others = [tuple(point[0] for point in points) for points in trajectories]
    rises = all(before < after for before, after in itertools.pairwise(first))
    return rises and all(other == first for other in others) and len(set(trajectories)) > 1


def _to_rear_axle(work: _Work) -> None:
    offset_m = work.plan.origin_offset_m
    if work.plan.follows == "rear-axle":
        work.change(
            lambda points: shift_origin(points, offset_m),
            f"moved the origin {offset_m:g} m back to the rear axle: x -> x + {offset_m:g}",
        )
    else:
        work.change(
            lambda points: sensor_to_rear_axle(points, offset_m),
            f"turned the path of a point {offset_m:g} m ahead of the rear axle into the path of the "
            "rear axle",
        )


def _leave_out_start(work: _Work) -> bool:
    """Leave out the point at t = 0, by the rule of `check`; of few trajectories where all can spare it."""
    given = [points for _, points in work.given()]
    sides = ((pair.source for pair in work.pairs), (pair.edited for pair in work.pairs))
    moving = [
        [_stands_first(points) for points in side if points and math.hypot(*points[-1]) > MOVES_M]
        for side in sides
    ]
    told = [begins for begins in moving if len(begins) >= MIN_COMPARED]
    has_start = any(sum(begins) >= FROM_ORIGIN * len(begins) for begins in told) or (
        bool(given)
        and not told
        and all(len(points) > work.plan.n_needed and _is_start(points) for points in given)
    )
    if has_start:
        work.refuse(
            lambda points: (
                f"begins {math.hypot(*points[0]):.2f} m from the origin, and nearly all others at t = 0"
                if points and not _is_start(points)
                else None
            ),
            "wrong_waypoint_count",
            "Let the planner write t = 0 for all of them, at (0, 0), or for none.",
        )
        work.change(
            lambda points: points[1:],
            f"left out the first point of {len(list(work.given()))} trajectories: within "
            f"{AT_ORIGIN_M} m of the origin, it is t = 0",
        )
    return has_start


def _is_start(points: Waypoints) -> bool:
    return math.hypot(*points[0]) <= AT_ORIGIN_M


def _stands_first(points: Waypoints) -> bool:
    """Whether the first point is no step of its own: from rest the second is four times as far, else twice."""
    return _is_start(points) and math.hypot(*points[0]) <= math.hypot(*points[1]) / 10


def _fit_horizon(work: _Work, beside: str) -> None:
    """Bring the time step to the protocol's, and cut what lies beyond its horizon."""
    plan, geometry = work.plan, work.plan.geometry
    work.refuse(
        lambda points: (
            f"has {len(points)} waypoints{beside}, fewer than {plan.n_needed}"
            if len(points) < plan.n_needed
            else None
        ),
        "wrong_waypoint_count",
        "Nothing is made up: let the planner give them, or write null.",
    )
    n_long = sum(len(points) > plan.n_needed for _, points in work.given())
    if n_long and not (plan.truncate and plan.time_step_s is not None):
        _, longest = max(work.given(), key=lambda found: len(found[1]))
        raise InvalidArgumentError(
            "wrong_waypoint_count",
            f"{counted(n_long, 'trajectory has', 'trajectories have')} more than {plan.n_needed} "
            f"waypoints, up to {len(longest)}.",
            ("" if plan.time_step_s else "Say how far apart they are, --time-step-s S. ")
            + f"Add --truncate to keep the first {geometry.horizon_s:g} s.",
        )
    if not math.isclose(plan.step_s, geometry.time_step_s):
        _resample(work)
    if n_long:
        n_kept = geometry.waypoints
        cut = counted(n_long, "trajectory", "trajectories")
        work.change(
            lambda points: points[:n_kept],
            f"cut {cut} to the first {n_kept} waypoints, {geometry.horizon_s:g} s",
        )


def _resample(work: _Work) -> None:
    step_s, wanted_s = work.plan.step_s, work.plan.geometry.time_step_s
    every = round(wanted_s / step_s)
    if every and math.isclose(every * step_s, wanted_s, rel_tol=1e-6):
        work.change(
            lambda points: points[every - 1 :: every],
            f"took one waypoint of {every}: {step_s:g} s to {wanted_s:g} s apart",
        )
        return
    times_s = [wanted_s * number for number in range(1, work.plan.geometry.waypoints + 1)]
    work.change(
        lambda points: tuple(at_times([(x, y) for x, y in points], step_s, times_s)),
        f"worked out waypoints {wanted_s:g} s apart on straight lines between those {step_s:g} s "
        "apart",
    )


def submission_text(split: str, pairs: Iterable[RawPair]) -> str:
    """Return a submission file."""
    predictions = [
        {"sample_id": pair.sample_id, "source": pair.source, "edited": pair.edited}
        for pair in pairs
    ]
    document = {"schema": PLANNING.file_schema, "split": split, "predictions": predictions}
    return json.dumps(document, separators=(",", ":"), allow_nan=False)
