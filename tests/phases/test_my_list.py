"""The team's own list: what stands on the board, and the buttons that a phase leaves to the team."""

import re
from typing import TYPE_CHECKING

from tests.phases.browsing import send, visitor
from tests.phases.life import CAREFUL

from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.api.own_entries import entry_words
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.phases.life import Life

BACK = {"back": "my"}


def buttons(page: str) -> set[tuple[str, str]]:
    return set(re.findall(r'action="/submissions/([0-9a-z]+)/(choose|publish|unpublish)"', page))


def test_a_team_chooses_in_its_list_until_the_deadline(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60), policy={"entries_shown": "chosen"})
    first, second = (life.submit("alpha", speed, "Net", "plain") for speed in (1.0, 9.0))
    life.work()
    alpha = visitor(life, "alpha")
    assert buttons(alpha.get("/my").text) == {(first, "choose"), (second, "choose")}
    done = send(alpha, f"/submissions/{first}/choose", BACK, page="/my")
    assert (done.status_code, done.headers["location"]) == (303, "/my")
    page = alpha.get("/my").text
    assert buttons(page) == {(second, "choose")}
    assert "<b>Chosen</b>" in page
    stands = "takes its place"
    assert f"{first}</a> {stands}" in alpha.get(f"/submissions/{second}").text
    assert stands not in alpha.get(f"/submissions/{first}").text
    life.work()
    assert life.entry_ids() == [first]
    life.move(closes_at=life.now())
    assert buttons(alpha.get("/my").text) == set()
    assert buttons(alpha.get(f"/submissions/{second}").text) == set()


def test_a_team_with_a_later_deadline_chooses_until_then(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60), policy={"entries_shown": "chosen"})
    mine, theirs = (life.submit(who, 1.0, "Net", "plain") for who in ("alpha", "beta"))
    life.work()
    own = {"closes_at": life.ahead(90), "reason": "ill"}
    life.done("/teams/alpha/allowances/test", own, "PATCH")
    life.move(closes_at=life.now())
    alpha, beta = visitor(life, "alpha"), visitor(life, "beta")
    assert buttons(alpha.get("/my").text) == {(mine, "choose")}
    assert buttons(beta.get("/my").text) == set()
    assert send(alpha, f"/submissions/{mine}/choose", BACK, page="/my").status_code == 303
    assert send(beta, f"/submissions/{theirs}/choose", BACK, page="/my").status_code == 409


def test_a_team_publishes_in_its_list_and_takes_back(life: "Life") -> None:
    life.make_phase(split="plain", policy={"entries_private": True})
    mine = life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    alpha = visitor(life, "alpha")
    assert "<b>Private</b>" in alpha.get("/my").text
    assert buttons(alpha.get("/my").text) == {(mine, "publish")}
    newer = life.submit("alpha", 9.0, "Net", "plain")
    life.work()
    assert "stands on the board" not in alpha.get(f"/submissions/{mine}").text
    assert "stands on the board" not in alpha.get(f"/submissions/{newer}").text
    send(alpha, f"/submissions/{mine}/publish", BACK, page="/my")
    life.work()
    assert life.entry_ids() == [mine]
    assert "<b>Published</b>" in alpha.get("/my").text
    send(alpha, f"/submissions/{mine}/unpublish", BACK, page="/my")
    life.work()
    assert life.entry_ids() == []


def test_a_listed_entry_that_is_private_again_may_be_published_while_the_board_shows_it(
    life: "Life",
) -> None:
    with life.database.write() as session:
        add_protocol(session, packaged_protocol_toml("1.1"), "test")
    life.make_phase(split="plain", protocol="1.1", policy={"entries_private": True})
    mine = life.submit("alpha", 0.0, "Parked", "plain")
    life.work()
    alpha = visitor(life, "alpha")
    send(alpha, f"/submissions/{mine}/publish", BACK, page="/my")
    life.work()
    (entry,) = life.board()["entries"]
    assert entry["unranked_because"] is not None
    send(alpha, f"/submissions/{mine}/unpublish", BACK, page="/my")
    assert buttons(alpha.get("/my").text) == {(mine, "publish")}


def test_other_teams_and_plain_phases_get_no_buttons(life: "Life") -> None:
    life.make_phase(split="plain", policy={"entries_private": True})
    life.make_phase("usual", split="plain")
    mine = life.submit("alpha", 1.0, "Net", "plain")
    life.submit("beta", 1.0, "Net", "plain", "usual")
    life.work()
    beta = visitor(life, "beta")
    page = beta.get("/my").text
    assert buttons(page) == set()
    stolen = send(beta, f"/submissions/{mine}/publish", BACK, page="/my")
    assert stolen.status_code == 404
    life.work()
    assert life.get("/api/v1/leaderboard?phase=test").status_code == 404 or not life.entry_ids()


