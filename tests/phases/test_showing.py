"""Freeze, late view, choice, families by date, anonymity, private entries: as attackers see them."""

import html
import re
from csv import DictReader
from datetime import timedelta
from io import StringIO
from typing import TYPE_CHECKING, Any

import pytest
from tests.phases.browsing import visitor

from exceptiondrive_records.boards.renewal import renew_where_families_show
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.submissions.submissions import LONGEST_UPLOAD, arrival
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.phases.life import Life

PUBLIC = (
    "/?phase=test",
    "/?phase=test&sort=family.sudden_emergence",
    "/export/board.csv?phase=test",
    "/export/board.tex?phase=test",
    "/export/board.bib?phase=test",
    "/feed.atom?phase=test",
    "/compare?phase=test",
    "/api/v1/leaderboard?phase=test",
    "/api/v1/leaderboard?phase=test&sort=-hcc",
    "/api/v1/leaderboard?phase=test&view=late",
    "/api/v1/leaderboard.csv?phase=test",
    "/api/v1/boards?phase=test",
    "/api/v1/phases/test",
    *(f"/api/v1/boards/test/{number}" for number in range(1, 9)),
    *(f"/?phase=test&board={number}" for number in range(1, 5)),
)
OF_ENTRY = (
    "/entries/{id}",
    "/badges/{id}.svg",
    "/compare?phase=test&a={id}",
    "/api/v1/entries/{id}",
    "/api/v1/entries/{id}/receipt",
)
OF_TEAM = ("/api/v1/submissions", "/api/v1/submissions/{id}", "/api/v1/submissions/{id}/receipt")


def public_texts(life: "Life", *ids: str) -> dict[str, str]:
    """Everything that anybody can read about the phase and these entries."""
    paths = [*PUBLIC, *(path.format(id=each) for each in ids for path in OF_ENTRY)]
    return {path: life.get(path).text for path in paths}


def plain(life: "Life", *, showing: dict[str, Any] | None = None, **settings: Any) -> None:
    life.make_phase(split="plain", policy=showing or {}, **settings)


def submit(life: "Life", who: str, speed: float, method: str = "Planner") -> str:
    sent = life.submit(who, speed, method, "plain")
    life.work()
    return sent


# --- freeze -----------------------------------------------------------------------------------


def test_no_answer_tells_a_submission_that_stands_on_no_board_from_none(life: "Life") -> None:
    plain(life)
    submit(life, "alpha", 3.0)
    life.make_phase("second", split="plain", policy={"entries_private": True})
    private = life.submit("beta", 1.0, "Secret", "plain", "second")
    life.work()
    made_up = "0" * len(private)
    for query in (
        "",
        "?board=1",
        "?board=99",
        "?phase=second&board=99",
        "?phase=test",
        "?protocol=7",
    ):
        for path in ("/entries/", "/api/v1/entries/"):
            told = [life.get(f"{path}{key}{query}").text for key in (private, made_up)]
            own, none = (re.sub(f"{private}|{made_up}|[0-9a-f]{{32}}", "ID", text) for text in told)
            assert own == none, (path, query)
            assert "There is no entry" in own or (query, path[:4]) == ("?protocol=7", "/api")


