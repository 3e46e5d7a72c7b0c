"""Reveal the withheld part of a split by a rescoring run to the revision of that part."""

from collections.abc import Iterator
from datetime import datetime

from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.phases.allowances import ended_by_reveal
from exceptiondrive_records.phases.phases import lock_phase
from exceptiondrive_records.phases.policy import frozen_since, has_closed, was_split_revealed
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.changes import create_run, start_run
from exceptiondrive_records.rescoring.comparison import splits_of
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.splits.splits import part_revision, part_words
from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.api.rescoring import RunState

LATE_FILES = "Late files are refused from the reveal on, also after a rollback."


def reveal_split(session: Session, phase_id: str, *, reason: str, actor: str) -> Phase:
    """Start scoring the part to be revealed; the board changes when the run is applied.

    Raises:
        NotFound: No such phase.
        Conflict: The split has no parts, it is revealed already, or a run is open.
    """
    phase = lock_phase(session, phase_id)
    part: SplitPart | None = "private" if phase.policy.revealed_part == "private" else None
    target = part_revision(session, phase.split_name, phase.split_revision, part)
    has_parts = part_revision(session, phase.split_name, phase.split_revision, "private")
    if target is None or has_parts is None:
        raise Conflict("The split of this phase has no parts: all samples count already.")
    if target == phase.split_revision:
        raise Conflict("The phase shows this part of its split already.")
    run = create_run(session, phase_id, split_revision=target, reason=reason, actor=actor)
    start_run(session, run.id, reason=reason, actor=actor)
    return phase


def is_reveal(session: Session, run: RescoringRun) -> bool:
    """Whether a run changes which part of the split counts."""
    old, new = splits_of(session, run)
    return old.part != new.part


def reveal_blockers(session: Session, run: RescoringRun) -> Iterator[str]:
    """Yield reasons in the state of the phase against applying a run, or rolling it back."""
    phase = session.get_one(Phase, run.phase_id)
    now = database_now(session)
    if run.state is RunState.APPLIED:
        yield from _against_update(phase, now, "rolling back")
    elif not is_reveal(session, run):
        yield from _against_update(phase, now, "applying")
    elif too_early := _against_reveal(phase, now):
        yield too_early
        yield from _same_part(session, run)


def reveal_warnings(session: Session, run: RescoringRun) -> tuple[str, ...]:
    """List what applying a reveal ends permanently: a rollback does not restore it."""
    phase = session.get_one(Phase, run.phase_id)
    if run.state is RunState.APPLIED or run.state.is_final or not is_reveal(session, run):
        return ()
    found = ended_by_reveal(session, phase)
    if phase.policy.late_entries == "own_view" and not was_split_revealed(session, phase):
        found = (LATE_FILES, *found)
    if frozen_since(phase, database_now(session)) is not None:
        found = ("The freeze ends with this; a rollback does not bring it back.", *found)
    return found


def _same_part(session: Session, run: RescoringRun) -> Iterator[str]:
    """Yield advice, if another revision rather than another part was meant."""
    old, new = splits_of(session, run)
    same = part_revision(session, new.name, new.revision, old.part)
    if same is not None and same != old.revision:
        yield f"To count {part_words(old.part)} of that revision instead, cancel this run and name {same}."


def _against_reveal(phase: Phase, now: datetime) -> str | None:
    if phase.closes_at is None:
        return (
            "The phase has no deadline: teams could tune on what is revealed. Set closes_at first."
        )
    if has_closed(phase, now):
        return None
    return (
        f"The phase is open until {phase.closes_at:%Y-%m-%d %H:%M} UTC: teams could tune on what "
        "is revealed. Apply after the deadline."
    )


def _against_update(phase: Phase, now: datetime, what: str) -> Iterator[str]:
    since = frozen_since(phase, now)
    if since is not None:
        yield (
            f"The board is frozen since {since:%Y-%m-%d %H:%M} UTC: {what} would show what the "
            "freeze hides. Reveal the board first."
        )
