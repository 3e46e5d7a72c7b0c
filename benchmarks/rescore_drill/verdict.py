"""What must hold when the drill has ended. Reads only the records and what the reader saw."""

import hashlib
from collections import Counter

from sqlalchemy import select
from sqlalchemy.orm import Session
from tests.support.records import count_audit_lines
from tests.support.work import unfinished

from benchmarks.rescore_drill.clients import Reader
from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.boards.boards import served_body
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.invariants import violations
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.protocol import ProtocolDocument


class NotProven(Exception):  # noqa: N818 - a verdict
    """The drill ended otherwise than it must."""


def demand(is_so: bool, sentence: str) -> None:
    """Raise the sentence unless it is so.

    Raises:
        NotProven: It is not.
    """
    if not is_so:
        raise NotProven(sentence)


def demand_end_state(
    database: Database, n_submissions: int, covered: list[ProtocolDocument], reader: Reader
) -> list[tuple[str, str]]:
    """Demand that nothing was lost, doubled, mixed or torn.

    Args:
        database: Of the drill.
        n_submissions: How many uploads were accepted.
        covered: Protocols under which each of them must have exactly one sheet.
        reader: Who looked at the board all the while.

    Returns:
        Lines for the report.

    Raises:
        NotProven: Something is not as it must be.
    """
    with database.read() as session:
        broken = [*violations(session), *unfinished(session)]
        demand(not broken, f"the records break a promise: {broken[:3]}")
        ids = set(session.scalars(select(Submission.id)))
        statuses = Counter(session.scalars(select(Submission.status)))
        demand(len(ids) == n_submissions, f"{len(ids)} of {n_submissions} uploads are recorded")
        demand(statuses == {SubmissionStatus.SCORED: len(ids)}, f"not all scored: {statuses}")
        n_sheets = _demand_coverage(session, ids, covered)
        differing = count_audit_lines(session, "scores differ for one key")
        demand(differing == 0, f"two scorings of one pair differ, {differing} times")
        verdict = verify_audit(session)
        demand(verdict.is_whole, f"the audit chain breaks at line {verdict.broken_at}")
        recorded = {
            hashlib.sha256(served_body(row).encode()).hexdigest()
            for row in session.scalars(select(BoardRow))
        }
    demand(not reader.torn, f"a reader saw something else than a board: {reader.torn[:3]}")
    demand(reader.digests <= recorded, "a reader saw a board that is not recorded")
    return [
        ("submissions, each scored once", f"{len(ids)}"),
        ("sheets under each protocol", " + ".join([str(len(ids))] * len(covered))),
        ("sheets, one for each pair", f"{n_sheets}"),
        ("boards read, none torn or unknown", f"{reader.n_read:,}"),
        ("audit lines, chain whole", f"{verdict.n_lines:,}"),
    ]


def _demand_coverage(session: Session, ids: set[str], covered: list[ProtocolDocument]) -> int:
    """Each submission has one sheet and one job under each protocol; no pair has two."""
    for protocol in covered:
        query = select(ScoreSheetRow.submission_id)
        found = set(session.scalars(query.where(ScoreSheetRow.protocol_digest == protocol.digest)))
        missing = len(ids - found)
        demand(not missing, f"{missing} sheets under protocol {protocol.version} are missing")
    keys = Counter(
        (job.submission_id, job.protocol_digest, job.split_revision)
        for job in session.scalars(select(Job))
    )
    demand(max(keys.values()) == 1, "a pair was queued twice")
    n_sheets = len(session.scalars(select(ScoreSheetRow.submission_id)).all())
    demand(n_sheets == len(ids) * len(covered), f"{n_sheets} sheets for {len(ids)} submissions")
    return n_sheets