@pytest.mark.parametrize("scores", ["shown", "hidden"])
def test_a_frozen_board_stays_while_scoring_goes_on(life: "Life", scores: str) -> None:
    plain(life, showing={"frozen_scores": scores})
    early = submit(life, "alpha", 3.0)
    before = life.get("/api/v1/leaderboard?phase=test").text
    life.done("/phases/test/freeze")
    frozen_since = life.json("/api/v1/phases/test")["now"]["frozen_since"]
    assert frozen_since is not None
    late = submit(life, "beta", 1.0, "Secret")
    assert life.get("/api/v1/leaderboard?phase=test").text == before
    line = life.json("/api/v1/organizer/audit?action=board built", "organizer")[0]
    assert (line["subject"], line["detail"]["kept_back"]) == ("test", "the board is frozen")
    lines = life.json("/api/v1/organizer/audit?action=board published", "organizer")
    assert line["detail"]["number"] > max(each["detail"]["number"] for each in lines)
    seen = public_texts(life, late)
    for path, text in seen.items():
        assert "Secret" not in text, path
        assert "Beta Labs" not in text, path
    assert frozen_since[:10] in life.get("/?phase=test").text
    assert "frozen" in life.get("/?phase=test").text
    coming = "on the board once the organizers reveal the board"
    assert life.get("/?phase=test").text.count(coming) == 2
    own = [life.get(path.format(id=late), "beta") for path in OF_TEAM]
    has_score = ['"micro"' in answer.text for answer in own]
    assert has_score == ([True] * 3 if scores == "shown" else [False] * 3)
    assert ("score is kept back until" in own[2].text) is (scores == "hidden")
    because = life.json(f"/api/v1/submissions/{late}", "beta")["unranked_because"]
    told = "the board is frozen, and shows it when the organizers reveal the board"
    assert because == (told if scores == "shown" else None)
    assert '"micro"' in life.get(f"/api/v1/submissions/{early}", "alpha").text
    live = life.json("/api/v1/organizer/phases/test/board", "organizer")
    assert (live["is_public"], live["names"][late]) == (False, ["Beta Labs", "Secret"])
    for path in ("/phases/test", "/?phase=test"):
        words = " ".join(life.get(path).text.split())
        assert (
            "What is scored from then on is shown when the organizers reveal the board, for"
            in words
        )
    life.done("/phases/test/reveal", {"what": "board", "reason": "ceremony"})
    assert set(life.entry_ids()) == {early, late}
    assert life.json("/api/v1/phases/test")["now"]["frozen_since"] is None
    assert life.get("/?phase=test").text.count("on the board within seconds") == 2

    def assert_told(*, is_kept_back: bool) -> None:
        for who, n in (("alpha", is_kept_back), ("beta", is_kept_back), ("gamma", 0)):
            notices = life.json("/api/v1/notifications", who)
            assert [one["title"] for one in notices] == ["The board of Test is revealed"] * n

    assert_told(is_kept_back=scores == "hidden")
    life.done("/phases/test/freeze")
    life.done("/phases/test/reveal", {"what": "board", "reason": "nothing came meanwhile"})
    assert_told(is_kept_back=scores == "hidden")


def test_teams_are_told_of_a_changed_deadline(life: "Life") -> None:
    life.make_phase(split="plain")
    life.submit("alpha", 1.0, "Planner", "plain")
    later, sooner = life.ahead(90), life.ahead(30)
    same_minute = f"{later[:17]}{'00' if later[17:19] == '59' else '59'}{later[19:]}"
    for deadline in (later, same_minute, sooner, sooner, None):
        life.change({"closes_at": deadline})
    notices = life.json("/api/v1/notifications", "alpha")
    assert {one["title"] for one in notices} == {"The deadline of Test is changed"}
    first, second = (f"{at[:10]} {at[11:16]} UTC" for at in (later, sooner))
    told = [sentence for one in notices for sentence in one["what_changed"]]
    assert told == [
        f"From {second} to none.",
        f"From {first} to {second}.",
        f"From none to {first}.",
    ]
    assert life.json("/api/v1/notifications", "beta") == [], "it sent nothing"
    life.change({"visibility": "hidden", "closes_at": life.ahead(20)})
    assert len(life.json("/api/v1/notifications", "alpha")) == 3


def test_a_team_with_a_later_deadline_is_told_with_a_changed_one_that_its_own_stays(
    life: "Life",
) -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60))
    for who in ("alpha", "beta"):
        life.submit(who, 1.0, "Planner", "plain")
    own = "2126-01-01T09:30:00Z"
    life.done("/teams/alpha/allowances/test", {"closes_at": own, "reason": "ill"}, "PATCH")
    for deadline in (life.ahead(30), "2127-01-01T09:30:00Z"):
        life.change({"closes_at": deadline})
    stays = "Your team's own deadline is still 2126-01-01 09:30 UTC."
    after, before = life.json("/api/v1/notifications", "alpha")[:2]
    assert before["what_changed"][1:] == [stays]
    assert after["what_changed"][1:] == [], "that of all is later than its own"
    for notice in life.json("/api/v1/notifications", "beta"):
        assert len(notice["what_changed"]) == 1


