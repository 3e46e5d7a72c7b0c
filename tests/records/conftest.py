"""A small world: one protocol, one split, one phase, one team."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from tests.support.documents import make_manifest, make_sheet
from tests.support.work import claim_this

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.splits import register_split
from exceptiondrive_records.submissions.submissions import Accepted, accept
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.jobs import Finish, finish_scored
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.phase_settings import NewPhase
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.score_sheet import ScoreSheet


def digest_of(text: str) -> str:
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


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


def build_world(
    database: Database,
    *,
    quota_per_day: int = 100,
    rejected_per_day: int = 20,
    quota_concurrent: int | None = None,
) -> World:
    with database.write() as session:
        protocol = add_protocol(session, packaged_protocol_toml(), "test")
        register_split(session, make_manifest(), {"sudden_emergence": 3}, "test")
        create_phase(
            session,
            NewPhase(
                id="dev",
                challenge=PLANNING.id,
                title="Development",
                split="sample",
                protocol="1.0",
                quota_per_day=quota_per_day,
                rejected_per_day=rejected_per_day,
                quota_concurrent=quota_concurrent,
            ),
            actor="test",
        )
        team = create_team(session, "alpha", "Alpha", actor="test")
        return World(database, team.id, protocol.digest)


@pytest.fixture
def world(database: Database) -> World:
    return build_world(database)


@pytest.fixture
def make_world(database: Database) -> Callable[..., World]:
    """Build the world with other limits."""
    return lambda **limits: build_world(database, **limits)


@pytest.fixture
def world_on() -> Callable[[str], World]:
    """Build the world on a database address."""
    return lambda url: build_world(Database(url))
