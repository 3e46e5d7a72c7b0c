"""Stages of a protocol update, and the real application over them; SQLite, then PostgreSQL."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient
from tests.rescoring.documents import (
    caution_protocol,
    new_protocol,
    split_document,
    strategy_file,
)
from tests.rescoring.stage import Stage, open_stage
from tests.support.databases import as_role
from tests.support.serving import served
from tests.support.snapshots import Snapshots

from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_schemas.split import Split
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings


@pytest.fixture
def stage(database_url: str, tmp_path: Path, snapshots: Snapshots) -> Iterator[Stage]:
    """Three planners of two teams, scored and ranked; SQLite, then PostgreSQL."""

    def three_planners() -> list[str]:
        with open_stage(database_url, tmp_path) as made:
            made.open_phase("planning")
            for speed_mps, method, team in ((1.0, "slow", "alpha"), (2.0, "middle", "alpha")):
                made.submit(speed_mps, method, team)
            made.submit(6.0, "fast", "beta")
            made.work()
            return made.submitted

    submitted = snapshots.fill("three planners", database_url, tmp_path, three_planners)
    with open_stage(database_url, tmp_path) as made:
        made.submitted = submitted
        yield made


@pytest.fixture
def agents(database_url: str, tmp_path: Path) -> Iterator[Stage]:
    """An agent without and with reminder, linked, and one of another team."""
    with open_stage(database_url, tmp_path) as made:
        made.open_phase("strategy")
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
    with ExitStack() as stack:
        yield lambda stage: (
            stack.enter_context(served(application_over(stage))),
            organizers_token(stage),
        )
