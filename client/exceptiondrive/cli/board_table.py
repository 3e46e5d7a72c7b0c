"""A board for people."""

from collections.abc import Iterator

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from exceptiondrive.cli.numbers import challenge_of, metric_head, metric_text
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge


def board_view(board: Board) -> Iterator[RenderableType]:
    """Yield what to print for a board."""
    challenge = challenge_of(board.challenge)
    yield Text(
        f"{challenge.title} · phase {board.phase} · split {board.split.name} "
        f"({board.n_samples} samples) · protocol {board.protocol.version}",
        style="bold",
    )
    yield Text(
        f"board {board.board} of {board.published_at:%Y-%m-%d %H:%M} UTC, metrics: "
        f"{board.headline}",
        style="dim",
    )
    if board.view == "late":
        yield Text(
            "late view: with the entries that came after the deadline; no rank of the board moves"
        )
    if board.part is not None:
        yield Text(f"counts the {board.part} part of the split")
    yield _table(board, challenge)
    for entry in board.entries:
        if entry.unranked_because:
            yield Text(f"{entry.method} ({entry.team}): {entry.unranked_because}", style="dim")


def _table(board: Board, challenge: Challenge) -> Table:
    table = Table(box=None, padding=(0, 1), header_style="bold")
    table.add_column("rank", justify="right", no_wrap=True)
    table.add_column("range", justify="right", no_wrap=True)
    table.add_column("method", overflow="fold")
    table.add_column("team", overflow="fold")
    for metric in challenge.metrics:
        table.add_column(metric_head(metric), justify="right", no_wrap=True)
    table.add_column("source", no_wrap=True)
    table.add_column("flags", overflow="fold")
    for entry in board.entries:
        table.add_row(*_cells(entry, challenge), style="" if entry.rank else "dim")
    return table


def _cells(entry: BoardEntry, challenge: Challenge) -> list[Text]:
    interval = entry.rank_interval
    cells = [
        str(entry.rank or "-"),
        "" if interval is None else f"{interval[0]}-{interval[1]}",
        entry.method,
        entry.team,
        *(metric_text(metric, entry.metrics.get(metric.key)) for metric in challenge.metrics),
        entry.source,
        ", ".join([*(["late"] if entry.is_late else []), *(flag.label for flag in entry.flags)]),
    ]
    return [Text(cell) for cell in cells]
