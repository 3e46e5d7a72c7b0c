"""What a session asks the database for, and how often."""

from tests.records.statements import statements
from tests.records.world import World

from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.splits.tables import SplitRow


def test_what_a_session_holds_is_not_asked_for_again(world: World) -> None:
    with statements(world.database) as sent, world.database.read() as session:
        first = session.get_one(Phase, world.phase_id)
        assert session.get(Phase, world.phase_id) is first
    assert sum("FROM phases" in statement for statement in sent) == 1


def test_a_key_of_several_columns_finds_its_row_alone(world: World) -> None:
    with world.database.read() as session:
        phase = session.get_one(Phase, world.phase_id)
        split = session.get_one(SplitRow, (phase.split_name, phase.split_revision))
        assert (split.name, split.revision) == (phase.split_name, phase.split_revision)
        assert session.get(SplitRow, (phase.split_name, "sha256:" + "0" * 64)) is None


def test_what_another_session_changed_is_got_anew_where_that_is_asked(world: World) -> None:
    with world.database.read() as session:
        title = session.get_one(Phase, world.phase_id).title
    with world.database.write() as session:
        held = session.get_one(Phase, world.phase_id)
        held.title = f"{title}, changed"
        session.flush()
        locked = session.get(Phase, world.phase_id, with_for_update=True, populate_existing=True)
        assert locked is held
        assert held.title == f"{title}, changed"
