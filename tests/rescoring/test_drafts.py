"""What a run is refused, and in which words: before it begins, while sheets fail, while it is frozen."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from tests.rescoring.stage import open_stage
from tests.support.floors import write_floors
from tests.support.work import claim_this
from tests.support.worker import build_wanted_boards

from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.phases.changes import freeze_phase
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.work.jobs import finish_failed
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker.boards.run import build_next_board

Stage = Any
Ready = tuple[Stage, str]
Make = Callable[..., str]
pytestmark = pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")


def refused(what: Callable[[], object]) -> str:
    with pytest.raises((Conflict, InvalidRecord)) as found:
        what()
    return str(found.value)


def test_what_accepted_files_cannot_be_scored_under_is_refused(
    stage: Stage, make_protocol: Make, make_split: Callable[..., Any]
) -> None:
    stage.add_protocol(make_protocol("2.0", "waypoints = 6", "waypoints = 8"))
    assert refused(lambda: stage.draft(protocol="2.0")) == (
        "The protocol asks for 8 waypoints 0.5 s apart; accepted files hold 6 waypoints 0.5 s "
        "apart: they cannot be scored under it. Open a new phase for it instead."
    )
    with pytest.raises(NotFound, match="no registered revision of split 'tiny' like 'sha256:0'"):
        stage.draft(split_revision="sha256:0")
    whole = make_split()
    one_more = whole.samples[0].model_copy(update={"sample_id": "e"})
    for name, samples, words in (
        ("split-less.json", whole.samples[1:], "lacks 1 sample that accepted files answer"),
        (
            "split-more.json",
            (*whole.samples, one_more),
            "has 1 sample that no accepted file answers",
        ),
    ):
        changed = whole.model_copy(update={"samples": samples})
        stage.put_split(changed, name)
        assert words in refused(partial(stage.draft, split_revision=changed.revision))


def test_a_run_of_a_phase_whose_own_protocol_the_floors_refuse_says_the_way_out(
    database_url: str, tmp_path: Path, make_protocol: Make
) -> None:
    with open_stage(database_url, tmp_path) as stage:
        write_floors(stage.settings.splits_dir / "tiny", "min_samples_per_cell = 100")
        stage.open_phase("planning")
        stage.add_protocol(
            make_protocol("1.1", "min_samples_per_cell = 1\n", "min_samples_per_cell = 100\n")
        )
        run_id = stage.draft(protocol="1.1")
        stage.step("start", run_id)
        tend_runs(stage.reconciler, 3)
        assert build_next_board(stage.context, Lane.RESCORE)
        tend_runs(stage.reconciler, 3)
        assert stage.view(run_id).state.value == "ready"
        (way_out,) = stage.view(run_id).blockers
        assert "open a new phase under the new protocol" in way_out
        assert refused(lambda: stage.preview(run_id)).endswith(way_out)
        assert refused(lambda: stage.apply(run_id, "sha256:0")) == way_out


def test_a_challenge_without_waypoints_takes_a_protocol_with_others(
    agents: Stage, make_protocol: Make
) -> None:
    agents.add_protocol(make_protocol("2.0", "waypoints = 6", "waypoints = 8"))
    assert agents.draft(protocol="2.0")


def fail(stage: Stage) -> str:
    """Let the next waiting job fail for good; return its submission."""
    with stage.database.write() as session:
        job = session.scalars(select(Job).where(Job.state == WorkState.QUEUED)).first()
        assert job is not None
        claimed = claim_this(session, job.id, 60, 4)
        assert claimed is not None
        finish_failed(session, claimed, "out_of_memory", "Too large.", retry=False)
    return str(claimed.submission_id)


@pytest.mark.parametrize("state", ["ready", "applied"])
def test_a_sheet_that_fails_late_is_named_and_can_be_tried_again(ready: Ready, state: str) -> None:
    stage, run_id = ready
    if state == "applied":
        stage.apply(run_id)
    assert "can be resumed only while" in refused(lambda: stage.step("resume", run_id))
    late = stage.submit(3.0, "late")
    assert stage.work(most=1) == 1  # the live one: it shows the fate of the submission
    assert fail(stage) == late
    view = stage.view(run_id)
    (blocker,) = view.blockers
    assert blocker.startswith(
        f"1 sheet could not be made (out_of_memory): of {late}. Give the workers more"
    )
    assert (view.state.value, view.progress.remaining_s) == (state, None)
    stage.step("resume", run_id)
    stage.work()
    assert (stage.view(run_id).blockers, stage.view(run_id).state.value) == ((), state)


def test_each_refusal_says_the_state_and_what_is_possible(
    stage: Stage, make_protocol: Make
) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = stage.draft(protocol="1.1")
    assert refused(lambda: stage.apply(run_id, "x")) == (
        "Scoring has not begun: start it on its page, or by `organizer rescore begin`."
    )
    assert refused(lambda: stage.draft(protocol="1.1")) == (
        f"The phase has an open run, {run_id} (a draft); begin or cancel it first."
    )
    assert refused(lambda: stage.rollback(run_id)) == (
        "The run is a draft; it can be rolled back only while it is applied."
    )
    stage.step("start", run_id)
    stage.work(most=3)
    tend_runs(stage.reconciler, 4)
    build_wanted_boards(stage.context)
    stage.step("pause", run_id)
    assert stage.view(run_id).blockers == ("The run is paused: resume it.",)
    assert not stage.preview(run_id).is_stale
    assert "only while it is applied" in refused(lambda: stage.rollback(run_id))
    assert "The run is paused: resume it." in refused(lambda: stage.apply(run_id, "x"))
    stage.step("cancel", run_id)
    assert refused(lambda: stage.step("cancel", run_id)) == (
        "The run is cancelled already; it can be cancelled only while it is a draft, scoring, "
        "paused or ready."
    )
    assert not stage.preview(run_id).is_stale  # nothing newer will come


def test_a_frozen_board_is_neither_applied_nor_rolled_back(ready: Ready) -> None:
    stage, run_id = ready
    stage.apply(run_id)
    again = stage.preview(run_id).digest
    with stage.database.write() as session:
        freeze_phase(session, "dev", reason="the last hour", actor="organizer")
    shown = stage.board()
    stage.submit(3.0, "after the freeze")
    stage.work()
    words = "rolling back would show what the freeze hides. Reveal the board first."
    assert words in refused(lambda: stage.rollback(run_id))
    stage.step("close", run_id)
    back = stage.draft(protocol="1.0")
    stage.step("start", back)
    stage.work()
    assert "applying would show what the freeze hides" in refused(lambda: stage.apply(back, again))
    assert stage.board() == shown
