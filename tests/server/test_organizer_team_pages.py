"""Teams, tokens and phases on the organizers' pages: each form's effect in the records."""

import re
from collections.abc import Callable
from datetime import timedelta
from typing import TYPE_CHECKING

import pytest
from sqlalchemy import select

from exceptiondrive_records.accounts.people import Identity, add_member, welcome_person
from exceptiondrive_records.accounts.tables import BrowserSession, Token
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.news.questions import answer_question, ask_question
from exceptiondrive_records.news.tables import Question
from exceptiondrive_records.participation.disqualification import disqualify_team
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import create_team, find_team, register_team

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Open = Callable[..., "TeamBrowser"]
TEAMS = "/organize/teams"
PHASES = "/organize/phases"


@pytest.fixture
def organizer(api_on_both: "Api", browse: Open) -> "TeamBrowser":
    """A browser in which an organizer signed in."""
    return browse(api_on_both, who="organizer")


@pytest.fixture
def one(api: "Api", browse: Open) -> "TeamBrowser":
    """The same, on SQLite alone."""
    return browse(api, who="organizer")


def badges(browser: "TeamBrowser", page: str) -> list[str]:
    return re.findall(r'class="badge st [^"]*">([^<]*)<', browser.get(page).text)


def settings(browser: "TeamBrowser", page: str) -> dict[str, str]:
    """What the fields of a page hold, as a browser would send them."""
    text = browser.get(page).text
    found = dict(re.findall(r'<input[^>]*name="([a-z_0-9.]+)"[^>]*value="([^"]*)"', text))
    for name in re.findall(r'type="checkbox" name="([a-z_]+)" value="yes">', text):
        found.pop(name, None)
    for name, body in re.findall(r'<select name="([a-z_]+)"[^>]*>(.*?)</select>', text):
        chosen = re.search(r'value="([^"]*)" selected', body)
        found[name] = chosen[1] if chosen else ""
    for name, body in re.findall(
        r'<textarea\s+name="(\w+)"[^>]*>(.*?)</textarea>', text, re.DOTALL
    ):
        found[name] = body
    found.pop("back", None)
    return found


def test_a_team_is_made_gets_a_token_once_and_loses_it(
    api_on_both: "Api", organizer: "TeamBrowser", browse: Open
) -> None:
    api = api_on_both
    taken = organizer.post(TEAMS, {"id": "alpha", "name": "<i>New</i>"}, page=TEAMS)
    assert (taken.status_code, "&lt;i&gt;New&lt;/i&gt;" in taken.text) == (409, True)
    made = organizer.post(TEAMS, {"id": "gamma", "name": "Gamma"}, page=TEAMS)
    here = f"{TEAMS}/gamma"
    assert made.headers["location"] == f"{here}?done=team_created"
    assert "No token yet: the team cannot do anything." in organizer.get(here).text
    with api.database.write() as session:
        ada = welcome_person(session, Identity("https://issuer.example", "ada")).id
        add_member(session, find_team(session, "gamma"), ada, actor="test")
    page = organizer.get(here).text
    assert ("No token yet." in page, "cannot do anything" in page) == (True, False)
    none = organizer.post(f"{here}/tokens", {"name": "desk"}, page=here)
    words = "The token may do nothing yet: tick at least one of submit, read:own, tokens."
    assert (none.status_code, words in none.text) == (400, True)
    issued = organizer.post(f"{here}/tokens", {"name": "desk", "scopes": "read:own"}, page=here)
    text = re.search(r"edk_s_[0-9A-Za-z_]{40,}", issued.text)
    assert text is not None
    assert issued.headers["cache-control"] == "no-store"
    assert text[0] not in organizer.get(here).text
    assert api.last_line().actor.startswith("token:")
    team = browse(api)
    assert team.sign_in_with(text[0]).status_code == 303
    token_id = text[0].split("_")[2]
    revoke = f"/organize/tokens/{token_id}/revoke"
    assert "for good" in organizer.get(revoke).text
    assert organizer.post(revoke, {}, page=revoke).headers["location"].startswith(here)
    assert team.get("/my").status_code == 303
    assert organizer.post(revoke, {}, page=revoke).status_code == 409


