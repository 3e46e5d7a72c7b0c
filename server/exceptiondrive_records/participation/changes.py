"""Changes of a team by organizers: approve, rename, change its affiliation, merge two teams."""

from itertools import product

from sqlalchemy import ColumnElement, delete, exists, select, update
from sqlalchemy.orm import Session, aliased

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.accounts.tables import Invitation, Membership, Token
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.standings import stood_at_deadline
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import (
    checked_reason,
    checked_team,
    checked_text,
    skeleton,
)
from exceptiondrive_records.news.tables import Question
from exceptiondrive_records.notifications.contacts import list_contacts, take_away
from exceptiondrive_records.notifications.events import OUTCOMES
from exceptiondrive_records.notifications.inbox import tell_team
from exceptiondrive_records.notifications.tables import ContactPoint, Notification
from exceptiondrive_records.participation.disqualification import want_boards_of_team
from exceptiondrive_records.participation.tables import Disqualification
from exceptiondrive_records.phases.policy import can_publish, has_closed, is_late, is_published
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import lock_jobs
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team, require_free_name
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.participation import AFTER_A_MERGE
from exceptiondrive_schemas.api.submission import WAITING, SubmissionStatus
from exceptiondrive_schemas.printable import counted

MAX_AFFILIATION = 200
_GIVEN_UP = (SubmissionStatus.WITHDRAWN, SubmissionStatus.FAILED)
"""Statuses after which a team may send the same bytes again."""


def approve_team(session: Session, slug: str, *, actor: str) -> Team:
    """Let a team that registered itself submit, and notify it. Idempotent.

    Raises:
        NotFound: There is no such team.
    """
    team = find_team(session, slug, lock=True)
    if team.pending_since is not None:
        team.pending_since = team.registered_from = None
        audit(session, actor, "team approved", slug)
        told = ("From now on it may submit, and be told at addresses, too.",)
        tell_team(session, team, "team_changed", f"Your team {team.name} is approved", told)
    return team


def change_team(
    session: Session,
    slug: str,
    *,
    reason: str,
    actor: str,
    name: str | None = None,
    affiliation: str | None = None,
) -> Team:
    """Change the name or the affiliation of a team; None keeps the old value.

    New boards show the new name, earlier ones keep the old one. Archived phases get no new board
    for this; one built there for another reason, such as a disqualification, has the new name.

    Raises:
        NotFound: No such team.
        InvalidRecord: A text cannot be used.
        Conflict: Another team has this or a similar-looking name; or this team is gone.
    """
    team = find_team(session, slug, lock=True)
    team.require_there()
    before = {"name": team.name, "affiliation": team.affiliation}
    if name is not None:
        team.name = checked_team(slug, name)
        if team.name != before["name"]:
            require_free_name(session, team)
            team.name_skeleton = skeleton(team.name)
    if affiliation is not None:
        team.affiliation = checked_affiliation(affiliation)
    after = {"name": team.name, "affiliation": team.affiliation}
    changed = {key: [before[key], after[key]] for key in after if before[key] != after[key]}
    if not changed:
        return team
    audit(session, actor, "team changed", slug, {"reason": checked_reason(reason), **changed})
    if "name" in changed:
        session.flush()
        want_boards_of_team(session, team.id, with_archived=False)
        told = (f"It was {before['name']}.", "New boards show it; earlier ones stay as they are.")
        tell_team(session, team, "team_changed", f"Your team is called {team.name}", told)
    return team


def checked_affiliation(text: str) -> str:
    """Return an affiliation that can be shown.

    Raises:
        InvalidRecord: It is too long, or cannot be shown.
    """
    return checked_text("affiliation", text, max_length=MAX_AFFILIATION, may_be_empty=True)


def merge_teams(
    session: Session, slug: str, into: str, *, reason: str, actor: str
) -> tuple[Team, int]:
    """Merge a team into another, with its submissions, people, addresses and questions.

    A shared address is kept once, and outcomes of submissions are not notified again. The merged
    team keeps its id, so that its audit lines stay readable, but no token and no people. Both
    quotas count together. Its later deadlines hold; no allowance moves. This is irreversible.

    Returns:
        The remaining team, and the number of submissions that moved to it.

    Raises:
        NotFound: No such team.
        InvalidRecord: The reason cannot be stored.
        Conflict: They are the same team; one of them is merged, forgotten or disqualified, waits
            for approval or is a reference; both submitted the same bytes to one phase; or an entry
            of one would displace a final one of the other, in a closed or archived phase.
    """
    ids = sorted({find_team(session, slug).id, find_team(session, into).id})
    if len(ids) == 1:
        raise Conflict("A team cannot be merged into itself.")
    for team_id in ids:
        hold_team(session, team_id)
    team, target = find_team(session, slug), find_team(session, into)
    _require_mergeable(session, team, target)
    phases = list(
        session.scalars(select(Submission.phase_id).where(Submission.team_id == team.id).distinct())
    )
    n_moved = _move(session, team, target)
    team.merged_into_id = target.id
    detail = {"into": target.slug, "n_submissions": n_moved, "reason": checked_reason(reason)}
    audit(session, actor, "team merged", team.slug, detail)
    audit(session, actor, "team merged", target.slug, {**detail, "from": team.slug})
    for phase_id in sorted(phases):
        want_boards_of_team(session, target.id, phase_id)
    its = f"Its {counted(n_moved, 'submission')}," if n_moved else "It had no submissions; its"
    told = [f"{its} people and addresses are your team's from now on."]
    if n_moved:
        told.append(AFTER_A_MERGE)
    title = f"The team {team.name} is part of your team"
    tell_team(session, target, "team_changed", title, told)
    return target, n_moved


