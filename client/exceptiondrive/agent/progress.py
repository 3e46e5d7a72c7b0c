"""A progress bar on stderr, and only where a person watches."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from exceptiondrive.agent.journal import JournalLine


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[JournalLine], None]]:
    """Give a function that moves the bar on by one journal line."""
    columns = (
        TextColumn(title),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failed]} failed"),
    )
    console = Console(stderr=True)
    failed = 0
    with Progress(*columns, console=console, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(title, total=total, failed=0)

        def advance(line: JournalLine) -> None:
            nonlocal failed
            failed += not line.is_done
            bar.update(task, advance=1, failed=failed)

        yield advance
