"""What the functions of the SDK take: a path, bytes, an open file, a mapping, arrays, a model.

A submission may also be columns of arrays (`sample_id`, `source`, `edited` of shape (N, T, 2), NaN
where the planner gave nothing; or `sample_id`, `strategy`), or a data frame: of these columns, or of
the waypoints, as `convert` reads CSV. What offers `tolist` or `__array__` is an array. numpy and
pandas are never imported here.
"""

import json
import math
import os
from codecs import BOM_UTF8
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Protocol, TypeVar

from pydantic import ValidationError

from exceptiondrive.errors import InvalidArgumentError, reason_of
from exceptiondrive.waypoint_rows import SIDES, pairs_of_rows, require_columns
from exceptiondrive_schemas.base import Document, faults_in
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY
from exceptiondrive_schemas.check.checker import CSV_COLUMNS
from exceptiondrive_schemas.check.inflate import UnreadableFileError, inflate
from exceptiondrive_schemas.protocol import (
    NEWEST,
    ProtocolDocument,
    ProtocolError,
    packaged_protocol,
    read_protocol,
)
from exceptiondrive_schemas.split import Manifest, Split


class DataFrameLike(Protocol):
    """A data frame, as far as it is looked at."""

    @property
    def columns(self) -> Any:
        """Names of its columns."""

    @property
    def attrs(self) -> Any:
        """What is said of it as a whole; `split` may be named there."""


class GivenFile(NamedTuple):
    """What was given, and what to call it."""

    name: str
    data: bytes

    def text(self) -> str:
        """Return what it holds as text, in UTF-8; no letter is replaced or left out.

        Raises:
            InvalidArgumentError: It is something else, such as a table in an encoding of old.
        """
        try:
            return self.data.decode("utf-8-sig")
        except UnicodeDecodeError:
            words = f"{self.name} is not UTF-8 text. Nothing was sent; save it as UTF-8."
            raise InvalidArgumentError("unreadable_file", words) from None


BytesLike = GivenFile | str | os.PathLike[str] | bytes | BinaryIO
"""The path of a file, what it holds, or an open one."""
SubmissionLike = BytesLike | Mapping[str, Any] | DataFrameLike
ManifestLike = Manifest | BytesLike | Mapping[str, Any]
SplitLike = Split | BytesLike | Mapping[str, Any]
ProtocolLike = ProtocolDocument | str | os.PathLike[str]
PROTOCOL_ADVICE = (
    "The server gives every version as a file at /api/v1/protocols/VERSION?format=toml."
)
MAX_SPLIT_BYTES = 256 * 1024 * 1024
STDIN = Path("-")
Model = TypeVar("Model", bound=Document)


def given_bytes(given: object, what: str = "file", advice: str = "") -> GivenFile:
    """Return what a path, bytes or an open file hold.

    Args:
        given: Any of these.
        what: What to call it.
        advice: Where to take it from, if it cannot be read.

    Raises:
        InvalidArgumentError: It is none of these, or cannot be read.
    """
    if isinstance(given, GivenFile):
        return given
    if isinstance(given, bytes | bytearray | memoryview):
        return GivenFile(what, bytes(given))
    if isinstance(given, str | os.PathLike):
        try:
            return GivenFile(Path(given).name, Path(given).read_bytes())
        except (OSError, ValueError) as error:
            if isinstance(given, str) and given.lstrip()[:1] in ("", "{", "["):
                said = "JSON in a text" if given.strip() else "an empty text"
                raise InvalidArgumentError(
                    "wrong_argument",
                    f"The {what} is {said}; a text is taken as the path of a file.",
                    "Give a path, or what the file holds as bytes: text.encode().",
                ) from None
            reason = getattr(error, "strerror", None) or str(error)
            raise InvalidArgumentError(
                "unreadable_file", f"{os.fspath(given)} cannot be read: {reason}.", advice
            ) from None
    read = None if isinstance(given, Document) else getattr(given, "read", None)
    try:
        data = read() if callable(read) else None
    except (OSError, ValueError) as error:  # of a file that is closed, or opened to be written
        raise InvalidArgumentError(
            "unreadable_file", f"The {what} cannot be read: {error}.", advice
        ) from None
    if not isinstance(data, bytes):
        forms = "its document as a mapping"
        if what == "submission":
            forms += ", columns `sample_id`, `source` and `edited`, or a data frame of them"
        raise InvalidArgumentError(
            "wrong_argument",
            f"The {what} is of type {type(given).__name__}, which is not taken.",
            f"Give a path, bytes, a file opened in binary mode, {forms}. {advice}".strip(),
        )
    name = getattr(given, "name", None)
    return GivenFile(Path(name).name.strip("<>") if isinstance(name, str) else what, data)


