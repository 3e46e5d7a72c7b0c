"""The pages over real records, for tests: a site to publish boards, submissions and drawings on."""

import shutil
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from fastapi import APIRouter, FastAPI
from tests.server.pages.invented_board import (
    COUNTS,
    DATASHEET,
    LONG_AGO,
    MANIFEST,
    PROTOCOL,
    N,
)
from tests.support.work import claim_board_of

from exceptiondrive_records.boards.boards import publish_board
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.drawings import find_public_split, keep_entry_drawings
from exceptiondrive_records.splits.splits import publish_split, register_split
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import (
    Board,
    BoardEntry,
)
from exceptiondrive_schemas.challenges import PLANNING, ChallengeId
from exceptiondrive_schemas.datasheet import SplitWarnings
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_schemas.protocol import (
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    ClearanceCurve,
    Coverage,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.arrays import split_arrays
from exceptiondrive_scoring.challenge import scoring_of
from exceptiondrive_server.boards import api as boards
from exceptiondrive_server.boards import pages as board_pages
from exceptiondrive_server.routes import PAGES
from exceptiondrive_server.splits import api as splits
from exceptiondrive_server.web.browser_session import lead_browsers
from exceptiondrive_server.web.kept_pages import KeptPages
from exceptiondrive_server.web.problems import install_problem_handlers
from exceptiondrive_server.web.services import SiteState
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_server.web.static_files import mount_static
from exceptiondrive_worker.sample.planners import PLANNERS, predictions
from exceptiondrive_worker.sample.scenes import SEED, sample_scenes, sample_split

ROUTES = APIRouter()  # of all sites: what a route takes and gives is worked out once
ROUTES.include_router(board_pages.front)
for _page in PAGES:
    ROUTES.include_router(_page)
ROUTES.include_router(boards.router, prefix="/api/v1", include_in_schema=False)
ROUTES.include_router(splits.router, prefix="/api/v1", include_in_schema=False)


class Services:
    """What pages need of the server: the records, and the settings."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self.settings = ServerSettings()
        self.files = FileStore("memory:///")
        self.provider = None
        self.kept_pages = KeptPages()
        self.site_state = SiteState(database)


class Site:
    """The pages over real records, on an application of their own."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self.app = FastAPI()
        self.app.state.services = Services(database)
        self.app.router.routes.extend(ROUTES.routes)
        install_problem_handlers(self.app)
        lead_browsers(self.app)
        mount_static(self.app)

    async def get(self, path: str, **headers: str) -> httpx.Response:
        return await self._send("GET", path, headers)

    async def post(self, path: str, data: dict[str, str]) -> httpx.Response:
        return await self._send("POST", path, {}, data)

    async def _send(
        self, method: str, path: str, headers: dict[str, str], data: dict[str, str] | None = None
    ) -> httpx.Response:
        transport = httpx.ASGITransport(app=self.app)
        named = {key.replace("_", "-"): value for key, value in headers.items()}
        named = {"accept": "text/html", **named}
        async with httpx.AsyncClient(transport=transport, base_url="http://site.test") as client:
            return await client.request(method, path, headers=named, data=data)

    def publish(self, board: Board, late: Board | None = None) -> None:
        """Publish a board of a phase that exists, and the board of its late view if there is one."""
        with self.database.write() as session:
            want_board(session, board.phase, board.protocol.digest)
        with self.database.write() as session:
            claim = claim_board_of(session, board.phase, board.protocol.digest)
            assert claim is not None
            assert publish_board(session, claim, board, late) is not None

    def create_phase(
        self,
        phase_id: str,
        challenge: str = "planning",
        manifest: Manifest = MANIFEST,
        protocol: str = "1.0",
        **more: Any,
    ) -> None:
        """Create a phase over a split, by default the small one, registering protocol and split."""
        with self.database.write() as session:
            add_protocol(session, packaged_protocol_toml(), "test")
            made: dict[str, Any] = {
                "datasheet": DATASHEET,
                "changes": DATASHEET.changes,
                "warnings": SplitWarnings(found=DATASHEET.warnings),
            }
            told = made if manifest is MANIFEST else {}
            register_split(session, manifest, COUNTS, "test", **told)
            create_phase(
                session,
                NewPhase(
                    id=phase_id,
                    challenge=ChallengeId(challenge),
                    title=phase_id.replace("-", " ").title(),
                    split=manifest.name,
                    protocol=protocol,
                    **({"quota_per_day": 3, "quota_total": None} | more),
                ),
                actor="test",
            )

    def publish_split(self) -> None:
        """Make the small split a development split."""
        with self.database.write() as session:
            publish_split(session, "sample", MANIFEST.revision, "sha256:" + "5" * 64, "test")

    def keep_drawings(self, submission_id: str, planner: int = 1) -> None:
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

    def keep_submission(
        self, entry: BoardEntry, phase_id: str = "sample", sheet: ScoreSheet | None = None
    ) -> None:
        """Record the submission and the score sheet behind a scored entry."""
        assert entry.submission_id is not None
        assert entry.submitted_at is not None
        with self.database.write() as session:
            slug = f"team-{entry.submission_id}"
            team = Team(slug=slug, name=slug, is_reference=False, created_at=entry.submitted_at)
            session.add(team)
            session.flush()
            session.add(_submission(entry, team.id, phase_id))
            session.flush()
            session.add(
                ScoreSheetRow(
                    submission_id=entry.submission_id,
                    protocol_digest=PROTOCOL.digest,
                    split_revision=MANIFEST.revision,
                    sheet=sheet or sheet_of(entry),
                    exact_digest="sha256:" + "e" * 64,
                    measurement_key="m" * 64,
                    scorer_version="1.0.0",
                    created_at=entry.submitted_at,
                )
            )


def _submission(entry: BoardEntry, team_id: int, phase_id: str) -> Submission:
    return Submission(
        id=entry.submission_id,
        phase_id=phase_id,
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
        challenge=PLANNING.id,
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
def real_drawings(planner: int = 1) -> EntryDrawings:
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
    scoring = scoring_of(PLANNING.id)
    measured = scoring.measure(columns, split, PROTOCOL.geometry)
    drawings = scoring.drawings(columns, measured, ids, split, PROTOCOL)
    assert drawings is not None
    return drawings


def open_site(folder: Path, migrated: Path) -> Site:
    """Pages over an empty system of record in a folder, copied from a migrated one."""
    path = shutil.copy(migrated, folder / "records.sqlite3")
    return Site(Database(f"sqlite:///{path}"))


def fill(site: Site, board: Board) -> None:
    """Publish a board with the submissions behind its scored entries."""
    site.create_phase("sample", shows_reported=True)
    site.publish(board)
    for entry in board.entries:
        if entry.source == "scored" and entry.rank is not None:
            site.keep_submission(entry)


def publish_late_view(site: Site, board: Board) -> None:
    """Make a phase `late` whose late view is led by an entry that its board does not hold.

    The sheet of that entry has a clearance curve in fine steps.
    """
    site.create_phase("late")
    late = board.entries[0].model_copy(update={"submission_id": "l0000000kq", "is_late": True})
    in_time = tuple(entry for entry in board.entries if entry.submission_id != "s0000000kq")
    main = board.model_copy(update={"phase": "late", "entries": in_time})
    both = main.model_copy(update={"view": "late", "entries": (late, *in_time)})
    site.publish(main, both)
    kept = tuple(0.9 * (1 - step / 40) for step in range(41))
    curve = ClearanceCurve(step=0.05, micro=kept, macro_family=kept)
    sheet = sheet_of(late).model_copy(update={"clearance_curve": curve})
    site.keep_submission(late, "late", sheet)
