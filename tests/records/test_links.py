"""Linked submissions: with and without reminder, of one team in one phase."""

from collections.abc import Callable
from typing import Any

import pytest

from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.submissions.submissions import Accepted, accept, withdraw
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.challenges import ChallengeId

PHASE = "reasoning"


@pytest.fixture
def strategy_world(world: Any) -> Any:
    """A world whose phase is of the strategy challenge."""
    make_phase(world, PHASE)
    world.phase_id = PHASE
    return world


def make_phase(world: Any, phase_id: str, challenge: str = "strategy") -> None:
    with world.database.write() as session:
        create_phase(
            session,
            NewPhase(
                id=phase_id,
                challenge=ChallengeId(challenge),
                title=phase_id,
                description="",
                split="sample",
                protocol=world.protocol_digest,
                quota_per_day=50,
            ),
            actor="test",
        )


def link(world: Any, content: str, linked_to: str | None, **changed: Any) -> Accepted:
    wanted: dict[str, Any] = {
        "team_id": world.team_id,
        "phase_id": world.phase_id,
        "method": f"method {content}",
        "file_digest": "sha256:" + content.encode().hex().ljust(64, "0"),
        "size_bytes": len(content),
        "linked_to": linked_to,
    }
    with world.database.write() as session:
        return accept(session, **wanted | changed)


def test_a_link_is_kept_and_shown_to_the_team(strategy_world: Any) -> None:
    plain = link(strategy_world, "plain", None)
    reminded = link(strategy_world, "reminded", plain.submission.id)
    with strategy_world.database.read() as session:
        assert view(session, reminded.submission).linked_to == plain.submission.id
        assert view(session, plain.submission).linked_to is None


def test_a_submission_of_another_team_is_not_found(strategy_world: Any) -> None:
    with strategy_world.database.write() as session:
        other = create_team(session, "others", "Others", actor="test").id
    plain = link(strategy_world, "plain", None, team_id=other)
    with pytest.raises(NotFound, match="of your team"):
        link(strategy_world, "reminded", plain.submission.id)


def test_a_submission_that_does_not_exist_is_not_found(strategy_world: Any) -> None:
    with pytest.raises(NotFound):
        link(strategy_world, "reminded", "nothing")


def test_a_submission_of_another_phase_is_refused(strategy_world: Any) -> None:
    make_phase(strategy_world, "elsewhere")
    plain = link(strategy_world, "plain", None, phase_id="elsewhere")
    with pytest.raises(InvalidRecord, match="is of the phase 'elsewhere'"):
        link(strategy_world, "reminded", plain.submission.id)


def test_a_challenge_without_reminder_takes_no_links(world: Any) -> None:
    plain = link(world, "plain", None)
    with pytest.raises(InvalidRecord, match="are not linked: leave out the one without"):
        link(world, "reminded", plain.submission.id)
    with pytest.raises(
        InvalidRecord, match="are not linked"
    ):  # nothing is to be withdrawn for that
        link(world, "plain", "another")


def test_a_withdrawn_submission_is_no_counterpart(strategy_world: Any) -> None:
    plain = link(strategy_world, "plain", None)
    with strategy_world.database.write() as session:
        withdraw(session, plain.submission.id, actor="test")
    with pytest.raises(Conflict, match="was withdrawn"):
        link(strategy_world, "reminded", plain.submission.id)


def test_a_run_in_whose_place_another_stands_may_be_linked_as_it_may_stand_again(
    strategy_world: Any,
) -> None:
    """A refusal would also tell who may only submit which of two stands, and end a confirmation."""
    plain = link(strategy_world, "plain", None, method="Agent")
    newer = link(strategy_world, "newer", None, method="Agent")
    strategy_world.score(plain.job_id)
    strategy_world.score(newer.job_id)
    assert link(strategy_world, "reminded", plain.submission.id).job_id is not None


def test_the_same_bytes_with_another_link_are_refused_and_with_the_same_are_a_duplicate(
    strategy_world: Any,
) -> None:
    plain = link(strategy_world, "plain", None)
    other = link(strategy_world, "other", None)
    reminded = link(strategy_world, "reminded", plain.submission.id)
    assert link(strategy_world, "reminded", plain.submission.id).is_duplicate
    assert link(strategy_world, "reminded", None).is_duplicate
    with pytest.raises(
        Conflict, match=f"submitted before, as '{reminded.submission.id}', linked to"
    ):
        link(strategy_world, "reminded", other.submission.id)
    with pytest.raises(Conflict, match="without a link"):
        link(strategy_world, "plain", other.submission.id)


def test_a_refused_link_leaves_nothing(
    strategy_world: Any, world_counts: Callable[..., Any]
) -> None:
    before = world_counts(strategy_world)
    with pytest.raises(NotFound):
        link(strategy_world, "reminded", "nothing")
    assert world_counts(strategy_world) == before


@pytest.fixture
def world_counts() -> Callable[[Any], tuple[int, int]]:
    from sqlalchemy import func, select

    from exceptiondrive_records.audit.tables import AuditLine
    from exceptiondrive_records.submissions.tables import Submission

    def count(world: Any) -> tuple[int, int]:
        with world.database.read() as session:
            submissions = session.scalar(select(func.count()).select_from(Submission))
            lines = session.scalar(select(func.count()).select_from(AuditLine))
            return submissions or 0, lines or 0

    return count
