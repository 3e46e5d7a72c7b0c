"""Queries for the pages of a submission."""

from collections.abc import Iterable
from typing import NamedTuple

from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import current_board, parsed_board
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.policy import can_publish
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.board import FamilyCell
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge
from exceptiondrive_schemas.protocol import Average, ProtocolDocument
from exceptiondrive_server.boards.query import AVERAGE_TITLES, OTHER_AVERAGE
from exceptiondrive_server.submissions.runs import PhaseRules
from exceptiondrive_server.web.numbers import Digits


class ScoreTables(NamedTuple):
    """What the score sheet of a submission is drawn with."""

    protocol: ProtocolDocument
    challenge: Challenge
    digits: Digits
    families: dict[str, FamilyCell]
    """Of its entry on the board, which alone tells their intervals."""
    other_average: Average
    """Which does not rank."""
    titles: tuple[str, str]
    """Of the average that ranks, and of the other one."""


def score_tables(session: Session, seen: SubmissionView) -> ScoreTables:
    """Return what draws the scores of a submission as its team sees it."""
    phase = find_phase(session, seen.phase)
    protocol = find_protocol(session, phase.protocol_digest)
    row = current_board(session, phase.id)
    board = None if row is None else parsed_board(row)
    entry = board.entries_by_submission.get(seen.id) if board else None
    headline = protocol.grading.headline
    return ScoreTables(
        protocol=protocol,
        challenge=CHALLENGES[seen.challenge],
        digits=Digits.of(
            protocol.publication,
            has_fine_intervals=board is not None and board.has_fine_intervals,
        ),
        families=entry.families if entry else {},
        other_average=OTHER_AVERAGE[headline],
        titles=(AVERAGE_TITLES[headline], AVERAGE_TITLES[OTHER_AVERAGE[headline]]),
    )


def phase_rules(session: Session, phases: Iterable[Phase]) -> dict[str, PhaseRules]:
    """Return what a list of submissions needs of each phase."""
    return {
        phase.id: PhaseRules(
            phase.policy,
            find_protocol(session, phase.protocol_digest),
            can_publish(session, phase),
        )
        for phase in phases
    }
