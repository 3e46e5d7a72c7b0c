"""A pytest plugin: a private Valkey or Redis for a test, watched for what is withheld."""

import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import redis
from tests.canary.watch import BrokerWatch

from exceptiondrive_server.launcher.broker import (
    broker_command,
    find_broker_binary,
    socket_path,
)
from exceptiondrive_server.launcher.broker import (
    broker_url as url_of_broker,
)
from exceptiondrive_server.launcher.child import LaunchError


class PrivateBroker:
    """A broker of one test, which may be killed, stopped and started again."""

    def __init__(self, folder: Path, command: list[str]) -> None:
        self.folder = folder
        self.url = url_of_broker(folder)
        self._command = command
        self.process = self.start()

    def start(self) -> subprocess.Popen[bytes]:
        self.process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            try:
                with self.client() as client:
                    client.ping()
                self.watch = BrokerWatch(self._connect)
                return self.process
            except redis.exceptions.ConnectionError:
                time.sleep(0.01)
        raise RuntimeError("the broker did not start")

    def _connect(self) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(str(socket_path(self.folder)))
        return connection

    def client(self) -> redis.Redis:
        return redis.Redis(unix_socket_path=str(socket_path(self.folder)))

    def waiting(self, lane: str = "live") -> int:
        """How many messages wait in a lane."""
        with self.client() as client:
            return int(client.llen(f"ed:{lane}"))

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.watch.stop()
        socket_path(self.folder).unlink(missing_ok=True)


@pytest.fixture
def broker() -> Iterator[PrivateBroker]:
    """A private Valkey or Redis, started for this test."""
    try:
        binary = find_broker_binary()
    except LaunchError as error:
        pytest.skip(str(error))
    folder = Path(tempfile.mkdtemp(prefix="ed-br-"))
    running = PrivateBroker(folder, broker_command(binary, folder))
    yield running
    running.kill()
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def broker_url(broker: PrivateBroker) -> str:
    """Address of the private broker of this test."""
    return broker.url
