"""One table says what may be done with a run: records, API and page go by it."""

from collections.abc import Callable
from itertools import product
from typing import Any

import pytest

from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_schemas.api.rescoring import (
    TRANSITIONS,
    RunAction,
    RunState,
    actions_of,
    next_states,
)
from exceptiondrive_server.rescoring.steps import RUN_STEPS, offered

Stage = Any
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")


def test_a_run_that_has_ended_goes_nowhere() -> None:
    for state in RunState:
        assert (actions_of(state, has_failed=True) == ()) is state.is_final


def test_every_action_has_a_page() -> None:
    assert set(RUN_STEPS) == set(RunAction) == set(TRANSITIONS)


def test_records_and_page_go_by_the_table(stage: Stage, make_protocol: Callable[..., str]) -> None:
    stage.add_protocol(make_protocol("1.1", *D_SAFE))
    run_id = stage.draft(protocol="1.1")
    flips = {RunAction.APPLY: lambda: stage.apply(run_id, "x")}
    flips[RunAction.ROLLBACK] = lambda: stage.rollback(run_id)
    for state, action in product(RunState, RunAction):
        with stage.owner.write() as session:
            find_run(session, run_id).state = state
        view = stage.view(run_id)
        is_possible = state in next_states(action, has_failed=False)
        assert (action in view.actions) is is_possible
        if (state, action) != (RunState.SCORING, RunAction.RESUME):  # shown if sheets have failed
            assert (action in [step.key for step in offered(view)]) is is_possible
        if is_possible and action not in flips:
            stage.step(action.value, run_id)
            assert stage.view(run_id).state is TRANSITIONS[action][state]
        elif not is_possible:
            with pytest.raises(Conflict):
                flips.get(action, lambda what=action.value: stage.step(what, run_id))()
            assert stage.view(run_id).state is state
