"""What a score asks of the records grows with what waits at most in proportion, and with what is over not at all."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import pytest
from sqlalchemy import insert, text
from sqlalchemy.orm import Session
from tests.records.statements import loops_of, steps_of

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.disqualified import disqualified_ids
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.splits.openings import opened_protocols
from exceptiondrive_records.submissions.sheets import is_scored, scored_within_a_day
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.dispatch import mark_queued
from exceptiondrive_records.work.fair_share import fair_order, is_live_work_open, waits
from exceptiondrive_records.work.jobs import give_up_exhausted
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane

World = Any
LONG_AGO = datetime(2026, 1, 1, tzinfo=UTC)
N_TEAMS = 20
on_sqlite = pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
"""Its steps can be counted."""
on_postgres = pytest.mark.parametrize(
    "database_url", [pytest.param("postgres", marks=pytest.mark.postgres)], indirect=True
)


_A_YEAR_OF_JOBS = """
INSERT INTO work (id, key, kind, lane, state, asked, attempts, fence, created_at, available_at, leased_at,
  finished_at, submission_id, team_id, protocol_digest, split_revision, is_first)
SELECT id || '-' || n, key || '-' || n, kind, lane, state, asked, attempts, fence, created_at, available_at, leased_at,
  finished_at, submission_id, team_id, protocol_digest, split_revision, is_first
FROM work, generate_series(1, 50) AS n WHERE kind = 'score'
"""


def add_jobs(world: World, name: str, number: int, state: WorkState) -> None:
    """Each of a submission of its own, of twenty teams in turn."""
    with world.database.write() as session:
        phase = session.get_one(Phase, world.phase_id)
        team_ids = [
            create_team(session, f"{name}-{team}", f"{name} {team}", actor="test").id
            for team in range(N_TEAMS)
        ]
        ids = [f"{name}{index}" for index in range(number)]
        session.execute(
            insert(Submission),
            [
                {
                    "id": name_of_one,
                    "phase_id": phase.id,
                    "team_id": team_ids[index % N_TEAMS],
                    "method": name_of_one,
                    "description": "",
                    "file_digest": name_of_one,
                    "size_bytes": 1,
                    "status": SubmissionStatus.QUEUED,
                    "received_at": LONG_AGO,
                    "status_at": LONG_AGO,
                }
                for index, name_of_one in enumerate(ids)
            ],
        )
        session.execute(
            insert(Job),
            [
                {
                    "id": name_of_one,
                    "key": name_of_one,
                    "lane": Lane.LIVE,
                    "state": state,
                    "asked": 1,
                    "attempts": 0,
                    "fence": 0,
                    "created_at": LONG_AGO,
                    "available_at": LONG_AGO,
                    "leased_at": None if state is WorkState.QUEUED else LONG_AGO,
                    "finished_at": None if state is WorkState.QUEUED else LONG_AGO,
                    "submission_id": name_of_one,
                    "team_id": team_ids[index % N_TEAMS],
                    "protocol_digest": phase.protocol_digest,
                    "split_revision": phase.split_revision,
                    "is_first": True,
                }
                for index, name_of_one in enumerate(ids)
            ],
        )


def add_old_sheets(world: World, name: str, number: int) -> None:
    add_jobs(world, name, number, WorkState.DONE)
    with world.database.write() as session:
        phase = session.get_one(Phase, world.phase_id)
        session.execute(
            insert(ScoreSheetRow),
            [
                {
                    "submission_id": f"{name}{index}",
                    "protocol_digest": phase.protocol_digest,
                    "split_revision": phase.split_revision,
                    "sheet": world.sheet(),
                    "exact_digest": "sha256:0",
                    "measurement_key": "m",
                    "scorer_version": "1",
                    "created_at": LONG_AGO,
                }
                for index in range(number)
            ],
        )


def next_in_turn(session: Session) -> object:
    return session.scalars(fair_order(waits(Lane.LIVE), Lane.LIVE).limit(1)).one()


@on_sqlite
def test_who_comes_next_costs_in_proportion_to_what_waits(world: World) -> None:
    add_jobs(world, "some", 100, WorkState.QUEUED)
    of_100 = steps_of(world.database, next_in_turn)
    add_jobs(world, "more", 700, WorkState.QUEUED)
    of_800 = steps_of(world.database, next_in_turn)
    assert of_800 < 1.5 * 8 * of_100


def next_to_claim(session: Session) -> object:
    firsts = fair_order(waits(Lane.LIVE), Lane.LIVE, firsts_alone=True)
    return session.scalars(firsts.limit(1)).one()


@on_sqlite
def test_a_claim_costs_what_there_are_teams_not_what_waits_or_is_over(world: World) -> None:
    add_jobs(world, "some", 100, WorkState.QUEUED)
    of_100 = steps_of(world.database, next_to_claim)
    add_jobs(world, "more", 700, WorkState.QUEUED)  # of as many teams again
    assert steps_of(world.database, next_to_claim) <= 2 * of_100 + 2
    add_jobs(world, "done", 900, WorkState.DONE)  # and again
    assert steps_of(world.database, next_to_claim) <= 3 * of_100 + 2


@on_postgres
@pytest.mark.parametrize("read", [next_to_claim, next_in_turn])
def test_a_rush_after_a_quiet_year_repeats_no_step_for_each_pair_of_teams(
    world: World, read: Callable[[Session], object]
) -> None:
    """PostgreSQL plans by what it counted when nothing waited."""
    add_jobs(world, "done", 400, WorkState.DONE)
    with world.database.write() as session:
        session.execute(text(_A_YEAR_OF_JOBS))
        session.execute(text("ANALYZE"))
    for name in ("rush", "more", "most"):
        add_jobs(world, name, N_TEAMS, WorkState.QUEUED)
    assert loops_of(world.database, read) <= 3 * 4 * N_TEAMS


@on_sqlite
@pytest.mark.parametrize(
    "read",
    [
        next_in_turn,
        is_live_work_open,
        lambda session: scored_within_a_day(session, "sample", database_now(session), besides="x"),
        lambda session: opened_protocols(session, "sample"),
        lambda session: is_scored(session, "sample", "old1"),
        mark_queued,
        lambda session: give_up_exhausted(session, 3),
        lambda session: disqualified_ids(session, "other"),
    ],
    ids=[
        "next in turn",
        "live work open",
        "scored today",
        "protocols",
        "is scored",
        "to show as queued",
        "to give up",
        "disqualified in another phase",
    ],
)
def test_what_is_over_costs_nothing(world: World, read: Callable[[Session], object]) -> None:
    add_jobs(world, "waiting", 40, WorkState.QUEUED)
    add_old_sheets(world, "old", 50)
    before = steps_of(world.database, read)
    add_old_sheets(world, "older", 400)
    assert steps_of(world.database, read) <= before + 2
