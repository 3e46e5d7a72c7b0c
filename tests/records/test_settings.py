"""Settings: malformed or misspelt ones stop the start with one clear sentence."""

import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from tests.support.processes import plain_environment

from exceptiondrive_records.db.settings import RecordsSettings, SettingsError, load_settings
from exceptiondrive_records.notifications.channels import NoticeSettings


def test_the_defaults_are_those_that_survived_every_fault() -> None:
    settings = load_settings(RecordsSettings)
    assert (settings.lease_s, settings.max_attempts, settings.reconcile_every_s) == (120, 4, 1)


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("DATABASE_URL", "mysql://x", "must start with sqlite:///"),
        ("BROKER_URL", "amqp://x", "must start with redis://"),
        ("FILE_STORE_URL", "ftp://x", "must start with file:///"),
        ("BROKER_URL", "memory://", "must start with redis://"),
        ("FILE_STORE_URL", "memory://", "must start with file:/// or s3://BUCKET$"),
        ("FILE_STORE_URL", "s3:///uploads", "must start with file:/// or s3://BUCKET"),
        ("LEASE_S", "-1", "greater than 0"),
        ("MAX_ATTEMPTS", "many", "valid integer"),
    ],
)
def test_a_malformed_value_is_named(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, words: str
) -> None:
    monkeypatch.setenv(f"EXCEPTIONDRIVE_{variable}", value)
    with pytest.raises(SettingsError, match=words) as refused:
        load_settings(RecordsSettings)
    assert f"EXCEPTIONDRIVE_{variable}" in str(refused.value)


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("PUBLIC_URL", "board.example.org"),
        ("MAIL_FROM", "nobody"),
        ("MAIL_FROM", "The board <no-reply@"),
        ("MAIL_FROM", "no-reply@board.example\nBcc: eve@example.org"),
    ],
)
def test_a_sender_whose_mails_could_not_be_sent_or_followed_is_refused_at_the_start(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_MAIL_FROM", "The board, \u00fcber <no-reply@board.example>")
    load_settings(NoticeSettings)
    monkeypatch.setenv(f"EXCEPTIONDRIVE_{variable}", value)
    with pytest.raises(SettingsError, match=rf"EXCEPTIONDRIVE_{variable}: must be .* as in "):
        load_settings(NoticeSettings)


def test_a_reconciler_that_would_lose_its_lead_between_two_polls_is_refused_at_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_RECONCILE_EVERY_S", "20")
    with pytest.raises(SettingsError, match="third of EXCEPTIONDRIVE_LEADER_LEASE_S"):
        load_settings(RecordsSettings)
    monkeypatch.setenv("EXCEPTIONDRIVE_LEADER_LEASE_S", "60")
    assert load_settings(RecordsSettings).reconcile_every_s == 20


def test_a_misspelt_variable_is_not_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABSE_URL", "sqlite:///x")
    with pytest.raises(SettingsError, match="did you mean EXCEPTIONDRIVE_DATABASE_URL"):
        load_settings(RecordsSettings)


def test_variables_of_other_parts_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("TOKEN", "SERVER", "PRIVATE_DIR", "MAX_UPLOAD_BYTES"):
        monkeypatch.setenv(f"EXCEPTIONDRIVE_{name}", "x")
    assert load_settings(RecordsSettings).max_attempts == 4


def test_a_secret_may_stand_in_a_file_of_its_name(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "exceptiondrive_database_url").write_text("postgresql+psycopg://u:p@db/x\n")
    (tmp_path / "exceptiondrive_broker_url").write_text("redis://:p@broker/0")
    monkeypatch.setenv("EXCEPTIONDRIVE_SECRETS_DIR", str(tmp_path))
    monkeypatch.delenv("EXCEPTIONDRIVE_DATABASE_URL", raising=False)
    settings = load_settings(RecordsSettings)
    assert settings.database_url == "postgresql+psycopg://u:p@db/x"
    assert settings.broker_url == "redis://:p@broker/0"


def test_the_environment_goes_before_a_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "exceptiondrive_lease_s").write_text("7")
    monkeypatch.setenv("EXCEPTIONDRIVE_SECRETS_DIR", str(tmp_path))
    monkeypatch.setenv("EXCEPTIONDRIVE_LEASE_S", "9")
    assert load_settings(RecordsSettings).lease_s == 9


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("broker_url", "amqp://user:hush@x"),
        ("broker_url", "redis://:hush/hush@broker:6379/0"),
        ("database_url", "postgresql+psycopg://user:x@hush@db:five/x"),
        ("database_url", "postgresql+psycopg://user:x@db:hush/x"),
    ],
)
def test_a_malformed_secret_is_named_but_not_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, value: str
) -> None:
    (tmp_path / f"exceptiondrive_{name}").write_text(value)
    monkeypatch.setenv("EXCEPTIONDRIVE_SECRETS_DIR", str(tmp_path))
    monkeypatch.delenv("EXCEPTIONDRIVE_DATABASE_URL", raising=False)
    with pytest.raises(SettingsError, match=f"EXCEPTIONDRIVE_{name.upper()}") as refused:
        load_settings(RecordsSettings)
    assert "hush" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "url"),
    [
        ("DATABASE_URL", "postgresql+psycopg://u:p:hush@h:hush/x"),
        ("BROKER_URL", "redis://:hush#x@127.0.0.1:6379/0"),
        ("BROKER_URL", "redis://broker:hush/0"),
    ],
)
def test_an_address_that_a_sign_of_its_password_breaks_is_named_and_not_told(
    monkeypatch: pytest.MonkeyPatch, name: str, url: str
) -> None:
    monkeypatch.setenv(f"EXCEPTIONDRIVE_{name}", url)
    with pytest.raises(SettingsError, match=f"EXCEPTIONDRIVE_{name}.*%2F") as refused:
        load_settings(RecordsSettings)
    assert "hush" not in str(refused.value)


