"""Run the tests on every other Python of this machine, and say which there were none of.

`make pythons` runs it. From 3.11 everything is installed, from the hashed lock; on 3.10, the client's
oldest, its own distribution alone, and what needs the server is skipped. `make pythons ENDS=1`, as in
`.ci/run`, takes a minute: the client alone, on the oldest and the newest, with what finds most.
"""

import subprocess
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from tests.support.pythons import Version, pythons

ROOT = Path(__file__).parents[1]
SUPPORTED: list[Version] = [(3, minor) for minor in range(10, 15)]
SERVERS_OLDEST: Version = (3, 11)
OF_CLIENT = ["tests/schemas", "tests/scoring", "tests/client", "tests/agent"]
OF_ALL = [*OF_CLIENT, "tests/worker", "tests/end_to_end/test_main_job.py"]
AT_THE_ENDS = [
    f"tests/client/test_{name}.py"
    for name in (
        *("cli", "client", "conversion", "conversion_files", "dataframes", "evaluation", "inputs"),
        *("planner_runs", "settings"),
    )
]
TEST_TOOLS = [
    "pytest",
    "pytest-asyncio",
    "pytest-timeout",
    "pytest-xdist",
    "hypothesis",
    "jsonschema",
    "shapely",
]


def main(arguments: list[str]) -> int:
    """Run the chosen tests, or the usual ones, and return the exit code."""
    chosen = [each for each in arguments if each != "--ends"]
    found = sorted(version for version in SUPPORTED if version in pythons())
    ends = {*found[:1], *found[-1:]} if "--ends" in arguments else None
    said: dict[Version, str] = {}
    for version in SUPPORTED:
        own = version == sys.version_info[:2]
        if not own and version not in pythons():
            said[version] = "NOT TESTED: absent; pyenv, uv or the system's packages install it"
        elif ends is not None:
            said[version] = (
                run_on(version, chosen or AT_THE_ENDS, is_whole=False)
                if version in ends
                else "between: tested by `make pythons`"
            )
        elif own:
            said[version] = "is that of `make test`"
        else:
            is_whole = version >= SERVERS_OLDEST
            said[version] = run_on(
                version, chosen or (OF_ALL if is_whole else OF_CLIENT), is_whole=is_whole
            )
    for (major, minor), words in said.items():
        sys.stdout.write(f"Python {major}.{minor}: {words}\n")
    return 1 if any(words.startswith("FAILED") for words in said.values()) else 0


def run_on(version: Version, tests: list[str], *, is_whole: bool) -> str:
    """Install on an interpreter, run the tests there, and say how it went.

    Args:
        version: Which.
        tests: Files and folders.
        is_whole: Whether server and worker are installed, too; else the client's tests are alone.
    """
    folder = ROOT / f".venv-{version[0]}.{version[1]}{'' if is_whole else '-client'}"
    python = folder / "bin/python"
    uv = str(Path(sys.executable).parent / "uv")
    if not python.exists():
        subprocess.run([uv, "venv", "-q", "--python", pythons()[version], folder], check=True)
    install: list[str | Path] = [uv, "pip", "install", "-q", "--python", python]
    if is_whole:
        lock = [*install, "--require-hashes", "-r", "requirements/dev.txt"]
        subprocess.run(lock, cwd=ROOT, check=True)
        ours: list[str] = ["-e", ".", "-e", "server", "-e", "worker"]
        subprocess.run([*install, "--no-deps", "--no-build-isolation", *ours], cwd=ROOT, check=True)
    else:
        lock = [*install, "-r", "requirements/client.txt", "hatchling", *TEST_TOOLS]
        subprocess.run(lock, cwd=ROOT, check=True)
        ours = ["--no-deps", "--no-build-isolation", "--reinstall-package", "exceptiondrive", "."]
        subprocess.run([*install, *ours], cwd=ROOT, check=True)
    groups = [tests] if is_whole else list(_by_folder(tests))
    last_lines = []
    for group in groups:
        command: list[str | Path] = [
            python,
            "-m",
            "pytest",
            "-q",
            "-n",
            "2",
            "-p",
            "no:cacheprovider",
            *group,
        ]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        last_lines.append(done.stdout.strip().splitlines()[-1])
        if done.returncode != 0:
            sys.stdout.write(done.stdout + done.stderr)
            return f"FAILED {' '.join(group)}: {last_lines[-1]}"
    return "; ".join(last_lines)


def _by_folder(tests: list[str]) -> Iterator[list[str]]:
    """Yield what pytest is asked for each folder: `tests/conftest.py` needs the server."""
    for folder, chosen in groupby(tests, lambda path: "/".join(path.split("/")[:2])):
        yield ["--confcutdir", folder, *chosen]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
