"""What readers find of a phase: its page, its place, its dates, its feed; and how organizers set it."""

import re
from typing import TYPE_CHECKING, Any

import pytest
from tests.phases.browsing import send, visitor

if TYPE_CHECKING:
    from tests.phases.life import Life

TEXTS = {
    "rules": "# Allowed\n\n- any *planner*",
    "terms": "You agree to **publish**.",
    "prize": "A cup.",
    "contact": "[Ada](mailto:ada@example.org)",
    "data_url": "https://data.example.org/scenes",
    "data_licence": "CC BY-NC-SA 4.0",
    "data_manifest_url": "https://data.example.org:8443/manifest.json",
}
LONG_AGO, FAR_AWAY = "2020-01-01T00:00:00Z", "2126-01-01T09:30:00Z"


def text_of(page: str) -> str:
    return " ".join(re.sub("<[^>]+>", " ", page.split("<main", 1)[1]).split())


def test_the_page_shows_everything_that_organizers_write(life: "Life") -> None:
    life.make_phase(split="plain", description="First **words**.\n\nMore of them.", page=TEXTS)
    page = life.get("/phases/test").text
    for part in (
        "<strong>words</strong>", "More of them.", "<h3>Allowed</h3>", "<em>planner</em>",
        "<strong>publish</strong>", "A cup.", 'href="mailto:ada@example.org"',
        'href="https://data.example.org/scenes"', "CC BY-NC-SA 4.0", "exceptiondrive data test",
        'href="/submit?phase=test"', 'href="/feed.atom?phase=test"', 'href="/splits/plain"',
    ):  # fmt: skip
        assert part in page, part
    assert life.json("/api/v1/phases/test")["page"] == TEXTS
    board = life.get("/?phase=test").text
    assert "<strong>words</strong>" in board
    assert "More of them." not in board
    assert 'href="/phases/test"' in board


def test_no_terms_are_to_be_accepted_of_an_archived_phase(life: "Life") -> None:
    life.make_phase(split="plain", page=TEXTS, policy={"terms_required": True})
    assert "accept them</a>" in life.get("/phases/test").text
    life.change({"visibility": "archived"})
    page = life.get("/phases/test").text
    assert ("<strong>publish</strong>" in page, "accept them" in page) == (True, False)


def test_a_page_without_texts_has_no_empty_sections(life: "Life") -> None:
    life.make_phase(split="plain")
    words = text_of(life.get("/phases/test").text)
    for absent in ("Rules", "Terms", "Prize", "Contact", "Data", "Licence"):
        assert absent not in words


def test_a_page_says_what_of_an_entry_stands_on_the_board(life: "Life") -> None:
    life.make_phase(split="plain", policy={"entries_private": True, "anonymous": True})
    words = text_of(life.get("/phases/test").text)
    assert "An entry is private, and ranks nowhere, until its team publishes it." in words
    assert "Teams and methods stand under pseudonyms until the organizers show names." in words
    board = text_of(life.get("/?phase=test").text)
    assert "They appear on the board once your team publishes the entry." in board
    life.done("/phases/test/freeze")
    board = text_of(life.get("/?phase=test").text)
    assert "once your team publishes the entry and the organizers reveal the board." in board


def test_what_comes_to_a_closed_phase_appears_on_its_late_view(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60), policy={"late_entries": "own_view"})
    life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    life.move(closes_at=life.now())
    board = text_of(life.get("/?phase=test").text)
    assert "They appear on the late view within seconds." in board
    own = text_of(visitor(life, "alpha").get("/my").text)
    assert "Test closed: it stands on the late view alone 19 19 of 20 100 of 100" in own


@pytest.mark.parametrize("late_entries", ["refused", "own_view"])
def test_a_closed_phase_is_open_to_a_team_until_its_own_deadline(
    life: "Life", late_entries: str
) -> None:
    policy = {"late_entries": late_entries}
    life.make_phase(split="plain", closes_at=life.ahead(60), policy=policy)
    life.submit("alpha", 1.0, "Net", "plain")
    life.work()
    own = {"closes_at": FAR_AWAY, "reason": "ill"}
    life.done("/teams/alpha/allowances/test", own, "PATCH")
    life.move(closes_at=life.now())
    alpha = visitor(life, "alpha")
    form, mine = (text_of(alpha.get(page).text) for page in ("/submit?phase=test", "/my"))
    until = "open until your team's own deadline, 1 Jan 2126, 09:30 UTC"
    assert form.count(until) == 1
    assert mine.count(f"Test {until}") == 1
    assert "Test Planning Open until 1 Jan 2126, 09:30 UTC" in form
    for words in ("has closed", "takes no submissions now", "late view"):
        assert words not in form + mine, words
    theirs = text_of(visitor(life, "beta").get("/submit?phase=test").text)
    assert "own deadline" not in theirs
    shut = {"refused": "Test takes no submissions now", "own_view": "on its late view alone"}
    assert shut[late_entries] in theirs


@pytest.mark.parametrize("name", ["data_url", "data_manifest_url"])
@pytest.mark.parametrize("url", ["http://x.org/", "javascript:alert(1)", "https://a@x.org/", "x"])
def test_a_data_link_is_an_https_address(life: "Life", name: str, url: str) -> None:
    life.make_phase(split="plain")
    assert "https://" in life.refused("/phases/test", {"page": {name: url}}, 400, "PATCH")


