"""The sentences of the board page: the headline, what changed, whose rows.

All of them come from the board's numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.boards.entry_facts import entry_url, primary_metrics
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.web.numbers import (
    THIN_SPACE,
    Digits,
    day,
    grouped,
    listed,
    with_unit,
)

MAX_NAMED = 3


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


@dataclass(frozen=True)
class BoardBefore:
    """The board that was shown before, without its entries."""

    number: int
    protocol: str
    published_at: datetime


@dataclass(frozen=True)
class ChangeLine:
    """The line, and where the whole history stands."""

    words: str
    history_url: str
    protocol_url: str | None
    """The page that says what the new protocol changed."""


def change_line(board: Board, before: BoardBefore | None) -> ChangeLine:
    """Say what is new: the protocol, entries, ranks."""
    history_url = f"/history?phase={board.phase}"
    if before is None:
        return ChangeLine("This is the first board of its phase.", history_url, None)
    is_updated = before.protocol != board.protocol.version
    parts = [f"protocol {before.protocol} became {board.protocol.version}"] if is_updated else []
    parts += _entry_parts(board)
    since = f"Since board {before.number} of {day(before.published_at)}"
    words = f"{since}: {'; '.join(parts)}." if parts else f"{since} no rank moved."
    return ChangeLine(
        words, history_url, f"/protocols/{board.protocol.version}" if is_updated else None
    )


def _entry_parts(board: Board) -> list[str]:
    ranked = [entry for entry in board.entries if entry.rank is not None]
    new = [entry for entry in ranked if entry.previous_rank is None]
    up = [entry for entry in ranked if _steps_up(entry) > 0]
    down = [entry for entry in ranked if _steps_up(entry) < 0]
    parts = []
    if new:
        parts.append(f"{counted(len(new), 'new entry', 'new entries')}{_named(new)}")
    if up:
        parts.append(f"{len(up)} moved up{_named(up)}")
    if down:
        parts.append(f"{len(down)} moved down{_named(down)}")
    return parts


def _named(entries: list[BoardEntry]) -> str:
    """Name a few; of many, none."""
    if len(entries) > MAX_NAMED:
        return ""
    return f" ({listed([f'{entry.method} to rank {entry.rank}' for entry in entries])})"


def _steps_up(entry: BoardEntry) -> int:
    if entry.rank is None or entry.previous_rank is None:
        return 0
    return entry.previous_rank - entry.rank


@dataclass(frozen=True)
class OwnEntries:
    """The rows of a team on one board.

    Attributes:
        ids: Submissions of the team that stand on the board.
        words: A sentence about them, with the name under which the team stands there.
        url: The same board with these rows alone.
    """

    ids: frozenset[str]
    words: str
    url: str


def own_entries(
    board: Board, submission_ids: frozenset[str], query: BoardQuery
) -> OwnEntries | None:
    """Return what of a board belongs to a team; None where nothing does.

    Args:
        board: The board as everybody reads it, under pseudonyms perhaps.
        submission_ids: All submissions of the team.
        query: The page that is asked for.
    """
    own = [entry for entry in board.entries if entry.submission_id in submission_ids]
    if not own:
        return None
    ranks = [entry.rank for entry in own if entry.rank is not None]
    count = "one entry" if len(own) == 1 else f"{len(own)} entries"
    place = (
        "without a rank" if not ranks else f"{'' if len(own) == 1 else 'best '}rank {min(ranks)}"
    )
    return OwnEntries(
        ids=frozenset(entry.submission_id for entry in own if entry.submission_id),
        words=f"Your team stands here as {own[0].team}: {count}, {place}.",
        url=query.url(search=own[0].team, source=None),
    )