def test_a_registration_is_approved_or_refused(
    api_on_both: "Api", organizer: "TeamBrowser", browse: Open
) -> None:
    api = api_on_both
    with api.database.write() as session:
        text, _, _ = register_team(session, "delta", "Delta", "We are new.")
        register_team(session, "epsilon", "Epsilon", "So are we.")
    browse(api).sign_in_with(text)
    assert "We are new." in organizer.get(f"{TEAMS}?show=pending").text
    refuse = f"{TEAMS}/delta/refuse"
    assert organizer.post(refuse, {"reason": ""}, page=refuse).status_code == 400
    done = organizer.post(refuse, {"reason": "a second account"}, page=refuse)
    assert done.headers["location"] == f"{TEAMS}?done=team_refused"
    assert api.last_line().detail == {"reason": "a second account", "name": "Delta"}
    with api.database.read() as session:
        assert session.scalars(select(Team).where(Team.slug == "delta")).first() is None
        kept = {token.id for token in session.scalars(select(Token))}
        assert text.split("_")[2] not in kept
        assert {one.token_id for one in session.scalars(select(BrowserSession))} <= kept
    with api.database.write() as session:
        register_team(session, "delta", "Delta", "Once more.")
    approve = f"{TEAMS}/epsilon/approve"
    assert organizer.post(approve, {}, page=approve).status_code == 303
    with api.database.read() as session:
        assert find_team(session, "epsilon").pending_since is None
    refuse = f"{TEAMS}/epsilon/refuse"
    late = organizer.post(refuse, {"reason": "x"}, page=refuse)
    assert (late.status_code, "The team is approved" in late.text) == (409, True)


def test_a_refused_registration_takes_along_all_that_is_the_teams(
    api_on_both: "Api", organizer: "TeamBrowser"
) -> None:
    api = api_on_both
    with api.database.write() as session:
        _, _, team = register_team(session, "delta", "Delta", "We are new.")
        ask_question(session, team.id, "dev", "May we use maps?", actor="delta")
    with api.database.write() as session, pytest.raises(Conflict, match="refuse its registration"):
        disqualify_team(session, "delta", reason="a second account", actor="test")
    with api.database.read() as session:
        assert session.scalars(select(Question)).first()
    refuse = f"{TEAMS}/delta/refuse"
    done = organizer.post(refuse, {"reason": "a second account"}, page=refuse)
    assert done.headers["location"] == f"{TEAMS}?done=team_refused"
    with api.database.read() as session:
        assert session.scalars(select(Question)).first() is None
        assert session.scalars(select(Team).where(Team.slug == "delta")).first() is None


def test_a_phase_is_made_and_a_deadline_is_moved(
    api_on_both: "Api", organizer: "TeamBrowser"
) -> None:
    new = f"{PHASES}/new"
    assert "that <code>exceptiondrive data</code> downloads." in organizer.get(new).text
    assert "`" not in re.sub(r"<script.*?</script>", "", organizer.get(new).text, flags=re.DOTALL)
    form = settings(organizer, new)
    assert (form["quota_per_day"], form["late_entries"]) == ("", "refused")
    form |= {"id": "final", "title": "Final", "challenge": "planning", "split": "sample"}
    form |= {"protocol": "1.0", "closes_at": "2099-11-21T12:00", "anonymous": "yes"}
    wrong = organizer.send(new, {**form, "quota_per_day": "0", "opens_at": "soon"})
    assert wrong.status_code == 400
    for words in ("Submissions per day: must be", "Opens at: must be", 'value="2099-11-21T12:00"'):
        assert words in wrong.text
    made = organizer.send(new, form)
    assert made.status_code == 303, re.findall(r"Refused.*", made.text)
    assert made.headers["location"] == f"{PHASES}/final?done=phase_created"
    here = f"{PHASES}/final"
    form = settings(organizer, here)
    assert (form["closes_at"], form["anonymous"]) == ("2099-11-21T12:00:00", "yes")
    n_before = api_on_both.last_line().id
    assert organizer.send(here, form).status_code == 303
    assert api_on_both.last_line().id == n_before, "nothing differed, so nothing was changed"
    moved = {**form, "closes_at": "2099-12-01T00:00:00", "quota_total": "9"}
    assert organizer.send(here, moved).status_code == 303
    line = api_on_both.last_line()
    assert line.action == "phase changed"
    assert line.detail == {
        "closes_at": ["2099-11-21T12:00:00Z", "2099-12-01T00:00:00Z"],
        "quota_total": [20, 9],
    }
    assert "phase changed" in organizer.get(here).text
    past = organizer.send(here, {**settings(organizer, here), "closes_at": "2001-01-01T00:00"})
    assert (past.status_code, "“Closes at” is in the past" in past.text) == (400, True)


