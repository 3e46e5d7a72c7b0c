"""A lively board for tests and screenshots: six invented entries, references, the paper's rows.

The invented entries exist here alone; nothing of them ships.
"""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi import FastAPI

from exceptiondrive_records.board_requests import want_board
from exceptiondrive_records.boards import claim_board, publish_board
from exceptiondrive_records.database import Database
from exceptiondrive_records.drawings import find_public_split, keep_entry_drawings
from exceptiondrive_records.migrations import migrate
from exceptiondrive_records.phases import create_phase
from exceptiondrive_records.protocols import add_protocol
from exceptiondrive_records.splits import publish_split, register_split
from exceptiondrive_records.tables import Phase, ScoreSheetRow, Submission, Team
from exceptiondrive_schemas.board import (
    Board,
    BoardEntry,
    FamilyCell,
    FamilyHead,
    Links,
    PairedDifference,
    ReminderEffect,
)
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_schemas.protocol import (
    Protocol,
    packaged_protocol,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.reported import reported_entries
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Coverage,
    Flag,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import Manifest, SplitRef
from exceptiondrive_schemas.submission import SubmissionStatus
from exceptiondrive_scoring.challenge import SCORING
from exceptiondrive_scoring.split_arrays import split_arrays
from exceptiondrive_server import pages, team_pages
from exceptiondrive_server.settings import ServerSettings
from exceptiondrive_worker.sample.planners import PLANNERS, predictions
from exceptiondrive_worker.sample.scenes import SEED, sample_scenes, sample_split

PROTOCOL = packaged_protocol("1.0")
COUNTS = dict(zip([f.id for f in PROTOCOL.families], (62, 47, 59, 14, 22, 36), strict=True))
N = sum(COUNTS.values())
KEYS = ("hcc", "ur", "hpr", "cts", "cts_x", "cts_y")
MANIFEST = Manifest(
    schema_="exceptiondrive.manifest/1",
    name="sample",
    title="Sample",
    revision="sha256:" + "3f9a" * 16,
    waypoints=6,
    time_step_s=0.5,
    sample_ids=tuple(f"s{index:04d}" for index in range(N)),
)
LONG_AGO = datetime(2020, 5, 4, 9, 30, tzinfo=UTC)
"""Before any board of a test, whatever the clock of the machine says."""
PAPER = {
    "ST-P3": (21.03, 78.11, 18.59, 1.57, 1.55, 0.24),
    "Impromptu VLA": (19.64, 78.92, 18.87, 2.20, 1.86, 0.70),
    "LightEMMA": (18.66, 79.51, 18.04, 1.68, 1.61, 0.23),
    "VAD": (13.89, 80.26, 13.47, 1.68, 1.47, 0.51),
    "AutoVLA": (10.37, 81.93, 11.26, 1.97, 1.67, 0.64),
    "OmniDrive": (9.52, 83.36, 9.84, 1.40, 1.34, 0.22),
    "DrivoR": (4.86, 92.13, 5.42, 1.25, 1.19, 0.22),
}
PAPER_FAMILIES = {
    "AutoVLA": (9.90, 12.86, 10.22, 9.78, 9.92, 9.56),
    "Impromptu VLA": (19.63, 20.28, 19.98, 20.14, 17.86, 19.95),
    "DrivoR": (4.31, 4.59, 2.61, 5.49, 3.94, 8.27),
    "ST-P3": (20.02, 19.86, 17.48, 22.92, 24.75, 21.17),
}
INVENTED = (
    ("Kestrel-2", "Halden Autonomy Lab", 61.40, 31.10, 52.71, 2.81, 2.44, 0.92, (1, 2), 3),
    ("LaneKeeper XL (bypass head, 3 s)", "Team Aurora", 58.92, 33.75, 49.02, 2.35, 1.71, 1.28,
     (1, 3), 1),
    ("brake-late", "Osprey", 57.31, 36.42, 47.90, 1.97, 1.95, 0.11, (2, 4), None),
    ("Møller–Ruiz world model", "U. Nørrebro", 49.05, 43.18, 41.33, 2.02, 1.66, 0.71, (3, 5), 4),
    ("VLA-7B zero-shot", "quiet.systems", 44.70, 47.96, 39.15, 1.12, 1.02, 0.30, (4, 6), 5),
    ("nerve", "Halden Autonomy Lab", 22.18, 74.90, 20.06, 0.04, 0.03, 0.02, (6, 6), 6),
)  # fmt: skip
SPREAD = (1.06, 0.91, 1.12, 0.74, 1.02, 1.15)
BLIND = Flag(
    code="blind_to_the_edit",
    label="Blind to the edit",
    detail="97% of the pairs differ by less than 0.05 m.",
)
STILL = Flag(
    code="stands_still",
    label="Stands still",
    detail="100% of the edited trajectories end within 0.5 m of the start.",
)

EFFECT = ReminderEffect(
    without="a0000001kq",
    without_method="Careful agent, no reminder",
    differences={
        "accuracy": PairedDifference(
            difference=0.1625, interval=(0.1, 0.23), discordant=0.4, verdict="with is better"
        ),
        "under_warning": PairedDifference(
            difference=-0.1525, interval=(-0.22, -0.09), discordant=0.4, verdict="with is better"
        ),
    },
)


def values(row: tuple[float, ...]) -> dict[str, float | None]:
    scale = (100, 100, 100, 1, 1, 1)
    return {key: round(v / s, 6) for key, v, s in zip(KEYS, row, scale, strict=True)}


def _interval(value: float, half: float) -> tuple[float, float]:
    return (round(max(0.0, value - half), 4), round(min(1.0, value + half), 4))


def _families(hcc: float, ur: float) -> dict[str, FamilyCell]:
    cells = {}
    for (family, n), spread in zip(COUNTS.items(), SPREAD, strict=True):
        value = round(min(hcc * spread, 1.0), 4)
        cells[family] = FamilyCell.model_validate(
            {
                "n": n,
                "hcc": value,
                "ur": round(min(ur, 1 - value), 4),
                "hpr": round(value * 0.9, 4),
                "intervals": {"hcc": _interval(value, 0.3 / n**0.5)},
            }
        )
    return cells


def scored(index: int, started: datetime) -> BoardEntry:
    method, team, hcc, ur, hpr, cts, cts_x, cts_y, interval, previous = INVENTED[index]
    metrics = values((hcc, ur, hpr, cts, cts_x, cts_y))
    return BoardEntry(
        source="scored",
        rank=index + 1,
        rank_interval=interval,
        previous_rank=previous,
        submission_id=f"s{index:07d}kq",
        method=method,
        team=team,
        description="Invented for tests.",
        links=Links(paper="https://example.org/p", code="https://example.org/c" if index else None),
        submitted_at=started - timedelta(days=9 - index, hours=index),
        metrics=metrics,
        macro_family=metrics,
        micro=values((hcc - 0.7, ur + 0.4, hpr - 0.5, cts, cts_x, cts_y)),
        intervals={
            "hcc": _interval(hcc / 100, 0.041 - 0.002 * index),
            "ur": _interval(ur / 100, 0.038),
            "hpr": _interval(hpr / 100, 0.03),
            "cts": (cts - 0.1, cts + 0.1),
        },
        families=_families(hcc / 100, ur / 100),
        coverage={"edited": 1.0, "source": 1.0},
        flags=(BLIND,) if method == "nerve" else (),
    )


def reference(method: str, row: tuple[float, ...], flags: tuple[Flag, ...] = ()) -> BoardEntry:
    metrics = values(row)
    return BoardEntry(
        source="reference",
        rank=None,
        rank_interval=None,
        submission_id=f"ref-{method.lower().replace(' ', '-')}",
        method=method,
        team="ExceptionDrive",
        submitted_at=datetime(2026, 11, 1, tzinfo=UTC),
        metrics=metrics,
        macro_family=metrics,
        micro=metrics,
        intervals={"hcc": _interval(metrics["hcc"] or 0, 0.03), "ur": None},
        families=_families(metrics["hcc"] or 0, metrics["ur"] or 0),
        flags=flags,
    )


def reported(method: str) -> BoardEntry:
    row = values(PAPER[method])
    families = {
        family: FamilyCell.model_validate({"n": None, "hcc": value / 100})
        for family, value in zip(COUNTS, PAPER_FAMILIES.get(method, ()), strict=False)
    }
    return BoardEntry(
        source="reported",
        rank=None,
        rank_interval=None,
        unranked_because="reported in the paper, not scored here",
        submission_id=None,
        method=method,
        team="",
        submitted_at=None,
        metrics=row,
        macro_family=row,
        micro={key: None for key in KEYS},
        intervals={},
        families=families,
        cite="exceptiondrive2026",
    )


def unscored(started: datetime) -> BoardEntry:
    nothing: dict[str, float | None] = {key: None for key in KEYS}
    return scored(5, started).model_copy(
        update={
            "rank": None,
            "rank_interval": None,
            "submission_id": "s0000009kq",
            "method": "half-a-file",
            "team": "Team Aurora",
            "unranked_because": "coverage 0.62 is below 0.99",
            "metrics": nothing,
            "macro_family": nothing,
            "micro": nothing,
            "intervals": {},
            "families": {},
            "flags": (),
        }
    )


def board_of(entries: tuple[BoardEntry, ...], number: int = 7) -> Board:
    return Board(
        challenge="planning",
        phase="sample",
        split=SplitRef(name="sample", revision="sha256:" + "3f9a" * 16),
        protocol=ProtocolRef(version="1.0", digest=PROTOCOL.digest),
        headline="macro_family",
        board=number,
        published_at=datetime(2026, 11, 21, 2, 5, tzinfo=UTC),
        n_samples=N,
        confidence=0.95,
        families=tuple(
            FamilyHead(id=family.id, title=family.title, n=COUNTS[family.id])
            for family in PROTOCOL.families
        ),
        entries=entries,
    )


def lively_entries() -> tuple[BoardEntry, ...]:
    started = datetime(2026, 11, 20, 14, 0, tzinfo=UTC)
    return (
        *(scored(index, started) for index in range(len(INVENTED))),
        unscored(started),
        reference("FREEZE", (97.20, 0.0, 12.44, 3.61, 3.60, 0.02), (STILL,)),
        reference("CONSTANT VELOCITY", (8.13, 90.02, 7.90, 0.0, 0.0, 0.0), (BLIND,)),
        *(reported(method) for method in PAPER),
    )


@pytest.fixture(scope="session")
def protocol() -> Protocol:
    """The packaged protocol."""
    return PROTOCOL


@pytest.fixture(scope="session")
def lively_board() -> Board:
    """A board with entries of every source."""
    return board_of(lively_entries())


@pytest.fixture(scope="session")
def empty_board() -> Board:
    """A board on which nobody stands."""
    return board_of((), 1)


@pytest.fixture(scope="session")
def paper_board() -> Board:
    """A board with the paper's rows alone."""
    return board_of(tuple(reported(method) for method in PAPER), 1)


class Services:
    """What pages need of the server: the records, and the settings."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self.settings = ServerSettings()
        self.provider = None


class Site:
    """The pages over real records, on an application of their own."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self.app = FastAPI()
        self.app.state.services = Services(database)
        self.app.include_router(pages.router)
        self.app.include_router(team_pages.router)
        team_pages.lead_to_sign_in(self.app)
        pages.mount_static(self.app)

    async def get(self, path: str, **headers: str) -> httpx.Response:
        return await self._send("GET", path, headers)

    async def post(self, path: str, data: dict[str, str]) -> httpx.Response:
        return await self._send("POST", path, {}, data)

    async def _send(
        self, method: str, path: str, headers: dict[str, str], data: dict[str, str] | None = None
    ) -> httpx.Response:
        transport = httpx.ASGITransport(app=self.app)
        named = {key.replace("_", "-"): value for key, value in headers.items()}
        async with httpx.AsyncClient(transport=transport, base_url="http://site.test") as client:
            return await client.request(method, path, headers=named, data=data)

    def publish(self, board: Board) -> None:
        """Publish a board of a phase that exists."""
        with self.database.write() as session:
            want_board(session, board.phase, board.protocol.digest)
        with self.database.write() as session:
            claim = claim_board(session, board.phase, board.protocol.digest, 30)
            assert claim is not None
            assert publish_board(session, claim, board) is not None

    def create_phase(self, phase_id: str, challenge: str = "planning", **more: Any) -> None:
        """Create a phase over the small split, registering protocol and split."""
        with self.database.write() as session:
            add_protocol(session, packaged_protocol_toml(), "test")
            register_split(session, MANIFEST, COUNTS, "test")
            create_phase(
                session,
                phase_id,
                challenge=challenge,
                title=phase_id.replace("-", " ").title(),
                split_name="sample",
                protocol="1.0",
                actor="test",
                **more,
            )

    def publish_split(self) -> None:
        """Make the small split a development split."""
        with self.database.write() as session:
            publish_split(session, "sample", MANIFEST.revision, "sha256:" + "5" * 64, "test")

    def keep_drawings(self, submission_id: str, planner: int = 4) -> None:
        """Keep real drawings of a recorded submission, on the small split, which is public."""
        with self.database.write() as session:
            split = find_public_split(session, MANIFEST.ref)
            assert split is not None
            drawings = real_drawings(planner)
            keep_entry_drawings(session, submission_id, PROTOCOL.digest, split, drawings)

    def draft(self, board: Board, version: str = "1.1") -> Board:
        """Build a board under a later protocol, which the phase does not show."""
        toml = packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"')
        protocol = parse_protocol(toml)
        with self.database.write() as session:
            add_protocol(session, toml, "test")
        ref = ProtocolRef(version=version, digest=protocol.digest)
        drafted = board.model_copy(update={"protocol": ref})
        self.publish(drafted)
        return drafted

    def change_protocol(self, board: Board, version: str = "1.1") -> None:
        """Show the phase of a board under a later protocol."""
        drafted = self.draft(board, version)
        with self.database.write() as session:
            session.get_one(Phase, board.phase).protocol_digest = drafted.protocol.digest
        self.publish(drafted)

    def keep_submission(self, entry: BoardEntry) -> None:
        """Record the submission and the score sheet behind a scored entry."""
        assert entry.submission_id is not None
        assert entry.submitted_at is not None
        with self.database.write() as session:
            slug = f"team-{entry.submission_id}"
            team = Team(slug=slug, name=slug, is_reference=False, created_at=entry.submitted_at)
            session.add(team)
            session.flush()
            session.add(_submission(entry, team.id))
            session.flush()
            session.add(
                ScoreSheetRow(
                    submission_id=entry.submission_id,
                    protocol_digest=PROTOCOL.digest,
                    split_revision=MANIFEST.revision,
                    sheet=sheet_of(entry),
                    exact_digest="sha256:" + "e" * 64,
                    measurement_key="m" * 64,
                    scorer_version="1.0.0",
                    created_at=entry.submitted_at,
                )
            )


def _submission(entry: BoardEntry, team_id: int) -> Submission:
    return Submission(
        id=entry.submission_id,
        phase_id="sample",
        team_id=team_id,
        method=entry.method,
        description=entry.description,
        paper_url=entry.links.paper,
        code_url=entry.links.code,
        file_digest="sha256:" + "ab12" * 16,
        size_bytes=41_233,
        status=SubmissionStatus.SCORED,
        report=None,
        failure_code=None,
        failure_message=None,
        received_at=LONG_AGO,
        status_at=entry.submitted_at,
        withdrawn_at=None,
    )


def sheet_of(entry: BoardEntry) -> ScoreSheet:
    """A score sheet that fits an entry, with a row for every task."""
    tasks = {}
    for index, task in enumerate(PROTOCOL.tasks):
        hcc = min(1.0, (entry.families[task.family].metrics["hcc"] or 0) * (0.8 + index % 5 / 10))
        row = {"hcc": round(hcc, 4), "ur": round(0.86 * (1 - hcc), 4), "hpr": 0.4, "cts": 1.1}
        tasks[task.id] = BreakdownRow.of(7 + 5 * (index % 4), {**row, "cts_x": 1.0, "cts_y": 0.3})
    shares: dict[str, float | None] = {
        "edited_stationary": 0.214,
        "source_stationary": 0.02,
        "blind": 0.973 if entry.flags else 0.08,
        "impossible": None,
    }
    return ScoreSheet(
        challenge="planning",
        protocol=ProtocolRef(version="1.0", digest=PROTOCOL.digest),
        split=MANIFEST.ref,
        scorer_version="1.0.0",
        n=N,
        coverage=Coverage(edited=1.0, source=1.0),
        micro=entry.micro,
        macro_family=entry.macro_family,
        families={
            key: BreakdownRow.of(cell.n, cell.metrics) for key, cell in entry.families.items()
        },
        tasks=tasks,
        plausibility=Plausibility(shares=shares, flags=entry.flags),
    )


@cache
def real_drawings(planner: int = 4) -> EntryDrawings:
    """What the worker draws of a synthetic planner on the synthetic split."""
    scenes = sample_scenes()
    answers = {one.sample_id: one for one in predictions(PLANNERS[planner], scenes, SEED)}
    ids = sorted(answers)
    nothing = ((float("nan"),) * 2,) * 6
    columns = {
        side: np.array([getattr(answers[key], side) or nothing for key in ids])
        for side in ("source", "edited")
    }
    split = split_arrays(sample_split().samples, PROTOCOL.taxonomy)
    scoring = SCORING[ChallengeId.PLANNING]
    measured = scoring.measure(columns, split, PROTOCOL.geometry)
    drawings = scoring.drawings(columns, measured, ids, split, PROTOCOL)
    assert drawings is not None
    return drawings


def open_site(folder: Path) -> Site:
    """Pages over an empty system of record in a folder."""
    url = f"sqlite:///{folder}/records.sqlite3"
    migrate(url)
    return Site(Database(url))


def fill(site: Site, board: Board) -> None:
    """Publish a board with the submissions behind its scored entries."""
    site.create_phase("sample", shows_reported=True)
    site.publish(board)
    for entry in board.entries:
        if entry.source == "scored" and entry.rank is not None:
            site.keep_submission(entry)


@pytest.fixture(scope="session", name="real_drawings")
def _real_drawings() -> EntryDrawings:
    """Real drawings of a synthetic planner."""
    return real_drawings()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    """Pages over an empty system of record."""
    site = open_site(tmp_path)
    yield site
    site.database.dispose()


@pytest.fixture
def lively_site(site: Site, lively_board: Board) -> Site:
    """Pages over a phase with a lively board."""
    fill(site, lively_board)
    return site


@pytest.fixture(scope="module")
def shown_site(
    tmp_path_factory: pytest.TempPathFactory,
    lively_board: Board,
    paper_board: Board,
    empty_board: Board,
    strategy_board: Board,
) -> Iterator[Site]:
    """Pages over a lively, a paper-only, an empty and an unpublished phase; only read."""
    site = open_site(tmp_path_factory.mktemp("site"))
    fill(site, lively_board)
    site.publish_split()
    for submission_id, planner in (("s0000000kq", 4), ("s0000003kq", 3), ("s0000005kq", 0)):
        site.keep_drawings(submission_id, planner)
    for phase in ("paper", "empty", "unpublished"):
        site.create_phase(phase)
    site.publish(paper_board.model_copy(update={"phase": "paper"}))
    site.publish(empty_board.model_copy(update={"phase": "empty"}))
    site.create_phase("strategy", "strategy")
    site.publish(strategy_board)
    yield site
    site.database.dispose()


@pytest.fixture(scope="session")
def strategy_board(lively_board: Board) -> Board:
    """A board of the strategy challenge: one scored agent, and the paper's two rows."""
    metrics: dict[str, float | None] = {
        "accuracy": 0.6125,
        "under_warning": 0.2875,
        "over_warning": 0.1,
        "missing": 0.0,
    }
    agent = lively_board.entries[0].model_copy(
        update={
            "submission_id": "a0000000kq",
            "method": "Careful agent",
            "metrics": metrics,
            "micro": metrics,
            "macro_family": metrics,
            "intervals": {"accuracy": (0.55, 0.67), "under_warning": (0.23, 0.34)},
            "families": {
                family: FamilyCell.model_validate({"n": n, **metrics})
                for family, n in COUNTS.items()
            },
            "coverage": {"edited": 1.0, "source": None},
        }
    )
    without = agent.model_copy(
        update={
            "submission_id": "a0000001kq",
            "method": "Careful agent, no reminder",
            "rank": 2,
            "previous_rank": 1,
            "metrics": {**metrics, "accuracy": 0.45, "under_warning": 0.44},
        }
    )
    agent = agent.model_copy(update={"reminder_effect": EFFECT})
    printed = reported_entries(ChallengeId.STRATEGY, lively_board.headline)
    return lively_board.model_copy(
        update={"challenge": "strategy", "phase": "strategy", "entries": (agent, without, *printed)}
    )


@pytest.fixture(scope="session")
def sheets(lively_board: Board) -> tuple[ScoreSheet, ScoreSheet]:
    """Score sheets of the first and the third entry."""
    return sheet_of(lively_board.entries[0]), sheet_of(lively_board.entries[2])
