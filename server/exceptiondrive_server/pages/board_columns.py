"""The columns of the board: heads with their sort links, and which are shown."""

from dataclasses import dataclass
from typing import Literal

from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_server.pages.board_query import BY_RANK, BoardQuery
from exceptiondrive_server.pages.numbers import unit_of

Order = Literal["ascending", "descending"]
Kind = Literal["primary", "diagnostic", "outcome", "date"]
_DIRECTION_WORDS = {
    "higher": {"descending": "best first", "ascending": "worst first"},
    "lower": {"ascending": "best first", "descending": "worst first"},
    None: {"descending": "largest first", "ascending": "smallest first"},
}
_BETTER_WORDS = {"higher": "higher is better", "lower": "lower is better", None: "not a score"}


@dataclass(frozen=True)
class Column:
    """One column head. `subscript` is set small behind the label."""

    key: str
    label: str
    subscript: str
    unit: str
    title: str
    kind: Kind
    sort_url: str | None
    aria_sort: Order | None
    sort_words: str


@dataclass(frozen=True)
class ColumnChoice:
    """A column that may be switched off."""

    key: str
    label: str
    is_shown: bool


def first_sort(challenge: Challenge, key: str) -> str:
    """Return how a column is sorted first: a metric best first, a date newest first."""
    if key == "method" or (
        key in challenge.metric_keys and challenge.metric(key).better == "lower"
    ):
        return key
    return f"-{key}"


def metric_columns(challenge: Challenge, query: BoardQuery) -> tuple[Column, ...]:
    """Return the heads of all shown metrics, in the challenge's order."""
    return tuple(
        _metric_column(challenge, metric, query)
        for metric in challenge.metrics
        if metric.key not in query.hidden
    )


def method_column(challenge: Challenge, query: BoardQuery) -> Column:
    """Return the head of the method column."""
    order, url = _sorting(challenge, query, "method")
    words = "sorted A to Z" if order == "ascending" else "sorted Z to A" if order else "sort A to Z"
    label = challenge.words.subject.capitalize()
    return Column("method", label, "", "", "Method and team", "date", url, order, words)


def date_column(challenge: Challenge, query: BoardQuery) -> Column:
    """Return the head of the date column."""
    order, url = _sorting(challenge, query, "date")
    words = {None: "sort, newest first", "descending": "sorted, newest first"}.get(
        order, "sorted, oldest first"
    )
    return Column("date", "Submitted", "", "", "Date of submission", "date", url, order, words)


def column_choices(challenge: Challenge, query: BoardQuery) -> tuple[ColumnChoice, ...]:
    """Return the columns that may be switched off: all but rank, method and primary metrics."""
    optional = [(m.key, m.label) for m in challenge.metrics if m.role == "diagnostic"]
    optional += [("outcome", "Outcome and families"), ("date", "Date")]
    return tuple(ColumnChoice(key, label, key not in query.hidden) for key, label in optional)


def _metric_column(challenge: Challenge, metric: Metric, query: BoardQuery) -> Column:
    order, url = _sorting(challenge, query, metric.key)
    first: Order = "descending" if first_sort(challenge, metric.key)[0] == "-" else "ascending"
    words = _DIRECTION_WORDS[metric.better][order or first]
    label, subscript = split_label(metric.label)
    return Column(
        key=metric.key,
        label=label,
        subscript=subscript,
        unit=unit_of(metric),
        title=f"{metric.title}, {_BETTER_WORDS[metric.better]}. {metric.meaning}",
        kind=metric.role,
        sort_url=url,
        aria_sort=order,
        sort_words=f"sorted, {words}" if order else f"sort, {words}",
    )


def split_label(label: str) -> tuple[str, str]:
    """Return the label and what is set as its subscript: `CTSx` -> `CTS`, `x`."""
    if label.startswith("CTS") and len(label) == 4:
        return label[:3], label[3:]
    return label, ""


def _sorting(challenge: Challenge, query: BoardQuery, key: str) -> tuple[Order | None, str]:
    """The direction in which `key` sorts now, if it does, and the address that sorts by it."""
    first = first_sort(challenge, key)
    is_by_rank = query.sort == BY_RANK and key == challenge.metrics[0].key
    sort = first if is_by_rank else query.sort
    if sort.removeprefix("-") != key:
        return None, query.url(sort=first)
    if sort.startswith("-"):
        return "descending", query.url(sort=key)
    return "ascending", query.url(sort=f"-{key}")
