"""A small world: one protocol, one split, one phase, one team."""

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from tests.support.documents import digest_of, make_board, make_sheet
from tests.support.records import add_phase, add_sample_split, found, next_moment
from tests.support.work import claim_board_of, claim_this

from exceptiondrive_records.boards.boards import publish_board
from exceptiondrive_records.boards.standings import entries_for_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import Accepted, accept
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.jobs import finish_scored
from exceptiondrive_records.work.tables import BoardRequest, Job
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.score_sheet import ProtocolRef, ScoreSheet


@dataclass
class World:
    """The database, and the ids of what is in it."""

    database: Database
    team_id: int
    protocol_digest: str
    phase_id: str = "dev"

    def submit(self, content: str, method: str = "method", team_id: int | None = None) -> Accepted:
        next_moment(self.database)
        with self.database.write() as session:
            return accept(
                session,
                team_id=team_id or self.team_id,
                phase_id=self.phase_id,
                method=method,
                file_digest=digest_of(content),
                size_bytes=len(content),
            )

    def claim(self, job_id: str | None, max_attempts: int = 4) -> Job:
        assert job_id is not None
        with self.database.write() as session:
            job = claim_this(session, job_id, 120, max_attempts)
        assert job is not None
        return job

    def finish(self, job: Job, hcc: float = 0.5) -> bool:
        with self.database.write() as session:
            return finish_scored(
                session,
                job,
                self.sheet(hcc),
                exact_digest=f"sha256:{hcc}",
                measurement_key="m",
                scorer_version="1",
            )

    def score(self, job_id: str | None, hcc: float = 0.5) -> None:
        assert self.finish(self.claim(job_id), hcc)

    def scored(
        self,
        content: str,
        method: str = "method",
        team_id: int | None = None,
        hcc: float = 0.5,
    ) -> str:
        """Submit a file and score it; return the id of the submission."""
        accepted = self.submit(content, method, team_id)
        self.score(accepted.job_id, hcc)
        return accepted.submission.id

    def standing(self) -> dict[str, str]:
        """Methods of the submissions that the next board shows."""
        with self.database.read() as session:
            entries = entries_for_board(session, self.phase_id, self.protocol_digest)
            return {entry.submission_id: entry.method for entry in entries}

    def close(self) -> None:
        """Let the deadline be now."""
        with self.database.write() as session:
            session.get_one(Phase, self.phase_id).closes_at = database_now(session)

    def want_board(self) -> None:
        with self.database.write() as session:
            want_board(session, self.phase_id, self.protocol_digest)

    def claim_board(self) -> BoardRequest | None:
        with self.database.write() as session:
            return claim_board_of(session, self.phase_id, self.protocol_digest)

    def publish(self, board: Board) -> BoardRow:
        """Do what a worker does when it has built the board that is wanted."""
        claim = self.claim_board()
        assert claim is not None
        with self.database.write() as session:
            row = publish_board(session, claim, board)
        assert row is not None
        return row

    def board(self, *submission_ids: str) -> Board:
        entries = tuple(
            BoardEntry(
                source="scored",
                rank=rank,
                rank_interval=(1, 2),
                submission_id=submission_id,
                method="method",
                team="Alpha",
                submitted_at=None,
                metrics={"hcc": 0.5},
                micro={"hcc": 0.5},
                macro_family={"hcc": 0.5},
                intervals={},
                families={},
            )
            for rank, submission_id in enumerate(submission_ids, start=1)
        )
        return make_board(
            *entries,
            phase=self.phase_id,
            protocol=ProtocolRef(version="1.0", digest=self.protocol_digest),
            published_at=datetime(2020, 1, 1, tzinfo=UTC),
        )

    def sheet(self, hcc: float = 0.5) -> ScoreSheet:
        row: dict[str, float | None] = {"hcc": hcc, "ur": 0.25, "cts": None}
        return make_sheet(self.protocol_digest, row)


def build_world(database: Database, **limits: Any) -> World:
    with database.write() as session:
        made = found(session, has_tokens=False)
        add_sample_split(session)
        add_phase(
            session,
            title="Development",
            **{"quota_per_day": 100, "rejected_per_day": 100, **limits},
        )
    return World(database, made.team_ids["alpha"], made.protocol.digest)
