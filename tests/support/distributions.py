"""The distributions of this repository, built as they are for an index; and bare environments."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
DISTRIBUTIONS = {"client": ROOT, "server": ROOT / "server", "worker": ROOT / "worker"}


def build(name: str, folder: Path, *targets: str) -> list[Path]:
    """Build wheel and source archive, or the targets named, without a network."""
    before = set(folder.iterdir())
    options = [part for target in targets for part in ("-t", target)]
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder), *options]
    done = subprocess.run(
        command, cwd=DISTRIBUTIONS[name], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return sorted(set(folder.iterdir()) - before)


def names_in(archive: Path) -> list[str]:
    """Return the names of the files in a wheel or source archive."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            return wheel.namelist()
    with tarfile.open(archive) as sdist:
        return sdist.getnames()
