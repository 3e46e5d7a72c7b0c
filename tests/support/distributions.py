"""The distributions of this repository, built as they are for an index; and bare environments."""

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

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


def bare_environment(folder: Path, python: Path, wheel: Path, *extras: str) -> Path:
    """Make an environment with a wheel, its extras and its locked dependencies; return its `bin`.

    Skips the test where packages can be had neither from uv's cache nor from a registry.
    """
    uv = shutil.which("uv", path=str(Path(sys.executable).parent))
    assert uv is not None
    subprocess.run([uv, "venv", "-q", "--python", python, folder], check=True)
    wanted = f"exceptiondrive[{','.join(extras)}] @ {wheel.as_uri()}"
    lock = ROOT / "requirements/client.txt"
    install: list[str | Path] = [
        uv,
        "pip",
        "install",
        "--python",
        folder / "bin/python",
        "-c",
        lock,
        wanted,
    ]
    for way in ("--offline", "--no-progress"):
        done = subprocess.run([*install, way], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return folder / "bin"
    pytest.skip(f"no packages at hand: {done.stderr.splitlines()[-1]}")
