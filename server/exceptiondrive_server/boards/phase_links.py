"""What pages say of a phase, of whatever noun they are, and which phase is asked for."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from math import inf

from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.phases import list_phases, not_checked
from exceptiondrive_records.phases.policy import is_open, takes_late_entries
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.splits.splits import whole_split
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_schemas.api.phase_settings import Visibility
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge
from exceptiondrive_schemas.protocol import NEWEST, ProtocolDocument, packaged_protocol
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.web.numbers import day, minute


@dataclass(frozen=True)
class PhaseLink:
    """A phase as pages say it, with the address under which its board stands."""

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
    visibility: Visibility
    description: str
    """Markdown."""
    opens_at: datetime | None
    closes_at: datetime | None
    quota_per_day: int
    rejected_per_day: int
    """How many wrong files a day are taken of a team."""
    split: str
    split_is_public: bool
    has_data: bool
    """Whether its page says where scenes and pictures are had."""
    not_checked: tuple[str, ...]
    """What nobody checks of a file for it, in sentences."""
    run_rule: str
    """Which run of a method stands, in a sentence."""
    url: str

    @property
    def state_words(self) -> str:
        """Say whether it takes submissions, and until or from when."""
        if self.visibility != "shown":
            return self.visibility.capitalize()
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
        return "" if self.is_open else "closed" if self.is_shown else self.visibility

    @property
    def is_shown(self) -> bool:
        """Whether it is neither archived nor hidden."""
        return self.visibility == "shown"

    @property
    def is_past(self) -> bool:
        """Whether it has closed, or was put away."""
        return (
            self.is_shown and not (self.is_open or self.is_ahead)
        ) or self.visibility == "archived"

    @property
    def takes_files(self) -> bool:
        """Whether it takes submissions now, be it for the late view."""
        return self.is_open or self.takes_late

    @property
    def page_url(self) -> str:
        """Address of the page about it."""
        return f"/phases/{self.id}"

    @property
    def challenge_title(self) -> str:
        """Name of the challenge."""
        return self.challenge.title


def read_phases(
    session: Session, query: BoardQuery
) -> tuple[tuple[PhaseLink, ...], PhaseLink | None]:
    """Read all phases, and the one asked for.

    Raises:
        NotFound: The phase does not exist.
    """
    links = phase_links(session, choose_phase(session, query))
    return links, next((link for link in links if link.is_current), None)


def phase_links(session: Session, chosen: Phase | None) -> tuple[PhaseLink, ...]:
    """Return what pages say of all phases that are listed, and of the one that is asked for."""
    phases = list_phases(session)
    if chosen is not None and chosen not in phases:
        phases.append(chosen)
    return tuple(phase_link(session, each, each is chosen) for each in phases)


def phase_link(session: Session, phase: Phase, is_current: bool = False) -> PhaseLink:
    """Return what pages say of a phase."""
    split = session.get_one(SplitRow, (phase.split_name, phase.split_revision))
    is_whole = split.whole_revision is None
    whole = split if is_whole else whole_split(session, split.name, split.revision)
    now = database_now(session)
    challenge = CHALLENGES[phase.challenge]
    return PhaseLink(
        id=phase.id,
        title=phase.title,
        challenge=challenge,
        n_samples=split.n_samples,
        is_open=is_open(phase, now),
        is_ahead=phase.opens_at is not None and now < phase.opens_at,
        takes_late=takes_late_entries(session, phase, now),
        is_current=is_current,
        visibility=phase.visibility,
        description=phase.description,
        opens_at=phase.opens_at,
        closes_at=phase.closes_at,
        quota_per_day=phase.quota_per_day,
        rejected_per_day=phase.rejected_per_day,
        split=phase.split_name,
        split_is_public=split.public_file_digest is not None,
        has_data=bool(phase.page.data_url or phase.page.data_manifest_url),
        not_checked=not_checked(phase.challenge, whole),
        run_rule=phase.policy.run_rule,
        url=f"/?phase={phase.id}#board",
    )


def choose_phase(session: Session, query: BoardQuery, *, with_hidden: bool = False) -> Phase | None:
    """Return the phase asked for, else the first by position, then in the order of challenges.

    Returns:
        None where no phase is named and there is none at all.

    Raises:
        NotFound: The phase does not exist, or is not of the challenge that is asked for.
    """
    phases = list_phases(session, with_hidden=with_hidden and query.phase is not None)
    if query.phase is not None:
        found = next((phase for phase in phases if phase.id == query.phase), None)
        if found is None:
            raise NotFound("phase", query.phase)
        if query.challenge is not None and found.challenge != query.challenge:
            raise NotFound(f"phase of the {query.challenge} challenge", query.phase)
        return found
    order = [query.challenge] if query.challenge else list(CHALLENGES)
    offered = [phase for phase in phases if phase.challenge in order]
    if query.challenge is not None and not offered:
        raise NotFound("phase of the challenge", query.challenge)
    return min(offered, key=lambda phase: _place(phase, order), default=None)


def featured_protocol(session: Session) -> ProtocolDocument:
    """Return the protocol of the phase on the front page; without any, the newest packaged one."""
    phase = choose_phase(session, BoardQuery())
    if phase is None:
        return packaged_protocol(NEWEST)
    return find_protocol(session, phase.protocol_digest)


def _place(phase: Phase, challenges: Sequence[str]) -> tuple[bool, float, int]:
    """Where a phase stands among those that may be the front page."""
    position = inf if phase.position is None else phase.position
    return phase.visibility == "archived", position, challenges.index(phase.challenge)
