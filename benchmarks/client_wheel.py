"""What the client costs to have: `python -m benchmarks.client_wheel` prints a table.

Its wheel goes into an empty environment of the oldest and the newest Python of this machine, alone
and with `evaluate`; every command says its help there, each in a process of its own. Packages come
from the cache of uv where it has them: the seconds are those of installing, not of a network.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.support.distributions import bare_environment, build
from tests.support.pythons import Version, pythons

OLDEST: Version = (3, 10)
EXTRAS: tuple[tuple[str, ...], ...] = ((), ("evaluate",))
COMMANDS = """
from typer.main import get_command
from exceptiondrive.cli import app
def walk(command, names):
    print(*names)
    for name in command.list_commands(None) if hasattr(command, "list_commands") else ():
        walk(command.get_command(None, name), [*names, name])
walk(get_command(app), [])
"""
HEAD = ("Python", "extra", "wheel kB", "packages", "MB", "install s", "helps", "failed", "help s")


def main() -> int:
    """Measure on both ends, print the table, and return 1 where a help fails."""
    supported = [version for version in pythons() if version >= OLDEST]
    failed = 0
    print(*(f"{word:>9}" for word in HEAD))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (wheel,) = build("client", folder, "wheel")
        for version in sorted({*supported[:1], *supported[-1:]}):
            for extras in EXTRAS:
                row = _measured(folder / f"{version[1]}{''.join(extras)}", version, wheel, extras)
                print(*(f"{each:>9}" for each in row))
                failed += int(row[HEAD.index("failed")])
    return 1 if failed else 0


def _measured(folder: Path, version: Version, wheel: Path, extras: tuple[str, ...]) -> list[str]:
    began_s = time.monotonic()
    bin_ = bare_environment(folder, pythons()[version], wheel, *extras)
    install_s = time.monotonic() - began_s
    packages = list(folder.glob("lib/python*/site-packages/*.dist-info"))
    n_bytes = sum(each.stat().st_size for each in folder.rglob("*") if each.is_file())
    listed = subprocess.run(
        [bin_ / "python", "-c", COMMANDS], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    began_s = time.monotonic()
    codes = [
        subprocess.run(
            [bin_ / "exceptiondrive", *line.split(), "--help"], check=False, capture_output=True
        )
        for line in listed
    ]
    help_s = (time.monotonic() - began_s) / len(listed)
    n_failed = sum(done.returncode != 0 or b"Usage:" not in done.stdout for done in codes)
    return [
        f"3.{version[1]}",
        ",".join(extras) or "-",
        f"{wheel.stat().st_size / 1000:.0f}",
        f"{len(packages)}",
        f"{n_bytes / 1e6:.1f}",
        f"{install_s:.1f}",
        f"{len(listed)}",
        f"{n_failed}",
        f"{help_s:.2f}",
    ]


if __name__ == "__main__":
    sys.exit(main())
