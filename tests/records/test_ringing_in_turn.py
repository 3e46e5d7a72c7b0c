"""Teams take turns: one team's flood does not delay another's first file."""

from collections.abc import Callable
from typing import Any

from exceptiondrive_records.doorbell import Doorbell
from exceptiondrive_records.ringing import due_jobs, mark_rung, ring_job
from exceptiondrive_records.settings import RecordsSettings
from exceptiondrive_records.tables import Job, Submission
from exceptiondrive_records.teams import create_team
from exceptiondrive_schemas.jobs import Lane

World = Any
SETTINGS = RecordsSettings(window=6)


def order(world: World, settings: RecordsSettings = SETTINGS) -> list[str]:
    """The methods of the jobs that would be rung for now."""
    with world.database.read() as session:
        due = due_jobs(session, Lane.LIVE, settings)
        jobs = [session.get_one(Job, found.job_id) for found in due]
        return [session.get_one(Submission, job.submission_id).method for job in jobs]


def add_team(world: World, slug: str) -> int:
    with world.database.write() as session:
        return create_team(session, slug, slug.title(), actor="test").id


def flood(world: World, name: str, n: int, team_id: int | None = None) -> list[Any]:
    return [world.submit(f"{name}{i}", f"{name}{i}", team_id) for i in range(n)]


def test_a_flood_does_not_delay_another_teams_first_file(world: World) -> None:
    flood(world, "flood", 40)
    flood(world, "small", 2, add_team(world, "beta"))
    assert order(world) == ["flood0", "small0", "flood1", "small1", "flood2", "flood3"]


def test_what_a_team_has_under_way_counts(world: World) -> None:
    flood(world, "flood", 40)
    with world.database.write() as session:
        for due in due_jobs(session, Lane.LIVE, RecordsSettings(window=4)):
            mark_rung(session, due)
    flood(world, "small", 3, add_team(world, "beta"))
    assert order(world) == ["small0", "small1"], "room for two: both go to the idle team"


def test_within_a_team_the_oldest_goes_first(world: World) -> None:
    flood(world, "f", 5)
    assert order(world) == ["f0", "f1", "f2", "f3", "f4"]


def test_an_upload_does_not_ring_past_those_who_wait(
    make_world: Callable[..., World], broker: Any
) -> None:
    world = make_world()
    bell = Doorbell(broker.url)
    first, second = flood(world, "f", 2)
    assert ring_job(world.database, bell, second.job_id, SETTINGS) is False
    assert ring_job(world.database, bell, first.job_id, SETTINGS) is True
    assert ring_job(world.database, bell, second.job_id, SETTINGS) is True
    bell.close()
