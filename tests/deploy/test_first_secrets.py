"""`init-secrets` makes what compose.yaml names, and what stands in two files agrees."""

import ssl
import stat
import subprocess
from pathlib import Path
from typing import Any

import pytest
import redis
import yaml
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from redis.backoff import ConstantBackoff
from redis.retry import Retry
from sqlalchemy import URL, make_url
from tests.support.processes import free_port
from typer.testing import CliRunner, Result

from exceptiondrive_records.db.roles import Role, role_of
from exceptiondrive_server.launcher.broker import find_broker_binary
from exceptiondrive_server.launcher.child import LaunchError
from exceptiondrive_server.operations.cli import app

ROOT = Path(__file__).parents[2]
_UNTIL_IT_STARTS = Retry(ConstantBackoff(0.05), 200)


@pytest.fixture
def compose() -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((ROOT / "compose.yaml").read_text("utf-8"))
    return document


def init(folder: Path, *more: str) -> Result:
    return CliRunner().invoke(app, ["init-secrets", str(folder), *more])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "secrets"
    done = init(made, "--host", "board.example.org")
    assert done.exit_code == 0, done.output
    return made


def test_every_file_of_compose_is_there_and_nothing_else(
    folder: Path, compose: dict[str, Any]
) -> None:
    named = {Path(secret["file"]).name for secret in compose["secrets"].values()}
    assert {path.name for path in folder.iterdir()} == named
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o644}


def address(folder: Path, name: str) -> URL:
    return make_url((folder / name).read_text())


def test_each_service_has_a_role_and_a_password_of_its_own(
    folder: Path, compose: dict[str, Any]
) -> None:
    names = ("database_url", "worker_database_url", "reconciler_database_url")
    found = [role_of((folder / name).read_text()) for name in names]
    assert [role for role, _ in found] == [Role.API, Role.WORKER, Role.RECONCILER]
    owner = address(folder, "owner_database_url")
    passwords = {str(url.password) for _, url in found} | {str(owner.password)}
    assert len(passwords) == 4
    assert min(len(password) for password in passwords) >= 32
    database = compose["services"]["database"]["environment"]
    assert owner.username == database["POSTGRES_USER"]
    assert {owner.database, *(url.database for _, url in found)} == {database["POSTGRES_DB"]}
    assert (folder / "postgres_password").read_text() == owner.password
    assert owner.host in compose["services"]


def test_broker_and_its_clients_agree(folder: Path, compose: dict[str, Any]) -> None:
    url = make_url((folder / "broker_url").read_text())
    assert (folder / "broker.conf").read_text() == f"requirepass {url.password}\n"
    assert url.host in compose["services"]


def test_keys_are_what_their_readers_take(folder: Path) -> None:
    key = load_pem_private_key((folder / "receipt_key.pem").read_bytes(), password=None)
    assert isinstance(key, Ed25519PrivateKey)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "tls.crt", folder / "tls.key")
    trust = ssl.create_default_context(cafile=str(folder / "tls.crt"))
    (certificate,) = trust.get_ca_certs()
    assert certificate["subjectAltName"] == (("DNS", "board.example.org"),)


def test_two_runs_share_no_secret(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    init(other, "--host", "board.example.org")
    same = {
        path.name
        for path in folder.iterdir()
        if path.read_bytes() == (other / path.name).read_bytes()
    }
    assert same == {"oidc_client_secret", "smtp_password"}, "which are empty"


def test_run_again_it_adds_what_is_missing_and_keeps_what_is_there(folder: Path) -> None:
    """As after an upgrade to a version that asks for a secret more, or after a full disk."""
    lost = {"smtp_password", "receipt_key.pem", "database_url", "tls.crt", "tls.key"}
    kept = {path: path.read_bytes() for path in folder.iterdir() if path.name not in lost}
    for name in lost - {"database_url"}:
        (folder / name).unlink()
    (folder / "database_url").chmod(0o600)
    (folder / "database_url").write_bytes(b"")  # a full disk left it so
    done = init(folder)
    assert done.exit_code == 0, done.output
    said = done.stderr.splitlines()[0].partition(": ")[2]
    assert set(said.split(", ")) == lost
    assert all(path.read_bytes() == content for path, content in kept.items())
    assert role_of((folder / "database_url").read_text())[0] is Role.API
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o644}
    again = init(folder)
    assert "nothing, every file is there" in again.stderr
    assert "is self-signed" not in again.stderr


@pytest.mark.parametrize(
    ("lost", "other"),
    [
        ("postgres_password", "owner_database_url"),
        ("broker.conf", "broker_url"),
        ("tls.key", "tls.crt"),
    ],
)
def test_of_two_files_that_agree_none_is_made_alone(folder: Path, lost: str, other: str) -> None:
    (folder / lost).unlink()
    (folder / "smtp_password").unlink()
    done = init(folder)
    assert isinstance(done.exception, LaunchError)
    assert f"holds {other} and no {lost}" in str(done.exception)
    assert not (folder / "smtp_password").exists(), "nothing was written"


def test_no_secret_is_printed(tmp_path: Path) -> None:
    done = init(tmp_path / "printed")
    contents = [path.read_text().strip() for path in (tmp_path / "printed").iterdir()]
    assert not [text for text in contents if text and text in done.output]
    assert "chmod" not in done.output


def test_the_broker_starts_with_composes_own_words_and_takes_the_password(
    folder: Path, compose: dict[str, Any], tmp_path: Path
) -> None:
    _, config, *options = compose["services"]["broker"]["command"]
    assert Path(config).name == "broker_acl_conf"
    port = free_port()
    command = [str(find_broker_binary()), str(folder / "broker.conf"), *options]
    url = make_url((folder / "broker_url").read_text())
    with subprocess.Popen(
        [*command, "--port", str(port), "--bind", "127.0.0.1"],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
    ) as broker:
        try:
            with redis.Redis(port=port, password=url.password, retry=_UNTIL_IT_STARTS) as client:
                assert client.config_get("maxmemory-policy") == {"maxmemory-policy": "noeviction"}
                assert client.config_get("appendonly") == {"appendonly": "yes"}
            with (
                redis.Redis(port=port, password="guessed") as stranger,
                pytest.raises(redis.AuthenticationError),
            ):
                stranger.ping()
        finally:
            broker.kill()


@pytest.mark.parametrize("command", ["init-secrets", "new-receipt-key"])
def test_where_nothing_can_be_written_one_sentence_says_so(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    place = tmp_path / "file" / "below"
    monkeypatch.setenv("EXCEPTIONDRIVE_RECEIPT_KEY_FILE", str(place / "key.pem"))
    arguments = [command, str(place)] if command == "init-secrets" else [command]
    done = CliRunner().invoke(app, arguments)
    assert isinstance(done.exception, LaunchError)
    assert f"{place}" in str(done.exception)
    assert "cannot be written: Not a directory. A file that" in str(done.exception)
