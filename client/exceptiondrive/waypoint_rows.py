"""Read trajectories from a table with one waypoint a row: CSV, Parquet, a data frame."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

from exceptiondrive.conversion import RawPair, Waypoints
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.check.checker import CSV_COLUMNS
from exceptiondrive_schemas.check.trajectory_forms import number_in

SIDES = ("source", "edited")


def fault(path: Path, sentence: str) -> InvalidArgumentError:
    """Return the error of a file that cannot be read."""
    return InvalidArgumentError("unreadable_file", f"{path.name}: {sentence}")


def with_unique_keys(path: Path) -> Callable[[list[tuple[str, Any]]], dict[str, Any]]:
    """Return what makes the objects of a JSON file, and refuses a key that stands in one twice.

    Python keeps the last of them and says nothing: a sample would be lost.
    """

    def made(members: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(members)
        if len(found) < len(members):
            ((key, _),) = Counter(key for key, _ in members).most_common(1)
            raise fault(path, f"{key} occurs twice in one object.")
        return found

    return made


def unless_missing(points: Waypoints) -> Waypoints | None:
    """Return None for a trajectory of NaN alone."""
    is_missing = bool(points) and all(math.isnan(number) for point in points for number in point)
    return None if is_missing else points


def require_columns(path: Path, names: Collection[str], other_form: str = "") -> None:
    """Refuse a table of waypoints that lacks a column; say in which other form it could be.

    Raises:
        InvalidArgumentError: It lacks one.
    """
    absent = sorted(set(CSV_COLUMNS) - set(names))
    if absent:
        raise fault(
            path,
            f"has no column {', '.join(absent)}; there must be {','.join(CSV_COLUMNS)}{other_form}.",
        )


def pairs_of_rows(path: Path, rows: Iterable[tuple[str, dict[str, Any]]]) -> Iterator[RawPair]:
    """Gather waypoints, one a row, in any order; each row with where it stands.

    Raises:
        InvalidArgumentError: A row is wrong or there twice, or a step is missing.
    """
    points: dict[str, dict[str, dict[int, tuple[float, ...]]]] = {}
    for where, row in rows:
        if row.get("trajectory") not in SIDES:
            raise fault(path, f"{where}: trajectory must be source or edited.")
        step, point = _step_and_numbers(path, where, row)
        if not isinstance(row.get("sample_id"), str | int):
            raise fault(path, f"{where}: sample_id must be a text.")
        of_side = points.setdefault(str(row["sample_id"]), {}).setdefault(row["trajectory"], {})
        if step in of_side:
            raise fault(path, f"{where}: step {step} occurs twice.")
        of_side[step] = point
    for sample_id, sides in points.items():
        source, edited = (_in_order(path, sample_id, side, sides.get(side)) for side in SIDES)
        yield RawPair(sample_id, source, edited)


def _step_and_numbers(path: Path, where: str, row: dict[str, Any]) -> tuple[int, tuple[float, ...]]:
    heading = row.get("heading_rad")
    try:
        numbers = (row["x_m"], row["y_m"], *(() if heading in (None, "") else (heading,)))
        step = int(row["step"])
        if isinstance(row["step"], float) and step != row["step"]:
            raise ValueError
        return step, tuple(map(_csv_number, numbers))
    except (KeyError, TypeError, ValueError, OverflowError):
        raise fault(path, f"{where}: step must be a whole number, x_m and y_m numbers.") from None


def _csv_number(cell: Any) -> float:
    """Read a number, NaN of an empty cell, and a decimal comma, as spreadsheets write them."""
    number = number_in(cell) if isinstance(cell, str) else cell
    if number is None and cell is not None:
        raise ValueError
    return math.nan if number is None else float(number)


def _in_order(
    path: Path, sample_id: str, side: str, by_step: dict[int, tuple[float, ...]] | None
) -> Waypoints | None:
    if by_step is None:
        return None
    steps = sorted(by_step)
    if steps != list(range(steps[0], steps[0] + len(steps))) or steps[0] not in (0, 1):
        raise fault(path, f"{sample_id}: {side}: steps must run from 0 or 1 without a gap.")
    return unless_missing(tuple(by_step[step] for step in steps))
