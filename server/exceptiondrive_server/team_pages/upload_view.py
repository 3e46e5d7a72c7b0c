"""What the upload form shows: open phases, what is left of each quota, and when it begins anew."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.submission import PhaseView, Quota
from exceptiondrive_server.problem_vocabulary import TITLE_OF

_FIELD_WORDS = {"paper_url": "paper", "code_url": "code"}


@dataclass(frozen=True)
class PhaseOption:
    """A phase in the form."""

    id: str
    title: str
    challenge_title: str
    left_words: str
    is_spent: bool
    is_chosen: bool
    resets_at: datetime
    is_late: bool = False
    """Whether it has closed, and what comes now stands on its late view alone."""


@dataclass(frozen=True)
class Refusal:
    """Why the form was refused: a title, a sentence, and what is wrong with which field."""

    title: str
    detail: str
    fields: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class UploadView:
    """Everything that the form needs."""

    team: str
    phases: tuple[PhaseOption, ...]
    max_upload_bytes: int
    form_token: str
    typed: Mapping[str, str] = field(default_factory=dict)
    """What was typed before it was refused."""
    refusal: Refusal | None = None


def refusal_of(code: ProblemCode, detail: str, fields: Mapping[str, str]) -> Refusal:
    """Set a problem as the form says it: the same words as the API and the client."""
    named = tuple((_FIELD_WORDS.get(key, key), why) for key, why in fields.items())
    return Refusal(TITLE_OF[code], detail, named)


def upload_view(
    phases: Sequence[PhaseView], team: str, wanted: str | None, form_token: str
) -> UploadView:
    """Set the form; the phase that the address names is chosen, else the first open one.

    Closed phases that still rank late entries come last.
    """
    with_quota = [phase for phase in phases if phase.quota is not None]
    views = [phase for phase in with_quota if phase.is_open]
    views += [phase for phase in with_quota if _takes_late(phase)]
    known = [phase.id for phase in views]
    chosen = wanted if wanted in known else (known[0] if known else None)
    return UploadView(
        team=team,
        phases=tuple(quota_line(phase, is_chosen=phase.id == chosen) for phase in views),
        max_upload_bytes=min((phase.max_upload_bytes for phase in views), default=0),
        form_token=form_token,
    )


def quota_line(phase: PhaseView, *, is_chosen: bool = False) -> PhaseOption:
    """Return a phase with what its team has left."""
    assert phase.quota is not None
    quota = phase.quota
    return PhaseOption(
        id=phase.id,
        title=phase.title,
        challenge_title=CHALLENGES[ChallengeId(phase.challenge)].title,
        left_words=left_words(quota),
        is_spent=quota.remaining_today == 0 or quota.rejected_today >= quota.rejected_per_day,
        is_chosen=is_chosen,
        resets_at=quota.resets_at,
        is_late=_takes_late(phase),
    )


def _takes_late(phase: PhaseView) -> bool:
    return phase.now is not None and phase.now.takes_late_entries


def left_words(quota: Quota) -> str:
    """Say what is left: `3 of 5 left today, 12 of 20 in all`."""
    words = f"{quota.remaining_today} of {quota.per_day} left today"
    if quota.total is not None:
        words += f", {max(0, quota.total - quota.used_total)} of {quota.total} in all"
    if quota.rejected_today >= quota.rejected_per_day:
        words += f"; {quota.rejected_today} files rejected, which is the limit of a day"
    return words
