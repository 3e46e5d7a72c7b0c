"""The SDK for asyncio: each method is `Client`'s own, run in a thread of its own pool.

>>> async with AsyncClient() as client:
...     submission = await client.submit("planner.json", phase="dev", method="Planner")
...     view = await submission.wait()

Retries, keys, checks and errors are those of `Client`, to the letter. A task that is cancelled stops
waiting; a request that is under way ends by itself.
"""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from functools import partial, wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from exceptiondrive.client import Client, OnChange, Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.python310 import Self

MAX_THREADS = 8
"""So many requests of one client run at once; the others wait for their turn."""
Result = TypeVar("Result")
P = ParamSpec("P")
Async = Callable[Concatenate["AsyncClient", P], Coroutine[Any, Any, Result]]


def _awaitable(method: Callable[Concatenate[Client, P], Result]) -> Async[P, Result]:
    """Return a method of `Client` as one to be awaited."""

    @wraps(method)
    async def call(client: "AsyncClient", /, *args: P.args, **kwargs: P.kwargs) -> Result:
        return await client.run(method, client.client, *args, **kwargs)

    return call


def _awaitable_submission(
    method: Callable[Concatenate[Client, P], Submission],
) -> "Async[P, AsyncSubmission]":
    """Return a method of `Client` that gives a submission as one that gives it to be awaited."""

    @wraps(method)
    async def call(
        client: "AsyncClient", /, *args: P.args, **kwargs: P.kwargs
    ) -> "AsyncSubmission":
        return AsyncSubmission(client, await client.run(method, client.client, *args, **kwargs))

    return call


class AsyncClient:
    """`Client` to be awaited; its arguments are those of `Client`.

    Attributes:
        client: The client whose methods are run.
    """

    def __init__(self, server: str | None = None, token: str | None = None, **more: Any) -> None:
        self.client = Client(server, token, **more)
        self._threads: ThreadPoolExecutor | None = ThreadPoolExecutor(MAX_THREADS, "exceptiondrive")

    def __repr__(self) -> str:
        return f"<AsyncClient of {self.client.server}>"

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections, once what is under way has ended; no further attempt is waited for."""
        threads, self._threads = self._threads, None  # what comes later hears that it is closed
        self.client._transport.give_up()
        if threads is not None:
            await asyncio.to_thread(threads.shutdown)
        self.client.close()

    async def run(
        self, function: Callable[P, Result], /, *args: P.args, **kwargs: P.kwargs
    ) -> Result:
        """Run a function in a thread of this client, and return what it returns."""
        call = partial(function, *args, **kwargs)
        return await asyncio.get_running_loop().run_in_executor(self._threads, call)

    submit = _awaitable_submission(Client.submit)
    submission = _awaitable_submission(Client.submission)
    ask = _awaitable(Client.ask)
    news = _awaitable(Client.news)
    questions = _awaitable(Client.questions)
    add_contact = _awaitable(Client.add_contact)
    check = _awaitable(Client.check)
    choose = _awaitable(Client.choose)
    contacts = _awaitable(Client.contacts)
    download = _awaitable(Client.download)
    edit = _awaitable(Client.edit)
    edits = _awaitable(Client.edits)
    leaderboard = _awaitable(Client.leaderboard)
    manifest = _awaitable(Client.manifest)
    mark_read = _awaitable(Client.mark_read)
    me = _awaitable(Client.me)
    notices = _awaitable(Client.notices)
    outlook = _awaitable(Client.outlook)
    phase = _awaitable(Client.phase)
    report = _awaitable(Client.report)
    phases = _awaitable(Client.phases)
    protocol = _awaitable(Client.protocol)
    protocol_of = _awaitable(Client.protocol_of)
    accept_terms = _awaitable(Client.accept_terms)
    publish = _awaitable(Client.publish)
    quota = _awaitable(Client.quota)
    receipt = _awaitable(Client.receipt)
    receipt_keys = _awaitable(Client.receipt_keys)
    set_wishes = _awaitable(Client.set_wishes)
    remove_contact = _awaitable(Client.remove_contact)
    split = _awaitable(Client.split)
    status = _awaitable(Client.status)
    submissions = _awaitable(Client.submissions)
    unpublish = _awaitable(Client.unpublish)
    withdraw = _awaitable(Client.withdraw)

    def page_url(self, submission_id: str) -> str:
        """Address of the page of a submission, from upload to rank, for members of its team."""
        return self.client.page_url(submission_id)

    def id_of(self, submission: str) -> str:
        """Return the id of a submission, of the address of its page too."""
        return self.client.id_of(submission)


class AsyncSubmission:
    """`Submission` to be awaited."""

    def __init__(self, client: AsyncClient, submission: Submission) -> None:
        self._client = client
        self._submission = submission

    def __repr__(self) -> str:
        return repr(self._submission).replace("<Submission", "<AsyncSubmission")

    @property
    def id(self) -> str:
        """Id, as `exceptiondrive status ID` takes it."""
        return self._submission.id

    @property
    def view(self) -> SubmissionView:
        """What the server said last."""
        return self._submission.view

    @property
    def status(self) -> SubmissionStatus:
        """Status, as last seen."""
        return self._submission.status

    @property
    def page_url(self) -> str:
        """Address of its page, from upload to rank; for members of the team."""
        return self._submission.page_url

    async def refresh(self) -> SubmissionView:
        """Ask the server again."""
        return await self._client.run(self._submission.refresh)

    async def withdraw(self) -> SubmissionView:
        """Take it off the board."""
        return await self._client.run(self._submission.withdraw)

    async def wait(
        self, timeout_s: float | None = None, on_change: OnChange | None = None
    ) -> SubmissionView:
        """Wait until it is scored, and for its rank; as `Submission.wait`, with its errors.

        `on_change` is called in a thread.
        """
        pauses = self._submission.waiting(timeout_s, on_change)
        while (pause_s := await self._client.run(next, pauses, None)) is not None:
            await asyncio.sleep(pause_s)
        return self.view
