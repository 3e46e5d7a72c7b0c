"""Sign-in through a real OpenID provider: what is right gets in, everything else is refused."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from pydantic import ValidationError
from sqlalchemy import select
from tests.access.people import query_of, with_provider
from tests.support.processes import free_port

from exceptiondrive_records.accounts import attempts
from exceptiondrive_records.accounts.tables import BrowserSession, Person
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_server.web.settings import ServerSettings

if TYPE_CHECKING:
    from tests.access.people import PersonBrowser, RunningProvider
    from tests.support.application import Api, TeamBrowser

Open = Callable[["Api"], "PersonBrowser"]
Browse = Callable[..., "TeamBrowser"]


def people_of(site: "Api") -> list[Person]:
    with site.database.read() as session:
        return list(session.scalars(select(Person)))


def assert_refused(answer: Any, who: "PersonBrowser", status: int = 401) -> str:
    assert answer.status_code == status, answer.text
    assert 'role="alert"' in answer.text
    assert not who.has_session
    assert who.get("/my").headers["location"].startswith("/sign-in")
    return str(answer.text)


def test_a_person_signs_in_and_stays_so_until_they_sign_out(site: "Api", person: Open) -> None:
    ada = person(site)
    answer = ada.sign_in(back="/my/team")
    assert (answer.status_code, answer.headers["location"]) == (303, "/my/team")
    assert "Welcome, Ada Example." in ada.get("/my/team").text
    cookie = answer.headers.get_list("set-cookie")[0]
    for flag in ("__Host-session=", "HttpOnly", "Secure", "SameSite=lax", "Path=/"):
        assert flag in cookie
    ada.post("/sign-out", {}, page="/my/team")
    assert ada.get("/my/team").headers["location"].startswith("/sign-in")
    with site.database.read() as session:
        assert session.scalars(select(BrowserSession)).all() == []
        lines = session.scalars(select(AuditLine).where(AuditLine.action == "signed in")).all()
    assert [line.actor for line in lines] == [f"person:{people_of(site)[0].id}"]


def test_what_the_provider_is_asked(small_site: "Api", person: Open) -> None:
    asked = query_of(person(small_site).begin())
    assert asked["redirect_uri"] == "https://server.test/sign-in/callback"
    assert (asked["response_type"], asked["scope"]) == ("code", "openid profile email")
    assert asked["code_challenge_method"] == "S256"
    assert min(len(asked[name]) for name in ("state", "nonce", "code_challenge")) >= 43
    again = query_of(person(small_site).begin())
    for name in ("state", "nonce", "code_challenge"):
        assert asked[name] != again[name]


def test_the_same_person_is_known_again_and_a_new_name_is_taken(
    site: "Api", person: Open, provider: "RunningProvider"
) -> None:
    person(site).sign_in()
    provider.order(person={"sub": "sub-1", "name": "Ada Newname"})
    person(site).sign_in()
    (ada,) = people_of(site)
    assert (ada.name, ada.email) == ("Ada Newname", None)


def test_another_subject_with_the_same_email_is_somebody_else(
    small_site: "Api", person: Open, provider: "RunningProvider"
) -> None:
    person(small_site).sign_in()
    provider.order(person={"sub": "sub-2", "name": "Eve", "email": "ada@example.org"})
    person(small_site).sign_in()
    assert len(people_of(small_site)) == 2


@pytest.mark.parametrize("n_before_the_sign", [90, 300])
def test_an_email_address_is_kept_whole_or_not_at_all(
    small_site: "Api", person: Open, provider: "RunningProvider", n_before_the_sign: int
) -> None:
    email = "a" * n_before_the_sign + "@example.org"
    provider.order(person={"sub": "s", "name": "Ada", "email": email})
    person(small_site).sign_in()
    (ada,) = people_of(small_site)
    assert ada.email == (email if n_before_the_sign == 90 else None)


@pytest.mark.parametrize("name", ["", "   ", "a\u202eb", "x" * 5000, None, 7, ["x"]])
def test_a_bad_name_is_no_reason_to_refuse(
    small_site: "Api", person: Open, provider: "RunningProvider", name: Any
) -> None:
    provider.order(person={"sub": "s", "name": name})
    assert person(small_site).sign_in().status_code == 303
    (somebody,) = people_of(small_site)
    assert 0 < len(somebody.name) <= 80
    assert somebody.name.isprintable()


@pytest.mark.parametrize("names", [[], ["name"], ["email"]])
def test_a_profile_kept_apart_is_fetched(
    small_site: "Api", person: Open, provider: "RunningProvider", names: list[str]
) -> None:
    provider.order(id_token_names=names)
    assert person(small_site).sign_in().status_code == 303
    (ada,) = people_of(small_site)
    assert (ada.name, ada.email) == ("Ada Example", "ada@example.org")


@pytest.mark.parametrize(
    "order",
    [
        {"userinfo_answers": ["", 403]},
        {"userinfo_answers": ["a.signed.document", 200]},
        {"userinfo_at": "http://127.0.0.1:9/userinfo"},
    ],
)
def test_without_the_profile_kept_apart_the_id_token_is_as_good(
    small_site: "Api", person: Open, provider: "RunningProvider", order: dict[str, Any]
) -> None:
    provider.order(id_token_names=["name"], **order)
    assert person(small_site).sign_in().status_code == 303
    (ada,) = people_of(small_site)
    assert (ada.name, ada.email) == ("Ada Example", None)


@pytest.mark.parametrize(("says", "kept"), [(False, None), ("false", None), (True, "e@x.org")])
def test_an_address_that_the_provider_calls_unverified_is_not_kept(
    small_site: "Api", person: Open, provider: "RunningProvider", says: Any, kept: str | None
) -> None:
    provider.order(person={"sub": "s", "name": "E", "email": "e@x.org", "email_verified": says})
    person(small_site).sign_in()
    (somebody,) = people_of(small_site)
    assert somebody.email == kept


def test_a_profile_of_somebody_else_is_refused(
    small_site: "Api", person: Open, provider: "RunningProvider"
) -> None:
    provider.order(id_token_names=[], userinfo={"sub": "sub-2"})
    ada = person(small_site)
    assert_refused(ada.sign_in(), ada)


def test_a_wrong_state_is_refused(small_site: "Api", person: Open) -> None:
    ada = person(small_site)
    back = ada.provider.visit(ada.begin())
    right = query_of(back)["state"]
    for wrong in ("", "x", right[:-1] + ("a" if right[-1] != "a" else "b"), right * 50):
        assert_refused(ada.come_back(back.replace(right, wrong)), ada, 400)


def test_a_flow_of_another_browser_is_refused(small_site: "Api", person: Open) -> None:
    victim, attacker = person(small_site), person(small_site)
    back = attacker.provider.visit(attacker.begin())
    victim.get("/sign-in")
    assert_refused(victim.come_back(back), victim, 400)
    victim.begin()
    assert_refused(victim.come_back(back), victim, 400)


def test_a_flow_in_a_cookie_of_ones_own_making_is_refused(small_site: "Api", person: Open) -> None:
    ada, forger = person(small_site), person(small_site)
    back = ada.provider.visit(ada.begin())
    cookie = ada.browser.client.cookies["__Host-sign-in"]
    other = "A" if cookie[-5] != "A" else "B"  # the last letter holds bits that count for nothing
    forger.browser.client.cookies.set("__Host-sign-in", f"{cookie[:-5]}{other}{cookie[-4:]}")
    assert_refused(forger.come_back(back), forger, 400)


def test_the_same_answer_works_once(site: "Api", person: Open) -> None:
    ada = person(site)
    back = ada.provider.visit(ada.begin())
    assert ada.come_back(back).status_code == 303
    ada.post("/sign-out", {}, page="/my/team")
    assert_refused(ada.come_back(back), ada, 400)


def test_a_second_click_of_who_is_signed_in_leads_on(small_site: "Api", person: Open) -> None:
    ada = person(small_site)
    back = ada.provider.visit(ada.begin())
    ada.come_back(back)
    again = ada.come_back(back)
    assert (again.status_code, again.headers["location"]) == (303, "/my")
    assert ada.has_session


def test_who_signs_in_anew_leaves_no_earlier_session(small_site: "Api", person: Open) -> None:
    ada = person(small_site)
    ada.browser.sign_in("alpha")
    ada.sign_in()
    (ada_herself,) = people_of(small_site)
    with small_site.database.read() as session:
        (opened,) = session.scalars(select(BrowserSession))
    assert opened.person_id == ada_herself.id


def test_of_two_flows_of_a_browser_the_later_counts_and_the_earlier_is_told(
    small_site: "Api", person: Open
) -> None:
    ada = person(small_site)
    earlier, later = (ada.provider.visit(ada.begin()) for _ in range(2))
    assert "another was begun after it" in assert_refused(ada.come_back(earlier), ada, 400)
    assert ada.come_back(later).headers["location"] == "/my"
    assert ada.come_back(earlier).headers["location"] == "/my"


def test_a_replayed_code_is_refused(small_site: "Api", person: Open) -> None:
    ada, thief = person(small_site), person(small_site)
    used = query_of(ada.provider.visit(ada.begin()))
    ada.come_back(f"/sign-in/callback?state={used['state']}&code={used['code']}")
    state = query_of(thief.begin())["state"]
    answer = thief.come_back(f"/sign-in/callback?state={state}&code={used['code']}")
    assert_refused(answer, thief)


def test_a_stolen_code_is_useless_without_the_verifier(small_site: "Api", person: Open) -> None:
    ada, thief = person(small_site), person(small_site)
    stolen = query_of(ada.provider.visit(ada.begin()))["code"]
    state = query_of(thief.begin())["state"]
    assert_refused(thief.come_back(f"/sign-in/callback?state={state}&code={stolen}"), thief)


@pytest.mark.parametrize(("passed_s", "status"), [(601, 400), (570, 303), (-30, 303)])
def test_a_flow_that_is_too_old_is_refused_and_one_that_is_still_to_begin_is_not(
    small_site: "Api",
    person: Open,
    monkeypatch: pytest.MonkeyPatch,
    passed_s: int,
    status: int,
) -> None:
    """The server that a browser comes back to may have a clock behind that of the one it left."""
    ada = person(small_site)
    url = ada.begin()
    now_s = time.time() + passed_s
    monkeypatch.setattr(time, "time", lambda: now_s)
    answer = ada.come_back(ada.provider.visit(url))
    assert (answer.status_code, ada.has_session) == (status, status == 303)


@pytest.mark.parametrize(
    "orders",
    [
        {"claims": {"nonce": "of-another-flow"}},
        {"claims": {"nonce": None}},
        {"claims": {"exp": 1_700_000_000, "iat": 1_699_999_000}},
        {"claims": {"exp": None}},
        {"claims": {"iat": 4_000_000_000}},  # a provider's clock that is far ahead
        {"claims": {"iss": "https://elsewhere.example"}},
        {"claims": {"aud": ["somebody-else"]}},
        {"claims": {"aud": ["somebody-else"], "azp": "exceptiondrive"}},
        {"claims": {"aud": ["exceptiondrive", "somebody-else"], "azp": "somebody-else"}},
        {"claims": {"sub": None}},
        {"claims": {"sub": ""}},
        {"claims": {"at_hash": "of-another-token"}},
        {"forge": True},
        {"algorithm": "none"},
        {"algorithm": "HS256"},
        {"sign_with_unpublished": True},
    ],
    ids=str,
)
def test_an_id_token_that_is_not_good_is_refused(
    small_site: "Api", person: Open, provider: "RunningProvider", orders: dict[str, Any]
) -> None:
    provider.order(**orders)
    ada = person(small_site)
    text = assert_refused(ada.sign_in(), ada)
    assert "Example University did not sign you in" in text
    assert people_of(small_site) == []


def test_rotated_keys_are_fetched_when_an_unknown_one_appears(
    small_site: "Api", person: Open, provider: "RunningProvider"
) -> None:
    assert person(small_site).sign_in().status_code == 303
    before = provider.order()
    assert person(small_site).sign_in().status_code == 303
    assert provider.order() == before, "known keys are kept"
    provider.order(rotate="second")
    assert person(small_site).sign_in().status_code == 303
    assert provider.order() == before + 1


def test_a_new_key_under_the_name_of_the_old_one_is_taken_by_who_begins_again(
    small_site: "Api", person: Open, provider: "RunningProvider"
) -> None:
    assert person(small_site).sign_in().status_code == 303
    provider.order(rotate="first")
    ada = person(small_site)
    assert "Begin again" in assert_refused(ada.sign_in(), ada)
    assert ada.sign_in().status_code == 303


def test_an_answer_of_another_provider_is_refused(small_site: "Api", person: Open) -> None:
    ada = person(small_site)
    back = ada.provider.visit(ada.begin())
    assert_refused(ada.come_back(back + "&iss=https%3A%2F%2Felsewhere.example"), ada)


def test_who_declines_at_the_provider_is_told_so(
    small_site: "Api", person: Open, provider: "RunningProvider"
) -> None:
    provider.order(deny=True)
    ada = person(small_site)
    text = assert_refused(ada.sign_in(), ada, 403)
    assert "called off" in text
    assert "aria-invalid" not in text, "nothing is wrong with a token that nobody typed"


@pytest.mark.parametrize(
    ("error", "told"),
    [
        ("invalid_scope", "invalid_scope"),
        ("server_error", "server_error"),
        ("hush", "another error"),
    ],
)
def test_another_error_of_the_provider_is_told_as_its_own_and_logged_by_its_code(
    small_site: "Api", person: Open, logs: list[Any], error: str, told: str
) -> None:
    ada = person(small_site)
    for _ in range(31):  # none of them counts as an attempt of somebody who guesses
        back = f"/sign-in/callback?state={query_of(ada.begin())['state']}&error={error}"
        text = assert_refused(ada.come_back(f"{back}&error_description=hush"), ada)
    assert "did not sign you in" in text
    assert [line["why"] for line in logs if "why" in line] == [f"the provider answered {told}"] * 31
    assert "hush" not in repr(logs)
    assert_refused(ada.come_back(back), ada, 400)


def test_a_provider_that_names_another_issuer_is_not_used(
    small_site: "Api", browse: Browse, provider: "RunningProvider", logs: list[Any]
) -> None:
    """Most often they differ by a slash at the end: the operator is told both."""
    named = f"{provider.issuer}/"
    provider.order(names_itself=named)
    assert browse(small_site).get("/sign-in/provider").status_code == 503
    told = [(line["named"], line["expected"]) for line in logs if "named" in line]
    assert told == [(named, provider.issuer)]


def test_without_the_provider_tokens_still_sign_in(
    make_api: Callable[..., "Api"], sqlite_url: str, browse: Browse
) -> None:
    site = with_provider(make_api, sqlite_url, f"http://127.0.0.1:{free_port()}")
    browser = browse(site)
    answer = browser.get("/sign-in/provider")
    assert answer.status_code == 503
    assert "Example University does not answer" in answer.text
    assert "sign in with your team&#39;s token" in answer.text
    assert browser.sign_in("alpha").status_code == 303


def test_a_provider_that_goes_away_in_the_middle_is_told(small_site: "Api", person: Open) -> None:
    ada = person(small_site)
    state = query_of(ada.begin())["state"]
    metadata = small_site.services.provider._client.server_metadata  # type: ignore[union-attr]
    metadata["token_endpoint"] = f"http://127.0.0.1:{free_port()}/token"
    answer = ada.come_back(f"/sign-in/callback?state={state}&code=x")
    assert "does not answer" in assert_refused(answer, ada, 503)


@pytest.mark.parametrize(
    "back", ["https://evil.test/", "//evil.test", "/\\evil.test", "javascript:alert(1)", "/\t/evil"]
)
def test_the_way_back_leads_nowhere_else(small_site: "Api", person: Open, back: str) -> None:
    answer = person(small_site).sign_in(back=back)
    assert answer.headers["location"] == "/"


def test_the_redirect_address_does_not_follow_the_host_header(
    small_site: "Api", browse: Browse
) -> None:
    answer = browse(small_site, "https://evil.test").get("/sign-in/provider")
    asked = query_of(answer.headers["location"])
    assert asked["redirect_uri"] == "https://server.test/sign-in/callback"


def test_the_secrets_of_a_sign_in_stand_in_no_log(
    small_site: "Api", person: Open, logs: list[Any]
) -> None:
    ada = person(small_site)
    back = ada.provider.visit(ada.begin())
    ada.come_back(back)
    ada.come_back(back)
    secrets = [*query_of(back).values(), ada.browser.client.cookies["__Host-session"]]
    assert not [secret for secret in secrets if secret in repr(logs)]
    assert "__Host-sign-in" not in ada.browser.client.cookies


def test_beginning_over_and_over_is_slowed_down_and_locks_nobody_out(
    small_site: "Api", person: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture on any page can make browsers of one network begin."""
    monkeypatch.setattr(attempts, "STARTS_PER_ADDRESS", 40)
    ada = person(small_site)
    back = ada.provider.visit(ada.begin())
    codes = [person(small_site).browser.get("/sign-in/provider").status_code for _ in range(40)]
    assert codes == [303] * 39 + [429]
    assert ada.come_back(back).status_code == 303
    assert person(small_site).browser.sign_in("alpha").status_code == 303