def test_the_life_of_a_phase_is_steered_with_reasons(api: "Api", one: "TeamBrowser") -> None:
    here = f"{PHASES}/dev"
    freeze = f"{here}/freeze"
    assert "Freeze the board" in one.get(here).text
    assert one.post(freeze, {"reason": " "}, page=freeze).status_code == 400
    assert one.post(freeze, {"reason": "the last week"}, page=freeze).status_code == 303
    with api.database.read() as session:
        assert find_phase(session, "dev").policy.freezes_at is not None
    assert one.post(freeze, {"reason": "again"}, page=freeze).status_code == 409
    reveal = f"{here}/reveal-board"
    assert one.post(reveal, {"reason": "the prizes"}, page=reveal).status_code == 303
    assert one.get(f"{here}/no-such").status_code == 404
    assert one.get(f"{PHASES}/no-such").status_code == 404


@pytest.mark.parametrize(
    ("dates", "word"),
    [
        ({"opens_at": "2099-01-01T00:00"}, "upcoming"),
        ({}, "open"),
        ({"opens_at": "2020-01-01T00:00", "closes_at": "2020-02-01T00:00"}, "closed"),
    ],
)
def test_a_phase_is_said_to_be_upcoming_open_or_closed(
    one: "TeamBrowser", dates: dict[str, str], word: str
) -> None:
    form = settings(one, f"{PHASES}/new") | {"id": "next", "title": "Next"}
    form |= {"challenge": "planning", "split": "sample", "protocol": "1.0", **dates}
    made = one.send(f"{PHASES}/new", form)
    assert made.status_code == 303
    assert ("its deadline has passed" in one.get(made.headers["location"]).text) == (
        word == "closed"
    )
    assert badges(one, f"{PHASES}/next")[0] == word
    row = one.get(PHASES).text.split('href="/organize/phases/next"')[1]
    assert re.findall(r'class="badge st [^"]*">([^<]*)<', row)[0] == word


WHY = {"reason": "as announced"}
RULES = "Be kind.\r\nBe fast."
PAGES = (
    (f"{PHASES}/dev", {"title": "Mine"}, {"quota_per_day": "7", "opens_at": "2026-10-01T00:00:05"}),
    (f"{PHASES}/dev", {"quota_per_day": "7"}, {"title": "Theirs", "rules": RULES}),
    ("/organize/site", {"contact": "ada@example.org"}, {"paper_url": "https://example.org/p"}),
    (f"{TEAMS}/alpha/change", {"affiliation": "Mine"}, {"name": "Theirs"}),
    (f"{TEAMS}/alpha/allowances/dev", {"quota_per_day": "7"}, {"quota_total": "9"}),
)


@pytest.mark.parametrize(("page", "mine", "theirs"), PAGES)
def test_what_one_leaves_alone_is_not_taken_back_from_another(
    organizer: "TeamBrowser", page: str, mine: dict[str, str], theirs: dict[str, str]
) -> None:
    shown = settings(organizer, page)
    assert organizer.send(page, {**shown, **WHY, **theirs}).status_code == 303
    assert organizer.send(page, {**shown, **WHY, **mine}).status_code == 303
    after = settings(organizer, page)
    changed = {**mine, **theirs}
    assert {name: after[name].replace("\n", "\r\n") for name in changed} == changed


