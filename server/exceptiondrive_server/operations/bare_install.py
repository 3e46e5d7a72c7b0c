"""Install a production server without containers: folders, secrets, settings and units, from `bare/`.

The files in `bare/` are compose.yaml for systemd on one machine: the same users, commands, isolation
and limits. nginx uses the same file as in containers, with this machine's addresses.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

from exceptiondrive_server.launcher.broker import find_broker_binary
from exceptiondrive_server.launcher.child import LaunchError
from exceptiondrive_server.launcher.users import SERVER_USER
from exceptiondrive_server.operations.secrets import (
    DATABASE,
    OWNER,
    RECEIPT_KEY,
    require_pair,
    write_first_secrets,
)

GROUP = SERVER_USER
WORKER_USER, PROXY_USER, OWNER_USER, BROKER_USER = 10002, 10003, 10004, 10005
DATABASE_AT, BROKER_AT = "127.0.0.1", "127.0.0.1:6380"
_HTTP2_SINCE = (1, 25, 1)
_BARE = resources.files(__package__) / "bare"
_BESIDE = {"as.sh": "as", "sysusers.conf": "sysusers.conf"}
"""What is no unit, and where it stands."""
_FOLDERS = {
    # name: (user, mode); workers read uploads through the group
    "etc": (0, 0o755),
    "systemd": (0, 0o755),
    "secrets": (OWNER_USER, 0o700),
    "uploads": (SERVER_USER, 0o2750),
    "backups": (SERVER_USER, 0o700),
    "splits": (WORKER_USER, 0o700),
    "private": (WORKER_USER, 0o700),
    "broker": (BROKER_USER, 0o700),
}
_COPIED = {
    # secret: (its copy in etc/, user)
    RECEIPT_KEY: (RECEIPT_KEY, SERVER_USER),
    "tls.crt": ("tls.crt", PROXY_USER),
    "tls.key": ("tls.key", PROXY_USER),
    "broker.conf": ("broker.conf", BROKER_USER),
}


@dataclass(frozen=True)
class BareServer:
    """Where a server lives, and with which programs.

    Attributes:
        folder: Keeps everything: data, secrets, settings, units.
        programs: Folder of `exceptiondrive-server` and `exceptiondrive-worker`.
        host: Name that people type.
    """

    folder: Path
    programs: Path
    host: str

    def write(self) -> list[Path]:
        """Write everything; secrets that are there stay, all else follows from them anew.

        Returns:
            The secrets that were made.

        Raises:
            LaunchError: This is not root, no nginx or broker is installed, or key and certificate do
                not belong together.
        """
        if os.geteuid() != 0:
            raise LaunchError("only root can give folders and secrets to the services' users")
        nginx = _find_nginx()
        programs = {"nginx": str(nginx), "broker": str(find_broker_binary())}
        for name, (user, mode) in _FOLDERS.items():
            path = self.folder / name
            path.mkdir(parents=True, exist_ok=True)
            _set_owner(path, user, mode)
        secrets = self.folder / "secrets"
        made = write_first_secrets(secrets, self.host, database=DATABASE_AT, broker=BROKER_AT)
        require_pair(secrets)
        (secrets / "database.sql").write_text(
            _first_sql((secrets / "postgres_password").read_text())
        )
        for path in (secrets, *secrets.iterdir()):
            _set_owner(path, OWNER_USER, 0o700 if path.is_dir() else 0o400)
        for secret, (copy, user) in _COPIED.items():
            self._replace_file(f"etc/{copy}", (secrets / secret).read_text(), user, 0o600)
        for service, (user, values) in self._settings(secrets).items():
            path = self.folder / f"etc/{service}.env"
            self._replace_file(f"etc/{service}.env", _merged_settings(values, path), user, 0o600)
        for name, text in _unit_templates():
            place = _BESIDE.get(name, f"systemd/{name}")
            filled = Template(text).substitute(programs, folder=self.folder, programs=self.programs)
            self._replace_file(place, filled, 0, 0o755 if name == "as.sh" else 0o644)
        self._replace_file("etc/nginx.conf", self._nginx(nginx), 0, 0o644)
        return made

    def _replace_file(self, name: str, text: str, user: int, mode: int) -> None:
        """Replace a file whole; it is never readable by anybody else, not for a moment."""
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        new = path.with_name(f".{path.name}.new")
        new.unlink(missing_ok=True)
        new.touch(mode=0o600)
        new.write_text(text)
        _set_owner(new, user, mode)
        new.replace(path)

    def _settings(self, secrets: Path) -> Mapping[str, tuple[int, Mapping[str, str]]]:
        """Return the user and the settings of each service that has some."""

        def common(database: str) -> dict[str, str]:
            return {
                "DATABASE_URL": (secrets / database).read_text(),
                "BROKER_URL": (secrets / "broker_url").read_text(),
                "FILE_STORE_URL": (self.folder / "uploads").as_uri(),
            }

        site = {"PUBLIC_URL": f"https://{self.host}"}
        server = {
            "RECEIPT_KEY_FILE": f"{self.folder}/etc/{RECEIPT_KEY}",
            "TRUSTED_PROXIES": "127.0.0.1",
            "CLIENT_DIR": f"{self.programs.parent}/client",
            "OIDC_CLIENT_SECRET": (secrets / "oidc_client_secret").read_text(),
        }
        password = (secrets / "smtp_password").read_text()
        mail = {"SMTP_PASSWORD": password} if password else {}  # it may stand in etc/ alone
        worker = {
            "SPLITS_DIR": f"{self.folder}/splits",
            "PRIVATE_DIR": f"{self.folder}/private",
        }
        return {
            "server": (SERVER_USER, common("database_url") | site | server),
            "reconciler": (SERVER_USER, common("reconciler_database_url") | site | mail),
            "worker": (WORKER_USER, common("worker_database_url") | worker),
            "owner": (OWNER_USER, common("owner_database_url")),
        }

    def _nginx(self, nginx: Path) -> str:
        """Return deploy/nginx.conf with the addresses and files of this machine."""
        etc = self.folder / "etc"
        servers = "".join(f" server 127.0.0.1:{port} max_fails=0;" for port in (8001, 8002))
        changes = {
            "pid /run/nginx.pid;": "pid /run/exceptiondrive-proxy/nginx.pid;",
            "resolver 127.0.0.11 valid=2s ipv6=off;": f"upstream servers {{{servers} }}",
            "set $application server:8000;": "set $application servers;",
            "listen 8080;": "listen 80;\n    listen [::]:80;",
            "listen 8443 ssl;": "listen 443 ssl;\n    listen [::]:443 ssl;",
            "/run/secrets/tls_certificate;": f"{etc}/tls.crt;",
            "/run/secrets/tls_key;": f"{etc}/tls.key;",
        }
        text = replaced((_BARE / "nginx.conf").read_text("utf-8"), changes)
        return text if speaks_http2_by_itself(nginx) else older_http2(text)


def replaced(text: str, changes: Mapping[str, str]) -> str:
    """Return the text with every change made.

    Raises:
        LookupError: Something to replace stands there not once.
    """
    for old, new in changes.items():
        if text.count(old) != 1:
            raise LookupError(f"{text.count(old)} times in the text: {old}")
        text = text.replace(old, new)
    return text


def speaks_http2_by_itself(nginx: Path) -> bool:
    """Whether this nginx knows `http2 on`; Debian 12 has 1.22, which does not."""
    said = subprocess.run([nginx, "-v"], capture_output=True, text=True, check=True).stderr
    version = said.split("/")[1].split()[0]
    return tuple(int(part) for part in version.split(".")) >= _HTTP2_SINCE


def older_http2(text: str) -> str:
    """Return a configuration of nginx for versions that take `http2` as a word of `listen`."""
    return replaced(text, {"http2 on;": ""}).replace(" ssl;", " ssl http2;")


def _first_sql(password: str) -> str:
    """Return what makes the owner of the tables and the database, for psql."""
    return (
        f"CREATE ROLE {OWNER} LOGIN CREATEROLE PASSWORD '{password}';\n"
        f"CREATE DATABASE {DATABASE} OWNER {OWNER};\n"
    )


def _merged_settings(values: Mapping[str, str], path: Path) -> str:
    """Return lines of settings; what an operator added to the file stays."""
    lines = [f"EXCEPTIONDRIVE_{name}={value}" for name, value in values.items()]
    ours = {line.partition("=")[0] for line in lines}
    there = path.read_text().splitlines() if path.exists() else []
    kept = [line for line in there if line.partition("=")[0] not in ours]
    return "\n".join([*lines, *kept, ""])


def _unit_templates() -> Iterator[tuple[str, str]]:
    """Yield the name of each unit and drop-in below `bare/`, and its text."""
    for found in sorted(_BARE.iterdir(), key=lambda f: f.name):
        if found.is_dir():
            yield from ((f"{found.name}/{f.name}", f.read_text("utf-8")) for f in found.iterdir())
        elif found.name != "nginx.conf":
            yield found.name, found.read_text("utf-8")


def _set_owner(path: Path, user: int, mode: int) -> None:
    os.chown(path, user, 0 if user == 0 else GROUP)
    path.chmod(mode)


def _find_nginx() -> Path:
    found = shutil.which("nginx", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin")
    if found is None:
        raise LaunchError("no nginx is installed; install it, and leave its own service off")
    return Path(found)


def programs_of_this() -> Path:
    """Return the folder of the program that runs."""
    return Path(sys.argv[0]).absolute().parent
