"""Whole processes: start to first score, and memory above idle for the largest legal upload."""

import gc
import gzip
import subprocess
import sys
import tempfile
import time
from dataclasses import fields
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.report import at_most, show
from benchmarks.upload import make_manifest, score, upload_text
from benchmarks.workload import BENCHMARK_SAMPLES, make_workload
from exceptiondrive_schemas.check import MAX_INFLATED_BYTES, MAX_UPLOAD_BYTES
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_scoring.arrays import SplitArrays

ROOT = Path(__file__).parents[1]


def run(protocol: ProtocolDocument) -> None:
    """Print start-up and memory of fresh processes."""
    with tempfile.TemporaryDirectory() as folder:
        usual = _write(Path(folder) / "usual.json", BENCHMARK_SAMPLES, protocol)
        text = usual.read_bytes()
        room = min(MAX_INFLATED_BYTES / len(text), MAX_UPLOAD_BYTES / len(gzip.compress(text)))
        n_largest = int(BENCHMARK_SAMPLES * room * 0.97)
        largest = _write(Path(folder) / "largest.json", n_largest, protocol)
        largest.write_bytes(gzip.compress(largest.read_bytes()))
        call = f"from benchmarks.processes import first_score; first_score({str(usual)!r})"
        starts = {
            "python alone": "pass",
            "import numpy": "import numpy",
            f"start, read and score {BENCHMARK_SAMPLES:,} samples": call,
        }
        took_s = {name: median(_seconds(code) for _ in range(5)) for name, code in starts.items()}
        rows = [(name, f"{seconds:.2f}") for name, seconds in took_s.items()]
        show("Fresh process, wall time", ("", "s"), rows)
        at_most("from a process's start to its first score", max(took_s.values()), 1.5, "s")
        call = f"from benchmarks.processes import memory; memory({str(usual)!r}, {str(largest)!r})"
        megabytes = largest.stat().st_size / 1e6
        output = subprocess.run(
            [sys.executable, "-c", call], cwd=ROOT, check=True, capture_output=True, text=True
        ).stdout.split()
    show(
        f"Largest legal upload: {megabytes:.0f} MB gzip, {n_largest:,} samples",
        ("", "MiB"),
        [
            ("process before it, one usual upload scored, split loaded", output[0]),
            ("added by reading and scoring it", output[1]),
        ],
    )
    at_most("memory for the largest legal upload, above idle", float(output[1]), 400, "MiB")


def _write(path: Path, n_samples: int, protocol: ProtocolDocument) -> Path:
    """Write an upload, and beside it the arrays of its split."""
    workload = make_workload(protocol, n_samples)
    path.write_bytes(upload_text(workload, make_manifest(n_samples, protocol)))
    split = {field.name: getattr(workload.split, field.name) for field in fields(SplitArrays)}
    given = {name: value for name, value in split.items() if value is not None}
    np.savez(path.with_suffix(".npz"), **given)
    return path


def _load_split(path: Path) -> SplitArrays:
    with np.load(path.with_suffix(".npz")) as arrays:
        columns = {name: arrays[name] for name in arrays.files}
    return SplitArrays(**columns | {"n_scenes": int(columns["n_scenes"])})


def first_score(path: str) -> None:
    """Read and score one file of the usual size: the work of a fresh worker."""
    _score(Path(path), packaged_protocol())


def memory(small: str, largest: str) -> None:
    """Print resident memory, MiB: with the largest split loaded, and what scoring adds to it."""
    protocol = packaged_protocol()
    _score(Path(small), protocol)
    split = _load_split(Path(largest))
    manifest = make_manifest(split.n_samples, protocol)
    gc.collect()
    before = peak_mib_so_far()
    score(Path(largest).read_bytes(), manifest, split, protocol)
    print(f"{before:.0f} {peak_mib_so_far() - before:.0f}")


def _score(path: Path, protocol: ProtocolDocument) -> None:
    split = _load_split(path)
    score(path.read_bytes(), make_manifest(split.n_samples, protocol), split, protocol)


def peak_mib_so_far() -> float:
    """Most resident memory since this process began (`ru_maxrss` would count its parent's)."""
    status = Path("/proc/self/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) / 1024


def _seconds(code: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
    return time.perf_counter() - start
