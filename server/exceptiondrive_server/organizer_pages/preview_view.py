"""The preview of a run: every entry before and after, worst movers first."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, ChallengeId, Metric
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.rescoring import Comparison, EntryChange, PreviewView, Standing
from exceptiondrive_server.organizer_pages.slope_chart import SlopeChart, slope_chart
from exceptiondrive_server.pages.numbers import Digits, unit_of

SHOWN = 40
"""Entries on a page: it stays small, and the file has them all."""
_DULL = 1e-9


@dataclass(frozen=True)
class Shift:
    """A number before and after; `tone` is better, worse or same."""

    old: str | None
    new: str | None
    difference: str | None
    tone: str


@dataclass(frozen=True)
class PreviewLine:
    """One entry before and after."""

    submission_id: str
    method: str
    team: str
    change: str
    newly_failing: bool
    why_not: str | None
    old_rank: str
    new_rank: str
    places: str
    places_tone: str
    metrics: tuple[Shift, ...]
    families: tuple[Shift, ...]


@dataclass(frozen=True)
class MetricHead:
    """A column of a primary metric."""

    label: str
    title: str
    unit: str


@dataclass(frozen=True)
class PreviewPage:
    """Everything that `preview.html` needs."""

    preview: PreviewView
    metrics: tuple[MetricHead, ...]
    family_metric: MetricHead
    families: tuple[tuple[str, str], ...]
    """Short and whole name of each family."""
    lines: tuple[PreviewLine, ...]
    n_worse: int
    number: int
    n_pages: int
    wide: SlopeChart | None
    narrow: SlopeChart | None


def preview_view(preview: PreviewView, protocol: Protocol, number: int = 1) -> PreviewPage:
    """Set the preview; `protocol` is the one to come, whose digits are published.

    Args:
        preview: What the next flip would change.
        protocol: Gives digits and the names of families.
        number: Of the page, from 1.
    """
    comparison = preview.comparison
    challenge = CHALLENGES[ChallengeId(comparison.challenge)]
    digits = Digits.of(protocol.publication)
    metrics = challenge.metrics[:2]
    titles = {family.id: family.title for family in protocol.families}
    keys = [key for key in titles if any(_has_family(one, key) for one in comparison.entries)]
    ordered = _ordered(comparison)
    n_pages = max(1, -(-len(ordered) // SHOWN))
    number = min(max(1, number), n_pages)
    shown = ordered[(number - 1) * SHOWN : number * SHOWN]
    return PreviewPage(
        preview=preview,
        metrics=tuple(_head(metric) for metric in metrics),
        family_metric=_head(challenge.metrics[0]),
        families=tuple((_short(titles[key]), titles[key]) for key in keys),
        lines=tuple(_line(one, challenge, digits, keys) for one in shown),
        n_worse=len(comparison.worst_movers),
        number=number,
        n_pages=n_pages,
        wide=slope_chart(comparison, width=860, longest=28),
        narrow=slope_chart(comparison, width=420, longest=15),
    )


def _ordered(comparison: Comparison) -> list[EntryChange]:
    """Worst movers first, then what changes, then the rest as the new board has it."""
    worst = {key: place for place, key in enumerate(comparison.worst_movers)}

    def order(one: EntryChange) -> tuple[int, bool, int]:
        rank = one.new.rank if one.new and one.new.rank else 1_000_000
        return (worst.get(one.submission_id, len(worst)), one.change == "none", rank)

    return sorted(comparison.entries, key=order)


def _line(
    one: EntryChange, challenge: Challenge, digits: Digits, families: Sequence[str]
) -> PreviewLine:
    first = challenge.metrics[0]
    places = one.rank_shift or 0
    return PreviewLine(
        submission_id=one.submission_id,
        method=one.method,
        team=one.team,
        change=one.change.replace("_", " "),
        newly_failing=one.newly_failing,
        why_not=one.new.unranked_because if one.new else None,
        old_rank=_rank_words(one.old),
        new_rank=_rank_words(one.new),
        places=f"{abs(places)} {'up' if places > 0 else 'down'}" if places else "",
        places_tone="better" if places > 0 else "worse",
        metrics=tuple(
            _shift(metric, digits, _value(one.old, metric), _value(one.new, metric))
            for metric in challenge.metrics[:2]
        ),
        families=tuple(
            _shift(first, digits, _family(one.old, key, first), _family(one.new, key, first))
            for key in families
        ),
    )


def _shift(metric: Metric, digits: Digits, old: float | None, new: float | None) -> Shift:
    if old is None or new is None:
        return Shift(digits.text(metric, old), digits.text(metric, new), None, "same")
    difference = new - old
    if abs(difference) < _DULL:
        return Shift(digits.text(metric, old), digits.text(metric, new), None, "same")
    is_better = (difference > 0) == (metric.better == "higher")
    tone = "better" if is_better else "worse"
    words = digits.signed(metric, difference)
    return Shift(digits.text(metric, old), digits.text(metric, new), words, tone)


def _head(metric: Metric) -> MetricHead:
    return MetricHead(metric.label, metric.title, unit_of(metric))


def _rank_words(standing: Standing | None) -> str:
    if standing is None:
        return "not there"
    if standing.rank is None:
        return "not ranked"
    if standing.rank_interval is None or standing.rank_interval[0] == standing.rank_interval[1]:
        return str(standing.rank)
    low, high = standing.rank_interval
    return f"{standing.rank} ({low} to {high})"


def _value(standing: Standing | None, metric: Metric) -> float | None:
    return None if standing is None else standing.metrics.get(metric.key)


def _family(standing: Standing | None, family: str, metric: Metric) -> float | None:
    return None if standing is None else standing.families.get(family, {}).get(metric.key)


def _has_family(one: EntryChange, family: str) -> bool:
    return any(side is not None and family in side.families for side in (one.old, one.new))


def _short(title: str) -> str:
    return title.split()[0]
