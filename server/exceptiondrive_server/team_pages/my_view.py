"""What the list of a team's submissions shows."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from exceptiondrive_records.tokens import Principal, Scope
from exceptiondrive_schemas.phase_settings import PhasePolicy
from exceptiondrive_schemas.submission import PhaseView, SubmissionStatus, SubmissionView
from exceptiondrive_server.team_pages.status_words import Status, status_of
from exceptiondrive_server.team_pages.submission_view import actions_of
from exceptiondrive_server.team_pages.upload_view import PhaseOption, quota_line

MAX_FOLLOWED = 3
"""Browsers open six connections to a host over HTTP/1.1; the page needs some for itself."""


@dataclass(frozen=True)
class MyLine:
    """One submission in the list."""

    id: str
    method: str
    team: str
    phase: str
    received_at: datetime
    status: Status
    rank: int | None
    standing: str
    """How it stands in the policy of its phase; empty where there is nothing to say."""
    actions: tuple[tuple[str, str], ...]
    """What the team may say of it: end of the address, and words."""


@dataclass(frozen=True)
class PhaseRules:
    """What the list needs to know of the phase of a submission."""

    policy: PhasePolicy
    has_closed: bool


@dataclass(frozen=True)
class MyPage:
    """Everything that `my.html` needs."""

    team: str | None
    token_name: str
    lines: tuple[MyLine, ...]
    quotas: tuple[PhaseOption, ...]
    following: str | None
    followed: tuple[str, ...]
    form_token: str
    has_tokens: bool
    person_name: str
    """Empty when a token signed in."""
    has_team_page: bool

    @property
    def has_sayings(self) -> bool:
        """Whether a phase in the list leaves something for the team to choose or publish."""
        return any(line.standing or line.actions for line in self.lines)


def my_view(
    who: Principal,
    submissions: Sequence[SubmissionView],
    *,
    phases: Sequence[PhaseView],
    rules: Mapping[str, PhaseRules],
    following: str | None,
    form_token: str,
) -> MyPage:
    """Set the list; the newest that still wait are followed."""
    can_say = Scope.SUBMIT in who.scopes and who.team_id is not None
    waiting = [one.id for one in submissions if not one.status.is_terminal]
    return MyPage(
        team=who.team_name,
        token_name=who.token_name,
        lines=tuple(_line(one, rules[one.phase], can_say) for one in submissions),
        quotas=tuple(quota_line(phase) for phase in phases if phase.is_open),
        following=following,
        followed=tuple(waiting[:MAX_FOLLOWED]),
        form_token=form_token,
        has_tokens=Scope.TOKENS in who.scopes and who.team_id is not None,
        person_name=who.person_name,
        has_team_page=who.person_id is not None
        or (Scope.TOKENS in who.scopes and who.team_id is not None),
    )


def _line(one: SubmissionView, rules: PhaseRules, can_say: bool) -> MyLine:
    policy, has_closed = rules.policy, rules.has_closed
    return MyLine(
        id=one.id,
        method=one.method,
        team=one.team,
        phase=one.phase,
        received_at=one.received_at,
        status=status_of(one),
        rank=one.rank,
        standing=", ".join(_standing(one, policy)),
        actions=actions_of(one, policy, has_closed=has_closed) if can_say else (),
    )


def _standing(one: SubmissionView, policy: PhasePolicy) -> Iterator[str]:
    if one.status is not SubmissionStatus.SCORED:
        return
    if one.is_chosen and policy.entries_shown == "chosen":
        yield "chosen"
    if policy.entries_private:
        yield "published" if one.is_published else "private"
    if one.is_late:
        yield "late"
