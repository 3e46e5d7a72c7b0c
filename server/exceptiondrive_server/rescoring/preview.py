"""The preview of a run: every entry before and after, worst movers first."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, Metric
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.rescoring import Comparison, EntryChange, PreviewView, Standing
from exceptiondrive_server.web.numbers import Digits, unit_of
from exceptiondrive_server.web.scales import px

# Old rank to new rank, a line per entry. Pure: standings in, positions out.
#
# Of a long board those entries are drawn that move most; the table beside it has them all.


MOST_LINES = 24
ROW = 26.0
TOP = 44.0
NOT_RANKED = "–"


@dataclass(frozen=True)
class SlopeLine:
    """One entry; `kind` is up, down, same, gone or new."""

    kind: str
    y1: str
    y2: str
    left_text: str
    right_text: str
    title: str


@dataclass(frozen=True)
class SlopeChart:
    """The drawing."""

    width: int
    height: int
    x1: int
    x2: int
    left_title: str
    right_title: str
    lines: tuple[SlopeLine, ...]
    n_left_out: int
    description: str


def slope_chart(comparison: Comparison, *, width: int, longest: int) -> SlopeChart | None:
    """Return the drawing; None when no entry is ranked on either board.

    Args:
        comparison: Two boards side by side.
        width: Of the drawing.
        longest: Characters of a name that have room beside the lines.
    """
    ranked = [one for one in comparison.entries if _rank(one, "old") or _rank(one, "new")]
    drawn = _drawn(ranked, comparison.worst_movers)
    if not drawn:
        return None
    left, right = _places(drawn, "old"), _places(drawn, "new")
    rows = len(drawn)
    margin = round(longest * 7.6 + 34)
    return SlopeChart(
        width=width,
        height=round(TOP + rows * ROW + 4),
        x1=margin,
        x2=width - margin,
        left_title=_slope_head(comparison, is_new=False),
        right_title=_slope_head(comparison, is_new=True),
        lines=tuple(_slope_line(one, left, right, longest) for one in drawn),
        n_left_out=len(ranked) - rows,
        description=_description(comparison, rows),
    )


def _drawn(ranked: Sequence[EntryChange], worst: Sequence[str]) -> list[EntryChange]:
    """The worst movers, then those that move most, then the top of the board."""
    order = {submission_id: place for place, submission_id in enumerate(worst)}

    def importance(one: EntryChange) -> tuple[bool, int, int, int]:
        place = order.get(one.submission_id, len(order))
        return (not one.newly_failing, -abs(one.rank_shift or 0), place, _sort_rank(one, "new"))

    return sorted(ranked, key=importance)[:MOST_LINES]


def _places(drawn: Sequence[EntryChange], side: str) -> dict[str, float]:
    """Rows by rank; ties keep rows of their own so that no two names cover each other."""
    ordered = sorted(drawn, key=lambda one: (_sort_rank(one, side), one.method, one.submission_id))
    return {one.submission_id: TOP + (row + 0.5) * ROW for row, one in enumerate(ordered)}


def _slope_line(
    one: EntryChange, left: dict[str, float], right: dict[str, float], longest: int
) -> SlopeLine:
    old, new = _rank(one, "old"), _rank(one, "new")
    name = one.method if len(one.method) <= longest else f"{one.method[: longest - 1]}…"
    return SlopeLine(
        kind=_kind(old, new),
        y1=px(left[one.submission_id]),
        y2=px(right[one.submission_id]),
        left_text=f"{name} {old or NOT_RANKED}",
        right_text=f"{new or NOT_RANKED} {name}",
        title=f"{one.method} of {one.team}: {_words(old)} before, {_words(new)} after",
    )


def _kind(old: int | None, new: int | None) -> str:
    if new is None:
        return "gone"
    if old is None:
        return "new"
    if old == new:
        return "same"
    return "up" if new < old else "down"


def _words(rank: int | None) -> str:
    return "not ranked" if rank is None else f"rank {rank}"


def _rank(one: EntryChange, side: str) -> int | None:
    standing = one.old if side == "old" else one.new
    return None if standing is None else standing.rank


def _sort_rank(one: EntryChange, side: str) -> int:
    return _rank(one, side) or 1_000_000


def _slope_head(comparison: Comparison, *, is_new: bool) -> str:
    ref = comparison.to_protocol if is_new else comparison.from_protocol
    if comparison.from_protocol == comparison.to_protocol:
        return "new split revision" if is_new else "old split revision"
    return f"under {ref.version}"


def _description(comparison: Comparison, rows: int) -> str:
    changed = counted(comparison.n_ranks_changed, "rank changes", "ranks change")
    return f"Old rank to new rank of {counted(rows, 'entry', 'entries')}; {changed} in all."


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
    challenge = CHALLENGES[comparison.challenge]
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
