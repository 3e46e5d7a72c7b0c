"""News of a phase, published on its page, in its feed, and to the inbox of every team."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import find_row
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import checked_reason, checked_text, random_id
from exceptiondrive_records.news.tables import News
from exceptiondrive_records.participation.messages import (
    MAX_TEXT,
    MAX_TITLE,
    recipients,
    send_message,
)
from exceptiondrive_records.phases.phases import find_phase


def publish_news(
    session: Session,
    phase_id: str,
    title: str,
    text: str,
    *,
    actor: str,
    plain: str,
    to_its_teams: bool = False,
) -> News:
    """Publish news of a phase and notify every team; the same text is sent only once.

    The text is Markdown. Inboxes show plain text: `plain`, or the text as written. With
    `to_its_teams` only teams that submitted to the phase are notified.

    Raises:
        NotFound: No such phase.
        InvalidRecord: A text cannot be used.
        Conflict: The phase is hidden, or a team has the same message already.
    """
    phase = find_phase(session, phase_id)
    if phase.visibility == "hidden":
        raise Conflict("The phase is hidden: show it first.")
    row = News(
        id=random_id(),
        phase_id=phase.id,
        title=checked_text("title", title, max_length=MAX_TITLE),
        text=checked_text("text", text, max_length=MAX_TEXT, may_have_lines=True),
        published_at=database_now(session),
        withdrawn_at=None,
    )
    session.add(row)
    session.flush()
    only_of = phase.id if to_its_teams else None
    if recipients(session, phase=only_of):
        title = f"{phase.title}: {row.title}"[:MAX_TITLE]
        here = f"/phases/{phase.id}#news-{row.id}"
        words = plain or row.text
        send_message(session, title, words, actor=actor, phase=only_of, address=here)
    audit(session, actor, "news published", row.id, {"phase": phase.id, "title": row.title})
    return row


def withdraw_news(session: Session, news_id: str, *, reason: str, actor: str) -> News:
    """Remove news from page and feed; notices to teams stay.

    Raises:
        NotFound: There are none with this id.
        InvalidRecord: The reason is empty.
        Conflict: They are withdrawn already.
    """
    row = find_news(session, news_id, lock=True)
    reason = checked_reason(reason)
    if row.withdrawn_at is not None:
        raise Conflict("This news is withdrawn already.")
    row.withdrawn_at = database_now(session)
    detail = {"phase": row.phase_id, "title": row.title, "reason": reason}
    audit(session, actor, "news withdrawn", row.id, detail)
    return row


def find_news(session: Session, news_id: str, *, lock: bool = False) -> News:
    """Return news, including withdrawn ones.

    Raises:
        NotFound: There are none with this id.
    """
    return find_row(session, News, "news", news_id, lock=lock)


def news_of(session: Session, phase_id: str) -> list[News]:
    """Return the news of a phase that readers see, newest first."""
    query = select(News).where(News.phase_id == phase_id, News.withdrawn_at.is_(None))
    return list(session.scalars(query.order_by(News.published_at.desc(), News.id)))


def list_news(session: Session, phase_id: str | None = None) -> list[News]:
    """Return the news of one phase or of all, including withdrawn ones, newest first.

    Raises:
        NotFound: There is no such phase.
    """
    query = select(News).order_by(News.published_at.desc(), News.id)
    if phase_id is not None:
        query = query.where(News.phase_id == find_phase(session, phase_id).id)
    return list(session.scalars(query))
