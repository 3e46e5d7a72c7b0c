"""The checker: records, files and what clients were told must tell one story.

It knows nothing of which fault was injected, and reads no process and no broker.
"""

import json
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import lru_cache

from sqlalchemy import select
from tests.chaos.checker_boards import audited, boards_now
from tests.chaos.checker_told import board_as_told, boards_seen, endings_stay, scores_stay
from tests.chaos.history import History
from tests.chaos.topology import MAX_ATTEMPTS
from tests.support.work import unfinished

from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import Violation
from exceptiondrive_records.operations import invariants
from exceptiondrive_records.operations.invariants import damaged_uploads, violations
from exceptiondrive_records.phases.quotas import COSTS_NOTHING
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.submission import SubmissionStatus

_LIMIT_BYTES = 2**26
_MAY_COME_AGAIN = (SubmissionStatus.WITHDRAWN, SubmissionStatus.FAILED)
_QUOTA_USED_UP = 429
# One text is one board with one digest: each is read once, however many faults
# come after it; 256 of them take some 200 MB.
invariants.board_in = lru_cache(256)(invariants.board_in)


def check(
    database: Database, files: FileStore, history: History, *, is_settled: bool = True
) -> list[Violation]:
    """Return every broken promise; `is_settled` asks also that nothing is left to do."""
    with database.read() as session:
        found = violations(session)
        found += damaged_uploads(session, files, limit_bytes=_LIMIT_BYTES)
        found += audited(session, history)
        if is_settled:
            found += unfinished(session)
            found += boards_now(session)
        rows = list(session.scalars(select(Submission)))
        jobs = list(session.scalars(select(Job).where(Job.attempts > MAX_ATTEMPTS)))
        teams = {team.id: team.slug for team in session.scalars(select(Team))}
        phases = {phase.id: phase for phase in session.scalars(select(Phase))}
        flips = select(BoardFlip.at, BoardRow).join(BoardRow).order_by(BoardFlip.id)
        shown, boards = defaultdict[str, list[int]](list), dict[int, str]()
        for at, board in session.execute(flips):
            shown[board.phase_id].append(board.number)
            boards.setdefault(board.id, board_as_told(board, at))
        sheets = {
            (row.submission_id, row.protocol_digest, row.split_revision): json.loads(
                row.sheet.model_dump_json(by_alias=True)
            )
            for row in session.scalars(select(ScoreSheetRow))
        }
    found += _accepted_is_kept(history, rows, teams)
    found += _refused_leaves_nothing(history, rows, teams)
    found += _refused_for_a_reason(history, rows, phases, teams)
    found += _everything_answered(history, rows, teams)
    found += _nothing_from_nowhere(history, rows, teams)
    found += _same_bytes_once(rows)
    found += _quota(rows, phases)
    found += _attempts(jobs)
    found += endings_stay(history, rows)
    found += scores_stay(history, sheets)
    found += boards_seen(history.boards, set(boards.values()), shown)
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
        elif row.method != call.method and call.status == 202:
            yield Violation("accepted as another", row.id, f"sent as method {call.method}")


def _refused_leaves_nothing(
    history: History, rows: list[Submission], teams: dict[int, str]
) -> Iterator[Violation]:
    """A refused upload left no row, unless another try of the same bytes may have been taken."""
    may_be_there = {(c.team, c.file_digest) for c in history.calls if not c.is_refused}
    refused = {(c.team, c.file_digest) for c in history.calls if c.is_refused} - may_be_there
    for row in rows:
        if (teams[row.team_id], row.file_digest) in refused:
            yield Violation("refused and kept", row.id, f"of {teams[row.team_id]}")


def _refused_for_a_reason(
    history: History, rows: list[Submission], phases: dict[str, Phase], teams: dict[int, str]
) -> Iterator[Violation]:
    """Clients send sound files with good tokens: only a quota that is used up may refuse one."""
    used = _used(rows).items()
    full = {teams[team] for (phase, team, _), n in used if n >= phases[phase].quota_per_day}
    for call in history.calls:
        if call.is_refused and not (call.status == _QUOTA_USED_UP and call.team in full):
            yield Violation("sound file refused", call.file_digest, f"{call.team}: {call.status}")


def _everything_answered(
    history: History, rows: list[Submission], teams: dict[int, str]
) -> Iterator[Violation]:
    """Who sends a file again and again is told in the end what became of it."""
    there = {(teams[row.team_id], row.file_digest) for row in rows}
    for call in history.given_up:
        what = "taken" if (call.team, call.file_digest) in there else "not taken"
        text = f"{call.team}: {call.status} to the last, and it was {what}"
        yield Violation("never answered", call.file_digest, text)


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


def _used(rows: list[Submission]) -> Counter[tuple[str, int, object]]:
    """What each team used of its quota: by phase, team and day."""
    costly = (row for row in rows if row.status not in COSTS_NOTHING)
    return Counter((row.phase_id, row.team_id, row.received_at.date()) for row in costly)


def _quota(rows: list[Submission], phases: dict[str, Phase]) -> Iterator[Violation]:
    for (phase_id, team_id, day), times in _used(rows).items():
        if times > phases[phase_id].quota_per_day:
            yield Violation("quota exceeded", phase_id, f"{times} of team {team_id} on {day}")


def _attempts(jobs: list[Job]) -> Iterator[Violation]:
    for job in jobs:
        text = f"{job.attempts} attempts, {MAX_ATTEMPTS} are allowed"
        yield Violation("too many attempts", job.submission_id, text)
