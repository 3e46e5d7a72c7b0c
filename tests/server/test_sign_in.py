"""GET and POST /sign-in, POST /sign-out: cookies, forged forms, throttling."""

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from html import unescape
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import delete, select, update
from starlette.testclient import TestClient
from tests.support.records import count_audit_lines

from exceptiondrive_records.accounts import sessions
from exceptiondrive_records.accounts.attempts import PER_TOKEN_ID
from exceptiondrive_records.accounts.tables import BrowserSession

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Problem = Callable[[Any, int, str], dict[str, Any]]
Open = Callable[..., "TeamBrowser"]


def test_a_team_signs_in_and_stays_so_until_it_signs_out(api_on_both: "Api", browse: Open) -> None:
    browser = browse(api_on_both)
    answer = browser.sign_in("alpha")
    assert (answer.status_code, answer.headers["location"]) == (303, "/my")
    assert "Alpha" in browser.get("/my").text
    answer = browser.post("/sign-out", {}, page="/my")
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    assert browser.get("/my").headers["location"] == "/sign-in?back=%2Fmy"
    with api_on_both.database.read() as session:
        assert session.scalars(select(BrowserSession)).all() == []


@pytest.mark.parametrize("query", ["?phase=dev&split_revision=a%2Fb", "?phase=" + "x" * 2000])
def test_who_signs_in_first_comes_to_the_address_that_was_asked_for(
    api: "Api", browse: Open, query: str
) -> None:
    page, browser = "/organize/rescoring/new", browse(api)
    shown = browser.get(browser.get(page + query).headers["location"]).text
    back = re.findall(r'name="back" value="([^"]*)"', shown)[-1]
    led = browser.sign_in("organizer", back=unescape(back))
    assert led.headers["location"] == page + (query if len(query) < 100 else "")


@pytest.mark.parametrize(
    ("who", "sent_to", "back"),
    [
        ("alpha", "/submit", "/submit"),
        ("alpha", "/submit?phase=dev", "/submit?phase=dev"),
        ("alpha", "/submissions/x/withdraw", "/submissions/x"),
        ("alpha", "/my/team/members/x/remove", "/my/team"),
        ("organizer", "/organize/phases/dev", "/organize/phases/dev"),
        ("organizer", "/organize/submissions/x/note", "/organize/submissions/x/note"),
    ],
)
def test_a_form_sent_after_the_session_ended_leads_back_to_its_page_and_is_told_as_unsaved(
    api: "Api", browse: Open, who: str, sent_to: str, back: str
) -> None:
    browser = browse(api, who=who)
    form = browser.form("/my/tokens" if who == "alpha" else "/organize/phases/dev")
    with api.database.write() as session:
        session.execute(delete(BrowserSession))
    led = browser.send(sent_to, form)
    assert led.status_code == 303
    page = browser.get(led.headers["location"])
    assert "what you sent was not saved" in page.text
    assert "your browser may still hold what you typed" in " ".join(page.text.split())
    assert f'name="back" value="{back}"' in page.text
    assert "was not saved" not in browser.get(browser.get("/my").headers["location"]).text


def test_who_signs_out_after_the_session_ended_is_told_of_nothing_unsaved(
    api: "Api", browse: Open
) -> None:
    browser = browse(api, who="alpha")
    form = browser.form("/my/tokens")
    for _ in range(2):  # two tabs
        answer = browser.send("/sign-out", form)
        assert (answer.status_code, answer.headers["location"]) == (303, "/")
        assert "Max-Age=0" in answer.headers["set-cookie"]


def test_no_other_site_takes_the_cookie_of_a_browser(api: "Api", browse: Open) -> None:
    """What it makes a browser send carries no cookie, and what is answered could still take one."""
    answer = browse(api).client.post("/sign-out", headers={"Origin": "https://evil.test"})
    assert answer.status_code == 403
    assert "set-cookie" not in answer.headers


def test_the_cookie_is_bound_to_this_host_and_hidden_from_scripts(api: "Api", browse: Open) -> None:
    cookie = browse(api).sign_in("alpha").headers.get_list("set-cookie")[0]
    assert cookie.startswith("__Host-session=")
    for flag in ("HttpOnly", "Secure", "SameSite=lax", "Path=/", "Max-Age=43200"):
        assert flag in cookie
    assert "Domain" not in cookie


