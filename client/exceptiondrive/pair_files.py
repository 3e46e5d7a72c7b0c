"""Read pairs of trajectories in the forms that people write.

JSON: a submission file, a bare list of its predictions, or an object by sample id. JSON lines: one
prediction a line; a recorder's journal is such a file.
CSV with commas, semicolons or tabs: one waypoint a row, with the header
`sample_id,trajectory,step,x_m,y_m` and perhaps `heading_rad`; `trajectory` is `source` or `edited`.
Parquet: those columns, or a prediction a row, its lists in `source` and `edited`. NPZ: `sample_id`
(N), `source` and `edited` (N, T, 2 or 3), NaN where missing. A trajectory may stand in a list of
several modes, its waypoints as `exceptiondrive_schemas.check.trajectory_forms` has them. Plain or gzip; UTF-8,
UTF-16 or UTF-32, with or without a byte order mark. Nothing is ever unpickled.
"""

import codecs
import csv
import gzip
import io
import json
import math
import sys
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from exceptiondrive.conversion import RawPair, Waypoints
from exceptiondrive.errors import InvalidArgumentError, extra_missing, reason_of
from exceptiondrive.inputs import STDIN
from exceptiondrive.waypoint_rows import (
    SIDES,
    fault,
    pairs_of_rows,
    require_columns,
    unless_missing,
    with_unique_keys,
)
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check.inflate import (
    CONVERTIBLE,
    GZIP_MAGIC,
    other_file_kind,
    wide_encoding,
)
from exceptiondrive_schemas.check.trajectory_forms import (
    is_null_word,
    is_number,
    number_in,
    point_in,
)

OUR_SCHEMAS = "exceptiondrive."
CSV_DELIMITERS = ",;\t"
NPZ_MAGIC, NPY_MAGIC = b"PK\x03\x04", b"\x93NUMPY"
PARQUET_MAGIC = b"PAR1"
COMMENTS = ("//", "/*", "#")
PICKLE_MAGIC = b"\x80"
NO_POINT = (math.nan, math.nan)
MOST_BYTES = 1 << 30
TOO_LARGE = "holds more than 1 GiB: give it in parts, several files make one submission."
TWO_RUNS = (
    "Two runs make a submission, on the source and on the edited inputs: exceptiondrive convert "
    "--source-run FILE --edited-run FILE --split NAME"
)
OnForm = Callable[[str], None]
READ_HERE = "Read are JSON, JSON lines, CSV, Parquet and NPZ, plain or as gzip."


def read_pairs(
    paths: Sequence[Path], mode: int | None = None, on_form: OnForm = lambda _: None
) -> tuple[tuple[RawPair, ...], str | None]:
    """Read all files as one: shards of a run make one submission.

    Args:
        paths: The files.
        mode: Which trajectory to take where a list of several stands, from 0.
        on_form: Told of each form of a trajectory that had to be read as waypoints.

    Returns:
        The pairs in order, and the split that the files name, if any does.

    Raises:
        InvalidArgumentError: A file cannot be read, or a sample occurs twice.
    """
    pairs: dict[str, RawPair] = {}
    splits: set[str] = set()
    for path in paths:
        for pair in _pairs_of(path, splits, mode, on_form):
            if pair.sample_id in pairs:
                raise fault(path, f"sample {pair.sample_id} occurs twice.")
            pairs[pair.sample_id] = pair
    if len(splits) > 1:
        raise InvalidArgumentError(
            "wrong_split", f"The files name different splits: {', '.join(sorted(splits))}."
        )
    return tuple(pairs.values()), splits.pop() if splits else None


def read_bytes(path: Path) -> bytes:
    """Return what a file holds, or stdin where it is `-`, inflated if it is gzip.

    Raises:
        InvalidArgumentError: It cannot be read, is empty, or is a pickle.
    """
    try:
        data = sys.stdin.buffer.read() if path == STDIN else path.read_bytes()
        if data.startswith(GZIP_MAGIC):
            with gzip.open(io.BytesIO(data)) as stream:
                data = stream.read(MOST_BYTES + 1)
    except EOFError:
        raise fault(
            path, "is gzip that stops before its end: was its writing or copying cut off?"
        ) from None
    except (gzip.BadGzipFile, zlib.error):
        raise fault(path, "is gzip that is damaged: compress it again.") from None
    except OSError as error:
        raise InvalidArgumentError(
            "unreadable_file", f"{path} cannot be read: {error.strerror}."
        ) from None
    if len(data) > MOST_BYTES:
        raise fault(path, TOO_LARGE)
    if not data or data.isspace():
        raise fault(path, "is empty: check that your program finished writing it.")
    if data.startswith(PICKLE_MAGIC):
        raise InvalidArgumentError(
            "unreadable_file",
            f"{path.name} is a pickle, which is never loaded: it could run code.",
            "Dump it as JSON where it was written, {token: array.tolist(), ...}; docs/client.md has a "
            "line for each planner.",
        )
    return data


