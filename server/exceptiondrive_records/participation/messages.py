"""Send messages from organizers to the inbox and every confirmed address of each team."""

from collections.abc import Sequence
from typing import NamedTuple

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.errors import Conflict, InvalidRecord
from exceptiondrive_records.db.identifiers import checked_text
from exceptiondrive_records.notifications.inbox import tell_about, tell_team
from exceptiondrive_records.notifications.tables import Channel, ContactPoint, Notification
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team, teams_that_read
from exceptiondrive_schemas.base import bytes_digest

MAX_TITLE, MAX_TEXT = 150, 4000


class Recipient(NamedTuple):
    """A team that gets a message, with the number of its addresses, but never the addresses."""

    team: str
    """Its id."""
    name: str
    n_emails: int
    n_webhooks: int


def recipients(
    session: Session, teams: Sequence[str] = (), phase: str | None = None
) -> list[Recipient]:
    """Return the recipients of a message, by id.

    Without `teams` these are all approved teams except reference teams and those that are gone;
    with `phase`, only those that submitted to it.

    Raises:
        NotFound: No such team.
        Conflict: One of these teams was forgotten, or merged into another one.
    """
    counts = _addresses(session)
    return [
        Recipient(
            team.slug,
            team.name,
            counts.get((team.id, Channel.EMAIL), 0),
            counts.get((team.id, Channel.WEBHOOK), 0),
        )
        for team in _teams(session, teams, phase)
    ]


def send_message(
    session: Session,
    title: str,
    text: str,
    *,
    actor: str,
    teams: Sequence[str] = (),
    phase: str | None = None,
    address: str = "/my/notices",
) -> list[Recipient]:
    """Write to teams; each paragraph of the text is one sentence of the notice.

    The same text reaches a team once: a repetition, also by another organizer, is refused. Blank
    lines separate paragraphs. Teams and phase are as for `recipients`; `address` is the path of a
    page with more.

    Returns:
        The recipients.

    Raises:
        NotFound: No such team.
        InvalidRecord: A text cannot be used, or there is nobody to write to.
        Conflict: One of the teams has the same message already, was forgotten, or was merged.
    """
    title, paragraphs = checked_message(title, text)
    found = _teams(session, teams, phase)
    if not found:
        raise InvalidRecord("There is no team to write to.")
    refusal = "This very message was sent to one of these teams already."
    digest = _digest_of_new(session, found, (title, *paragraphs), refusal)
    for team in found:
        tell_team(
            session,
            team,
            "message",
            title,
            paragraphs,
            address=address,
            phase=phase or "",
            subject=digest,
        )
    told = recipients(session, [team.slug for team in found])
    detail = {"title": title, "digest": digest, "n_teams": len(found), "phase": phase}
    subject = found[0].slug if len(found) == 1 else "teams"
    audit(session, actor, "message sent", subject, detail)
    return told


def write_about(session: Session, submission_id: str, *, words: str, actor: str) -> Notification:
    """Write to a team about one of its submissions; the notice links to it.

    Blank lines in `words` separate paragraphs.

    Raises:
        NotFound: No such submission.
        InvalidRecord: The words cannot be used.
        Conflict: The team has the same message about it already, was forgotten, or was merged into
            another one meanwhile.
    """
    submission = find_submission(session, submission_id)
    title, paragraphs = checked_message(f"The organizers wrote about {submission.method}", words)
    team = session.get_one(Team, submission.team_id)
    refusal = "This very message about it was sent already."
    digest = _digest_of_new(session, [team], (submission_id, title, *paragraphs), refusal)
    row = tell_about(session, submission, title, paragraphs, subject=digest)
    audit(session, actor, "team told", submission_id, {"notice": row.id, "digest": digest})
    return row


def _digest_of_new(
    session: Session, teams: Sequence[Team], words: Sequence[str], refusal: str
) -> str:
    """Lock the teams, and return the digest of a message that none of them has yet; else refuse.

    It also refuses if one of the teams is gone.
    """
    digest = bytes_digest("\n\n".join(words).encode())
    ids = [team.id for team in teams]
    weak = select(Team).where(Team.id.in_(ids)).order_by(Team.id).with_for_update(key_share=True)
    for team in session.scalars(weak.execution_options(populate_existing=True)):
        _require_reader(session, team)
    have = select(Notification.id).where(
        Notification.kind == "message",
        Notification.subject == digest,
        Notification.team_id.in_(ids),
    )
    if session.scalar(have.limit(1)) is not None:
        raise Conflict(refusal)
    return digest


def checked_message(title: str, text: str) -> tuple[str, tuple[str, ...]]:
    """Return title and paragraphs of a message as it would be sent.

    Raises:
        InvalidRecord: One of them is empty, too long, or cannot be shown.
    """
    title = checked_text("title", title, max_length=MAX_TITLE)
    text = checked_text("text", text, max_length=MAX_TEXT, may_have_lines=True)
    paragraphs = (" ".join(part.split()) for part in text.split("\n\n"))
    return title, tuple(part for part in paragraphs if part)


def _teams(session: Session, slugs: Sequence[str], phase_id: str | None) -> list[Team]:
    if slugs:
        return [_require_reader(session, find_team(session, slug)) for slug in sorted(set(slugs))]
    return teams_that_read(session, phase_id)


def _require_reader(session: Session, team: Team) -> Team:
    """Return a team; refuse a merged or forgotten one, whose notices nobody reads."""
    if team.merged_into_id is not None:
        into = session.get_one(Team, team.merged_into_id).slug
        raise Conflict(f"The team {team.slug} is part of {into}: write to that one.")
    if team.forgotten_at is not None:
        raise Conflict(f"The team {team.slug} is forgotten: nobody reads what is written to it.")
    return team


def _addresses(session: Session) -> dict[tuple[int, Channel], int]:
    query = (
        select(ContactPoint.team_id, ContactPoint.channel, func.count())
        .where(ContactPoint.removed_at.is_(None), ContactPoint.confirmed_at.is_not(None))
        .group_by(ContactPoint.team_id, ContactPoint.channel)
    )
    return {(team_id, channel): count for team_id, channel, count in session.execute(query)}
