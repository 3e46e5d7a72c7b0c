"""Forget a team or a person: people, addresses and texts are deleted, a team's name becomes an alias.

Bytes and digests of boards stay in their immutable table. The alias is inserted when a board is read
(`boards.parsed_board`), and its digest stays the original one. The same holds for the comparison of
an applied run.
"""

from sqlalchemy import case, delete, exists, func, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import find_person, remove_member, teams_of
from exceptiondrive_records.accounts.tables import (
    FORGOTTEN,
    BrowserSession,
    Invitation,
    Membership,
    Person,
    Token,
)
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.tables import BoardEntryRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import checked_reason, random_id, skeleton
from exceptiondrive_records.news.tables import Question
from exceptiondrive_records.notifications.tables import ContactPoint, Delivery, Notification
from exceptiondrive_records.participation.disqualification import want_boards_of_team
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_records.work.lease import cancel
from exceptiondrive_schemas.api.notifications import NotificationView
from exceptiondrive_schemas.base import canonical_json


def forget_team(session: Session, slug: str, *, reason: str, actor: str) -> Team:
    """Delete all personal data of a team; its scored entries stay, under an alias. Irreversible.

    This deletes names, note, affiliation, people without another team, addresses, questions,
    notices and descriptions of methods, also of merged teams, and ends tokens and sessions.

    Raises:
        NotFound: No such team.
        InvalidRecord: The reason cannot be stored.
        Conflict: It is a reference team, was merged into another one, or is forgotten already.
    """
    team = find_team(session, slug, lock=True)
    if team.is_reference:
        raise Conflict("A reference team has no people: there is nothing to forget.")
    if team.forgotten_at is not None:
        raise Conflict(f"It was forgotten at {team.forgotten_at:%Y-%m-%d %H:%M} UTC.")
    if team.merged_into_id is not None:
        into = session.get_one(Team, team.merged_into_id).slug
        raise Conflict(
            f"It was merged into the team {into}, with all that it sent: forget that one."
        )
    all_of_it = [team]
    for each in all_of_it:  # grows in the loop: merged teams may have had others merged into them
        merged = select(Team).where(Team.merged_into_id == each.id).order_by(Team.id)
        all_of_it += session.scalars(merged)
        _forget_words(session, each)
        _forget_people(session, each)
        _forget_notices(session, each)
    boards = select(func.count(BoardEntryRow.board_id.distinct())).join(
        Submission, Submission.id == BoardEntryRow.submission_id
    )
    n_boards = session.scalar(boards.where(Submission.team_id == team.id))
    want_boards_of_team(session, team.id)
    detail = {"reason": checked_reason(reason), "n_boards": n_boards}
    audit(session, actor, "team forgotten", team.slug, detail)
    return team


def forget_person(session: Session, person_id: str, *, reason: str, actor: str) -> Person:
    """Delete a person's data and memberships; only their id stays. Irreversible.

    Name, address, the provider's identifier and sessions are deleted. Their teams keep submissions,
    tokens and addresses. If they sign in again, they are a new person.

    Raises:
        NotFound: There is no such person, or they are forgotten already.
        InvalidRecord: The reason cannot be stored.
        Conflict: They are an organizer.
    """
    person = find_person(session, person_id, lock=True)
    if person.is_organizer:
        raise Conflict("The person is an organizer: remove their role first.")
    audit(session, actor, "person forgotten", person.id, {"reason": checked_reason(reason)})
    for team in teams_of(session, person.id):
        remove_member(session, team.id, person.id, actor=actor)
    _forget_person(session, person)
    return person


def _forget_person(session: Session, person: Person) -> None:
    session.execute(delete(BrowserSession).where(BrowserSession.person_id == person.id))
    made = update(Invitation).where(Invitation.made_by == f"person:{person.id}")
    person.name, person.email = "Former participant", None
    session.execute(made.values(invited_by=person.name))
    person.issuer, person.subject = FORGOTTEN, person.id


def _forget_words(session: Session, team: Team) -> None:
    letters = random_id(6)
    team.name, team.slug = f"Former team {letters.upper()}", f"former-{letters}"
    team.name_skeleton = skeleton(team.name)
    team.affiliation, team.registration_note, team.registered_from = "", None, None
    team.forgotten_at = database_now(session)
    session.flush()
    session.execute(
        update(Submission)
        .where(Submission.team_id == team.id)
        .values(description="", paper_url=None, code_url=None, facts=None, idempotency_key=None)
    )
    for asked in session.scalars(select(Question).where(Question.team_id == team.id)):
        asked.text = asked.answer = "Forgotten"
        asked.answered_at = asked.answered_at or team.forgotten_at


def _forget_people(session: Session, team: Team) -> None:
    now = database_now(session)
    tokens = select(Token.id).where(Token.team_id == team.id).scalar_subquery()
    session.execute(
        delete(BrowserSession).where(
            BrowserSession.token_id.in_(tokens) | (BrowserSession.team_id == team.id)
        )
    )
    mine = update(Token).where(Token.team_id == team.id)
    session.execute(mine.where(Token.revoked_at.is_(None)).values(revoked_at=now))
    session.execute(mine.values(name="forgotten"))
    session.execute(delete(Invitation).where(Invitation.team_id == team.id))
    members = session.scalars(
        select(Person).join(Membership).where(Membership.team_id == team.id)
    ).all()
    session.execute(delete(Membership).where(Membership.team_id == team.id))
    for person in members:
        elsewhere = exists().where(Membership.person_id == person.id)
        if person.is_organizer or session.scalar(select(elsewhere)):
            continue
        _forget_person(session, person)


def _forget_notices(session: Session, team: Team) -> None:
    now = database_now(session)
    contacts = select(ContactPoint.id).where(ContactPoint.team_id == team.id)
    said_no = ContactPoint.unsubscribed_at.is_not(None)
    cancel(session, Delivery, now, Delivery.contact_id.in_(contacts))
    session.execute(
        update(ContactPoint)
        .where(ContactPoint.team_id == team.id)
        .values(
            address="",
            secret=case((said_no, ContactPoint.secret)),
            removed_at=now,
            mailbox_digest=case((said_no, ContactPoint.mailbox_digest)),
        )
    )
    for row in session.scalars(select(Notification).where(Notification.team_id == team.id)):
        view = NotificationView.read(row.body)
        kept = view.model_dump(include={"id", "kind", "phase", "created_at"})
        said = {"team": team.name, "title": "Forgotten", "what_changed": (), "comparison": ""}
        blank = NotificationView.model_validate(kept | said)
        row.body = canonical_json(blank).decode("utf-8")