def read_text(path: Path, data: bytes) -> str:
    """Return the text of a file, of what `read_bytes` gave of it; without a byte order mark.

    Raises:
        InvalidArgumentError: It is no UTF-8 text, or begins with a comment.
    """
    try:
        text = data.decode(wide_encoding(data) or "utf-8-sig").removeprefix("\ufeff")
    except UnicodeDecodeError:
        raise fault(path, "is not UTF-8 text.") from None
    if text.lstrip().startswith(COMMENTS):
        raise fault(path, "begins with what looks like a comment: remove it.")
    return text


def read_arrays(path: Path, data: bytes, *names: str) -> tuple[list[Any], ...]:
    """Return named arrays of an NPZ file as nested lists; objects in it are refused, not unpickled.

    Args:
        path: The file, to be named where it is wrong.
        data: What it holds.
        names: Of the arrays.

    Raises:
        InvalidArgumentError: No such array, it holds objects, they are not equally long, or numpy is
            missing.
    """
    try:
        import numpy as np
    except ModuleNotFoundError:
        raise extra_missing("NPZ files need numpy.", "evaluate") from None
    try:
        arrays = np.load(io.BytesIO(data), allow_pickle=False)
        if isinstance(arrays, np.ndarray):
            raise fault(
                path,
                "is one array without names (.npy). Write it with sample ids: "
                f'numpy.savez("planner.npz", {", ".join(f"{name}=..." for name in names)}).',
            )
        with arrays:
            if sum(member.file_size for member in arrays.zip.infolist()) > MOST_BYTES:
                raise fault(path, TOO_LARGE)
            if absent := [name for name in names if name not in arrays]:
                raise InvalidArgumentError(
                    "unreadable_file",
                    f"{path.name}: has no array {', '.join(absent)}; there must be "
                    f"{', '.join(names)}.",
                    "" if "token" in names else f"A run has token and trajectory. {TWO_RUNS}",
                )
            found = [arrays[name] for name in names]
            columns = tuple(
                (array.astype(str) if array.dtype.kind == "S" else array).tolist()
                for array in found
            )
    except (
        ValueError,
        EOFError,
        MemoryError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise fault(
            path,
            "cannot be read as arrays of numbers, with ids of dtype=str and NaN for what is missing: "
            f"{error}",
        ) from None
    lengths = {len(column) if isinstance(column, list) else None for column in columns}
    if len(lengths) != 1 or None in lengths:
        raise fault(path, f"the arrays {', '.join(names)} must have as many rows each.")
    return columns


def points_of(
    path: Path, where: str, value: Any, mode: int | None, on_form: OnForm = lambda _: None
) -> Waypoints | None:
    """Return a trajectory as rows of numbers; NaN for a null in it, None for one of NaN alone.

    Raises:
        InvalidArgumentError: It is not a list of points, or one of several modes and none was said.
    """
    if value is None:
        return None
    if is_null_word(value):
        on_form("text in the place of null")
        return None
    if (modes := _mode_list(value)) is not None:
        value = _chosen_mode(path, where, modes, mode)
        on_form(f"mode {mode} of {len(modes)}" if len(modes) > 1 else "a list of one trajectory")
    try:
        points = tuple(
            NO_POINT if point is None else tuple(map(_as_number, point_in(point) or point))
            for point in value
        )
    except (TypeError, ValueError):
        raise fault(path, f"{where} must be a list of [x, y] in metres, or null.") from None
    return unless_missing(points)


def _mode_list(value: Any) -> list[Any] | None:
    """Return the trajectories of a list of modes; None where it is one trajectory."""
    is_list = isinstance(value, list) and value and isinstance(value[0], list) and value[0]
    return value if is_list and isinstance(value[0][0], list) else None


def _chosen_mode(path: Path, where: str, modes: list[Any], mode: int | None) -> Any:
    if len(modes) == 1:
        return modes[0]
    if mode is None or not mode < len(modes):
        raise InvalidArgumentError(
            "wrong_waypoint_shape",
            f"{path.name}: {where} has {len(modes)} modes.",
            f"Say which is driven: --mode N, from 0 to {len(modes) - 1}.",
        )
    return modes[mode]


def _as_number(value: Any) -> float:
    if value is None:
        return math.nan
    number = value if is_number(value) else number_in(value)
    if number is None:
        raise TypeError
    try:
        return float(number)
    except OverflowError:
        return math.inf


def _pairs_of(path: Path, splits: set[str], mode: int | None, on_form: OnForm) -> Iterator[RawPair]:
    data = read_bytes(path)
    kind = other_file_kind(data)
    if kind and kind not in CONVERTIBLE and not data.startswith(NPY_MAGIC):
        raise fault(path, f"is {kind}. {READ_HERE}")
    if data.startswith((NPZ_MAGIC, NPY_MAGIC)):
        on_form("arrays (NPZ)")
        yield from _pairs_of_arrays(path, data, mode, on_form)
        return
    if data.startswith(PARQUET_MAGIC):
        on_form("Parquet")
        yield from _pairs_of_parquet(path, data, mode)
        return
    if wide_encoding(data) or data.startswith(codecs.BOM_UTF8):
        on_form("text with a byte order mark, or in another encoding than UTF-8")
    text = read_text(path, data)
    if not text.lstrip().startswith(("{", "[")):
        on_form("CSV")
        yield from _pairs_of_csv(path, text)
        return
    for value in _predictions(path, text, splits, on_form):
        yield _pair_of_json(path, value, mode, on_form)


def _pairs_of_arrays(
    path: Path, data: bytes, mode: int | None, on_form: OnForm
) -> Iterator[RawPair]:
    sample_ids, *sides = read_arrays(path, data, "sample_id", *SIDES)
    for sample_id, *pair in zip(sample_ids, *sides, strict=True):
        source, edited = (points_of(path, str(sample_id), points, mode, on_form) for points in pair)
        yield RawPair(str(sample_id), source, edited)


def _predictions(path: Path, text: str, splits: set[str], on_form: OnForm) -> Iterator[Any]:
    """Yield the predictions of a JSON document, of several in a row, or of JSON lines."""
    documents = list(_json_documents(path, text))
    if len(documents) > 1:
        on_form(f"{len(documents):,} JSON documents in a row")
    values = [one for each in documents for one in (each if isinstance(each, list) else [each])]
    if not all(isinstance(value, dict) and "predictions" in value for value in values):
        on_form("predictions in another form than that of a submission")
    for value in values:
        if isinstance(value, dict) and not {"sample_id", "predictions", *SIDES} & value.keys():
            _require_own_keys(path, value)
        if isinstance(value, dict) and ("schema" in value or "predictions" in value):
            schema = value.get("schema", PLANNING.file_schema)
            if schema != PLANNING.file_schema:
                if str(schema).startswith(OUR_SCHEMAS):
                    raise fault(
                        path, f"is {schema!r}: only {PLANNING.file_schema!r} has trajectories."
                    )
                on_form(f"a file of the schema {schema!r}")
            if isinstance(value.get("split"), str):
                splits.add(value["split"])
            predictions = value.get("predictions", [])
            if not isinstance(predictions, list | dict):
                raise fault(path, "predictions must be a list, or an object by sample id.")
            yield from _flat_predictions(path, predictions)
        elif isinstance(value, dict) and not {"sample_id", *SIDES} & value.keys():
            yield from _flat_predictions(path, value)
        else:
            yield value


def _require_own_keys(path: Path, value: dict[str, Any]) -> None:
    """Refuse predictions under a key that is none of ours, and name it."""
    for key, each in value.items():
        held = each.values() if isinstance(each, dict) else each if isinstance(each, list) else ()
        first = next(iter(held), None)
        is_whole = isinstance(each, dict) and "predictions" in each
        if is_whole or (isinstance(first, dict) and not first.keys().isdisjoint(SIDES)):
            raise fault(
                path,
                f"did you mean what is under {key}? Write that alone into a file, or call the key "
                "predictions.",
            )


def _flat_predictions(path: Path, predictions: Any) -> Iterator[Any]:
    """Yield predictions of a list, or of an object by sample id."""
    if not isinstance(predictions, Mapping):
        for value in predictions:
            yield from value if isinstance(value, list) else [value]
        return
    if _is_run(predictions.values()):
        raise InvalidArgumentError(
            "unreadable_file",
            f"{path.name} is one run of a planner: one trajectory by each id.",
            TWO_RUNS,
        )
    for sample_id, value in predictions.items():
        yield {**value, "sample_id": sample_id} if isinstance(value, dict) else predictions


def _is_run(values: Collection[Any]) -> bool:
    """Whether values by id are trajectories, or null."""
    return any(values) and all(
        value is None or (isinstance(value, list) and not isinstance(next(iter(value), 0), dict))
        for value in values
    )


def whole_number(digits: str) -> float:
    """Return a whole number of JSON; one of more digits than Python reads is no finite one."""
    try:
        return int(digits)
    except ValueError:
        return float(digits)


def _json_documents(path: Path, text: str) -> Iterator[Any]:
    """Yield the JSON documents of a text, with or without line ends between them."""
    hook = with_unique_keys(path)
    decoder, at = json.JSONDecoder(object_pairs_hook=hook, parse_int=whole_number), 0
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        try:
            value, at = decoder.raw_decode(text, at)
        except (ValueError, RecursionError) as error:
            at = getattr(error, "pos", at)
            number = text.count("\n", 0, at) + 1
            raise fault(path, f"line {number} is not JSON: {reason_of(error)}.") from None
        yield value


def _pair_of_json(path: Path, value: Any, mode: int | None, on_form: OnForm) -> RawPair:
    if not isinstance(value, dict) or not isinstance(value.get("sample_id"), str):
        raise fault(path, f"a prediction needs a sample_id, got {str(value)[:80]}.")
    sample_id = value["sample_id"]
    unknown = sorted(set(value) - {"sample_id", *SIDES})
    if unknown:
        known = "a prediction has sample_id, source and edited alone"
        raise fault(path, f"{sample_id}: unknown key {', '.join(unknown)}; {known}.")
    source, edited = (
        points_of(path, f"{sample_id}: {side}", value.get(side), mode, on_form) for side in SIDES
    )
    return RawPair(sample_id, source, edited)


def _pairs_of_csv(path: Path, text: str) -> Iterator[RawPair]:
    head = text.partition("\n")[0]
    delimiter = max(CSV_DELIMITERS, key=head.count)
    reader = csv.reader(io.StringIO(text), delimiter=delimiter, skipinitialspace=True)
    try:
        names = [name.strip() for name in next(reader, ())]
        require_columns(path, names)
        rows = (_by_column(path, reader.line_num, names, row) for row in reader if row)
        yield from pairs_of_rows(path, ((f"line {reader.line_num}", row) for row in rows))
    except csv.Error as error:
        raise fault(path, f"line {reader.line_num + 1} is no row of a table: {error}.") from None


def _by_column(path: Path, line: int, names: list[str], row: list[str]) -> dict[str, str]:
    """Return the cells of a row by column; more of them than columns are decimal commas, or a wrong head."""
    if any(map(str.strip, row[len(names) :])):
        raise fault(
            path,
            f"line {line} has {len(row)} cells, the first line {len(names)}: where decimal commas "
            "are in it, separate cells by semicolons or tabs.",
        )
    return dict(zip(names, map(str.strip, row), strict=False))


def _pairs_of_parquet(path: Path, data: bytes, mode: int | None) -> Iterator[RawPair]:
    try:
        from pyarrow import ArrowException, BufferReader
        from pyarrow.parquet import read_table
    except ModuleNotFoundError:
        raise extra_missing("Parquet files need pyarrow.", "parquet") from None
    try:
        # Without threads: one that is alive when the process ends aborts it.
        table = read_table(BufferReader(data), use_threads=False, pre_buffer=False)
        rows = table.to_pylist()
    except (ArrowException, OSError, UnicodeDecodeError) as error:
        raise fault(path, f"cannot be read as Parquet: {error}") from None
    if {"sample_id", *SIDES} <= set(table.column_names):
        for row in rows:
            yield _pair_of_json(path, row, mode, lambda _: None)
        return
    require_columns(path, table.column_names, ", or sample_id,source,edited")
    yield from pairs_of_rows(path, ((f"row {at}", row) for at, row in enumerate(rows, start=1)))
