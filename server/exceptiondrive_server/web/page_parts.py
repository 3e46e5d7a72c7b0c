"""What every page carries besides its subject: theme, place in the navigation, choices."""

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from markupsafe import Markup

from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_server.web.numbers import day, minute

Theme = Literal["auto", "light", "dark"]
THEMES: tuple[Theme, ...] = ("auto", "light", "dark")
_DIRECTIONS = {"higher": "higher is better", "lower": "lower is better", None: "diagnostic"}


@dataclass(frozen=True)
class Site:
    """The frame around a page."""

    theme: Theme
    path: str
    current: str
    has_session: bool = False
    """Whether the browser sent a session, valid or not: only words depend on it."""
    origin: str = ""
    """What people type before the path, for the addresses that other sites follow."""
    is_organizer: bool = False
    """Whether it once signed in as an organizer: only a link depends on it, never a right."""


@dataclass(frozen=True)
class Choice:
    """One option of a select field."""

    value: str
    title: str
    is_current: bool


@dataclass(frozen=True)
class PhaseLink:
    """A phase that a visitor may switch to."""

    id: str
    title: str
    challenge: Challenge
    n_samples: int
    is_open: bool
    is_ahead: bool
    """Whether it has not opened yet."""
    takes_late: bool
    """Whether it has closed, and what comes now is ranked on its late view."""
    is_current: bool
    opens_at: datetime | None
    closes_at: datetime | None
    quota_per_day: int
    split: str
    split_is_public: bool
    url: str

    @property
    def state_words(self) -> str:
        """Say whether it takes submissions, and until or from when."""
        if self.is_ahead and self.opens_at:
            return f"Opens {minute(self.opens_at)}"
        if self.is_open:
            return (
                f"Open until {minute(self.closes_at)}" if self.closes_at else "Open for submissions"
            )
        return f"Closed since {minute(self.closes_at)}" if self.closes_at else "Closed"

    @property
    def state_word(self) -> str:
        """Say it in a word where it is not open: `closed`, `opens 3 Dec 2026`."""
        if self.is_ahead and self.opens_at:
            return f"opens {day(self.opens_at)}"
        return "" if self.is_open else "closed"

    @property
    def challenge_title(self) -> str:
        """Name of the challenge."""
        return self.challenge.title


@dataclass(frozen=True)
class Notice:
    """A sentence above the board, with a way out."""

    words: str
    url: str
    link_words: str


@dataclass(frozen=True)
class MetricCard:
    """A metric explained."""

    key: str
    label: str
    title: str
    direction: str
    meaning: str
    formula: Markup


def metric_cards(challenge: Challenge) -> tuple[MetricCard, ...]:
    """Return a card per metric; components of a metric (CTSx, CTSy) share its card."""
    return tuple(
        MetricCard(m.key, m.label, m.title, _DIRECTIONS[m.better], m.meaning, Markup(m.formula))
        for m in challenge.metrics
        if not m.part_of
    )
