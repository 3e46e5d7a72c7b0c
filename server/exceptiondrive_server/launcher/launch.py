"""Starts, supervises and stops the processes of the embedded default."""

import errno
import os
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from types import FrameType

from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.setup import prepare
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.phases.policy import is_open
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_server.launcher.broker import broker_command, find_broker_binary, socket_path
from exceptiondrive_server.launcher.child import Child, ChildPlan, LaunchError, Say, die_with_parent
from exceptiondrive_server.launcher.layout import (
    Address,
    BrokerFolder,
    Layout,
    banner,
    broker_plan,
    data_lock,
    find_command,
    service_plans,
    shared_environment,
    worker_environment,
)
from exceptiondrive_server.launcher.own_split import open_phase_on
from exceptiondrive_server.launcher.sample import PHASES, tell_page
from exceptiondrive_server.launcher.users import own_user_of_server

_TICK_S = 0.1
_GRACE_S = 20.0
_BROKER_START_S = 10.0
_DEATHS_BEFORE_GIVING_UP = 3


@dataclass
class Launcher:
    """The embedded default on one DATA folder; `run` returns when a signal has ended it."""

    layout: Layout
    address: Address
    with_sample: bool
    own_split: Path | None
    say: Say
    children: list[Child] = field(default_factory=list, init=False)
    _sample: subprocess.Popen[bytes] | None = field(default=None, init=False)
    _signals: int = field(default=0, init=False)

    def run(self) -> None:
        """Run until SIGINT or SIGTERM.

        Raises:
            LaunchError: It cannot start; the text says why.
        """
        self.layout.create()
        with data_lock(self.layout):
            require_free_port(self.address)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, self._on_signal)
            self.say("starting ...")
            folder = BrokerFolder(self.layout)
            try:
                self._watch(self._start_all(folder))
            finally:
                self._end_all()
                folder.remove()

    def _start_all(self, folder: BrokerFolder) -> dict[str, str]:
        given_url = os.environ.get("EXCEPTIONDRIVE_BROKER_URL")
        shared = shared_environment(self.layout, self.address, given_url or folder.url)
        self._migrate(shared)
        with _records(shared) as database:
            tell_page(database, "the server starts" if self.with_sample else "")
            if self.own_split is not None:
                open_phase_on(self.own_split, self.layout, shared, database, self.say)
        user, words = own_user_of_server(self.layout.data)
        self.say(words)
        if given_url:
            self.say("broker: the one of EXCEPTIONDRIVE_BROKER_URL")
        else:
            self._start_broker(folder, user)
        plans = service_plans(self.layout, self.address, shared, user)
        for plan in plans:
            self._start(plan)
        return shared

    def _start_broker(self, folder: BrokerFolder, user: int | None) -> None:
        binary = find_broker_binary()
        self.say(f"broker: {binary}, private, on a unix socket")
        socket_path(folder.path).unlink(missing_ok=True)
        command = broker_command(binary, folder.path)
        if user is not None:
            folder.give_to(user)
        child = self._start(broker_plan(self.layout, command, user))
        deadline = time.monotonic() + _BROKER_START_S
        while not socket_path(folder.path).exists():
            if not child.is_alive or time.monotonic() > deadline:
                raise LaunchError(f"the broker did not start:\n{child.last_lines()}")
            time.sleep(0.01)

    def _migrate(self, shared: Mapping[str, str]) -> None:
        from alembic.util.exc import CommandError

        url = shared["EXCEPTIONDRIVE_DATABASE_URL"]
        try:
            prepare(url)
        except (SQLAlchemyError, CommandError) as error:
            raise LaunchError(f"the records could not be brought up to date: {error}") from None

    def _phase_to_try(self, shared: Mapping[str, str]) -> str | None:
        """Return a phase that takes files, for the printed first steps; None if there is none."""
        if self.with_sample:
            return PHASES[PLANNING.id].id
        with _records(shared) as database, database.read() as session:
            now = database_now(session)
            taking = (phase.id for phase in list_phases(session) if is_open(phase, now))
            return next(taking, None)

    def _start(self, plan: ChildPlan) -> Child:
        child = Child(plan)
        self.children.append(child)
        child.start()
        return child

    def _watch(self, shared: Mapping[str, str]) -> None:
        is_ready = is_refusing = False
        while not self._signals:
            for child in self.children:
                news = child.check()
                if news is not None:
                    self._tell_death(child, news, is_ready)
            status = None if is_ready else _readiness(self.address)
            if status == HTTPStatus.SERVICE_UNAVAILABLE and not is_refusing:
                is_refusing = True
                self.say(
                    f"{self.address.url} answers, and can take no uploads yet; in another terminal "
                    f"`exceptiondrive-server doctor --data {self.layout.data}` says what to do"
                )
            if status == HTTPStatus.OK:
                is_ready = True
                self.say(banner(self.layout.data, self.address, self._phase_to_try(shared)))
                self._start_sample(shared)
            self._check_sample()
            time.sleep(_TICK_S)

    def _tell_death(self, child: Child, news: str, is_ready: bool) -> None:
        tail = "\n".join(f"    {line}" for line in child.last_lines().splitlines())
        self.say(f"{news} (log: {child.plan.log})\n{tail}")
        if not is_ready and child.starts >= _DEATHS_BEFORE_GIVING_UP:
            raise LaunchError(f"the {child.plan.name} does not start; see {child.plan.log}")

    def _start_sample(self, shared: Mapping[str, str]) -> None:
        if not self.with_sample:
            return
        command = [
            find_command("exceptiondrive-server"),
            *("fill-sample", "--data", str(self.layout.data), "--server", self.address.url),
        ]
        environment = worker_environment(self.layout, shared)
        self._sample = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=die_with_parent(os.getpid()),  # noqa: PLW1509 - no threads here
        )

    def _check_sample(self) -> None:
        if self._sample is None or self._sample.poll() is None:
            return
        if self._sample.returncode != 0:
            self.say("the sample could not be filled; the server runs on without it")
        self._sample = None

    def _end_all(self) -> None:
        self.say("stopping ...")
        if self._sample is not None and self._sample.poll() is None:
            os.killpg(self._sample.pid, signal.SIGTERM)
        brokers = [child for child in self.children if child.plan.name == "broker"]
        services = [child for child in self.children if child not in brokers]
        self._end_children(services)
        self._end_children(brokers)  # last: the worker says goodbye to it
        if self._sample is not None:
            self._sample.wait()
        self.say("stopped; the data stays in " + str(self.layout.data))

    def _end_children(self, children: list[Child]) -> None:
        for child in children:
            child.end()
        deadline = time.monotonic() + _GRACE_S
        seen = self._signals
        while any(not child.wait(time.monotonic() + _TICK_S) for child in children):
            if time.monotonic() > deadline or self._signals > max(seen, 1):
                break
        for child in children:
            child.kill()  # whatever is left of the group
            child.wait(time.monotonic() + 5)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._signals += 1


