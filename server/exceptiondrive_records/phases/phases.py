"""Phases: dated stages of a challenge, each with its own split, protocol and limits."""

from functools import partial
from typing import Any

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import find_row, flush_or_refuse
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.db.identifiers import checked_link, checked_slug, checked_text
from exceptiondrive_records.phases.allowances import is_open_to
from exceptiondrive_records.phases.disqualified import team_disqualified_since
from exceptiondrive_records.phases.policy import new_salt, phase_now
from exceptiondrive_records.phases.quotas import quota_of
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.phases.terms import terms_accepted_at, terms_version
from exceptiondrive_records.protocols.protocols import find_protocol, usual_protocol
from exceptiondrive_records.splits.shown import shown_whole
from exceptiondrive_records.splits.splits import find_split, live_revision, whole_split
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_schemas.api.form_fields import fields_of
from exceptiondrive_schemas.api.phase_settings import (
    WITHHELD_DEFAULTS,
    NewPhase,
    PhaseChange,
    PhasePage,
    PhaseSettings,
)
from exceptiondrive_schemas.api.submission import PhaseView
from exceptiondrive_schemas.challenges import PLANNING

# Validation of the settings of a phase.


def check_phase(phase: Phase, *, is_freeze_new: bool = True) -> None:
    """Refuse an invalid id or text, and contradicting settings, and report all contradictions.

    Args:
        phase: The phase with its new settings.
        is_freeze_new: Whether `freezes_at` or `closes_at` is being set now; the action freeze may
            have set it after the deadline.

    Raises:
        InvalidRecord: With one sentence for each contradiction.
    """
    faults = []
    for check in (partial(checked_slug, "phase", phase.id), partial(_check_texts, phase)):
        try:
            check()
        except InvalidRecord as refusal:
            faults.append(str(refusal))
    freezes_at, opens_at, closes_at = phase.policy.freezes_at, phase.opens_at, phase.closes_at
    if opens_at is not None and closes_at is not None and closes_at <= opens_at:
        faults.append("A phase must close after it opens.")
    if freezes_at is not None and opens_at is not None and freezes_at <= opens_at:
        faults.append("freezes_at must lie after opens_at.")
    if phase.policy.late_entries == "own_view" and closes_at is None:
        faults.append("Late entries need a deadline: set closes_at, or refuse them.")
    is_too_late = freezes_at is not None and closes_at is not None and freezes_at >= closes_at
    if is_freeze_new and is_too_late:
        faults.append(
            "freezes_at must lie before closes_at: a board that freezes after the deadline hides "
            "nothing. After the deadline use the action freeze."
        )
    if phase.policy.terms_required and not phase.page.terms:
        faults.append("terms_required needs terms: without them every team submits unasked.")
    if faults:
        raise InvalidRecord(" ".join(faults))


def _check_texts(phase: Phase) -> None:
    """Strip the texts, and refuse those that cannot be shown."""
    page = {}
    for field in fields_of(PhaseSettings):
        if field.kind in ("text", "lines"):
            is_of_page = field.part == "page"
            text = checked_text(
                field.name,
                getattr(phase.page if is_of_page else phase, field.name),
                max_length=field.max_length,
                may_be_empty=not field.is_required,
                may_have_lines=field.kind == "lines",
            )
            if is_of_page:
                page[field.name] = text
            else:
                setattr(phase, field.name, text)
    for name in ("data_url", "data_manifest_url"):
        checked_link(name, page[name], may_have_port=True)
    phase.page = PhasePage(**page)


def create_phase(session: Session, new: NewPhase, *, actor: str) -> Phase:
    """Create a phase, and request its first, empty board.

    Settings of a phase on a withheld split default to the advice of docs/leakage.md.

    Raises:
        InvalidRecord: A text cannot be used, or two settings contradict each other.
        Conflict: The id is taken.
        NotFound: Split or protocol is unknown.
    """
    split = find_split(session, new.split, new.split_revision)
    whole = whole_split(session, split.name, split.revision)
    is_withheld = whole.public_file_digest is None
    settings = {name: getattr(new, name) for name in PhaseSettings.model_fields}
    if is_withheld:
        untold = WITHHELD_DEFAULTS.keys() - new.model_fields_set
        settings |= {name: WITHHELD_DEFAULTS[name] for name in untold}
    protocol = new.protocol or usual_protocol(session, actor, is_withheld=is_withheld)
    phase = Phase(
        id=new.id,
        challenge=new.challenge,
        split_name=split.name,
        split_revision=live_revision(session, split.name, split.revision, new.policy.live_part),
        protocol_digest=find_protocol(session, protocol).digest,
        current_board_id=None,
        created_at=database_now(session),
        pseudonym_salt=new_salt() if new.policy.anonymous else None,
        **settings,
    )
    check_phase(phase)
    if session.get(Phase, new.id) is not None:
        raise Conflict(f"There is a phase {new.id!r} already.")
    session.add(phase)
    flush_or_refuse(
        session, "Its protocol was deleted meanwhile, or the id taken: reload the page."
    )
    want_board(session, phase.id, phase.protocol_digest)
    detail = {
        "challenge": phase.challenge,
        "split": split.name,
        "protocol": phase.protocol_digest,
        "protocol_version": find_protocol(session, phase.protocol_digest).version,
        **deciding_settings(phase),
    }
    audit(session, actor, "phase created", phase.id, detail)
    return phase


