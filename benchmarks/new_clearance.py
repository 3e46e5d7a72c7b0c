"""A new required clearance over a thousand submissions: `python -m benchmarks.new_clearance [N]`.

Records, private store and two workers are real; each worker is a process of both lanes, and the
reconciler makes its passes here. What was uploaded is made up, of the benchmark's size, and scored
before the clock runs. Printed: seconds on the wall from the start of the run to a complete preview,
and which step of the workers' took what share of their processor time.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy.orm import Session
from tests.support.work import let_time_pass
from tests.support.worker import build_board_of, worker_settings

from benchmarks.processes import ROOT
from benchmarks.report import note, show
from benchmarks.rescore_drill.drill import protocol_of
from benchmarks.workload import BENCHMARK_SAMPLES, SEED, Workload, make_workload
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.reconciler import reconcile_once
from exceptiondrive_records.operations.setup import prepare
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.rescoring.changes import create_run, start_run
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.views import preview_of, run_view
from exceptiondrive_records.submissions.tables import ScoreSheetRow, SimilarityRow, Submission
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.api.rescoring import RunState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Split, SplitSample
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_worker import scoring_run, stages, work
from exceptiondrive_worker.boards import run as board_run
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.process import keep_memory
from exceptiondrive_worker.sample.files import OPEN_FLOORS
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.splits.admin import register_all_splits
from exceptiondrive_worker.splits.floors import FLOORS_FILE
from exceptiondrive_worker.stages import Scored, Stages, Target

N_SUBMISSIONS = 1_000
N_TEAMS = 97
N_WORKERS = 2
AHEAD_M = 6.0
PASS_EVERY_S = 1.0
LOOK_AGAIN_S = 0.02
ENDED = "ended"
WHO = {"reason": "benchmark", "actor": "bench"}
STEPS: tuple[tuple[Any, str, str], ...] = (
    (work, "may_work", "records: look for work"),
    (work, "let_live_work_pass", "records: look for work"),
    (work, "build_next_board", "board: read entries, the rest"),
    (work, "score_next", "records: claim, floors, finish"),
    (stages, "graded_sheet", "regrade: grade, aggregate, sheet"),
    (Stages, "score", "regrade: keys, private store, digest"),
    (Rounding, "sheet", "regrade: round"),
    (scoring_run, "finish_scored", "records: claim, floors, finish"),
    (Stages, "scene_sums", "board: sums by scene"),
    (board_run, "_scored", "board: intervals"),
    (board_run, "board_entries", "board: ranks, rows"),
    (board_run, "comparisons", "board: compared top"),
    (board_run, "publish_board", "board: publish"),
    (board_run, "draw_entries", "board: drawing, likeness"),
    (board_run, "compare_submissions", "board: drawing, likeness"),
)
"""Where a function is looked up, its name, and which step it is; what it calls is counted apart."""


def main() -> None:
    """Print what a new required clearance costs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.new_clearance", description=__doc__)
    parser.add_argument("submissions", nargs="?", type=int, default=N_SUBMISSIONS)
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        _work(given.worker)
        return
    with tempfile.TemporaryDirectory(prefix="ed-clearance-") as folder:
        _measure(Path(folder), given.submissions)


def run(_: ProtocolDocument) -> None:
    """Print what a new required clearance costs over a thousand submissions."""
    with tempfile.TemporaryDirectory(prefix="ed-clearance-") as folder:
        _measure(Path(folder), N_SUBMISSIONS)


def settings_in(folder: Path) -> WorkerSettings:
    """Return settings of a worker whose every place is in a folder, its records too."""
    return worker_settings(folder, f"sqlite:///{folder}/records.sqlite3")


def _measure(folder: Path, n_submissions: int) -> None:
    context = _prepared(folder, n_submissions)
    workers = [_start_worker(folder, number) for number in range(N_WORKERS)]
    try:
        wall_s, n_changed = _carry(context, n_submissions)
        (folder / ENDED).touch()
        _show(n_submissions, wall_s, [_ended(worker, folder) for worker in workers])
    finally:
        for worker in workers:
            worker.kill()
    note(f"entries with new numbers: {n_changed}")


