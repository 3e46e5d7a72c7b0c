"""Organizers' roles: every route is asked with every role, the actions one by one from a table."""

import html
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.server.test_organizer_team_pages import settings
from typer.testing import CliRunner

from exceptiondrive_records.accounts.people import Identity, set_organizer, welcome_person
from exceptiondrive_records.accounts.roles import OrganizerRole
from exceptiondrive_records.accounts.sessions import (
    find_session,
    open_person_session,
    require_unrevoked,
)
from exceptiondrive_records.accounts.tokens import SCOPES_OF_ROLE, Scope, issue_token
from exceptiondrive_records.db.errors import NotAllowed
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.teams.teams import switch_self_registration
from exceptiondrive_schemas.api.form_fields import values_of
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_server.operations.cli import app
from exceptiondrive_server.phases.organizer_pages import SETTINGS
from exceptiondrive_server.routes import ROUTES
from exceptiondrive_server.web.forms import text_of
from exceptiondrive_server.web.organizer_rights import HELPER_ACTIONS

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

OWNER, HELPER, READER = OrganizerRole.OWNER, OrganizerRole.HELPER, OrganizerRole.READ_ONLY
ROLES: dict[str, tuple[OrganizerRole, tuple[str, ...]]] = {
    "owner": (OWNER, ()),
    "helper": (HELPER, ()),
    "reader": (READER, ()),
    "owner of dev": (OWNER, ("dev",)),
    "reader of dev": (READER, ("dev",)),
    "owner of other": (OWNER, ("other",)),
}
ALL, WRITERS = set(ROLES), {"owner"}
OF_DEV = {"owner", "owner of dev"}
SEEN_OF_DEV = ALL - {"owner of other"}
WHOLE_SITE = {"owner", "helper", "reader"}
ACTIONS = [
    # method, path, who may
    ("GET", "/organizer/teams", WHOLE_SITE),
    ("GET", "/organizer/audit", WHOLE_SITE),
    ("GET", "/organizer/people", WHOLE_SITE),
    ("GET", "/organizer/phases/dev/board", SEEN_OF_DEV),
    ("GET", "/organizer/phases/dev/similar", SEEN_OF_DEV),
    ("GET", "/organizer/phases/dev/export", SEEN_OF_DEV),
    ("GET", "/organizer/submissions/archive", WHOLE_SITE),
    ("GET", "/organizer/submissions/archive?phase=dev", SEEN_OF_DEV),
    ("POST", "/organizer/protocols/check", WHOLE_SITE),
    ("POST", "/organizer/teams/alpha/approve", {"owner", "helper"}),
    ("POST", "/organizer/teams/alpha/refuse", {"owner", "helper"}),
    ("POST", "/organizer/submissions/{submission}/retry", {"owner", "helper", "owner of dev"}),
    ("POST", "/organizer/submissions/{submission}/note", {"owner", "helper", "owner of dev"}),
    ("POST", "/organizer/submissions/{submission}/verify", {"owner", "helper", "owner of dev"}),
    ("POST", "/organizer/submissions/{submission}/restore", OF_DEV),
    ("GET", "/organizer/submissions/{submission}", SEEN_OF_DEV),
    ("POST", "/organizer/teams", WRITERS),
    ("POST", "/organizer/teams/alpha/tokens", WRITERS),
    ("POST", "/organizer/teams/alpha/invitations", WRITERS),
    ("POST", "/organizer/tokens/x/revoke", WRITERS),
    ("POST", "/organizer/people/x/organizer", WRITERS),
    ("POST", "/organizer/people/x/forget", WRITERS),
    ("PATCH", "/organizer/site", WRITERS),
    ("POST", "/organizer/phases", WRITERS),
    ("POST", "/organizer/protocols", WRITERS),
    ("POST", "/organizer/rescoring", WRITERS),
    ("PATCH", "/organizer/phases/dev", OF_DEV),
    ("POST", "/organizer/phases/dev/freeze", OF_DEV),
    ("POST", "/organizer/phases/dev/reveal", OF_DEV),
    ("POST", "/organizer/phases/dev/feature", WRITERS),
    ("POST", "/organizer/phases/dev/delete", OF_DEV),
    ("POST", "/organizer/phases/dev/news", OF_DEV),
    ("GET", "/organizer/phases/dev/reported", SEEN_OF_DEV),
    ("POST", "/organizer/phases/dev/reported", OF_DEV),
    ("POST", "/organizer/phases/dev/reported/x/withdraw", OF_DEV),
    ("GET", "/organizer/news", WHOLE_SITE),
    ("GET", "/organizer/news?phase=dev", SEEN_OF_DEV),
    ("POST", "/organizer/news/x/withdraw", WRITERS),
    ("POST", "/organizer/news/{news}/withdraw", OF_DEV),
    ("GET", "/organizer/questions", WHOLE_SITE),
    ("GET", "/organizer/questions?phase=dev", SEEN_OF_DEV),
    ("POST", "/organizer/questions/x/answer", WRITERS),
    ("POST", "/organizer/questions/{question}/answer", OF_DEV),
    ("POST", "/organizer/disqualifications/{of_an_entry}/reinstate", OF_DEV),
    ("POST", "/organizer/disqualifications/{of_a_team}/reinstate", WRITERS),
    ("POST", "/organizer/messages", WRITERS),
    ("PATCH", "/organizer/teams/alpha", WRITERS),
    ("POST", "/organizer/teams/alpha/merge", WRITERS),
    ("POST", "/organizer/teams/alpha/forget", WRITERS),
    ("PATCH", "/organizer/teams/alpha/allowances/dev", OF_DEV),
    ("POST", "/organizer/submissions/{submission}/disqualify", OF_DEV),
    ("GET", "/submissions/{submission}", WHOLE_SITE),
    ("POST", "/submissions/{submission}/withdraw", WRITERS),
]


