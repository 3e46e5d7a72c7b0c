"""Decisions about an accepted submission: confirm, edit, withdraw, choose, publish.

A team decides about its own. An organizer may edit or withdraw any, and its team is notified.
"""

from collections.abc import Callable
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.accounts.sessions import require_unrevoked
from exceptiondrive_records.accounts.tokens import Principal, Scope
from exceptiondrive_records.boards.standings import replacements
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotConfirmed
from exceptiondrive_records.notifications.inbox import tell_about
from exceptiondrive_records.phases.policy import is_late, is_published, score_kept_back_since
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.edits import edits_of
from exceptiondrive_records.submissions.questions import is_asked_anew
from exceptiondrive_records.submissions.submissions import confirm, find_submission, lock_jobs
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import view, views
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.own_entries import entry_words
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_server.submissions.upload import told_to
from exceptiondrive_server.web.auth import own_team, team_of
from exceptiondrive_server.web.services import Services

_OFF_THE_BOARD = (
    "The next boards leave it out; earlier ones keep what they showed, and a frozen board goes on "
    "showing it until it is revealed."
)
_ONE_OF_TWO = (
    "It comes together with another run of your team, and one of the two stands: which, is told when the "
    "organizers reveal the board."
)


def confirmed_upload(
    services: Services, principal: Principal, submission_id: str
) -> SubmissionView:
    """Let a submission of a team count that it was asked about, and call a worker.

    Where it would replace another entry by now, nothing counts: it is returned with that question.

    Raises:
        RecordsError: It is refused; what was asked stays as it is.
    """
    with services.database.write() as session:
        require_unrevoked(session, principal)
        asked = find_submission(session, submission_id, team_id=team_of(principal))
        counted_id = submission_id
        if not is_asked_anew(session, asked):
            counted_id = confirm(session, submission_id, actor=principal.actor).id
    services.dispatcher.wake(Lane.LIVE)
    with services.database.read() as session:
        return told_to(principal, view(session, find_submission(session, counted_id)))


def decide(
    services: Services,
    principal: Principal,
    submission_id: str,
    what: Callable[..., object],
    *,
    replace: bool = True,
    by_organizers: bool = False,
) -> None:
    """Let a team do something with a submission of its own, in one transaction.

    `by_organizers`: they may edit or withdraw any so, and its team is told. `what` is called with a
    session, the id, and `actor`. Without `replace` it may take no entry of the team off the board.

    Raises:
        NotConfirmed: It does; the sentence names the entry, to who may read it. Or it may, as scores are
            kept back. Nothing was changed.
        NotAllowed: The token, or the place in the team, ended since the request began.
        NotFound: The team has no such submission.
        ApiProblem: It acts for no team.
    """
    team_id = own_team(principal) if by_organizers else team_of(principal)
    with services.database.write() as session:
        require_unrevoked(session, principal)
        submission = find_submission(session, submission_id, team_id=team_id)
        if team_id is None:  # its team is told of what they changed themselves
            hold_team(session, submission.team_id)
            lock_jobs(session, Job.submission_id == submission_id)
            session.refresh(submission, with_for_update={"key_share": True})
        method, before = submission.method, _decided(submission)
        standing = {} if replace else _standing(session, submission)
        together = [] if replace else _together(session, submission)
        what(session, submission_id, actor=principal.actor)
        after = [] if replace else _together(session, submission)
        if not all(any(ids <= was for was in together) for ids in after):
            raise NotConfirmed(_ONE_OF_TWO)
        if gone := standing and standing.keys() - _standing(session, submission).keys():
            may_read = Scope.READ_OWN in principal.scopes
            named = " and ".join(entry_words(standing[each]) for each in sorted(gone))
            raise NotConfirmed(f"It replaces {named if may_read else 'an entry of your team'}.")
        if team_id is None and _decided(submission) != before:
            done, means = _decision(session, submission, before[0])
            tell_about(session, submission, f"An organizer {done.format(method)}", (means,))


def _standing(session: Session, submission: Submission) -> dict[str, SubmissionView]:
    """Return, by id, the entries of its team in its phase, under the team's lock."""
    hold_team(session, submission.team_id)
    phase = session.get_one(Phase, submission.phase_id)
    public = _public(session, submission, phase)
    replaced = replacements(session, phase, public, database_now(session))
    standing = [each for each in public if each.id not in replaced]
    return {each.id: each for each in views(session, standing)}


def _together(session: Session, submission: Submission) -> list[set[str]]:
    """Return the runs of its team that share a place on the board, where a score of them is kept back.

    `replacements` leaves them out: which of them stands may tell which is the best.
    """
    phase, now = session.get_one(Phase, submission.phase_id), database_now(session)
    found: dict[tuple[bool, str], set[str]] = {}
    hidden = set()
    for each in _public(session, submission, phase):
        late = is_late(phase, each)
        shows_one = phase.policy.entries_shown == "chosen" and not late
        found.setdefault((late, "" if shows_one else each.method), set()).add(each.id)
        if score_kept_back_since(phase, each, now) is not None:
            hidden.add(each.id)
    return [ids for ids in found.values() if len(ids) > 1 and ids & hidden]


def _public(session: Session, submission: Submission, phase: Phase) -> list[Submission]:
    """Return the scored runs of its team in the phase that are public."""
    query = select(Submission).where(
        Submission.team_id == submission.team_id,
        Submission.phase_id == phase.id,
        Submission.status == SubmissionStatus.SCORED,
    )
    return [each for each in session.scalars(query) if is_published(phase, each)]


def _decided(submission: Submission) -> tuple[datetime | None, datetime | None]:
    return submission.edited_at, submission.withdrawn_at


def _decision(
    session: Session, submission: Submission, edited_at: datetime | None
) -> tuple[str, str]:
    """Say what was done, and what it means."""
    if submission.edited_at != edited_at:
        changed = edits_of(session, submission.id)[0].changed
        names = ", ".join(name.removeprefix("facts.").replace("_", " ") for name in changed)
        name = f"It is called {submission.method} now. " if "method" in changed else ""
        return "edited {}", f"{name}Changed: {names}. Its page says what stood there before."
    return "withdrew {}", f"{_OFF_THE_BOARD} The quota it took stays used."
