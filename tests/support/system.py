"""The whole system as an operator starts it, and participants as they use it."""

import json
import os
import signal
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import httpx
import redis
from tests.support.processes import BIN, free_port, plain_environment, wait_until

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
    launcher: "subprocess.Popen[bytes]"
    launcher_log: Path

    def environment(self, token: str | None = None) -> dict[str, str]:
        ours = {
            "EXCEPTIONDRIVE_SERVER": self.url,
            "EXCEPTIONDRIVE_SPLITS_DIR": str(self.splits),
            "XDG_CONFIG_HOME": str(self.data / "config"),
        }
        return plain_environment(**ours, **({"EXCEPTIONDRIVE_TOKEN": token} if token else {}))

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

    def work(self, *arguments: str | Path) -> None:
        """Run a command of the worker beside the system; it has to succeed."""
        records = {"EXCEPTIONDRIVE_DATABASE_URL": f"sqlite:///{self.data}/records.sqlite3"}
        done = subprocess.run(
            [BIN / "exceptiondrive-worker", *arguments],
            env=self.environment() | records,
            check=False,
            capture_output=True,
            text=True,
            timeout=240,
        )
        assert done.returncode == 0, done.stderr

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

    def said(self) -> str:
        """What the launcher has told its operator so far."""
        return self.launcher_log.read_text()

    def read(self, path: str) -> str:
        """Return what stands at a path of the site."""
        with urllib.request.urlopen(f"{self.url}{path}", timeout=30) as answer:
            text: str = answer.read().decode()
            return text

    def get(self, path: str) -> Any:
        """Return what the API answers to anybody."""
        return json.loads(self.read(f"/api/v1{path}"))

    def post(self, token: str, file: Path, phase: str, method: str) -> dict[str, Any]:
        """Upload past the client and its check, as a script might; return what is answered."""
        with file.open("rb") as stream:
            answer = httpx.post(
                f"{self.url}/api/v1/submissions",
                headers={"Authorization": f"Bearer {token}"},
                data={"phase": phase, "method": method},
                files={"file": ("file.json", stream)},
                timeout=60,
            )
        assert answer.status_code == 202, answer.text
        submission: dict[str, Any] = answer.json()
        return submission

    def submission(self, token: str, submission_id: str) -> dict[str, Any]:
        """Return what its team is told of a submission."""
        answer = httpx.get(
            f"{self.url}/api/v1/submissions/{submission_id}",
            headers={"Authorization": f"Bearer {token}"},
        )
        assert answer.status_code == 200, answer.text
        submission: dict[str, Any] = answer.json()
        return submission

    def submissions(self, token: str) -> list[dict[str, Any]]:
        """Return the team's submissions, as the client prints them."""
        done = self.client("submissions", "--json", token=token)
        assert done.returncode == 0, done.stderr
        found: list[dict[str, Any]] = json.loads(done.stdout)
        return found

    def make_team(self, slug: str) -> str:
        """Make a team as an organizer does; return its token."""
        return self.organize("teams", "create", slug, slug, "--with-token").strip()

    def open_phase(self, phase: str, split: str, *options: str) -> None:
        """Open a phase on a registered split, under 1.0 unless the options say otherwise."""
        if "--protocol" not in options:
            options = ("--protocol", "1.0", *options)
        options = ("--split", split, "--title", phase, "--quota-per-day", "50", *options)
        self.organize("phases", "create", phase, *options)

    def organize(self, *arguments: str) -> str:
        """Run a command of organizers; it has to succeed."""
        done = self.client("organizer", *arguments, token=self.organizers_token)
        assert done.returncode == 0, done.stderr
        return done.stdout

    @cached_property
    def organizers_token(self) -> str:
        """A token that an operator issues."""
        return self.operate("exceptiondrive-server", "create-organizer", "test").split()[-1]

    def kill_workers(self) -> None:
        """SIGKILL to the worker and to every process that scores; the launcher starts another."""
        self.signal_workers(signal.SIGKILL)

    def signal_workers(self, number: signal.Signals) -> None:
        """Send a signal to the worker and to every process that scores."""
        for pid in self._worker_pids():
            try:
                os.kill(pid, number)
            except ProcessLookupError:
                pass

    def _worker_pids(self) -> list[int]:
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

    def empty_broker(self) -> None:
        """Let the broker forget everything."""
        sockets = [path for path in (self.data / "broker").rglob("*") if path.is_socket()]
        assert sockets, "the broker listens on a socket of its own"
        with redis.Redis(unix_socket_path=str(sockets[0])) as client:
            client.flushall()

    def is_ready(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self.url}/readyz", timeout=2) as answer:
                return bool(json.load(answer)["live_workers"])
        except (urllib.error.URLError, TimeoutError, ConnectionError):
            return False


@contextmanager
def running_system(
    data: Path, splits: Path, *options: str, **environment_more: str
) -> Iterator[System]:
    """Start everything as an operator does, wait for a worker, and end it as Ctrl-C does."""
    port = free_port()
    environment = plain_environment(
        EXCEPTIONDRIVE_SPLITS_DIR=str(splits), **SHORT_LEASE, **environment_more
    )
    data.mkdir(parents=True, exist_ok=True)
    log = data / "launcher.txt"
    with log.open("wb") as said:
        launcher = subprocess.Popen(
            [BIN / "exceptiondrive-server", "run", "--port", str(port), "--data", data, *options],
            env=environment,
            stdout=said,
            stderr=subprocess.STDOUT,
        )
    running = System(data, f"http://127.0.0.1:{port}", splits, launcher, log)
    try:
        wait_until(running.is_ready, "a worker", 120)
        yield running
    finally:
        launcher.send_signal(signal.SIGINT)
        launcher.wait(timeout=60)
