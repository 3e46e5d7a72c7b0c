"""One upload, bytes to sheet: parse and validate, measure, grade; against bare JSON decoding."""

import gzip
import json

import orjson

from benchmarks.report import at_most, ms, show, times
from benchmarks.timing import interleave, peak_mib, ratio, typical
from benchmarks.workload import Workload, make_workload
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import grade
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.sheet import aggregate
from exceptiondrive_worker.upload_reader import read_upload


def run(protocol: ProtocolDocument) -> None:
    """Print the upload table."""
    workload = make_workload(protocol)
    manifest = make_manifest(workload.split.n_samples, protocol)
    text = upload_text(workload, manifest)
    packed = gzip.compress(text, 6)
    columns = _read(text, manifest, protocol)
    jobs = {
        "orjson.loads alone": lambda: orjson.loads(text),
        "json.loads alone": lambda: json.loads(text),
        "parse + validate": lambda: _read(text, manifest, protocol),
        "measure": lambda: measure(
            TrajectoryPairs.from_columns(columns),
            workload.split.prepared_regions,
            protocol.geometry,
        ),
        "parse + validate + measure + grade": lambda: score(
            text, manifest, workload.split, protocol
        ),
        "the same, gzip": lambda: score(packed, manifest, workload.split, protocol),
        "precise checker alone (faulty files)": lambda: _check(text, manifest, protocol),
    }
    found = interleave(jobs, rounds=9)
    bare = found["orjson.loads alone"]
    rows = [
        (name, ms(typical(found[name])), times(ratio(found[name], bare)), f"{peak_mib(job):.1f}")
        for name, job in jobs.items()
    ]
    show(
        f"One upload, N = {workload.split.n_samples:,}: {len(text) / 1e3:,.0f} kB of JSON, "
        f"{len(packed) / 1e3:,.0f} kB gzip",
        ("", "ms", "x orjson.loads", "peak MiB"),
        rows,
    )
    whole = ratio(found["parse + validate + measure + grade"], bare)
    at_most("parse, validate, measure and grade", whole, 3, "x orjson.loads")


def make_manifest(n_samples: int, protocol: ProtocolDocument) -> Manifest:
    """Return a manifest with ids as long as those of nuScenes, in canonical order."""
    return Manifest(
        schema_="exceptiondrive.manifest/1",
        name="bench",
        title="Benchmark",
        revision="sha256:0",
        waypoints=protocol.geometry.waypoints,
        time_step_s=protocol.geometry.time_step_s,
        sample_ids=tuple(f"{index:032x}" for index in range(n_samples)),
    )


def upload_text(workload: Workload, manifest: Manifest) -> bytes:
    """Return the submission file of a workload."""
    source, edited = workload.pairs.source.tolist(), workload.pairs.edited.tolist()
    predictions = [
        {"sample_id": sample_id, "source": s, "edited": e}
        for sample_id, s, e in zip(manifest.sample_ids, source, edited, strict=True)
    ]
    return orjson.dumps(
        {"schema": PLANNING.file_schema, "split": manifest.name, "predictions": predictions}
    )


def score(data: bytes, manifest: Manifest, split: SplitArrays, protocol: ProtocolDocument) -> None:
    """Go the whole way from bytes to the breakdown."""
    pairs = TrajectoryPairs.from_columns(_read(data, manifest, protocol))
    measured = measure(pairs, split.prepared_regions, protocol.geometry)
    aggregate(grade(measured, split, protocol), split, protocol.taxonomy)


def _read(data: bytes, manifest: Manifest, protocol: ProtocolDocument) -> Columns:
    columns = read_upload(data, challenge=PLANNING, manifest=manifest, protocol=protocol)
    if isinstance(columns, CheckReport):
        raise SystemExit(f"the benchmark's own file is not valid: {columns}")
    return columns


def _check(data: bytes, manifest: Manifest, protocol: ProtocolDocument) -> None:
    check(data, protocol=protocol, manifest=manifest, challenge=PLANNING.id)