def test_the_best_of_a_method_is_not_said_of_scores_that_are_kept_back(life: "Life") -> None:
    """Which of two files is better is a bit of the hidden score, each time the team asks."""
    plain(life, showing={"frozen_scores": "hidden", "run_choice": "team"})
    shown = submit(life, "alpha", 3.0)
    best = f"/api/v1/submissions/{shown}/choose?rule=best"
    assert life.request("POST", best, "alpha").status_code == 200
    life.done("/phases/test/freeze")
    hidden = [submit(life, "alpha", speed) for speed in (1.0, 9.0)]
    told = [life.json(f"/api/v1/submissions/{each}", "alpha") for each in (shown, *hidden)]
    assert [one["replaced_by"] for one in told] == [None] * 3
    listed = life.json("/api/v1/submissions", "alpha")
    assert all(one["replaced_by"] is None for one in listed.get("submissions", listed))
    life.done("/phases/test/reveal", {"what": "board", "reason": "ceremony"})
    told = [life.json(f"/api/v1/submissions/{each}", "alpha") for each in (shown, *hidden)]
    assert [one["replaced_by"] for one in told] == [hidden[0], None, hidden[0]]


def test_a_board_freezes_by_its_date_and_no_update_shows_what_it_hides(life: "Life") -> None:
    plain(life, closes_at=life.ahead(60), showing={"freezes_at": life.ahead(30)})
    submit(life, "alpha", 3.0)
    shown = life.entry_ids()
    life.move(freezes_at=life.now())
    submit(life, "beta", 1.0)
    assert life.entry_ids() == shown
    words = life.refused("/phases/test", {"policy": {"freezes_at": life.ahead(20)}}, 409, "PATCH")
    assert "frozen" in words
    toml = _protocol("1.1")
    with life.database.write() as session:
        add_protocol(session, toml, "test")
    run = life.start_run(protocol="1.1")
    preview = life.json(f"/api/v1/organizer/rescoring/{run}/preview", "organizer")
    body = {"preview": preview["digest"], "reason": "new"}
    assert "frozen since" in life.refused(f"/rescoring/{run}/apply", body, 409)
    assert life.entry_ids() == shown
    built = life.json("/api/v1/organizer/audit?action=board built", "organizer")
    assert {each["detail"]["kept_back"] for each in built} == {
        "it is a draft",
        "the board is frozen",
    }


def _protocol(version: str) -> str:
    return packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"')


# --- late entries -----------------------------------------------------------------------------


def test_late_files_are_refused_in_plain_words_unless_the_phase_takes_them(life: "Life") -> None:
    plain(life, closes_at=life.ahead(60))
    life.move(closes_at=life.now())
    answer = life.upload("alpha", 1.0, "Planner", "plain")
    assert (answer.status_code, answer.json()["code"]) == (403, "phase_closed")
    assert "it closed at" in answer.json()["detail"]


def test_late_entries_rank_on_their_own_view_and_move_no_rank(life: "Life") -> None:
    plain(life, closes_at=life.ahead(60), showing={"late_entries": "own_view"})
    in_time = submit(life, "alpha", 3.0)
    other = submit(life, "beta", 9.0)
    assert life.get("/api/v1/leaderboard?phase=test&view=late").status_code == 404
    life.move(closes_at=life.now())
    before = life.board()
    late = submit(life, "gamma", 1.0)
    again = submit(life, "alpha", 1.5)
    assert life.json(f"/api/v1/submissions/{late}", "gamma")["is_late"] is True
    after = life.board()
    assert (after["entries"], after["board"]) == (before["entries"], before["board"])
    view = life.board("&view=late")
    assert view["view"] == "late"
    by_id = {entry["submission_id"]: entry for entry in view["entries"]}
    assert set(by_id) == {in_time, other, late, again}
    assert by_id[late]["rank"] == 1
    assert "UTC; what comes later is scored and stands on the late view alone" in (
        life.get("/phases/test").text
    )
    shown = life.json(f"/api/v1/entries/{late}")
    assert (shown["entry"]["is_late"], shown["entry"]["submission_id"]) == (True, late)
    assert life.get(f"/api/v1/entries/{late}/receipt").status_code == 200
    assert [by_id[key].get("is_late", False) for key in (in_time, late)] == [False, True]
    assert "Gamma Works" not in life.get("/?phase=test").text
    page = life.get("/?phase=test&view=late")
    assert "Gamma Works" in page.text
    assert "view=late" in life.get("/?phase=test").text
    assert life.get("/api/v1/leaderboard?phase=test&view=late&as_of=2026-01-01").status_code == 400


