"""A whole split is built: 850 scenes x 21 tasks through every stage, in one go and killed ten times.

`python -m benchmarks.workshop` makes the scenes, starts the stand-in for the models, and prints wall
time, memory and sizes of each stage. A second workshop goes the same way and is killed ten times by
SIGKILL; what both freeze has to be the same, byte for byte.
"""

import argparse
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
from rich.console import Console
from rich.table import Table
from tests.support.processes import free_port
from tests.support.stand_in import share_of

from exceptiondrive_build.candidates import walk
from exceptiondrive_build.inspection import to_inspect
from exceptiondrive_build.records import Author, Kind, Record
from exceptiondrive_build.scenes.generated import make_scenes
from exceptiondrive_build.scenes.read_in import read_in
from exceptiondrive_build.values import Inspected, Localized, Verified
from exceptiondrive_build.workshop import Workshop, new_workshop

KEY = "ab" * 32
KILLS = {"screen": 5, "edit": 3, "review": 2}
COMMAND = [sys.executable, "-c", "from exceptiondrive_build.cli import main; main()"]
CHECKED = ("location", "views", "calibration", "task")
console = Console()


@dataclass(frozen=True)
class Measured:
    """One command: how long, and its largest resident memory."""

    name: str
    wall_s: float
    peak_mib: float
    kills: int = 0


