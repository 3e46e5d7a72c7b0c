"""Boards of 100 to 10,000 entries: `python -m benchmarks.long_boards [ENTRIES ...]`.

Records, worker and application are real, the latter two in a process of their own each. One file is
scored; every entry has that score and its sums by scene, times a factor of its own. A board of all but
one stands when the last score comes. Printed: CPU of each step from that score to the published board,
what looks at it cost a server, the most memory of both, and how all this grows. Drawing and likeness,
which follow publication, are not counted.
"""

import argparse
import asyncio
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Scope

from benchmarks.load_traffic import file_maker
from benchmarks.new_clearance import (
    Clock,
    add_scored,
    build_bench_board,
    open_phase,
    settings_in,
)
from benchmarks.processes import ROOT, peak_mib_so_far
from benchmarks.report import at_most, note, show
from exceptiondrive_records.boards.boards import current_board, flip_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.setup import prepare
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_schemas.base import bytes_digest, canonical_json
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_scoring.bootstrap import GRID, SceneSums
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web import kept_pages
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_worker.boards import run as board_run
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.process import keep_memory, limit_memory
from exceptiondrive_worker.sample.files import write_sample_split
from exceptiondrive_worker.splits.admin import register_all_splits
from exceptiondrive_worker.splits.private_store import Shelf, content_key
from exceptiondrive_worker.stages import Target

GROWTH = (100, 1_000, 10_000)
PAGE = 100
ENTRIES_AFTER_IT = 30_000
"""Of boards that the server shows besides: as many boards of this length."""
N_LOG_N = 1.13
"""The exponent of n log n between 1,000 and 10,000."""
MOST_EXPONENT = 1.2
"""A little above it: one run moves by so much."""
MOST_OF_A_WORKER_MIB = 512
"""What docs/performance.md says the longest of these boards fits into."""
_PARTS = ("make", "worker", "server")
_STEPS = {
    "entries_for_board": "read entries",
    "_scored": "read intervals",
    "board_entries": "ranks, rows",
    "comparisons": "compared top",
    "publish_board": "publish",
}