def test_every_link_of_the_late_view_leads_somewhere(life: "Life") -> None:
    plain(life, closes_at=life.ahead(60), showing={"late_entries": "own_view"})
    submit(life, "alpha", 3.0)
    life.move(closes_at=life.now())
    submit(life, "beta", 1.0)
    page = life.get("/?phase=test&view=late").text
    links = {html.unescape(link) for link in re.findall(r'href="(/[^"#]*)', page)}
    assert {link for link in links if life.get(link).status_code >= 400} == set()
    assert "/api/v1/leaderboard?phase=test&view=late" in links
    assert '<input type="hidden" name="view" value="late">' in page  # a filter keeps the view
    assert page.count('class="badge late"') == 1
    assert 'class="mv' not in page  # no rank moves
    assert "first board of its phase" not in page
    assert "badge late" not in life.get("/?phase=test").text


def test_what_cites_the_late_view_leads_to_it_and_marks_who_is_late(life: "Life") -> None:
    plain(life, closes_at=life.ahead(60), showing={"late_entries": "own_view"})
    submit(life, "alpha", 3.0, "In time")
    life.move(closes_at=life.now())
    late = submit(life, "beta", 1.0, "Behind")
    files = {
        form: life.get(f"/export/board.{form}?phase=test&view=late")
        for form in ("csv", "tex", "bib")
    }
    for form, file in files.items():
        assert f'"exceptiondrive-test-late-view.{form}"' in file.headers["Content-Disposition"]
    csv, tex, bib = (file.text for file in files.values())
    cited = html.unescape(life.get(f"/entries/{late}").text)
    for text in (csv, tex, bib, cited[cited.index("@misc") :]):
        named = set(re.findall(r"https?://[^/]+(/\?phase=test[^\s,}]*)", text))
        assert named == {"/?phase=test&view=late"}
    assert "phase test, late view" in bib
    assert "@misc{exceptiondrive-test-late-view," in bib
    are_late = [row["method"] for row in DictReader(StringIO(csv)) if row["is_late"] == "True"]
    assert are_late == ["Behind"]
    assert "Behind} (late) &" in tex
    assert "In time &" in tex


def test_the_deadline_is_judged_by_the_first_byte_but_nobody_holds_it_open(life: "Life") -> None:
    plain(life)
    now = life.now()
    soon, long_ago = now - timedelta(minutes=2), now - LONGEST_UPLOAD - timedelta(seconds=1)
    with life.database.read() as session:
        phase = find_phase(session, "test")
        assert arrival(session, phase, soon, now) == soon
        assert arrival(session, phase, long_ago, now) == now
        assert arrival(session, phase, now + timedelta(seconds=1), now) == now
        assert arrival(session, phase, None, now) == now


# --- choice of the final entry ----------------------------------------------------------------


