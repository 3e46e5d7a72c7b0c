"""The real topology as processes: API, two reconcilers, workers, broker behind a proxy, database."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from subprocess import Popen
from typing import Any

import redis
from sqlalchemy import make_url
from tests.chaos import saboteur
from tests.chaos.postgres import Postgres
from tests.chaos.processes import Process, Supervisor, signal_process, started
from tests.chaos.proxy import Proxy
from tests.chaos.splits import drives_in, multiply, plant_canary, thin
from tests.chaos.users import Users, as_user
from tests.support.forked import Forked
from tests.support.processes import free_port

from exceptiondrive_records.accounts.tokens import issue_token
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role, grant_to_files
from exceptiondrive_records.operations.setup import prepare
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.splits.splits import manifest_of
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_server.launcher.broker import broker_command, find_broker_binary, socket_path
from exceptiondrive_worker.sample.files import write_sample_split

ROOT = Path(__file__).parents[2]
PHASE = "chaos"
TEAMS = ("alpha", "beta", "gamma", "delta")
LEASE_S = 5.0
MAX_ATTEMPTS = 5
HEARTBEAT_TTL_S = 5.0
SHORT = {
    "SOFT_TIME_LIMIT_S": "3.5",
    "TIME_LIMIT_S": "4",
    "LEASE_S": f"{LEASE_S:g}",
    "BOARD_LEASE_S": "4",
    "MAX_ATTEMPTS": f"{MAX_ATTEMPTS}",
    "RETRY_BACKOFF_S": "0.2",
    "RECONCILE_EVERY_S": "0.3",
    "HEARTBEAT_EVERY_S": "1",
    "HEARTBEAT_TTL_S": f"{HEARTBEAT_TTL_S:g}",
    "LEADER_LEASE_S": "2",
}

PATIENT = {
    "EXCEPTIONDRIVE_SOFT_TIME_LIMIT_S": "14",
    "EXCEPTIONDRIVE_TIME_LIMIT_S": "15",
    "EXCEPTIONDRIVE_LEASE_S": "16",
}
"""For a worker whose scoring runs take seconds, which on a busy machine last longer."""


class Broker:
    """A private broker that keeps nothing on disk."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(mode=0o700)
        self._command = broker_command(find_broker_binary(), folder)
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 20
        while True:
            try:
                with self.client() as client:
                    client.ping()
                return
            except redis.exceptions.ConnectionError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.02)

    def client(self) -> redis.Redis:
        return redis.Redis(unix_socket_path=str(socket_path(self.folder)), socket_timeout=20)

    def answers(self, within_s: float = 0.5) -> bool:
        """Whether it answers a ping in time."""
        path = str(socket_path(self.folder))
        try:
            with redis.Redis(unix_socket_path=path, socket_timeout=within_s) as client:
                return bool(client.ping())
        except redis.exceptions.RedisError:
            return False

    def n_calls(self, command: str) -> int:
        """How often it was told a command, as it counts itself."""
        with self.client() as client:
            told = client.info("commandstats").get(f"cmdstat_{command}", {})
        return int(told.get("calls", 0))

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        socket_path(self.folder).unlink(missing_ok=True)

    @contextmanager
    def down(self) -> Iterator[None]:
        """Kill it, and start another one at the end: it is gone meanwhile, and forgets all."""
        pid = self.process.pid
        self.kill()
        assert not self.answers(), "the broker is up"
        try:
            yield
        finally:
            self.start()
        assert self.process.pid != pid, "it is the same broker"

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Let it stand still: it takes connections, and answers nobody."""
        signal_process(self.process.pid, signal.SIGSTOP)
        try:
            assert not self.answers(), "the broker answers"
            yield
            assert not self.answers(), "the broker answers"
        finally:
            self.process.send_signal(signal.SIGCONT)


class Topology:
    """Everything running on one folder; `close` ends all of it."""

    def __init__(
        self,
        *,
        uses_postgres: bool = False,
        data: Path | None = None,
        n_workers: int = 1,
        users: Users | None = None,
        split_copies: int = 1,
        every_sample: int = 1,
        has_canary: bool = False,
        is_database_proxied: bool = False,
        settings: Mapping[str, str] | None = None,
        is_forked: bool = False,
    ) -> None:
        """Start it.

        Args:
            uses_postgres: Instead of SQLite.
            data: Where the file of SQLite lies.
            n_workers: Of two processes that score each.
            users: Who runs what, if not the user of the tests.
            split_copies: How often each sample is in the split.
            every_sample: One means all samples, seven every seventh.
            has_canary: Whether withheld regions hold a coordinate that is looked for everywhere.
            is_database_proxied: Whether connections to PostgreSQL go over a proxy.
            settings: More of the environment.
            is_forked: Whether services that need nothing else are forked from a process that has imported theirs.
        """
        self.folder = Path(tempfile.mkdtemp(prefix="ed-chaos-"))
        self.patience_s = 90.0
        self.users = users
        self.data = data or self.folder
        self.orders = self.folder / "orders"
        self.splits = self.folder / "splits"
        self.uploads = self.folder / "uploads"
        self.orders.mkdir()
        self.postgres = Postgres() if uses_postgres else None
        self._is_database_proxied = is_database_proxied
        if is_database_proxied:
            assert self.postgres is not None, "a file cannot be far away"
            self.database_proxy = Proxy(self.postgres.socket)
        self.broker = Broker(self.folder / "broker")
        self.proxy = Proxy(socket_path(self.broker.folder))
        self.supervisor = Supervisor()
        self.url = f"http://127.0.0.1:{free_port()}"
        self.environment = {**self._environment(), **(settings or {})}
        self._split_copies = split_copies
        self._every_sample = every_sample
        self._has_canary = has_canary
        assert not (is_forked and users), "a forked process keeps its user"
        self._is_forked = is_forked
        if users is not None:
            self._raise_walls(users)
        self.database = Database(self.database_url)
        self.files = FileStore(self.uploads.as_uri())
        try:
            self._start(n_workers)
        except BaseException:
            self.close(keep=True)  # its logs tell why
            raise

    def _start(self, n_workers: int) -> None:
        self.tokens = self._prepare()
        self.server = self._add("server", "server", "serve", "--port", self.url.rpartition(":")[2])
        self.reconcilers = [self._add(f"reconciler-{n}", "server", "reconcile") for n in (1, 2)]
        self.workers = [
            self._add(f"worker-{n + 1}", "worker", "run", "--concurrency", "2")
            for n in range(n_workers)
        ]
        n_slots = 2 * n_workers
        self.wait_until(lambda: self.readiness().get("live_workers", 0) >= n_slots, "a start")

    @property
    def worker(self) -> Process:
        return self.workers[0]

    @property
    def database_url(self) -> str:
        if self.postgres is not None:
            return self.postgres.url
        return f"sqlite:///{self.data / 'records.sqlite3'}"

    def add_worker(
        self,
        *,
        environment: dict[str, str] | None = None,
        slots: int = 2,
        lanes: str = "live,rescore",
    ) -> Process:
        """Start one worker more."""
        name = f"worker-{len(self.workers) + 1}"
        serves = ("--lanes", lanes, "--concurrency", f"{slots}")
        worker = self._add(name, "worker", "run", *serves, **(environment or {}))
        self.workers.append(worker)
        return worker

    def add_server(self, host: str) -> Process:
        """Start one server more, at the same port of another address of this machine."""
        port = self.url.rpartition(":")[2]
        return self._add(f"server-{host}", "server", "serve", "--host", host, "--port", port)

    def remove_worker(self, worker: Process) -> None:
        worker.hold_down()
        self.workers.remove(worker)
        self.supervisor.processes.remove(worker)

    def order(self, name: str, what: str = "") -> Path:
        """Give the saboteur an order."""
        path = self.orders / name
        path.write_text(what)
        return path

    def readiness(self, host: str = "127.0.0.1") -> dict[str, Any]:
        url = self.url.replace("127.0.0.1", host)
        try:
            with urllib.request.urlopen(f"{url}/readyz", timeout=5) as answer:
                found: dict[str, Any] = json.load(answer)
                return found
        except (urllib.error.URLError, TimeoutError, ConnectionError):
            return {}

    def freeze_between_writes(self) -> None:
        """Freeze the worker and its children, none of them in the middle of a write.

        On SQLite such a one would keep everybody from writing till it thaws: the lock is ours meanwhile.
        """
        with self.database.write() as session:
            session.connection()  # takes the lock
            self.worker.freeze()

    def wait_until(
        self, question: Callable[[], object], what: str, timeout_s: float | None = None
    ) -> float:
        """Wait for something, and say how long it took; raise when it never comes."""
        started, timeout_s = time.monotonic(), timeout_s or self.patience_s
        while not question():
            if time.monotonic() > started + timeout_s:
                raise TimeoutError(f"waited {timeout_s:g} s in vain for {what}; {self.folder}")
            time.sleep(0.05)
        return time.monotonic() - started

    def close(self, *, keep: bool = False) -> None:
        self.supervisor.close()
        self.proxy.close()
        if self._is_database_proxied:
            self.database_proxy.close()
        self.broker.kill()
        self.database.dispose()
        if self.postgres is not None:
            self.postgres.close()
        if not keep:
            shutil.rmtree(self.folder, ignore_errors=True)

    def _add(self, name: str, which: str, *arguments: str, **environment: str) -> Process:
        log = self.folder / f"{name}.log"
        process = Process(name, self._way_to(name, log, which, *arguments, **environment), log)
        process.start()
        self.supervisor.processes.append(process)
        return process

    def _way_to(
        self, name: str, log: Path, which: str, *arguments: str, **environment: str
    ) -> Callable[[], Popen[bytes] | Forked]:
        """Return what starts a process: what its environment says for imports needs one that imports."""
        own = {**self.environment, **self._address_of(which, *arguments), **environment}
        if self._is_forked and not environment:
            return partial(Forked, saboteur.run, [which, *arguments], own, log)
        command = [sys.executable, "-m", "tests.chaos.saboteur", which, *arguments]
        if self.users is not None:
            user = self.users.worker if which == "worker" else self.users.server
            command = as_user(user, self.users.group, command)
            own = self._with_secrets_in_files(name, own, user)
        return partial(started, command, own, log)

    def _address_of(self, which: str, *arguments: str) -> dict[str, str]:
        """Let a service connect as compose does: on PostgreSQL under a role of its own."""
        if self.postgres is None:
            return {}
        of_server = Role.RECONCILER if "reconcile" in arguments else Role.API
        role = Role.WORKER if which == "worker" else of_server
        return {"EXCEPTIONDRIVE_DATABASE_URL": self.role_urls[role]}

    @property
    def role_urls(self) -> dict[Role, str]:
        """The address of each role on PostgreSQL."""
        assert self.postgres is not None
        owner = make_url(self.postgres.url)
        if self._is_database_proxied:
            owner = owner.set(host="127.0.0.1", port=self.database_proxy.port, query={})
        return {
            role: owner.set(username=role, password="trusted").render_as_string(hide_password=False)
            for role in Role
        }

    def _environment(self) -> dict[str, str]:
        kept = {k: v for k, v in os.environ.items() if not k.startswith("EXCEPTIONDRIVE_")}
        values = {
            **SHORT,
            "DATABASE_URL": self.database_url,
            "BROKER_URL": f"redis://127.0.0.1:{self.proxy.port}/0",
            "FILE_STORE_URL": self.uploads.as_uri(),
            "SPLITS_DIR": str(self.splits),
            "PRIVATE_DIR": str(self.folder / "private"),
        }
        kept.pop("PYTHONDONTWRITEBYTECODE", None)
        return {
            **kept,
            **{f"EXCEPTIONDRIVE_{name}": value for name, value in values.items()},
            saboteur.ORDERS: str(self.orders),
            "PYTHONPATH": os.pathsep.join([str(ROOT), kept.get("PYTHONPATH", "")]),
            "PYTHONPYCACHEPREFIX": f"{tempfile.gettempdir()}/exceptiondrive-tests-pycache",
        }

    def _raise_walls(self, users: Users) -> None:
        """Give every folder to who needs it: splits and private store to the workers alone."""
        self.folder.chmod(0o755)
        self.orders.chmod(0o777)  # whoever obeys an order uses it up
        for folder, user, mode in (
            (self.splits, users.worker, 0o700),
            (self.folder / "private", users.worker, 0o700),
            (self.uploads, users.server, 0o2750),
        ):
            folder.mkdir()
            os.chown(folder, user, users.group)
            folder.chmod(mode)

    def _with_secrets_in_files(
        self, service: str, environment: dict[str, str], user: int
    ) -> dict[str, str]:
        """Take addresses out of the environment, as compose's secrets do."""
        folder = self.folder / f"secrets-{service}"
        folder.mkdir(exist_ok=True)
        environment["EXCEPTIONDRIVE_SECRETS_DIR"] = str(folder)
        for name in ("EXCEPTIONDRIVE_DATABASE_URL", "EXCEPTIONDRIVE_BROKER_URL"):
            path = folder / name.lower()
            path.unlink(missing_ok=True)
            path.write_text(environment.pop(name))
            path.chmod(0o400)
            os.chown(path, user, user)
        return environment

    def _make_roles(self) -> None:
        """Make the roles as `migrate --grant-to` does in compose."""
        files = []
        for role, url in self.role_urls.items():
            files.append(self.folder / f"{role}.url")
            files[-1].write_text(url)
        grant_to_files(self.database_url, files)

    def _register_splits(self) -> None:
        log = self.folder / "register-splits.log"
        users, self.users = self.users, None  # as an operator
        assert self._way_to("", log, "worker", "register-splits")().wait(120) == 0, log.read_text()
        self.users = users

    def _prepare(self) -> dict[str, str]:
        """Schema, split, phase, teams; return a token for each team."""
        prepare(self.database_url)
        if self.postgres is not None:
            self._make_roles()
        split = write_sample_split(self.splits)
        if self._split_copies > 1:
            multiply(split, self._split_copies)
        if self._every_sample > 1:
            thin(split, self._every_sample)
        if self._has_canary:
            plant_canary(split)
        self.drives = drives_in(split)
        if self.users is not None:
            for path in (split.parent, split):
                os.chown(path, self.users.worker, self.users.group)
        self._register_splits()
        tokens = {}
        with self.database.write() as session:
            self.sample_ids = manifest_of(session, "sample").sample_ids
            create_phase(
                session,
                NewPhase(
                    id=PHASE,
                    challenge=PLANNING.id,
                    title="Chaos",
                    split="sample",
                    protocol="1.0",
                    quota_per_day=1000,
                    quota_total=None,
                    rejected_per_day=1000,
                ),
                actor="chaos",
            )
            for team in TEAMS:
                row = create_team(session, team, team.title(), actor="chaos")
                tokens[team], _ = issue_token(session, row.id, "chaos", actor="chaos")
        return tokens
