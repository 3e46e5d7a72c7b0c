"""Information about the whole site: the organizers' links, and whether scoring keeps up."""

from datetime import date, datetime
from typing import Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document


class SiteLinks(Document):
    """Links of every page's header and footer; what is empty is not shown."""

    paper_url: str = Field(
        default="", max_length=500, title="Paper", description="https address of the paper."
    )
    code_url: str = Field(
        default="", max_length=500, title="Code", description="https address of the code."
    )
    citation: str = Field(
        default="",
        max_length=4000,
        title="Citation",
        description="BibTeX with which papers cite the benchmark; it gets its own page.",
    )
    contact: str = Field(
        default="",
        max_length=500,
        title="Contact",
        description="An https address, or an e-mail address.",
    )

    @property
    def contact_url(self) -> str:
        """The target of the contact link."""
        is_mail = self.contact and not self.contact.startswith("https://")
        return f"mailto:{self.contact}" if is_mail else self.contact


class LastBoard(Document):
    """The board that was published last, of all phases that are shown."""

    phase: str
    board: int
    published_at: datetime


class ScoringDay(Document):
    """How scoring went on one day (UTC)."""

    day: date
    longest_wait_s: float | None
    """From an upload until its scoring began; None where nothing was scored."""
    n_failed: int
    """Submissions that failed: by our own fault, or beyond what a withheld split allows a day."""


class ServiceStatus(Document):
    """Whether submissions are scored now, and how it went of late; the same for everybody."""

    state: Literal["up", "delayed"]
    sentence: str
    live_workers: int
    """Processes that score, one submission at a time each."""
    waiting: int
    """Submissions that no worker scores yet."""
    running: int
    """Submissions that are being scored."""
    oldest_wait_s: float | None
    """Of what waits now."""
    usual_scoring_s: float | None
    """Median of the last ones."""
    last_board: LastBoard | None
    days: tuple[ScoringDay, ...]
    """The newest first; days on which nothing came are left out."""
