"""Files of other boards, read as rows: CSV, JSON, our own exports, records of Every Eval Ever."""

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, cast, get_args

from pydantic import ValidationError

from exceptiondrive_records.db.csv_table import Fault, csv_rows, faults_text
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.db.identifiers import checked_text
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.method_facts import MethodFacts
from exceptiondrive_schemas.printable import from_spreadsheet
from exceptiondrive_schemas.protocol import Average
from exceptiondrive_schemas.reported.imported import ImportedRow
from exceptiondrive_schemas.score_sheet import MetricRow
from exceptiondrive_schemas.split import SPLIT_NAME_PATTERN, SplitRef

NEEDED = ("method", "split", "split_revision", "protocol")
OPTIONAL = ("team", "protocol_digest", "average", "n_samples", "cite")
MAX_ROWS = 500
MAX_NAME = 80
MAX_CITE = 500
_PASSED_OVER = frozenset(
    (
        *("board", "published_at", "source", "rank", "rank_low", "rank_high", "submission_id"),
        *("submitted_at", "flags", "leads", "unranked_because", "edited_at", "board_url"),
        *MethodFacts.model_fields,
    )
)
"""Columns of our own export that are no part of a reported row."""
_DIGEST = re.compile(r"sha256:[0-9a-f]{64}")
_ID = re.compile(r"[a-z0-9_]{1,64}")


class _Line(NamedTuple):
    place: str
    """`Line 3` of a table, `Row 2` of a JSON file."""
    values: Mapping[str, Any]


def read_rows(text: str, challenge: Challenge) -> tuple[ImportedRow, ...]:
    """Return the rows of a file: all of them, or none.

    A CSV file, or a JSON list of objects, has the columns of `NEEDED`, those of `OPTIONAL`, one for
    each metric that is told, and for families such as `hcc.lane_blockage`. The CSV and the JSON that
    this software exports, and records of Every Eval Ever made by it, are such files too.

    Raises:
        InvalidRecord: It cannot be read, or rows of it are refused: each is named, with what helps.
    """
    try:
        return _rows(text, challenge)
    except RecursionError:
        words = "Lists or objects of the file are nested too deeply"
        raise InvalidRecord(f"{words}: write a list of objects, one for each row.") from None


def _rows(text: str, challenge: Challenge) -> tuple[ImportedRow, ...]:
    rows: list[ImportedRow] = []
    faults: list[Fault] = []
    seen: dict[tuple[object, ...], str] = {}
    for line in _lines(text.removeprefix("\ufeff"), challenge):
        try:
            row = _row(line.values, challenge)
        except InvalidRecord as refusal:
            faults.append(Fault(line.place, str(refusal)))
            continue
        key = row.method, row.team, row.split.revision, row.protocol, row.average
        if key in seen:
            words = f"The same method as in {seen[key]}; leave one of the two out."
            faults.append(Fault(line.place, words))
        seen[key] = line.place.lower()
        rows.append(row)
    if faults:
        raise InvalidRecord(f"Nothing was imported. {faults_text(faults)}")
    return tuple(rows)


def _lines(text: str, challenge: Challenge) -> list[_Line]:
    lines = _of_json(text, challenge) if text.lstrip()[:1] in ("{", "[") else _of_csv(text)
    if not lines:
        raise InvalidRecord(
            "The file has no row: write the names of columns first, then one method a line."
        )
    if len(lines) > MAX_ROWS:
        raise InvalidRecord(f"The file has more than {MAX_ROWS} rows; import it in parts.")
    return lines


def _of_csv(text: str) -> list[_Line]:
    (_, head), *rows = csv_rows(text) or [(1, [])]
    names = [name.strip().lower() for name in head]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InvalidRecord(f"The first line names the column {min(twice)} twice.")
    lines: list[_Line] = []
    for number, cells in rows:
        values = map(from_spreadsheet, map(str.strip, cells))
        lines.append(_Line(f"Line {number}", dict(zip(names, values, strict=True))))
    return lines


