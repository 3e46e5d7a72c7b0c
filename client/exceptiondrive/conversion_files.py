"""Read trajectories from JSON, JSON lines or CSV as planners write them; write a submission.

JSON: a submission file, or a bare list of its predictions. JSON lines: one prediction a line; a
recorder's journal is such a file. CSV, one waypoint a row, with the header
`sample_id,trajectory,step,x_m,y_m` and perhaps `heading_rad`; `trajectory` is `source` or
`edited`. A trajectory without rows is missing (null).
"""

import csv
import gzip
import io
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from exceptiondrive.conversion import RawPair, Waypoints
from exceptiondrive.errors import InvalidArgumentError

SIDES = ("source", "edited")
CSV_COLUMNS = ("sample_id", "trajectory", "step", "x_m", "y_m")
SCHEMA = "exceptiondrive.planning/1"


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
    data = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    if path.suffix == ".gz":
        data = gzip.compress(data, mtime=0)
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    os.replace(part, path)
    return len(data)


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
