"""The whole system as an operator starts it, and participants as they use it."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
REALDATA = ROOT.parent / "shared" / "realdata"
BIN = Path(sys.executable).parent
SHORT_LEASE = {
    "EXCEPTIONDRIVE_SOFT_TIME_LIMIT_S": "6",
    "EXCEPTIONDRIVE_TIME_LIMIT_S": "7",
    "EXCEPTIONDRIVE_LEASE_S": "8",
}
"""So that the job of a killed worker is taken up again while the test waits."""


@dataclass(frozen=True)
class System:
    """A running deployment on the embedded default."""

    data: Path
    url: str
    splits: Path
    launcher: subprocess.Popen[bytes]

    def environment(self, token: str | None = None) -> dict[str, str]:
        ours = {
            "EXCEPTIONDRIVE_SERVER": self.url,
            "EXCEPTIONDRIVE_SPLITS_DIR": str(self.splits),
            "XDG_CONFIG_HOME": str(self.data / "config"),
        }
        kept = {k: v for k, v in os.environ.items() if not k.startswith("EXCEPTIONDRIVE_")}
        return kept | ours | ({"EXCEPTIONDRIVE_TOKEN": token} if token else {})

    def operate(self, command: str, *arguments: str) -> str:
        """Run an operator's command on the machine itself; it has to succeed."""
        done = subprocess.run(
            [BIN / command, *arguments, "--data", self.data],
            env=self.environment(),
            check=False,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def client(
        self, *arguments: str | Path, token: str | None = None
    ) -> "subprocess.CompletedProcess[str]":
        """Run the participant's client."""
        return subprocess.run(
            [BIN / "exceptiondrive", *arguments],
            env=self.environment(token),
            check=False,
            capture_output=True,
            text=True,
            timeout=300,
        )

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"{self.url}/api/v1{path}", timeout=30) as answer:
            return json.load(answer)

    def submissions(self, token: str) -> list[dict[str, Any]]:
        """The team's submissions, as the client prints them."""
        done = self.client("submissions", "--json", token=token)
        assert done.returncode == 0, done.stderr
        found: list[dict[str, Any]] = json.loads(done.stdout)
        return found

    def worker_pids(self) -> list[int]:
        """Processes of this deployment's worker: the parent, then its children."""
        listed = subprocess.run(
            ["ps", "-eo", "pid,ppid,args"], check=False, capture_output=True, text=True
        )
        rows = [line.split(None, 2) for line in listed.stdout.splitlines()[1:]]
        parents = [
            int(pid)
            for pid, ppid, args in rows
            if int(ppid) == self.launcher.pid and "exceptiondrive-worker" in args
        ]
        return parents + [int(pid) for pid, ppid, _ in rows if int(ppid) in parents]

    def wait_until(self, condition: Callable[[], bool], timeout_s: float = 120.0) -> None:
        """Wait until something holds, and fail if it never does."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, "it did not happen in time"
            time.sleep(0.1)

    def is_ready(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self.url}/readyz", timeout=2) as answer:
                return bool(json.load(answer)["live_workers"])
        except (urllib.error.URLError, TimeoutError, ConnectionError):
            return False


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


@pytest.fixture(scope="session")
def start_system() -> Callable[..., System]:
    """Start a deployment as an operator does: data folder, splits folder, options of `run`."""

    def start(data: Path, splits: Path, *options: str) -> System:
        port = free_port()
        environment = {k: v for k, v in os.environ.items() if not k.startswith("EXCEPTIONDRIVE_")}
        environment |= {"EXCEPTIONDRIVE_SPLITS_DIR": str(splits)}
        launcher = subprocess.Popen(
            [BIN / "exceptiondrive-server", "run", "--port", str(port), "--data", data, *options],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        return System(data, f"http://127.0.0.1:{port}", splits, launcher)

    return start


@contextmanager
def running_system(data: Path, splits: Path, *options: str) -> Iterator[System]:
    """Start everything as an operator does, wait for a worker, and end it as Ctrl-C does."""
    port = free_port()
    environment = {k: v for k, v in os.environ.items() if not k.startswith("EXCEPTIONDRIVE_")}
    environment |= {"EXCEPTIONDRIVE_SPLITS_DIR": str(splits), **SHORT_LEASE}
    launcher = subprocess.Popen(
        [BIN / "exceptiondrive-server", "run", "--port", str(port), "--data", data, *options],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    running = System(data, f"http://127.0.0.1:{port}", splits, launcher)
    try:
        running.wait_until(running.is_ready)
        yield running
    finally:
        launcher.send_signal(signal.SIGINT)
        launcher.wait(timeout=60)


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """Start everything over the real splits; skip, saying so, where they are absent."""
    if not REALDATA.is_dir():
        pytest.skip("the real planner outputs are not beside the repository: ../shared/realdata")
    base = tmp_path_factory.mktemp("system")
    splits = base / "splits"
    for name in ("nuscenes-real", "carla-pairs"):
        (splits / name).mkdir(parents=True)
        shutil.copy(REALDATA / name / "split.json.gz", splits / name / "split.json.gz")
    with running_system(base / "data", splits) as running:
        yield running


def open_phases(system: System, *names: str) -> None:
    """Register the splits and open a phase over each of these."""
    work(system, "register-splits")
    for name in names:
        options = ("--split", name, "--per-day", "50", "--shows-reported")
        system.operate("exceptiondrive-server", "create-phase", name, *options)


def work(system: System, *arguments: str | Path) -> None:
    """Run a command of the worker beside the system; it has to succeed."""
    done = subprocess.run(
        [BIN / "exceptiondrive-worker", *arguments],
        env=system.environment()
        | {"EXCEPTIONDRIVE_DATABASE_URL": f"sqlite:///{system.data}/records.sqlite3"},
        check=False,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def sample_system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """Start everything with the generated sample, as `make run` does."""
    base = tmp_path_factory.mktemp("sample")
    with running_system(base / "data", ROOT / "hidden_splits", "--sample") as running:
        yield running


@pytest.fixture(scope="module")
def phases(system: System) -> System:
    """Open a phase over each real split."""
    open_phases(system, "nuscenes-real", "carla-pairs")
    return system


@pytest.fixture(scope="module")
def token(phases: System) -> str:
    """Make a team with a token, as an operator does."""
    printed = phases.operate(
        "exceptiondrive-server", "create-team", "testers", "Testers", "--with-token"
    )
    return next(word for word in printed.split() if word.startswith("edk_"))
