"""What a team says of a submission changes at any time, with a history; what stands does not."""

from datetime import timedelta

import pytest
from sqlalchemy import select, text, update
from sqlalchemy.exc import DatabaseError
from tests.records.world import World
from tests.support.records import next_moment

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.errors import Conflict, InvalidRecord
from exceptiondrive_records.phases.scoring_keys import key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions import edits
from exceptiondrive_records.submissions.edits import (
    edit_submission,
    edits_of,
    edits_of_phase,
    facts_of_entries,
)
from exceptiondrive_records.submissions.submissions import accept, find_submission
from exceptiondrive_records.submissions.tables import SubmissionEdit
from exceptiondrive_records.work.board_requests import is_board_wanted
from exceptiondrive_records.work.tables import BoardRequest, WorkState
from exceptiondrive_schemas.method_facts import EditChanges, MethodFacts, SubmissionChange

VLA = MethodFacts(type="vla", sensors=("lidar", "front_camera"), parameters_millions=7000)


def edit(world: World, submission_id: str, **change: object) -> None:
    next_moment(world.database)
    with world.database.write() as session:
        edit_submission(
            session, submission_id, SubmissionChange.model_validate(change), actor="team:1"
        )


def test_an_edit_changes_what_it_names_and_keeps_before_and_after(world: World) -> None:
    one = world.scored("a", "Planer")
    edit(world, one, method="Planner", paper_url="https://example.org/paper", facts=VLA)
    with world.database.read() as session:
        now = find_submission(session, one)
        history = edits_of(session, one)
        audited = session.scalars(
            select(AuditLine).where(AuditLine.action == "submission edited")
        ).one()
    assert (now.method, now.description, now.code_url) == ("Planner", "", None)
    assert now.facts == VLA
    assert now.edited_at == history[0].edited_at
    assert history[0].by == "Alpha"
    assert history[0].changed == {
        "method": ("Planer", "Planner"),
        "paper": (None, "https://example.org/paper"),
        "facts.type": (None, "vla"),
        "facts.sensors": ((), ("front_camera", "lidar")),
        "facts.parameters_millions": (None, 7000.0),
    }
    assert audited.subject == one


def test_of_the_facts_only_those_that_were_sent_change(world: World) -> None:
    one = world.scored("a", "Planner")
    edit(world, one, facts=VLA)
    edit(world, one, facts={"map": "hd", "parameters_millions": None})
    with world.database.read() as session:
        facts = find_submission(session, one).facts
    assert facts == MethodFacts(type="vla", sensors=("front_camera", "lidar"), map="hd")


def test_a_board_is_asked_for_where_an_edit_changes_what_it_says(world: World) -> None:
    one = world.scored("a", "Planner")
    for change, is_wanted in (({"facts": VLA}, False), ({"method": "Planner 2"}, True)):
        with world.database.write() as session:
            session.execute(update(BoardRequest).values(state=WorkState.DONE))
        edit(world, one, **change)
        with world.database.read() as session:
            key = key_of_phase(session.get_one(Phase, world.phase_id))
            assert is_board_wanted(session, world.phase_id, *key) == is_wanted


def test_what_changes_nothing_leaves_no_trace(world: World) -> None:
    one = world.scored("a", "Planner")
    edit(world, one, method="Planner", description="", facts=MethodFacts())
    with world.database.read() as session:
        assert edits_of(session, one) == ()
        assert find_submission(session, one).edited_at is None
        assert edits_of_phase(session, world.phase_id) == (None, 0)


def test_an_edit_that_began_before_another_and_came_after_it_is_seen(world: World) -> None:
    one, two = world.scored("a", "Planner"), world.scored("b", "Other")
    edit(world, one, facts=VLA)
    with world.database.read() as session:
        before = edits_of_phase(session, world.phase_id)
    assert before.newest_at is not None
    with world.database.write() as session:  # as a transaction that took its time and waited
        session.add(
            SubmissionEdit(
                submission_id=two,
                edited_at=before.newest_at - timedelta(seconds=1),
                actor="team:2",
                changes=EditChanges(changed={"facts.map": (None, "hd")}),
            )
        )
    with world.database.read() as session:
        after = edits_of_phase(session, world.phase_id)
    assert after.newest_at == before.newest_at
    assert after != before


