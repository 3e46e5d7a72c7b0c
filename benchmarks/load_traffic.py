"""Who comes in a rush: arrivals, files and uploads of many teams, and readers of page and board."""

import gzip
import json
import random
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import quantiles

import httpx

FLOOD = "flood"
_FLOOD_SHARE = 0.3
_WAYPOINTS = 6
_MOVED = "moved"
_READERS = 8
_LOOKS_EVERY_MS = 200
_LONGEST_RUN_S = 7200
_WRK_SCRIPT = """
function delay() return %d end
function done(summary, latency, requests)
  local e = summary.errors
  io.write(string.format("%%d %%d %%f %%f %%f\\n", summary.requests,
    e.connect + e.read + e.write + e.status + e.timeout,
    latency:percentile(50) / 1e6, latency:percentile(99) / 1e6, latency.max / 1e6))
end
"""


@dataclass
class Reading:
    """What readers of one address saw."""

    n: int = 0
    errors: int = 0
    p50_s: float = 0.0
    p99_s: float = 0.0
    longest_s: float = 0.0


@dataclass
class Uploads:
    """What uploading clients saw."""

    took_s: list[float] = field(default_factory=list)
    refused: dict[int, int] = field(default_factory=dict)
    refusals_without_retry_after: int = 0


def arrivals(n_uploads: int, rush_s: float, n_teams: int) -> list[tuple[float, str]]:
    """Return (second, team): the flood comes at once, all others thicken towards the deadline."""
    rng = random.Random(20261121)
    n_flood = int(n_uploads * _FLOOD_SHARE)
    flood = [(0.05 * number, FLOOD) for number in range(n_flood)]
    others = [
        (rush_s * (1 - rng.random() ** 2), f"team{rng.randrange(n_teams)}")
        for _ in range(n_uploads - n_flood)
    ]
    return sorted(flood + others)


def file_maker(sample_ids: Sequence[str]) -> Callable[[], bytes]:
    """Return what makes gzipped files, each with other bytes: one of ten drives, one point moved."""
    rng = random.Random(7)

    def drive() -> list[list[float]]:
        mps, drift = rng.uniform(1, 12), rng.gauss(0, 0.2)
        return [
            [round(mps * step / 2, 3), round(drift * step + rng.gauss(0, 0.05), 3)]
            for step in range(1, _WAYPOINTS + 1)
        ]

    def document() -> str:
        predictions = [
            {"sample_id": sample_id, "source": drive(), "edited": drive()}
            for sample_id in sample_ids
        ]
        head = {"schema": "exceptiondrive.planning/1", "split": "sample"}
        predictions[0]["source"] = _MOVED
        return json.dumps({**head, "predictions": predictions})

    documents = [document() for _ in range(10)]

    def make() -> bytes:
        text = rng.choice(documents).replace(json.dumps(_MOVED), json.dumps(drive()), 1)
        return gzip.compress(text.encode(), compresslevel=1)

    return make


def upload(url: str, phase: str, token: str, data: bytes, seen: Uploads) -> None:
    """Upload; who is sent away comes again when told to."""
    headers = {"Authorization": f"Bearer {token}"}
    method = f"m{random.randrange(3)}"
    while True:
        began = time.monotonic()
        try:
            answer = httpx.post(
                f"{url}/api/v1/submissions",
                data={"phase": phase, "method": method},
                files={"file": ("f.json.gz", data)},
                headers=headers,
                timeout=60,
            )
        except httpx.HTTPError:
            seen.refused[0] = seen.refused.get(0, 0) + 1
            time.sleep(1)
            continue
        if answer.status_code in (200, 202):
            seen.took_s.append(time.monotonic() - began)
            return
        seen.refused[answer.status_code] = seen.refused.get(answer.status_code, 0) + 1
        wait_s = answer.headers.get("Retry-After")
        seen.refusals_without_retry_after += wait_s is None
        time.sleep(min(5.0, float(wait_s or 1)))


class Readers:
    """Eight readers of one address, each with a pause between looks: wrk, or Python without it."""

    def __init__(self, url: str) -> None:
        self.tool = "wrk" if shutil.which("wrk") else "Python"
        self._url = url
        self._stopped = threading.Event()
        self._took_s: list[float] = []
        self._errors = 0
        self._threads: list[threading.Thread] = []
        self._folder = tempfile.TemporaryDirectory(prefix="ed-wrk-")
        self._wrk = self._start_wrk() if self.tool == "wrk" else None
        if self._wrk is None:
            self._threads = [threading.Thread(target=self._read) for _ in range(_READERS)]
            for thread in self._threads:
                thread.start()

    def stop(self) -> Reading:
        """End all looks; return what was seen."""
        self._stopped.set()
        try:
            return self._of_wrk(self._wrk) if self._wrk is not None else self._of_python()
        finally:
            self._folder.cleanup()

    def _start_wrk(self) -> subprocess.Popen[str]:
        script = Path(self._folder.name) / "pause.lua"
        script.write_text(_WRK_SCRIPT % _LOOKS_EVERY_MS)
        command = ["wrk", "-t1", f"-c{_READERS}", f"-d{_LONGEST_RUN_S}s", "--timeout", "60s"]
        return subprocess.Popen(
            [*command, "--script", str(script), self._url], stdout=subprocess.PIPE, text=True
        )

    @staticmethod
    def _of_wrk(process: subprocess.Popen[str]) -> Reading:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=120)
        n, errors, p50_s, p99_s, longest_s = output.strip().splitlines()[-1].split()
        return Reading(int(n), int(errors), float(p50_s), float(p99_s), float(longest_s))

    def _read(self) -> None:
        with httpx.Client(timeout=60) as http:
            while not self._stopped.wait(_LOOKS_EVERY_MS / 1000):
                began = time.monotonic()
                try:
                    is_well = http.get(self._url).status_code == 200
                except httpx.HTTPError:
                    is_well = False
                self._took_s.append(time.monotonic() - began)
                self._errors += not is_well

    def _of_python(self) -> Reading:
        for thread in self._threads:
            thread.join()
        took_s = sorted(self._took_s)
        if len(took_s) < 2:
            return Reading(len(took_s), self._errors)
        cuts = quantiles(took_s, n=100, method="inclusive")
        return Reading(len(took_s), self._errors, cuts[49], cuts[98], took_s[-1])
