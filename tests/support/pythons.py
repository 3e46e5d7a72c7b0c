"""The interpreters of this machine: those of pyenv, and those that PATH names."""

import os
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

Version = tuple[int, int]
HOME = Path(os.environ.get("HOME", "/"))
"""Taken at import: tests give the client a home of its own."""
NAMES = [f"python3.{minor}" for minor in range(6, 20)]


@cache
def pythons() -> dict[Version, Path]:
    """Return one interpreter of each minor version, oldest first.

    Shims of pyenv are passed over: those of what is installed are in its folder.
    """
    of_pyenv = sorted((HOME / ".pyenv/versions").glob("3.*/bin/python"))
    outside = os.pathsep.join(each for each in os.get_exec_path() if not each.endswith("/shims"))
    on_path = [
        Path(path) for name in NAMES if (path := shutil.which(name, path=outside)) is not None
    ]
    found = {version: path for path in [*on_path, *of_pyenv] if (version := version_of(path))}
    return dict(sorted(found.items()))


def version_of(python: Path) -> Version | None:
    """Ask an interpreter for its version; None where it does not run."""
    try:
        done = subprocess.run([python, "-V"], capture_output=True, text=True, check=False)
    except OSError:
        return None
    said = re.match(r"Python (\d+)\.(\d+)\.", done.stdout)
    return (int(said[1]), int(said[2])) if done.returncode == 0 and said else None
