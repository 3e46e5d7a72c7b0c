"""The report of a drill: a bar while it runs, then a table, also as Markdown for the document."""

from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

_CONSOLE = Console(width=140)


class Report:
    """Lines of a report, and where the drill stands."""

    def __init__(self, n_stages: int) -> None:
        self.lines: list[tuple[str, str]] = []
        self._bar = Progress(
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=Console(stderr=True),
            transient=True,
        )
        self._task = self._bar.add_task("starting", total=n_stages)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def stage(self, name: str) -> None:
        """Say what the drill does next."""
        self._bar.update(self._task, description=name, advance=1)

    def standing(self, name: str) -> None:
        """Say how far the present stage is."""
        self._bar.update(self._task, description=name)

    def say(self, what: str, value: object) -> None:
        """Keep one line."""
        self.lines.append((what, str(value)))

    def show(self, title: str, *, as_markdown: bool) -> None:
        """Print the table."""
        if as_markdown:
            print(f"| {title} | |\n|---|---|")
            print("\n".join(f"| {what} | {value} |" for what, value in self.lines))
            return
        table = Table("", "", title=title, title_justify="left", show_header=False)
        for what, value in self.lines:
            table.add_row(what, value)
        _CONSOLE.print(table)
