"""Stages of a protocol update, and the real application over them; SQLite, then PostgreSQL."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from tests.rescoring.application import Api, application_over, organizers_token
from tests.rescoring.documents import (
    even_split,
    new_protocol,
    split_document,
    strategy_file,
)
from tests.rescoring.stage import Stage, open_stage
from tests.support import documents
from tests.support.serving import served
from tests.support.snapshots import Snapshots

from exceptiondrive_records.accounts.tokens import issue_token
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_schemas.split import Split


@pytest.fixture
def stage(database_url: str, tmp_path: Path, snapshots: Snapshots) -> Iterator[Stage]:
    """Three planners of two teams, scored and ranked; SQLite, then PostgreSQL."""

    def three_planners() -> list[str]:
        with open_stage(database_url, tmp_path) as made:
            made.put_planners()
            return made.submitted

    submitted = snapshots.fill("three planners", database_url, tmp_path, three_planners)
    with open_stage(database_url, tmp_path) as made:
        made.submitted = submitted
        yield made


@pytest.fixture
def ready(database_url: str, tmp_path: Path, snapshots: Snapshots) -> Iterator[tuple[Stage, str]]:
    """The same, and a run to a protocol of a larger clearance, which may be applied."""

    def ready_run() -> tuple[list[str], str]:
        with open_stage(database_url, tmp_path) as made:
            made.put_planners()
            run_id = made.ready(new_protocol("1.1", "d_safe_m = 2.0", "d_safe_m = 4.5"))
            return made.submitted, run_id

    submitted, run_id = snapshots.fill("ready run", database_url, tmp_path, ready_run)
    with open_stage(database_url, tmp_path) as made:
        made.submitted = submitted
        yield made, run_id


@pytest.fixture
def even_stage(database_url: str, tmp_path: Path) -> Iterator[Stage]:
    """Three planners whose HCC has an interval; that of the last ends shortly below the second."""
    with open_stage(database_url, tmp_path) as made:
        split = even_split()
        made.open_phase("planning", split)
        for speed_mps, method, team in ((1.5, "slow", "alpha"), (1.87, "middle", "alpha"),
                                        (6.0, "fast", "beta")):  # fmt: skip
            speeds_mps = {sample.sample_id: speed_mps for sample in split.samples}
            made.submit_file(documents.planning_file(speeds_mps), method, team)
        made.work()
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
def make_split() -> Callable[..., Split]:
    return split_document


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
