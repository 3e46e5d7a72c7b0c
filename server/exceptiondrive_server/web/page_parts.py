"""What pages of several nouns carry: phases to switch to, options of a field, notices."""

from dataclasses import dataclass
from datetime import datetime

from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_server.web.numbers import day, minute


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