def main() -> None:
    """Print how long boards cost."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.long_boards", description=__doc__)
    parser.add_argument("entries", nargs="*", type=int, default=GROWTH)
    parser.add_argument("--part", choices=_PARTS, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.part:
        measure = {"make": _make, "worker": _worker, "server": _server}[given.part]
        sys.stdout.write(json.dumps(measure(given.folder, given.entries[0])) + "\n")
        return
    _measure(given.entries)


def run(_: ProtocolDocument) -> None:
    """Print how long boards cost."""
    _measure(GROWTH)


def _measure(lengths: Sequence[int]) -> None:
    found = {n_entries: _measured(n_entries) for n_entries in lengths}
    for part, title in (
        ("worker", "From a new score to the published board, CPU ms"),
        ("server", "In a server, CPU ms unless it says otherwise"),
    ):
        names = list(next(iter(found.values()))[part])
        rows = [
            (name, *_line([found[n][part][name] for n in found], list(found))) for name in names
        ]
        heads = [f"{n:,}" for n in found] + ["exponents"]
        show(title, ("", *heads), rows)
        for name in names:
            values = [found[n][part][name] for n in found]
            if exponents := _exponents(values, list(found)):
                at_most(f"{name}, growth with the longest board", exponents[-1], MOST_EXPONENT, "")
    if longest := found.get(GROWTH[-1]):
        worker = longest["worker"]
        above_mib = worker["most memory of the worker, MiB"] - worker["memory idle, MiB"]
        what = f"memory of the worker above idle, {GROWTH[-1]:,} entries"
        at_most(what, above_mib, MOST_OF_A_WORKER_MIB, "MiB")
    note(f"exponents: from each length to the next; n log n is about {N_LOG_N} at the last")


def _exponents(values: list[float], lengths: list[int]) -> list[float]:
    return [
        math.log(after / before) / math.log(longer / shorter)
        for before, after, shorter, longer in zip(
            values, values[1:], lengths, lengths[1:], strict=False
        )
        if before and after
    ]


def _line(values: list[float], lengths: list[int]) -> list[str]:
    exponents = _exponents(values, lengths)
    return [*(f"{value:,.3g}" if value < 100 else f"{value:,.0f}" for value in values),
            ", ".join(f"{each:.2f}" for each in exponents)]  # fmt: skip


def _measured(n_entries: int) -> dict[str, dict[str, float]]:
    with tempfile.TemporaryDirectory(prefix="ed-long-") as folder:
        found = {}
        for part in _PARTS:
            command = [sys.executable, "-m", "benchmarks.long_boards", str(n_entries)]
            done = subprocess.run(
                [*command, "--part", part, "--folder", folder],
                cwd=ROOT,
                check=True,
                stdout=subprocess.PIPE,
                text=True,
            )
            found[part] = json.loads(done.stdout.splitlines()[-1])
        return found


def _make(folder: Path, n_entries: int) -> dict[str, float]:
    """Let a board of all entries but one stand, and add the last score."""
    prepare(settings_in(folder).database_url)
    write_sample_split(folder / "splits")
    with _opened(folder) as context:
        register_all_splits(context.database, context.splits, packaged_protocol())
        entries = _Entries(context, n_entries)
        entries.add(range(n_entries - 1))
        build_bench_board(context)
        entries.add([n_entries - 1])
    return {}


def _worker(folder: Path, _: int) -> dict[str, float]:
    """Build the board with the last score, as a process that has just begun; CPU ms by step, MiB."""
    with _opened(folder) as context:
        keep_memory()
        limit_memory(context.settings.memory_headroom_bytes)
        idle_mib = peak_mib_so_far()
        clock = Clock()
        for function, step in _STEPS.items():
            setattr(board_run, function, clock.counting(getattr(board_run, function), step))
        began_s = time.process_time()
        build_bench_board(context)
        total_s = time.process_time() - began_s
    seconds = {step: clock.seconds[step][0] for step in _STEPS.values()}
    rest_s = total_s - sum(seconds.values())
    steps = {step: 1000 * cpu_s for step, cpu_s in seconds.items()}
    return {
        **steps,
        "read the last board, the rest": 1000 * rest_s,
        "all": 1000 * total_s,
        "memory idle, MiB": idle_mib,
        "most memory of the worker, MiB": peak_mib_so_far(),
    }


@contextmanager
def _opened(folder: Path) -> Iterator[WorkerContext]:
    context = open_context(settings_in(folder))
    try:
        yield context
    finally:
        context.close()


class _Entries:
    """Scored submissions of one phase, each its own factor away from one that was scored."""

    def __init__(self, context: WorkerContext, n_entries: int) -> None:
        self._context, self._protocol = context, packaged_protocol()
        rng = np.random.default_rng(20261123)
        self._factors = rng.uniform(0.3, 0.99, n_entries)
        self._best = set(np.argsort(self._factors)[-2 * self._compared :].tolist())
        revision, self._teams = open_phase(context.database, "sample")
        split = context.splits.find("sample", revision, self._protocol)
        data = file_maker(split.manifest.sample_ids)()
        digest, _ = context.files.put_stream([data], limit_bytes=len(data))
        self._target = Target(digest, PLANNING, split, self._protocol)
        self._scored = context.stages.score(self._target)
        self._measurements = context.stages.measurements(self._target)
        self._sums = context.stages.scene_sums(self._target, self._scored.measurement_key)
        self._factor_of: dict[str, float] = {}
        context.stages.scene_sums = self._scene_sums  # type: ignore[method-assign]
        self._sheet = Rounding(PLANNING, self._protocol.publication).sheet(self._scored.sheet)

    @property
    def _compared(self) -> int:
        return self._protocol.publication.compared_entries

    def add(self, numbers: Iterable[int]) -> None:
        """Record the scores of these entries."""
        with self._context.database.write() as session:
            for number in numbers:
                self._keep(number)
                target = replace(self._target, file_digest=bytes_digest(f"{number}".encode()))
                scored = replace(self._scored, measurement_key=_measurement_key(number))
                add_scored(session, target, scored, self._published(number), self._teams, number)

    def _keep(self, number: int) -> None:
        """Write what the worker would have kept of those to be compared, and of the last one."""
        key = _measurement_key(number)
        self._factor_of[key] = self._factors[number]
        if number in self._best or number == len(self._factors) - 1:
            self._context.private.write_columns(Shelf.MEASUREMENTS, key, self._measurements)

    def _scene_sums(self, target: Target, measurement_key: str) -> SceneSums:
        """Return what the worker would make of an entry's measurements."""
        sums = self._sums.sums * self._factor_of.get(measurement_key, 1.0)
        return replace(self._sums, sums=np.rint(sums / GRID) * GRID)

    def _published(self, number: int) -> ScoreSheet:
        factor = float(self._factors[number])
        rows = {
            name: {
                key: None if value is None else round(value * factor, 4)
                for key, value in getattr(self._sheet, name).items()
            }
            for name in ("micro", "macro_family")
        }
        return self._sheet.model_copy(update=rows)


def _measurement_key(number: int) -> str:
    return content_key("bench", str(number))


