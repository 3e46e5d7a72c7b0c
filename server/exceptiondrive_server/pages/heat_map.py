"""The family heat map: one line per entry, one cell per family."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.pages.board_query import BoardQuery
from exceptiondrive_server.pages.board_rows import Row
from exceptiondrive_server.pages.entry_facts import challenge_of
from exceptiondrive_server.pages.family_tiles import HEAT_STEPS, HeatScale, short_title
from exceptiondrive_server.pages.numbers import fixed, grouped

MAX_LINES = 12


@dataclass(frozen=True)
class HeatHead:
    """The head of a family column."""

    id: str
    title: str
    short: str
    n_text: str
    share_text: str
    sort_url: str
    is_sorted: bool


@dataclass(frozen=True)
class HeatMap:
    """Heads, lines and the legend."""

    metric_label: str
    subject: str
    heads: tuple[HeatHead, ...]
    rows: tuple[Row, ...]
    n_left_out: int
    legend_top: str
    legend_steps: tuple[int, ...]


def heat_map(board: Board, heat: HeatScale, rows: Sequence[Row], query: BoardQuery) -> HeatMap:
    """Return the heat map of the rows on this page, the first twelve of them."""
    total = sum(head.n for head in board.families) or 1
    heads = tuple(
        HeatHead(
            id=head.id,
            title=head.title,
            short=short_title(head.title),
            n_text=f"n = {grouped(head.n)}",
            share_text=f"{fixed(100 * head.n / total, 1)} % of samples",
            sort_url=query.url(sort=f"-family.{head.id}", anchor="families"),
            is_sorted=query.sort_key == f"family.{head.id}",
        )
        for head in board.families
    )
    return HeatMap(
        metric_label=heat.metric.label,
        subject=challenge_of(board).words.subject.capitalize(),
        heads=heads,
        rows=tuple(rows[:MAX_LINES]),
        n_left_out=max(0, len(rows) - MAX_LINES),
        legend_top=fixed(heat.top * 100, 0),
        legend_steps=tuple(range(HEAT_STEPS)),
    )
