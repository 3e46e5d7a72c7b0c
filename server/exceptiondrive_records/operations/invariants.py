"""Check invariants of records and files, which always hold, however often processes died.

Read-only. `exceptiondrive-server verify` and `restore` report violations, and the fault suite checks
them after every fault (docs/faults.md).
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError
from pydantic_core import from_json
from sqlalchemy import Enum, Text, exists, select, type_coerce
from sqlalchemy.orm import Session, defer

from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.documents import collector_at_rest
from exceptiondrive_records.boards.tables import BoardEntryRow, BoardFlip, BoardRow
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText
from exceptiondrive_records.db.errors import Conflict, NotFound, StoreError, Violation
from exceptiondrive_records.operations.dump import file_digests
from exceptiondrive_records.operations.unlogged import (
    unlogged_disqualifications,
    unlogged_flips,
    unlogged_forgetting,
    unlogged_settings,
    unlogged_submissions,
)
from exceptiondrive_records.phases.scoring_keys import IS_TWO_SIDED, ScoringKey
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.protocols.tables import ProtocolRow
from exceptiondrive_records.rescoring.progress import left_out
from exceptiondrive_records.splits.drawings import shown_of_withheld_splits
from exceptiondrive_records.submissions.file_store import FileDamaged, FileStore, FileUnreadable
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus as Status
from exceptiondrive_schemas.base import bytes_digest, content_digest
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.protocol import ProtocolError
from exceptiondrive_schemas.score_sheet import MetricRow

# Invariants of boards: each is a pure function of score sheets under one protocol.


_SheetKey = tuple[str, str, str]
_Totals = tuple[MetricRow, MetricRow]
"""Both aggregates of a sheet, read once: boards repeat their entries."""


def broken_boards(session: Session) -> Iterator[Violation]:
    """Yield violations by boards and by the pointers to them."""
    query = select(BoardRow).order_by(BoardRow.phase_id, BoardRow.number)
    last: dict[str, int] = {}
    totals: dict[_SheetKey, _Totals | None] = {}
    references: dict[_SheetKey, MetricRow] = {}
    for row in session.scalars(query.execution_options(yield_per=1)):
        subject = f"{row.phase_id}/{row.number}"
        if row.number != last.get(row.phase_id, 0) + 1:
            yield Violation("board number skipped", subject, "a board is missing before it")
        last[row.phase_id] = row.number
        for rule, text in _faults(session, row, totals, references):
            yield Violation(rule, subject, text)
    yield from _pointers(session)


def board_in(body: str) -> Board:
    """Parse the recorded text of a board, as strictly as any document.

    Raises:
        ValidationError: The text is no valid board.
    """
    return Board.model_validate_json(body)


def _faults(
    session: Session,
    row: BoardRow,
    totals: dict[_SheetKey, _Totals | None],
    references: dict[_SheetKey, MetricRow],
) -> Iterator[tuple[str, str]]:
    try:
        board = board_in(row.body)
    except ValidationError:
        yield "board unreadable", "its body is not a board"
        return
    if _digests(row.body) != (row.body_digest, row.digest):
        yield "board altered", "its bytes do not have the recorded digest"
    if (board.protocol.digest, board.split.revision) != (row.protocol_digest, row.split_revision):
        yield "board of another protocol", "body and row name different ones"
    for entry in board.entries:
        if entry.submission_id is not None:
            key = (entry.submission_id, row.protocol_digest, row.split_revision)
            if key not in totals:
                totals[key] = _totals(session, key)
            yield from _entry_faults(entry, board, totals[key])
        elif entry.source == "reference":
            yield from _reference_faults(entry, row, references)
    yield from _rank_faults(board)
    kept = select(BoardEntryRow.submission_id, BoardEntryRow.rank)
    rows = {
        (id, rank) for id, rank in session.execute(kept.where(BoardEntryRow.board_id == row.id))
    }
    shown = {(e.submission_id, e.rank) for e in board.entries if e.submission_id is not None}
    if rows != shown:
        yield "entries of a board altered", "the table of entries and the body name different ones"


def _digests(body: str) -> tuple[str, str]:
    """Return the digests of a recorded text as it is: it may lack fields of later releases."""
    said = from_json(body)
    del said["board"], said["published_at"]
    return bytes_digest(body.encode()), content_digest(said)


def _totals(session: Session, key: _SheetKey) -> _Totals | None:
    row = session.get(ScoreSheetRow, key)
    return None if row is None else (row.sheet.micro, row.sheet.macro_family)


def _entry_faults(
    entry: BoardEntry, board: Board, of_sheet: _Totals | None
) -> Iterator[tuple[str, str]]:
    if of_sheet is None:
        yield "entry without a sheet", f"{entry.submission_id} under the board's protocol"
        return
    if (entry.micro, entry.macro_family) != of_sheet:
        yield "entry is not its sheet", str(entry.submission_id)
    if entry.metrics != (entry.micro if board.headline == "micro" else entry.macro_family):
        yield "entry shows another aggregate", str(entry.submission_id)


def _reference_faults(
    entry: BoardEntry, row: BoardRow, references: dict[_SheetKey, MetricRow]
) -> Iterator[tuple[str, str]]:
    """Check that boards of a split and protocol agree on a reference, which depends on these only.

    A board of an older release may lack metrics of later ones.
    """
    said = references.setdefault(
        (entry.method, row.protocol_digest, row.split_revision), entry.metrics
    )
    if any(said[key] != entry.metrics[key] for key in said.keys() & entry.metrics.keys()):
        yield "reference altered", f"{entry.method} differs from an earlier board's"


def _rank_faults(board: Board) -> Iterator[tuple[str, str]]:
    """Check ranks (1, 2, 2, 4): each is one more than the number of entries above it."""
    ranked = [entry.rank for entry in board.entries if entry.rank is not None]
    in_order = sorted(ranked)
    for entry in board.entries:
        if entry.rank is None:
            continue
        if all(value is None for value in entry.metrics.values()):
            yield "rank without a score", str(entry.submission_id)
        if entry.source != "scored":
            yield "rank of an unscored row", entry.method
        if entry.rank != 1 + bisect_left(in_order, entry.rank):
            yield "ranks do not follow", f"{entry.submission_id} has rank {entry.rank}"
    if ranked != in_order:
        yield "ranks do not follow", "entries stand out of order"


def _pointers(session: Session) -> Iterator[Violation]:
    for phase in session.scalars(select(Phase).where(Phase.current_board_id.is_not(None))):
        row = session.get(BoardRow, phase.current_board_id)
        if row is None or row.phase_id != phase.id:
            yield Violation("current board missing", phase.id, "the pointer leads nowhere")
        elif row.protocol_digest != phase.protocol_digest:
            yield Violation("current board of another protocol", phase.id, f"board {row.number}")
        else:
            flips = select(BoardFlip.board_id).where(BoardFlip.phase_id == phase.id)
            if session.scalar(flips.order_by(BoardFlip.id.desc()).limit(1)) != row.id:
                yield Violation("shown by nobody", phase.id, f"board {row.number}: no flip says so")


_JOB_STATES_OF = {
    Status.RECEIVED: {WorkState.QUEUED},
    Status.QUEUED: {WorkState.QUEUED},
    Status.SCORING: {WorkState.LEASED},
    Status.SCORED: {WorkState.DONE},
    Status.REJECTED: {WorkState.DONE},
    Status.FAILED: {WorkState.FAILED, WorkState.DEAD},
    Status.WITHDRAWN: {WorkState.CANCELLED, WorkState.DONE},
}
_SHEET_KEY = (
    ScoreSheetRow.submission_id,
    ScoreSheetRow.protocol_digest,
    ScoreSheetRow.split_revision,
)


@dataclass(frozen=True)
class _Held:
    """Submissions, jobs and sheets, read in one transaction."""

    submissions: dict[str, Submission]
    reported: set[str]
    """Submissions with a report of faults; `unreadable_rows` checks the reports themselves."""
    jobs: list[Job]
    sheets: set[tuple[str, str, str]]


def violations(session: Session) -> list[Violation]:
    """Return all violations of invariants in the records.

    An unreadable row is a violation; rules that it interrupts are reported as broken off.
    """
    rules: tuple[Callable[[Session], Iterable[Violation]], ...] = (
        unreadable_rows,
        _submissions_and_jobs,
        _stand_on_the_board,
        _scored_once,
        _same_bytes_same_scores,
        _protocols,
        _audit_chain,
        broken_boards,
        unlogged_forgetting,
        unlogged_submissions,
        unlogged_disqualifications,
        unlogged_settings,
        unlogged_flips,
        shown_of_withheld_splits,
    )
    found: list[Violation] = []
    for rule in rules:
        try:
            with collector_at_rest():
                found.extend(rule(session))
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            subject = rule.__name__.strip("_").replace("_", " ")
            text = f"{type(error).__name__}: repair the rows that cannot be read, then verify again"
            found.append(Violation("rule broken off", subject, text))
    return found


def unreadable_rows(session: Session) -> Iterator[Violation]:
    """Check in every table that documents are valid and states are known."""
    for table in Base.metadata.sorted_tables:
        keys = table.primary_key.columns
        for column in table.columns:
            if not isinstance(column.type, DocumentText | Enum):
                continue
            told = type_coerce(column, Text)
            query = select(told, *keys).where(column.is_not(None))
            for text, *key in session.execute(query.execution_options(yield_per=100)):
                if not _is_read(column.type, text):
                    subject = "/".join([table.name, *map(str, key)])
                    yield Violation("row unreadable", subject, f"its {column.name}")


def _is_read(kind: DocumentText[Any] | Enum, text: str) -> bool:
    if isinstance(kind, Enum):
        return text in kind.enums
    try:
        kind.model.model_validate_json(text)
    except ValidationError:
        return False
    return True


def _submissions_and_jobs(session: Session) -> Iterator[Violation]:
    without_report = select(Submission).options(defer(Submission.report))
    held = _Held(
        submissions={row.id: row for row in session.scalars(without_report)},
        reported=set(session.scalars(select(Submission.id).where(Submission.report.is_not(None)))),
        jobs=list(session.scalars(select(Job))),
        sheets={(key[0], key[1], key[2]) for key in session.execute(select(*_SHEET_KEY))},
    )
    for rule in (_first_jobs, _leases, _sheets_of_jobs, _status_violations):
        yield from rule(held)


def damaged_uploads(session: Session, files: FileStore, *, limit_bytes: int) -> list[Violation]:
    """Read every file that the records mention; return missing or damaged ones, with owners."""
    found = []
    for digest in file_digests(session):
        try:
            files.read(digest, limit_bytes=limit_bytes)
        except NotFound:
            found.append(Violation("upload missing", digest, _owner_of_file(session, digest)))
        except FileDamaged:
            text = f"the bytes are not those sent; {_owner_of_file(session, digest)}"
            found.append(Violation("upload damaged", digest, text))
        except StoreError as error:
            found.append(Violation("store unreadable", digest, str(error)))
            if not isinstance(error, FileUnreadable):
                break  # the store does not answer for other files either
    return found


def _owner_of_file(session: Session, digest: str) -> str:
    ids = session.scalars(select(Submission.id).where(Submission.file_digest == digest))
    named = ", ".join(sorted(ids))
    return f"the file of {named}" if named else "shown of a public split, not sent by a team"


def _first_jobs(held: _Held) -> Iterator[Violation]:
    """Check that every submission has exactly one first job, and its outcome as status."""
    first = Counter(job.submission_id for job in held.jobs if job.is_first)
    for submission_id in held.submissions:
        if first[submission_id] != 1:
            text = f"has {first[submission_id]} first jobs, not one"
            yield Violation("not exactly one job", submission_id, text)
    for job in held.jobs:
        submission = held.submissions.get(job.submission_id)
        if submission is None:
            yield Violation("job without submission", job.submission_id, f"job {job.id}")
        elif job.is_first and job.state not in _JOB_STATES_OF[submission.status]:
            text = f"is {submission.status}, but its job is {job.state}"
            yield Violation("status is not that of the job", submission.id, text)


def _leases(held: _Held) -> Iterator[Violation]:
    for job in held.jobs:
        if (job.state is WorkState.LEASED) != (job.lease_until is not None):
            yield Violation("lease and state differ", job.submission_id, f"job is {job.state}")
        if job.state.is_final != (job.finished_at is not None):
            yield Violation("end and state differ", job.submission_id, f"job is {job.state}")


def _sheets_of_jobs(held: _Held) -> Iterator[Violation]:
    """Check that every sheet comes from a finished job, and that scored submissions have one."""
    done = {
        (job.submission_id, job.protocol_digest, job.split_revision)
        for job in held.jobs
        if job.state is WorkState.DONE
    }
    for key in held.sheets - done:
        yield Violation("sheet without a finished job", key[0], f"under {key[1]}")
    for job in held.jobs:
        key = (job.submission_id, job.protocol_digest, job.split_revision)
        submission = held.submissions.get(job.submission_id)
        is_scored = submission is not None and submission.status is Status.SCORED
        if job.is_first and is_scored and key not in held.sheets:
            yield Violation("scored without a sheet", job.submission_id, f"under {key[1]}")


def _status_violations(held: _Held) -> Iterator[Violation]:
    """Check that rejected means a report and no sheet, failed a code, and withdrawn a time."""
    scored = {submission_id for submission_id, _, _ in held.sheets}
    for row in held.submissions.values():
        if row.status is Status.REJECTED and (row.id not in held.reported or row.id in scored):
            yield Violation("rejected without a report", row.id, "or with a score sheet")
        if (row.status is Status.FAILED) != (row.failure_code is not None):
            yield Violation("failure and status differ", row.id, f"is {row.status}")
        if (row.status is Status.WITHDRAWN) != (row.withdrawn_at is not None):
            yield Violation("withdrawal and status differ", row.id, f"is {row.status}")


def _stand_on_the_board(session: Session) -> Iterator[Violation]:
    """Check that all are, or will be, scored under what their phase shows, but for open updates."""
    shown = select(Phase.id, Phase.protocol_digest, Phase.split_revision)
    for phase_id, *key in session.execute(shown.where(~exists().where(IS_TWO_SIDED))).all():
        found = left_out(phase_id, ScoringKey(*key))
        for row in session.execute(found.with_only_columns(Submission.id, Submission.status)):
            text = f"is {row.status}, without sheet or job under {key[0]}"
            yield Violation("stands on no board", row.id, text)


def _scored_once(session: Session) -> Iterator[Violation]:
    """Check that each submission and protocol has as many "scored" audit lines as sheets."""
    lines = session.scalars(select(AuditLine).where(AuditLine.action == "submission scored"))
    said = Counter((line.subject, str(line.detail.get("protocol"))) for line in lines)
    kept = Counter((key[0], key[1]) for key in session.execute(select(*_SHEET_KEY)))
    for key in sorted(said.keys() | kept.keys()):
        if said[key] != kept[key]:
            text = f"{kept[key]} sheets, {said[key]} audit lines under {key[1]}"
            yield Violation("not scored exactly once", key[0], text)


def _same_bytes_same_scores(session: Session) -> Iterator[Violation]:
    query = select(
        Submission.file_digest,
        ScoreSheetRow.protocol_digest,
        ScoreSheetRow.split_revision,
        ScoreSheetRow.scorer_version,
        ScoreSheetRow.exact_digest,
    ).join(ScoreSheetRow, ScoreSheetRow.submission_id == Submission.id)
    seen: dict[tuple[str, ...], str] = {}
    for *key, exact_digest in session.execute(query):
        if seen.setdefault(tuple(key), exact_digest) != exact_digest:
            yield Violation("same bytes, other scores", key[0], f"under {key[1]}")
    alarms = select(AuditLine.subject).where(AuditLine.action == "scores differ for one key")
    for subject in session.scalars(alarms):
        yield Violation("same bytes, other scores", subject, "a worker said so")


def _protocols(session: Session) -> Iterator[Violation]:
    for digest in session.scalars(select(ProtocolRow.digest)):
        try:
            find_protocol(session, digest)
        except (Conflict, ProtocolError) as error:
            yield Violation("protocol altered", digest, str(error))


def _audit_chain(session: Session) -> Iterator[Violation]:
    verdict = verify_audit(session)
    if not verdict.is_whole:
        yield Violation("audit chain broken", f"line {verdict.broken_at}", "or a line before it")
