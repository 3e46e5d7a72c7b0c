"""What is kept within a room: those asked for last; and what says whether records changed."""

from contextlib import suppress

from sqlalchemy import text

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.memory import Memory
from exceptiondrive_records.teams.teams import create_team


def test_those_asked_for_last_stay() -> None:
    memory: Memory[str, str] = Memory(10)
    for key in "abc":
        memory.keep(key, key.upper(), 3)
    assert memory.get("a") == "A"
    memory.keep("d", "D", 4)
    assert [memory.get(key) for key in "abcd"] == ["A", None, "C", "D"]
    assert memory.weight == 10


def test_a_value_in_place_of_another_frees_its_room() -> None:
    memory: Memory[str, str] = Memory(10)
    memory.keep("a", "first", 8)
    assert memory.keep("a", "second", 3) == "second"
    memory.keep("b", "B", 7)
    assert (memory.get("a"), memory.get("b"), memory.weight) == ("second", "B", 10)


def test_what_is_heavier_than_the_room_is_kept_alone_until_the_next() -> None:
    memory: Memory[str, str] = Memory(10)
    memory.keep("a", "A", 5)
    assert memory.keep("b", "large", 11) == "large"
    assert (memory.get("a"), memory.get("b"), memory.weight) == (None, "large", 11)
    memory.keep("c", "C", 1)
    assert (memory.get("b"), len(memory), memory.weight) == (None, 1, 1)


def test_room_is_made_before_what_takes_it() -> None:
    memory: Memory[str, str] = Memory(10)
    for key in "abc":
        memory.keep(key, key.upper(), 3)
    memory.make_room(4)
    assert ([memory.get(key) for key in "abc"], memory.weight) == ([None, "B", "C"], 6)
    memory.make_room(11)
    assert (len(memory), memory.weight) == (0, 0)


def test_the_state_is_another_after_every_commit_whoever_made_it(database: Database) -> None:
    others = Database(database.engine.url.render_as_string(hide_password=False))
    try:
        states = [database.state()]
        for number, writer in enumerate((database, others, database)):
            with writer.write() as session:
                create_team(session, f"team{number}", f"Team {number}", actor="test")
            states.append(database.state())
    finally:
        others.dispose()
    assert len(set(states)) == len(states)


def test_the_state_stays_while_nothing_is_committed(sqlite_url: str) -> None:
    database = Database(sqlite_url)
    before = database.state()
    with database.read() as session:
        session.execute(text("SELECT 1"))
    with suppress(ZeroDivisionError), database.write() as session:
        create_team(session, "nobody", "Nobody", actor="test")
        raise ZeroDivisionError
    assert database.state() == before
    database.dispose()
