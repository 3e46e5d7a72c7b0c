"""The compare page: entries of one board side by side, the first two in detail."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple
from urllib.parse import urlencode

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_server.boards.charts import curve_chart, labels_of
from exceptiondrive_server.boards.comparison import (
    LONGEST_NAME,
    MAX_COMPARED,
    Comparison,
    difference_table,
    find_pair,
    flagged,
    side_of,
)
from exceptiondrive_server.boards.entry_facts import (
    board_fields,
    challenge_of,
    entry_key,
    entry_labels,
    is_barred,
)
from exceptiondrive_server.boards.families import DOT_WIDE, dot_plot
from exceptiondrive_server.boards.query import AVERAGE_TITLES
from exceptiondrive_server.boards.table import outcome_bar
from exceptiondrive_server.entries.queries import ComparedEntries
from exceptiondrive_server.web.numbers import Digits, listed


def compare_page(reading: ComparedEntries) -> dict[str, Any]:
    """Return what `compare.html` shows; without two entries there is nothing to compare."""
    shown, board, entries = reading.board, reading.board.board, reading.entries
    has_fine = board is not None and board.has_fine_intervals
    digits = Digits.of(shown.protocol.publication, has_fine_intervals=has_fine)
    keys = tuple(entry_key(entry) for entry in entries)
    page = {
        "shown": shown,
        "board": board,
        "challenge": shown.challenge,
        "digits": digits,
        "entries": entries,
        "keys": keys,
        "names": labels_of(entries, LONGEST_NAME),
        "has_room": len(keys) < MAX_COMPARED,
        "both": None,
        "kept_fields": board_fields(board, shown.is_current) if board else (),
    }
    if board is None or len(entries) < 2:
        return page
    both = Comparison(board, entries[0], entries[1], digits, entries)
    fields = board_fields(board, shown.is_current)
    told = zip(entries, reading.sheets, strict=True)
    is_many = len(entries) > 2
    curves = tuple((e, s.clearance_curve) for e, s in told if s and s.clearance_curve)
    return page | {
        "both": both,
        "labels": entry_labels(board),
        "fit": [entry for entry in entries if not is_barred(entry)],
        "pair_plot": dot_plot(board, entries[:2], digits),
        "plot": dot_plot(board, entries, digits) if is_many else None,
        "wide_plot": dot_plot(board, entries, digits, DOT_WIDE) if is_many else None,
        "bars": [outcome_bar(shown.challenge, entry.metrics, digits) for entry in entries[:2]],
        "differences": difference_table(
            both, shown.protocol, (reading.sheets[0], reading.sheets[1])
        ),
        "curves_chart": curve_chart(curves, board.headline, digits),
        "narrow_curves": curve_chart(curves, board.headline, digits, width=350, height=300),
        "average": AVERAGE_TITLES[board.headline],
        "against": [[against(board, one, other, digits) for other in entries] for one in entries],
        "verdict": verdict(board, entries, digits) if is_many else both.verdict,
        "address": compare_address(board_fields(board), keys),
        "swap_url": compare_address(fields, (keys[1], keys[0], *keys[2:])),
    }


def compare_address(fields: Sequence[tuple[str, str]], keys: Sequence[str]) -> str:
    """Return the address of a comparison of some entries on the board that the fields name."""
    given = (*fields, *zip(("a", "b"), keys, strict=False), *(("more", key) for key in keys[2:]))
    return f"/compare?{urlencode(given)}"


class Against(NamedTuple):
    """One entry against another: `sure`, `open`, `unknown`, or itself."""

    kind: str
    text: str = ""
    note: str = ""


def against(board: Board, one: BoardEntry, other: BoardEntry, digits: Digits) -> Against:
    """Compare two entries by the first metric, one minus the other."""
    if one is other:
        return Against("self")
    first = challenge_of(board).metrics[0]
    text = digits.difference(first, one.metrics.get(first.key), other.metrics.get(first.key))
    pair = find_pair(board, entry_key(one), entry_key(other))
    found = pair.overall[first.key] if pair else None
    if found is None or found.interval is None:
        return Against("unknown", text or "none", "no interval")
    if not side_of(found):
        return Against("open", text or "none", "not separable")
    is_better = (side_of(found) > 0) == (first.better == "higher")
    return Against("sure", text or "none", f"surely {'better' if is_better else 'worse'}")


def verdict(board: Board, entries: Sequence[BoardEntry], digits: Digits) -> str:
    """Say whom the best of these is surely ahead of, and from whom the split cannot tell it.

    One that a flag bars from leading is the best of none but its like.
    """
    first = challenge_of(board).metrics[0]
    keys = [entry_key(entry) for entry in entries]
    called = dict(zip(keys, labels_of(entries, LONGEST_NAME), strict=True))
    fit = [entry for entry in entries if not is_barred(entry)]
    leader = _best_by_metric(fit or entries, first)
    if leader is None:
        return f"None of them has {first.label}."
    level = [e for e in fit or entries if e is not leader and _is_level(e, leader, first, digits)]
    groups: dict[str, list[str]] = defaultdict(list)
    for other in entries:
        if other is not leader and other not in level:
            found = against(board, leader, other, digits)
            groups[found.note if found.kind == "sure" else found.kind].append(
                called[entry_key(other)]
            )
    among = "Of these" if len(fit) in (0, len(entries)) else "Of those that no flag bars"
    best = f"{among}, {called[entry_key(leader)]} has the best {first.label}"
    like = [called[entry_key(e)] for e in level]
    parts = [best + (f", level with {listed(like)}" if like else "")]
    for note in ("surely better", "surely worse"):
        if groups[note]:
            parts.append(f"it is {note} than {listed(groups[note])}")
    if groups["open"]:
        parts.append(f"this split does not tell it from {listed(groups['open'], 'or')}")
    if groups["unknown"]:
        parts.append(f"against {listed(groups['unknown'])} no paired interval is known")
    return " ".join(["; ".join(parts) + ".", *flagged(zip(entries, called.values(), strict=True))])


def _is_level(one: BoardEntry, other: BoardEntry, metric: Metric, digits: Digits) -> bool:
    """Whether a page shows the same value of both."""
    x, y = (digits.text(metric, each.metrics.get(metric.key)) for each in (one, other))
    return x == y


def _best_by_metric(entries: Sequence[BoardEntry], metric: Metric) -> BoardEntry | None:
    sign = -1 if metric.better == "higher" else 1
    known = [entry for entry in entries if entry.metrics.get(metric.key) is not None]
    return min(known, key=lambda e: sign * (e.metrics[metric.key] or 0.0), default=None)
