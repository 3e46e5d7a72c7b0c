"""A small world: one protocol, one split, one phase, one team."""

from dataclasses import dataclass
from typing import Any

from tests.support.documents import digest_of, make_sheet
from tests.support.records import add_phase, add_sample_split, found
from tests.support.work import claim_this

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.submissions import Accepted, accept
from exceptiondrive_records.work.jobs import Finish, finish_scored
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.score_sheet import ScoreSheet


@dataclass
class World:
    """The database, and the ids of what is in it."""

    database: Database
    team_id: int
    protocol_digest: str
    phase_id: str = "dev"

    def submit(self, content: str, method: str = "method", team_id: int | None = None) -> Accepted:
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

    def finish(self, job: Job, hcc: float = 0.5) -> Finish:
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
        assert self.finish(self.claim(job_id), hcc) is Finish.RECORDED

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
