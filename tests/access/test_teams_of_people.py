"""Members, invitations, self-registration of a person, and for whom somebody acts."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import select, update

from exceptiondrive_records.accounts.people import (
    MAX_INVITATIONS_A_DAY,
    MAX_MEMBERS,
    MAX_OPEN_INVITATIONS,
    Identity,
    accept_invitation,
    add_member,
    find_invitation,
    invite,
    is_member,
    members_of,
    open_invitations,
    remove_member,
    set_organizer,
    welcome_person,
    withdraw_invitation,
)
from exceptiondrive_records.accounts.roles import OrganizerRole
from exceptiondrive_records.accounts.tables import BrowserSession, Invitation, Membership, Person
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.errors import Conflict, NotFound
from exceptiondrive_records.teams.teams import find_team, switch_self_registration

if TYPE_CHECKING:
    from tests.access.people import PersonBrowser, RunningProvider
    from tests.support.application import Api, TeamBrowser

    from exceptiondrive_records.db.database import Database

Open = Callable[["Api"], "PersonBrowser"]
Browse = Callable[..., "TeamBrowser"]
EVE = {"sub": "sub-eve", "name": "Eve <b>Example</b>", "email": "eve@example.org"}


def invitation_from(page: Any) -> str:
    """Return the path of the link that a page shows."""
    assert page.status_code == 200, page.text
    assert 'data-page="/my/team"' in page.text, "loaded anew it invites nobody else"
    start = page.text.index("https://server.test/join/") + len("https://server.test")
    return str(page.text[start:].split("<")[0].split('"')[0])


def invited_by_token(site: "Api", browse: Browse) -> str:
    browser = browse(site, who="alpha")
    return invitation_from(browser.post("/my/team/invitations", {}, page="/my/team"))


def actions(site: "Api") -> list[str]:
    with site.database.read() as session:
        return list(session.scalars(select(AuditLine.action).order_by(AuditLine.id)))


def test_somebody_invited_joins_submits_and_invites_the_next(
    site: "Api", person: Open, browse: Browse, provider: "RunningProvider"
) -> None:
    link = invited_by_token(site, browse)
    ada = person(site)
    shown = ada.get(link)
    assert "Sign in with Example University" in shown.text
    assert ada.sign_in(back=link).headers["location"] == link
    assert "Join Alpha" in ada.get(link).text
    joined = ada.post(link, {}, page=link)
    assert joined.headers["location"] == "/my/team"
    assert "Ada Example" in ada.get("/my/team").text
    assert ada.browser.submit("a").status_code == 303
    assert "Planner" in ada.get("/my").text
    provider.order(person=EVE)
    eve = person(site)
    second = invitation_from(ada.post("/my/team/invitations", {}, page="/my/team"))
    eve.sign_in(back=second)
    eve.post(second, {}, page=second)
    page = ada.get("/my/team").text
    assert "Eve &lt;b&gt;Example&lt;/b&gt;" in page
    assert "eve@example.org" in page
    told = [action for action in actions(site) if "invit" in action or "member" in action]
    assert told == ["invitation made", "member joined"] * 2


@pytest.mark.parametrize(
    "rights",
    [
        {"scopes": ["read:own", "tokens"]},
        {"scopes": ["submit", "read:own", "tokens"], "expires_at": "2099-01-01T00:00:00Z"},
    ],
)
def test_no_token_invites_into_more_rights_than_its_own(
    small_site: "Api", browse: Browse, rights: dict[str, Any]
) -> None:
    made = small_site.post("/tokens", "alpha", json={"name": "less", **rights})
    small_site.tokens["less"] = made.json()["token"]
    browser = browse(small_site, who="less")
    page = browser.get("/my/team").text
    assert "Invite somebody</button>" not in page
    refused = browser.post("/my/team/invitations", {}, page="/my/tokens")
    assert refused.status_code == 403
    assert "all scopes of a team" in refused.text
    assert "invitation made" not in actions(small_site)


def test_looking_at_an_invitation_uses_nothing_up(
    small_site: "Api", person: Open, browse: Browse
) -> None:
    link = invited_by_token(small_site, browse)
    for _ in range(3):
        assert browse(small_site).get(link).status_code == 200
    ada = person(small_site)
    ada.sign_in()
    assert ada.get("/my").headers["location"] == "/my/team"
    assert ada.post(link, {}, page=link).status_code == 303


def test_an_invitation_works_once_within_its_week_and_only_whole(
    small_site: "Api", person: Open, browse: Browse, provider: "RunningProvider"
) -> None:
    ada, eve = person(small_site), person(small_site)
    ada.sign_in()
    provider.order(person=EVE)
    eve.sign_in()
    link = invited_by_token(small_site, browse)
    for wrong in (link[:-1], link + "x", link.split(".")[0], "/join/x", "/join/" + "x" * 200):
        assert eve.get(wrong).status_code == 404
        assert eve.post(wrong, {}, page="/my/team").status_code == 404
    ada.post(link, {}, page=link)
    assert eve.get(link).status_code == 404
    assert "it was used or withdrawn, or its week is over" in eve.get(link).text
    assert eve.post(link, {}, page="/my/team").status_code == 404
    link = invited_by_token(small_site, browse)
    with small_site.database.write() as session:
        session.execute(update(Invitation).values(expires_at=datetime.now(UTC)))
    assert eve.post(link, {}, page="/my/team").status_code == 404


def test_a_team_invites_only_so_often_a_day(small_site: "Api") -> None:
    """Each leaves a row and audit lines for ever, however soon it is withdrawn."""
    team_id = small_site.team_ids["alpha"]
    with small_site.database.write() as session:
        for _ in range(MAX_INVITATIONS_A_DAY):
            _, made = invite(session, team_id, "Ada", actor="test")
            withdraw_invitation(session, team_id, made.id, actor="test")
        with pytest.raises(Conflict, match="in 24 hours"):
            invite(session, team_id, "Ada", actor="test")
        made.created_at -= timedelta(days=1)
        assert invite(session, team_id, "Ada", actor="test")


def test_a_team_has_only_so_many_open_invitations(small_site: "Api") -> None:
    team_id = small_site.team_ids["alpha"]
    with small_site.database.write() as session:
        for _ in range(MAX_OPEN_INVITATIONS):
            _, made = invite(session, team_id, "Ada", actor="test")
        with pytest.raises(Conflict, match="withdraw one first"):
            invite(session, team_id, "Ada", actor="test")
        withdraw_invitation(session, team_id, made.id, actor="test")
        assert invite(session, team_id, "Ada", actor="test")


def test_an_organizers_invitations_end_with_the_role_but_not_those_into_their_own_team(
    small_site: "Api",
) -> None:
    alpha, beta = (small_site.team_ids[name] for name in ("alpha", "beta"))
    with small_site.database.write() as session:
        ben = welcome_person(session, Identity("https://provider.test", "ben")).id
        add_member(session, find_team(session, "alpha"), ben, actor="test")
        set_organizer(session, ben, OrganizerRole.HELPER, actor="test")
        invite(session, alpha, "Ben", actor=f"person:{ben}")
        set_organizer(session, ben, OrganizerRole.OWNER, actor="test")
        invite(session, beta, "Ben", actor=f"person:{ben}")
        set_organizer(session, ben, None, actor="test")
        assert [len(open_invitations(session, team)) for team in (alpha, beta)] == [1, 0]


def test_who_was_removed_comes_not_back_by_the_link_that_they_joined_by(small_site: "Api") -> None:
    team_id = small_site.team_ids["alpha"]
    with small_site.database.write() as session:
        stays, goes = (
            welcome_person(session, Identity("https://provider.test", name)).id
            for name in ("stays", "goes")
        )
        add_member(session, find_team(session, "alpha"), stays, actor="test")
        link, _ = invite(session, team_id, "Ada", actor="test")
        assert accept_invitation(session, link, goes, actor="test").id == team_id
        assert accept_invitation(session, link, goes, actor="test").id == team_id
        remove_member(session, team_id, goes, actor="test")
        with pytest.raises(NotFound):
            find_invitation(session, link, goes)
        with pytest.raises(NotFound):
            accept_invitation(session, link, goes, actor="test")


def test_a_team_is_full_of_its_own_members_alone_each_of_whom_joins_once(
    small_site: "Api",
) -> None:
    with small_site.database.write() as session:
        alpha, beta = (find_team(session, slug) for slug in ("alpha", "beta"))
        *many, last = (
            welcome_person(session, Identity("https://provider.test", f"sub-{number}")).id
            for number in range(MAX_MEMBERS + 1)
        )
        for person_id in (*many, many[0]):
            add_member(session, alpha, person_id, actor="test")
        add_member(session, beta, last, actor="test")
        with pytest.raises(Conflict, match="at most 50 members"):
            add_member(session, alpha, last, actor="test")
        assert len(members_of(session, alpha.id)) == MAX_MEMBERS


def test_an_invitation_is_kept_as_a_digest(small_site: "Api", browse: Browse) -> None:
    secret = invited_by_token(small_site, browse).partition(".")[2]
    with small_site.database.read() as session:
        (kept,) = session.scalars(select(Invitation))
    assert secret not in repr(vars(kept))


def test_a_withdrawn_invitation_is_useless(small_site: "Api", person: Open, browse: Browse) -> None:
    link = invited_by_token(small_site, browse)
    keeper = browse(small_site, who="alpha")
    name = link.removeprefix("/join/").partition(".")[0]
    stranger = browse(small_site, who="beta")
    path = f"/my/team/invitations/{name}/withdraw"
    assert stranger.post(path, {}, page="/my/team").status_code == 404
    assert keeper.post(path, {}, page="/my/team").status_code == 303
    ada = person(small_site)
    ada.sign_in()
    assert ada.get(link).status_code == 404


def test_a_removed_member_is_out_at_once(
    site: "Api", person: Open, browse: Browse, provider: "RunningProvider"
) -> None:
    link = invited_by_token(site, browse)
    ada = person(site)
    ada.sign_in(back=link)
    ada.post(link, {}, page=link)
    with site.database.read() as session:
        person_id = session.scalars(select(Person.id)).one()
    path = f"/my/team/members/{person_id}/remove"
    stranger = browse(site, who="beta")
    assert stranger.post(path, {}, page="/my/team").status_code == 404
    assert ada.get("/my").status_code == 200
    assert "You are out of Alpha at once" in ada.get("/my/team").text
    keeper = browse(site, who="alpha")
    ada.post("/my/tokens", {"name": "kept", "scopes": "submit", "days": ""}, page="/my/tokens")
    asked = keeper.get("/my/team").text.split('<details class="danger">')[1]
    assert '<a href="/my/notices">addresses</a> are told as before' in " ".join(asked.split())
    assert "Ada Example is out of Alpha at once" in asked
    assert "What was made by Ada Example works on: <b>kept</b>" in " ".join(asked.split())
    assert '<td data-k="made by">Ada Example</td>' in keeper.get("/my/tokens").text
    assert keeper.post(path, {}, page="/my/team").status_code == 303
    for page in ("/my", "/my/tokens", "/submissions/x"):
        assert ada.get(page).headers["location"] == "/my/team"
    out = " ".join(ada.get("/my/team").text.split())
    assert "You were taken out of Alpha on " in out
    assert "for an invitation to come back" in out
    refused = ada.browser.send("/submit", {}, files={"file": ("planner.json", b"a")})
    assert refused.headers["location"] == "/my/team"
    assert "member removed" in actions(site)
    assert '<td data-k="made by">Ada Example, no member now</td>' in keeper.get("/my/tokens").text


def test_no_invitation_that_a_removed_member_made_leads_back_in(
    site: "Api", person: Open, browse: Browse
) -> None:
    link = invited_by_token(site, browse)
    ada = person(site)
    ada.sign_in(back=link)
    ada.post(link, {}, page=link)
    own = invitation_from(ada.post("/my/team/invitations", {}, page="/my/team"))
    others = invited_by_token(site, browse)
    with site.database.read() as session:
        person_id = session.scalars(select(Person.id)).one()
    keeper = browse(site, who="alpha")
    keeper.post(f"/my/team/members/{person_id}/remove", {}, page="/my/team")
    assert ada.get(own).status_code == 404
    assert ada.post(own, {}, page="/my/team").status_code == 404
    assert actions(site)[-2:] == ["member removed", "invitation withdrawn"]
    assert ada.get(others).status_code == 200


@pytest.mark.parametrize("path", ["/my/team/invitations", "/my/tokens"])
def test_who_is_removed_while_a_form_of_theirs_is_in_the_air_gets_nothing_of_it(
    small_site: "Api", person: Open, browse: Browse, path: str
) -> None:
    """Whoever sends it slowly would keep an invitation, or a token, that nobody took away."""
    link = invited_by_token(small_site, browse)
    ada = person(small_site)
    ada.sign_in(back=link)
    ada.post(link, {}, page=link)
    good = ada.browser.form_token("/my/team")
    before = actions(small_site)

    def slowly() -> Iterator[bytes]:
        yield f"form_token={good}&".encode()
        with small_site.database.write() as session:
            (member,) = session.scalars(select(Membership))
            remove_member(session, member.team_id, member.person_id, actor="test")
        yield b"name=kept&scope=submit&days="

    headers = {"Origin": ada.browser.origin, "Content-Type": "application/x-www-form-urlencoded"}
    answer = ada.browser.client.post(path, content=slowly(), headers=headers)
    assert actions(small_site)[len(before) :] == ["member removed"]
    assert (answer.status_code, answer.headers["location"][:9]) == (303, "/sign-in?")


@pytest.mark.parametrize(
    ("action", "is_ended"),
    [
        (("revoke", {}), True),
        (("rotate", {"keep_days": "0"}), True),
        (("rotate", {"keep_days": "7"}), False),
    ],
)
def test_invitations_of_a_token_end_with_it(
    small_site: "Api", browse: Browse, action: tuple[str, dict[str, str]], is_ended: bool
) -> None:
    link = invited_by_token(small_site, browse)
    keeper = browse(small_site, who="alpha")
    token_id = small_site.tokens["alpha"].split("_")[2]
    done = keeper.post(f"/my/tokens/{token_id}/{action[0]}", action[1], page="/my/tokens")
    assert done.status_code in (200, 303), done.text
    assert browse(small_site).get(link).status_code == (404 if is_ended else 200)


def test_a_member_does_not_use_up_an_invitation_of_the_own_team(
    small_site: "Api", person: Open, browse: Browse, provider: "RunningProvider"
) -> None:
    link = invited_by_token(small_site, browse)
    ada = person(small_site)
    ada.sign_in(back=link)
    ada.post(link, {}, page=link)
    second = invitation_from(ada.post("/my/team/invitations", {}, page="/my/team"))
    assert "Nobody is left in it then" in ada.get("/my/team").text
    shown = ada.get(second).text
    assert "You belong to Alpha already: send this link on" in shown
    assert "Join Alpha</button>" not in shown
    assert ada.post(second, {}, page="/my/team").status_code == 303
    provider.order(person=EVE)
    eve = person(small_site)
    eve.sign_in(back=second)
    assert eve.post(second, {}, page=second).headers["location"] == "/my/team"
    assert "Nobody is left in it then" not in ada.get("/my/team").text


def test_who_joined_by_a_link_is_told_so_by_it_and_everybody_else_that_it_is_used(
    small_site: "Api", person: Open, browse: Browse, provider: "RunningProvider"
) -> None:
    """As after a second click on the button, or on the link in the mail."""
    link = invited_by_token(small_site, browse)
    ada = person(small_site)
    ada.sign_in(back=link)
    for _ in range(2):
        assert ada.post(link, {}, page="/my/team").headers["location"] == "/my/team"
    again = ada.get(link)
    assert (again.status_code, "send this link on" in again.text) == (200, False)
    assert "You belong to Alpha already, by this link" in again.text
    assert browse(small_site).get(link).status_code == 404
    provider.order(person=EVE)
    eve = person(small_site)
    eve.sign_in()
    assert eve.post(link, {}, page="/my/team").status_code == 404
    with small_site.database.read() as session:
        person_id = session.scalars(select(Membership.person_id)).one()
    ada.post(f"/my/team/members/{person_id}/remove", {}, page="/my/team")
    assert "You left Alpha on " in ada.get("/my/team").text
    assert "You left" not in eve.get("/my/team").text
    assert ada.get(link).status_code == 404
    assert ada.post(link, {}, page="/my/team").status_code == 404


def test_who_cannot_submit_reads_why_on_the_page_of_it(
    small_site: "Api", person: Open, browse: Browse
) -> None:
    """To sign in would lead back here."""
    ada, organizer, reader = person(small_site), browse(small_site), browse(small_site)
    ada.sign_in()
    organizer.sign_in("organizer")
    made = small_site.post("/tokens", "alpha", json={"name": "r", "scopes": ["read:own"]})
    small_site.tokens["reader"] = made.json()["token"]
    reader.sign_in("reader")
    for browser, said in (
        (ada, "You act for no team yet"),
        (organizer, "You are signed in as an organizer"),
        (reader, "a token that may not submit"),
    ):
        page = browser.get("/submit").text
        assert said in page
        assert "Sign in to submit" not in page
    assert "Sign in to submit" in browse(small_site).get("/submit").text


def test_an_organizer_who_acts_for_a_team_reads_how_to_organize(
    small_site: "Api", person: Open, browse: Browse
) -> None:
    link = invited_by_token(small_site, browse)
    ada = person(small_site)
    ada.sign_in(back=link)
    ada.post(link, {}, page=link)
    refused = ada.get("/organize")
    assert (
        refused.status_code,
        "choose to act as an organizer on the page Team" in refused.text,
    ) == (403, True)


def test_an_organizer_without_a_team_finds_the_way_to_organize(
    small_site: "Api", person: Open, browse: Browse
) -> None:
    """As after `exceptiondrive organizer people set`, or after leaving a team."""
    ada = person(small_site)
    ada.sign_in()
    assert "To submit you need a team" in ada.get("/my/team").text
    with small_site.database.write() as session:
        person_id = session.scalars(select(Person.id)).one()
        set_organizer(session, person_id, OrganizerRole.OWNER, actor="test")
    assert ">Organizer</button>" in ada.get("/my/team").text
    led = ada.post("/my/team/act-for", {"team": ""}, page="/my/team")
    assert led.headers["location"] == "/organize"
    assert 'href="/organize"' in ada.get("/").text
    link = invited_by_token(small_site, browse)
    ada.post(link, {}, page=link)
    assert 'href="/organize"' not in ada.get("/").text, "who acts for a team organizes nothing"
    ada.post(f"/my/team/members/{person_id}/remove", {}, page="/my/team")
    assert ">Organizer</button>" in ada.get("/my/team").text


@pytest.mark.parametrize("is_organizer", [True, False])
def test_who_belongs_to_a_team_and_acts_for_none_is_offered_it_and_no_new_one(
    small_site: "Api", person: Open, is_organizer: bool
) -> None:
    """As an organizer, or where the team that they acted for was merged into another."""
    ada = person(small_site)
    ada.sign_in()
    with small_site.database.write() as session:
        switch_self_registration(session, True, actor="test")
        person_id = session.scalars(select(Person.id)).one()
    assert "Register a team" in ada.get("/my/team").text
    with small_site.database.write() as session:
        if is_organizer:
            set_organizer(session, person_id, OrganizerRole.OWNER, actor="test")
        add_member(session, find_team(session, "alpha"), person_id, actor="test")
    page = ada.get("/my/team").text
    assert ">Alpha</button>" in page
    for words in ("No team", "Welcome", "Register a team"):
        assert words not in page, words


def test_who_came_back_to_a_team_reads_nothing_of_having_left_it(
    small_site: "Api", person: Open
) -> None:
    ada = person(small_site)
    ada.sign_in()
    with small_site.database.write() as session:
        person_id = session.scalars(select(Person.id)).one()
        add_member(session, find_team(session, "alpha"), person_id, actor="test")
    team_id = small_site.team_ids["alpha"]
    with small_site.database.write() as session:
        remove_member(session, team_id, person_id, actor=f"person:{person_id}")
    assert "You left Alpha on" in ada.get("/my/team").text
    with small_site.database.write() as session:
        add_member(session, find_team(session, "alpha"), person_id, actor="test")
    page = ada.get("/my/team").text
    assert ">Alpha</button>" in page
    assert "You left" not in page


@pytest.mark.parametrize(
    "path",
    ["/my/team/act-for", "/my/team/invitations", "/my/team/invitations/x/withdraw",
     "/my/team/members/x/remove", "/my/team/register", "/join/x"],
)  # fmt: skip
def test_no_form_is_taken_from_elsewhere(small_site: "Api", person: Open, path: str) -> None:
    ada = person(small_site)
    ada.sign_in()
    good = ada.browser.form_token("/my/team")
    assert ada.browser.send(path, {"form_token": "wrong"}).status_code == 403
    headers = {"Origin": "https://evil.test"}
    answer = ada.browser.client.post(path, data={"form_token": good}, headers=headers)
    assert answer.status_code == 403


def test_a_person_of_no_team_gets_into_no_page_of_one(small_site: "Api", person: Open) -> None:
    ada = person(small_site)
    ada.sign_in()
    for page in ("/my", "/my/tokens", "/submissions/x", "/submissions/x/events"):
        assert ada.get(page).headers.get("location") == "/my/team"
    for path in ("/my/tokens", "/my/team/invitations", "/submissions/x/withdraw"):
        assert ada.post(path, {}, page="/my/team").headers.get("location") == "/my/team"


def test_one_acts_for_own_teams_alone_and_organizers_do_not_mix(
    site: "Api", person: Open, browse: Browse
) -> None:
    link = invited_by_token(site, browse)
    ada = person(site)
    ada.sign_in(back=link)
    ada.post(link, {}, page=link)
    beta = str(site.team_ids["beta"])
    for wrong in (beta, "9999", "x", "-1", "1e3"):
        answer = ada.post("/my/team/act-for", {"team": wrong}, page="/my/team")
        assert answer.status_code in (400, 403)
    with site.database.write() as session:
        person_id = session.scalars(select(Person.id)).one()
        set_organizer(session, person_id, OrganizerRole.OWNER, actor="test")
    assert "My submissions" in ada.get("/my").text
    ada.post("/my/team/act-for", {"team": ""}, page="/my/team")
    assert "All submissions" in ada.get("/my").text
    with site.database.write() as session:
        set_organizer(session, person_id, None, actor="test")
    assert ada.get("/my").headers["location"] == "/my/team"


def test_a_form_that_was_opened_for_one_team_does_nothing_for_another(
    small_site: "Api", person: Open, browse: Browse
) -> None:
    """Another tab chooses the other team meanwhile."""
    ada = person(small_site)
    ada.sign_in()
    alpha, beta = (small_site.team_ids[name] for name in ("alpha", "beta"))
    with small_site.database.write() as session:
        person_id = session.scalars(select(Person.id)).one()
        for team in (find_team(session, "alpha"), find_team(session, "beta")):
            add_member(session, team, person_id, actor="test")
    ada.sign_in()
    missing = ada.get("/submissions/of-beta")
    assert (missing.status_code, 'href="/my/team">For which team' in missing.text) == (404, True)
    for nobody in (None, "organizer"):
        assert "For which team" not in browse(small_site, who=nobody).get("/phases/nowhere").text
    opened = {path: ada.browser.form(path) for path in ("/submit", "/my/tokens")}
    ada.post("/my/team/act-for", {"team": str(beta)}, page="/my/team")
    before = actions(small_site)
    upload = {**opened["/submit"], "phase": "dev", "method": "Planner"}
    answers = [
        ada.browser.send("/submit", upload, "text/html", files={"file": ("a.json", b"a")}),
        ada.browser.send("/my/tokens", {**opened["/my/tokens"], "name": "x"}, "text/html"),
    ]
    for answer in answers:
        assert answer.status_code == 403
        assert "was opened while you acted for another team" in " ".join(answer.text.split())
    assert actions(small_site) == before
    ada.post("/my/team/act-for", {"team": str(alpha)}, page="/my/team")
    assert ada.browser.send("/submit", upload, files={"file": ("a.json", b"a")}).status_code == 303


def test_a_person_registers_a_team_where_that_is_switched_on(
    small_site: "Api", person: Open
) -> None:
    ada = person(small_site)
    assert "Sign in as a person, and read how you get one." in ada.get("/sign-in").text
    ada.sign_in()
    for words in ("To submit you need a team", "invitation link of a member"):
        assert words in ada.get("/my/team").text
    wanted = {"id": "gamma", "name": "Gamma", "note": "Gamma group"}
    assert "Register a team" not in ada.get("/my/team").text
    assert ada.post("/my/team/register", wanted, page="/my/team").status_code == 403
    with small_site.database.write() as session:
        switch_self_registration(session, True, actor="test")
    assert "Register a team" in ada.get("/my/team").text
    taken = ada.post("/my/team/register", {**wanted, "id": "alpha"}, page="/my/team")
    assert taken.status_code == 409
    for words in ("There is a team with the id", 'value="alpha"', "Gamma group</textarea>"):
        assert words in taken.text, "what was typed stays in the form"
    assert ada.post("/my/team/register", wanted, page="/my/team").status_code == 303
    for page in ("/my/team", "/my", "/my/notices", "/submit"):
        assert "An organizer has not approved the team yet" in ada.get(page).text
    asked = ada.get("/my/team").text
    assert "add or confirm one" not in asked, "it would be refused"
    assert "one can be added once an organizer has approved the team" in asked
    assert "/my/notices/add" not in ada.get("/my/notices").text
    assert 'id="upload"' not in ada.get("/submit").text
    typed = {"phase": "dev", "method": "Planner"}
    refused = ada.browser.post("/submit", typed, page="/my", files={"file": ("a.json", b"a")})
    assert refused.status_code == 403
    small_site.post("/organizer/teams/gamma/approve", "organizer")
    assert ada.browser.submit("a").status_code == 303
    assert "/my/notices/add" in ada.get("/my/notices").text


def test_a_person_reads_that_their_registration_was_refused_and_may_register_anew(
    site: "Api", person: Open
) -> None:
    ada = person(site)
    ada.sign_in()
    with site.database.write() as session:
        switch_self_registration(session, True, actor="test")
    wanted = {"id": "gamma", "name": "Gamma", "note": "Gamma group"}
    ada.post("/my/team/register", wanted, page="/my/team")
    why = {"reason": "a second account"}
    assert site.post("/organizer/teams/gamma/refuse", "organizer", json=why).status_code == 200
    assert ada.get("/my").headers["location"].startswith("/sign-in")
    ada.sign_in()
    page = ada.get("/my/team").text
    assert "An organizer refused the registration of Gamma on " in page
    assert "a second account" not in page, "the reason is for organizers alone"
    assert ada.post("/my/team/register", wanted, page="/my/team").status_code == 303
    assert "refused" not in ada.get("/my/team").text


def test_a_token_of_a_team_does_nothing_in_the_name_of_a_person(
    small_site: "Api", browse: Browse
) -> None:
    browser = browse(small_site, who="alpha")
    for path in ("/my/team/act-for", "/my/team/register", "/join/x"):
        assert browser.post(path, {}, page="/my/team").status_code == 403


def test_two_who_open_one_link_at_once_do_not_both_join(
    database: "Database", make_api: Callable[..., "Api"], database_url: str
) -> None:
    site = make_api(database_url)
    with database.write() as session:
        link, _ = invite(session, site.team_ids["alpha"], "x", actor="test")
        people = [
            welcome_person(session, Identity("https://issuer.example", f"s{n}")).id
            for n in range(6)
        ]

    def join(person_id: str) -> None:
        with database.write() as session:
            accept_invitation(session, link, person_id, actor="test")

    with ThreadPoolExecutor(6) as pool:
        results = [pool.submit(join, person_id) for person_id in people]
    failed = [result.exception() for result in results]
    assert [type(error) for error in failed if error is not None] == [NotFound] * 5
    with database.read() as session:
        joined = [is_member(session, site.team_ids["alpha"], one) for one in people]
    assert sum(joined) == 1


def test_a_session_of_a_person_ends_with_its_time(small_site: "Api", person: Open) -> None:
    ada = person(small_site)
    ada.sign_in()
    with small_site.database.write() as session:
        past = datetime.now(UTC) - timedelta(seconds=1)
        session.execute(update(BrowserSession).values(expires_at=past))
    assert ada.get("/my/team").headers["location"].startswith("/sign-in")
