"""Which run of a method stands: newest, best or chosen, as phase and team say, until the deadline."""

import pytest
from tests.records.world import World

from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.entries.selection import MAX_CHOICES_A_DAY, choose
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import find_submission, withdraw
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.jobs import finish_scored
from exceptiondrive_schemas.api.phase_settings import RunRule
from exceptiondrive_schemas.score_sheet import Coverage

FULL, ENOUGH, TOO_LITTLE = (Coverage(edited=share, source=1.0) for share in (1.0, 0.99, 0.98))


def runs(world: World, *hccs: float) -> list[str]:
    return [world.scored(f"file {number}", "Planner", hcc=hcc) for number, hcc in enumerate(hccs)]


def allow(world: World) -> None:
    with world.database.write() as session:
        phase = session.get_one(Phase, world.phase_id)
        phase.policy = phase.policy.model_copy(update={"run_choice": "team"})


def say(world: World, submission_id: str, rule: RunRule = "this") -> None:
    with world.database.write() as session:
        choose(session, submission_id, actor="team:1", rule=rule)


def replaced(world: World, submission_id: str) -> str | None:
    with world.database.read() as session:
        return view(session, find_submission(session, submission_id)).replaced_by


def test_the_newest_stands_and_nothing_is_chosen_unless_the_phase_says_so(world: World) -> None:
    first, second = runs(world, 0.9, 0.5)
    assert list(world.standing()) == [second]
    with pytest.raises(Conflict, match=r"nothing to choose.* The newest run of each method"):
        say(world, first)


def test_a_team_says_newest_best_or_one(world: World) -> None:
    allow(world)
    other = world.scored("other", "Other")
    first, best, last = runs(world, 0.5, 0.9, 0.7)
    assert set(world.standing()) == {last, other}
    say(world, last, "best")
    assert set(world.standing()) == {best, other}
    assert (replaced(world, last), replaced(world, best)) == (best, None)
    say(world, first)
    assert set(world.standing()) == {first, other}
    say(world, first, "newest")
    assert set(world.standing()) == {last, other}


@pytest.mark.postgres
@pytest.mark.parametrize("database_url", ["postgres"], indirect=True)
def test_what_was_withdrawn_meanwhile_is_not_chosen(world: World) -> None:
    """Whoever asks has looked at it before. SQLite takes one writer at a time."""
    allow(world)
    run = world.scored("one", "Planner", hcc=0.5)
    with world.database.write() as session:
        looked_at = find_submission(session, run)
        with world.database.write() as other:
            withdraw(other, run, actor="team:1")
        with pytest.raises(Conflict, match="The submission is withdrawn"):
            choose(session, run, actor="organizer:1")
        assert looked_at.chosen_at is None


def test_a_reference_keeps_all_its_methods_where_each_team_has_one_entry(world: World) -> None:
    first, second = world.scored("one", "One"), world.scored("two", "Two")
    with world.database.write() as session:
        phase = session.get_one(Phase, world.phase_id)
        phase.policy = phase.policy.model_copy(update={"entries_shown": "chosen"})
    assert set(world.standing()) == {second}
    assert replaced(world, first) == second
    with world.database.write() as session:
        session.get_one(Team, world.team_id).is_reference = True
    assert set(world.standing()) == {first, second}
    assert replaced(world, first) is None


def test_a_team_chooses_so_many_times_a_day(world: World) -> None:
    """Each choice may become a board, and no board is ever removed."""
    allow(world)
    both = runs(world, 0.9, 0.5)
    for number in range(MAX_CHOICES_A_DAY):
        say(world, both[number % 2])
    with pytest.raises(Conflict, match="50 times in 24 hours"):
        say(world, both[0])


def test_a_rule_holds_for_runs_to_come_and_a_withdrawn_choice_is_none(world: World) -> None:
    allow(world)
    first, second = runs(world, 0.6, 0.5)
    say(world, first, "best")
    better = world.scored("a third file", "Planner", hcc=0.8)
    assert list(world.standing()) == [better]
    say(world, second)
    assert list(world.standing()) == [second]
    with world.database.write() as session:
        withdraw(session, second, actor="team:1")
    assert list(world.standing()) == [better]


def test_after_the_deadline_the_choice_is_final(world: World) -> None:
    allow(world)
    first, second = runs(world, 0.6, 0.5)
    say(world, first, "best")
    world.close()
    with pytest.raises(Conflict, match="the choice stands as it is"):
        say(world, second)
    with world.database.write() as session:
        withdraw(session, first, actor="team:1")
    assert world.standing() == {}, (
        "withdrawn later it leaves no entry: nobody picks after the outcome"
    )


def test_the_same_score_stands_by_its_newest_run(world: World) -> None:
    allow(world)
    _, second = runs(world, 0.6, 0.6)
    say(world, second, "best")
    assert list(world.standing()) == [second]


@pytest.mark.parametrize(
    ("worse", "better"),
    [
        ((0.5, 0.1, FULL), (0.6, 0.9, FULL)),
        ((0.5, 0.3, FULL), (0.5, 0.2, FULL)),  # UR decides where HCC is the same: less is better
        ((0.5, None, FULL), (0.5, 0.9, FULL)),
        ((0.9, 0.1, TOO_LITTLE), (0.5, 0.9, FULL)),  # it takes no rank
        ((0.5, 0.1, FULL), (0.6, 0.1, ENOUGH)),
    ],
)
@pytest.mark.parametrize("comes_last", ["worse", "better"])
def test_the_best_run_is_the_one_that_would_rank_first(
    world: World,
    worse: tuple[float, float | None, Coverage],
    better: tuple[float, float | None, Coverage],
    comes_last: str,
) -> None:
    allow(world)
    ids = {}
    for name in ("better", "worse") if comes_last == "worse" else ("worse", "better"):
        hcc, ur, coverage = worse if name == "worse" else better
        row = {"hcc": hcc, "ur": ur, "cts": None}
        aggregates = {"micro": row, "macro_family": row, "coverage": coverage}
        accepted = world.submit(name, "Planner")
        job = world.claim(accepted.job_id)
        with world.database.write() as session:
            sheet = world.sheet().model_copy(update=aggregates)
            made = {"exact_digest": "e", "measurement_key": "m", "scorer_version": "1"}
            finish_scored(session, job, sheet, **made)
        ids[name] = accepted.submission.id
    say(world, ids[comes_last], "best")
    assert list(world.standing()) == [ids["better"]]
