"""End a freeze and the later deadlines that end with a reveal, and notify teams of both."""

from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import checked_reason
from exceptiondrive_records.notifications.inbox import tell_team
from exceptiondrive_records.phases.allowances import allowance_of, is_revealed, running_deadlines
from exceptiondrive_records.phases.policy import own_deadline
from exceptiondrive_records.phases.scoring_keys import key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.progress import fresh_board
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import teams_that_read


def end_freeze(session: Session, phase: Phase, now: datetime, *, reason: str, actor: str) -> None:
    """End the freeze of a phase's boards, and notify its teams of scores that were kept back.

    The audit line names the board that readers saw, if a newer one exists or is to be built.
    """
    since = Submission.received_at >= phase.policy.freezes_at
    kept_back = exists(ScoreSheetRow).where(
        ScoreSheetRow.submission_id == Submission.id, Submission.phase_id == phase.id, since
    )
    phase.unfrozen_at = now
    shown = current_board(session, phase.id)
    has_newer = shown != fresh_board(session, phase.id, key_of_phase(phase))
    number = shown.number if shown is not None and has_newer else None
    detail = {"reason": checked_reason(reason), "board": number}
    audit(session, actor, "freeze ended", phase.id, detail)
    if phase.policy.frozen_scores == "hidden" and session.scalar(select(kept_back)):
        title = f"The board of {phase.title} is revealed"
        tell_teams(session, phase, title, "Scores that were kept back are shown.")


def tell_teams(session: Session, phase: Phase, title: str, sentence: str) -> None:
    """Notify the teams that submitted to a phase, unless it is hidden.

    Teams with a later deadline that still holds are reminded of it.
    """
    if phase.visibility == "hidden":
        return
    has_ended = is_revealed(session, phase)
    for team in teams_that_read(session, phase.id):
        # lock the team, so that it is not forgotten while it is being notified
        session.refresh(team, with_for_update={"read": True, "key_share": True})
        own = None if has_ended else allowance_of(session, team.id, phase.id)
        until = own and own_deadline(phase, own.closes_at)
        words = f"Your team's own deadline is still {until:%Y-%m-%d %H:%M} UTC." if until else None
        sentences = tuple(filter(None, (sentence, words)))
        tell_team(session, team, "phase_changed", title, sentences, phase=phase.id)


def hold_running_deadlines(session: Session, phase: Phase) -> list[tuple[Team, datetime]]:
    """Return `running_deadlines`, and lock the teams, so that no upload overlaps the reveal."""
    held = []
    for team, until in sorted(running_deadlines(session, phase), key=lambda each: each[0].id):
        with suppress(Conflict):  # it was refused meanwhile
            held.append((hold_team(session, team.id), until))
    return held


def tell_of_ended_deadlines(
    session: Session, phase: Phase, running: Iterable[tuple[Team, datetime]]
) -> None:
    """Notify teams whose own later deadline ran until a reveal that it has ended.

    Args:
        session: Session of the write transaction that reveals.
        phase: The phase; if it is hidden, nobody is notified.
        running: The deadlines before the reveal (`hold_running_deadlines`).
    """
    if phase.visibility == "hidden" or not is_revealed(session, phase):
        return
    for team, until in running:
        title = f"Your team's own deadline in {phase.title} has ended"
        sentence = (
            f"It was {until:%Y-%m-%d %H:%M} UTC, and ended as what had been kept back was revealed."
        )
        tell_team(session, team, "allowance", title, (sentence,), phase=phase.id)
