"""Many questions, several at a time, with progress; an end when the endpoint has gone."""

import asyncio
import sys
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from exceptiondrive_endpoints.errors import GO_ON, EndpointGoneError, Reason

GIVE_UP_AFTER = 20


class Outcome(Protocol):
    """What came of a question: a reason and a sentence where it has no answer."""

    @property
    def reason(self) -> Reason | None:
        """Why there is none."""

    @property
    def detail(self) -> str | None:
        """The same in words."""


Item = TypeVar("Item")
Found = TypeVar("Found", bound=Outcome)


async def ask_all(
    items: Iterable[Item],
    ask: Callable[[Item], Awaitable[Found]],
    take: Callable[[Found], None],
    concurrency: int,
    *,
    has_answered: bool,
) -> None:
    """Ask about the items in order, at most `concurrency` at a time; hand each outcome to `take`.

    Args:
        items: What to ask about.
        ask: Asks about one.
        take: Keeps what came of it.
        concurrency: How many are under way.
        has_answered: Whether the endpoint has ever answered such a question. Once it has, what it
            refuses is about the item, and only silence counts as a failure of the endpoint.

    Raises:
        EndpointError: The endpoint refuses the run, or failed 20 times in a row.
    """
    queue, failures_in_a_row = iter(items), 0

    async def work() -> None:
        nonlocal failures_in_a_row, has_answered
        for item in queue:
            outcome = await ask(item)
            take(outcome)
            reason = outcome.reason
            has_answered = has_answered or reason is None
            failed = reason is not None and (
                reason.is_unreachable if has_answered else reason.is_from_endpoint
            )
            failures_in_a_row = failures_in_a_row + 1 if failed else 0
            if failures_in_a_row >= GIVE_UP_AFTER:  # before every question has waited in vain
                raise EndpointGoneError(
                    f"The endpoint failed for {GIVE_UP_AFTER} samples in a row, the last time "
                    f"with: {outcome.detail}.",
                    GO_ON,
                )

    workers = [asyncio.create_task(work()) for _ in range(concurrency)]
    try:
        await asyncio.gather(*workers)
    finally:  # the first error ends the run: no other question stays under way
        for worker in workers:
            worker.cancel()
        await asyncio.gather(*workers, return_exceptions=True)


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text("" if task.speed is None else f"{60 * task.speed:.3g} a minute")


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[Outcome], None]]:
    """Give a function that moves the bar on by one outcome; it is drawn on terminals alone."""
    columns = (
        TextColumn(title),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failed]} failed"),
    )
    console = Console(stderr=True)
    failed = 0
    with Progress(*columns, console=console, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(title, total=total, failed=0)

        def advance(outcome: Outcome) -> None:
            nonlocal failed
            failed += outcome.reason is not None
            bar.update(task, advance=1, failed=failed)

        yield advance
