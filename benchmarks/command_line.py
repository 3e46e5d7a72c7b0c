"""The client's commands as whole processes: what a participant waits for, beside the naive loop.

They run as participants have them: from the client's wheel, in an environment that holds nothing else.
`submit` speaks to a real server and its workers, whose time is not counted.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.support.distributions import bare_environment, build

from benchmarks.measuring import NAIVE_SAMPLES
from benchmarks.naive import naive_clearances_m
from benchmarks.report import at_least, at_most, note, show, times
from benchmarks.timing import cpu_seconds, ratio, typical
from benchmarks.upload import make_manifest, upload_text
from benchmarks.upload_to_rank import planning_text, running_bench
from benchmarks.workload import BENCHMARK_SAMPLES, Workload, make_workload
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.clearance import touches_start

ROUNDS = 5
LARGE = 20_000
TARGETS_S = {"--help": 0.15, f"{BENCHMARK_SAMPLES:,}": 0.35, f"{LARGE:,}": 0.8}
TWO_SIZES = ("check", "evaluate")
CLEAR_OF_START_M = 6.0
TIMES_NAIVE = {f"{BENCHMARK_SAMPLES:,}": 1.85, f"{LARGE:,}": 8}
"""So many times faster than the naive loop: of the smaller size, what 0.35 s were where the seconds were asked."""


def run(protocol: ProtocolDocument) -> None:
    """Print the CPU seconds of each command, from the start of the process to its end."""
    with tempfile.TemporaryDirectory() as name:
        client = _installed(Path(name))
        calls: dict[tuple[str, str], list[str]] = {("--help", ""): ["--help"]}
        workloads: dict[str, Workload] = {}
        for n_samples in (BENCHMARK_SAMPLES, LARGE):
            size, folder = f"{n_samples:,}", Path(name) / str(n_samples)
            workloads[size] = scorable_workload(protocol, n_samples)
            files = _write(folder, workloads[size], protocol)
            for command in TWO_SIZES:
                calls[command, size] = [command, *files]
        seconds: dict[tuple[str, str], list[float]] = {call: [] for call in calls}
        naive: dict[str, list[float]] = {size: [] for size in workloads}
        for _ in range(ROUNDS):
            for size, workload in workloads.items():
                naive[size].append(_naive_s(workload, protocol))
            for call, words in calls.items():
                seconds[call].append(_process_s([client, *words]))
        faster = {
            (command, size): ratio(naive[size], taken)
            for (command, size), taken in seconds.items()
            if size
        }
        for size, workload in workloads.items():
            taken, loops = _submissions_s(client, workload, protocol)
            seconds["submit", size], faster["submit", size] = taken, ratio(loops, taken)
    rows = [
        (command, size, f"{typical(taken):.2f}", times(faster[command, size]) if size else "")
        for (command, size), taken in seconds.items()
    ]
    show("Commands, whole processes", ("", "pairs", "CPU s", "x naive"), rows)
    for (command, size), taken in seconds.items():
        what = f"{command}, {size} pairs" if size else command
        at_most(what, typical(taken), TARGETS_S[size or command], "s of CPU")
        if size:
            at_least(what, faster[command, size], TIMES_NAIVE[size], "x the naive loop")
    note(f"x naive: the shapely loop of clearances alone, {NAIVE_SAMPLES} samples of it scaled")


def scorable_workload(protocol: ProtocolDocument, n_samples: int) -> Workload:
    """Make the seeded workload, with no region at the car's start: a split may hold none of those."""
    workload = make_workload(protocol, n_samples)
    regions_m = workload.split.regions_m.copy()
    regions_m[touches_start(workload.split.prepared_regions, protocol.geometry)] += [
        CLEAR_OF_START_M,
        0.0,
    ]
    return replace(workload, split=replace(workload.split, regions_m=regions_m))


def _installed(folder: Path) -> str:
    """Install the client's wheel with `evaluate`, and let every module be compiled; return its command."""
    (wheel,) = build("client", folder, "wheel")
    bin_ = bare_environment(folder / "client", Path(sys.executable), wheel, "evaluate")
    subprocess.run([bin_ / "python", "-m", "compileall", "-q", bin_.parent / "lib"], check=True)
    return str(bin_ / "exceptiondrive")


def _write(folder: Path, workload: Workload, protocol: ProtocolDocument) -> list[str]:
    """Write a submission and its split; return them as arguments."""
    folder.mkdir()
    manifest = make_manifest(workload.split.n_samples, protocol)
    file, split = folder / "planner.json", folder / "split.json"
    file.write_bytes(upload_text(workload, manifest))
    split.write_text(json.dumps(split_document(workload, manifest, protocol)))
    return [str(file), "--split", str(split)]


def split_document(
    workload: Workload, manifest: Manifest, protocol: ProtocolDocument
) -> dict[str, object]:
    """Return the split file of a workload."""
    columns = (
        manifest.sample_ids,
        workload.split.scene_index.tolist(),
        workload.split.task_index.tolist(),
        workload.split.regions_m.tolist(),
    )
    samples = [
        {
            "sample_id": sample_id,
            "scene_id": f"scene-{scene:05}",
            "task": protocol.tasks[task].id,
            "region": region,
        }
        for sample_id, scene, task, region in zip(*columns, strict=True)
    ]
    name, title = manifest.name, manifest.title
    return {"schema": "exceptiondrive.split/1", "name": name, "title": title, "samples": samples}


def _submissions_s(
    client: str, workload: Workload, protocol: ProtocolDocument
) -> tuple[list[float], list[float]]:
    """CPU seconds of the client alone, from the check to score and rank, file by file; of the loop in turns."""
    n_samples = workload.split.n_samples
    with tempfile.TemporaryDirectory(prefix="ed-bench-") as name:
        file = Path(name) / "planner.json"
        with running_bench(Path(name), n_samples) as (system, token):
            environment = {
                "EXCEPTIONDRIVE_SERVER": system.url,
                "EXCEPTIONDRIVE_TOKEN": token,
            }
            seconds, naive = [], []
            for number in range(ROUNDS):
                naive.append(_naive_s(workload, protocol))
                file.write_bytes(planning_text(number, n_samples))
                method = ["--method", f"Planner {number}", "--phase", "bench", "--wait"]
                seconds.append(_process_s([client, "submit", str(file), *method], environment))
    return seconds, naive


def _naive_s(workload: Workload, protocol: ProtocolDocument) -> float:
    part, split = slice(0, NAIVE_SAMPLES), workload.split
    edited = np.nan_to_num(workload.pairs.edited[part])
    regions_m = split.regions_m[part]
    taken = cpu_seconds(lambda: naive_clearances_m(edited, regions_m, protocol.geometry))
    return taken * split.n_samples / NAIVE_SAMPLES


def _process_s(command: list[str], environment: Mapping[str, str] = {}) -> float:
    """CPU seconds of one process, its system calls included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    whole = {**os.environ, "PYTHONDONTWRITEBYTECODE": "", **environment}  # compiled once
    subprocess.run(command, env=whole, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
