"""Change a phase or reveal its board, and notify its teams of the consequences for them."""

from datetime import timedelta

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import (
    boards_of_flip,
    entries_on,
    entry_ids,
    flip_board,
    latest_board,
)
from exceptiondrive_records.boards.renewal import renew_boards
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.notifications.tables import Notification
from exceptiondrive_records.phases.allowances import end_own_deadlines
from exceptiondrive_records.phases.changes import update_phase
from exceptiondrive_records.phases.disqualified import is_one_taken_back
from exceptiondrive_records.phases.phases import lock_phase
from exceptiondrive_records.phases.policy import frozen_since
from exceptiondrive_records.phases.scoring_keys import key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.comparison import compare_rows
from exceptiondrive_records.rescoring.flip import notify_of_run
from exceptiondrive_records.rescoring.freeze import (
    end_freeze,
    hold_running_deadlines,
    tell_of_ended_deadlines,
    tell_teams,
)
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_schemas.api.notifications import NotificationKind
from exceptiondrive_schemas.api.phase_settings import PhaseChange
from exceptiondrive_schemas.api.rescoring import RunState


def change_phase(session: Session, phase_id: str, change: PhaseChange, *, actor: str) -> Phase:
    """Change settings of a phase; if that shows it, notify its teams of updates applied while hidden.

    They are notified of a changed deadline, too.

    Raises:
        RecordsError: It is refused as by `update_phase`.
    """
    before = lock_phase(session, phase_id)
    was_hidden, until = before.visibility == "hidden", before.closes_at
    phase = update_phase(session, phase_id, change, actor=actor)
    if was_hidden and phase.visibility != "hidden":
        _tell_of_hidden_updates(session, phase)
    was, now = (f"{at:%Y-%m-%d %H:%M} UTC" if at else "none" for at in (until, phase.closes_at))
    if was != now:
        title = f"The deadline of {phase.title} is changed"
        tell_teams(session, phase, title, f"From {was} to {now}.")
    return phase


def reveal_board(session: Session, phase_id: str, *, reason: str, actor: str) -> Phase:
    """End the freeze: show the newest board at once, and notify teams of scores that were kept back.

    If an entry was taken back since that board was built, the next board is shown instead.

    Raises:
        NotFound: No such phase.
        Conflict: It is not frozen.
    """
    phase = lock_phase(session, phase_id)
    running = hold_running_deadlines(session, phase)
    now = database_now(session)
    if frozen_since(phase, now) is None:
        raise Conflict("The board is not frozen: there is nothing to reveal.")
    end_freeze(session, phase, now, reason=reason, actor=actor)
    end_own_deadlines(session, phase, now)
    tell_of_ended_deadlines(session, phase, running)
    row = latest_board(session, phase.id, key_of_phase(phase))
    if row is not None and not is_one_taken_back(session, phase, entry_ids(session, row.id)):
        flip_board(session, phase, row)
    renew_boards(session, phase)
    return phase


def _tell_of_hidden_updates(session: Session, phase: Phase) -> None:
    """Notify teams, in order, of applied updates, and of rollbacks of those that they heard of.

    Nothing that was notified while the phase was shown earlier is repeated, and entries that are
    not on the present board are left out.
    """
    runs = session.scalars(select(RescoringRun).where(RescoringRun.phase_id == phase.id)).all()
    notices = select(Notification.run_id, Notification.kind).where(
        Notification.run_id.in_([run.id for run in runs])
    )
    told = {(run_id, kind) for run_id, kind in session.execute(notices.distinct())}
    due: dict[int, tuple[RescoringRun, NotificationKind]] = {}
    for run in runs:
        kind: NotificationKind = "protocol_applied"
        flip_id, is_news = run.apply_flip_id, True
        if run.state is RunState.ROLLED_BACK:
            is_news = (run.id, kind) in told
            flip_id, kind = run.rollback_flip_id, "protocol_rolled_back"
        if flip_id is not None and is_news and (run.id, kind) not in told:
            due[flip_id] = run, kind
    stands = entries_on(session, phase.current_board_id)
    at = database_now(session)
    for flip_id, (run, kind) in sorted(due.items()):
        old, new = boards_of_flip(session, flip_id)
        comparison = compare_rows(old, new).comparison
        own = tuple(each for each in comparison.entries if each.submission_id in stands)
        at += timedelta(milliseconds=1)  # inboxes sort by time, newest first
        notify_of_run(session, run, comparison.model_copy(update={"entries": own}), kind, at)