def test_a_team_chooses_its_entry_until_the_deadline(life: "Life") -> None:
    plain(life, closes_at=life.ahead(60), showing={"entries_shown": "chosen"})
    first = submit(life, "alpha", 3.0, "A")
    second = submit(life, "alpha", 9.0, "B")
    other = submit(life, "beta", 2.0)
    assert set(life.entry_ids()) == {second, other}  # the latest, while nothing is chosen
    address = f"/api/v1/submissions/{first}/choose"
    assert life.request("POST", address, "beta").status_code == 404
    assert life.request("POST", address, "alpha").json()["is_chosen"] is True
    life.work()
    assert set(life.entry_ids()) == {first, other}
    third = submit(life, "alpha", 1.0, "C")
    assert set(life.entry_ids()) == {first, other}  # a choice stands until another is made
    life.move(closes_at=life.now())
    refusal = life.request("POST", f"/api/v1/submissions/{third}/choose", "alpha")
    assert refusal.status_code == 409
    assert "the choice stands" in refusal.json()["detail"]
    life.request("POST", f"/api/v1/submissions/{first}/withdraw", "alpha")
    life.work()
    assert set(life.entry_ids()) == {other}, "the choice stands, and it is withdrawn"


def test_after_the_deadline_no_older_version_takes_the_place_of_a_withdrawn_one(
    life: "Life",
) -> None:
    plain(life, closes_at=life.ahead(60))
    older = submit(life, "alpha", 3.0, "A")
    newest = submit(life, "alpha", 9.0, "A")
    kept = submit(life, "alpha", 5.0, "B")
    assert set(life.entry_ids()) == {newest, kept}
    pages = f"/submissions/{older}", f"/organize/submissions/{older}"
    browsers = visitor(life, "alpha"), visitor(life, "organizer")
    words = f"{newest} takes its place"
    for browser, page in zip(browsers, pages, strict=True):
        told = re.sub(r"</?a\b[^>]*>", "", browser.get(page).text)
        assert f"{words}; withdraw that one, and this one counts again." in told
    life.move(closes_at=life.now())
    for browser, page in zip(browsers, pages, strict=True):
        assert f"{words}." in re.sub(r"</?a\b[^>]*>", "", browser.get(page).text)
    life.request("POST", f"/api/v1/submissions/{newest}/withdraw", "alpha")
    told = life.json(f"/api/v1/submissions/{older}", "alpha")
    assert (told["replaced_by"], told["awaits_board"]) == (None, False)
    assert f"{newest} stood in its place at the deadline" in told["unranked_because"]
    life.work()
    assert set(life.entry_ids()) == {kept}


# --- families by date -------------------------------------------------------------------------


def test_families_are_absent_everywhere_until_their_date(life: "Life") -> None:
    plain(life, showing={"families_from": life.ahead(60)})
    mine = submit(life, "alpha", 3.0)
    submit(life, "beta", 1.0)
    texts = public_texts(life, mine)
    texts |= {path: life.get(path.format(id=mine), "alpha").text for path in OF_TEAM}
    receipt = life.json(f"/api/v1/submissions/{mine}/receipt", "alpha")
    for path, text in texts.items():
        if path.startswith(("/api", "/export/board.csv")):
            assert not re.search(r"sudden_emergence|lane_blockage|\"SE1\"|Sudden", str(text)), path
    assert receipt["statement"]["families"] == {}
    board = life.board()
    assert (board["families"], [entry["families"] for entry in board["entries"]]) == ([], [{}, {}])
    sheet = life.json(f"/api/v1/entries/{mine}")["sheet"]
    assert (sheet["families"], sheet["tasks"]) == ({}, {})
    for path in ("/?phase=test", f"/entries/{mine}", "/compare?phase=test"):
        assert life.get(path).status_code == 200, path
        assert not re.search(r'family\.sudden_emergence"|n = [0-9]+ of', life.get(path).text), path
    assert renew_where_families_show(life.database) == 0
    life.move(families_from=life.now())
    assert renew_where_families_show(life.database) == 1
    life.work()
    assert renew_where_families_show(life.database) == 0
    assert {family["id"] for family in life.board()["families"]} >= {"sudden_emergence"}
    assert life.json(f"/api/v1/entries/{mine}")["sheet"]["families"] != {}
    refuses_to_hide_families(life)
    withdrawn = f"/api/v1/submissions/{mine}/withdraw"
    assert life.request("POST", withdrawn, "alpha", json={"reason": "wrong"}).status_code == 200
    life.change({"visibility": "hidden"})
    refuses_to_hide_families(life)