@pytest.fixture
def site(api: "Api") -> "Api":
    """A site with two phases, a submission in one, and a token for every role."""
    api.phase("other")
    with api.database.write() as session:
        for name, (role, phases) in ROLES.items():
            scopes = SCOPES_OF_ROLE[role]
            text, _ = issue_token(session, None, name, scopes, phases=phases, actor="test")
            api.tokens[name] = text
    return api


@pytest.mark.parametrize(
    ("method", "path", "may"), ACTIONS, ids=[f"{m} {p}" for m, p, _ in ACTIONS]
)
def test_each_action_is_for_the_roles_of_the_table(
    site: "Api", method: str, path: str, may: set[str]
) -> None:
    submission = site.submit("a").json()["id"]
    asked = path.replace("{submission}", submission).format(**made_for(site, path, submission))
    status = {who: site.request(method, asked, who).status_code for who in ROLES}
    refused = {403, 404} if not path.startswith("/organizer") else {403}
    assert {who for who in ROLES if status[who] not in refused} == may, status


def made_for(site: "Api", path: str, submission: str) -> dict[str, object]:
    """What a path names beside a phase, a team or a submission, made in the phase dev."""
    why: dict[str, object] = {"reason": "A test."}
    sent: dict[str, tuple[str, str, dict[str, object]]] = {
        "news": ("/organizer/phases/dev/news", "owner", {"title": "A", "text": "B"}),
        "question": ("/phases/dev/questions", "alpha", {"text": "May maps be used?"}),
        "of_an_entry": (f"/organizer/submissions/{submission}/disqualify", "owner", why),
        "of_a_team": ("/organizer/teams/alpha/disqualify", "owner", {**why, "phase": "dev"}),
    }
    return {
        name: site.post(to, who, json=body).json()["id"]
        for name, (to, who, body) in sent.items()
        if f"{{{name}}}" in path
    }


def organizer_routes() -> list[tuple[str, str]]:
    """Method and path of every route of the organizers, of the API and of the pages."""
    found = []
    for included in ROUTES.routes:
        for route in included.effective_route_contexts():  # type: ignore[attr-defined]
            if "/organize" in route.path:
                found += [(method, route.path) for method in route.methods]
    return found


def filled(path: str) -> str:
    names = {"phase_id": "dev", "team_id": "alpha"}
    parts = path.split("/")
    return "/".join(
        names.get(part[1:-1].partition(":")[0], "x") if part.startswith("{") else part
        for part in parts
    )


