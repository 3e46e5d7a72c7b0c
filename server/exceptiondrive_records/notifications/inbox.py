"""Fill and read a team's inbox, in the same transaction that changes its published numbers."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Select, func, select, tuple_, update
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound, NotListed
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.notifications.tables import ContactPoint, Delivery, Notification
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.splits.splits import newly_counted
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.lease import new_item
from exceptiondrive_schemas.api.notifications import (
    ChangedEntry,
    NotificationKind,
    NotificationView,
    Subscription,
)
from exceptiondrive_schemas.api.rescoring import Comparison, EntryChange
from exceptiondrive_schemas.base import canonical_json

_VERBS: dict[NotificationKind, str] = {
    "protocol_applied": "now stands under",
    "protocol_rolled_back": "stands again under",
}


def notify_teams(
    session: Session,
    comparison: Comparison,
    kind: NotificationKind,
    *,
    run_id: str,
    what_changed: tuple[str, ...],
    at: datetime | None = None,
) -> None:
    """Notify each team whose published numbers change of its old and new numbers; no others.

    Nothing of a hidden phase is published, so nobody is notified before it is shown.
    """
    phase = session.get_one(Phase, comparison.phase)
    if phase.visibility == "hidden":
        return
    changed = _changed_entries(comparison)
    own = _submissions(session, [entry.submission_id for entry in changed])
    by_team: defaultdict[Team, list[ChangedEntry]] = defaultdict(list)
    for entry in changed:
        submission, team = own[entry.submission_id]
        told = ChangedEntry(
            submission_id=submission.id, method=submission.method, old=entry.old, new=entry.new
        )
        by_team[team].append(told)
    now = at or database_now(session)
    title = f"{phase.title} {_VERBS[kind]} {_what_stands(session, comparison)}"
    for team in sorted(by_team, key=lambda team: team.id):
        tell_team(
            session,
            team,
            kind,
            title,
            what_changed,
            address=f"/api/v1/rescoring/{run_id}",
            phase=phase.id,
            subscription="updates",
            run_id=run_id,
            at=now,
            challenge=comparison.challenge,
            from_protocol=comparison.from_protocol,
            to_protocol=comparison.to_protocol,
            entries=tuple(by_team[team]),
        )


def _changed_entries(comparison: Comparison) -> list[EntryChange]:
    """Return the entries whose published numbers change."""
    return [entry for entry in comparison.entries if entry.change != "none"]


def _what_stands(session: Session, comparison: Comparison) -> str:
    """Name what is new: the protocol, else the newly counted part of the split or its revision."""
    if comparison.from_protocol != comparison.to_protocol:
        return f"protocol {comparison.to_protocol.version}"
    new = comparison.to_split
    if which := newly_counted(session, comparison.from_split, new):
        return f"{which} of split {new.name}"
    return f"revision {new.revision.removeprefix('sha256:')[:12]} of split {new.name}"


def tell_team(
    session: Session,
    team: Team,
    kind: NotificationKind,
    title: str,
    sentences: Iterable[str],
    *,
    address: str = "/my/notices",
    phase: str = "",
    subject: str | None = None,
    subscription: Subscription | None = None,
    run_id: str | None = None,
    at: datetime | None = None,
    **of_update: Any,
) -> Notification:
    """Notify a team in its inbox and at its confirmed addresses, or those of them that subscribe.

    Args:
        session: Of a write transaction.
        team: The recipient.
        kind: Kind of the notification.
        title: One line.
        sentences: The text.
        address: Path of a page with more, on the server.
        phase: The phase that it concerns; empty if none in particular.
        subject: Identifies what it is about, if nothing of its kind may be sent twice.
        subscription: Send only to addresses with it; None for all confirmed ones.
        run_id: The rescoring run that caused it.
        at: Its time; by default now.
        of_update: Further fields about a protocol update.
    """
    view = NotificationView(
        id=random_id(),
        kind=kind,
        team=team.name,
        phase=phase,
        created_at=at or database_now(session),
        title=title,
        what_changed=tuple(sentences),
        comparison=address,
        **of_update,
    )
    addresses = listening_contacts(session, team.id, subscription)
    return _put(session, team.id, view, addresses, run_id=run_id, subject=subject)


def tell_about(
    session: Session,
    submission: Submission,
    title: str,
    sentences: Iterable[str],
    *,
    subject: str | None = None,
) -> Notification:
    """Notify a team of organizers' words or actions about its submission, with a link to it."""
    return tell_team(
        session,
        session.get_one(Team, submission.team_id),
        "message",
        title,
        sentences,
        address=f"/submissions/{submission.id}",
        phase=submission.phase_id,
        subject=subject,
    )


def send_to(session: Session, contact: ContactPoint, view: NotificationView) -> None:
    """Send a message to one address only; no inbox shows it."""
    _put(session, contact.team_id, view, [contact], subject=contact.id)


