"""The client for asyncio: `Client`'s own methods, awaited."""

import asyncio
import inspect
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from exceptiondrive import (
    AsyncClient,
    AsyncSubmission,
    Client,
    NotFoundError,
    Submission,
    to_dataframe,
)
from exceptiondrive.errors import InvalidArgumentError, InvalidFileError, WaitTimeoutError

if TYPE_CHECKING:
    from tests.client.servers import CannedServer, Running

MakeFile = Callable[..., Path]


def public(kind: type) -> set[str]:
    return {name for name, _ in inspect.getmembers(kind) if not name.startswith("_")}


def test_it_has_every_method_with_the_arguments_of_the_client() -> None:
    assert public(Client) <= public(AsyncClient)
    assert public(Submission) - {"waiting"} | {"view"} == public(AsyncSubmission)
    for name in public(Client) - {"close", "page_url", "id_of"}:
        assert inspect.signature(getattr(AsyncClient, name)) == inspect.signature(
            getattr(Client, name)
        )
        assert inspect.iscoroutinefunction(getattr(AsyncClient, name)), name


async def test_from_file_to_rank(working: "Running", planning_file: MakeFile) -> None:
    async with AsyncClient(working.url, working.token) as client:
        submission = await client.submit(planning_file(), phase="dev", method="Awaited")
        seen: list[str] = []
        view = await submission.wait(on_change=lambda now: seen.append(now.status.value))
        assert (view.rank, submission.status, seen[-1]) == (1, "scored", "scored")
        assert (await client.submission(submission.id)).view.id == submission.id
        assert repr(submission) == f"<AsyncSubmission {view.id}: scored, rank 1, 'Awaited'>"
        for followed in (to_dataframe(submission), to_dataframe([submission])):
            assert list(followed["rank"]) == [1]


async def test_requests_run_side_by_side_and_errors_are_those_of_the_client(
    running: "Running", planning_file: MakeFile
) -> None:
    async with AsyncClient(running.url, running.token) as client:
        phases = await asyncio.gather(*(client.phase("dev") for _ in range(12)))
        assert {phase.id for phase in phases} == {"dev"}
        with pytest.raises(NotFoundError, match="Did you mean 'dev'"):
            await client.phase("dve")
        with pytest.raises(InvalidFileError):
            await client.submit(planning_file(predictions=[]), phase="dev", method="M")
        submission = await client.submit(planning_file(), phase="dev", method="M")
        with pytest.raises(WaitTimeoutError):
            await submission.wait(timeout_s=0)
    await client.close()
    with pytest.raises(InvalidArgumentError, match="This client was closed"):
        await client.phases()


async def test_an_outage_is_waited_out_without_a_word(
    canned_server: "CannedServer", capfd: pytest.CaptureFixture[str]
) -> None:
    canned_server.answer("GET /phases", 503, {}, {"retry-after": "0"})
    canned_server.answer("GET /phases", 200, [])
    told: list[float] = []
    async with AsyncClient(canned_server.url, on_retry=told.append) as client:
        assert await client.phases() == ()
    assert told == [0.0]
    assert capfd.readouterr() == ("", "")


async def test_who_leaves_waits_for_no_further_attempt(canned_server: "CannedServer") -> None:
    canned_server.answer("GET /phases", 503, {}, {"retry-after": "20"})
    pauses: asyncio.Queue[float] = asyncio.Queue()
    loop = asyncio.get_running_loop()

    def told(pause_s: float) -> None:
        loop.call_soon_threadsafe(pauses.put_nowait, pause_s)

    async with AsyncClient(canned_server.url, on_retry=told) as client:
        waiting = asyncio.create_task(client.phases())
        assert await pauses.get() == 20.0
        waiting.cancel()
    assert len(canned_server.requests) == 2, "one more at once, and none of the three after it"
    with pytest.raises(asyncio.CancelledError):
        await waiting


def test_short_forms_are_a_line_and_tables_hold_nothing_that_runs(running: "Running") -> None:
    with running.client() as client:
        assert repr(client) == f"<Client of {running.url}>"
        phase = client.phase("dev").model_copy(update={"title": "<script>alert(1)</script>"})
    assert len(repr(phase)) < 2_000
    assert "\n" not in repr(phase)
    assert "&lt;script&gt;" in phase._repr_html_()
    assert "<script" not in phase._repr_html_()


def test_a_report_is_short_and_its_faults_are_a_table(planning_file: MakeFile) -> None:
    from exceptiondrive import check_file

    wrong = [{"sample_id": f"s{n}", "source": [[1, 2]], "edited": "x" * 99} for n in range(99)]
    report = check_file(planning_file(predictions=wrong))
    assert len(repr(report)) < 400
    assert "wrong_waypoint_count" in report._repr_html_()
    table: Any = to_dataframe(report)
    assert list(table["code"]) == [group.code for group in report.faults]
    assert json.loads(table.to_json(orient="records"))[0]["count"] == report.faults[0].count
