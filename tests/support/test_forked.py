"""A forked process is one of its own: its session, environment, log and end."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
from tests.support.forked import Forked


def tell(arguments: Sequence[str]) -> None:
    leads = os.getsid(0) == os.getpgrp() == os.getpid()
    print(leads, sorted(os.environ), *arguments, flush=True)  # noqa: T201
    print("to the same log", file=sys.stderr)  # noqa: T201
    sys.exit(3)


def stay(_: Sequence[str]) -> None:
    time.sleep(600)


def test_it_leads_a_session_and_has_its_own_environment_log_and_code(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("before\n")
    forked = Forked(tell, ["a", "b"], {"ONLY": "this"}, log)
    assert forked.wait(60) == forked.poll() == forked.returncode == 3
    assert log.read_text() == "before\nTrue ['ONLY'] a b\nto the same log\n"


def test_it_dies_alone_of_a_signal_and_is_waited_for_as_popen_waits(tmp_path: Path) -> None:
    killed, other = (Forked(stay, [], {}, tmp_path / "log") for _ in range(2))
    assert killed.pid != other.pid
    with pytest.raises(subprocess.TimeoutExpired):
        killed.wait(0.05)
    os.killpg(killed.pid, signal.SIGKILL)
    assert killed.wait(60) == -signal.SIGKILL
    assert other.poll() is None
    os.killpg(other.pid, signal.SIGKILL)
    other.wait(60)
