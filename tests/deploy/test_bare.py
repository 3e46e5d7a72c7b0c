"""A server without containers: what `init --bare` writes, and that its units say what compose.yaml says."""

import os
import re
import shlex
import shutil
import stat
import subprocess
import time
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.chaos.users import can_change_user
from tests.operating.units import Unit, read_unit
from typer.testing import CliRunner, Result

from exceptiondrive_server.launcher.child import LaunchError
from exceptiondrive_server.operations.cli import app
from exceptiondrive_server.operations.secrets import self_signed

ROOT = Path(__file__).parents[2]
SERVER, WORKER, PROXY, OWNER, BROKER = range(10001, 10006)
AS_IN_COMPOSE = {
    "server": "server@",
    "reconciler": "reconciler",
    "worker-live": "worker-live",
    "worker-rescore": "worker-rescore",
    "migrate": "migrate",
    "broker": "broker",
}


def init(folder: Path, host: str = "board.example.org") -> Result:
    return CliRunner().invoke(
        app, ["init", "--bare", str(folder), "--host", host, "--programs", "/opt/ed/bin"]
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    if not can_change_user():
        pytest.skip("only root can give folders to other users")
    made = tmp_path / "srv"
    done = init(made)
    assert done.exit_code == 0, done.output
    return made


def mode(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_uid, stat.S_IMODE(found.st_mode)


def unit(folder: Path, name: str) -> Unit:
    return read_unit(folder / "systemd" / f"exceptiondrive-{name}.service")


@pytest.fixture
def compose() -> dict[str, Any]:
    text = (ROOT / "compose.yaml").read_text("utf-8")
    services: dict[str, Any] = yaml.safe_load(text)["services"]
    return services


def test_every_file_and_folder_is_its_users_alone(folder: Path) -> None:
    assert {path.name: mode(path) for path in (folder / "etc").iterdir()} == {
        "server.env": (SERVER, 0o600),
        "reconciler.env": (SERVER, 0o600),
        "worker.env": (WORKER, 0o600),
        "owner.env": (OWNER, 0o600),
        "receipt_key.pem": (SERVER, 0o600),
        "tls.crt": (PROXY, 0o600),
        "tls.key": (PROXY, 0o600),
        "broker.conf": (BROKER, 0o600),
        "nginx.conf": (0, 0o644),
    }
    assert {path.name: mode(path) for path in folder.iterdir() if path.is_dir()} == {
        "etc": (0, 0o755),
        "systemd": (0, 0o755),
        "secrets": (OWNER, 0o700),
        "splits": (WORKER, 0o700),
        "private": (WORKER, 0o700),
        "uploads": (SERVER, 0o2750),
        "backups": (SERVER, 0o700),
        "broker": (BROKER, 0o700),
    }
    assert {mode(path) for path in (folder / "secrets").iterdir()} == {(OWNER, 0o400)}


def test_no_password_stands_in_a_file_that_everybody_reads(folder: Path) -> None:
    password = (folder / "secrets/postgres_password").read_text()
    open_files = [p for p in folder.rglob("*") if p.is_file() and mode(p)[1] & 0o007]
    assert len(open_files) > 10
    assert not [path for path in open_files if password in path.read_text()]
    assert password in (folder / "secrets/database.sql").read_text()


def test_each_service_has_its_own_address_of_the_database_and_no_other(
    folder: Path,
) -> None:
    """The worker's file names the splits, and only that one."""
    roles = {"server": "api", "reconciler": "reconciler", "worker": "worker", "owner": "owner"}
    texts = {name: (folder / f"etc/{name}.env").read_text() for name in roles}
    for name, role in roles.items():
        (line,) = [row for row in texts[name].splitlines() if "postgresql" in row]
        assert f"//exceptiondrive_{role}:" in line
    assert [name for name, text in texts.items() if "SPLITS_DIR" in text] == ["worker"]
    links = [name for name, text in texts.items() if "PUBLIC_URL=https://board.ex" in text]
    assert links == ["server", "reconciler"], "pages, and mails"


def test_the_server_hands_out_the_client_that_the_page_puts_beside_its_programs(
    folder: Path,
) -> None:
    """`init` ran with /opt/ed/bin; an upgrade of the programs is one of the client."""
    settings = (folder / "etc/server.env").read_text().splitlines()
    assert "EXCEPTIONDRIVE_CLIENT_DIR=/opt/ed/client" in settings
    page = (ROOT / "docs/operating-bare.md").read_text("utf-8")
    assert " -t /opt/exceptiondrive/1/client wheelhouse/exceptiondrive-*.whl" in page
    assert "--programs /opt/exceptiondrive/current/bin" in page


def test_run_again_it_keeps_secrets_data_and_what_an_operator_added(folder: Path) -> None:
    secrets = {path: path.read_bytes() for path in (folder / "secrets").iterdir()}
    settings, unit_file = folder / "etc/server.env", folder / "systemd/exceptiondrive.target"
    settings.write_text(settings.read_text() + "EXCEPTIONDRIVE_OIDC_CLIENT_ID=ours\n")
    unit_file.write_text("spoilt")
    (folder / "splits/kept").touch()
    for name, content in zip(("tls.crt", "tls.key"), self_signed("renewed"), strict=True):
        (folder / "secrets" / name).write_bytes(content)
    assert init(folder, "other.example.org").exit_code == 0
    kept = {path: path.read_bytes() for path in secrets if path.suffix not in {".crt", ".key"}}
    assert all(secrets[path] == content for path, content in kept.items())
    lines = settings.read_text().splitlines()
    assert lines.count("EXCEPTIONDRIVE_OIDC_CLIENT_ID=ours") == 1
    assert "EXCEPTIONDRIVE_PUBLIC_URL=https://other.example.org" in lines
    assert not [line for line in lines if "board.example.org" in line]
    assert (folder / "splits/kept").exists()
    assert "spoilt" not in unit_file.read_text()
    for name in ("tls.crt", "tls.key"):
        renewed = (folder / "secrets" / name).read_bytes()
        assert (folder / "etc" / name).read_bytes() == renewed != secrets[folder / "secrets" / name]
    assert not list(folder.rglob("*.new"))


def test_a_certificate_beside_anothers_key_is_refused_and_the_one_in_use_stays(
    folder: Path,
) -> None:
    """nginx takes such a pair without a word where the keys are of two kinds, and nobody gets in."""
    in_use = (folder / "etc/tls.crt").read_bytes()
    certificate, _ = self_signed("board.example.org")
    for content, said in ((certificate, "is not the key of"), (b"none", "cannot be read")):
        (folder / "secrets/tls.crt").write_bytes(content)
        done = init(folder)
        assert isinstance(done.exception, LaunchError)
        assert said in str(done.exception)
        assert (folder / "etc/tls.crt").read_bytes() == in_use


def test_it_says_when_the_certificate_ends_or_that_it_has(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that has ended is taken all the same: an upgrade does not wait for another."""
    assert "tls.crt ends on 20" in init(folder).stderr
    monkeypatch.setattr("exceptiondrive_server.operations.secrets.LIFETIME", timedelta(hours=-0.5))
    for name, content in zip(("tls.crt", "tls.key"), self_signed("board.example.org"), strict=True):
        (folder / "secrets" / name).write_bytes(content)
    done = init(folder)
    assert (done.exit_code, "tls.crt ended on 20" in done.stderr) == (0, True)


def test_the_password_of_mail_comes_from_its_secret_or_else_stays_as_written(folder: Path) -> None:
    settings, secret = folder / "etc/reconciler.env", folder / "secrets/smtp_password"
    settings.write_text(settings.read_text() + "EXCEPTIONDRIVE_SMTP_PASSWORD=written\n")
    for password, line in (("", "written"), ("kept", "kept")):
        secret.write_text(password)
        assert init(folder).exit_code == 0
        found = [row for row in settings.read_text().splitlines() if "SMTP_PASSWORD" in row]
        assert found == [f"EXCEPTIONDRIVE_SMTP_PASSWORD={line}"]


def test_old_backups_go_and_after_a_day_what_one_that_was_cut_off_left(folder: Path) -> None:
    """It has a name of its own, and may be as large as a backup."""
    (command,) = [line for line in unit(folder, "backup")["ExecStart"] if line.startswith("find ")]
    backups = folder / "backups"
    for name, days in (("a.tar", 20), (".b.tar-x1", 1.1), ("c.tar", 3), (".d.tar-x2", 0.5)):
        (backups / name).touch()
        os.utime(backups / name, (time.time() - days * 86_400,) * 2)
    subprocess.run(shlex.split(command), check=True)
    assert sorted(path.name for path in backups.iterdir()) == [".d.tar-x2", "c.tar"]


def test_a_command_of_the_operator_takes_settings_as_systemd_does(folder: Path) -> None:
    """No shell reads them: a blank, `<` or `$` ended it, or came out as something else."""
    settings = folder / "etc/server.env"
    added = "EXCEPTIONDRIVE_OIDC_NAME=single sign-on\nEXCEPTIONDRIVE_OIDC_CLIENT_SECRET=a$b;'c\n"
    more = '# a word\nEXCEPTIONDRIVE_MAIL_FROM="The board <no-reply@board.example.org>"'
    settings.write_text(settings.read_text() + added + more)
    done = subprocess.run(
        [folder / "as", "server", "env"], capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()
    assert {
        "EXCEPTIONDRIVE_OIDC_NAME=single sign-on",
        "EXCEPTIONDRIVE_OIDC_CLIENT_SECRET=a$b;'c",
        "EXCEPTIONDRIVE_MAIL_FROM=The board <no-reply@board.example.org>",
        "EXCEPTIONDRIVE_TRUSTED_PROXIES=127.0.0.1",
    } <= set(lines)


def test_a_split_is_published_with_the_workers_settings_and_the_right_to_write_uploads(
    folder: Path,
) -> None:
    """Workers have none; and what root puts among the uploads belongs to the server."""
    command = [f"{folder}/as", "publish-split", "sh", "-c", "id -u; env"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    user, *lines = done.stdout.splitlines()
    assert user == "0"
    assert f"EXCEPTIONDRIVE_SPLITS_DIR={folder}/splits" in lines
    assert any("//exceptiondrive_worker:" in line for line in lines)


def test_run_again_it_adds_a_secret_that_an_older_version_did_not_ask_for(folder: Path) -> None:
    secret = folder / "secrets/oidc_client_secret"
    secret.unlink()
    done = init(folder)
    assert done.exit_code == 0
    assert "new secrets: oidc_client_secret\n" in done.stderr
    assert (secret.read_text(), mode(secret)) == ("", (OWNER, 0o400))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may")
def test_who_is_not_root_is_told_so(tmp_path: Path) -> None:
    assert isinstance(init(tmp_path).exception, LaunchError)


@pytest.mark.parametrize(("service", "name"), AS_IN_COMPOSE.items())
def test_a_unit_runs_what_compose_runs(
    folder: Path, compose: dict[str, Any], service: str, name: str
) -> None:
    found, said = unit(folder, name), compose[service]
    options = [word for word in said.get("command", []) if word.startswith("--")]
    (command,) = found["ExecStart"]
    if service == "migrate":
        assert command.count("--grant-to=") == sum("--grant-to=" in word for word in options)
    else:
        assert set(options) <= set(shlex.split(command))
    mebibytes = {"M": 1, "G": 1024}
    limit, allowed = found["MemoryMax"][0], said["deploy"]["resources"]["limits"]["memory"]
    assert int(limit[:-1]) * mebibytes[limit[-1]] <= int(allowed[:-1]) * mebibytes[allowed[-1]]
    if service not in {"migrate", "broker"}:
        assert found["User"] == [said["user"].split(":")[0]]
    if "stop_grace_period" in said:
        assert found["TimeoutStopSec"] == [said["stop_grace_period"].rstrip("s")]
    is_confined = set(said["networks"]) == {"data"}
    assert ("IPAddressDeny" in found) is is_confined, "a way out where compose has one"


def test_systemd_gives_up_no_service_while_the_database_is_away(folder: Path) -> None:
    """A program that needs it ends at once then; by default the sixth start within 10 s would be the last."""
    shared = read_unit(folder / "systemd/exceptiondrive-.service.d/confined.conf")
    assert shared["StartLimitIntervalSec"] == ["0"]
    assert int(shared["RestartSec"][0]) >= 1
    lasting = {path.stem for path in (folder / "systemd").glob("*.service")}
    lasting -= {"exceptiondrive-migrate", "exceptiondrive-backup"}
    for name in lasting:
        assert unit(folder, name.removeprefix("exceptiondrive-"))["Restart"] == ["always"]


def test_the_proxy_may_open_what_its_connections_need(folder: Path) -> None:
    """systemd gives 1,024 descriptors; a connection takes one to the reader and one to a server."""
    text = (folder / "etc/nginx.conf").read_text()
    (connections,) = re.findall(r"worker_connections (\d+);", text)
    assert int(unit(folder, "proxy")["LimitNOFILE"][0]) >= 2 * int(connections)


def test_only_workers_see_splits_and_private_store(folder: Path) -> None:
    units = sorted((folder / "systemd").glob("exceptiondrive-*.service"))
    assert len(units) == 8
    for path in units:
        found = unit(folder, path.stem.removeprefix("exceptiondrive-"))
        is_worker = found["User"] == [str(WORKER)]
        hidden = found["InaccessiblePaths"][0].split()
        assert ({f"{folder}/splits", f"{folder}/private"} <= set(hidden)) is not is_worker
        if is_worker:
            assert found["ReadOnlyPaths"] == [f"{folder}/uploads {folder}/splits"]
        if path.stem != "exceptiondrive-migrate":
            assert f"{folder}/secrets" in hidden
        assert found["CapabilityBoundingSet"] in ([""], ["CAP_NET_BIND_SERVICE"])


def test_the_proxy_reads_the_very_file_of_the_containers(folder: Path) -> None:
    """What differs are addresses and places, and `http2` for an older nginx."""
    ours = set((folder / "etc/nginx.conf").read_text().splitlines())
    theirs = set((ROOT / "deploy/nginx.conf").read_text("utf-8").splitlines())
    different = theirs - ours
    words = ("pid ", "resolver 127", "listen ", "http2 on", "ssl_certificate", "set $application")
    assert different
    assert all(line.strip().startswith(words) for line in different), different


def analyze(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """What systemd's own reader says of the units; it starts nothing."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze")
    return subprocess.run(
        ["systemd-analyze", "--no-pager", *words],
        env={**os.environ, "SYSTEMD_UNIT_PATH": f"{folder}/systemd:"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def units(folder: Path) -> list[Path]:
    """All units; what they start is a program that is there."""
    for path in (folder / "systemd").glob("*.service"):
        path.write_text(path.read_text().replace("/opt/ed/bin/", "/bin/true "))
    return sorted(path for path in (folder / "systemd").iterdir() if path.is_file())


def said_of_ours(done: "subprocess.CompletedProcess[str]", folder: Path) -> list[str]:
    lines = (done.stderr + done.stdout).splitlines()
    return [line for line in lines if "exceptiondrive" in line or str(folder) in line]


def test_systemd_reads_every_unit_without_a_word(folder: Path, units: list[Path]) -> None:
    done = analyze(folder, "verify", "--man=no", *map(str, units))
    assert len(units) == 10
    assert said_of_ours(done, folder) == []


def test_systemd_names_a_misspelt_setting(folder: Path, units: list[Path]) -> None:
    path = folder / "systemd/exceptiondrive-worker-live.service"
    path.write_text(path.read_text().replace("ReadOnlyPaths=", "ReadOnlyPath="))
    (line,) = said_of_ours(analyze(folder, "verify", "--man=no", str(path)), folder)
    assert "ReadOnlyPath" in line
    confined = folder / "systemd/exceptiondrive-.service.d/confined.conf"
    confined.write_text("[Service]\nPrivateTmpp=yes\n")
    lines = said_of_ours(analyze(folder, "verify", "--man=no", str(path)), folder)
    assert any("PrivateTmpp" in line for line in lines), "it reads what all units share"


def test_systemd_finds_every_service_confined(folder: Path, units: list[Path]) -> None:
    """Its own measure of exposure, from 0 to 100: under 20; without the shared file it is over 60."""
    services = [path.name.replace("@", "@8001") for path in units if path.suffix == ".service"]
    words = ("security", "--offline=true", "--threshold=20")
    if "unknown option" in analyze(folder, "security", "--offline=true", services[0]).stderr:
        pytest.skip("this systemd-analyze measures running services alone")
    for name in services:
        assert analyze(folder, *words, name).returncode == 0, name
    (folder / "systemd/exceptiondrive-.service.d/confined.conf").unlink()
    assert analyze(folder, "security", "--offline=true", "--threshold=60", services[0]).returncode


def test_every_user_of_a_unit_gets_an_account(folder: Path, tmp_path: Path) -> None:
    """systemd itself reads the file; without an account a unit ends with 217/USER before it begins."""
    if shutil.which("systemd-sysusers") is None:
        pytest.skip("no systemd-sysusers")
    root = tmp_path / "root"
    (root / "etc/sysusers.d").mkdir(parents=True)
    shutil.copy(folder / "sysusers.conf", root / "etc/sysusers.d/exceptiondrive.conf")
    subprocess.run(["systemd-sysusers", f"--root={root}"], check=True, capture_output=True)
    rows = [line.split(":") for line in (root / "etc/passwd").read_text().splitlines()]
    accounts = {row[2]: row[3] for row in rows if row[0].startswith("exceptiondrive")}
    units = [read_unit(path) for path in (folder / "systemd").glob("*.service")]
    assert {user for found in units for user in found["User"]} == accounts.keys()
    (confined,) = (folder / "systemd").glob("*.d/confined.conf")
    assert set(accounts.values()) == set(read_unit(confined)["Group"])


@pytest.mark.parametrize(
    ("locks", "built"),
    [("client", ["."]), ("server worker", [".", "./server", "./worker"])],
)
def test_a_wheelhouse_holds_what_its_locks_are_for(locks: str, built: list[str]) -> None:
    done = subprocess.run(
        ["make", "--dry-run", "wheelhouse", f"LOCKS={locks}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    (line,) = [line for line in done.stdout.splitlines() if " pip wheel " in line]
    assert line.partition("-w wheelhouse ")[2].split() == built
