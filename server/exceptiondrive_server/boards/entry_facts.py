"""Properties of one board entry that pages need: its slug, values, badge, shares of outcomes."""

from collections import Counter
from dataclasses import dataclass
from urllib.parse import urlencode

from exceptiondrive_schemas.board import Board, BoardEntry, EntrySource
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, Metric, OutcomePart
from exceptiondrive_schemas.flags import bars_leading
from exceptiondrive_schemas.protocol import RankingSection
from exceptiondrive_schemas.score_sheet import Interval, MetricRow
from exceptiondrive_server.boards.query import Average
from exceptiondrive_server.web.numbers import DASH, Digits, listed, slug
from exceptiondrive_server.web.templating import template_filter


@dataclass(frozen=True)
class Badge:
    """Where the numbers of a row come from: shape, icon and word."""

    icon: str
    word: str
    meaning: str


BADGES: dict[EntrySource, Badge] = {
    "scored": Badge("shield", "Scored", "Scored by this server from an uploaded file."),
    "reference": Badge("ruler", "Reference", "Scored by this server as a yardstick; never ranked."),
    "reported": Badge(
        "paper", "Reported", "Printed in the paper; not scored by this server and never ranked."
    ),
}


@template_filter
def source_badge(source: EntrySource) -> Badge:
    """Return the badge of rows from a source."""
    return BADGES[source]


def challenge_of(board: Board) -> Challenge:
    """Return the challenge of a board."""
    return CHALLENGES[board.challenge]


def primary_metrics(challenge: Challenge) -> tuple[Metric, ...]:
    """Return the metrics that decide the rank."""
    return tuple([metric for metric in challenge.metrics if metric.role == "primary"])


def entry_key(entry: BoardEntry) -> str:
    """Return the key of an entry in URLs: its submission, or `reported-st-p3`."""
    return entry.submission_id or f"{entry.source}-{slug(entry.method)}"


@template_filter
def entry_url(entry: BoardEntry, board: Board, is_current: bool = True) -> str:
    """Return the URL of an entry's page; from an old board, as of that board."""
    given = {} if entry.submission_id and is_current else {"phase": board.phase}
    if not is_current:
        given["board"] = str(board.board)
    return f"/entries/{entry_key(entry)}" + (f"?{urlencode(given)}" if given else "")


def board_fields(board: Board, is_current: bool = False) -> tuple[tuple[str, str], ...]:
    """Return the query that names a board in URLs; the late view has no number, as it is always the present one."""
    if board.view == "late":
        return ("phase", board.phase), ("view", "late")
    number = () if is_current else (("board", str(board.board)),)
    return ("phase", board.phase), *number


@template_filter
def board_name(board: Board) -> str:
    """Return what a board is called: `Board 7`, or `Late view`, which has no number of its own."""
    return "Late view" if board.view == "late" else f"Board {board.board}"


@template_filter
def why_no_intervals(board: Board) -> str:
    """Say why a board has no intervals, and which families have too few scenes; nothing where it has some."""
    if not board.min_scenes:
        return ""
    few = [f"{head.title} has {head.n_scenes}" for head in board.families if head.n_scenes]
    takes = f"intervals take {board.min_scenes}"
    if board.headline == "macro_family":
        takes += " in each family" + (f", and {listed(few)}" if few else "")
    return f"This split has too few scenes to say how sure a number is: {takes}."


@template_filter
def rank_range(entry: BoardEntry) -> str:
    """Write the ranks that the intervals allow, `2` or `2–5`; nothing where none is known."""
    if entry.rank_interval is None:
        return ""
    low, high = entry.rank_interval
    return str(low) if low == high else f"{low}{DASH}{high}"


def flags_of(entry: BoardEntry) -> str:
    """Write the labels of an entry's flags: `Stands still, Blind to the edit`."""
    return ", ".join([flag.label for flag in entry.flags])


@template_filter
def is_barred(entry: BoardEntry) -> bool:
    """Whether a flag bars an entry from being shown as the best."""
    return bars_leading(flag.code for flag in entry.flags)


def is_listed(entry: BoardEntry) -> bool:
    """Whether a scored entry is on the board without a rank."""
    return entry.source == "scored" and entry.rank is None


def too_few_answers(entry: BoardEntry, ranking: RankingSection, digits: Digits) -> list[str]:
    """Say what share of samples a scored entry answers, if too small for a rank; else None."""
    shares = [share for share in entry.coverage.values() if share is not None]
    if entry.source != "scored" or not shares or min(shares) >= ranking.min_coverage:
        return []
    return [f"{digits.fraction(min(shares))} % answered"]


def find_entry(board: Board, key: str) -> BoardEntry | None:
    """Return the entry with this key, if it stands on the board."""
    return next((entry for entry in board.entries if entry_key(entry) == key), None)


def entry_labels(board: Board) -> dict[str, str]:
    """Return what each entry is called among the others, by its key: method and team."""
    labels = {entry_key(e): f"{e.method}, {e.team}" if e.team else e.method for e in board.entries}
    counts = Counter(labels.values())
    return {
        key: label if counts[label] == 1 else f"{label} ({key})" for key, label in labels.items()
    }


def find_named(board: Board, text: str) -> BoardEntry | None:
    """Return the entry with this key or label, else the only one whose label holds the words."""
    found = find_entry(board, text)
    if found is None:
        labels, words = entry_labels(board), text.casefold()
        keys = [key for key, label in labels.items() if label.casefold() == words]
        keys = keys or [key for key, label in labels.items() if words in label.casefold()]
        found = find_entry(board, keys[0]) if len(keys) == 1 else None
    return found


def values_of(entry: BoardEntry, board: Board, average: Average) -> MetricRow:
    """Return the metrics of an entry under one average.

    A reported row carries what its paper printed; its other average is unknown, not zero.
    """
    if average == board.headline:
        return entry.metrics
    return entry.micro if average == "micro" else entry.macro_family


def interval_of(entry: BoardEntry, board: Board, average: Average, key: str) -> Interval | None:
    """Return the interval of a metric; intervals belong to the headline average."""
    return entry.intervals.get(key) if average == board.headline else None


def outcome_parts(
    challenge: Challenge, values: MetricRow
) -> tuple[tuple[OutcomePart, float], ...] | None:
    """Return the parts of the outcome bar with their shares, which sum to one but for rounding.

    None where one of them is undefined, or was not counted by the scorer.
    """
    parts = [(part, values.get(part.metric)) for part in challenge.words.outcome]
    known = tuple([(part, share) for part, share in parts if share is not None])
    return known if len(known) == len(parts) else None