def _put(
    session: Session,
    team_id: int,
    view: NotificationView,
    addresses: Sequence[ContactPoint],
    *,
    run_id: str | None = None,
    subject: str | None,
) -> Notification:
    """Put a notification into an inbox, and a delivery for each address into the outbox."""
    row = Notification(
        id=view.id,
        team_id=team_id,
        run_id=run_id,
        kind=view.kind,
        subject=subject,
        body=canonical_json(view).decode("utf-8"),
        created_at=view.created_at,
    )
    session.add(row)
    session.flush()
    for contact in addresses:
        key = f"{row.id}/{contact.id}"
        delivery = new_item(
            Delivery, key, row.created_at, notification_id=row.id, contact_id=contact.id
        )
        session.add(delivery)
    return row


def notices_about(session: Session, submission_id: str) -> list[NotificationView]:
    """Return the notices to its team about a submission, newest first."""
    query = (
        select(Notification)
        .join(Submission, Submission.team_id == Notification.team_id)
        .where(Submission.id == submission_id)
        .order_by(Notification.created_at.desc(), Notification.id)
    )
    told = map(_view, session.scalars(query))
    return [view for view in told if _mentions(view, submission_id)]


def _mentions(view: NotificationView, submission_id: str) -> bool:
    """Whether a message lists a submission, links to it, or has its id in its text."""
    words = (view.title, *view.what_changed, view.comparison)
    return any(submission_id in each for each in words) or any(
        entry.submission_id == submission_id for entry in view.entries
    )


def listening_contacts(
    session: Session, team_id: int, subscription: Subscription | None
) -> list[ContactPoint]:
    """Return the confirmed addresses of a team with a subscription; None for all of them."""
    query = select(ContactPoint).where(
        ContactPoint.team_id == team_id,
        ContactPoint.removed_at.is_(None),
        ContactPoint.confirmed_at.is_not(None),
    )
    return [
        one
        for one in session.scalars(query)
        if subscription is None or subscription in one.wishes.split()
    ]


def list_notifications(
    session: Session,
    team_id: int,
    *,
    only_unread: bool = False,
    after: str | None = None,
    limit: int = 100,
) -> list[NotificationView]:
    """Return the inbox of a team, newest first, continuing after the message `after`.

    Raises:
        NotListed: `after` is not a message of the team.
    """
    query = _inbox(select(Notification), team_id, only_unread=only_unread)
    if after is not None:
        try:
            last = _find(session, team_id, after)
        except NotFound:
            raise NotListed from None
        place = tuple_(Notification.created_at, Notification.id)
        query = query.where(place < tuple_(last.created_at, last.id))
    newest_first = Notification.created_at.desc(), Notification.id.desc()
    return [_view(row) for row in session.scalars(query.order_by(*newest_first).limit(limit))]


def count_unread(session: Session, team_id: int) -> int:
    """Return the number of unread messages of the team."""
    query = select(func.count()).select_from(Notification)
    return session.scalar(_inbox(query, team_id, only_unread=True)) or 0


def mark_read(session: Session, team_id: int, notification_id: str) -> NotificationView:
    """Mark a message as read. Idempotent.

    Raises:
        NotFound: There is none, or it is another team's.
    """
    row = _find(session, team_id, notification_id)
    row.read_at = row.read_at or database_now(session)
    return _view(row)


def mark_all_read(session: Session, team_id: int) -> None:
    """Mark all messages in a team's inbox as read."""
    session.execute(
        update(Notification)
        .where(Notification.team_id == team_id, Notification.read_at.is_(None))
        .values(read_at=database_now(session))
    )


def _inbox(query: Select[Any], team_id: int, *, only_unread: bool) -> Select[Any]:
    query = query.where(Notification.team_id == team_id, Notification.kind != "confirm_address")
    return query.where(Notification.read_at.is_(None)) if only_unread else query


def _find(session: Session, team_id: int, notification_id: str) -> Notification:
    row = session.get(Notification, notification_id)
    if row is None or row.team_id != team_id:
        raise NotFound("notification", notification_id)
    return row


def _view(row: Notification) -> NotificationView:
    view = NotificationView.read(row.body)
    return view.model_copy(update={"read_at": row.read_at})


def _submissions(session: Session, submission_ids: list[str]) -> dict[str, tuple[Submission, Team]]:
    """Return submissions and their teams by id, with real names: anonymous boards show pseudonyms.

    The teams are locked, so that none is forgotten while it is being notified.
    """
    query = (
        select(Submission, Team)
        .join(Team, Team.id == Submission.team_id)
        .where(Submission.id.in_(submission_ids))
        .with_for_update(of=Team, read=True, key_share=True)
        .execution_options(populate_existing=True)
    )
    return {submission.id: (submission, team) for submission, team in session.execute(query)}
