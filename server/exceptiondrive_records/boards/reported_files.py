"""Parse the table of an external board from CSV, such as our own export."""

import math
import re
from collections.abc import Mapping
from typing import cast, get_args

from exceptiondrive_records.db.csv_table import faults_text, named_rows
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.db.identifiers import checked_text
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
        *("phase", "board", "published_at", "source", "rank", "rank_low", "rank_high"),
        *("submission_id", "submitted_at", "flags", "is_late", "leads", "unranked_because"),
        *("edited_at", "board_url"),
        *MethodFacts.model_fields,
    )
)
"""Columns of our own export that are ignored on import."""
_DIGEST = re.compile(r"sha256:[0-9a-f]{64}")
_ID = re.compile(r"[a-z0-9_]{1,64}")


def read_rows(text: str, challenge: Challenge) -> tuple[ImportedRow, ...]:
    """Return the rows of a file: all of them, or none.

    A CSV file has the columns of `NEEDED`, any of `OPTIONAL`, one for each reported metric, and for
    families columns such as `hcc.lane_blockage`. The CSV export of this software is such a file.

    Raises:
        InvalidRecord: It cannot be read, or rows are refused: each is named, with advice.
    """
    rows: list[ImportedRow] = []
    faults: list[tuple[int, str]] = []
    seen: dict[tuple[object, ...], int] = {}
    for number, cells in named_rows(text, most=MAX_ROWS):
        values = {name: from_spreadsheet(cell) for name, cell in cells.items()}
        try:
            row = _row(values, challenge)
        except InvalidRecord as refusal:
            faults.append((number, str(refusal)))
            continue
        key = row.method, row.team, row.split.revision, row.protocol, row.average
        if key in seen:
            words = f"The same method as in line {seen[key]}; leave one of the two out."
            faults.append((number, words))
        seen[key] = number
        rows.append(row)
    if faults:
        raise InvalidRecord(f"Nothing was imported. {faults_text(faults)}")
    return tuple(rows)


def _row(values: Mapping[str, str], challenge: Challenge) -> ImportedRow:
    missing = [name for name in NEEDED if not values.get(name)]
    if missing:
        raise InvalidRecord(
            f"It lacks {', '.join(missing)}: each row must name the split, its revision and the "
            "protocol that it was measured under."
        )
    metrics, families = _numbers(values, challenge)
    if not metrics:
        first = challenge.metrics[0].key
        raise InvalidRecord(f"It has no metric, such as {first}.")
    digest = values.get("protocol_digest") or None
    return ImportedRow(
        method=_text("method", values["method"], MAX_NAME),
        team=_text("team", values.get("team"), MAX_NAME, may_be_empty=True),
        metrics=metrics,
        families=families,
        n_samples=_count(values.get("n_samples")),
        split=SplitRef(
            name=_split_name(values["split"]),
            revision=_digest("split_revision", values["split_revision"]),
        ),
        protocol=_protocol(values["protocol"]),
        protocol_digest=digest and _digest("protocol_digest", digest),
        average=_average(values.get("average")),
        cite=_text(
            "cite", values.get("cite") or values.get("board_url"), MAX_CITE, may_be_empty=True
        ),
    )


def _numbers(values: Mapping[str, str], challenge: Challenge) -> tuple[MetricRow, MetricRow]:
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


def _number(name: str, value: str, metric: Metric) -> float | None:
    if not value:
        return None
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InvalidRecord(f"{name} is {value!r}: write a number such as 0.1964, or nothing.")
    if metric.unit == "fraction" and not 0 <= number <= 1:
        raise InvalidRecord(f"{name} is {number:g}: shares are from 0 to 1; 19.64 % is 0.1964.")
    if abs(number) > 1e6:
        raise InvalidRecord(f"{name} is {number:g}: write it in metres.")
    return number


def _count(value: str | None) -> int | None:
    if not value:
        return None
    is_whole = value.isascii() and value.isdigit() and len(value) < 10
    if not is_whole or int(value) == 0:
        raise InvalidRecord(
            f"n_samples is {value!r}: write how many samples, such as 3181, or nothing."
        )
    return int(value)


def _split_name(value: str) -> str:
    if re.fullmatch(SPLIT_NAME_PATTERN, value) is None:
        raise InvalidRecord(f"split is {value!r}: write its name, such as nuscenes-real.")
    return value


def _protocol(value: str) -> str:
    version = _text("protocol", value, 100)
    if version.isdigit():
        raise InvalidRecord(
            f"protocol is {version!r}: write its version in full, such as 1.0; spreadsheet programs "
            "cut it unless its cells are of text."
        )
    return version


def _digest(name: str, value: str) -> str:
    if _DIGEST.fullmatch(value) is None:
        raise InvalidRecord(f"{name} is {value!r}: write it in full, sha256: and 64 digits.")
    return value


def _average(value: str | None) -> Average | None:
    if not value:
        return None
    if value not in get_args(Average):
        raise InvalidRecord(
            f"average is {value!r}: write {' or '.join(get_args(Average))}, or nothing."
        )
    return cast("Average", value)


def _text(kind: str, value: str | None, max_length: int, *, may_be_empty: bool = False) -> str:
    return checked_text(kind, value or "", max_length=max_length, may_be_empty=may_be_empty)