def _require_mergeable(session: Session, team: Team, target: Team) -> None:
    for each in (team, target):
        if each.merged_into_id is not None:
            into = session.get_one(Team, each.merged_into_id).slug
            raise Conflict(f"The team {each.slug} was already merged into {into}: use that one.")
        if each.forgotten_at is not None:
            raise Conflict(f"The team {each.slug} was forgotten and cannot be merged.")
    if team.is_reference or target.is_reference:
        raise Conflict("A reference team cannot be merged.")
    if team.pending_since is not None or target.pending_since is not None:
        raise Conflict("A team that waits for approval cannot be merged: approve or refuse it.")
    out = select(Disqualification.id).where(
        Disqualification.team_id.in_((team.id, target.id)),
        Disqualification.submission_id.is_(None),
        Disqualification.reinstated_at.is_(None),
    )
    if session.scalar(out.limit(1)) is not None:
        raise Conflict("One of the teams is disqualified: reinstate it first.")
    same = aliased(Submission)
    is_same = (same.phase_id == Submission.phase_id) & (same.file_digest == Submission.file_digest)
    found = select(Submission.id).join(same, is_same).order_by(Submission.id)
    for row, its_team in ((Submission, team), (same, target)):
        found = found.where(row.team_id == its_team.id, row.status.not_in(_GIVEN_UP))
    if both := session.scalars(found).all():
        raise Conflict(
            f"Both teams submitted the same bytes: {', '.join(both[:5])}. A team can have a file "
            "only once in a phase: withdraw it for one of them first; a rejected one cannot be withdrawn."
        )
    _require_places(session, Submission.team_id.in_((team.id, target.id)))


def _require_places(session: Session, of_both: ColumnElement[bool]) -> None:
    """Refuse if an entry of one team would irreversibly displace an entry of the other."""
    phases = select(Phase).where(exists().where(Submission.phase_id == Phase.id, of_both))
    now = database_now(session)
    for phase in session.scalars(phases.order_by(Phase.id)):
        if not has_closed(phase, now) and phase.visibility != "archived":
            continue
        may_stand = stood_at_deadline(phase) | Submission.status.in_(WAITING)
        found = select(Submission).where(Submission.phase_id == phase.id, of_both, may_stand)
        shows_one = phase.policy.entries_shown == "chosen"
        may_publish = can_publish(session, phase)
        places = {
            (each.team_id, "" if shows_one else each.method)
            for each in session.scalars(found)
            if (may_publish or is_published(phase, each)) and not is_late(phase, each)
        }
        if len({place for _, place in places}) < len(places):
            raise Conflict(
                f"Both teams have entries in {phase.id} that would take one place, and entries there "
                f"have been final since it {'closed' if has_closed(phase, now) else 'was archived'}. "
                "The teams cannot be merged."
            )


def _move(session: Session, team: Team, target: Team) -> int:
    to_target = {"team_id": target.id}
    lock_jobs(session, Job.team_id == team.id)
    session.execute(update(Job).where(Job.team_id == team.id).values(to_target))
    n_moved = 0
    for submission in session.scalars(select(Submission).where(Submission.team_id == team.id)):
        submission.team_id = target.id
        n_moved += 1
    now = database_now(session)
    for mine, other in product(list_contacts(session, team.id), list_contacts(session, target.id)):
        if mine.address == other.address:
            unheard = other if other.confirmed_at is None else mine
            take_away(unheard, now)
    session.flush()
    for table in (Disqualification, ContactPoint, Question):
        session.execute(update(table).where(table.team_id == team.id).values(to_target))
    outcomes = Notification.team_id == team.id, Notification.kind.in_([*OUTCOMES.values()])
    session.execute(update(Notification).where(*outcomes).values(to_target))
    members = select(Membership.person_id).where(Membership.team_id == target.id)
    there = set(session.scalars(members))
    for person_id in session.scalars(
        select(Membership.person_id).where(Membership.team_id == team.id)
    ).all():
        if person_id not in there:
            session.add(Membership(team_id=target.id, person_id=person_id, joined_at=now))
    session.execute(delete(Membership).where(Membership.team_id == team.id))
    for kind, column in ((Token, "revoked_at"), (Invitation, "withdrawn_at")):
        is_live = getattr(kind, column).is_(None)
        session.execute(update(kind).where(kind.team_id == team.id, is_live).values({column: now}))
    return n_moved