def test_a_folder_of_secrets_that_is_not_there_is_not_passed_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_SECRETS_DIR", str(tmp_path / "none"))
    with pytest.raises(SettingsError, match=r"EXCEPTIONDRIVE_SECRETS_DIR names .*/none"):
        load_settings(RecordsSettings)


@pytest.mark.parametrize("closed", ["", "exceptiondrive_broker_url"])
def test_what_this_user_may_not_read_of_the_secrets_is_named(closed: str) -> None:
    with tempfile.TemporaryDirectory() as name:  # others may enter the folder above it
        folder = Path(name) / "secrets"
        folder.mkdir()
        (folder / "exceptiondrive_broker_url").write_text("redis://:p@broker/0")
        Path(name).chmod(0o755)
        (folder / closed).chmod(0)
        told = subprocess.run(
            [sys.executable, "-c", _AS_SOMEBODY_ELSE],
            env=plain_environment(EXCEPTIONDRIVE_SECRETS_DIR=str(folder)),
            capture_output=True,
            text=True,
            check=False,
        )
        folder.chmod(0o700)
    assert told.stdout.startswith(f"the secrets in {folder} cannot be read"), told.stderr
    assert f"Permission denied: '{folder / closed}'" in told.stdout


_AS_SOMEBODY_ELSE = """
import os
from exceptiondrive_records.db.settings import RecordsSettings, SettingsError, load_settings
if os.geteuid() == 0:
    os.setgroups([]); os.setgid(10001); os.setuid(10001)
try:
    load_settings(RecordsSettings)
except SettingsError as error:
    print(error)
"""


def test_a_secret_that_cannot_be_read_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "exceptiondrive_broker_url").write_bytes(b"\xff\xfe")
    monkeypatch.setenv("EXCEPTIONDRIVE_SECRETS_DIR", str(tmp_path))
    with pytest.raises(SettingsError, match=r"cannot be read .*broker_url"):
        load_settings(RecordsSettings)
