"""How a worker process stands beside the others on its machine."""

import multiprocessing
import os
import subprocess
import sys
from multiprocessing.connection import Connection
from pathlib import Path

import pytest
from structlog.testing import capture_logs
from tests.support.worker import worker_settings

from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker import process as worker_process
from exceptiondrive_worker.process import BACKGROUND_NICENESS, WorkerProcess, give_way

LEAST_PRIORITY = 19
"""Of any process: more than that is not taken away."""


def _say_niceness(lanes: tuple[Lane, ...], answer: Connection) -> None:
    give_way(lanes)
    answer.send(os.nice(0))


@pytest.mark.parametrize(
    ("lanes", "expected"),
    [
        ((Lane.RESCORE,), BACKGROUND_NICENESS),
        ((Lane.LIVE,), 0),
        ((Lane.LIVE, Lane.RESCORE), 0),
    ],
)
def test_a_worker_of_the_background_alone_gives_way(lanes: tuple[Lane, ...], expected: int) -> None:
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_say_niceness, args=(lanes, there))
    process.start()
    process.join(30)
    assert here.poll(), "the process said nothing"
    assert here.recv() == min(os.nice(0) + expected, LEAST_PRIORITY)


def test_a_process_whose_folder_was_away_begins_when_it_is_back(
    tmp_path: Path, sqlite_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until then it gives no sign of life, and the log says what it waits for."""
    monkeypatch.setattr(worker_process, "limit_memory", lambda _: None)
    settings = worker_settings(tmp_path, sqlite_url)
    settings.private_dir.parent.mkdir(parents=True, exist_ok=True)
    settings.private_dir.touch()  # no folder can be made here
    process = WorkerProcess(settings, (Lane.LIVE,))
    with capture_logs() as lines:
        process.begin()
        with pytest.raises(RuntimeError, match="has not begun"):
            process.context()
    assert [line["log_level"] for line in lines] == ["error", "error"]
    assert "EXCEPTIONDRIVE_PRIVATE_DIR" in lines[0]["event"]
    settings.private_dir.unlink()
    try:
        assert process.context().private.root == settings.private_dir
    finally:
        process.end()


def test_nothing_ends_of_a_log_line_that_a_full_disk_does_not_take(tmp_path: Path) -> None:
    """The thread of the heartbeat ended so, and the worker counted as dead from then on."""
    code = (
        "import sys, structlog\nfrom pathlib import Path\n"
        "from exceptiondrive_records.operations.logs import set_up_logs\nset_up_logs(sys.stderr)\n"
        "for _ in range(100):\n    structlog.get_logger().warning('x' * 1000)\n"
        "Path(sys.argv[1]).touch()\n"
    )
    with Path("/dev/full").open("w") as full:
        subprocess.run(
            [sys.executable, "-c", code, tmp_path / "alive"], stdout=full, stderr=full, check=False
        )
    assert (tmp_path / "alive").exists()