def _carry(context: WorkerContext, n_submissions: int) -> tuple[dict[str, float], int]:
    """Carry a run from start to preview; seconds until each step, and entries with new numbers."""
    database = context.database
    toml, protocol = protocol_of("d_safe")
    with database.write() as session:
        add_protocol(session, toml, "bench")
        run_id = create_run(session, "bench", protocol=protocol.version, **WHO).id
    _wait(context, lambda: not _has_open_trial(database, run_id))
    with database.write() as session:
        start_run(session, run_id, **WHO)
    began_s, wall_s = time.monotonic(), {}
    _wait(context, lambda: _n_sheets(database, protocol) == n_submissions)
    wall_s["all scored"] = time.monotonic() - began_s
    _wait(context, lambda: _state(database, run_id) == RunState.READY)
    wall_s["board built, run ready"] = time.monotonic() - began_s
    with database.read() as session:
        preview = preview_of(session, run_id)
    wall_s["preview complete"] = time.monotonic() - began_s
    assert not preview.blockers, preview.blockers
    return wall_s, preview.comparison.n_numbers_changed


def _show(
    n_submissions: int, wall_s: dict[str, float], workers: list[dict[str, tuple[float, float]]]
) -> None:
    title = (
        f"{n_submissions:,} submissions, {N_WORKERS} workers, seconds on the wall from the start"
    )
    show(title, ("", "s"), [(name, f"{seconds:.1f}") for name, seconds in wall_s.items()])
    steps = {
        step: [sum(worker.get(step, (0.0, 0.0))[part] for worker in workers) for part in (0, 1)]
        for step in sorted({step for worker in workers for step in worker})
    }
    whole_s = sum(cpu_s for cpu_s, _ in steps.values())
    rows = [
        (step, f"{cpu_s:.2f}", f"{1000 * cpu_s / n_submissions:.2f}", f"{cpu_s / whole_s:.0%}",
         f"{took_s:.2f}")
        for step, (cpu_s, took_s) in steps.items()
    ]  # fmt: skip
    rows.append(("together", f"{whole_s:.2f}", f"{1000 * whole_s / n_submissions:.2f}", "", ""))
    show("Both workers", ("", "CPU s", "ms each", "share", "wall s"), rows)


def _wait(context: WorkerContext, is_so: Callable[[], bool]) -> None:
    """Make a pass a second, as the reconciler does, until it is so."""
    next_s = time.monotonic()
    while not is_so():
        if time.monotonic() >= next_s:
            reconcile_once(context.database, context.dispatcher, context.settings)
            next_s = time.monotonic() + PASS_EVERY_S
        time.sleep(LOOK_AGAIN_S)


def _has_open_trial(database: Database, run_id: str) -> bool:
    with database.read() as session:
        trial = run_view(session, find_run(session, run_id)).trial
    return trial is None or trial.state == "waiting"


def _n_sheets(database: Database, protocol: ProtocolDocument) -> int:
    with database.read() as session:
        rows = session.query(ScoreSheetRow).filter_by(protocol_digest=protocol.digest)
        return rows.count()


def _state(database: Database, run_id: str) -> RunState:
    with database.read() as session:
        return find_run(session, run_id).state


# What was there before


def _prepared(folder: Path, n_submissions: int) -> WorkerContext:
    """Records of scored submissions with their board, and the private store that made them."""
    settings, protocol, workload = settings_in(folder), packaged_protocol(), _workload()
    prepare(settings.database_url)
    place = folder / "splits" / "bench"
    place.mkdir(parents=True)
    (place / "split.json").write_text(_split(workload, protocol).model_dump_json(by_alias=True))
    (place / FLOORS_FILE).write_text(OPEN_FLOORS)
    context = open_context(settings)
    register_all_splits(context.database, context.splits, protocol)
    keep_memory()
    revision, teams = open_phase(context.database, "bench")
    split = context.splits.find("bench", revision, protocol)
    for number, factor in enumerate(np.linspace(0.6, 1.2, n_submissions).tolist()):
        made = {
            "source": workload.pairs.source,
            "edited": np.round(workload.pairs.edited * factor, 4),
        }
        target = Target(bytes_digest(f"{number}".encode()), PLANNING, split, protocol, made=made)
        scored = context.stages.score(target)
        published = Rounding(PLANNING, protocol.publication).sheet(scored.sheet)
        with context.database.write() as session:
            add_scored(session, target, scored, published, teams, number)
    build_bench_board(context)
    return context


def _workload() -> Workload:
    return make_workload(packaged_protocol(), BENCHMARK_SAMPLES, seed=SEED)


def _split(workload: Workload, protocol: ProtocolDocument) -> Split:
    """The workload's split, its regions moved ahead of where the car stands."""
    arrays = workload.split
    regions_m = arrays.regions_m.copy()
    regions_m[..., 0] += np.maximum(0.0, AHEAD_M - regions_m[..., 0].min(axis=1))[:, None]
    samples = (
        SplitSample(
            sample_id=f"{number:024x}",
            scene_id=f"scene-{scene:04}",
            task=protocol.tasks[task].id,
            region=tuple((round(x, 3), round(y, 3)) for x, y in region),
        )
        for number, (scene, task, region) in enumerate(
            zip(
                arrays.scene_index.tolist(),
                arrays.task_index.tolist(),
                regions_m.tolist(),
                strict=True,
            )
        )
    )
    return Split(
        schema_="exceptiondrive.split/1", name="bench", title="Bench", samples=tuple(samples)
    )


