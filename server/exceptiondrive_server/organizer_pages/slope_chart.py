"""Old rank to new rank, a line per entry. Pure: standings in, positions out.

Of a long board those entries are drawn that move most; the table beside it has them all.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.rescoring import Comparison, EntryChange
from exceptiondrive_server.pages.scales import px

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
        left_title=_head(comparison, is_new=False),
        right_title=_head(comparison, is_new=True),
        lines=tuple(_line(one, left, right, longest) for one in drawn),
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


def _line(
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


def _head(comparison: Comparison, *, is_new: bool) -> str:
    ref = comparison.to_protocol if is_new else comparison.from_protocol
    if comparison.from_protocol == comparison.to_protocol:
        return "new split revision" if is_new else "old split revision"
    return f"under {ref.version}"


def _description(comparison: Comparison, rows: int) -> str:
    changed = counted(comparison.n_ranks_changed, "rank changes", "ranks change")
    return f"Old rank to new rank of {counted(rows, 'entry', 'entries')}; {changed} in all."
