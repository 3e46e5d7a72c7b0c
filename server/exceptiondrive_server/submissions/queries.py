"""What the pages of a submission read from the records."""

from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import entries_on
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.phases.policy import can_publish
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.challenges import CHALLENGES, Metric
from exceptiondrive_server.boards.query import AVERAGE_TITLES, OTHER_AVERAGE
from exceptiondrive_server.submissions.runs import PhaseRules
from exceptiondrive_server.submissions.view import FamilyLine, ScoreLine, families_of, scores_of


@dataclass(frozen=True)
class ScoreTables:
    """The score sheet of a submission, ready to be drawn; both tables are empty without one."""

    metrics: tuple[ScoreLine, ...]
    families: tuple[FamilyLine, ...]
    columns: tuple[Metric, ...]
    """Of the families."""
    headline_title: str
    """The average that ranks."""
    other_title: str


def score_tables(session: Session, seen: SubmissionView) -> ScoreTables:
    """Return the scores of a submission as its team sees it, with the intervals of the board."""
    phase = find_phase(session, seen.phase)
    protocol = find_protocol(session, phase.protocol_digest)
    entry = entries_on(session, phase.current_board_id).get(seen.id)
    headline = protocol.grading.headline
    return ScoreTables(
        metrics=scores_of(seen, protocol),
        families=families_of(seen, protocol, entry),
        columns=CHALLENGES[seen.challenge].columns,
        headline_title=AVERAGE_TITLES[headline],
        other_title=AVERAGE_TITLES[OTHER_AVERAGE[headline]],
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
