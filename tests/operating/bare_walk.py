"""Carries out docs/operating-bare.md, block by block as written, in a network of its own; as root.

Only places and the host name are others, the programs are those of this environment, and `systemctl` and
`systemd-sysusers` are tests/operating/units.py. Every step that fails ends it.
"""

import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import httpx
from tests.chaos.clients import planning_file
from tests.chaos.postgres import binaries

from exceptiondrive import Client
from exceptiondrive_worker.sample.files import write_sample_split
from exceptiondrive_worker.splits.store import read_split

ROOT = Path(__file__).parents[2]
SITE = "https://127.0.0.1"
_NOBODY = 65534


class Walk:
    """One server in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.home, self.programs = folder / "srv", folder / "opt"
        self.units, self.state = folder / "units", folder / "state"
        for made in (self.programs, self.units, self.state, folder / "bin"):
            made.mkdir()
        for version in ("1", "2"):
            (self.programs / version).symlink_to(sys.prefix)
        (self.programs / "current").symlink_to("1")
        for name, verb in (("systemctl", ""), ("systemd-sysusers", " make-accounts")):
            program = folder / "bin" / name
            program.write_text(
                f'#!/bin/sh\ncd {ROOT} && exec {sys.executable} -m tests.operating.units{verb} "$@"\n'
            )
            program.chmod(0o755)
        (folder / "bin" / "su").write_text('#!/bin/sh\nexport PGUSER=$1\nexec sh -c "$3"\n')
        (folder / "bin" / "su").chmod(0o755)
        self.environment = {
            **{k: v for k, v in os.environ.items() if not k.startswith("EXCEPTIONDRIVE_")},
            "PATH": f"{folder / 'bin'}:{binaries()}:{os.environ['PATH']}:/usr/sbin",
            "PGHOST": str(folder),
            "WALK_UNITS": str(self.units),
            "WALK_STATE": str(self.state),
        }
        text = (ROOT / "docs/operating-bare.md").read_text("utf-8")
        self.blocks = [
            self._here(block)
            for block in re.findall(r"^ *```sh\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
        ]

    def _here(self, block: str) -> str:
        for written, here in {
            "/srv/exceptiondrive": str(self.home),
            "/opt/exceptiondrive": str(self.programs),
            "/etc/systemd/system/": f"{self.units}/",
            "/etc/sysusers.d/": f"{self.state}/",
            "board.example.org": "127.0.0.1",
            "BACKUP.tar": f"{self.home}/backups/*.tar",
        }.items():
            block = block.replace(written, here)
        return block

    def run(self, script: str) -> str:
        """Run lines of shell; the first that fails ends the walk."""
        sys.stderr.write(f"{script}\n")
        done = subprocess.run(
            ["bash", "-eu", "-c", script],
            env=self.environment,
            stdout=subprocess.PIPE,
            text=True,
            timeout=600,
            check=True,
        )
        return done.stdout

    def block(self, first_words: str) -> str:
        """Run the block of the page that begins so."""
        (found,) = [
            each for each in self.blocks if each.strip().startswith(self._here(first_words))
        ]
        return self.run(found)

    def start_database(self) -> "subprocess.Popen[bytes]":
        """What the distribution has: PostgreSQL that asks for passwords over the network."""
        os.chown(self.folder, _NOBODY, _NOBODY)
        data = self.folder / "pg"
        initdb = [str(binaries() / "initdb"), "-D", str(data), "-U", "postgres", "-N"]
        initdb += ["--auth-local=trust", "--auth-host=scram-sha-256", "--encoding=UTF8"]
        quiet = {"stdout": subprocess.DEVNULL, "user": _NOBODY, "group": _NOBODY}
        subprocess.run([*initdb, "--locale=C"], check=True, **quiet)  # type: ignore[call-overload]
        started: subprocess.Popen[bytes] = subprocess.Popen(
            [str(binaries() / "postgres"), "-D", str(data), "-k", str(self.folder)],
            stderr=(self.state / "postgres.log").open("wb"),
            **quiet,  # type: ignore[call-overload]
        )
        self.until(f"pg_isready -q -h {self.folder}")
        return started

    def until(self, question: str) -> None:
        deadline = time.monotonic() + 300
        command = ["bash", "-c", question]
        while subprocess.run(command, env=self.environment, check=False).returncode != 0:
            if time.monotonic() > deadline:
                sys.exit(f"waited in vain for: {question}")
            time.sleep(0.1)

    def cannot(self, user: int, *words: str) -> None:
        """A user of the services is refused something."""
        command = ["setpriv", f"--reuid={user}", "--regid=10001", "--clear-groups", *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert "Permission denied" in done.stderr, (words, done)

    def organizer(self, token: str, *words: str) -> str:
        command = shlex.join([f"{sys.prefix}/bin/exceptiondrive", "organizer", *words])
        return self.run(f"EXCEPTIONDRIVE_SERVER={SITE} EXCEPTIONDRIVE_TOKEN={token} {command}")


def ranks(token: str) -> list[tuple[str | None, int | None]]:
    """Return what the board shows, through the proxy."""
    with Client(SITE, token) as client:
        entries = client.leaderboard(phase="test").entries
    return [(entry.submission_id, entry.rank) for entry in entries if entry.submission_id]


def submit(walk: Walk, token: str, ids: list[str], speed_mps: float) -> None:
    file = walk.folder / "planner.json"
    file.write_bytes(planning_file(ids, speed_mps))
    with Client(SITE, token) as client:
        view = client.submit(file, phase="test", method=f"at {speed_mps}").wait(timeout_s=300)
    assert view.rank is not None, view


def carry_out(walk: Walk) -> None:
    """Install, use, look at the walls, upgrade, roll back, back up, restore."""
    install = "/opt/exceptiondrive/current/bin/exceptiondrive-server init"
    walk.block(install)
    walk.block("install -D -m 0644 /srv/exceptiondrive/sysusers.conf")
    split = write_sample_split(walk.home / "splits")
    printed = walk.block("chown -R 10002:10001").splitlines()
    (token,) = [line for line in printed if " " not in line]
    os.environ["SSL_CERT_FILE"] = walk.environment["SSL_CERT_FILE"] = f"{walk.home}/secrets/tls.crt"
    walk.until(f"curl -fsk -o /dev/null {SITE}/readyz")
    phase = (
        "test",
        "--split",
        "sample",
        "--title",
        "Test",
        "--protocol",
        "1.0",
        "--quota-per-day",
        "9",
    )
    walk.organizer(token, "phases", "create", *phase)
    assert "exceptiondrive-" in walk.run(f"curl -fsk {SITE}/client/")
    walk.organizer(token, "teams", "create", "alpha", "Alpha")
    team = walk.organizer(token, "teams", "issue-token", "alpha", "--name", "walk").split()[-1]
    ids = [sample.sample_id for sample in read_split(split).samples]
    submit(walk, team, ids, 5.0)
    before = ranks(team)
    assert [rank for _, rank in before] == [1], before
    for words in (("ls", f"{walk.home}/splits"), ("cat", f"{walk.home}/etc/worker.env")):
        walk.cannot(10001, *words)
    walk.cannot(10002, "touch", f"{walk.home}/uploads/new")
    walk.cannot(10002, "cat", f"{walk.home}/etc/server.env")
    walk.cannot(10003, "cat", f"{walk.home}/secrets/database_url")
    publish = next(b for b in walk.blocks if "publish-split NAME" in b)
    walk.run(publish.replace("NAME", "sample --while-open"))
    with Client(SITE, team) as client:
        assert client.split("sample").samples
    assert walk.run(f"find {walk.home}/uploads ! -user 10001") == "", "the server's, as all uploads"
    walk.run("systemctl stop exceptiondrive-server@8001.service")
    assert ranks(team) == before, "the other server answers"
    walk.run("systemctl start exceptiondrive-server@8001.service")
    walk.block("ln -sfn 2")
    submit(walk, team, ids, 6.0)
    walk.run(next(b for b in walk.blocks if "ln -sfn 2" in b).replace("ln -sfn 2", "ln -sfn 1"))
    assert os.readlink(walk.programs / "current") == "1"
    kept = ranks(team)
    walk.run("systemctl start exceptiondrive-backup.service")
    (backup,) = (walk.home / "backups").iterdir()
    assert backup.stat().st_size > 1000
    submit(walk, team, ids, 7.0)
    walk.block("systemctl stop exceptiondrive.target")
    walk.until(f"curl -fsk -o /dev/null {SITE}/readyz")
    assert ranks(team) == kept, "as at the backup"
    submit(walk, team, ids, 8.0)


def main(folder: Path) -> None:
    """Walk, and end every process."""
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    walk = Walk(folder)
    database = walk.start_database()
    try:
        carry_out(walk)
        assert httpx.get("http://127.0.0.1/", timeout=10).status_code == 308
    except BaseException:
        for log in sorted(walk.state.glob("*.log")):
            sys.stderr.write("\n".join([log.name, *log.read_text().splitlines()[-15:], ""]))
        raise
    finally:
        walk.run("systemctl stop exceptiondrive.target")
        database.terminate()
        database.wait(30)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