def main() -> None:
    """Run both ways and print what they took."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=850)
    parser.add_argument("--width", type=int, default=160, help="of the pictures, pixels")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="ed-workshop-") as name:
        base = Path(name)
        began = time.monotonic()
        make_scenes(
            base / "scenes", n_scenes=arguments.scenes, n_samples=7, width_px=arguments.width
        )
        console.print(f"scenes made in {time.monotonic() - began:.0f} s")
        one_go, killed = base / "one-go", base / "killed"
        for shop in (one_go, killed):
            new_workshop(shop, "bench-2027", KEY)
            with Workshop(shop) as workshop:
                read_in(workshop, base / "scenes")
        with _stand_in(one_go) as base_url:
            for shop in (one_go, killed):
                _point_at(shop, base_url)
            _show("in one go", one_go, _all_stages(one_go, kills=False))
            _show("killed ten times", killed, _all_stages(killed, kills=True))
        _compare(one_go, killed)


def _all_stages(shop: Path, *, kills: bool) -> list[Measured]:
    found = []
    for stage, count in KILLS.items():
        found.append(_stage(shop, stage, count if kills else 0))
    found.append(_command("localize", shop, "localize", "--by-hand"))
    began = time.monotonic()
    _people_decide(shop)
    found.append(Measured("people", time.monotonic() - began, 0.0))
    found.append(_command("freeze", shop, "freeze", str(shop / "frozen")))
    return found


def _stage(shop: Path, stage: str, kills: int) -> Measured:
    with Workshop(shop) as workshop:
        candidates = walk(workshop).values()
    n_calls = len(candidates) if stage == "screen" else sum(c.is_suitable for c in candidates)
    wall_s, peak_mib = 0.0, 0.0
    for number in range(1, kills + 1):
        process = _start(shop, "run", stage)
        began = time.monotonic()
        while _n_lines(shop, stage) < n_calls * number / (kills + 1):
            time.sleep(0.05)
        peak_mib = max(peak_mib, _peak_mib(process))
        process.send_signal(signal.SIGKILL)
        process.wait()
        wall_s += time.monotonic() - began
    last = _command(stage, shop, "run", stage)
    return Measured(stage, wall_s + last.wall_s, max(peak_mib, last.peak_mib), kills)


def _command(name: str, shop: Path, *arguments: str) -> Measured:
    process, began = _start(shop, *arguments), time.monotonic()
    peak_mib = 0.0
    while process.poll() is None:
        peak_mib = max(peak_mib, _peak_mib(process))
        time.sleep(0.05)
    if process.returncode:
        raise SystemExit(f"{name} ended with {process.returncode}")
    return Measured(name, time.monotonic() - began, peak_mib)


def _peak_mib(process: subprocess.Popen[bytes]) -> float:
    """Largest resident memory since the process began its program; 0 once it has ended."""
    try:
        status = Path(f"/proc/{process.pid}/status").read_text("utf-8")
    except OSError:
        return 0.0
    found = re.search(r"VmHWM:\s+(\d+) kB", status)
    return int(found[1]) / 1024 if found else 0.0


def _start(shop: Path, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([*COMMAND, *arguments, "-w", str(shop)], stdout=subprocess.DEVNULL)


def _n_lines(shop: Path, stage: str) -> int:
    path = shop / "answers" / f"{stage}.jsonl"
    return path.read_bytes().count(b"\n") - 1 if path.is_file() else 0


def _people_decide(shop: Path) -> None:
    """The words of two people about every region, and of one about every picture to inspect."""
    with Workshop(shop) as workshop:
        candidates = walk(workshop)
        workshop.records.append(
            *(
                Record(
                    kind=Kind.INSPECT,
                    candidate=sample_id,
                    by=Author(person="ada"),
                    inputs=candidates[sample_id].pictures,
                    value=Inspected(
                        passed=share_of(b"audit", sample_id.encode()) < 0.97
                    ).model_dump(mode="json"),
                )
                for sample_id in to_inspect(candidates, workshop.settings.inspect)
            )
        )
        workshop.records.append(
            *(
                Record(
                    kind=Kind.VERIFY,
                    candidate=candidate.sample_id,
                    by=Author(person=person),
                    inputs=candidate.pictures,
                    value=_verified(candidate.localized, aside_m).model_dump(mode="json"),
                )
                for candidate in walk(workshop).values()
                if candidate.is_accepted and candidate.localized is not None
                for person, aside_m in (("ada", 0.0), ("grace", 0.02))
            )
        )


def _verified(proposal: Localized, aside_m: float) -> Verified:
    corners = tuple((x, y + aside_m) for x, y in proposal.corners)
    return Verified.model_validate(
        {"accepted": True, "corners": corners, "checked": CHECKED}, strict=False
    )


def _show(title: str, shop: Path, measured: list[Measured]) -> None:
    table = Table("stage", "wall s", "peak MiB", "kills", title=title)
    for row in measured:
        table.add_row(row.name, f"{row.wall_s:.1f}", f"{row.peak_mib:.0f}", str(row.kills or ""))
    console.print(table)
    with Workshop(shop) as workshop:
        began = time.monotonic()
        candidates = walk(workshop).values()
        walked_s = time.monotonic() - began
    suitable = sum(candidate.is_suitable for candidate in candidates)
    accepted = sum(candidate.is_accepted for candidate in candidates)
    console.print(f"{len(candidates):,} candidates, {suitable:,} suitable, {accepted:,} accepted")
    console.print(f"all of them read from the records in {walked_s:.1f} s")
    for name in ("records.sqlite3", "answers", "images", "frozen"):
        console.print(f"{name}: {_mib(shop / name):.1f} MiB")


def _mib(path: Path) -> float:
    paths = [path, *path.rglob("*")] if path.is_dir() else [path]
    return sum(each.stat().st_size for each in paths if each.is_file()) / 2**20


def _compare(one: Path, other: Path) -> None:
    """The split of both ways has the same bytes, and no question has two answers of use.

    The time of decisions is in provenance and nowhere else.
    """
    for name in ("split.json.gz", "manifest.json", "datasheet.json", "croissant.json"):
        same = (one / "frozen" / name).read_bytes() == (other / "frozen" / name).read_bytes()
        console.print(f"{name}: {'the same bytes' if same else 'DIFFERS'}")
        if not same:
            raise SystemExit(1)
    for stage in KILLS:
        twice = _n_lines(other, stage) - _n_lines(one, stage)
        console.print(f"{stage}: {twice} answers more in the journal of the killed runs")


@contextmanager
def _stand_in(shop: Path) -> Iterator[str]:
    port = free_port()
    command = [sys.executable, "-m", "tests.support.stand_in", str(shop), "--port", str(port)]
    process = subprocess.Popen([*command, "--suitable", "0.1931", "--low", "0.03"])
    try:
        while True:
            try:
                httpx.get(f"http://127.0.0.1:{port}/", timeout=1, trust_env=False)
                break
            except httpx.TransportError:
                time.sleep(0.2)
        yield f"http://127.0.0.1:{port}/v1"
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=30)


def _point_at(shop: Path, base_url: str) -> None:
    path = shop / "workshop.toml"
    text = path.read_text("utf-8")
    for port in (8000, 8001):
        text = text.replace(f"http://127.0.0.1:{port}/v1", base_url)
    path.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
