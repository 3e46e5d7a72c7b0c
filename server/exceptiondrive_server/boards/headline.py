"""The sentences of the board page: the headline, what changed, whose rows they are.

All of them are derived from the board's numbers.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

from exceptiondrive_records.splits.splits import part_words
from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.board import Board, BoardEntry, EntryNews
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.boards.entry_facts import entry_key, flags_of, is_listed, primary_metrics
from exceptiondrive_server.boards.query import AVERAGE_TITLES, BoardQuery
from exceptiondrive_server.web.numbers import DASH, Digits, day, grouped, listed, with_unit

MAX_NAMED = 3


@dataclass(frozen=True)
class Fact:
    """One figure under the headline."""

    label: str
    value: str
    note: str


@dataclass(frozen=True)
class Headline:
    """Headline, first paragraph (as plain sentences) and facts."""

    title: str
    findings: tuple[str, ...]
    facts: tuple[Fact, ...]


def headline(board: Board | None, challenge: Challenge, protocol: ProtocolDocument) -> Headline:
    """Say what the board shows of its leader, whom no flag bars from leading, and of the others."""
    words = challenge.words
    if board is None:
        return Headline(words.headline.question, ("No board has been published yet.",), ())
    ranked = [entry for entry in board.entries if entry.rank is not None]
    n_listed = sum([is_listed(entry) for entry in board.entries])
    subject = words.subject if len(ranked) == 1 else words.subjects
    note = f"{subject} ranked"
    note += f", {n_listed} without a rank" if n_listed else ""
    facts = (
        Fact("Samples scored", grouped(board.n_samples), words.sample_note),
        Fact("Tasks", str(len(protocol.tasks)), "kinds of hazard"),
        Fact(words.subjects.capitalize(), grouped(len(ranked)), note),
    )
    return Headline(_title(board, challenge), _findings(board, ranked, challenge, protocol), facts)


def _title(board: Board, challenge: Challenge) -> str:
    """One sentence that counts the leader's samples; a question where there is none."""
    second, words = primary_metrics(challenge)[1], challenge.words.headline
    share = board.leader.micro.get(second.key) if board.leader else None
    if share is None:
        return words.question
    sentence = next(text for least, text in words.by_share if share >= least)
    is_alone = len([entry for entry in board.entries if entry.rank is not None]) == 1
    the = "The only ranked" if is_alone else "The leading"
    even_the = the if is_alone else "Even the leading"
    return sentence.format(
        the=the, even_the=even_the, often=_how_often(share), rest=_how_often(1 - share)
    )


def _how_often(share: float) -> str:
    """Write a share as `in about 4 of 5 samples`, on the nearest honest small fraction."""
    about, hits, of = _small_fraction(share)
    if hits in (0, of):
        return "every time" if hits else "not once"
    return f"in {about}{'one' if hits == 1 else hits} of {of} samples"


def _small_fraction(share: float) -> tuple[str, int, int]:
    """Return "about " or what else stands before a fraction, its hits, and out of how many.

    It is the nearest in at most ten, if within 1.5 points, and of equally near ones the simplest;
    else the nearest in a hundred. A share that is nearly, and not quite, none or all is never said
    to be it.
    """
    if share in (0.0, 1.0):
        return "", int(share), 1
    if not 0.01 <= share <= 0.99:
        return ("less than ", 1, 100) if share < 0.5 else ("over ", 99, 100)
    small = [of for of in range(2, 11) if 0 < round(share * of) < of]
    near = [(abs(round(share * of) / of - share), of) for of in small]
    distance, of = min(near, default=(1.0, 100))
    of = of if distance <= 0.015 else 100
    hits = round(share * of)
    return ("" if hits / of == share else "about "), hits, of


def _findings(
    board: Board, ranked: Sequence[BoardEntry], challenge: Challenge, protocol: ProtocolDocument
) -> tuple[str, ...]:
    words, leader = challenge.words, board.leader
    if not ranked:
        return (f"No {words.subject} is ranked on this board.",)
    if leader is None:
        flags = listed(sorted({flag.label for entry in ranked for flag in entry.flags}))
        return (f"Nobody leads: every ranked {words.subject} is flagged ({flags}).",)
    digits = Digits.of(protocol.publication)
    one, two = primary_metrics(challenge)[:2]
    first, second, of_all = (
        with_unit(metric, digits.text(metric, row.get(metric.key)) or DASH)
        for metric, row in ((one, leader.metrics), (two, leader.metrics), (two, leader.micro))
    )
    numbers = words.headline.leads.format(first=first, second=second)
    numbers += f", as the {AVERAGE_TITLES[board.headline]}"
    if of_all != second:  # the title counts samples
        numbers += f"; over all samples, {two.label} is {of_all}"
    if len(ranked) == 1:
        lead = f"The only ranked {words.subject} so far is {leader.method}"
    else:
        level = [
            entry
            for entry in ranked
            if entry.rank == leader.rank and entry.may_lead and entry is not leader
        ]
        lead = f"Of {grouped(len(ranked))} ranked {words.subjects}, {leader.method} leads"
        lead += _level_with(level)
        place = leader.rank or 1
        could = board.contenders(protocol.ranking.order_of(challenge)[0], place)
        lead += _could_too(place, sum(each.may_lead and each.rank != leader.rank for each in could))
    above = [entry for entry in ranked if (entry.rank or 0) < (leader.rank or 0)]
    own_flags = f"; flagged “{flags_of(leader)}”" if leader.flags else ""  # which do not bar it
    return (f"{lead}: {numbers}{own_flags}.", *_flagged_above(above))


