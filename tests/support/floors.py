"""Floors of the withheld splits of tests: as open as those of the sample, but for what a test says."""

import re
import threading
from pathlib import Path
from typing import Any

import pytest

from exceptiondrive_worker.sample.files import OPEN_FLOORS
from exceptiondrive_worker.splits import floors_held


def write_floors(folder: Path, text: str = "") -> None:
    """Write the floors of the split in this folder; `text` goes before what is open."""
    said = set(re.findall(r"(?m)^(\w+) = ", text))
    rest = [line for line in OPEN_FLOORS.splitlines() if line.split(" = ")[0] not in said]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "floors.toml").write_text("\n".join([*rest, text]))


def leave_open(folder: Path) -> None:
    """Write open floors, unless a test has said others."""
    if not (folder / "floors.toml").exists():
        write_floors(folder)


def let_begin_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let two threads go on when the floors have let both begin."""
    together, hold, looked = threading.Barrier(2), floors_held._hold, threading.local()

    def hold_and_wait(*args: Any) -> None:
        hold(*args)
        if not hasattr(looked, "once"):
            looked.once = True
            together.wait(60)

    monkeypatch.setattr(floors_held, "_hold", hold_and_wait)