def require_name(path: Path) -> None:
    """Refuse `-` where a file is to be written.

    Raises:
        InvalidArgumentError: It is `-`.
    """
    if path == STDIN:
        raise InvalidArgumentError(
            "wrong_output",
            "- stands for stdin, and nothing can be written there.",
            "Name the file to write.",
        )


def require_unread(output: Path, *read: Path | str | None) -> None:
    """Refuse to write over what a command reads; what is None was not given.

    Raises:
        InvalidArgumentError: The output is one of these.
    """
    if output.resolve() in [Path(each).resolve() for each in read if each is not None]:
        raise InvalidArgumentError(
            "wrong_option",
            f"{output} is what is read; it was left as it is.",
            "Name another file to write.",
        )


def given_submission(given: object, split: str | None = None) -> GivenFile:
    """Return a submission file.

    Args:
        given: See the head of this module.
        split: Name of the split, where arrays or a data frame do not say it.

    Raises:
        InvalidArgumentError: It is none of these.
    """
    if not isinstance(given, Mapping) and hasattr(given, "columns") and hasattr(given, "to_dict"):
        frame: Any = given
        attrs = getattr(given, "attrs", None) or {}
        columns = {str(name): _as_lists(frame[name]) for name in frame.columns}
        split = split or attrs.get("split")
        given = _of_waypoints(columns) if "trajectory" in columns else columns
    if not isinstance(given, Mapping):
        return given_bytes(given, "submission")
    document = _as_lists(given)
    if "predictions" not in document and "sample_id" in document:
        document = _of_columns(document, split)
    try:
        return GivenFile("submission.json", json.dumps(document).encode())
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError(
            "wrong_argument",
            f"The submission cannot be written as JSON: {error}.",
            "Give texts (of bytes: .decode(), of an array: .astype(str)), real numbers, None, and "
            "lists or arrays of them.",
        ) from None


def given_manifest(given: ManifestLike) -> Manifest:
    """Return the public manifest of a split.

    Raises:
        InvalidArgumentError: It cannot be read, or is no manifest.
    """
    return _model_of(
        Manifest,
        given,
        "manifest",
        "Take it from the server: exceptiondrive manifest PHASE -o FILE",
    )


def given_split(given: SplitLike) -> Split:
    """Return a split with its regions, of a plain file or gzip.

    Raises:
        InvalidArgumentError: It cannot be read, or is no split.
    """
    return _model_of(
        Split, given, "split file", "Take the development split: exceptiondrive split download NAME"
    )


def given_protocol(given: ProtocolLike | None) -> ProtocolDocument:
    """Return a protocol: a model, a TOML file or a version that ships; else the newest.

    Raises:
        InvalidArgumentError: Neither a file nor a version, or a file that is no protocol.
    """
    if given is None:
        return packaged_protocol(NEWEST)
    if isinstance(given, ProtocolDocument):
        return given
    try:
        if Path(given).is_file():
            return read_protocol(Path(given))
        return packaged_protocol(str(given))
    except ProtocolError as error:
        raise InvalidArgumentError("wrong_protocol", f"{given}: {error}") from None
    except (OSError, TypeError, ValueError):
        is_named = isinstance(given, str | os.PathLike)
        shown, advice = repr(os.fspath(given) if is_named else given), PROTOCOL_ADVICE
        if not is_named:
            advice = f'A version is a text, such as "{NEWEST}". {advice}'
        raise InvalidArgumentError(
            "wrong_protocol",
            f"{shown} is neither a protocol file nor a version that ships with this client.",
            advice,
        ) from None


