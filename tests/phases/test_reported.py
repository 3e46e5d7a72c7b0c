"""External boards beside a phase: what is taken, what is refused, and that nothing of it ranks."""

import json
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import pytest
from tests.phases.browsing import send, visitor
from tests.phases.test_export import files_of

if TYPE_CHECKING:
    from tests.phases.life import Beginning, Life

PATH = "/phases/test/reported"
REVISION = "sha256:" + "a" * 64
HEAD = "method,team,hcc,ur,hcc.lane_blockage,n_samples,split,split_revision,protocol,average,cite"
LINE = f"Far Planner,Far Team,0.1964,0.7892,0.2028,3181,elsewhere,{REVISION},1.0,micro,https://far.example/p"
ROWS = f"{HEAD}\n{LINE}\n"


def sent(file: str, title: str = "Far board") -> dict[str, str]:
    return {"title": title, "cite": "Luo et al., 2026", "file": file}


def rows_of(board: Any) -> list[Any]:
    return [each["row"] for each in board["rows"]]


@pytest.fixture
def beginning() -> "Beginning":
    def two_entries(life: "Life") -> None:
        life.make_phase(split="plain")
        for team, speed in (("alpha", 2.0), ("beta", 4.0)):
            assert life.upload(team, speed, "=1+1", split="plain").status_code == 202
        life.work()

    return "reported", two_entries


@pytest.fixture
def scored(life: "Life") -> "Life":
    """A phase with two entries on its board."""
    return life


@pytest.mark.parametrize("by", ["page", "api"])
def test_rows_stand_on_a_page_of_their_own_until_withdrawn(scored: "Life", by: str) -> None:
    life, organizer = scored, visitor(scored, "organizer")
    before = life.get("/api/v1/leaderboard?phase=test").content
    assert "external boards" not in life.get("/?phase=test").text
    if by == "page":
        page = f"/organize{PATH}/new"
        assert send(organizer, page, sent(ROWS), page=page).status_code == 303
    else:
        life.done(PATH, sent(ROWS))
    (board,) = life.json(f"/api/v1{PATH}")
    line = life.json("/api/v1/organizer/audit?limit=1", "organizer")[0]
    assert (line["action"], line["subject"]) == ("reported board imported", board["id"])
    (row,) = board["rows"]
    assert row["row"]["metrics"] == {"hcc": 0.1964, "ur": 0.7892}
    assert row["differences"] == [
        "Split elsewhere, not plain.",
        "The digest of protocol 1.0 is not told.",
        "3,181 samples, not 5.",
        "The average micro, not macro_family.",
    ]
    page_text = life.get(PATH).text
    for words in ("Far Planner", "19.64", "20.28", "Luo et al., 2026", *row["differences"]):
        assert words in page_text
    assert 'href="https://far.example/p"' in page_text
    assert "1 row of external boards" in life.get("/?phase=test").text
    assert life.get("/api/v1/leaderboard?phase=test").content == before, "no board knows of them"
    assert json.loads(files_of(life)["reported.json"]) == [board]
    if by == "page":
        page = f"/organize{PATH}/{board['id']}/withdraw"
        assert page in organizer.get(f"/organize{PATH}").text
        assert send(organizer, page, {"reason": "wrong"}, page=page).status_code == 303
    else:
        life.done(f"{PATH}/{board['id']}/withdraw", {"reason": "wrong"})
    assert life.json(f"/api/v1{PATH}") == []
    assert "Far Planner" not in life.get(PATH).text
    assert "external boards" not in life.get("/?phase=test").text
    assert "already" in life.refused(f"{PATH}/{board['id']}/withdraw", {"reason": "again"}, 409)
    life.done(PATH, sent(ROWS))
    assert len(life.json(f"/api/v1{PATH}")) == 1, "they can be imported again"


def as_csv(life: "Life") -> str:
    return str(life.get("/api/v1/leaderboard.csv?phase=test").text)


def test_what_we_export_we_import(scored: "Life") -> None:
    """Into a like phase nothing differs; numbers, names and counts come back as they were."""
    scored.make_phase("other", split="plain")
    made = scored.done("/phases/other/reported", sent(as_csv(scored)))
    board = scored.json("/api/v1/leaderboard?phase=test")
    told = {row["team"]: row for row in rows_of(made)}
    for entry in board["entries"]:
        row = told[entry["team"]]
        assert row["method"] == entry["method"]
        for key, value in row["metrics"].items():
            assert value == entry["metrics"][key]
        first = {id: it["hcc"] for id, it in entry["families"].items()}
        assert row["families"] == {id: value for id, value in first.items() if value is not None}
        assert (row["n_samples"], row["average"]) == (board["n_samples"], board["headline"])
        assert row["split"] == board["split"]
        assert row["protocol_digest"] == board["protocol"]["digest"]
        assert {"hcc", "ur"} <= row["metrics"].keys()
    assert all(not each["differences"] for each in made["rows"])