def test_the_way_back_leads_nowhere_else(life: "Life") -> None:
    life.make_phase(split="plain", policy={"entries_private": True})
    mine = life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    fields = {"back": "https://elsewhere.example/"}
    done = send(visitor(life, "alpha"), f"/submissions/{mine}/publish", fields, page="/my")
    assert done.headers["location"] == f"/submissions/{mine}"


def test_a_disqualified_run_is_neither_published_nor_chosen_on_pages(life: "Life") -> None:
    """It stands on no board, whatever its team says of it."""
    life.make_phase(split="plain", policy={"entries_private": True, "run_choice": "team"})
    own = life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    alpha, pages = visitor(life, "alpha"), ("/my", f"/submissions/{own}")
    for page in pages:
        assert f'action="/submissions/{own}/publish"' in alpha.get(page).text
    life.done(f"/submissions/{own}/disqualify", {"reason": "it used the map"})
    for page in pages:
        shown = alpha.get(page).text
        assert "isqualified" in shown
        assert f"/submissions/{own}/publish" not in shown
        assert f"/submissions/{own}/choose" not in shown


def test_what_is_said_to_stand_does_and_of_the_rest_its_state(life: "Life") -> None:
    life.make_phase("usual", split="plain")
    life.make_phase("private", split="plain", policy={"entries_private": True})
    good = life.submit("alpha", 1.0, "Good", "plain", "usual")
    older, out = (life.submit("alpha", speed, "Out", "plain", "usual") for speed in (2.0, 9.0))
    life.submit("alpha", 1.0, "Hidden", "plain", "private")
    life.work()
    life.done(f"/submissions/{out}/disqualify", {"reason": "it used the map"})
    life.done("/phases/usual/freeze")
    life.submit("alpha", 8.0, "Fresh", "plain", "usual")
    life.work()
    alpha = visitor(life, "alpha")
    told = alpha.get("/submit").text.split('<ul class="standing">')[1].split("</ul>")[0]
    plain = " ".join(re.sub(r"<[^>]+>", " ", told).split())
    assert re.search(r"Good , rank \d", plain), plain
    assert "Fresh , not ranked: the board is frozen" in plain
    assert "Hidden" not in plain
    assert out not in told
    assert "Stands in place" not in alpha.get("/my").text
    assert good in told
    assert older not in told


def test_a_sheet_says_of_a_family_that_is_kept_back_that_it_is_not_told(life: "Life") -> None:
    """As its board does."""
    toml = packaged_protocol_toml("1.0").replace(
        "min_samples_per_cell = 1\n", "min_samples_per_cell = 100\n"
    )
    with life.database.write() as session:
        add_protocol(session, toml.replace('version = "1.0"', 'version = "9.9"'), "test")
    life.make_phase(split="plain", protocol="9.9")
    own = life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    sheet = life.json(f"/api/v1/submissions/{own}", "alpha")["sheet"]
    assert all(row["hcc"] is None for row in sheet["families"].values())
    page = visitor(life, "alpha").get(f"/submissions/{own}").text
    families = page.split(">Families</h2>")[1].split("</table>")[0]
    assert ("not told" in families, "none" in families) == (True, False)


def test_a_submission_tells_which_average_ranks_it(life: "Life") -> None:
    toml = packaged_protocol_toml("1.0").replace('version = "1.0"', 'version = "9.0"', 1)
    with life.database.write() as session:
        add_protocol(
            session, toml.replace('headline = "macro_family"', 'headline = "micro"'), "test"
        )
    life.make_phase(split="plain", protocol="9.0")
    mine = life.submit("alpha", CAREFUL | {"c": 9.0}, "Net", "plain")
    life.work()
    told = life.get(f"/api/v1/submissions/{mine}", "alpha").text
    seen = SubmissionView.model_validate_json(told)
    assert seen.sheet is not None
    assert seen.sheet.micro["hcc"] != seen.sheet.macro_family["hcc"]
    (entry,) = life.board()["entries"]
    assert seen.sheet.average(seen.headline) == entry["metrics"]
    assert f"HCC {100 * entry['metrics']['hcc']:.2f}, rank 1" in entry_words(seen)
