"""Two entries compared sample by sample, as the board carries it, set for either order."""

from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, PairedComparison, PairedDifference
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_server.pages.numbers import Digits, unit_of

NOT_SEPARABLE = "not separable on this split"


@dataclass(frozen=True)
class PairedLine:
    """One metric or family: the difference of the first minus the second, as text."""

    label: str
    difference: str
    interval: str
    discordant: str
    verdict: str
    is_sure: bool


@dataclass(frozen=True)
class PairedTable:
    """Overall by metric, then families by the metric that ranks first."""

    overall: tuple[PairedLine, ...]
    families: tuple[PairedLine, ...]
    sentence: str


def paired_table(
    board: Board, a: str, b: str, challenge: Challenge, digits: Digits
) -> PairedTable | None:
    """Return the comparison of two submissions, or None where the board carries none."""
    found = find_pair(board, a, b)
    if found is None:
        return None
    first = challenge.metrics[0]
    overall = tuple(
        _line(f"{m.label} {unit_of(m)}", m, found.overall[m.key], digits)
        for m in challenge.metrics
        if m.key in found.overall
    )
    return PairedTable(
        overall=overall,
        families=tuple(
            _line(f"{head.title}, {first.label} {unit_of(first)}", first, each, digits)
            for head in board.families
            if (each := found.families.get(head.id)) is not None
        ),
        sentence=_sentence(board, first, overall[0], found.overall[first.key]),
    )


def find_pair(board: Board, a: str, b: str) -> PairedComparison | None:
    """Return the comparison of two submissions in this order, where the board carries one."""
    for pair in board.comparisons:
        if (pair.a, pair.b) == (a, b):
            return pair
        if (pair.a, pair.b) == (b, a):
            return _turned(pair)
    return None


def _turned(pair: PairedComparison) -> PairedComparison:
    return PairedComparison(
        a=pair.b,
        b=pair.a,
        overall={key: _negated(each) for key, each in pair.overall.items()},
        families={key: _negated(each) for key, each in pair.families.items()},
        tasks={key: _negated(each) for key, each in pair.tasks.items()},
    )


def _negated(found: PairedDifference) -> PairedDifference:
    """B minus A; the verdict names a method, so it stays."""
    interval = None if found.interval is None else (-found.interval[1], -found.interval[0])
    difference = None if found.difference is None else -found.difference
    return found.model_copy(update={"difference": difference, "interval": interval})


def _line(label: str, metric: Metric, found: PairedDifference, digits: Digits) -> PairedLine:
    return PairedLine(
        label=label,
        difference="none" if found.difference is None else digits.signed(metric, found.difference),
        interval=_interval(metric, found, digits),
        discordant="" if found.discordant is None else f"{digits.fraction(found.discordant)} %",
        verdict=found.verdict,
        is_sure=found.verdict != NOT_SEPARABLE,
    )


def _interval(metric: Metric, found: PairedDifference, digits: Digits) -> str:
    if found.interval is None:
        return ""
    low, high = (digits.signed(metric, end) for end in found.interval)
    return f"{low} to {high}"


def _sentence(board: Board, first: Metric, line: PairedLine, found: PairedDifference) -> str:
    if found.interval is None:
        return f"Sample by sample, {first.label} gives no interval here."
    start = (
        f"Sample by sample, the difference in {first.label} is {line.interval} points "
        f"({board.confidence:.0%} interval): "
    )
    if line.is_sure:
        return f"{start}{line.verdict}."
    return f"{start}this split does not settle which is better."
