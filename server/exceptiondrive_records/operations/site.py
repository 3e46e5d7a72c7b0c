"""Site-wide settings: the links on every page, and the progress of building the sample at start."""

import re
from datetime import timedelta

from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import hold_words
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.db.identifiers import checked_link, checked_text
from exceptiondrive_records.teams.tables import SiteSetting
from exceptiondrive_schemas.api.form_fields import fields_of
from exceptiondrive_schemas.api.site import SiteLinks

_NAME = "links"
_E_MAIL = re.compile(r"[^\s@<>\"'?&:/]+@[^\s@<>\"'?&:/]+\.[^\s@<>\"'?&:/]+")


def site_links(session: Session) -> SiteLinks:
    """Return the links of the site; all are empty at first."""
    row = session.get(SiteSetting, _NAME)
    return SiteLinks() if row is None else SiteLinks.model_validate(row.value, extra="ignore")


def set_site_links(session: Session, change: SiteLinks, *, actor: str) -> SiteLinks:
    """Set those links that are set in `change`; keep the others.

    Raises:
        InvalidRecord: A link is no https address, or a text cannot be shown.
    """
    hold_words(session, "links of the site")
    before = site_links(session)
    given = {name: getattr(change, name) for name in change.model_fields_set}
    after = _checked_links(before.model_copy(update=given))
    changed = {
        name: [getattr(before, name), getattr(after, name)]
        for name in SiteLinks.model_fields
        if getattr(before, name) != getattr(after, name)
    }
    if changed:
        now = database_now(session)
        session.merge(SiteSetting(name=_NAME, value=after.model_dump(), changed_at=now))
        audit(session, actor, "site links changed", "site", changed)
    return after


_PREPARING = "preparing"
_PREPARING_AT_LONGEST = timedelta(minutes=10)
"""An older message is of a process that died."""


def say_preparing(session: Session, words: str) -> None:
    """Let pages show what is being prepared before there is anything to see; empty words end it."""
    row = SiteSetting(name=_PREPARING, value={"words": words}, changed_at=database_now(session))
    session.merge(row)


def in_preparation(session: Session) -> str:
    """Return a sentence about what is being prepared now; empty if nothing is."""
    row = session.get(SiteSetting, _PREPARING)
    if row is None or row.changed_at + _PREPARING_AT_LONGEST < database_now(session):
        return ""
    return str(row.value["words"])


def _checked_links(links: SiteLinks) -> SiteLinks:
    texts = {
        field.name: checked_text(
            field.label.lower(),
            getattr(links, field.name),
            max_length=field.max_length,
            may_be_empty=True,
            may_have_lines=field.kind == "lines",
        )
        for field in fields_of(SiteLinks)
    }
    checked_link("paper", texts["paper_url"])
    checked_link("code", texts["code_url"])
    contact = texts["contact"]
    if contact and _E_MAIL.fullmatch(contact) is None:
        try:
            checked_link("contact", contact)
        except InvalidRecord:
            words = "The contact must be an e-mail address, or an https:// address."
            raise InvalidRecord(words) from None
    return SiteLinks(**texts)