def open_phase(database: Database, split: str) -> tuple[str, list[int]]:
    """Open the phase `bench` on a split, and make its teams; return the split's revision and the teams."""
    with database.write() as session:
        phase = NewPhase(id="bench", challenge=PLANNING.id, title="Bench", split=split,
            protocol="1.0", quota_per_day=50, quota_total=None)  # fmt: skip
        revision = create_phase(session, phase, actor="bench").split_revision
        teams = [
            create_team(session, f"team{k}", f"Team {k}", actor="bench").id for k in range(N_TEAMS)
        ]
    return revision, teams


def add_scored(
    session: Session,
    target: Target,
    scored: Scored,
    published: ScoreSheet,
    teams: Sequence[int],
    number: int,
) -> None:
    """Record what was made here as an upload that was scored; the teams take turns."""
    name, now = f"s{number:07d}kq", database_now(session)
    session.add(
        Submission(
            id=name,
            phase_id="bench",
            team_id=teams[number % len(teams)],
            method=f"Planner {number}",
            description="An invented planner.",
            file_digest=target.file_digest,
            size_bytes=1,
            status=SubmissionStatus.SCORED,
            received_at=now,
            status_at=now,
        )
    )
    session.flush()
    session.add(
        ScoreSheetRow(
            submission_id=name,
            protocol_digest=target.protocol.digest,
            split_revision=target.split.manifest.revision,
            sheet=published,
            exact_digest=scored.digest,
            measurement_key=scored.measurement_key,
            scorer_version=SCORER_VERSION,
            created_at=now,
        )
    )
    session.add(SimilarityRow(submission_id=name, alike="[]"))


def build_bench_board(context: WorkerContext) -> None:
    """Build the board of the phase `bench`, which is due at once."""
    digest = packaged_protocol().digest
    with context.database.write() as session:
        want_board(session, "bench", digest)
        let_time_pass(session, timedelta(hours=1))
    build_board_of(context, "bench", digest)


# A worker


def _start_worker(folder: Path, number: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "benchmarks.new_clearance", "--worker", str(folder)]
    with (folder / f"worker-{number}.log").open("wb") as log:
        return subprocess.Popen(command, cwd=ROOT, stdout=log)


def _ended(worker: subprocess.Popen[bytes], folder: Path) -> dict[str, tuple[float, float]]:
    if worker.wait():
        raise SystemExit("a worker of the benchmark ended with an error")
    found: dict[str, tuple[float, float]] = json.loads(_seconds_of(folder, worker.pid).read_text())
    return found


def _seconds_of(folder: Path, pid: int) -> Path:
    return folder / f"seconds-{pid}.json"


def _work(folder: Path) -> None:
    """Work until the preview is there; then write seconds of processor and wall by step."""
    context, clock = open_context(settings_in(folder)), Clock()
    keep_memory()
    for owner, name, step in STEPS:
        setattr(owner, name, clock.counting(getattr(owner, name), step))
    while not (folder / ENDED).exists():
        if not work.work(context, Lane.RESCORE):
            time.sleep(LOOK_AGAIN_S)
    _seconds_of(folder, os.getpid()).write_text(json.dumps(clock.seconds))


class Clock:
    """Seconds by step, each without what is counted as another step inside it."""

    def __init__(self) -> None:
        self.seconds: dict[str, tuple[float, float]] = {}
        self._inside: list[list[float]] = []

    def counting(self, function: Callable[..., Any], step: str) -> Callable[..., Any]:
        """The function, which counts its time as this step."""

        def run(*arguments: Any, **named: Any) -> Any:
            with self._step(step):
                return function(*arguments, **named)

        return run

    @contextmanager
    def _step(self, step: str) -> Iterator[None]:
        cpu_s, wall_s = time.process_time(), time.monotonic()
        self._inside.append([0.0, 0.0])
        try:
            yield
        finally:
            took = (time.process_time() - cpu_s, time.monotonic() - wall_s)
            inside = self._inside.pop()
            if self._inside:
                self._inside[-1] = [s + t for s, t in zip(self._inside[-1], took, strict=True)]
            had = self.seconds.get(step, (0.0, 0.0))
            self.seconds[step] = (had[0] + took[0] - inside[0], had[1] + took[1] - inside[1])


if __name__ == "__main__":
    main()
