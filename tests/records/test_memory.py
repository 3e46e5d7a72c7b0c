"""What is kept within a room: those asked for last."""

from exceptiondrive_records.db.memory import Memory


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
    assert (memory.get("b"), memory.get("c"), memory.weight) == (None, "C", 1)


def test_room_is_made_before_what_takes_it() -> None:
    memory: Memory[str, str] = Memory(10)
    for key in "abc":
        memory.keep(key, key.upper(), 3)
    memory.make_room(4)
    assert ([memory.get(key) for key in "abc"], memory.weight) == ([None, "B", "C"], 6)
    memory.make_room(11)
    assert ([memory.get(key) for key in "bc"], memory.weight) == ([None, None], 0)