def _of_json(text: str, challenge: Challenge) -> list[_Line]:
    try:
        found = json.loads(text)
    except json.JSONDecodeError:
        found = _json_lines(text)
    except ValueError:
        raise InvalidRecord("A number of the file has too many digits: write 0.1964.") from None
    if isinstance(found, dict) and "entries" in found:
        return list(_of_board(text, challenge))
    objects = found if isinstance(found, list) else [found]
    lines = []
    for n, one in enumerate(objects, 1):
        if not isinstance(one, dict):
            raise InvalidRecord(f"Row {n} is no JSON object with the names of columns as keys.")
        values = _of_record(one) if "evaluation_results" in one else one
        lines.append(_Line(f"Row {n}", values))
    return lines


def _json_lines(text: str) -> list[Any]:
    found = []
    for n, line in enumerate(text.split("\n"), 1):
        try:
            found += [json.loads(line)] if line.strip() else []
        except json.JSONDecodeError as error:
            raise InvalidRecord(f"Line {n} is no JSON: {error}.") from None
        except ValueError:
            words = f"Line {n}: A number has too many digits"
            raise InvalidRecord(f"{words}: write 0.1964.") from None
    return found


def _of_board(text: str, challenge: Challenge) -> Iterator[_Line]:
    """The entries of a board, without what papers report, which is of other samples."""
    try:
        board = Board.model_validate_json(text, extra="allow")
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise InvalidRecord(f"This is no board of an ExceptionDrive site: {where}.") from None
    if board.challenge != challenge.id:
        raise InvalidRecord(f"This is a board of the {board.challenge} challenge.")
    ranking = challenge.metrics[0].key
    for n, entry in enumerate((one for one in board.entries if one.source != "reported"), 1):
        yield _Line(
            f"Row {n}",
            {
                "method": entry.method,
                "team": entry.team,
                "split": board.split.name,
                "split_revision": board.split.revision,
                "protocol": board.protocol.version,
                "protocol_digest": board.protocol.digest,
                "average": board.headline,
                "n_samples": board.n_samples,
                **entry.metrics,
                **{f"{ranking}.{id}": it.metrics.get(ranking) for id, it in entry.families.items()},
            },
        )


def _of_record(record: Mapping[str, Any]) -> dict[str, Any]:
    """Read a record of Every Eval Ever; whatever it lacks is missing in the row, and named there."""
    try:
        library = record["eval_library"]["additional_details"]
        results = record["evaluation_results"]
        overall = results[0]["evaluation_name"]
        source = results[0]["source_data"]
        values = {
            "method": record["model_info"]["name"],
            "team": record["model_info"].get("developer", ""),
            "split": source["dataset_name"].removeprefix("exceptiondrive: "),
            "split_revision": source["additional_details"]["revision"],
            "protocol": library["protocol"],
            "protocol_digest": library.get("protocol_digest"),
            "average": library.get("average"),
            "n_samples": results[0]["score_details"].get("uncertainty", {}).get("num_samples"),
            "cite": record["source_metadata"].get("additional_details", {}).get("entry", ""),
        }
        ranking = results[0]["metric_config"]["metric_id"].removeprefix("exceptiondrive.")
        for result in results:
            metric = result["metric_config"]["metric_id"].removeprefix("exceptiondrive.")
            family = result["evaluation_name"].removeprefix(overall).removeprefix(".")
            if not family or metric == ranking:
                name = f"{metric}.{family}" if family else metric
                values[name] = result["score_details"]["score"]
    except (LookupError, AttributeError, TypeError) as error:
        words = "This record of Every Eval Ever was not made by ExceptionDrive"
        raise InvalidRecord(f"{words}: it lacks {error}. Import its numbers as CSV.") from None
    return values


def _row(values: Mapping[str, Any], challenge: Challenge) -> ImportedRow:
    missing = [name for name in NEEDED if values.get(name) in (None, "")]
    if missing:
        raise InvalidRecord(
            f"It does not tell {', '.join(missing)}: each row names the split, its revision and the "
            "protocol that it was measured under."
        )
    metrics, families = _numbers(values, challenge)
    if not metrics:
        first = challenge.metrics[0].key
        raise InvalidRecord(f"It tells no metric, such as {first}.")
    return ImportedRow(
        method=_text("method", values["method"], MAX_NAME),
        team=_text("team", values.get("team"), MAX_NAME, may_be_empty=True),
        metrics=metrics,
        families=families,
        n_samples=_count(values.get("n_samples")),
        split=SplitRef(name=_split_name(values["split"]), revision=_revision(values)),
        protocol=_protocol(values["protocol"]),
        protocol_digest=_digest("protocol_digest", values.get("protocol_digest")),
        average=_average(values.get("average")),
        cite=_text(
            "cite", values.get("cite") or values.get("board_url"), MAX_CITE, may_be_empty=True
        ),
    )