def test_families_that_no_entry_has_shown_can_be_hidden(life: "Life") -> None:
    plain(life, showing={"families_from": life.ahead(-5)})
    life.work()
    assert life.board()["families"], "of the reference rows"
    life.change({"policy": {"families_from": life.ahead(9)}})
    life.work()
    assert life.board()["families"] == []
    life.change({"policy": {"families_from": None}})
    submit(life, "alpha", 3.0)
    refuses_to_hide_families(life)


def refuses_to_hide_families(life: "Life") -> None:
    words = life.refused("/phases/test", {"policy": {"families_from": life.ahead(9)}}, 409, "PATCH")
    assert "have been shown" in words


# --- anonymous until revealed -----------------------------------------------------------------


def test_names_stand_nowhere_until_they_are_revealed(life: "Life") -> None:
    plain(life, showing={"anonymous": True})
    mine = submit(life, "alpha", 3.0, "AlphaNet")
    other = submit(life, "beta", 1.0, "BetaNet")
    ids = (mine, other)
    for path, text in public_texts(life, *ids).items():
        for name in ("Alpha", "Beta", "alpha", "beta"):
            assert name not in text, (path, name)
    entries = {entry["submission_id"]: entry for entry in life.board()["entries"]}
    own = life.json(f"/api/v1/submissions/{mine}", "alpha")
    assert own["known_as"] == entries[mine]["team"] != entries[other]["team"]
    assert re.fullmatch(r"Team [0-9A-Z]{3}-[0-9A-Z]{3}", entries[mine]["team"])
    assert own["team"] == "Alpha Institute"
    assert life.get(f"/api/v1/entries/{mine}/receipt").status_code == 404
    assert life.get(f"/api/v1/submissions/{mine}/receipt", "alpha").status_code == 200
    again = submit(life, "alpha", 2.0, "AlphaNet")
    renewed = {entry["submission_id"]: entry for entry in life.board()["entries"]}
    assert (renewed[again]["team"], renewed[again]["method"]) == (
        entries[mine]["team"],
        entries[mine]["method"],
    )
    live = life.json("/api/v1/organizer/phases/test/board", "organizer")
    assert live["names"][again] == ["Alpha Institute", "AlphaNet"]
    answers = {n: life.get(f"/api/v1/boards/test/{n}") for n in range(1, 5)}
    old = {n: answer.text for n, answer in answers.items() if answer.status_code == 200}
    assert len(old) >= 2
    life.done("/phases/test/reveal", {"what": "names", "reason": "accepted"})
    life.work()
    assert {entry["team"] for entry in life.board()["entries"]} == {"Alpha Institute", "Beta Labs"}
    ranked = [entry for entry in life.board()["entries"] if entry["rank"]]
    assert [entry["previous_rank"] for entry in ranked] == [entry["rank"] for entry in ranked]
    for number, text in old.items():
        assert life.get(f"/api/v1/boards/test/{number}").text == text
        assert "Alpha" not in text
    action = [line["action"] for line in life.json("/api/v1/organizer/audit", "organizer")]
    assert "names revealed" in action


def test_a_pseudonym_is_keyed_by_a_salt_that_nobody_sees(life: "Life") -> None:
    for phase in ("one", "two"):
        life.make_phase(phase, split="plain", policy={"anonymous": True})
        life.submit("alpha", 2.0, "Planner", "plain", phase)
    life.work()
    names = {life.board(phase=phase)["entries"][0]["team"] for phase in ("one", "two")}
    assert len(names) == 2
    with life.database.read() as session:
        salts = [find_phase(session, phase).pseudonym_salt for phase in ("one", "two")]
    paths = ("/api/v1/phases", "/api/v1/organizer/audit", "/api/v1/organizer/phases/one/board")
    texts = [life.get(path, "organizer").text for path in paths]
    assert all(salt and len(salt) == 64 and salt not in text for salt in salts for text in texts)


# --- private until published ------------------------------------------------------------------


