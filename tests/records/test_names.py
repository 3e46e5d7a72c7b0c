"""Names of teams and methods: seen, readable, and no two teams under what looks like one."""

from collections.abc import Callable

import pytest
from tests.records.conftest import World

from exceptiondrive_records.db.errors import Conflict, InvalidRecord
from exceptiondrive_records.db.identifiers import checked_name, skeleton
from exceptiondrive_records.teams.teams import create_team

BLANK = ("\u3164", "\uffa0", "\u115f", "\u1160", "\u2800", "...", "\u0301")
UNSEEN = ("\u034f", "\ufe0f", "\U000e0100", "\u180b", "\u17b4", "\u3164", "\u200b", "\u202e")
ALIKE = (
    "alpha",
    "ALPHA",
    "\u0391lpha",
    "\u0410lpha",
    "A1pha",
    "AIpha",
    "Álpha",
    "Ａｌｐｈａ",
    "𝐀lpha",
)


@pytest.mark.parametrize("name", BLANK, ids=ascii)
def test_a_name_that_shows_nothing_is_refused(name: str) -> None:
    with pytest.raises(InvalidRecord, match=r"letter or digit|cannot be shown|must not be empty"):
        checked_name("team name", name)


@pytest.mark.parametrize("character", UNSEEN, ids=ascii)
def test_what_no_eye_sees_is_refused(character: str) -> None:
    with pytest.raises(InvalidRecord, match="cannot be shown"):
        checked_name("method name", f"Alpha{character}x")


def test_accents_do_not_pile_up() -> None:
    assert checked_name("team name", "Việt Nam Tự lái") == "Việt Nam Tự lái"
    with pytest.raises(InvalidRecord, match="cannot be shown"):
        checked_name("team name", "A" + "\u0301" * 78)


@pytest.mark.parametrize(
    "name", ["FREEZE", "freeze", "Fr\u0435eze", "\u0421ONSTANT VELOCITY", "Ref\u0435rence"]
)
def test_names_of_reference_rows_are_reserved_in_every_spelling(name: str) -> None:
    with pytest.raises(InvalidRecord, match="reserved"):
        checked_name("method name", name)


@pytest.mark.parametrize("name", ALIKE, ids=ascii)
def test_no_two_teams_have_names_that_look_alike(
    make_world: Callable[..., World], name: str
) -> None:
    world = make_world()
    with world.database.write() as session:
        create_team(session, "first", "Alphaville", actor="test")
    with pytest.raises(Conflict, match="looks like"), world.database.write() as session:
        create_team(session, "second", f"{name}ville", actor="test")


@pytest.mark.parametrize(
    ("one", "other"),
    [("Alpha", "Alpha 2"), ("Team 2", "Team 3"), ("自动驾驶", "自動車"), ("Ω", "Σ")],
)
def test_names_that_differ_to_the_eye_are_two(one: str, other: str) -> None:
    assert skeleton(one) != skeleton(other)
