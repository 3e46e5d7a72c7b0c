"""The sentences on top of the board page. All of them come from the board's numbers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.boards.entry_facts import entry_url, primary_metrics
from exceptiondrive_server.web.numbers import THIN_SPACE, Digits, grouped, with_unit


@dataclass(frozen=True)
class Fact:
    """One big figure under the headline."""

    label: str
    value: str
    note: str
    url: str | None = None


@dataclass(frozen=True)
class Headline:
    """Headline, first paragraph (as plain sentences) and facts."""

    title: str
    findings: tuple[str, ...]
    facts: tuple[Fact, ...]


def headline(board: Board | None, challenge: Challenge, n_tasks: int, digits: Digits) -> Headline:
    """Say what the board shows; without a scored entry, what the paper reported, or nothing."""
    words = challenge.words
    if board is None:
        return Headline(words.headline.question, ("No board has been published yet.",), ())
    ranked = [entry for entry in board.entries if entry.rank is not None]
    reported = [entry for entry in board.entries if entry.source == "reported"]
    shown = ranked or reported
    facts = (
        Fact("Samples scored", grouped(board.n_samples), words.sample_note),
        Fact("Tasks", str(n_tasks), f"in {counted(len(board.families), 'family', 'families')}"),
        _entries_fact(words.subjects.capitalize(), ranked, reported),
        *_best_facts(challenge, shown, digits, partial(entry_url, board=board)),
    )
    return Headline(
        _title(challenge, ranked), _findings(challenge, ranked, reported, digits), facts
    )


def _entries_fact(label: str, ranked: Sequence[BoardEntry], reported: Sequence[BoardEntry]) -> Fact:
    if ranked:
        note = "ranked" + (f", {len(reported)} reported" if reported else "")
        return Fact(label, grouped(len(ranked)), note)
    note = "reported, none scored yet" if reported else "none scored yet"
    return Fact(label, grouped(len(reported)), note)


def _best(entries: Sequence[BoardEntry], metric: Metric) -> BoardEntry | None:
    known = [entry for entry in entries if entry.metrics.get(metric.key) is not None]
    sign = -1 if metric.better == "higher" else 1
    return min(known, key=lambda e: sign * (e.metrics[metric.key] or 0.0), default=None)


def _best_facts(
    challenge: Challenge,
    entries: Sequence[BoardEntry],
    digits: Digits,
    url: Callable[[BoardEntry], str],
) -> tuple[Fact, ...]:
    facts = []
    for metric in primary_metrics(challenge):
        best = _best(entries, metric)
        if best is None:
            continue
        text = digits.text(metric, best.metrics[metric.key]) or ""
        word = "Highest" if metric.better == "higher" else "Lowest"
        facts.append(
            Fact(
                f"{word} {metric.label}",
                with_unit(metric, text),
                best.method,
                url(best),
            )
        )
    return tuple(facts)


def _title(challenge: Challenge, ranked: Sequence[BoardEntry]) -> str:
    """One sentence about the safest ranked entry; a question where there is none."""
    second = primary_metrics(challenge)[1]
    safest = _best(ranked, second)
    value = safest.metrics[second.key] if safest else None
    words = challenge.words.headline
    if value is None:
        return words.question
    sentence = next((text for least, text in words.by_share if value >= least), words.question)
    return sentence.format(often=_often(value), cases=_often_noun(value), rest=_often(1 - value))


def _often(share: float) -> str:
    """Write a share as `4 times out of 5`, on the nearest honest small fraction."""
    hits, of = _small_fraction(share)
    return f"{'once' if hits == 1 else f'{hits} times'} in {of}"


def _often_noun(share: float) -> str:
    hits, of = _small_fraction(share)
    return f"{'one' if hits == 1 else hits} hazard{'' if hits == 1 else 's'} in {of}"


def _small_fraction(share: float) -> tuple[int, int]:
    """Return the simplest fraction within 1.5 points of a share: hits, out of."""
    for of in (2, 3, 4, 5, 6, 7, 8, 9, 10):
        hits = round(share * of)
        if 0 < hits < of and abs(hits / of - share) <= 0.015:
            return hits, of
    return max(1, min(99, round(share * 100))), 100


def _findings(
    challenge: Challenge,
    ranked: Sequence[BoardEntry],
    reported: Sequence[BoardEntry],
    digits: Digits,
) -> tuple[str, ...]:
    if ranked:
        of = f"Of {counted(len(ranked), f'ranked {challenge.words.subject}')}"
        return (_finding(challenge, ranked, of, digits),)
    none = "Nobody has been scored on this board yet."
    if not reported:
        return (none,)
    of = f"Of the {len(reported)} {challenge.words.subjects} in the paper"
    return (none, _finding(challenge, reported, of, digits))


def _finding(challenge: Challenge, entries: Sequence[BoardEntry], of: str, digits: Digits) -> str:
    first, second = primary_metrics(challenge)[:2]
    best, safest = _best(entries, first), _best(entries, second)
    if best is None or safest is None:
        return ""
    high = digits.fraction(best.metrics[first.key] or 0.0)
    low = digits.fraction(safest.metrics[second.key] or 0.0)
    who = best.method if best is safest else f"{best.method} and {safest.method}"
    verb = "reaches" if best is safest else "reach"
    if len(entries) == 1:
        return (
            f"The only one so far, {who}, reaches a {first.title.lower()} of {high}{THIN_SPACE}% "
            f"and a {second.title.lower()} of {low}{THIN_SPACE}%."
        )
    return (
        f"{of}, {who} {verb} the highest {first.title.lower()}, {high}{THIN_SPACE}%, "
        f"and the lowest {second.title.lower()}, {low}{THIN_SPACE}%."
    )
