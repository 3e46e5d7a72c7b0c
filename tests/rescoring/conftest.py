"""Stages of a protocol update, and the real application over them; SQLite, then PostgreSQL."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from starlette.testclient import TestClient
from tests.conftest import as_role
from tests.rescoring.documents import (
    caution_protocol,
    new_protocol,
    split_document,
    strategy_file,
)
from tests.rescoring.stage import Stage, open_stage

from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_schemas.split import Split
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings


@pytest.fixture
def stage(database_url: str, tmp_path: Path) -> Iterator[Stage]:
    """Three planners of two teams, scored and ranked; SQLite, then PostgreSQL."""
    with open_stage(database_url, tmp_path, "planning") as made:
        for speed_mps, method, team in ((1.0, "slow", "alpha"), (2.0, "middle", "alpha")):
            made.submit(speed_mps, method, team)
        made.submit(6.0, "fast", "beta")
        made.work()
        yield made


@pytest.fixture
def agents(database_url: str, tmp_path: Path) -> Iterator[Stage]:
    """An agent without and with reminder, linked, and one of another team."""
    with open_stage(database_url, tmp_path, "strategy") as made:
        # a and b, SE1: C or D; c, LB1: C; d, RS1: C or E
        plain = made.submit_file(strategy_file("AEAD"), "agent")
        made.work()
        made.submit_file(strategy_file("CEBE"), "agent+reminder", linked_to=plain)
        made.submit_file(strategy_file("CCCC"), "careful", "beta")
        made.work()
        yield made


@pytest.fixture(scope="session")
def make_protocol() -> Callable[..., str]:
    return new_protocol


@pytest.fixture(scope="session")
def make_caution_protocol() -> Callable[..., str]:
    return caution_protocol


@pytest.fixture(scope="session")
def make_split() -> Callable[..., Split]:
    return split_document


class Api:
    """The application over a stage, as organizer, team Alpha, or nobody."""

    def __init__(self, client: TestClient, tokens: dict[str, str]) -> None:
        self.client = client
        self.tokens = tokens

    def __call__(self, method: str, path: str, who: str = "organizer", **more: Any) -> Any:
        token = self.tokens.get(who)
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        headers |= more.pop("headers", {})
        return self.client.request(method, f"/api/v1{path}", headers=headers, **more)


def application_over(stage: Stage) -> Any:
    return create_app(
        ServerSettings(
            database_url=as_role(stage.settings.database_url, Role.API),
            broker_url="memory://",
            file_store_url=stage.settings.file_store_url,
        )
    )


def organizers_token(stage: Stage) -> str:
    with stage.database.write() as session:
        return issue_token(session, None, "me", ORGANIZER_SCOPES, actor="test")[0]


@pytest.fixture
def api(stage: Stage) -> Iterator[Api]:
    """The application over the planners, asked in this process."""
    with stage.database.write() as session:
        alpha, _ = issue_token(session, find_team(session, "alpha").id, "laptop", actor="test")
    tokens = {"alpha": alpha, "organizer": organizers_token(stage)}
    with TestClient(application_over(stage)) as client:
        yield Api(client, tokens)


@pytest.fixture
def serve() -> Iterator[Callable[[Stage], tuple[str, str]]]:
    """Serve a stage on the loopback; gives the address and an organizer's token."""
    running: list[tuple[uvicorn.Server, threading.Thread]] = []

    def start(stage: Stage) -> tuple[str, str]:
        config = uvicorn.Config(
            application_over(stage), host="127.0.0.1", port=0, log_level="warning"
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        running.append((server, thread))
        while not server.started:
            assert thread.is_alive(), "the server did not start"
            time.sleep(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]
        return f"http://127.0.0.1:{port}", organizers_token(stage)

    yield start
    for server, thread in running:
        server.should_exit = True
        thread.join()