@pytest.mark.parametrize("by", ["copied cells", "capitals", "empty columns"])
def test_what_a_spreadsheet_makes_of_a_table_is_taken(scored: "Life", by: str) -> None:
    tables = {
        "copied cells": ROWS.replace(",", "\t"),
        "capitals": ROWS.replace(HEAD, HEAD.upper()),
        "empty columns": f"\ufeff\r\n{HEAD},,\r\n{LINE},,\r\n,,\r\n",
    }
    (row,) = rows_of(scored.done(PATH, sent(tables[by])))
    assert row["metrics"] == {"hcc": 0.1964, "ur": 0.7892}
    assert "already" in scored.refused(PATH, sent(ROWS), 409), "the very rows"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"0.1964": "19.64"}, "Line 3: hcc is 19.64: shares are from 0 to 1"),
        ({"0.1964": "nan"}, "Line 3: hcc is 'nan': write a number"),
        ({"0.1964": '"0,19"'}, "Line 3: hcc is '0,19': write a number"),
        ({REVISION: ""}, "Line 3: It lacks split_revision"),
        ({REVISION: "abc"}, "Line 3: split_revision is 'abc': write it in full"),
        ({",1.0,": ",,"}, "Line 3: It lacks protocol"),
        ({",1.0,": ",1,"}, "Line 3: protocol is '1': write its version in full, such as 1.0"),
        ({"3181": "many"}, "Line 3: n_samples is 'many'"),
        ({"3181": "9" * 5000}, "Line 3: n_samples is '99"),
        ({"micro": "mean"}, "Line 3: average is 'mean': write micro or macro_family"),
        ({"Far Planner": "Far\u202ePlanner"}, "Line 3: The method holds characters"),
        ({"Far Planner": ""}, "Line 3: It lacks method"),
        ({"0.1964,0.7892,0.2028": ",,"}, "Line 3: It has no metric"),
        ({"Far Team,": "Far Team,x,"}, "Line 3 has 12 values, not 11 as line 1"),
    ],
)
def test_a_bad_line_is_named_with_its_cure_and_nothing_is_imported(
    scored: "Life", changes: dict[str, str], words: str
) -> None:
    bad = LINE
    for old, new in changes.items():
        assert old in bad
        bad = bad.replace(old, new)
    good = LINE.replace("Far Planner", "Near Planner")
    assert words in scored.refused(PATH, sent(f"{HEAD}\n{good}\n{bad}\n"), 400)
    assert scored.json("/api/v1/organizer" + PATH, "organizer") == []


def test_what_is_wrong_with_many_lines_is_said_once(scored: "Life") -> None:
    lines = [LINE.replace("Far Planner", f"Planner {n}").replace(REVISION, "") for n in range(9)]
    said = scored.refused(PATH, sent("\n".join((HEAD, *lines, LINE.replace("3181", "many")))), 400)
    assert "Line 2, Line 3, Line 4, Line 5, Line 6 and 4 more: It lacks split_rev" in said
    assert said.count("It lacks") == said.count("Line 11: n_samples is 'many'") == 1


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("\n", "no row"),
        (HEAD, "no row"),
        (f"{HEAD}\n{LINE}\n{LINE}", "Line 3: The same method as in line 2"),
        (ROWS.replace("hcc,ur", "accuracy,ur"), "'accuracy' is no column of the planning"),
        (ROWS.replace("team,hcc", "hcc,hcc"), "names the column hcc twice"),
        (f'{HEAD}\n"{LINE}', "not a CSV table"),
        (
            f"{HEAD}\n\n{LINE.replace('Far Team', chr(34) + 'Far' + chr(10) + 'Team' + chr(34))}",
            "Line 3: The team",
        ),
        ("\n".join([HEAD, *(f"{n}{LINE}" for n in range(501))]), "more than 500 rows"),
    ],
)
def test_a_file_that_is_none_is_refused_in_words(scored: "Life", file: str, words: str) -> None:
    assert words in scored.refused(PATH, sent(file), 400)
    assert scored.json("/api/v1/organizer" + PATH, "organizer") == []


def test_of_two_organizers_at_once_one_imports(scored: "Life") -> None:
    with ThreadPoolExecutor(2) as both:
        done = list(both.map(lambda _: scored.organize(PATH, sent(ROWS)).status_code, range(2)))
    assert sorted(done) == [201, 409]
    assert len(scored.json(f"/api/v1{PATH}")) == 1


def test_rows_of_a_hidden_phase_are_hidden_and_words_are_no_markup(scored: "Life") -> None:
    bad = ROWS.replace("Far Planner", "<b>Far</b>").replace("https://far.example/p", "javascript:x")
    scored.done(PATH, sent(bad))
    text = scored.get(PATH).text
    assert "&lt;b&gt;Far" in text
    assert 'href="javascript' not in text
    scored.change({"visibility": "hidden"})
    assert scored.get(f"/api/v1{PATH}").status_code == scored.get(PATH).status_code == 404
    assert len(scored.json(f"/api/v1{PATH}", "organizer")) == 1
