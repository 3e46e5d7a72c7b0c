"""What organizers change in a phase that is there: settings, freeze, reveal. Each is audited."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.boards import current_board, flip_board, latest_board, parsed_board
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import Conflict, InvalidRecord
from exceptiondrive_records.identifiers import checked_text
from exceptiondrive_records.phase_boards import want_boards
from exceptiondrive_records.phase_life import frozen_since, is_anonymous, new_salt
from exceptiondrive_records.phase_rules import check_phase
from exceptiondrive_records.phases import lock_phase
from exceptiondrive_records.splits import live_revision
from exceptiondrive_records.tables import Phase, Submission
from exceptiondrive_schemas.phase_life import PhaseLife

PLAIN = (
    "title",
    "description",
    "opens_at",
    "closes_at",
    "quota_per_day",
    "quota_total",
    "quota_concurrent",
    "rejected_per_day",
    "shows_reported",
)
"""Columns that may be changed as they are."""
_PROMISED = {
    "live_part": "which samples the live board counts",
    "anonymous": "whether names are shown",
    "entries_private": "whether entries are private",
}


def update_phase(
    session: Session,
    phase_id: str,
    *,
    changes: Mapping[str, Any],
    life: PhaseLife | None = None,
    actor: str,
) -> Phase:
    """Change settings of a phase.

    Args:
        session: Of a write transaction.
        phase_id: The phase.
        changes: Of the columns in `PLAIN`.
        life: Its fields that were set explicitly are changed, the others stay.
        actor: Who.

    Raises:
        NotFound: No such phase.
        InvalidRecord: A value cannot be used, or it contradicts another.
        Conflict: It would take back what teams or readers were shown or promised.
    """
    phase = lock_phase(session, phase_id)
    now = database_now(session)
    before = _document(phase)
    old_dates = (phase.closes_at, phase.life.freezes_at)
    for key, value in changes.items():
        if key not in PLAIN:
            raise InvalidRecord(f"There is no setting {key!r} of a phase.")
        setattr(phase, key, value)
    phase.title = checked_text("title", phase.title, max_length=120)
    checked_text(
        "description", phase.description, max_length=4000, may_be_empty=True, may_have_lines=True
    )
    if life is not None:
        given = {key: getattr(life, key) for key in life.model_fields_set}
        _set_life(session, phase, phase.life.model_copy(update=given), now)
    if phase.closes_at is not None and phase.closes_at != old_dates[0] and phase.closes_at < now:
        raise InvalidRecord(
            "closes_at lies in the past: what was accepted in time would become late. Set a time "
            "to come, or leave it."
        )
    check_phase(phase, is_freeze_new=(phase.closes_at, phase.life.freezes_at) != old_dates)
    after = _document(phase)
    changed = {key: [before[key], after[key]] for key in after if after[key] != before[key]}
    if changed:
        audit(session, actor, "phase changed", phase.id, changed)
        want_boards(session, phase)
    return phase


def freeze_phase(session: Session, phase_id: str, *, reason: str, actor: str) -> Phase:
    """Freeze the public board from now on; scoring goes on.

    Raises:
        NotFound: No such phase.
        Conflict: It is frozen already.
    """
    phase = lock_phase(session, phase_id)
    now = database_now(session)
    since = frozen_since(phase, now)
    if since is not None:
        raise Conflict(f"The board is frozen already, since {since:%Y-%m-%d %H:%M} UTC.")
    phase.life = phase.life.model_copy(update={"freezes_at": now})
    audit(session, actor, "board frozen", phase.id, {"reason": _reason(reason)})
    return phase


def reveal_board(session: Session, phase_id: str, *, reason: str, actor: str) -> Phase:
    """End the freeze: the public board is the newest one at once.

    Raises:
        NotFound: No such phase.
        Conflict: It is not frozen.
    """
    phase = lock_phase(session, phase_id)
    now = database_now(session)
    if frozen_since(phase, now) is None:
        raise Conflict("The board is not frozen: there is nothing to reveal.")
    unfreeze(session, phase, now)
    audit(session, actor, "freeze ended", phase.id, {"reason": _reason(reason)})
    return phase


def unfreeze(session: Session, phase: Phase, now: datetime) -> None:
    """Let the pointer move again, to the newest board of what the phase shows."""
    phase.unfrozen_at = now
    row = latest_board(session, phase.id, phase.protocol_digest, phase.split_revision)
    if row is not None:
        flip_board(session, phase, row)
    want_boards(session, phase)


def reveal_names(session: Session, phase_id: str, *, reason: str, actor: str) -> Phase:
    """Show the names of teams and methods from the next board on; this cannot be taken back.

    Boards that were public before keep their pseudonyms for ever.

    Raises:
        NotFound: No such phase.
        Conflict: Its names are shown already.
    """
    phase = lock_phase(session, phase_id)
    if not is_anonymous(phase):
        raise Conflict("The names of this phase are shown already.")
    phase.names_revealed_at = database_now(session)
    audit(session, actor, "names revealed", phase.id, {"reason": _reason(reason)})
    want_boards(session, phase)
    return phase


def _set_life(session: Session, phase: Phase, life: PhaseLife, now: datetime) -> None:
    old = phase.life
    _keep_promises(session, phase, old, life)
    if life.freezes_at != old.freezes_at:
        if frozen_since(phase, now) is not None:
            raise Conflict("The board is frozen: reveal it, instead of moving freezes_at.")
        if life.freezes_at is not None and life.freezes_at < now:
            raise InvalidRecord(
                "freezes_at lies in the past. To freeze now, use the action freeze."
            )
    if _hides_families(life, now) and not _hides_families(old, now):
        row = current_board(session, phase.id)
        if row is not None and parsed_board(row).families:
            raise Conflict("The families of this phase have been shown: they cannot be hidden now.")
    phase.life = life
    if life.live_part != old.live_part:
        name, revision = phase.split_name, phase.split_revision
        phase.split_revision = live_revision(session, name, revision, life.live_part)
        phase.current_board_id = None
    if life.anonymous and phase.pseudonym_salt is None:
        phase.pseudonym_salt = new_salt()


def _keep_promises(session: Session, phase: Phase, old: PhaseLife, new: PhaseLife) -> None:
    broken = [what for key, what in _PROMISED.items() if getattr(old, key) != getattr(new, key)]
    if broken and session.scalar(select(exists().where(Submission.phase_id == phase.id))):
        raise Conflict(
            f"The phase has submissions: {' and '.join(broken)} cannot change any more. "
            "Names are shown by revealing them; the other part of a split likewise."
        )


def _hides_families(life: PhaseLife, now: datetime) -> bool:
    return life.families_from is not None and life.families_from > now


def _reason(reason: str) -> str:
    return checked_text("reason", reason, max_length=1000, may_have_lines=True)


def _document(phase: Phase) -> dict[str, Any]:
    plain = {key: getattr(phase, key) for key in PLAIN}
    times = {k: v.isoformat() if isinstance(v, datetime) else v for k, v in plain.items()}
    return {**times, **phase.life.model_dump(mode="json")}