def test_an_entry_is_its_teams_alone_until_it_is_published(life: "Life") -> None:
    plain(life, showing={"entries_private": True})
    mine = submit(life, "alpha", 3.0, "Secret")
    public = submit(life, "beta", 9.0)
    life.request("POST", f"/api/v1/submissions/{public}/publish", "beta")
    life.work()
    assert life.entry_ids() == [public]
    for path, text in public_texts(life, mine).items():
        assert "Secret" not in text, path
        assert "Alpha" not in text, path
    own = life.json(f"/api/v1/submissions/{mine}", "alpha")
    assert (own["is_published"], own["rank"], own["sheet"] is not None) == (False, None, True)
    address = f"/api/v1/submissions/{mine}"
    assert life.request("POST", f"{address}/publish", "beta").status_code == 404
    assert life.request("POST", f"{address}/publish", "alpha").json()["is_published"] is True
    life.work()
    assert life.entry_ids() == [mine, public]
    assert life.get(f"/entries/{mine}").status_code == 200
    life.request("POST", f"{address}/unpublish", "alpha")
    life.work()
    assert life.entry_ids() == [public]
    for path in OF_ENTRY[:2] + OF_ENTRY[3:]:
        assert life.get(path.format(id=mine)).status_code == 404, path


@pytest.mark.parametrize("shown", ["all", "chosen"])
def test_after_the_deadline_nobody_picks_what_stands_by_publishing(
    life: "Life", shown: str
) -> None:
    policy = {"entries_private": True, "entries_shown": shown, "late_entries": "own_view"}
    plain(life, closes_at=life.ahead(60), showing=policy)

    def do(what: str, submission_id: str, who: str = "alpha") -> tuple[int, str]:
        answer = life.request("POST", f"/api/v1/submissions/{submission_id}/{what}", who)
        life.work()
        return answer.status_code, str(answer.json().get("detail"))

    public, kept = submit(life, "alpha", 3.0), submit(life, "alpha", 1.0)
    older, newest = submit(life, "beta", 1.0), submit(life, "beta", 9.0)
    assert do("publish", public)[0] == 200
    final, other = newest, older
    if shown == "chosen":
        final, other = older, newest
        assert do("choose", older, "beta")[0] == 200
        page = visitor(life, "beta").get(f"/submissions/{older}").text
        assert "The team chose it: once it is public, it is on the board." in page
    life.move(closes_at=life.now())
    assert do("unpublish", public) == (
        409,
        "The deadline has passed: withdraw it, and its place stays empty.",
    )
    for who, each in (("alpha", kept), ("beta", other)):
        refused, words = do("publish", each, who)
        assert (refused, "else its newest, can still" in words) == (409, True)
        because = life.json(f"/api/v1/submissions/{each}", who)["unranked_because"]
        assert because == "it was private at the deadline, and stays so"
    assert "Publish it" not in visitor(life, "alpha").get("/my").text
    assert "Make it private" not in visitor(life, "alpha").get("/my").text
    assert visitor(life, "beta").get("/my").text.count("Publish it") == 1
    assert life.entry_ids() == [public]
    assert do("publish", final, "beta")[0] == 200
    assert set(life.entry_ids()) == {public, final}
    assert do("withdraw", public)[0] == 200
    assert do("publish", kept)[0] == 409, "its place stays empty"
    assert life.entry_ids() == [final]
    late = submit(life, "gamma", 1.0)
    assert do("publish", late, "gamma")[0] == 200, "it moves no rank"
    assert set(life.entry_ids("&view=late")) == {final, late}
    assert do("unpublish", late, "gamma")[0] == 200
    assert life.get("/api/v1/leaderboard?phase=test&view=late").status_code == 404
    assert life.entry_ids() == [final]


def test_a_phase_that_shows_everything_has_nothing_to_choose_or_publish(life: "Life") -> None:
    plain(life)
    mine = submit(life, "alpha", 3.0)
    for what in ("choose", "publish", "unpublish"):
        assert (
            life.request("POST", f"/api/v1/submissions/{mine}/{what}", "alpha").status_code == 409
        )