def test_a_change_of_one_text_leaves_the_others(life: "Life") -> None:
    life.make_phase(split="plain", page=TEXTS)
    changed = life.change({"page": {"prize": "Two cups."}})
    assert changed["page"] == {**TEXTS, "prize": "Two cups."}
    line = life.json("/api/v1/organizer/audit?limit=1", "organizer")[0]
    assert line["detail"] == {"prize": ["A cup.", "Two cups."]}


def test_an_upcoming_phase_has_a_countdown_a_feed_and_no_dead_button(life: "Life") -> None:
    life.make_phase(split="plain", opens_at=FAR_AWAY, description="Soon.")
    for address in ("/?phase=test", "/phases/test"):
        page = life.get(address).text
        assert '<time datetime="2126-01-01T09:30:00Z" data-countdown>' in page
        assert "1 Jan 2126, 09:30 UTC" in page
        assert "Soon." in page
        assert "/feed.atom?phase=test" in page
        main = page.split("<main", 1)[1].split("</main>")[0]
        assert "Submit trajectories" not in main
        assert "Prepare a submission" in main
    feed = life.get("/feed.atom?phase=test").text
    assert "Test opens 1 Jan 2126, 09:30 UTC" in feed
    assert "is open for submissions" not in feed
    life.move(opens_at=life.now())
    assert "Test is open for submissions" in life.get("/feed.atom?phase=test").text


def test_a_closed_phase_offers_no_submission(life: "Life") -> None:
    life.make_phase(split="plain", opens_at=LONG_AGO)
    life.move(closes_at=life.now())
    for address in ("/?phase=test", "/phases/test"):
        main = life.get(address).text.split("<main", 1)[1].split("</main>")[0]
        assert "Submit trajectories" not in main
        assert "Prepare a submission" not in main
    assert "Test has closed" in life.get("/feed.atom?phase=test").text


@pytest.mark.parametrize(
    ("dates", "takes_files"),
    [
        ({}, True),
        ({"opens_at": FAR_AWAY}, False),
        ({"closes_at": LONG_AGO}, False),
        ({"closes_at": LONG_AGO, "policy": {"late_entries": "own_view"}}, True),
    ],
)
def test_only_where_files_are_taken_does_the_board_tell_how_to_submit(
    life: "Life", dates: dict[str, Any], takes_files: bool
) -> None:
    life.make_phase(split="plain", **dates)
    main = life.get("/?phase=test").text.split("<main", 1)[1].split("</main>")[0]
    assert ("on the board</h2>" in main) == takes_files
    assert ("exceptiondrive submit" in main) == takes_files
    assert 'href="/phases/test"' in main


def front(life: "Life") -> str:
    found = re.search(r'href="/phases/([a-z]+)"', life.get("/").text)
    assert found is not None
    return found[1]


def test_the_organizer_chooses_the_front_page(life: "Life") -> None:
    for name in ("first", "second", "third"):
        life.make_phase(name, split="plain", title=name)
    assert front(life) == "first"
    organizer = visitor(life, "organizer")
    done = send(
        organizer, "/organize/phases/third/feature", {"reason": "the season"},
        page="/organize/phases/third/feature",
    )  # fmt: skip
    assert done.status_code == 303
    assert front(life) == "third"
    assert [one["id"] for one in life.json("/api/v1/phases")] == ["third", "first", "second"]
    assert life.done("/phases/second/feature", {"reason": "a better one"})["position"] == 1
    assert front(life) == "second"
    assert "already" in life.refused("/phases/second/feature", {"reason": "again"}, 409)
    line = life.json("/api/v1/organizer/audit?limit=1", "organizer")[0]
    assert (line["action"], line["subject"]) == ("phase featured", "second")
    life.change({"visibility": "hidden"}, "second")
    assert front(life) == "third"
    assert "hidden" in life.refused("/phases/second/feature", {"reason": "no"}, 409)
    assert (
        life.request("POST", "/api/v1/organizer/phases/first/feature", "alpha").status_code == 403
    )


def test_phases_can_be_put_in_order(life: "Life") -> None:
    for place, name in enumerate(("first", "second", "third")):
        life.make_phase(name, split="plain", position=30 - 10 * place)
    assert [one["id"] for one in life.json("/api/v1/phases")] == ["third", "second", "first"]


def test_a_phase_is_made_like_another_one(life: "Life") -> None:
    wanted: dict[str, Any] = {"quota_per_day": 7, "page": TEXTS, "description": "As before."}
    life.make_phase(split="plain", closes_at=FAR_AWAY, **wanted)
    organizer = visitor(life, "organizer")
    form = organizer.get("/organize/phases/new?like=test").text
    for value in ("As before.", 'value="7"', "You agree to **publish**.", TEXTS["data_url"]):
        assert value in form
    assert "2126" not in form
    assert '<option value="plain" selected>' in form
    life.change({"visibility": "archived"})
    form = organizer.get("/organize/phases/new?like=test").text
    assert ('value="shown" selected' in form, 'value="archived" selected' in form) == (True, False)
