"""Operator commands: results on stdout, everything else on stderr, clear refusals."""

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from fastapi import FastAPI

from exceptiondrive_records.accounts.tokens import is_well_formed, verify_token
from exceptiondrive_records.db.database import Database
from exceptiondrive_server.operations import cli as operator_cli
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_server.web.slow_clients import PatientProtocol


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


def test_a_team_and_its_token_are_made_in_one_command(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code = command(
        monkeypatch, "create-team", "mine", "My team", "--with-token", "--data", str(data)
    )
    told = capsys.readouterr()
    assert code == 0
    token = told.out.strip()
    assert is_well_formed(token)
    assert token not in told.err
    database = Database(f"sqlite:///{data}/records.sqlite3")
    with database.read() as session:
        principal = verify_token(session, token)
    database.dispose()
    assert principal is not None
    assert principal.team_slug == "mine"


def test_an_organizer_gets_a_token_of_its_own(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "create-organizer", "Ann", "--data", str(data)) == 0
    assert capsys.readouterr().out.startswith("edk_o_")
    assert command(monkeypatch, "list-tokens", "--data", str(data)) == 0
    assert "Ann\torganizer" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["create-token", "nobody"], "There is no team 'nobody'."),
        (["create-phase", "dev", "--split", "nope"], "There is no split 'nope'."),
        (["revoke-token", "00000000"], "There is no token '00000000'."),
        (["retry", "0"], "There is no submission '0'."),
    ],
)
def test_what_is_not_there_is_one_sentence_and_exit_code_2(
    data: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: str,
) -> None:
    assert command(monkeypatch, *arguments, "--data", str(data)) == 2
    assert capsys.readouterr().err == f"exceptiondrive-server: {words}\n"


def test_a_folder_without_records_is_refused_and_stays_empty(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "list-teams", "--data", str(data / "other")) == 2
    assert "exceptiondrive-server migrate" in capsys.readouterr().err
    assert not (data / "other").exists()


def test_the_audit_chain_is_verified(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command(monkeypatch, "create-team", "mine", "My team", "--data", str(data))
    assert command(monkeypatch, "verify-audit", "--data", str(data)) == 0
    assert capsys.readouterr().out.startswith("1 lines, whole; head ")


def test_the_server_is_served_with_an_end_to_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slow clients are ended where no proxy does it, too (tests/hostile/test_connections.py)."""
    served: dict[str, object] = {}
    monkeypatch.setattr("uvicorn.run", lambda app, **keywords: served.update(keywords))
    application = FastAPI()
    settings = ServerSettings(trusted_proxies="10.0.0.1")
    application.state.services = SimpleNamespace(settings=settings)
    monkeypatch.setattr("exceptiondrive_server.app.app_from_environment", lambda: application)
    operator_cli.serve(host="127.0.0.1", port=1)
    assert served["forwarded_allow_ips"] == "10.0.0.1"
    assert served["http"] is PatientProtocol
    assert served["ws"] == "none"
