"""A pytest plugin: a small story, truly lived by records and files, for whoever checks or keeps them."""

import dataclasses
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select, text
from sqlalchemy.orm import Session
from tests.chaos.history import BoardSeen, Call, History, Sighting
from tests.support.documents import REVISION, make_manifest
from tests.support.records import add_phase, add_sample_split, found
from tests.support.work import claim_board_of, claim_this

from exceptiondrive_records.boards.boards import publish_board
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.submissions import accept
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.score_sheet import Coverage, Plausibility, ProtocolRef, ScoreSheet
from exceptiondrive_schemas.split import SplitRef

SPLIT = SplitRef(name="sample", revision=REVISION)


@dataclass
class Story:
    """Two teams, three submissions: two scored and ranked, one failed."""

    database: Database
    files: FileStore
    folder: Path
    history: History
    scored: tuple[str, str]
    failed: str

    def plant(self, change: Callable[[Session], None]) -> None:
        with self.database.write() as session:
            change(session)


def _sheet(protocol: ProtocolRef, hcc: float) -> ScoreSheet:
    row: dict[str, float | None] = {"hcc": hcc, "ur": 0.25}
    return ScoreSheet(
        challenge=PLANNING.id,
        protocol=protocol,
        split=SPLIT,
        scorer_version="1",
        n=2,
        coverage=Coverage(edited=1.0, source=1.0),
        micro=row,
        macro_family=row,
        families={},
        tasks={},
        plausibility=Plausibility(shares={}),
    )


def told_sheet(protocol: ProtocolRef, hcc: float) -> dict[str, Any]:
    """A sheet as a team is told it."""
    told: dict[str, Any] = json.loads(_sheet(protocol, hcc).model_dump_json(by_alias=True))
    return told


def _found(database: Database) -> ProtocolRef:
    """Make protocol, split, phase and teams."""
    manifest = make_manifest().model_copy(update={"sample_ids": ("a", "b")})
    with database.write() as session:
        made = found(session, ("alpha", "beta"), has_tokens=False)
        add_sample_split(session, manifest)
        add_phase(session, title="Dev", quota_per_day=2)
    return made.protocol


class _Teller:
    """Lives the story: uploads as the server takes them, scores as a worker records them."""

    def __init__(self, database: Database, files: FileStore) -> None:
        self.database = database
        self.files = files
        self.history = History()
        self.protocol = _found(database)

    def submit(self, team_id: int, content: str) -> str:
        digest, size = self.files.put_stream([content.encode()], limit_bytes=100)
        with self.database.write() as session:
            taken = accept(
                session,
                team_id=team_id,
                phase_id="dev",
                method=content,
                file_digest=digest,
                size_bytes=size,
            )
        team = ("alpha", "beta")[team_id - 1]
        new = taken.submission
        self.history.note(Call(team, digest, content, team_id, 0.1, 202, new.id))
        return new.id

    def finish(self, submission_id: str, hcc: float | None) -> None:
        with self.database.write() as session:
            row = session.get_one(Submission, submission_id)
            (job_id,) = session.scalars(select(Job.id).where(Job.submission_id == row.id))
            claim = claim_this(session, job_id, 60, 3)
        assert claim is not None
        with self.database.write() as session:
            if hcc is None:
                done = jobs.finish_failed(session, claim, "internal_error", "Sorry.", retry=False)
            else:
                done = jobs.finish_scored(
                    session,
                    claim,
                    _sheet(self.protocol, hcc),
                    exact_digest=f"sha256:{hcc}",
                    measurement_key="m",
                    scorer_version="1",
                )
        assert done
        status = "failed" if hcc is None else "scored"
        sheet = None if hcc is None else told_sheet(self.protocol, hcc)
        self.history.note(Sighting(10.0, submission_id, status, sheet))

    def publish(self, ranked: tuple[str, ...]) -> None:
        with self.database.write() as session:
            claim = claim_board_of(session, "dev", self.protocol.digest)
            assert claim is not None
            entries = tuple(
                self._entry(session, submission_id, rank)
                for rank, submission_id in enumerate(ranked, start=1)
            )
            row = publish_board(session, claim, self._board(entries))
            assert row is not None
        self.history.note(BoardSeen(20.0, 0.1, row.body_digest, row.body.encode()))

    def _entry(self, session: Session, submission_id: str, rank: int) -> BoardEntry:
        submission = session.get_one(Submission, submission_id)
        sheet = session.get_one(ScoreSheetRow, (submission_id, self.protocol.digest, REVISION))
        return BoardEntry(
            source="scored",
            rank=rank,
            rank_interval=(rank, rank),
            submission_id=submission_id,
            method=submission.method,
            team=str(submission.team_id),
            submitted_at=submission.received_at,
            metrics=sheet.sheet.macro_family,
            micro=sheet.sheet.micro,
            macro_family=sheet.sheet.macro_family,
            intervals={},
            families={},
        )

    def _board(self, entries: tuple[BoardEntry, ...]) -> Board:
        return Board(
            challenge=PLANNING.id,
            phase="dev",
            split=SPLIT,
            protocol=self.protocol,
            headline="macro_family",
            board=0,
            published_at=datetime.fromtimestamp(0, UTC),
            n_samples=2,
            confidence=0.95,
            families=(),
            entries=entries,
        )