def _model_of(kind: type[Model], given: object, noun: str, advice: str) -> Model:
    if isinstance(given, kind):
        return given
    name = noun
    try:
        if isinstance(given, Mapping):
            data = json.dumps(_as_lists(given)).encode()
        else:
            name, data = given_bytes(given, noun, advice)
            data = inflate(
                data, max_upload_bytes=MAX_SPLIT_BYTES, max_inflated_bytes=MAX_SPLIT_BYTES
            ).removeprefix(BOM_UTF8)
        if kind is Manifest:  # of a server that may be newer
            return kind.read(data)
        return kind.model_validate_json(data)
    except (UnreadableFileError, TypeError, RecursionError) as error:
        reason = reason_of(error)
    except ValidationError as error:
        reason = faults_in(error)[0]
    code = f"wrong_{noun.replace(' ', '_')}"
    raise InvalidArgumentError(code, f"{name} is not a {noun} ({reason}).", advice)


def _as_lists(value: Any) -> Any:
    """Return lists in the place of arrays, tensors and series, at every depth, and None of `pandas.NA`."""
    if not hasattr(value, "tolist") and hasattr(value, "__array__"):
        value = value.__array__()
    if hasattr(value, "tolist"):
        listed = value.tolist()
        is_mixed = str(getattr(value, "dtype", "")) == "object" or hasattr(value, "isna")
        return _as_lists(listed) if is_mixed else listed
    if isinstance(value, Mapping):
        return {str(key): _as_lists(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_as_lists(each) for each in value]
    return None if type(value).__name__ == "NAType" else value  # pandas.NA


def _of_columns(columns: Mapping[str, Any], split: str | None) -> dict[str, Any]:
    """Return the document of columns, one value a sample."""
    challenge = STRATEGY if "strategy" in columns else PLANNING
    named = [name for name in columns if name not in ("schema", "split")]
    for name in named:
        if not isinstance(columns[name], list):
            raise InvalidArgumentError(
                "wrong_argument",
                f"The column {name} is no list, array or series: one value a sample.",
            )
    lengths = {name: len(columns[name]) for name in named}
    if len(set(lengths.values())) != 1:
        told = ", ".join(f"{name} {length:,}" for name, length in lengths.items())
        raise InvalidArgumentError(
            "wrong_argument", f"The columns are not equally long, one value a sample: {told}."
        )
    rows = zip(*(map(_without_nan, columns[name]) for name in named), strict=True)
    return {
        "schema": columns.get("schema", challenge.file_schema),
        "split": split or columns.get("split"),
        "predictions": [dict(zip(named, row, strict=True)) for row in rows],
    }


def _without_nan(value: Any) -> Any:
    """Return None for what is NaN alone, as numpy and pandas write what is missing."""
    numbers = list(_iterate_numbers(value))
    is_nan = all(isinstance(each, float) and math.isnan(each) for each in numbers)
    return None if numbers and is_nan else value


def _iterate_numbers(value: Any) -> Iterable[Any]:
    if isinstance(value, list):
        for each in value:
            yield from _iterate_numbers(each)
    else:
        yield value


def _of_waypoints(columns: Mapping[str, list[Any]]) -> dict[str, Any]:
    """Return columns by sample of columns by waypoint, read as `convert` reads CSV."""
    frame = Path("data frame")
    require_columns(frame, columns)
    rows = zip(*(columns[name] for name in CSV_COLUMNS), strict=True)
    by_name = (dict(zip(CSV_COLUMNS, row, strict=True)) for row in rows)
    pairs = [*pairs_of_rows(frame, ((f"row {at}", row) for at, row in enumerate(by_name, 1)))]
    return {name: [getattr(pair, name) for pair in pairs] for name in ("sample_id", *SIDES)}
