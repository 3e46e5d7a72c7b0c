"""Submissions for people: one at length, many as a table."""

from collections.abc import Iterable, Iterator

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from exceptiondrive.cli.report_table import report_view
from exceptiondrive.cli.sheet_table import sheet_view
from exceptiondrive.errors import utc_text
from exceptiondrive_schemas.submission import QueuePlace, SubmissionStatus, SubmissionView

STYLES = {
    SubmissionStatus.SCORED: "green",
    SubmissionStatus.REJECTED: "red",
    SubmissionStatus.FAILED: "red",
    SubmissionStatus.WITHDRAWN: "dim",
}


def status_line(view: SubmissionView) -> str:
    """Say where a submission stands, in one line."""
    return view.status.value if view.queue is None else f"{view.status}: {queue_text(view.queue)}"


def queue_text(queue: QueuePlace) -> str:
    """Say how long it will take."""
    if queue.workers_alive == 0:
        return f"place {queue.position}, no worker is alive: it waits until one is"
    wait = ""
    if queue.expected_wait_s is not None:
        wait = f", about {max(1, round(queue.expected_wait_s))} s"
    again = f", attempt {queue.attempts + 1}" if queue.attempts > 1 else ""
    return f"place {queue.position}{wait}{again}"


def submission_view(
    view: SubmissionView, page_url: str, unranked_because: str | None = None
) -> Iterator[RenderableType]:
    """Yield what to print for one submission."""
    style = STYLES.get(view.status, "yellow")
    yield Text.assemble((f"{view.id}  ", "bold"), (status_line(view), f"bold {style}"))
    yield Text(
        f"{view.method} · team {view.team} · phase {view.phase} · {utc_text(view.received_at)}",
        style="dim",
    )
    if view.is_duplicate:
        yield "The same bytes were submitted before: this is that submission, no quota was spent."
    if view.failure is not None:
        yield Text(f"{view.failure.code}: {view.failure.message}")
    if view.report is not None and view.report.faults:
        yield from report_view(view.report)
    if view.sheet is not None:
        yield from sheet_view(view.sheet, with_tasks=False)
    if view.status is SubmissionStatus.SCORED:
        rank = f"rank {view.rank}" if view.rank else "not ranked"
        why = f": {unranked_because}" if unranked_because else ""
        yield Text(f"{rank} in phase {view.phase}{why}", style="bold")
        yield Text(page_url)
    elif not view.status.is_terminal:
        yield Text(f"follow it with: exceptiondrive status {view.id}")
        yield Text(f"or in the browser: {page_url}")


def submissions_table(views: Iterable[SubmissionView]) -> Table:
    """Return the table of many submissions."""
    table = Table(box=None, padding=(0, 1), header_style="bold")
    for title in ("id", "phase", "method", "status", "received", "rank"):
        table.add_column(title, overflow="fold")
    for view in views:
        style = STYLES.get(view.status, "yellow")
        table.add_row(
            view.id,
            view.phase,
            Text(view.method),
            Text(status_line(view), style=style),
            utc_text(view.received_at),
            str(view.rank or ""),
        )
    return table
