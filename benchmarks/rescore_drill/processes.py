"""The processes of a drill: broker, API, reconciler, two workers; workers may be killed."""

import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

from exceptiondrive_server.launcher.broker import (
    broker_command,
    broker_url,
    find_broker_binary,
    socket_path,
)

BIN = Path(sys.executable).parent
WORKERS = (("live", 2), ("rescore", 1))
"""Lane and slots of each worker: what compose.yaml starts."""
SHORT_LEASE = {
    "EXCEPTIONDRIVE_SOFT_TIME_LIMIT_S": "10",
    "EXCEPTIONDRIVE_TIME_LIMIT_S": "11",
    "EXCEPTIONDRIVE_LEASE_S": "12",
    "EXCEPTIONDRIVE_BOARD_LEASE_S": "12",
}
"""So that the work of a killed worker is taken up again while one waits."""


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Deployment:
    """Everything that runs, in process groups of its own."""

    def __init__(self, database_url: str, folder: Path, port: int) -> None:
        self.folder = folder
        self.url = f"http://127.0.0.1:{port}"
        self._port = port
        self._broker_folder = folder / "broker"
        self._broker_folder.mkdir()
        self._environment = {
            **{k: v for k, v in os.environ.items() if not k.startswith("EXCEPTIONDRIVE_")},
            **SHORT_LEASE,
            "EXCEPTIONDRIVE_DATABASE_URL": database_url,
            "EXCEPTIONDRIVE_FILE_STORE_URL": (folder / "uploads").as_uri(),
            "EXCEPTIONDRIVE_SPLITS_DIR": str(folder / "splits"),
            "EXCEPTIONDRIVE_PRIVATE_DIR": str(folder / "private"),
            "EXCEPTIONDRIVE_BROKER_URL": broker_url(self._broker_folder),
        }
        self._others: list[subprocess.Popen[bytes]] = []
        self._workers: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        """Start all, and wait until the API answers."""
        binary = find_broker_binary()
        self._others.append(self._run(broker_command(binary.path, self._broker_folder), "broker"))
        while not socket_path(self._broker_folder).exists():
            time.sleep(0.01)
        server = str(BIN / "exceptiondrive-server")
        self._others.append(self._run([server, "serve", "--port", str(self._port)], "server"))
        self._others.append(self._run([server, "reconcile"], "reconciler"))
        self._workers = [self._worker(number) for number in range(len(WORKERS))]
        while not self._answers():
            time.sleep(0.1)

    def kill_a_worker(self, chance: random.Random) -> int:
        """SIGKILL a whole worker, or only its scoring process; a dead one is started again."""
        number = chance.randrange(len(self._workers))
        worker = self._workers[number]
        if chance.random() < 0.5:
            _kill(os.killpg, worker.pid)
            worker.wait()
            self._workers[number] = self._worker(number)
            return 1
        children = Path(f"/proc/{worker.pid}/task/{worker.pid}/children").read_text().split()
        for child in children:
            _kill(os.kill, int(child))
        return len(children)

    def end(self) -> None:
        """End everything that was started here."""
        for process in (*self._workers, *reversed(self._others)):
            _kill(os.killpg, process.pid)
            process.wait()

    def _run(self, command: list[str], name: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.log").open("ab") as log:
            return subprocess.Popen(
                command, env=self._environment, stdout=log, stderr=log, start_new_session=True
            )

    def _worker(self, number: int) -> subprocess.Popen[bytes]:
        lane, slots = WORKERS[number]
        worker = [str(BIN / "exceptiondrive-worker"), "run", "--lanes", lane]
        return self._run([*worker, "--concurrency", str(slots)], f"worker-{number}")

    def _answers(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self.url}/healthz", timeout=2) as answer:
                return bool(answer.status == 200)
        except (urllib.error.URLError, ConnectionError, TimeoutError):
            return False


def _kill(kill: Callable[[int, int], None], pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        kill(pid, signal.SIGKILL)