def test_false_answers_of_a_provider_are_counted(small_site: "Api", person: Open) -> None:
    """Each is begun in earnest, and comes back with a code that the provider does not know."""

    def come_back_falsely() -> int:
        ada = person(small_site)
        back = ada.provider.visit(ada.begin())
        code = query_of(back)["code"]
        return int(ada.come_back(back.replace(code, "0" * len(code))).status_code)

    codes = [come_back_falsely() for _ in range(31)]
    assert codes == [401] * 30 + [429]


def test_where_no_provider_is_named_there_is_no_such_way(api: "Api", browse: Browse) -> None:
    assert browse(api).get("/sign-in/provider").status_code == 404
    assert "/sign-in/provider" not in browse(api).get("/sign-in").text


@pytest.mark.parametrize(
    "settings",
    [
        {"oidc_issuer": "http://provider.example"},
        {"oidc_issuer": "https://provider.example", "oidc_client_id": "x"},
        {"oidc_issuer": "https://provider.example", "public_url": "https://server.test"},
    ],
)
def test_half_a_setup_stops_the_start(settings: dict[str, str]) -> None:
    with pytest.raises(ValidationError, match="EXCEPTIONDRIVE_OIDC_ISSUER"):
        ServerSettings(**settings)  # type: ignore[arg-type]