def require_free_port(address: Address) -> None:
    """Check that nobody listens there.

    Raises:
        LaunchError: The port is taken, or the host is none of this machine.
    """
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family is socket.AF_INET6:
            probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)  # as asyncio listens
        try:
            probe.bind((address.host, address.port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise LaunchError(
                    f"port {address.port} is in use; choose another one with --port "
                    "(`make run PORT=8001`)"
                ) from None
            raise LaunchError(
                f"cannot listen on {address.host}:{address.port}: {error.strerror}"
            ) from None


@contextmanager
def _records(shared: Mapping[str, str]) -> Iterator[Database]:
    database = Database(shared["EXCEPTIONDRIVE_DATABASE_URL"])
    try:
        yield database
    finally:
        database.dispose()


def _readiness(address: Address) -> int | None:
    """Return the status of `/readyz`, or None while nobody answers."""
    try:
        with urllib.request.urlopen(f"{address.url}/readyz", timeout=1) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as refusal:
        with refusal:
            return refusal.code
    except (urllib.error.URLError, OSError):
        return None


def launch(
    data: Path, address: Address, *, with_sample: bool, own_split: Path | None = None, say: Say
) -> None:
    """Run the embedded default on a data folder until a signal ends it.

    Raises:
        LaunchError: It cannot start; the text says why.
    """
    os.umask(0o077)  # records and logs hold what other users of the machine must not read
    Launcher(Layout(data), address, with_sample, own_split, say).run()