def _numbers(values: Mapping[str, Any], challenge: Challenge) -> tuple[MetricRow, MetricRow]:
    metrics: MetricRow = {}
    families: MetricRow = {}
    ranking = challenge.metrics[0]
    for name, value in values.items():
        metric, _, family = name.partition(".")
        if name in challenge.metric_keys:
            number = _number(name, value, challenge.metric(name))
            metrics |= {} if number is None else {name: number}
        elif metric == ranking.key and _ID.fullmatch(family):
            number = _number(name, value, ranking)
            families |= {} if number is None else {family: number}
        elif not _is_passed_over(name, challenge):
            known = ", ".join(challenge.metric_keys)
            raise InvalidRecord(
                f"{name!r} is no column of the {challenge.id} challenge: leave it out. Metrics are {known}."
            )
    return metrics, families


def _is_passed_over(name: str, challenge: Challenge) -> bool:
    is_end = name.removesuffix("_low").removesuffix("_high") in challenge.metric_keys
    is_of_controls = any(name == metric.key for metric in challenge.of_controls)
    return is_end or is_of_controls or name in {*_PASSED_OVER, *NEEDED, *OPTIONAL}


def _number(name: str, value: Any, metric: Metric) -> float | None:
    if value is None or value == "":
        return None
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InvalidRecord(f"{name} is {value!r}: write a number such as 0.1964, or nothing.")
    if metric.unit == "fraction" and not 0 <= number <= 1:
        raise InvalidRecord(f"{name} is {number:g}: shares are from 0 to 1; 19.64 % is 0.1964.")
    if abs(number) > 1e6:
        raise InvalidRecord(f"{name} is {number:g}: write it in metres.")
    return number


def _count(value: Any) -> int | None:
    if value is None or value == "":
        return None
    text = str(value)
    is_whole = text.isascii() and text.isdigit() and len(text) < 10
    if isinstance(value, bool) or not is_whole or int(text) == 0:
        raise InvalidRecord(
            f"n_samples is {value!r}: write how many samples, such as 3181, or nothing."
        )
    return int(text)


def _split_name(value: Any) -> str:
    if re.fullmatch(SPLIT_NAME_PATTERN, str(value)) is None:
        raise InvalidRecord(f"split is {value!r}: write its name, such as nuscenes-real.")
    return str(value)


def _revision(values: Mapping[str, Any]) -> str:
    revision = _digest("split_revision", values["split_revision"])
    assert revision is not None
    return revision


def _protocol(value: Any) -> str:
    version = _text("protocol", value, 100)
    if version.isdigit():
        raise InvalidRecord(
            f"protocol is {version!r}: write its version in full, such as 1.0; spreadsheet programs "
            "cut it unless its cells are of text."
        )
    return version


def _digest(name: str, value: Any) -> str | None:
    if value is None or value == "":
        return None
    if _DIGEST.fullmatch(str(value)) is None:
        raise InvalidRecord(f"{name} is {value!r}: write it in full, sha256: and 64 digits.")
    return str(value)


def _average(value: Any) -> Average | None:
    if value is None or value == "":
        return None
    if value not in get_args(Average):
        raise InvalidRecord(
            f"average is {value!r}: write {' or '.join(get_args(Average))}, or nothing."
        )
    return cast("Average", value)


def _text(kind: str, value: Any, max_length: int, *, may_be_empty: bool = False) -> str:
    text = "" if value is None else value
    if not isinstance(text, str):
        raise InvalidRecord(f"The {kind} is no text: put it in quotes.")
    return checked_text(kind, text, max_length=max_length, may_be_empty=may_be_empty)
