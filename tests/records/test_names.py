"""Names of teams and methods: seen, readable, and no two teams under what looks like one."""

import unicodedata
from collections.abc import Callable

import pytest
from tests.records.world import World

from exceptiondrive_records.db.errors import Conflict, InvalidRecord
from exceptiondrive_records.db.identifiers import (
    checked_name,
    checked_reason,
    checked_team,
    skeleton,
)
from exceptiondrive_records.participation.changes import change_team
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_schemas.reported import reported_paper

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
    "Alpha.",
    "«Alpha»",
    "Alpha—",
    "A\u05dfpha",
    "A\u0627pha",
    "ᴀʟpha",
    "🅰lpha",
    "🅐lpha",
    "\U0001f1e6lpha",
)


@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=ascii)
def test_a_line_ends_with_one_character(end: str) -> None:
    lines = end.join(["a word"] * 143)
    assert checked_reason(lines) == "\n".join(["a word"] * 143)
    with pytest.raises(InvalidRecord, match="longer than 1000 characters"):
        checked_reason(lines + "x")


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
    "name",
    [
        "FREEZE",
        "freeze",
        "Fr\u0435eze",
        "FREE\u0396E",
        "\u0421ONSTANT VELOCITY",
        "CONSTANT VELOCI\u0422Y",
        "SOURC\u0395 AS EDITED",
        "Ref\u0435rence",
        "\u0395xceptionDrive reference",
        reported_paper().team,
        "\u0395xceptionDrive p\u0430per",
        "Exception-Drive Paper",
    ],
    ids=ascii,
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
        create_team(session, "first", "Alpha-Ville", actor="test")
    with pytest.raises(Conflict, match="looks like"), world.database.write() as session:
        create_team(session, "second", f"{name} ville", actor="test")


@pytest.mark.parametrize(
    ("slug", "name"),
    [
        ("x", "Team 7KQ-2MF"),
        ("x", "TEAM abc–def"),
        ("x", "Team７KQ-2MF"),
        ("x", "T\u0435am 7KQ - 2MF"),
        ("x", "\u0422eam 7KQ-2MF"),
        ("x", "Team 7\u041aQ-2MF"),
        ("x", "Former team 7KQ2MF"),
        ("x", "former  Team"),
        ("former-7kq2mf", "Alpha"),
    ],
    ids=ascii,
)
def test_no_team_calls_itself_like_one_that_is_not_named(
    make_world: Callable[..., World], slug: str, name: str
) -> None:
    """As teams of an anonymous phase, and forgotten ones, stand on boards."""
    world = make_world()
    with pytest.raises(InvalidRecord, match="not named"), world.database.write() as session:
        create_team(session, slug, name, actor="test")
    if slug == "x":
        with pytest.raises(InvalidRecord, match="not named"), world.database.write() as session:
            change_team(session, "alpha", name=name, reason="r", actor="test")


@pytest.mark.parametrize("name", ["Team Red Cat", "Team Blue-Lab", "Old former team", "Team 7"])
def test_other_names_of_teams_stay_free(name: str) -> None:
    assert checked_team("x", name) == name


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("Alpha", "Alpha 2"),
        ("Team 2", "Team 3"),
        ("自动驾驶", "自動車"),
        ("किरण", "करण"),
        ("Ω", "Σ"),
        ("Мир", "Mind"),
        ("Van", "Nan"),
        ("שלום", "שלוש"),
        ("محمد", "محمود"),
    ],
)
def test_names_that_differ_to_the_eye_are_two(one: str, other: str) -> None:
    assert skeleton(one) != skeleton(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [("Waymo", "VVaymo"), ("Oxford", "Øxford"), ("Lodz", "Łodz"), ("Møller", "Moller"),
     ("Đelta", "Delta"), ("Ħaus", "Haus")],
)  # fmt: skip
def test_a_letter_with_a_bar_is_read_without_and_two_v_as_one_w(one: str, other: str) -> None:
    assert skeleton(one) == skeleton(other)


@pytest.mark.parametrize("capital", "ΑАΒВСΕЕΗНΙІКΚМΜΝОΟРΡЅТΤХΧУΥΖϜԌ", ids=ascii)
def test_capitals_of_other_scripts_are_read_as_the_latin_ones(capital: str) -> None:
    latin = dict(
        zip("ΑАΒВСΕЕΗНΙІКΚМΜΝОΟРΡЅТΤХΧУΥΖϜԌ", "AABBCEEHHIIKKMMNOOPPSTTXXYYZFG", strict=True)
    )
    assert skeleton(f"{capital}x one") == skeleton(f"{latin[capital]}x one")


@pytest.mark.parametrize("letter", "ABCDEFGHIJKLMNOPQRSTUVWYZ")
def test_small_capitals_are_read_as_capitals(letter: str) -> None:
    small = unicodedata.lookup(f"LATIN LETTER SMALL CAPITAL {letter}")
    assert skeleton(f"{small}x one") == skeleton(f"{letter}x one")


@pytest.mark.parametrize("name", ["Мир", "Москва", "Αθήνα", "Straße", "Élan"], ids=ascii)
def test_case_makes_no_two_names(name: str) -> None:
    assert skeleton(name) == skeleton(name.lower())