def tell(database: Database, folder: Path) -> Story:
    files = FileStore((folder / "uploads").as_uri())
    teller = _Teller(database, files)
    best, second = teller.submit(1, "best"), teller.submit(2, "second")
    failed = teller.submit(1, "failed")
    teller.finish(best, 0.75)
    teller.finish(second, 0.5)
    teller.finish(failed, None)
    teller.publish((best, second))
    return Story(database, files, folder, teller.history, (best, second), failed)


@pytest.fixture
def story(database: Database, tmp_path: Path) -> Story:
    """The story on SQLite, then on PostgreSQL."""
    return tell(database, tmp_path)


@pytest.fixture(scope="session")
def told_once(migrated_sqlite: Path, tmp_path_factory: pytest.TempPathFactory) -> Story:
    """The story on SQLite, to copy from; without the triggers that forbid what is planted."""
    folder = tmp_path_factory.mktemp("story")
    shutil.copy(migrated_sqlite, folder / "records.sqlite3")
    database = Database(f"sqlite:///{folder / 'records.sqlite3'}")
    story = tell(database, folder)
    with database.write() as session:
        names = session.scalars(text("SELECT name FROM sqlite_master WHERE type = 'trigger'"))
        for name in list(names):
            session.execute(text(f'DROP TRIGGER "{name}"'))
    database.dispose()
    return story


@pytest.fixture
def embedded_story(told_once: Story, tmp_path: Path) -> Iterator[Story]:
    """A copy of the story on SQLite that a test may spoil."""
    folder = tmp_path / "copy"
    shutil.copytree(told_once.folder, folder)
    database = Database(f"sqlite:///{folder / 'records.sqlite3'}")
    files = FileStore((folder / "uploads").as_uri())
    history = told_once.history.so_far()
    yield dataclasses.replace(
        told_once, database=database, files=files, folder=folder, history=history
    )
    database.dispose()


@dataclass(frozen=True)
class Lived:
    """Records and uploads on SQLite."""

    url: str
    database: Database
    files: FileStore
    uploads: Path


@pytest.fixture
def lived(tmp_path: Path, migrated_sqlite: Path) -> Iterator[Lived]:
    """The story of the fault suite's checker."""
    folder = tmp_path / "lived"
    folder.mkdir()
    shutil.copy(migrated_sqlite, folder / "records.sqlite3")
    url = f"sqlite:///{folder / 'records.sqlite3'}"
    database = Database(url)
    story = tell(database, folder)
    yield Lived(url, database, story.files, folder / "uploads")
    database.dispose()
