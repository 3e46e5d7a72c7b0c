"""Let teams decide which of their entries counts, and which are public."""

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.audit.log import audit, lines_of_a_day
from exceptiondrive_records.boards.renewal import renew_boards
from exceptiondrive_records.boards.standings import stood_at_deadline
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import find_row
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.phases.policy import (
    can_change,
    can_publish,
    deadline_of,
    is_late,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.phase_settings import RunRule

MAX_CHOICES_A_DAY = 50
"""Choices and publications of one team together."""


def choose(
    session: Session, submission_id: str, *, actor: str, rule: RunRule = "this"
) -> Submission:
    """Choose which run counts on the board; the last choice before the deadline holds.

    In a phase that shows one entry of each team, this submission stands for the team. In one that
    lets teams choose the run of a method, this run stands for its method, or the best or newest one.

    Raises:
        NotFound: No such submission.
        Conflict: The phase does not offer that choice, its deadline has passed, or there is no
            score yet.
    """
    submission, phase = _scored(session, submission_id)
    now = database_now(session)
    if phase.policy.entries_shown == "chosen":
        if rule != "this":
            raise Conflict("This phase shows one entry of each team: choose a submission itself.")
    elif phase.policy.run_choice == "newest":
        words = phase.policy.run_rule(has_deadline=phase.closes_at is not None)
        raise Conflict(f"There is nothing to choose. {words}")
    if not can_change(phase, submission, now):
        raise Conflict(
            f"The deadline was {deadline_of(phase, submission):%Y-%m-%d %H:%M} UTC: "
            "the choice stands as it is."
        )
    if is_late(phase, submission):
        raise Conflict("This entry came after the deadline; it stands on the late view alone.")
    _require_changes_left(session, submission)
    submission.chosen_at, submission.chosen_rule = now, rule
    renew_boards(session, phase)
    audit(session, actor, "entry chosen", submission_id, {"phase": phase.id, "rule": rule})
    return submission


def rules_of(
    session: Session, phase: Phase, submissions: Sequence[Submission]
) -> dict[str, tuple[RunRule, bool]]:
    """Return the rule by which a run counts, and whether the team chose this very submission.

    The rule is the last choice for the method, or for the team if the phase shows one entry of
    each. Submissions without a choice are left out: there the newest run counts.
    """
    is_of_team = phase.policy.entries_shown == "chosen"
    if not is_of_team and phase.policy.run_choice == "newest":
        return {}
    query = (
        select(Submission.id, Submission.team_id, Submission.method, Submission.chosen_rule)
        .where(
            Submission.team_id.in_({each.team_id for each in submissions}),
            Submission.phase_id == phase.id,
            stood_at_deadline(phase),
            Submission.chosen_at.is_not(None),
        )
        .order_by(Submission.chosen_at, Submission.received_at, Submission.id)
    )
    said = {  # the last choice for each method or team
        (team_id, "" if is_of_team else method): (rule, submission_id)
        for submission_id, team_id, method, rule in session.execute(query)
    }
    found = {}
    for each in submissions:
        word = said.get((each.team_id, "" if is_of_team else each.method))
        if word is not None:
            found[each.id] = word[0], word == ("this", each.id)
    return found


def publish(session: Session, submission_id: str, *, actor: str) -> Submission:
    """Put an entry on the board of a phase that keeps entries private. Idempotent.

    Raises:
        NotFound: No such submission.
        Conflict: The phase shows every entry, there is no score yet, or it is too late to pick.
    """
    return _show(session, submission_id, actor, is_public=True)


def publishable(session: Session, phase: Phase, private: Sequence[Submission]) -> set[str]:
    """Return the ids of those private entries that their teams may still make public.

    After the deadline that is the chosen or else newest entry of each method (or team, if the phase
    shows one of each) that has no public entry, so that nobody picks after the fact.
    """
    now = database_now(session)
    final = [each for each in private if _is_final(phase, each, now)]
    found = {each.id for each in private} - {each.id for each in final}
    if not final:
        return found

    def place(each: Submission) -> tuple[int, str]:
        return each.team_id, each.method if phase.policy.entries_shown == "all" else ""

    query = (
        select(Submission)
        .where(
            Submission.team_id.in_({each.team_id for each in final}),
            Submission.phase_id == phase.id,
            stood_at_deadline(phase),
        )
        .order_by(Submission.received_at, Submission.id)
    )
    stood = [each for each in session.scalars(query) if not is_late(phase, each)]
    taken = {place(each) for each in stood if each.published_at is not None}
    newest = {place(each): each.id for each in stood}
    rules = rules_of(session, phase, final)
    for each in final:
        rule, is_named = rules.get(each.id, ("newest", False))
        is_due = is_named if rule == "this" else newest.get(place(each)) == each.id
        if is_due and place(each) not in taken:
            found.add(each.id)
    return found


def unpublish(session: Session, submission_id: str, *, actor: str) -> Submission:
    """Take an entry off the board; boards that showed it keep it. Idempotent.

    Raises:
        NotFound: No such submission.
        Conflict: The phase shows every entry, there is no score yet, or its deadline has passed.
    """
    return _show(session, submission_id, actor, is_public=False)


def _show(session: Session, submission_id: str, actor: str, *, is_public: bool) -> Submission:
    submission, phase = _scored(session, submission_id)
    _require_private(session, phase)
    if is_public != (submission.published_at is not None):
        if is_public and submission_id not in publishable(session, phase, [submission]):
            raise Conflict(
                "The deadline has passed: only the run that the team named, else its newest, can "
                "still be published, and only where none was public in its place."
            )
        if not is_public and _is_final(phase, submission, database_now(session)):
            raise Conflict("The deadline has passed: withdraw it, and its place stays empty.")
        _require_changes_left(session, submission)
        submission.published_at = database_now(session) if is_public else None
        renew_boards(session, phase)
        done = "entry published" if is_public else "entry made private"
        audit(session, actor, done, submission_id, {"phase": phase.id})
    return submission


def _is_final(phase: Phase, submission: Submission, now: datetime) -> bool:
    """Whether a submission was in time and its deadline has passed."""
    return not is_late(phase, submission) and not can_change(phase, submission, now)


def _require_changes_left(session: Session, submission: Submission) -> None:
    """Limit choices, counted by audit lines: each one requests a new board, which is kept forever."""
    own = select(Submission.id).where(Submission.team_id == submission.team_id)
    choices = ("entry chosen", "entry published", "entry made private")
    if lines_of_a_day(session, choices, own) >= MAX_CHOICES_A_DAY:
        raise Conflict(f"A team may choose {MAX_CHOICES_A_DAY} times in 24 hours; go on later.")


def _scored(session: Session, submission_id: str) -> tuple[Submission, Phase]:
    hold_team(session, find_row(session, Submission, "submission", submission_id).team_id)
    submission = find_row(session, Submission, "submission", submission_id, lock=True)
    if not submission.is_scored:
        raise Conflict(f"The submission is {submission.status}; only a scored one is an entry.")
    return submission, session.get_one(Phase, submission.phase_id)


def _require_private(session: Session, phase: Phase) -> None:
    if not phase.policy.entries_private:
        raise Conflict("This phase shows every scored entry; withdraw it to take it off.")
    if not can_publish(session, phase):
        raise Conflict(
            "Scores that were hidden are shown now: what is public stays public, and the rest private."
        )
