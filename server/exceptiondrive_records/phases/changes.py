"""Changes of an existing phase by organizers: settings, order, freeze, team names, its end."""

from datetime import datetime
from typing import Any

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.renewal import renew_boards
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import flush_or_refuse
from exceptiondrive_records.db.errors import Conflict, InvalidRecord
from exceptiondrive_records.db.identifiers import checked_reason
from exceptiondrive_records.phases.allowances import is_revealed
from exceptiondrive_records.phases.phases import (
    check_phase,
    find_phase,
    list_phases,
    lock_phase,
    settings_of,
)
from exceptiondrive_records.phases.policy import (
    families_shown_from,
    frozen_since,
    has_closed,
    is_anonymous,
    new_salt,
    was_split_revealed,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.splits.splits import live_revision
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.api.phase_settings import PhaseChange, PhasePolicy, PhaseSettings
from exceptiondrive_schemas.base import Document

_PROMISED = {
    "live_part": "which samples the live board counts",
    "anonymous": "whether names are shown",
    "entries_private": "whether entries are private",
}
_FINAL = {
    "entries_shown": "which entries of a team stand",
    "run_choice": "which run of a method stands",
}
_REVEALED = {**_FINAL, "revealed_part": "which samples count after the reveal"}


def update_phase(session: Session, phase_id: str, change: PhaseChange, *, actor: str) -> Phase:
    """Change those settings of a phase that are set in `change`; keep the others.

    Raises:
        NotFound: No such phase.
        InvalidRecord: A value cannot be used, or it contradicts another.
        Conflict: It would revoke something shown or promised to teams or readers.
    """
    phase = lock_phase(session, phase_id)
    now = database_now(session)
    before = _document(phase)
    old_dates = (phase.closes_at, phase.policy.freezes_at)
    was_revealed = was_split_revealed(session, phase) or is_revealed(session, phase)
    for name in change.model_fields_set - {"page", "policy"}:
        setattr(phase, name, getattr(change, name))
    if "page" in change.model_fields_set:
        phase.page = phase.page.model_copy(update=_given_fields(change.page))
    if "policy" in change.model_fields_set:
        policy = phase.policy.model_copy(update=_given_fields(change.policy))
        _keep_promises(
            session, phase, policy, is_over=has_closed(phase, now), is_revealed=was_revealed
        )
        _set_policy(session, phase, policy, now)
    if was_revealed and phase.closes_at != old_dates[0]:
        raise Conflict(
            "What was hidden has been revealed, and teams could tune on it if the deadline moved. "
            "Create another phase."
        )
    if phase.closes_at is not None and phase.closes_at != old_dates[0] and phase.closes_at < now:
        raise InvalidRecord(
            "closes_at is in the past: what was accepted in time would become late. Set a future "
            "time, or leave it as it is."
        )
    check_phase(phase, is_freeze_new=(phase.closes_at, phase.policy.freezes_at) != old_dates)
    after = _document(phase)
    changed = {key: [before[key], after[key]] for key in after if after[key] != before[key]}
    if changed:
        audit(session, actor, "phase changed", phase.id, changed)
        renew_boards(session, phase)
    return phase


def feature_phase(session: Session, phase_id: str, *, reason: str, actor: str) -> Phase:
    """Put a phase first: in lists, and on the front page.

    Raises:
        NotFound: No such phase.
        Conflict: It is not shown, or it is first already.
    """
    locked = select(Phase).order_by(Phase.id).with_for_update(key_share=True)
    phases = session.scalars(locked.execution_options(populate_existing=True)).all()
    phase = find_phase(session, phase_id)
    if phase.visibility != "shown":
        raise Conflict(f"The phase is {phase.visibility}: show it first.")
    if phase.position is not None and list_phases(session)[0] is phase:
        raise Conflict("The phase is on the front page already.")
    for other in phases:
        if other.position is not None:
            other.position += 1
    phase.position = 1
    audit(session, actor, "phase featured", phase.id, {"reason": checked_reason(reason)})
    return phase


def delete_phase(session: Session, phase_id: str, *, reason: str, actor: str) -> None:
    """Delete a phase that was never used, with its boards, which list no submissions.

    Foreign keys of the database protect a phase that a submission or rescoring run refers to.

    Raises:
        NotFound: No such phase.
        Conflict: Something was submitted or rescored in it.
    """
    phase = lock_phase(session, phase_id)
    detail = {"title": phase.title, "split": phase.split_name, "reason": checked_reason(reason)}
    session.delete(phase)
    flush_or_refuse(
        session,
        f"Phase {phase_id!r} was used: submissions or rescoring runs refer to it, so it stays. "
        "Archive or hide it: `visibility`.",
    )
    audit(session, actor, "phase deleted", phase_id, detail)


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
    phase.policy = phase.policy.model_copy(update={"freezes_at": now})
    audit(session, actor, "board frozen", phase.id, {"reason": checked_reason(reason)})
    return phase


def reveal_names(session: Session, phase_id: str, *, reason: str, actor: str) -> Phase:
    """Show the names of teams and methods from the next board on. Irreversible.

    Boards that were public before keep their pseudonyms forever.

    Raises:
        NotFound: No such phase.
        Conflict: Its names are shown already.
    """
    phase = lock_phase(session, phase_id)
    if not is_anonymous(phase):
        raise Conflict("The names of this phase are shown already.")
    phase.names_revealed_at = database_now(session)
    audit(session, actor, "names revealed", phase.id, {"reason": checked_reason(reason)})
    renew_boards(session, phase)
    return phase


def _set_policy(session: Session, phase: Phase, policy: PhasePolicy, now: datetime) -> None:
    old = phase.policy
    was_frozen = frozen_since(phase, now) is not None or phase.unfrozen_at is not None
    if was_frozen and policy.frozen_scores != old.frozen_scores:
        raise Conflict(
            "The board has been frozen: whether scores are hidden meanwhile can no longer change."
        )
    if policy.freezes_at != old.freezes_at:
        if frozen_since(phase, now) is not None:
            raise Conflict("The board is frozen: reveal it, instead of moving freezes_at.")
        if policy.freezes_at is not None and policy.freezes_at < now:
            raise InvalidRecord("freezes_at is in the past. To freeze now, use the action freeze.")
    if families_shown_from(policy, now) and families_shown_from(old, now) is None:
        _require_no_scores(session, phase)
    phase.policy = policy
    if policy.live_part != old.live_part:
        name, revision = phase.split_name, phase.split_revision
        phase.split_revision = live_revision(session, name, revision, policy.live_part)
        phase.current_board_id = None
    if policy.anonymous and phase.pseudonym_salt is None:
        phase.pseudonym_salt = new_salt()


def _keep_promises(
    session: Session, phase: Phase, new: PhasePolicy, *, is_over: bool, is_revealed: bool
) -> None:
    old = phase.policy
    for fixed, is_fixed, why, instead in (
        (
            _PROMISED,
            True,
            "The phase has submissions",
            "Reveal the names instead; likewise the other part of a split.",
        ),
        (_REVEALED, is_revealed, "What was hidden has been revealed", "Create another phase."),
        (
            _FINAL,
            is_over,
            "What counts at the deadline is final",
            "Set closes_at to a future time as well, or create another phase.",
        ),
    ):
        broken = [what for key, what in fixed.items() if getattr(old, key) != getattr(new, key)]
        if is_fixed and broken and _has_submissions(session, phase):
            raise Conflict(f"{why}: {' and '.join(broken)} can no longer change. {instead}")


def _has_submissions(session: Session, phase: Phase) -> bool:
    """Whether a phase has submissions; locks all teams, so that no upload overlaps the change."""
    session.execute(select(Team.id).order_by(Team.id).with_for_update(key_share=True))
    return bool(session.scalar(select(exists().where(Submission.phase_id == phase.id))))


def _require_no_scores(session: Session, phase: Phase) -> None:
    """Refuse to hide families after any submission was scored: at least its team has seen them.

    Raises:
        Conflict: One was scored.
    """
    scores = select(ScoreSheetRow).join(Submission).where(Submission.phase_id == phase.id)
    if session.scalar(select(scores.exists())):
        raise Conflict("The families of this phase have been shown: they cannot be hidden now.")


def _document(phase: Phase) -> dict[str, Any]:
    """Return all settings by name."""
    document: dict[str, Any] = PhaseSettings.model_construct(**settings_of(phase)).model_dump(
        mode="json"
    )
    return {**document.pop("page"), **document.pop("policy"), **document}


def _given_fields(part: Document) -> dict[str, Any]:
    """Return the fields that are set in a part of a change."""
    return {name: getattr(part, name) for name in part.model_fields_set}
