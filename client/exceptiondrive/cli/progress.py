"""Progress on stderr, and only where a person sees it: else not even what draws it is imported."""

from threading import Timer
from typing import TYPE_CHECKING

from exceptiondrive.cli.output import console, has_terminal
from exceptiondrive_schemas.python310 import Self

if TYPE_CHECKING:
    from rich.progress import Progress
    from rich.status import Status

    from exceptiondrive_schemas.api.submission import SubmissionView


class TransferBar:
    """A bar that is called with bytes done and bytes in all, 0 where that is not known.

    Args:
        doing: "uploading", "downloading".
        name: Of the file.
    """

    def __init__(self, doing: str, name: str) -> None:
        self._bar = _transfer(f"{doing} {name}") if has_terminal() else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, done: int, total: int) -> None:
        """Move the bar; it is shown from the first byte on, so that a question before it is read."""
        if self._bar is not None:
            self._bar.start()
            self._bar.update(self._bar.task_ids[0], completed=done, total=total or None)


def _transfer(description: str) -> "Progress":
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
    bar.add_task(description, total=None)
    return bar


STEPS_AFTER_S = 1.0
"""From when on steps are told: what is quick says nothing."""


class StepLine:
    """A line that says which step goes on, and for how long all of them have."""

    def __init__(self) -> None:
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        self._line = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            console=console(stderr=True),
            transient=True,
        )
        self._task = self._line.add_task("", total=None)
        self._later = Timer(STEPS_AFTER_S, self._line.start)

    def __enter__(self) -> Self:
        self._later.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._later.cancel()
        self._later.join()
        self._line.stop()

    def __call__(self, step: str) -> None:
        """Say the next step."""
        self._line.update(self._task, description=step)


class WaitLine:
    """A line that says where a submission stands."""

    def __init__(self, view: "SubmissionView") -> None:
        self._status = _waiting(_place(view)) if has_terminal() else None

    def __enter__(self) -> Self:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def __call__(self, view: "SubmissionView") -> None:
        """Say the new state."""
        if self._status is not None:
            self._status.update(_place(view))


def _waiting(place: str) -> "Status":
    from rich.status import Status

    return Status(place, console=console(stderr=True))


def _place(view: "SubmissionView") -> str:
    from exceptiondrive.cli.tables import status_line

    return f"{view.id}  {status_line(view)}"
