"""Overload: uploads beyond what one process takes at once are sent away before they are read."""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress

import pytest

from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.limits.upload_places import UploadPlaces
from exceptiondrive_server.web.problem_vocabulary import ApiProblem

ALPHA, BETA, GAMMA = 1, 2, 3


def refusal(hold: Callable[[], AbstractContextManager[None]]) -> ApiProblem:
    with pytest.raises(ApiProblem) as caught, hold():
        pass
    assert caught.value.retry_after_s
    assert "Nothing was taken" in caught.value.detail
    return caught.value


def test_a_team_has_few_places_and_leaves_the_others_free() -> None:
    places = UploadPlaces(at_once=3, per_team=2)
    with places.held_by(ALPHA), places.held_by(ALPHA):
        assert refusal(lambda: places.held_by(ALPHA)).code is ProblemCode.TOO_MANY_REQUESTS
        with places.held_by(BETA):
            assert refusal(lambda: places.held_by(GAMMA)).code is ProblemCode.STORE_UNAVAILABLE
        with places.held_by(GAMMA):
            pass
    with places.held_by(ALPHA), places.held_by(ALPHA):
        pass


def test_eight_teams_together_leave_places_for_others() -> None:
    """Four of them have four places each; then half are taken, and every further team has one."""
    places = UploadPlaces(at_once=32, per_team=4)
    with ExitStack() as stack:
        for team in range(8):
            for _ in range(4):
                with suppress(ApiProblem):
                    stack.enter_context(places.held_by(team))
        assert places.taken == 4 * 4 + 4
        for team in range(8, 20):
            stack.enter_context(places.held_by(team))
        assert refusal(lambda: places.held_by(20)).code is ProblemCode.STORE_UNAVAILABLE


def test_an_upload_that_breaks_off_leaves_its_place() -> None:
    places = UploadPlaces(at_once=1, per_team=1)
    with pytest.raises(ConnectionError), places.held_by(ALPHA):
        raise ConnectionError
    with ExitStack() as stack:
        stack.enter_context(places.held_by(BETA))
        assert refusal(lambda: places.held_by(ALPHA)).code is ProblemCode.STORE_UNAVAILABLE