def find_phase(session: Session, phase_id: str) -> Phase:
    """Return a phase.

    Raises:
        NotFound: There is none with this id.
    """
    return find_row(session, Phase, "phase", phase_id)


def titles_of_phases(session: Session) -> dict[str, str]:
    """Return the titles of phases, by id."""
    return {one.id: one.title for one in list_phases(session, with_hidden=True)}


def lock_phase(session: Session, phase_id: str) -> Phase:
    """Lock the row of a phase, and return it.

    Transactions that also lock a board request must lock it after the phase, to avoid deadlocks.
    Others may still write rows that refer to the phase (`FOR NO KEY UPDATE`): uploads, scores and
    their board requests do not wait.

    Raises:
        NotFound: There is none.
    """
    return find_row(session, Phase, "phase", phase_id, lock={"key_share": True})


def shown_phase(session: Session, phase_id: str, *, with_hidden: bool = False) -> Phase:
    """Return a phase that readers may see.

    `with_hidden`, for organizers, allows hidden ones.

    Raises:
        NotFound: There is none, or it is hidden; the words are the same.
    """
    phase = find_phase(session, phase_id)
    if phase.visibility == "hidden" and not with_hidden:
        raise NotFound("phase", phase_id)
    return phase


def require_known_to(session: Session, team_id: int, phase: Phase) -> None:
    """Refuse an action that would reveal a hidden phase to a team that does not know of it.

    Raises:
        Conflict: The phase is hidden, and the team submitted nothing to it.
    """
    sent = exists().where(Submission.phase_id == phase.id, Submission.team_id == team_id)
    if phase.visibility == "hidden" and not session.scalar(select(sent)):
        raise Conflict(
            "The phase is hidden, and the team, which sent nothing to it, would be told of it: "
            "show it first."
        )


def list_phases(
    session: Session, challenge: str | None = None, *, with_hidden: bool = False
) -> list[Phase]:
    """Return the phases that readers may see, by position, then in order of creation.

    Archived ones come last. `with_hidden`, for organizers, and for teams about their own
    submissions, adds hidden ones.
    """
    query = select(Phase).order_by(
        Phase.visibility == "archived",
        Phase.position.is_(None),
        Phase.position,
        Phase.created_at,
        Phase.id,
    )
    if challenge is not None:
        query = query.where(Phase.challenge == challenge)
    if not with_hidden:
        query = query.where(Phase.visibility != "hidden")
    return list(session.scalars(query))


def splits_in_use(session: Session) -> list[str]:
    """Return the names of the splits of all phases that are not archived, sorted."""
    query = select(Phase.split_name).where(Phase.visibility != "archived").distinct()
    return sorted(session.scalars(query))


def phase_view(
    session: Session, phase: Phase, *, max_upload_bytes: int, team_id: int | None = None
) -> PhaseView:
    """Return the phase as the API shows it, with the quota of a team if given."""
    whole = shown_whole(session, phase)
    quota = None if team_id is None else quota_of(session, team_id, phase)
    own_closes_at = None if quota is None else quota.closes_at
    return PhaseView(
        id=phase.id,
        challenge=phase.challenge,
        split=phase.split_name,
        split_revision=phase.split_revision,
        split_is_public=whole.public_file_digest is not None,
        n_samples=whole.n_samples,
        protocol=find_protocol(session, phase.protocol_digest).version,
        protocol_digest=phase.protocol_digest,
        is_open=is_open_to(session, phase, own_closes_at, database_now(session)),
        max_upload_bytes=max_upload_bytes,
        not_checked=not_checked(phase.challenge, whole),
        now=phase_now(session, phase),
        quota=quota,
        disqualified_at=None
        if team_id is None
        else team_disqualified_since(session, team_id, phase),
        terms_version=terms_version(phase),
        terms_accepted_at=None if team_id is None else terms_accepted_at(session, team_id, phase),
        **settings_of(phase),
    )


def not_checked(challenge: str, whole: SplitRow) -> tuple[str, ...]:
    """Return warnings about what is not checked in files of this challenge on a split."""
    if challenge != PLANNING.id or not whole.lacks_drives:
        return ()
    words = (
        "This split has no recorded drives, so nothing compares your source trajectories with the "
        "drive of the scene: a wrong time step, unit or axis goes unnoticed. Compare the speeds that "
        "the check of your file prints with those of your planner."
    )
    return (words,)


def settings_of(phase: Phase) -> dict[str, Any]:
    """Return the present settings of a phase, by name."""
    return {name: getattr(phase, name) for name in PhaseSettings.model_fields}


def deciding_settings(phase: Phase) -> dict[str, Any]:
    """Return the settings that decide which entries count (dates and policy), as audit lines do."""
    dates = PhaseChange.model_construct(opens_at=phase.opens_at, closes_at=phase.closes_at)
    told = dates.model_dump(mode="json", include={"opens_at", "closes_at"})
    return {**told, **phase.policy.model_dump(mode="json")}