def test_on_this_machine_alone_sign_in_works_without_https(api: "Api", browse: Open) -> None:
    near = browse(api, "http://127.0.0.1:8000")
    cookie = near.sign_in("alpha").headers.get_list("set-cookie")[0]
    assert cookie.startswith("session=")
    assert "Secure" not in cookie
    assert near.get("/my").status_code == 200
    assert browse(api, "http://server.test").get("/sign-in").status_code == 403


def test_behind_a_proxy_the_public_address_decides(
    make_api: Callable[..., "Api"], sqlite_url: str, browse: Open
) -> None:
    api = make_api(sqlite_url, public_url="https://board.example")
    browser = browse(api, "http://inside.test", origin="https://board.example")
    answer = browser.client.get("/sign-in", headers={"Accept": "text/html"})
    assert answer.headers.get_list("set-cookie")[0].startswith("__Host-session=v.")


def test_a_plain_cookie_counts_for_nothing_where_https_is_spoken(api: "Api", browse: Open) -> None:
    near = browse(api, "http://127.0.0.1:8000")
    near.sign_in("alpha")
    far = browse(api)
    far.client.cookies.set("session", near.client.cookies["session"])
    assert far.get("/my").status_code == 303


def test_the_token_stands_in_no_cookie_no_page_and_no_log(
    api: "Api", browse: Open, logs: list[Any]
) -> None:
    browser = browse(api)
    answer = browser.sign_in("alpha")
    token = api.tokens["alpha"]
    wrong = browser.fresh().sign_in_with(token[:-1] + ("a" if token[-1] != "a" else "b"))
    told = repr((answer.headers, browser.get("/my").text, wrong.text, wrong.headers, logs))
    assert token[15:40] not in told


def test_every_wrong_token_is_told_the_same_and_gets_no_session(api: "Api", browse: Open) -> None:
    told = set()
    for token in ("", "x", "edk_s_00000000_" + "A" * 32 + "_AAAAAA", api.tokens["alpha"][:-1]):
        browser = browse(api)
        answer = browser.sign_in_with(token)
        assert answer.status_code == 401
        assert "session" not in answer.headers.get("set-cookie", "")
        assert browser.client.cookies["__Host-session"].startswith("v.")
        told.add(re.search(r'role="alert"[^>]*>([^<]*)<', answer.text).group(1))  # type: ignore[union-attr]
    assert told == {"The token is not valid: unknown, expired or revoked."}