def _level_with(level: Sequence[BoardEntry]) -> str:
    """Name who shares the rank of the leader; of many, their number."""
    if not level:
        return ""
    names = listed([entry.method for entry in level])
    return f", level with {names if len(level) <= MAX_NAMED else f'{len(level)} others'}"


def _could_too(place: int, n: int) -> str:
    """Say how many others could have the leader's rank, given how much the scenes vary.

    That rank is the first, or follows those whose flags bar them from leading.
    """
    could = "could be first" if place == 1 else "could lead"
    return f", though {counted(n, 'other', 'others')} {could}" if n else ""


def what_else_tells(board: Board, could_be_first: Sequence[BoardEntry]) -> str:
    """Say why fewer entries could be first than have rank 1 in their rank interval; empty if as many."""
    kept = {entry_key(entry) for entry in could_be_first}
    reach = (entry for entry in board.entries if (entry.rank_interval or (0,))[0] == 1)
    left_out = [entry for entry in reach if entry_key(entry) not in kept]
    if not left_out:
        return ""
    leader = board.leader.submission_id if board.leader else None
    pairs = [(pair.a, pair.b) for pair in board.comparisons if leader in (pair.a, pair.b)]
    compared = {name for pair in pairs for name in pair}
    unknown, lower = (
        sum(entry.submission_id not in compared for entry in some)
        for some in (could_be_first, left_out)
    )
    words = ", as they compare sample by sample"
    words += f" ({counted(unknown, 'is', 'are')} not compared with the leader)" if unknown else ""
    lower_ones = counted(lower, "lower one", "lower ones")
    return words + (f"; left out too: {lower_ones}, not compared" if lower else "")


def _flagged_above(above: Sequence[BoardEntry]) -> Iterator[str]:
    if len(above) > MAX_NAMED:
        yield f"The {len(above)} that rank above it are flagged, and do not lead."
    elif above:
        names = listed([f"{entry.method} (“{flags_of(entry)}”)" for entry in above])
        verb, do = ("ranks", "does") if len(above) == 1 else ("rank", "do")
        yield f"{names} {verb} above it and, flagged as that, {do} not lead."


@dataclass(frozen=True)
class BoardBefore:
    """The board that was shown before, without its entries."""

    number: int
    protocol: str
    split_revision: str
    part: SplitPart | None
    published_at: datetime
    left: tuple[EntryNews, ...] = ()
    """What ranked on it and left."""


class ChangeLine(NamedTuple):
    """What is new since the board before."""

    words: str
    has_new_protocol: bool = False


def change_line(board: Board, before: BoardBefore | None) -> ChangeLine:
    """Say what is new: the protocol, the samples that count, entries, ranks."""
    if before is None:
        return ChangeLine("This is the first board of its phase.")
    is_updated = before.protocol != board.protocol.version
    parts = [f"protocol {before.protocol} became {board.protocol.version}"] if is_updated else []
    if before.part != board.part:
        parts.append(f"other samples count: {part_words(board.part)}")
    elif before.split_revision != board.split.revision:
        parts.append("another revision of the split counts")
    parts += moves_on(board, before.left)
    since = f"Since board {before.number} of {day(before.published_at)}"
    words = f"{since}: {'; '.join(parts)}." if parts else f"{since} no rank moved."
    return ChangeLine(words, is_updated)


def moves_on(board: Board, left: Sequence[EntryNews]) -> list[str]:
    """Say which entries are new or gone, and whose rank changed since the previous board."""
    ranked = [entry for entry in board.entries if entry.rank is not None]
    new = [entry for entry in ranked if entry.previous_rank is None]
    up = [entry for entry in ranked if _steps_up(entry) > 0]
    down = [entry for entry in ranked if _steps_up(entry) < 0]
    parts = []
    if new:
        parts.append(f"{len(new)} newly ranked{_named_ranks(new, 'to')}")
    if left:
        parts.append(f"{len(left)} left{_named_ranks(left, 'from')}")
    if up:
        parts.append(f"{len(up)} moved up{_named_ranks(up, 'to')}")
    if down:
        parts.append(f"{len(down)} moved down{_named_ranks(down, 'to')}")
    return parts


def _named_ranks(entries: Sequence[BoardEntry | EntryNews], way: str) -> str:
    """Name a few, with their rank; of many, none."""
    if len(entries) > MAX_NAMED:
        return ""
    return f" ({listed([f'{entry.method} {way} rank {entry.rank}' for entry in entries])})"


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
    """Return the rows of a board that belong to a team; None if there are none.

    The board is as everybody reads it, under pseudonyms perhaps; the ids are all submissions of the
    team.
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