def _server(folder: Path, n_entries: int) -> dict[str, float]:
    """Look at the board as visitors and programs do, then at others; CPU ms, kB, MiB."""
    worker = settings_in(folder)
    settings = ServerSettings(
        database_url=worker.database_url,
        broker_url=worker.broker_url,
        file_store_url=worker.file_store_url,
        receipt_key_file=folder / "receipt-key.pem",
    )
    with asyncio.Runner() as runner:
        look = _Looks(create_app(settings), runner)
        assert look("/healthz").n_bytes
        idle_mib = peak_mib_so_far()
        page, api = "/?phase=bench", "/api/v1/leaderboard?phase=bench"
        first, again, whole = look(page), look(page), look(api)
        after_json_mib = peak_mib_so_far()
        parts = list(_by_cursor(look, f"{api}&limit={PAGE}"))
        assert len(parts) == -(-whole.n_entries // PAGE), "the pages do not hold all entries"
        csv = look("/api/v1/leaderboard.csv?phase=bench")
        with_csv_mib = peak_mib_so_far()
        kept_pages.MAX_AGE_S = 0.0  # each of the next boards is shown, however soon it comes
        for number in range(max(3, ENTRIES_AFTER_IT // n_entries) if n_entries > 100 else 30):
            beside = get_context("spawn").Process(
                target=_publish_next, args=(settings.database_url, number)
            )
            beside.start()
            beside.join()
            assert beside.exitcode == 0, "the next board was not published"
            look(page)
            look(api)
    return {
        "first page, with reading the board": first.cpu_ms,
        "the same page again": again.cpu_ms,
        "first page, kB": first.n_bytes / 1e3,
        "whole board as JSON": whole.cpu_ms,
        "whole board as JSON, kB": whole.n_bytes / 1e3,
        f"API in pages of {PAGE}, each": sum(each.cpu_ms for each in parts) / len(parts),
        f"API in pages of {PAGE}, all of them": sum(each.cpu_ms for each in parts),
        "CSV": csv.cpu_ms,
        "CSV, kB": csv.n_bytes / 1e3,
        "memory idle, MiB": idle_mib,
        "most, page and JSON shown, MiB": after_json_mib,
        "most, CSV too, MiB": with_csv_mib,
        "most, after other boards as long, MiB": peak_mib_so_far(),
    }


class _Look(NamedTuple):
    cpu_ms: float
    n_bytes: int
    n_entries: int
    next_address: str | None


class _Looks:
    """Asks an application and keeps nothing of what it answers: a client's copies are not its memory."""

    def __init__(self, app: ASGIApp, runner: asyncio.Runner) -> None:
        self._app, self._runner = app, runner

    def __call__(self, address: str) -> _Look:
        began_s = time.process_time()
        n_bytes, n_entries, link = self._runner.run(self._ask(*address.split("?", 1)))
        return _Look(1000 * (time.process_time() - began_s), n_bytes, n_entries, link)

    async def _ask(self, path: str, query: str = "") -> tuple[int, int, str | None]:
        n_bytes = n_entries = 0
        link = None

        async def receive() -> Message:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Message) -> None:
            nonlocal n_bytes, n_entries, link
            if message["type"] == "http.response.start":
                assert message["status"] == 200, message
                link = Headers(raw=message["headers"]).get("link")
            else:
                n_bytes += len(message["body"])
                n_entries += message["body"].count(b'"submission_id":')

        headers = [(b"host", b"localhost")]
        scope: Scope = {"type": "http", "http_version": "1.1", "method": "GET", "scheme": "http",
            "path": path, "raw_path": path.encode(), "query_string": query.encode(), "root_path": "",
            "headers": headers, "server": ("localhost", 80), "client": ("127.0.0.1", 1)}  # fmt: skip
        await self._app(scope, receive, send)
        return n_bytes, n_entries, link and link[1 : link.index(">")]


def _by_cursor(look: _Looks, address: str) -> Iterator[_Look]:
    """Follow `Link` to the end."""
    following: str | None = address
    while following is not None:
        answer = look(following)
        yield answer
        following = answer.next_address


def _publish_next(database_url: str, number: int) -> None:
    """Let the phase show one board more, which says the same under another number.

    It runs beside the server, as a worker does: what it takes is none of the server's memory.
    """
    database = Database(database_url)
    with database.read() as session:
        row = current_board(session, "bench")
        assert row is not None, "a board stands"
        shown = Board.model_validate_json(row.body)
    board = shown.model_copy(update={"board": 1_000 + number})
    body = canonical_json(board).decode()
    with database.write() as session:
        phase = session.get_one(Phase, board.phase)
        row = BoardRow(
            phase_id=phase.id,
            protocol_digest=phase.protocol_digest,
            split_revision=phase.split_revision,
            number=board.board,
            digest=board.content_digest,
            body_digest=bytes_digest(body.encode()),
            body=body,
            published_at=board.published_at,
        )
        session.add(row)
        session.flush()
        flip_board(session, phase, row)
    database.dispose()


if __name__ == "__main__":
    main()
