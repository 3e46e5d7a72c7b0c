"""Documents of the API as pandas tables; needs the extra `data`.

Numbers stay what the documents hold: fractions for safety metrics, metres for shifts, NaN where
undefined. Times are in UTC.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from exceptiondrive.async_client import AsyncSubmission
from exceptiondrive.client import Submission
from exceptiondrive.errors import InvalidArgumentError, extra_missing
from exceptiondrive.evaluation import SampleResult
from exceptiondrive_schemas.api.similarity import SimilarityReport, SubmissionOfTeam
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.faults import CheckReport, FaultGroup
from exceptiondrive_schemas.score_sheet import ScoreSheet

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]
OneSubmission = Submission | AsyncSubmission | SubmissionView
AGGREGATES = ("macro_family", "micro")
_OF_ALL = [
    *("id", "phase", "challenge", "method", "status", "rank", "received_at", "is_late"),
    *("unranked_because", "replaced_by"),
]
"""Columns of every submission, scored or not."""
_OF_BOARDS = ["phase", "board", "protocol"]
_OF_ENTRIES = [
    *_OF_BOARDS,
    *("rank", "rank_low", "rank_high", "method", "team", "source"),
    *("flags", "is_late", "unranked_because", "submission_id", "submitted_at"),
]
_OF_FAMILIES = [*_OF_BOARDS, "method", "team", "source", "submission_id", "family", "n"]
"""Columns of every board, whatever its metrics."""
_ENDS_OF_TIMES = ("submitted_at", "received_at")
"""What the names of columns of times end with."""


def to_dataframe(
    document: "Board | ScoreSheet | CheckReport | SimilarityReport | OneSubmission | "
    "Iterable[OneSubmission] | Iterable[SampleResult]",
    *,
    families: bool = False,
) -> "pd.DataFrame":
    """Return a document as a table.

    Args:
        document: A board: one row an entry, in the board's order. A score sheet, of `evaluate_file`
            or of a submission: rows `all`, `family` and `task` by id, as a two-level index.
            A check report: one row a kind of fault. A report of similar submissions: one row a pair of teams' submissions. Submissions, one or
            many or none: one row each, with the totals of those that are scored. What `evaluate_samples` gives: one row a sample.
        families: For a board: one row an entry and family instead.

    Raises:
        InvalidArgumentError: It is none of these, or the extra `data` is missing.
    """
    try:
        import pandas as pd
    except ModuleNotFoundError:
        raise extra_missing("Tables need pandas.", "data") from None
    if isinstance(document, Board):
        make_rows = _family_rows if families else _entry_rows
        told = (document.phase, document.board, document.protocol.version)
        named = dict(zip(_OF_BOARDS, told, strict=True))
        rows = [named | row for row in make_rows(document.entries)]
        columns = None if rows else _OF_FAMILIES if families else _OF_ENTRIES
        return _with_types(pd.DataFrame(rows, columns=columns))
    if isinstance(document, ScoreSheet):
        by_id = {(level, key): row for level, key, row in _sheet_rows(document)}
        index = pd.MultiIndex.from_tuples(list(by_id), names=["level", "id"])
        return _with_types(pd.DataFrame(list(by_id.values()), index=index))
    if isinstance(document, CheckReport):
        kinds = (group.model_dump(mode="json", exclude={"examples"}) for group in document.faults)
        columns = [name for name in FaultGroup.model_fields if name != "examples"]
        return pd.DataFrame(list(kinds), columns=columns)
    if isinstance(document, SimilarityReport):
        return _with_types(pd.DataFrame(list(_pair_rows(document))))
    if isinstance(document, OneSubmission):
        document = [document]
    given: object = document  # whatever a caller without type checks gives
    records = list(given) if isinstance(given, Iterable) else [given]
    if records and all(isinstance(each, SampleResult) for each in records):
        return pd.DataFrame(records, columns=list(SampleResult._fields))
    views = [
        each if isinstance(each, SubmissionView) else each.view
        for each in records
        if isinstance(each, OneSubmission)
    ]
    if len(views) < len(records) or isinstance(given, str | bytes | Mapping):
        raise InvalidArgumentError(
            "wrong_argument",
            f"{_named_type(given)} is nothing that becomes a table.",
            "Tables are made of a board, a score sheet, a check report, a report of similar "
            "submissions, submissions, and what evaluate_samples gives.",
        )
    if not views:
        return _with_types(pd.DataFrame(columns=_OF_ALL))
    return _with_types(pd.DataFrame([_submission_row(view) for view in views]))


def _named_type(given: object) -> str:
    """Name a type; of a list or tuple also that of what it holds."""
    kinds = (
        sorted({type(each).__name__ for each in given}) if isinstance(given, list | tuple) else []
    )
    return type(given).__name__ + (f" of {', '.join(kinds)}" if kinds else "")


def _with_types(table: "pd.DataFrame") -> "pd.DataFrame":
    """Give times a time zone, and ranks a type that knows of missing ones."""
    import pandas as pd

    for name in [name for name in table.columns if name.endswith(_ENDS_OF_TIMES)]:
        table[name] = pd.to_datetime(table[name], utc=True)
    for name in {"rank", "rank_low", "rank_high", "n"}.intersection(table.columns):
        table[name] = table[name].astype("Int64")
    return table


def _entry_rows(entries: Iterable[BoardEntry]) -> Iterator[Row]:
    for entry in entries:
        low, high = entry.rank_interval or (None, None)
        row: Row = {"rank": entry.rank, "rank_low": low, "rank_high": high}
        row |= {"method": entry.method, "team": entry.team, "source": entry.source}
        row |= {**entry.micro, **entry.metrics}  # of controls the mean of samples tells alone
        for key, interval in entry.intervals.items():
            row[f"{key}_low"], row[f"{key}_high"] = interval or (None, None)
        row |= {f"coverage_{key}": share for key, share in entry.coverage.items()}
        row["flags"] = ", ".join(flag.label for flag in entry.flags)
        row |= {"is_late": entry.is_late, "unranked_because": entry.unranked_because}
        yield row | {"submission_id": entry.submission_id, "submitted_at": entry.submitted_at}


def _family_rows(entries: Iterable[BoardEntry]) -> Iterator[Row]:
    for entry in entries:
        for family, cell in entry.families.items():
            row: Row = {"method": entry.method, "team": entry.team, "source": entry.source}
            row |= {"submission_id": entry.submission_id, "family": family, "n": cell.n}
            yield row | cell.metrics


def _sheet_rows(sheet: ScoreSheet) -> Iterator[tuple[str, str, Row]]:
    for key in AGGREGATES:
        yield "all", key, {"n": sheet.n, **getattr(sheet, key)}
    levels: Mapping[str, Any] = {"family": sheet.families, "task": sheet.tasks}
    for level, rows in levels.items():
        for key, row in rows.items():
            yield level, key, {"n": row.n, **row.metrics}


def _pair_rows(report: SimilarityReport) -> Iterator[Row]:
    for pair in report.pairs:
        told = pair.model_dump(mode="json", exclude={"first", "second"})
        yield told | _name_columns("first", pair.first) | _name_columns("second", pair.second)


def _name_columns(name: str, submission: SubmissionOfTeam) -> Row:
    return {f"{name}_{key}": value for key, value in dict(submission).items()}


def _submission_row(view: SubmissionView) -> Row:
    row: Row = {name: getattr(view, name) for name in _OF_ALL}
    row["status"] = view.status.value
    if view.sheet is not None:
        for key in AGGREGATES:
            row |= {f"{name}_{key}": number for name, number in getattr(view.sheet, key).items()}
    return row
