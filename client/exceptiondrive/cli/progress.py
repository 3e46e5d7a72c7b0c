"""Progress on stderr, and only where a person sees it."""

from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)
from rich.status import Status
from rich.table import Column

from exceptiondrive.cli.output import console, has_terminal
from exceptiondrive.cli.tables import status_line
from exceptiondrive_schemas.python310 import Self
from exceptiondrive_schemas.submission import SubmissionView


class TransferBar:
    """A bar that is called with bytes done and bytes in all, 0 where that is not known.

    Args:
        doing: "uploading", "downloading".
        name: Of the file.
    """

    def __init__(self, doing: str, name: str) -> None:
        self._bar = Progress(
            TextColumn(
                "{task.description}", table_column=Column(overflow="ellipsis", no_wrap=True)
            ),
            BarColumn(bar_width=20),
            DownloadColumn(),
            TransferSpeedColumn(),
            TimeRemainingColumn(),
            console=console(stderr=True),
            transient=True,
            disable=not has_terminal(),
        )
        self._task = self._bar.add_task(f"{doing} {name}", total=None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, total: int) -> None:
        """Move the bar; it is shown from the first byte on, so that a question before it is read."""
        self._bar.start()
        self._bar.update(self._task, completed=done, total=total or None)


class WaitLine:
    """A line that says where a submission stands."""

    def __init__(self, view: SubmissionView) -> None:
        self._status = Status(_place(view), console=console(stderr=True))

    def __enter__(self) -> Self:
        if has_terminal():
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._status.stop()

    def __call__(self, view: SubmissionView) -> None:
        """Say the new state."""
        if has_terminal():
            self._status.update(_place(view))


def _place(view: SubmissionView) -> str:
    return f"{view.id}  {status_line(view)}"
