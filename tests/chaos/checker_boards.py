"""When nothing is left to do: the boards that stand, and the lines that tell how it came to them.

Nothing of the product's own choice of entries is asked here: what should stand on a board is
worked out anew.
"""

from collections import Counter
from collections.abc import Iterator

from pydantic import ValidationError
from sqlalchemy import func, select
from sqlalchemy.orm import Session
from tests.chaos.history import History

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.boards import BOARD_LINES, current_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.errors import Conflict, Violation
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_schemas.api.phase_settings import PhasePolicy
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.protocol import ProtocolDocument, ProtocolError


def boards_now(session: Session) -> Iterator[Violation]:
    """Each phase shows its newest board, with the latest score of every method, the best first."""
    for phase in session.scalars(select(Phase)):
        if phase.policy != PhasePolicy():
            continue  # what such a phase shows depends on the day
        row, due = current_board(session, phase.id), _due(session, phase)
        if row is None:
            if due:
                yield Violation("scores without a board", phase.id, f"{len(due)} entries are due")
            continue
        if row.number != _newest(session, phase):
            yield Violation("not the newest board", phase.id, f"number {row.number} is shown")
        try:
            board = Board.model_validate_json(row.body)
            protocol = find_protocol(session, phase.protocol_digest)
        except (ValidationError, Conflict, ProtocolError):
            continue  # which is a violation of its own, and named as such
        yield from _entries(board, due)
        yield from _order(board, protocol)


def _due(session: Session, phase: Phase) -> set[str]:
    """The latest scored submission of each method of each team."""
    query = (
        select(Submission)
        .join(ScoreSheetRow, ScoreSheetRow.submission_id == Submission.id)
        .where(
            Submission.phase_id == phase.id,
            Submission.status == SubmissionStatus.SCORED,
            ScoreSheetRow.protocol_digest == phase.protocol_digest,
            ScoreSheetRow.split_revision == phase.split_revision,
        )
        .order_by(Submission.received_at, Submission.id)
    )
    latest = {(row.team_id, row.method): row.id for row in session.scalars(query)}
    return set(latest.values())


def _newest(session: Session, phase: Phase) -> int | None:
    query = select(func.max(BoardRow.number)).where(
        BoardRow.phase_id == phase.id,
        BoardRow.protocol_digest == phase.protocol_digest,
        BoardRow.split_revision == phase.split_revision,
        BoardRow.view == "main",
    )
    return session.scalar(query)


def _entries(board: Board, due: set[str]) -> Iterator[Violation]:
    shown = Counter(entry.submission_id for entry in board.entries if entry.submission_id)
    for submission_id in due - set(shown):
        yield Violation("missing on the board", submission_id, f"of {board.phase}/{board.board}")
    for submission_id, times in shown.items():
        if submission_id not in due or times > 1:
            text = f"{times} times on {board.phase}/{board.board}"
            yield Violation("must not stand on the board", submission_id, text)


def _order(board: Board, protocol: ProtocolDocument) -> Iterator[Violation]:
    """A better value never has a worse rank, equal ones share theirs, a flag that bars it has none."""
    keys = protocol.ranking.order[board.challenge]

    def worth(entry: BoardEntry) -> tuple[float, ...]:
        values = [entry.metrics.get(key.metric) or 0.0 for key in keys]
        return tuple(
            -value if key.order == "descending" else value
            for key, value in zip(keys, values, strict=True)
        )

    ranked = [(worth(entry), entry) for entry in board.entries if entry.rank is not None]
    for _, entry in ranked:
        barred = {flag.code for flag in entry.flags} & set(protocol.ranking.unranked_flags)
        if barred:
            yield Violation("rank in spite of a flag", str(entry.submission_id), str(barred))
    for mine, entry in ranked:
        rank = 1 + sum(other < mine for other, _ in ranked)
        if entry.rank != rank:
            text = f"has rank {entry.rank}, its values give {rank}"
            yield Violation("rank is not that of the values", str(entry.submission_id), text)


def audited(session: Session, history: History) -> Iterator[Violation]:
    """What was taken and shown has its line, and no line that was seen once is another now."""
    wanted = {
        ("submission received",): Counter(session.scalars(select(Submission.id))),
        BOARD_LINES: Counter(session.scalars(select(BoardRow.phase_id))),
    }
    for actions, due in wanted.items():
        query = select(AuditLine.subject).where(AuditLine.action.in_(actions))
        lines = Counter(session.scalars(query))
        for subject in sorted(due.keys() | lines.keys()):
            if due[subject] != lines[subject]:
                text = f"{due[subject]} of it, {lines[subject]} lines say {' or '.join(actions)!r}"
                yield Violation("audit lines differ", subject, text)
    for number, head in history.audit_heads.items():
        line = session.get(AuditLine, number)
        if line is None or line.hash != head:
            yield Violation("audit chain rewritten", f"line {number}", "it had another hash before")
    last = session.scalars(select(AuditLine).order_by(AuditLine.id.desc()).limit(1)).first()
    if last is not None:
        history.audit_heads.setdefault(last.id, last.hash)
