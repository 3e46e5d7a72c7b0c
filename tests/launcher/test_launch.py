"""The embedded default for real: what dies is started again, and all ends with the launcher."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from tests.chaos.users import can_change_user, showing_python
from tests.support.processes import free_port, plain_environment

from exceptiondrive_server.launcher.users import SERVER_USER
from exceptiondrive_worker.sample.files import write_sample_split

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SERVER = Path(sys.executable).parent / "exceptiondrive-server"
ROOT = Path(__file__).parents[2]


def run_command(data: Path, port: int) -> list[str]:
    return [str(SERVER), "run", "--port", str(port), "--data", str(data)]


class Running:
    """A launcher of this test."""

    def __init__(
        self, data: Path, port: int, *, command: list[str] | None = None, **environment: str
    ) -> None:
        self.data = data
        self.port = port
        self.said = data.parent / "said.txt"
        with self.said.open("wb") as said:
            self.process = subprocess.Popen(
                command or run_command(data, port),
                stdout=said,
                stderr=subprocess.STDOUT,
                env={**plain_environment(), **environment},
                cwd=ROOT,
            )

    def wait_until(self, is_so: Callable[[str], bool]) -> None:
        deadline = time.monotonic() + 200
        while not is_so(self.said.read_text()):
            assert self.process.poll() is None, self.said.read_text()
            assert time.monotonic() < deadline, self.said.read_text()
            time.sleep(0.1)

    def children(self) -> dict[str, int]:
        """Pids of the direct children, by the last word of their name."""
        found = {}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                parent = int(stat.read_text().rpartition(")")[2].split()[1])
                words = (stat.parent / "cmdline").read_bytes().decode().split("\0")
            except (FileNotFoundError, ProcessLookupError):
                continue
            if parent == self.process.pid:
                name = next(
                    (w for w in ("serve", "reconcile", "run", "fill-sample") if w in words),
                    "broker",
                )
                found[name] = int(stat.parent.name)
        return found

    def pages(self) -> list[str]:
        """What board and form say as soon as it answers."""
        self.wait_until(lambda _: answers(self.port))
        return [httpx.get(f"http://127.0.0.1:{self.port}{path}").text for path in ("/", "/submit")]

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)


@contextmanager
def started(data: Path, *more: str) -> Iterator[Running]:
    port = free_port()
    running = Running(data, port, command=[*run_command(data, port), *more])
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.end()


@pytest.fixture(scope="module")
def before_the_sample(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The folder of a launcher that was ended before its sample was made, and what its pages said."""
    data = tmp_path_factory.mktemp("launched") / "data"
    with started(data, "--sample") as running:
        return data, running.pages()


@pytest.fixture(scope="module")
def running(before_the_sample: tuple[Path, list[str]]) -> Iterator[Running]:
    """The next launcher in that folder, for all tests that only look at it."""
    with started(before_the_sample[0]) as running:
        yield running


def has_started(said: str) -> bool:
    return "ExceptionDrive runs at" in said


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_whatever_dies_is_started_again_and_nothing_outlives_the_launcher(tmp_path: Path) -> None:
    with started(tmp_path / "data") as running:
        running.wait_until(has_started)
        before = running.children()
        assert sorted(before) == ["broker", "reconcile", "run", "serve"]
        for pid in before.values():
            os.kill(pid, signal.SIGKILL)
        running.wait_until(lambda _: len(running.children()) == 4 and not is_any(before, running))
        after = running.children()
        running.process.kill()
        running.process.wait()
    deadline = time.monotonic() + 60
    while any(Path(f"/proc/{pid}").exists() for pid in after.values()):
        assert time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="nobody can write into /proc")
def test_a_server_that_can_take_no_uploads_says_where_to_learn_why(tmp_path: Path) -> None:
    data = tmp_path / "data"
    running = Running(data, free_port(), EXCEPTIONDRIVE_FILE_STORE_URL="file:///proc")
    try:
        running.wait_until(lambda said: "can take no uploads yet" in said)
    finally:
        running.end()
    said = running.said.read_text()
    assert f"`exceptiondrive-server doctor --data {data}` says what to do" in said
    assert not has_started(said)


def test_pages_say_that_the_sample_is_being_made_and_only_while_it_is(
    before_the_sample: tuple[Path, list[str]], running: Running
) -> None:
    for page in before_the_sample[1]:
        assert "The sample is being made" in page
        assert "There is no phase yet" not in page
    for page in running.pages():
        assert "The sample is being made" not in page, "the launcher that made it was ended"
        assert "There is no phase yet" in page


def answers(port: int) -> bool:
    try:
        return httpx.get(f"http://127.0.0.1:{port}/readyz").status_code == 200
    except httpx.TransportError:
        return False


def is_any(before: dict[str, int], running: Running) -> bool:
    return bool(set(before.values()) & set(running.children().values()))


_READ = "import pathlib, sys; print(len(pathlib.Path(sys.argv[1]).read_bytes()))"


@pytest.mark.skipif(not can_change_user(), reason="only root can give the server another user")
def test_who_takes_over_the_web_process_opens_no_split_file(
    open_folder: Path,
) -> None:
    splits, data = open_folder / "splits", open_folder / "data"
    withheld = write_sample_split(splits)
    port = free_port()
    command = showing_python([*run_command(data, port), "--sample"])
    running = Running(data, port, command=command, EXCEPTIONDRIVE_SPLITS_DIR=str(splits))
    try:
        running.wait_until(lambda said: "1 of 7 scored" in said)
        users = {
            name: Path(f"/proc/{pid}").stat().st_uid
            for name, pid in running.children().items()
            if name != "fill-sample"
        }
        kept = next((data / "private" / "settled").iterdir())
        split = httpx.get(f"http://127.0.0.1:{port}/api/v1/splits/sample")
    finally:
        running.end()
    said = running.said.read_text()
    assert f"the server runs as user {SERVER_USER}" in said
    assert "for withheld splits, use compose.yaml" in said, "it writes what workers believe"
    assert users == {
        "broker": SERVER_USER,
        "serve": SERVER_USER,
        "reconcile": SERVER_USER,
        "run": 0,
    }
    assert split.status_code == 200, "what root stored is the server's to give"
    for path, is_own in ((data / "records.sqlite3", True), (withheld, False), (kept, False)):
        read = showing_python([sys.executable, "-c", _READ, str(path)])
        as_server = ["setpriv", f"--reuid={SERVER_USER}", f"--regid={SERVER_USER}"]
        read[-4:-4] = [*as_server, "--clear-groups", "--no-new-privs"]
        done = subprocess.run(read, capture_output=True, text=True, check=False)
        assert (done.returncode == 0) is is_own, f"{path}: {done.stderr}"


def test_nobody_else_on_the_machine_reads_records_or_logs(running: Running) -> None:
    """They hold the secrets of webhooks, notes, and scores that nobody published."""
    running.wait_until(has_started)
    data = running.data
    files = [*data.glob("records.sqlite3*"), *(data / "logs").iterdir()]
    assert len(files) > 1
    assert {path.name for path in files if path.stat().st_mode & 0o077} == set()


def test_started_as_one_user_it_says_what_that_means(running: Running) -> None:
    """The folders of pytest are closed to other users, so that root can give none to the server."""
    running.wait_until(has_started)
    assert (
        "whoever takes over the web process can read withheld regions" in running.said.read_text()
    )