def test_no_route_of_the_organizers_lacks_the_guard(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    """Routes that come later are an owner's unless they read, or stand among the helpers' actions."""
    routes = organizer_routes()
    assert {path for _, path in routes if path.startswith("/organize/")}
    assert {path for _, path in routes} >= {f"/api/v1/organizer{path}" for path in HELPER_ACTIONS}
    browsers = {who: browse(site) for who in ("alpha", "reader", "helper", "owner of other")}
    for who, browser in browsers.items():
        assert browser.sign_in(who).status_code == 303
    for method, path in routes:
        is_read = method in ("GET", "HEAD") or path.endswith("/protocols/check")
        for who, browser in browsers.items():
            headers = {"Origin": browser.origin}
            if path.startswith("/api/"):
                headers = site.headers(who)
            status = browser.client.request(method, filled(path), headers=headers).status_code
            is_free = {
                "alpha": False,
                "reader": is_read,
                "helper": is_read or path.endswith(tuple(HELPER_ACTIONS)),
                "owner of other": False,
            }[who]
            if (who, path) == ("owner of other", "/organize"):
                assert status == 303  # to the phase
            elif not is_free:
                assert status == 403, (who, method, path)
            elif path.startswith("/api/"):
                assert status != 403, (who, method, path)


def test_a_helper_has_the_same_actions_on_pages(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    submission = site.submit("a").json()["id"]
    browser = browse(site, who="helper")
    form = browser.form(f"/organize/submissions/{submission}/note")
    status = {
        action: browser.send(f"/organize/{action}", form).status_code
        for action in (
            f"submissions/{submission}/retry",
            "teams/alpha/approve",
            "teams/alpha/tokens",
        )
    }
    assert [code == 403 for code in status.values()] == [False, False, True], status


def test_a_role_for_one_phase_is_led_to_it_and_sees_no_other(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    browser = browse(site)
    browser.sign_in("owner of dev")
    led = browser.get("/organize")
    assert (led.status_code, led.headers["location"]) == (303, "/organize/phases/dev")
    page = browser.get("/organize/phases/dev")
    assert page.status_code == 200
    assert 'href="/organize/phases/dev"' in page.text
    assert "/organize/audit" not in page.text
    assert browser.get("/organize/phases/other").status_code == 403
    hidden = {"visibility": "hidden"}
    assert site.request("PATCH", "/organizer/phases/other", "owner", json=hidden).status_code == 200
    assert site.get("/phases/other", "owner of dev").status_code == 404
    assert site.get("/phases/other", "reader").status_code == 200


def offered(page: str) -> list[str]:
    """Where the buttons and links of the body of a page lead, and where its forms do."""
    return re.findall(r'<a class="btn[^"]*" href="([^"]+)"', page)


@pytest.mark.parametrize("who", list(ROLES))
def test_a_page_of_a_phase_offers_what_the_role_may_do(
    site: "Api", browse: Callable[..., "TeamBrowser"], who: str
) -> None:
    site.submit("a")
    browser = browse(site, who=who)
    page = browser.get(
        "/organize/phases/other" if who == "owner of other" else "/organize/phases/dev"
    )
    links = offered(page.text)
    is_owner = who.startswith("owner")
    assert ("Save the changes" in page.text) is is_owner
    assert any(link.endswith("/news") for link in links) is is_owner
    assert any(link.endswith("/freeze") for link in links) is is_owner
    for site_wide in ("/verifications/new", "/rescoring/new", "/feature", "/new?like"):
        assert any(site_wide in link for link in links) is (who == "owner"), site_wide
    for link in links:
        assert browser.get(html.unescape(link)).status_code != 403, link


def test_a_role_for_one_phase_lists_its_submissions_and_names_no_other_phase_or_team(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    own = site.submit("a").json()["id"]
    other = site.submit("b", "beta", phase="other").json()["id"]
    browser = browse(site)
    browser.sign_in("owner of dev")
    page = browser.get("/organize/submissions?phase=dev")
    assert page.status_code == 200
    assert own in page.text
    for foreign in (other, "beta", "Beta", 'value="other"', "/organize/teams"):
        assert foreign not in page.text
    for query in ("", "?phase=other", "?phase=dev&phase=other", "?phase="):
        refused = browser.get(f"/organize/submissions{query}")
        assert refused.status_code == 403
        assert "Your role is confined to dev; this is for organizers of" in refused.text


@pytest.mark.parametrize("who", ["owner of dev", "reader of dev"])
def test_a_role_for_one_phase_asks_for_the_submissions_of_that_phase_with_its_token(
    site: "Api", who: str
) -> None:
    own = site.submit("a").json()["id"]
    other = site.submit("b", "beta", phase="other").json()["id"]
    listed = site.get("/submissions?phase=dev", who)
    assert [one["id"] for one in listed.json()["submissions"]] == [own]
    paths = [f"/organizer/submissions/{other}", f"/organizer/submissions/{'0' * len(other)}"]
    theirs, none = (site.get(path, who) for path in paths)
    assert theirs.status_code == none.status_code == 403
    assert theirs.json()["detail"] == none.json()["detail"], "whether there is one is not told"
    for query in ("", "?phase=other", "?phase="):
        refused = site.get(f"/submissions{query}", who)
        assert refused.status_code == 403
        assert "Your role is for dev alone" in refused.json()["detail"]


@pytest.mark.parametrize("who", ["owner of dev", "reader of dev", "helper"])
def test_links_of_a_page_lead_to_no_refusal(
    site: "Api", browse: Callable[..., "TeamBrowser"], who: str
) -> None:
    submission = site.submit("a").json()["id"]
    browser = browse(site, who=who)
    for page in ("/organize/phases/dev", f"/organize/submissions/{submission}"):
        text = browser.get(page).text
        links = set(re.findall(r'href="(/organize[^"#]*)', text))
        assert links
        refused = {link for link in links if browser.get(html.unescape(link)).status_code == 403}
        assert refused == set(), page


@pytest.mark.parametrize("who", [who for who in ROLES if who != "owner of other"])
def test_no_page_offers_what_the_role_may_not_do(
    site: "Api", browse: Callable[..., "TeamBrowser"], who: str
) -> None:
    """All pages are walked; where a link leads to an action, the action may be done."""
    fill_with_actions(site)
    browser = browse(site, who=who)
    todo, seen = ["/organize"], set[str]()
    while todo:
        path = todo.pop()
        seen.add(path)
        page = browser.get(path)
        assert page.status_code != 403, path
        if "text/html" in page.headers.get("content-type", ""):
            if path != "/organize/site":  # a section of the navigation, to be read by every role
                assert "This would be refused now.</b> This needs" not in page.text, path
            links = re.findall(r'href="(/organize[^"#]*)', page.text)
            todo += {html.unescape(link) for link in links} - seen - set(todo)
        elif "location" in page.headers:
            todo.append(page.headers["location"])
    actions = {re.sub(r"/[0-9a-z]{16}/", "/ID/", path).partition("?")[0] for path in seen}
    assert ("/organize/submissions/ID/note" in actions) is not who.startswith("reader")
    assert ("/organize/submissions/ID/disqualify" in actions) is who.startswith("owner")
    assert ("/organize/teams/alpha/allowances/dev" in actions) is who.startswith("owner")
    assert ("/organize/teams/waiting/approve" in actions) is (who in {"owner", "helper"})
    assert ("/organize/rescoring/ID/start" in actions) is who.startswith("owner")
    for action in ("teams/alpha/merge", "messages", "rescoring/new"):
        assert (f"/organize/{action}" in actions) is (who == "owner"), action
    for action in ("phases/dev/reported/new", "phases/dev/news", "phases/dev/freeze"):
        assert (f"/organize/{action}" in actions) is who.startswith("owner"), action


def fill_with_actions(site: "Api") -> None:
    """Bring about what organizers act on: a submission, a registration, a question, news."""
    site.submit("a")
    site.submit("b", "beta", phase="other")
    with site.database.write() as session:
        switch_self_registration(session, True, actor="test")
    wanted = {"id": "waiting", "name": "Waiting", "note": "We drive."}
    asked = site.post("/phases/dev/questions", "alpha", json={"text": "May maps be used?"})
    news = {"title": "A", "text": "Mine."}
    told = site.post("/organizer/phases/dev/news", "owner", json=news)
    made = site.client.post("/api/v1/registrations", json=wanted)
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    form = {"Content-Type": "application/toml"}
    added = site.post("/organizer/protocols", "owner", content=toml, headers=form)
    run = {"phase": "dev", "protocol": "1.1", "reason": "A test."}
    drafted = site.post("/organizer/rescoring", "owner", json=run)
    assert {one.status_code for one in (asked, told, made, added, drafted)} <= {200, 201}


def test_a_form_says_before_it_is_filled_in_that_the_role_may_not_send_it(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    browser = browse(site, who="reader")
    words = "This needs an organizer with the role owner; yours is read-only."
    for path in (
        "/organize/teams",
        "/organize/teams/alpha",
        "/organize/teams/alpha/merge",
        "/organize/messages",
        "/organize/phases/dev",
        "/organize/phases/dev/news",
        "/organize/protocols/new",
        "/organize/site",
    ):
        page = browser.get(path).text
        main = page[page.index("<main") : page.index("</main>")]
        assert words in main, path
        assert not re.search(r'<button class="btn (pri|grave)"', main), path


@pytest.mark.parametrize("link", ["/my", "/organize"])
def test_the_head_of_a_page_leads_a_role_for_one_phase_to_that_phase(
    site: "Api", browse: Callable[..., "TeamBrowser"], link: str
) -> None:
    browser = browse(site)
    browser.sign_in("reader of dev")
    assert f'href="{link}"' in browser.get("/organize/phases/dev").text
    led = browser.get(link)
    assert (led.status_code, led.headers["location"]) == (303, "/organize/phases/dev")


def test_a_role_for_one_phase_publishes_its_news_by_page(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    assert site.submit("a").status_code == 202
    browser = browse(site)
    browser.sign_in("owner of dev")
    page = "/organize/phases/dev/news"
    assert "the teams that submitted to it are told" in browser.get(page).text
    sent = browser.post(page, {"title": "A", "text": "Mine."}, page=page)
    assert sent.headers["location"] == "/organize/phases/dev?done=news_published"
    assert (
        "The news is published, and the teams are told."
        in browser.get(sent.headers["location"]).text
    )
    inboxes = [site.get("/notifications", who).json() for who in ("alpha", "beta")]
    assert [any(one["title"].endswith(": A") for one in box) for box in inboxes] == [True, False]
    assert browser.get("/organize/phases/other/news").status_code == 403


def test_a_role_for_one_phase_answers_what_is_asked_about_it(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    """The team that asked is told, also where it submitted nothing yet; those of other phases are not."""
    asked = {
        phase: site.post(f"/phases/{phase}/questions", "alpha", json={"text": f"{phase}?"}).json()
        for phase in ("dev", "other")
    }
    browser = browse(site)
    browser.sign_in("owner of dev")
    assert "News and questions (1 waiting)" in " ".join(
        browser.get("/organize/phases/dev").text.split()
    )
    led = browser.get("/my/questions/dev")  # where the page of the phase leads who would ask
    assert (led.status_code, led.headers["location"]) == (303, "/organize/news?phase=dev")
    listed = browser.get("/organize/news?phase=dev").text
    assert (asked["dev"]["id"] in listed, asked["other"]["id"] in listed) == (True, False)
    assert browser.get("/organize/news").status_code == 403
    assert browser.get(f"/organize/news/questions/{asked['other']['id']}").status_code == 403
    page = f"/organize/news/questions/{asked['dev']['id']}"
    sent = browser.post(page, {"text": "Offline ones.", "to_all": "yes"}, page=page)
    assert sent.headers["location"] == "/organize/news?phase=dev&done=question_answered"
    assert "The question is answered." in browser.get(sent.headers["location"]).text
    inboxes = [site.get("/notifications", who).json() for who in ("alpha", "beta")]
    told = [[one for one in box if "Offline ones." in str(one)] for box in inboxes]
    assert [len(each) for each in told] == [1, 0]
    (news,) = site.get("/phases/dev/news").json()
    assert "Offline ones." in news["text"]


def test_a_role_for_one_phase_takes_back_what_it_disqualified(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    submission = site.submit("a").json()["id"]
    browser = browse(site)
    browser.sign_in("owner of dev")
    page = f"/organize/submissions/{submission}"
    why = {"reason": "Of another team."}
    assert browser.post(f"{page}/disqualify", why, page=f"{page}/disqualify").status_code == 303
    (back,) = [link for link in offered(browser.get(page).text) if link.endswith("/reinstate")]
    sent = browser.post(back, {"reason": "It is its own."}, page=back)
    assert sent.headers["location"] == f"{page}?done=reinstated"
    assert any(link.endswith("/disqualify") for link in offered(browser.get(page).text))


def test_a_role_for_one_phase_gives_an_allowance_and_is_led_to_its_phase(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    submission = site.submit("a").json()["id"]
    browser = browse(site)
    browser.sign_in("owner of dev")
    links = offered(browser.get(f"/organize/submissions/{submission}").text)
    (page,) = [link for link in links if link.endswith("/allowances/dev")]
    sent = browser.post(page, {"quota_per_day": "7", "reason": "They were ill."}, page=page)
    assert sent.headers["location"] == "/organize/phases/dev?done=allowance_set"
    assert "The allowance is set" in browser.get(sent.headers["location"]).text


def test_a_role_for_one_phase_moves_no_other_and_writes_to_no_team_of_another(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    first = {"position": 1}
    for who, status in (("owner of dev", 403), ("owner", 200)):
        assert site.request("PATCH", "/organizer/phases/dev", who, json=first).status_code == status
    browser = browse(site)
    browser.sign_in("owner of dev")
    page = "/organize/phases/dev"
    assert browser.get(f"{page}/feature").status_code == 403
    feature = {**browser.form(page), "reason": "Mine first."}
    assert browser.send(f"{page}/feature", feature).status_code == 403
    moved = {**browser.form(page), **_shown_in_form(browser, page), "position": "7"}
    told = browser.send(page, moved)
    assert (told.status_code, "organizers of the whole site" in told.text) == (403, True)
    assert site.submit("a").status_code == 202
    news = {"title": "A", "text": "Mine."}
    assert site.post("/organizer/phases/dev/news", "owner of dev", json=news).status_code == 201
    inboxes = [site.get("/notifications", who).json() for who in ("alpha", "beta")]
    assert [any(one["title"].endswith(": A") for one in box) for box in inboxes] == [True, False]
    news = {"title": "B", "text": "Of all."}
    assert site.post("/organizer/phases/dev/news", "owner", json=news).status_code == 201
    assert site.get("/notifications", "beta").json()[0]["title"].endswith(": B")


def _shown_in_form(browser: "TeamBrowser", page: str) -> dict[str, str]:
    with browser.api.database.read() as session:
        now = values_of(SETTINGS, find_phase(session, page.rpartition("/")[2]))
    return {name: text_of(value) for name, value in now.items()}


def test_a_person_has_the_role_that_was_given_from_the_next_request_on(site: "Api") -> None:
    with site.database.write() as session:
        ada = welcome_person(session, Identity("https://issuer.example", "s", "Ada"))
        secret, person_id = open_person_session(session, ada), ada.id

    def now() -> Any:
        with site.database.read() as session:
            return find_session(session, secret)

    def is_refused(began_as: Any) -> bool:
        """Whether what it began, such as a stream of events, ends."""
        with site.database.read() as session:
            try:
                require_unrevoked(session, began_as)
            except NotAllowed:
                return True
        return False

    began_as = [now()]
    assert now().role is None
    path = f"/organizer/people/{person_id}/organizer"
    wanted = {"is_organizer": True, "role": "helper", "phases": ["dev"]}
    told = site.post(path, "owner", json=wanted).json()
    assert (told["role"], told["phases"], told["is_organizer"]) == ("helper", ["dev"], True)
    assert (now().role, now().phases, now().is_organizer) == (HELPER, {"dev"}, False)
    began_as.append(now())
    site.post(path, "owner", json={**wanted, "phases": []})
    began_as.append(now())
    assert [is_refused(each) for each in began_as] == [True, True, False]
    missing = {**wanted, "phases": ["no-such"]}
    assert site.post(path, "owner", json=missing).status_code == 404
    site.post(path, "owner", json={"is_organizer": False})
    assert (now().role, now().phases) == (None, frozenset())
    lines = site.get("/organizer/audit", "owner").json()
    granted = [line["detail"] for line in lines if line["action"] == "organizer granted"]
    assert granted[-1] == {"role": "helper", "phases": ["dev"]}
    assert is_refused(began_as[-1])


def test_organizers_give_and_take_roles_by_page(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    with site.database.write() as session:
        issuer = "https://issuer.example"
        ada = welcome_person(session, Identity(issuer, "s", "Ada <b>", "ada@example.org"))
        person_id = ada.id
        welcome_person(session, Identity(issuer, "t", "Ada <b>", "other@example.org"))
    reader, owner = browse(site), browse(site)
    reader.sign_in("reader")
    owner.sign_in("owner")
    page = f"/organize/people/{person_id}"
    people = owner.get("/organize/people").text
    assert page in people
    assert 'data-k="phases"' not in people, "a label of nothing"
    assert "ada@example.org" in people, "names alone do not tell two apart"
    assert "ada@example.org" in owner.get(page).text
    sent = {**reader.form(page), "role": "owner"}
    assert reader.send(page, sent).status_code == 403
    wrong = owner.post(page, {"role": "helper", "phases": "no-such"}, page=page)
    assert wrong.status_code == 404
    assert "There is no phase &#39;no-such&#39;." in wrong.text
    assert 'value="no-such"' in wrong.text, "what was typed stays"
    done = owner.post(page, {"role": "helper", "phases": "dev other"}, page=page)
    assert done.headers["location"] == "/organize/people?done=role_set"
    told = owner.get("/organize/people").text
    assert ("dev, other" in told, "<b>" in told) == (True, False)
    assert 'value="dev other"' in owner.get(page).text
    owner.post(page, {"role": "", "phases": ""}, page=page)
    person = next(
        one for one in site.get("/organizer/people", "owner").json() if one["id"] == person_id
    )
    assert (person["role"], person["phases"]) == (None, [])
    actions = [line["action"] for line in site.get("/organizer/audit", "owner").json()]
    assert actions.index("organizer ended") < actions.index("organizer granted")


def test_a_role_that_another_ended_is_not_given_back_by_a_page_that_shows_it_still(
    site: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    with site.database.write() as session:
        person = welcome_person(session, Identity("https://issuer.example", "s", "Ada")).id
        set_organizer(session, person, OrganizerRole.HELPER, ["dev"], actor="test")
    first, second = browse(site), browse(site)
    first.sign_in("owner")
    second.sign_in("owner")
    page = f"/organize/people/{person}"
    shown = settings(second, page)
    assert (shown["role"], shown["phases"]) == ("helper", "dev")
    done = first.post(page, {"role": "", "phases": ""}, page=page)
    assert done.headers["location"] == "/organize/people?done=role_set"
    left_alone = second.send(page, shown)
    assert left_alone.headers["location"] == "/organize/people?done=nothing_changed"
    changed = second.send(page, {**shown, "phases": "dev other"})
    assert changed.status_code == 409
    assert "Changed since this page was shown: Phases, which is empty now." in changed.text
    (now,) = site.get("/organizer/people", "owner").json()
    assert (now["role"], now["phases"]) == (None, [])


def test_operators_give_roles_by_command(
    site: "Api", sqlite_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABASE_URL", sqlite_url)
    run = CliRunner()
    of_dev = ["--role", "helper", "--phase", "dev"]
    made = run.invoke(app, ["create-organizer", "Ben", *of_dev])
    site.tokens["ben"] = made.stdout.splitlines()[-1]
    assert site.get("/organizer/phases/dev/board", "ben").status_code != 403
    assert site.get("/organizer/teams", "ben").status_code == 403
    assert run.invoke(app, ["create-organizer", "Cy", "--phase", "no-such"]).exit_code != 0


def test_a_team_never_gets_an_organizers_scope(site: "Api") -> None:
    with site.database.write() as session:
        person = welcome_person(session, Identity("https://issuer.example", "m", "Member"))
        set_organizer(session, person.id, READER, actor="test")
    for scope in (Scope.ORGANIZE, Scope.ORGANIZE_HELP, Scope.ORGANIZE_READ):
        body = {"name": "more", "scopes": [scope.value]}
        assert site.post("/tokens", "alpha", json=body).status_code in (403, 422)
