"""The checker: records, files and what clients were told must tell one story.

It knows nothing of which fault was injected, and reads no process and no broker.
"""

import json
from collections import Counter
from collections.abc import Iterator

from sqlalchemy import select
from tests.chaos.history import BoardSeen, History

from exceptiondrive_records.database import Database
from exceptiondrive_records.file_store import FileStore
from exceptiondrive_records.invariants import damaged_uploads, unfinished, violations
from exceptiondrive_records.quotas import COSTS_NOTHING
from exceptiondrive_records.tables import BoardRow, Phase, ScoreSheetRow, Submission, Team
from exceptiondrive_records.violations import Violation
from exceptiondrive_schemas.submission import SubmissionStatus

_LIMIT_BYTES = 2**26
_MAY_COME_AGAIN = (SubmissionStatus.WITHDRAWN, SubmissionStatus.FAILED)
_TERMINAL = {status.value for status in SubmissionStatus if status.is_terminal}
_FINAL_FOR_CLIENTS = _TERMINAL - {SubmissionStatus.WITHDRAWN.value}


def check(
    database: Database, files: FileStore, history: History, *, is_settled: bool = True
) -> list[Violation]:
    """Return every broken promise; `is_settled` asks also that nothing is left to do."""
    with database.read() as session:
        found = violations(session)
        found += damaged_uploads(session, files, limit_bytes=_LIMIT_BYTES)
        if is_settled:
            found += unfinished(session)
        rows = list(session.scalars(select(Submission)))
        teams = {team.id: team.slug for team in session.scalars(select(Team))}
        phases = {phase.id: phase for phase in session.scalars(select(Phase))}
        boards = {row.body for row in session.scalars(select(BoardRow))}
        hccs = {
            row.submission_id: row.sheet.macro_family.get("hcc")
            for row in session.scalars(select(ScoreSheetRow))
        }
    found += _accepted_is_kept(history, rows, teams)
    found += _refused_leaves_nothing(history, rows, teams)
    found += _nothing_from_nowhere(history, rows, teams)
    found += _same_bytes_once(rows)
    found += _quota(rows, phases)
    found += _endings_stay(history, rows)
    found += _scores_stay(history, hccs)
    found += _boards_seen(history.boards, boards)
    return sorted(set(found))


def _accepted_is_kept(
    history: History, rows: list[Submission], teams: dict[int, str]
) -> Iterator[Violation]:
    """Every accepted upload has a row, its own, for ever."""
    by_id = {row.id: row for row in rows}
    for call in history.calls:
        if not call.is_accepted:
            continue
        row = by_id.get(call.submission_id or "")
        if row is None:
            yield Violation("accepted and lost", str(call.submission_id), f"{call.status} was said")
        elif (teams[row.team_id], row.file_digest) != (call.team, call.file_digest):
            yield Violation("accepted as another", row.id, f"told to {call.team}")


def _refused_leaves_nothing(
    history: History, rows: list[Submission], teams: dict[int, str]
) -> Iterator[Violation]:
    """A refused upload left no row, unless another try of the same bytes may have been taken."""
    may_be_there = {(c.team, c.file_digest) for c in history.calls if not c.is_refused}
    refused = {(c.team, c.file_digest) for c in history.calls if c.is_refused} - may_be_there
    for row in rows:
        if (teams[row.team_id], row.file_digest) in refused:
            yield Violation("refused and kept", row.id, f"of {teams[row.team_id]}")


def _nothing_from_nowhere(
    history: History, rows: list[Submission], teams: dict[int, str]
) -> Iterator[Violation]:
    sent = {(call.team, call.file_digest) for call in history.calls}
    for row in rows:
        if (teams[row.team_id], row.file_digest) not in sent:
            yield Violation("nobody sent it", row.id, f"of {teams[row.team_id]}")


def _same_bytes_once(rows: list[Submission]) -> Iterator[Violation]:
    standing = (row for row in rows if row.status not in _MAY_COME_AGAIN)
    count = Counter((row.phase_id, row.team_id, row.file_digest) for row in standing)
    for (phase_id, _, digest), times in count.items():
        if times > 1:
            yield Violation("same bytes taken twice", digest, f"{times} times in {phase_id}")


def _quota(rows: list[Submission], phases: dict[str, Phase]) -> Iterator[Violation]:
    costly = (row for row in rows if row.status not in COSTS_NOTHING)
    used = Counter((row.phase_id, row.team_id, row.received_at.date()) for row in costly)
    for (phase_id, team_id, day), times in used.items():
        if times > phases[phase_id].quota_per_day:
            yield Violation("quota exceeded", phase_id, f"{times} of team {team_id} on {day}")


def _endings_stay(history: History, rows: list[Submission]) -> Iterator[Violation]:
    """Who was told an ending is never told another status, and the records say the same."""
    told: dict[str, str] = {}
    for seen in sorted(history.sightings, key=lambda seen: seen.at_s):
        before = told.get(seen.submission_id)
        if before in _FINAL_FOR_CLIENTS and seen.status not in (before, "withdrawn"):
            yield Violation("ending changed", seen.submission_id, f"{before}, then {seen.status}")
        told[seen.submission_id] = seen.status
    for row in rows:
        said = told.get(row.id)
        if said in _FINAL_FOR_CLIENTS and row.status.value not in (said, "withdrawn"):
            yield Violation("ending changed", row.id, f"{said} was told, records: {row.status}")


def _scores_stay(history: History, hccs: dict[str, float | None]) -> Iterator[Violation]:
    for seen in history.sightings:
        if seen.hcc is not None and hccs.get(seen.submission_id) != seen.hcc:
            yield Violation("score changed", seen.submission_id, f"{seen.hcc} was told")


def _boards_seen(seen: list[BoardSeen], kept: set[str]) -> Iterator[Violation]:
    """Every board that was shown is one of the records, byte for byte, and never went back."""
    last: dict[str, int] = {}
    bodies: dict[str, bytes] = {}
    for board in sorted(seen, key=lambda board: board.at_s):
        document = json.loads(board.body)
        phase, number = document["phase"], document["board"]
        if board.body.decode() not in kept:
            yield Violation("board not on the records", phase, f"number {number} was shown")
        if bodies.setdefault(board.etag, board.body) != board.body:
            yield Violation("one tag, two boards", phase, board.etag)
        if number < last.get(phase, 0):
            yield Violation("board went back", phase, f"{last[phase]}, then {number}")
        last[phase] = number