def test_a_name_is_the_methods_so_that_what_stands_stays(world: World) -> None:
    first, second = world.scored("a", "Planer"), world.scored("b", "Planer")
    assert world.standing() == {second: "Planer"}
    edit(world, second, method="Planner")
    assert world.standing() == {second: "Planner"}
    with world.database.read() as session:
        assert find_submission(session, first).method == "Planner"
        assert edits_of(session, first)[0].changed == {"method": ("Planer", "Planner")}


def test_two_methods_become_one_until_the_deadline_and_never_after(world: World) -> None:
    first, second = world.scored("a", "Planner"), world.scored("b", "Planer")
    third = world.scored("c", "Other")
    edit(world, second, method="Planner")
    assert world.standing() == {second: "Planner", third: "Other"}
    world.close()
    with pytest.raises(Conflict, match="After the deadline two methods cannot become one"):
        edit(world, third, method="Planner")
    edit(world, third, method="Another", description="The name alone may still be mended.")
    assert world.standing() == {second: "Planner", third: "Another"}
    assert first not in world.standing()


@pytest.mark.parametrize("name", ["FREEZE", "\u200b", "Ref\u0435rence", "=\u0301\u0301\u0301"])
def test_a_new_name_keeps_the_rules_of_names(world: World, name: str) -> None:
    one = world.scored("a", "Planner")
    with pytest.raises(InvalidRecord):
        edit(world, one, method=name)
    assert world.standing() == {one: "Planner"}


def test_links_are_https_and_texts_can_be_shown(world: World) -> None:
    one = world.scored("a", "Planner")
    for change in (
        {"paper_url": "http://example.org"},
        {"code_url": "javascript:alert(1)"},
        {"description": "\u202eback"},
        {"facts": {"hardware": "a\x1b[31m"}},
        {"facts": {"type_note": "two\nlines"}},
    ):
        with pytest.raises(InvalidRecord):
            edit(world, one, **change)


def test_a_day_has_a_limit_of_edits(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edits, "MAX_EDITS_A_DAY", 2)
    one = world.scored("a", "Planner")
    edit(world, one, description="one")
    edit(world, one, description="two")
    with pytest.raises(Conflict, match="2 edits in 24 hours"):
        edit(world, one, description="three")
    edit(world, one, description="two")


def test_a_new_name_of_many_runs_is_one_edit(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edits, "MAX_EDITS_A_DAY", 2)
    one, _, _ = [world.scored(name, "Planer") for name in "abc"]
    edit(world, one, method="Planner")
    edit(world, one, description="one")
    with pytest.raises(Conflict, match="2 edits in 24 hours"):
        edit(world, one, description="two")


def test_the_history_cannot_be_altered(world: World) -> None:
    one = world.scored("a", "Planner")
    edit(world, one, description="one")
    with pytest.raises(DatabaseError), world.database.write() as session:
        session.execute(text("UPDATE submission_edits SET actor = 'nobody'"))


def test_the_same_bytes_with_other_words_are_refused_plainly(world: World) -> None:
    one = world.submit("a", "Planer").submission.id
    assert world.submit("a", "Planer").is_duplicate
    with pytest.raises(Conflict, match=f"exceptiondrive edit {one}") as refusal:
        world.submit("a", "Planner")
    assert "What differs now: method." in str(refusal.value)
    edit(world, one, method="Planner", facts=VLA)
    assert world.submit("a", "Planner").submission.id == one


def test_the_next_run_of_a_method_has_its_facts(world: World) -> None:
    one = world.scored("a", "Planner")
    edit(world, one, facts=VLA)
    assert world.submit("b", "Planner").submission.facts == VLA
    assert world.submit("c", "Other").submission.facts is None
    with world.database.write() as session:
        told = accept(
            session,
            team_id=world.team_id,
            phase_id=world.phase_id,
            method="Planner",
            facts=MethodFacts(type="rule"),
            file_digest="sha256:" + "d" * 64,
            size_bytes=1,
        )
    assert told.submission.facts == MethodFacts(type="rule")


def test_facts_of_an_anonymous_phase_wait_for_its_names(world: World) -> None:
    one, other = world.scored("a", "Planner"), world.scored("b", "Other")
    edit(world, one, facts=VLA)
    with world.database.read() as session:
        assert facts_of_entries(session, world.phase_id, [one, other, None])[one].facts == VLA
        assert facts_of_entries(session, world.phase_id, [other]) == {}
    with world.database.write() as session:
        phase = session.get_one(Phase, world.phase_id)
        phase.policy = phase.policy.model_copy(update={"anonymous": True})
    with world.database.read() as session:
        assert facts_of_entries(session, world.phase_id, [one]) == {}