def test_a_refused_form_keeps_the_lines_of_a_text(one: "TeamBrowser") -> None:
    page = f"{PHASES}/dev"
    form = {**settings(one, page), "rules": RULES}
    refused = one.send(page, {**form, "quota_per_day": "many"})
    assert refused.status_code == 400
    shown = re.search(r'<textarea\s+name="rules"[^>]*>(.*?)</textarea>', refused.text, re.DOTALL)
    assert shown is not None
    assert shown[1] == "Be kind.\nBe fast."
    assert one.send(page, {**form, "rules": shown[1].replace("\n", "\r\n")}).status_code == 303
    assert settings(one, page)["rules"] == "Be kind.\nBe fast."


@pytest.mark.parametrize(
    ("page", "name", "values"),
    [
        (f"{PHASES}/dev", "closes_at", ("2100-01-01T00:00:00", "2100-02-02T00:00:00")),
        (f"{PHASES}/dev", "rules", ("Be kind.", "Be fast.")),
        ("/organize/site", "paper_url", ("https://example.org/a", "https://example.org/b")),
        (f"{TEAMS}/alpha/change", "name", ("Alef", "Aleph")),
        (f"{TEAMS}/alpha/allowances/dev", "quota_per_day", ("7", "8")),
    ],
)
def test_what_two_change_at_once_is_refused_to_the_second_until_it_is_said_again(
    organizer: "TeamBrowser", page: str, name: str, values: tuple[str, str]
) -> None:
    first, second = values
    shown = settings(organizer, page)
    assert organizer.send(page, {**shown, **WHY, name: first}).status_code == 303
    refused = organizer.send(page, {**shown, **WHY, name: second})
    assert refused.status_code == 409
    assert "Changed since this page was shown" in refused.text
    assert f"which is {first} now" in refused.text
    assert settings(organizer, page)[name] == first
    assert second in refused.text
    mark = re.search(rf'name="was.{name}" value="(\w+)"', refused.text)
    assert mark is not None
    again = {**shown, **WHY, name: second, f"was.{name}": mark[1]}
    assert organizer.send(page, again).status_code == 303
    assert settings(organizer, page)[name] == second


def test_a_long_text_that_two_change_is_named_by_its_beginning(one: "TeamBrowser") -> None:
    page = f"{PHASES}/dev"
    shown = settings(one, page)
    assert one.send(page, {**shown, "rules": "Theirs. " * 1000}).status_code == 303
    refused = one.send(page, {**shown, "rules": "Mine."})
    assert refused.status_code == 409
    notice = refused.text.split('id="refusal"')[1].split("</div>")[0]
    assert "Rules, which is Theirs." in notice
    assert len(notice) < 500


def test_a_refused_form_shows_what_was_changed_meanwhile_in_what_was_left_alone(
    one: "TeamBrowser",
) -> None:
    page = f"{PHASES}/dev"
    shown = settings(one, page)
    assert one.send(page, {**shown, "title": "Theirs"}).status_code == 303
    refused = one.send(page, {**shown, "quota_per_day": "many"})
    assert refused.status_code == 400
    assert re.search(r'name="title"[^>]*value="Theirs"', refused.text)
    assert 'value="many"' in refused.text


@pytest.mark.parametrize(
    "page",
    [f"{PHASES}/dev", "/organize/site", f"{TEAMS}/alpha/change", f"{TEAMS}/alpha/allowances/dev"],
)
def test_a_form_that_changes_nothing_says_so_and_leaves_no_line(
    api: "Api", one: "TeamBrowser", page: str
) -> None:
    before = api.last_line().id
    answer = one.send(page, {**settings(one, page), **WHY})
    assert answer.headers["location"].endswith("?done=nothing_changed")
    assert "Nothing was changed" in one.get(answer.headers["location"]).text
    assert api.last_line().id == before


