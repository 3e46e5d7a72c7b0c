"""The watch sees a leak in every channel, and a run that leaks fails."""

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psycopg
import pytest
import structlog
from fastapi import FastAPI
from fastapi.responses import PlainTextResponse, StreamingResponse
from starlette.testclient import TestClient
from tests.canary.plugin import pytest_runtest_logreport
from tests.canary.values import CANARY_M, PATTERN, spellings
from tests.canary.watch import WATCH, Watch

if TYPE_CHECKING:
    from tests.support.broker import PrivateBroker
    from tests.support.databases import Postgres

ROOT = Path(__file__).parents[2]
CANARY = str(CANARY_M)


@pytest.mark.parametrize("spelling", spellings(), ids=repr)
def test_every_spelling_is_found(spelling: bytes) -> None:
    assert PATTERN.search(spelling)
    assert PATTERN.search(b'{"x": ' + spelling + b"}")


OTHERS = ["72.71", "2026-11-21T10:00:12.719483Z", "12.7194836", "72.71945", "172.6194836", "719483"]
SECONDS_OF_BROKERS = ["1795967271.948087", "1795967272.719484", "1795972719.500000"]
A_DIGEST = "sha256:42917060" + "7" * 56


@pytest.mark.parametrize("text", [*OTHERS, *SECONDS_OF_BROKERS, A_DIGEST])
def test_other_numbers_are_not(text: str) -> None:
    assert not PATTERN.search(text.encode())


def application() -> FastAPI:
    app = FastAPI()

    @app.get("/body")
    def body() -> PlainTextResponse:
        return PlainTextResponse(f"region at {CANARY}")

    @app.get("/head")
    def head() -> PlainTextResponse:
        return PlainTextResponse("", headers={"X-Region": CANARY})

    @app.get("/stream")
    def stream() -> StreamingResponse:
        return StreamingResponse(iter([f"region at {CANARY[:4]}", CANARY[4:]]))

    return app


@pytest.mark.parametrize("path", ["/body", "/head", "/stream"])
def test_a_leak_in_an_answer_is_found(path: str) -> None:
    with WATCH.planted() as found:
        TestClient(application()).get(path)
    assert len(found) == 1
    assert found[0].startswith(f"response {path}: ")
    assert "test_a_leak_in_an_answer_is_found" in found[0]


def test_a_leak_in_a_log_line_is_found() -> None:
    with WATCH.planted() as found, structlog.testing.capture_logs():
        structlog.get_logger("x").info("scored", clearance_to=CANARY_M)
    assert [line.split()[0] for line in found] == ["log"]


def test_a_leak_in_a_traceback_or_print_is_found() -> None:
    class Report:
        nodeid = "test_x"
        sections = (("Captured stderr call", f"ValueError: region [{CANARY_M}, 1.0]"),)

    with WATCH.planted() as found:
        pytest_runtest_logreport(Report())  # type: ignore[arg-type]
    assert [line.split()[0] for line in found] == ["printed"]


def test_a_leak_in_a_job_payload_is_found(broker: "PrivateBroker") -> None:
    with WATCH.planted() as found:
        with broker.client() as client:
            client.lpush("celery", f'{{"args": ["job", {CANARY}]}}')
        broker.kill()
        broker.watch.stop()
    assert found
    assert found[0].startswith("broker")


@pytest.mark.postgres
def test_a_leak_in_a_row_is_found(postgres: "Postgres") -> None:
    name = postgres.create("migrated")
    address = postgres.uri.replace("/postgres?", f"/{name}?")
    with WATCH.planted() as found:
        with psycopg.connect(address) as connection:
            connection.execute(
                "INSERT INTO teams (slug, name, affiliation, name_skeleton, is_reference, created_at) "
                "VALUES (%s, %s, '', 'x', false, now())",
                ("x", f"Team {CANARY}"),
            )
        postgres.drop(name)
    assert [line.split()[:2] for line in found] == [["database", "teams:"]]


def test_a_leak_in_a_file_is_found_and_what_workers_keep_is_not_one(tmp_path: Path) -> None:
    watch = Watch()
    places = ("splits/tiny/split.json", "private/settled/x", "tiny.split.json")
    leaks = ("export.csv", "uploads/blob", "records.sqlite3", "logs/server.log")
    for place in (*places, *leaks):
        path = tmp_path / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"a" * (1024 * 1024 - 5) + CANARY.encode())
    watch.look_in_folder(tmp_path)
    assert len(watch.found) == len(leaks)
    assert all(any(leak in line for line in watch.found) for leak in leaks)
    for leak in leaks:
        (tmp_path / leak).unlink()


LEAKING = f"""
def test_x(tmp_path):
    (tmp_path / "export.csv").write_text("{CANARY}")
"""


@pytest.mark.parametrize("more", [[], ["-p", "xdist", "-n", "1"]], ids=["alone", "xdist"])
def test_a_run_that_leaks_fails_and_says_where(tmp_path: Path, more: list[str]) -> None:
    leaking = tmp_path / "splits" / "test_leaking.py"  # where this run does not look
    leaking.parent.mkdir()
    leaking.write_text(LEAKING)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.canary.plugin", *more]
    options = ["-c", os.devnull, "--basetemp", str(leaking.parent / "base"), str(leaking)]
    done = subprocess.run(
        [*command, *options],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
    )
    said: Any = done.stdout.replace(CANARY, "CANARY")
    assert done.returncode == 1, said
    assert "a withheld coordinate has left the worker" in said
    assert "export.csv" in said
    assert "1 passed" in said
