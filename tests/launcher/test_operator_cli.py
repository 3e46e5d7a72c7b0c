"""Operator commands: results on stdout, everything else on stderr, clear refusals."""

import shutil
import socket
import subprocess
import sys
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest
from fastapi import FastAPI
from tests.support.processes import free_port

from exceptiondrive_records.accounts.tokens import issue_token, list_tokens, verify_token
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_server.operations import cli as operator_cli
from exceptiondrive_server.operations import records_commands
from exceptiondrive_server.web.settings import ServerSettings


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, migrated_sqlite: Path) -> Path:
    for name in ("DATABASE_URL", "FILE_STORE_URL", "BROKER_URL"):
        monkeypatch.delenv(f"EXCEPTIONDRIVE_{name}", raising=False)
    shutil.copy(migrated_sqlite, tmp_path / "records.sqlite3")
    return tmp_path


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["exceptiondrive-server", *arguments])
    with pytest.raises(SystemExit) as ended:
        operator_cli.main()
    return int(ended.value.code or 0)


def test_an_organizer_gets_a_token_of_its_own(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "create-organizer", "Ann", "--data", str(data)) == 0
    told = capsys.readouterr()
    token = told.out.strip()
    assert token.startswith("edk_o_")
    assert token not in told.err
    database = Database(f"sqlite:///{data}/records.sqlite3")
    with database.read() as session:
        assert verify_token(session, token) is not None
    database.dispose()


def test_a_token_ends_by_the_clock_of_the_database(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That of the machine where the command is given may be off."""
    database = Database(f"sqlite:///{data}/records.sqlite3")
    with database.read() as session:
        ahead = database_now(session) + timedelta(days=2)
    monkeypatch.setattr(records_commands, "database_now", lambda session: ahead)
    command(monkeypatch, "create-organizer", "Ann", "--days", "3", "--data", str(data))
    with database.read() as session:
        (token,) = list_tokens(session)
    assert token.expires_at == ahead + timedelta(days=3)
    database.dispose()


def test_a_lost_token_is_found_and_revoked(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command(monkeypatch, "create-organizer", "Ann", "--days", "3", "--data", str(data))
    token = capsys.readouterr().out.strip()
    assert command(monkeypatch, "list-tokens", "--data", str(data)) == 0
    token_id, *rest = capsys.readouterr().out.strip().split("\t")
    assert (rest[0], rest[-1]) == ("Ann", "live")
    database = Database(f"sqlite:///{data}/records.sqlite3")
    with database.write() as session:
        _, made = issue_token(session, None, "made by Ann", actor=f"token:{token_id}")
        made_id = made.id
    assert command(monkeypatch, "revoke-token", token_id, "--data", str(data)) == 0
    told = capsys.readouterr()
    assert told.out == f"{made_id}\tmade by Ann\n"
    assert "revoke these too, if they are not wanted" in told.err
    with database.read() as session:
        assert verify_token(session, token) is None
    database.dispose()


def test_tokens_are_listed_with_their_phases_and_whether_they_live(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("Ann", "Bob"):
        assert command(monkeypatch, "create-organizer", name, "--data", str(data)) == 0
    database = Database(f"sqlite:///{data}/records.sqlite3")
    with database.write() as session:
        confined, over = sorted(list_tokens(session), key=lambda token: token.name)
        confined.phases = ["dev", "final"]
        over.expires_at = over.created_at
    database.dispose()
    capsys.readouterr()
    assert command(monkeypatch, "list-tokens", "--data", str(data)) == 0
    lines = [line.split("\t") for line in capsys.readouterr().out.splitlines()]
    scopes = "organizer,read:own,submit"
    told = {name: rest for _, name, *rest in lines}
    assert told == {"Ann": [f"{scopes}:dev:final", "live"], "Bob": [scopes, "expired"]}


def test_no_token_lives_longer_than_dates_reach(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("create-organizer", "Ann", "--days", "99999999999", "--data", str(data))
    assert command(monkeypatch, *arguments) == 2
    assert "--days" in capsys.readouterr().err


def test_what_is_not_there_is_one_sentence_and_exit_code_2(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "revoke-token", "00000000", "--data", str(data)) == 2
    assert capsys.readouterr().err == "exceptiondrive-server: There is no token '00000000'.\n"


def test_a_folder_without_records_is_refused_and_stays_empty(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "list-tokens", "--data", str(data / "other")) == 2
    assert "exceptiondrive-server migrate" in capsys.readouterr().err
    assert not (data / "other").exists()


def test_a_database_that_does_not_answer_is_one_sentence(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABASE_URL", f"sqlite:///{data}")  # a folder
    assert command(monkeypatch, "migrate") == 2
    said = capsys.readouterr().err
    assert said.startswith("exceptiondrive-server: ")
    assert said.count("\n") == 1


def test_the_audit_chain_is_verified(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command(monkeypatch, "create-organizer", "Ann", "--data", str(data))
    capsys.readouterr()
    assert command(monkeypatch, "verify", "--no-uploads", "--data", str(data)) == 0
    assert "every invariant holds; 1 audit lines, head " in capsys.readouterr().err


def test_the_server_is_served_by_the_strict_parser(monkeypatch: pytest.MonkeyPatch) -> None:
    """What that refuses: tests/hostile/test_connections.py."""
    served: dict[str, object] = {}
    monkeypatch.setattr("uvicorn.run", lambda app, **keywords: served.update(keywords))
    application = FastAPI()
    settings = ServerSettings(trusted_proxies="10.0.0.1")
    application.state.services = SimpleNamespace(settings=settings)
    monkeypatch.setattr("exceptiondrive_server.app.app_from_environment", lambda: application)
    operator_cli.serve(host="127.0.0.1", port=free_port())
    assert served["forwarded_allow_ips"] == "10.0.0.1"
    assert served["http"] == "httptools"
    assert served["ws"] == "none"


def test_a_server_on_a_port_in_use_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert command(monkeypatch, "serve", "--port", port) == 2
    assert f"port {port} is in use; choose another one with --port" in capsys.readouterr().err


def test_commands_on_records_import_no_log_broker_or_migrations() -> None:
    heavy = {"structlog", "celery", "alembic", "fastapi"}
    code = (
        "import sys, exceptiondrive_server.operations.cli; "
        f"print(sorted({heavy!r} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
