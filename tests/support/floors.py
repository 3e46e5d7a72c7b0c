"""Floors of the withheld splits of tests: as open as those of the sample, but for what a test says."""

import re
from pathlib import Path

from exceptiondrive_worker.sample.files import OPEN_FLOORS


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
