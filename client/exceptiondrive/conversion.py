"""Bring a planner's own trajectories into the form and frame of a submission.

Read: JSON (a submission file, or a bare list of its predictions), JSON lines (one prediction a
line; a recorder's journal is such a file), or CSV, one waypoint a row, with the header
`sample_id,trajectory,step,x_m,y_m` and perhaps `heading_rad`; `trajectory` is `source` or
`edited`. A trajectory without rows is missing (null).

Convert: the steps run in one order, each only if asked for or needed, and each says what it did:
heading column away, swap of axes, sensor to rear axle, t = 0 away, horizon cut. Pure.
"""

import csv
import gzip
import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from exceptiondrive.checking import write_file
from exceptiondrive.errors import InvalidArgumentError

Waypoints = tuple[tuple[float, ...], ...]
FollowedPoint = Literal["sensor", "rear-axle"]

AT_ORIGIN_M = 0.05
"""A first point as near to the origin as this is the car at t = 0."""
SIDES = ("source", "edited")
CSV_COLUMNS = ("sample_id", "trajectory", "step", "x_m", "y_m")
SCHEMA = "exceptiondrive.planning/1"


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


def read_pairs(paths: Sequence[Path]) -> tuple[tuple[RawPair, ...], str | None]:
    """Read all files as one: shards of a run make one submission.

    Returns:
        The pairs in order, and the split that the files name, if any does.

    Raises:
        InvalidArgumentError: A file cannot be read, or a sample occurs twice.
    """
    pairs: dict[str, RawPair] = {}
    splits: set[str] = set()
    for path in paths:
        text = _text(path)
        for pair in _pairs_of(path, text, splits):
            if pair.sample_id in pairs:
                raise _fault(path, f"sample {pair.sample_id} occurs twice.")
            pairs[pair.sample_id] = pair
    if len(splits) > 1:
        raise InvalidArgumentError(
            "wrong_split", f"The files name different splits: {', '.join(sorted(splits))}."
        )
    return tuple(pairs.values()), splits.pop() if splits else None


def write_submission(path: Path, split: str, pairs: Iterable[RawPair]) -> int:
    """Write a submission file in one step, compressed if the name ends in `.gz`.

    Returns:
        Size in bytes.
    """
    predictions = [
        {"sample_id": pair.sample_id, "source": pair.source, "edited": pair.edited}
        for pair in pairs
    ]
    document = {"schema": SCHEMA, "split": split, "predictions": predictions}
    return write_file(path, json.dumps(document, separators=(",", ":"), allow_nan=False))


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
        return (gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data).decode("utf-8-sig")
    except (OSError, EOFError) as error:
        raise _fault(path, f"cannot be read: {error}.") from None
    except UnicodeDecodeError:
        raise _fault(path, "is not UTF-8 text.") from None


def _pairs_of(path: Path, text: str, splits: set[str]) -> Iterator[RawPair]:
    if text.lstrip()[:1] not in ("{", "["):
        yield from _pairs_of_csv(path, text)
        return
    for value in _predictions(path, text, splits):
        yield _pair_of_json(path, value)


def _predictions(path: Path, text: str, splits: set[str]) -> Iterator[Any]:
    """Yield the predictions of a JSON document, or of JSON lines."""
    try:
        document = json.loads(text)
        values = document if isinstance(document, list) else [document]
    except ValueError:
        values = _json_lines(path, text)
    for value in values:
        if isinstance(value, dict) and "schema" in value:
            if value["schema"] != SCHEMA:
                raise _fault(path, f"is {value['schema']!r}: only {SCHEMA!r} has trajectories.")
            if isinstance(value.get("split"), str):
                splits.add(value["split"])
            yield from value.get("predictions", ())
        else:
            yield value


def _json_lines(path: Path, text: str) -> list[Any]:
    values = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip():
            try:
                values.append(json.loads(line))
            except ValueError as error:
                raise _fault(path, f"line {number} is not JSON: {error}.") from None
    return values


def _pair_of_json(path: Path, value: Any) -> RawPair:
    if not isinstance(value, dict) or not isinstance(value.get("sample_id"), str):
        raise _fault(path, f"a prediction needs a sample_id, got {str(value)[:80]}.")
    sample_id = value["sample_id"]
    unknown = sorted(set(value) - {"sample_id", *SIDES})
    if unknown:
        raise _fault(path, f"{sample_id}: unknown key {', '.join(unknown)}.")
    source, edited = (_points(path, f"{sample_id}: {side}", value.get(side)) for side in SIDES)
    return RawPair(sample_id, source, edited)


def _points(path: Path, where: str, value: Any) -> Waypoints | None:
    if value is None:
        return None
    try:
        return tuple(tuple(_number(number) for number in point) for point in value)
    except (TypeError, ValueError):
        raise _fault(path, f"{where} must be a list of [x, y] in metres, or null.") from None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    return float(value)


def _pairs_of_csv(path: Path, text: str) -> Iterator[RawPair]:
    reader = csv.DictReader(io.StringIO(text))
    absent = sorted(set(CSV_COLUMNS) - set(reader.fieldnames or ()))
    if absent:
        raise _fault(
            path, f"has no column {', '.join(absent)}; the header must be {','.join(CSV_COLUMNS)}."
        )
    points: dict[str, dict[str, dict[int, tuple[float, ...]]]] = {}
    for row in reader:
        where = f"line {reader.line_num}"
        if row["trajectory"] not in SIDES:
            raise _fault(path, f"{where}: trajectory must be source or edited.")
        step, point = _row(path, where, row)
        of_side = points.setdefault(row["sample_id"], {}).setdefault(row["trajectory"], {})
        if step in of_side:
            raise _fault(path, f"{where}: step {step} occurs twice.")
        of_side[step] = point
    for sample_id, sides in points.items():
        source, edited = (_in_order(path, sample_id, side, sides.get(side)) for side in SIDES)
        yield RawPair(sample_id, source, edited)


def _row(path: Path, where: str, row: dict[str, str]) -> tuple[int, tuple[float, ...]]:
    heading = row.get("heading_rad")
    numbers = (row["x_m"], row["y_m"], *((heading,) if heading else ()))
    try:
        return int(row["step"]), tuple(float(number) for number in numbers)
    except (TypeError, ValueError):
        raise _fault(path, f"{where}: step must be a whole number, x_m and y_m numbers.") from None


def _in_order(
    path: Path, sample_id: str, side: str, by_step: dict[int, tuple[float, ...]] | None
) -> Waypoints | None:
    if by_step is None:
        return None
    steps = sorted(by_step)
    if steps != list(range(steps[0], steps[0] + len(steps))) or steps[0] not in (0, 1):
        raise _fault(path, f"{sample_id}: {side}: steps must run from 0 or 1 without a gap.")
    return tuple(by_step[step] for step in steps)


def _fault(path: Path, sentence: str) -> InvalidArgumentError:
    return InvalidArgumentError("unreadable_file", f"{path.name}: {sentence}")
