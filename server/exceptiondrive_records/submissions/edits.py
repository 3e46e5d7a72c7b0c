"""Edit a team's description of its submissions, at any time: name, text, links, facts.

No board is altered: a new one shows the new name, and facts are joined to a board when it is read.
"""

from collections.abc import Iterable
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.renewal import renew_boards
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import checked_link, checked_name
from exceptiondrive_records.phases.policy import can_change, is_anonymous
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import (
    checked_description,
    checked_facts,
    find_submission,
)
from exceptiondrive_records.submissions.tables import Submission, SubmissionEdit
from exceptiondrive_schemas.method_facts import (
    EditChanges,
    EntryFacts,
    MethodFacts,
    SubmissionChange,
    SubmissionEditView,
)

MAX_EDITS_A_DAY = 50
"""Limit per team: each edit may request a new board."""


def edit_submission(
    session: Session, submission_id: str, change: SubmissionChange, *, actor: str
) -> Submission:
    """Change those descriptive fields of a submission that are set in `change`; keep the others.

    A name belongs to the method, so all of its runs in the phase get it. The name of another method
    of the team merges both, which may change the entry on the board, so it is allowed only until
    the deadline. Quota, time and score stay. An edit without a change is not recorded.

    Raises:
        NotFound: No such submission.
        InvalidRecord: A text, link or name cannot be used.
        Conflict: The name is that of another method and the deadline has passed, or the team
            reached its daily limit of edits.
    """
    submission = find_submission(session, submission_id)
    hold_team(session, submission.team_id)
    session.refresh(submission, with_for_update={"key_share": True})
    phase = session.get_one(Phase, submission.phase_id)
    now = database_now(session)
    old_name = submission.method
    before = _audited_fields(submission)
    _apply_change(submission, change)
    after = _audited_fields(submission)
    changed = {name: (before[name], after[name]) for name in after if before[name] != after[name]}
    if not changed:
        return submission
    _require_edits_left(session, submission.team_id, now)
    runs = [submission]
    if submission.method != old_name:
        runs += _other_runs(session, submission, old_name)
        _require_free_name(session, phase, submission, runs, now)
    for run in runs:
        run.method, run.edited_at = submission.method, now
        said = changed if run is submission else {"method": changed["method"]}
        session.add(
            SubmissionEdit(
                submission_id=run.id, edited_at=now, actor=actor, changes=EditChanges(changed=said)
            )
        )
        audit(session, actor, "submission edited", run.id, {"changed": said})
    if any(not name.startswith("facts.") for name in changed):
        renew_boards(session, phase)
    return submission


def _apply_change(submission: Submission, change: SubmissionChange) -> None:
    given = change.model_fields_set
    if "method" in given and change.method not in (None, submission.method):
        submission.method = checked_name("method name", change.method or "")
    if "description" in given:
        submission.description = checked_description(change.description or "")
    if "paper_url" in given:
        submission.paper_url = checked_link("paper", change.paper_url)
    if "code_url" in given:
        submission.code_url = checked_link("code", change.code_url)
    if "facts" in given:
        submission.facts = checked_facts(_merged_facts(submission.facts, change.facts))


def _merged_facts(old: MethodFacts | None, change: MethodFacts | None) -> MethodFacts:
    if change is None:
        return MethodFacts()
    given = {name: getattr(change, name) for name in change.model_fields_set}
    return (old or MethodFacts()).model_copy(update=given)


def _audited_fields(submission: Submission) -> dict[str, Any]:
    facts = (submission.facts or MethodFacts()).model_dump()
    return {
        "method": submission.method,
        "description": submission.description,
        "paper": submission.paper_url,
        "code": submission.code_url,
        **{f"facts.{name}": value for name, value in facts.items()},
    }


def _other_runs(session: Session, submission: Submission, method: str) -> list[Submission]:
    query = select(Submission).where(
        Submission.team_id == submission.team_id,
        Submission.phase_id == submission.phase_id,
        Submission.method == method,
        Submission.id != submission.id,
    )
    return list(session.scalars(query.order_by(Submission.id).with_for_update(key_share=True)))


def _require_free_name(
    session: Session, phase: Phase, submission: Submission, runs: list[Submission], now: datetime
) -> None:
    others = _other_runs(session, submission, submission.method)
    if not can_change(phase, submission, now) and any(other not in runs for other in others):
        raise Conflict(
            f"Your team has another method {submission.method!r} in this phase. After the deadline "
            "two methods cannot become one: which run counts would change. Choose another name."
        )


def _require_edits_left(session: Session, team_id: int, now: datetime) -> None:
    query = (  # renaming a method adds one row for each of its runs, with the same time
        select(func.count(SubmissionEdit.edited_at.distinct()))
        .join(Submission, Submission.id == SubmissionEdit.submission_id)
        .where(Submission.team_id == team_id, SubmissionEdit.edited_at > now - timedelta(days=1))
    )
    if (session.scalar(query) or 0) >= MAX_EDITS_A_DAY:
        raise Conflict(f"A team may make {MAX_EDITS_A_DAY} edits in 24 hours; go on later.")


def edits_of(session: Session, submission_id: str) -> tuple[SubmissionEditView, ...]:
    """Return the edits of a submission, newest first, for its team and the organizers."""
    query = select(SubmissionEdit).where(SubmissionEdit.submission_id == submission_id)
    rows = session.scalars(query.order_by(SubmissionEdit.id.desc())).all()
    names = names_of_actors(session, (row.actor for row in rows))
    return tuple(
        SubmissionEditView(
            changed=row.changes.changed, edited_at=row.edited_at, by=names.get(row.actor, row.actor)
        )
        for row in rows
    )


def facts_of_entries(
    session: Session, phase_id: str, submission_ids: Iterable[str | None]
) -> dict[str, EntryFacts]:
    """Return the present facts of entries by submission; those without facts or edits are left out.

    It is empty while the phase is anonymous: facts, like links, may identify teams. The submissions
    must be entries of a board of the phase: facts of others are visible to their team only.
    """
    phase = session.get(Phase, phase_id)
    if phase is None or is_anonymous(phase):
        return {}
    query = select(Submission.id, Submission.facts, Submission.edited_at).where(
        Submission.phase_id == phase_id,
        Submission.facts.is_not(None) | Submission.edited_at.is_not(None),
    )
    wanted = set(submission_ids)
    return {
        submission_id: EntryFacts(facts=facts or MethodFacts(), edited_at=edited_at)
        for submission_id, facts, edited_at in session.execute(query)
        if submission_id in wanted
    }


class EditsOfPhase(NamedTuple):
    """A marker of all edits in a phase, which differs after every further edit."""

    newest_at: datetime | None
    n: int
    """Number of edits: of two concurrent ones, the later committed may have the earlier time."""


def edits_of_phase(session: Session, phase_id: str) -> EditsOfPhase:
    """Return a marker that changes with every edit of facts in a phase."""
    query = (
        select(func.max(SubmissionEdit.edited_at), func.count())
        .join(Submission, Submission.id == SubmissionEdit.submission_id)
        .where(Submission.phase_id == phase_id)
    )
    newest_at, n = session.execute(query).one()
    return EditsOfPhase(newest_at, n)
