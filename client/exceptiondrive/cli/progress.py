"""Progress on stderr, and only where a person sees it."""

from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn
from rich.status import Status

from exceptiondrive.cli.output import console, has_terminal
from exceptiondrive.cli.tables import status_line
from exceptiondrive_schemas.python310 import Self
from exceptiondrive_schemas.submission import SubmissionView


class UploadBar:
    """A bar that is called with bytes sent and bytes in all."""

    def __init__(self, name: str) -> None:
        self._bar = Progress(
            TextColumn("uploading {task.description}"),
            BarColumn(),
            DownloadColumn(),
            TimeRemainingColumn(),
            console=console(stderr=True),
            transient=True,
            disable=not has_terminal(),
        )
        self._task = self._bar.add_task(name, total=None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, sent: int, total: int) -> None:
        """Move the bar; it is shown from the first byte on, so that a question before it is read."""
        self._bar.start()
        self._bar.update(self._task, completed=sent, total=total)


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