def listed(browser: "TeamBrowser", page: str) -> list[str]:
    """What stands first in each row of the table of a page."""
    rows = re.findall(r'<th scope="row"[^>]*>(.*?)</th>', browser.get(page).text, re.DOTALL)
    return [" ".join(re.sub(r"<[^>]*>", " ", row).split()) for row in rows]


def test_teams_and_people_are_found_among_many(one: "TeamBrowser") -> None:
    with one.api.database.write() as session:
        for number in range(30):
            team = create_team(session, f"t{number}", f"Lab {number}", actor="test")
            team.affiliation = "Åbo Akademi" if number == 7 else "Elsewhere"
            name, mail = f"Person {number}", f"p{number}@example.org"
            welcome_person(session, Identity("https://id.test", f"s{number}", name, mail))
    for asked, found in (
        ("åbo", ["Lab 7"]),
        ("elsewhere 12", ["Lab 12"]),
        ("t29", ["Lab 29"]),
        ("alpha", ["Alpha"]),
    ):
        assert listed(one, f"{TEAMS}?q={asked}") == found
    assert "1 of 32 teams match “åbo”." in one.get(f"{TEAMS}?q=åbo").text
    nobody = one.get(f"{TEAMS}?q=nobody").text
    assert ("0 of 32 teams" in nobody, "No team yet" in nobody) == (True, False)
    assert len(listed(one, TEAMS)) == 32
    assert listed(one, "/organize/people?q=p3@") == ["Person 3 p3@example.org"]
    assert "1 of 30 people" in one.get("/organize/people?q=p3@").text


def test_choosers_list_teams_by_the_name_that_they_show(one: "TeamBrowser") -> None:
    with one.api.database.write() as session:
        for slug, name in (("a1", "zeta"), ("a2", "Aachen"), ("z9", "Middle")):
            create_team(session, slug, name, actor="test")
    names = ["Aachen", "Alpha", "Beta", "Middle", "zeta"]
    for page, option in (
        ("/organize/submissions", r'<option value="[a-z0-9-]+">([A-Za-z]+)</option>'),
        ("/organize/messages", r'name="teams"[^>]*>\s*<span class="written">(.*?)</span>'),
    ):
        assert re.findall(option, one.get(page).text)[: len(names)] == names
    merge = re.findall(
        r'<option value="[a-z0-9]+">(\w+)</option>', one.get(f"{TEAMS}/a1/merge").text
    )
    assert merge == [name for name in names if name != "zeta"]


def test_the_history_of_a_team_leads_to_what_it_leaves_out(one: "TeamBrowser") -> None:
    page, link = f"{TEAMS}/alpha", 'href="/organize/audit?subject=alpha">All lines'
    assert link not in one.get(page).text
    with one.api.database.write() as session:
        for number in range(60):
            audit(session, "test", "team changed", "alpha", {"number": number})
    assert link in one.get(page).text


def test_what_waits_stands_before_the_newest_answers(one: "TeamBrowser") -> None:
    with one.api.database.write() as session:
        team_id = find_team(session, "alpha").id
        for number in range(60):
            asked = ask_question(session, team_id, "dev", f"Question {number}?", actor="test")
            words = f"Answer {number}."
            answer_question(session, asked.id, words, plain=words, to_all=False, actor="test")
            asked.answered_at = database_now(session) + timedelta(seconds=number)
        for minutes_ago, text in ((2, "First wait?"), (1, "Second wait?")):
            waits = ask_question(session, team_id, "dev", text, actor="test")
            waits.asked_at -= timedelta(minutes=minutes_ago)
    page = "/organize/news"
    rows = listed(one, page)
    assert rows[:3] == ["First wait?", "Second wait?", "Question 59?"]
    assert (len(rows), "Questions: 2 wait for an answer" in squeezed(one.get(page).text)) == (
        52,
        True,
    )
    older = re.search(
        r'href="(/organize/news\?[^"]*)"\s*>\s*Older answers \(10\)', one.get(page).text
    )
    assert older is not None
    assert len(listed(one, older[1].replace("&amp;", "&"))) == 62


def squeezed(text: str) -> str:
    return " ".join(text.split())