def test_a_form_from_elsewhere_is_refused(api: "Api", browse: Open) -> None:
    browser = browse(api)
    for origin in ("https://evil.test", "null", None, "http://server.test"):
        form = {**browser.form("/sign-in"), "token": api.tokens["alpha"]}
        headers = {"Origin": origin} if origin else {}
        answer = browser.client.post("/sign-in", data=form, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (403, "not_allowed")
    for stolen in ({}, {"form_token": "x"}, {"form_token": browse(api).form_token("/sign-in")}):
        answer = browser.send("/sign-in", {"token": api.tokens["alpha"], **stolen})
        assert answer.status_code == 403


@pytest.mark.row("I25")
@pytest.mark.parametrize(
    "path", ["/sign-out", "/my/tokens", "/my/tokens/x/revoke", "/my/tokens/x/rotate",
             "/submissions/x/withdraw"]
)  # fmt: skip
def test_no_form_of_a_session_is_taken_from_elsewhere(api: "Api", browse: Open, path: str) -> None:
    browser = browse(api, who="alpha")
    good = browser.form_token("/my")
    assert browser.send(path, {"form_token": "wrong"}).status_code == 403
    assert browser.send(path, {}).status_code == 403
    headers = {"Origin": "https://evil.test"}
    answer = browser.client.post(path, data={"form_token": good}, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "not_allowed")
    assert browser.get("/my").status_code == 200
    led = browser.fresh().send(path, {"form_token": good}).headers["location"]
    assert led == "/" if path == "/sign-out" else led.startswith("/sign")


def test_guessing_is_slowed_down_with_a_time_to_wait(api: "Api", browse: Open) -> None:
    wrong = api.tokens["alpha"][:15] + "A" * 32 + "_AAAAAA"
    codes = [browse(api).sign_in_with(wrong).status_code for _ in range(PER_TOKEN_ID + 1)]
    assert codes == [401] * PER_TOKEN_ID + [429]
    answer = browse(api).sign_in("alpha")
    assert answer.status_code == 429, "the right token too: else a guess would tell"
    assert 0 < int(answer.headers["retry-after"]) <= 15 * 60
    page = browse(api).sign_in("alpha", accept="text/html")
    assert "try again in" in page.text
    assert int(page.headers["retry-after"]) > 0
    assert browse(api).sign_in("beta").status_code == 303
    assert api.get("/me", "alpha").status_code == 200, "the API knows no such limit"


def test_a_team_signs_in_only_so_often_a_day(
    api_on_both: "Api", browse: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each leaves an audit line for ever, whichever token of the team it is made with."""
    api = api_on_both
    monkeypatch.setattr(sessions, "MAX_SIGN_INS_A_DAY", 2)
    api.tokens["second"] = api.post("/tokens", "alpha", json={"name": "x"}).json()["token"]
    browser = browse(api)
    assert [browse(api).sign_in(who).status_code for who in ("alpha", "second")] == [303, 303]
    told = browser.sign_in("alpha", accept="text/html")
    assert told.status_code == 409
    assert "may sign in 2 times in 24 hours" in " ".join(told.text.split())
    with api.database.read() as session:
        assert count_audit_lines(session, "signed in") == 2
    assert browse(api).sign_in("beta").status_code == 303
    assert api.get("/me", "alpha").status_code == 200


def test_going_back_leads_nowhere_else(api: "Api", browse: Open) -> None:
    for back in ("https://evil.test/", "//evil.test", "/\\evil.test"):
        assert browse(api).sign_in("alpha", back=back).headers["location"] == "/"
    assert browse(api).sign_in("alpha", back="/submit").headers["location"] == "/submit"


def test_a_session_ends_with_its_time_and_with_its_token(api: "Api", browse: Open) -> None:
    browser = browse(api, who="alpha")
    with api.database.write() as session:
        past = datetime.now(UTC) - timedelta(seconds=1)
        session.execute(update(BrowserSession).values(expires_at=past))
    assert browser.get("/my").status_code == 303
    browser.sign_in("alpha")
    assert browser.get("/my").status_code == 200
    token_id = api.tokens["alpha"].split("_")[2]
    assert api.post(f"/organizer/tokens/{token_id}/revoke", "organizer").status_code == 200
    assert browser.get("/my").status_code == 303


def test_a_new_sign_in_is_a_new_session(api: "Api", browse: Open) -> None:
    browser = browse(api)
    browser.client.cookies.set("__Host-session", "planted-by-somebody")
    browser.sign_in("alpha")
    first = browser.client.cookies.get("__Host-session", domain="server.test")
    assert first not in (None, "planted-by-somebody")


def test_a_session_speaks_for_nobody_on_the_api(
    api: "Api", browse: Open, as_problem: Problem
) -> None:
    browser = browse(api, who="alpha")
    for method, path in (("GET", "/me"), ("GET", "/submissions"), ("POST", "/submissions"),
                         ("POST", "/tokens"), ("POST", "/submissions/x/withdraw")):  # fmt: skip
        answer = browser.client.request(method, "/api/v1" + path)
        as_problem(answer, 401, "not_signed_in")


def test_a_token_in_a_header_or_a_cookie_opens_no_page(api: "Api") -> None:
    token = api.tokens["alpha"]
    client = TestClient(api.app, base_url="https://server.test", follow_redirects=False)
    assert client.get("/my", headers={"Authorization": f"Bearer {token}"}).status_code == 303
    assert client.get("/my", headers={"Cookie": f"__Host-session={token}"}).status_code == 303


def test_signing_in_leaves_an_audit_line(api: "Api", browse: Open) -> None:
    browse(api).sign_in("alpha")
    line = api.last_line()
    assert (line.action, line.subject) == ("signed in", api.tokens["alpha"].split("_")[2])
