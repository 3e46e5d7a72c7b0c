"""Progress on stderr, on terminals only; the library that draws it is imported only then."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer

from exceptiondrive.cli.output import console, has_terminal

STEPS_AFTER_S = 1.0
"""From when on steps are told: what is quick says nothing."""


@contextmanager
def transfer_bar(doing: str, name: str) -> Iterator[Callable[[int, int], None]]:
    """Give what moves a bar: it takes bytes done and bytes in all, 0 where that is not known.

    The bar is shown from the first byte on, so that a question before it is read.

    Args:
        doing: "uploading", "downloading".
        name: Of the file.
    """
    if not has_terminal():
        yield lambda done, total: None
        return
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )
    from rich.table import Column

    bar = Progress(
        TextColumn("{task.description}", table_column=Column(overflow="ellipsis", no_wrap=True)),
        BarColumn(bar_width=20),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=console(stderr=True),
        transient=True,
    )
    task = bar.add_task(f"{doing} {name}", total=None)

    def move(done: int, total: int) -> None:
        bar.start()
        bar.update(task, completed=done, total=total or None)

    try:
        yield move
    finally:
        bar.stop()


@contextmanager
def step_line(*, is_shown: bool = True) -> Iterator[Callable[[str], None]]:
    """Give what says the next step in a line, which says for how long all of them have gone on."""
    if not (is_shown and has_terminal()):
        yield lambda step: None
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    line = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False, table_column=Column()),  # whole, folded
        TimeElapsedColumn(),
        console=console(stderr=True),
        transient=True,
    )
    task = line.add_task("", total=None)
    later = Timer(STEPS_AFTER_S, line.start)
    later.start()
    try:
        yield lambda step: line.update(task, description=step)
    finally:
        later.cancel()
        later.join()
        line.stop()
