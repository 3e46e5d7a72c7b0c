"""What the page and the document say of people: as the code has it."""

import re
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, select
from tests.access.test_teams_of_people import Open

from exceptiondrive_records.db.base import Base
from exceptiondrive_server.accounts.oidc import FLOW_S

if TYPE_CHECKING:
    from tests.support.application import Api

DOCUMENT = (Path(__file__).parents[2] / "docs" / "privacy.md").read_text("utf-8")
PAGES = ("/", "/history?phase=dev", "/phases/dev", "/submit", "/status", "/privacy", "/feed.atom")


def counts(site: "Api") -> dict[str, int]:
    with site.database.read() as session:
        return {
            name: session.scalar(select(func.count()).select_from(table)) or 0
            for name, table in Base.metadata.tables.items()
        }


def test_the_page_names_every_cookie_and_how_long_it_lasts(small_site: "Api", person: Open) -> None:
    ada = person(small_site)
    set_cookies: dict[str, str] = {}
    for answer in (
        ada.get("/sign-in"),
        ada.browser.client.get("/sign-in/provider"),
        ada.sign_in(),
        ada.browser.send("/theme", {"choice": "dark"}),
    ):
        for line in answer.headers.get_list("set-cookie"):
            set_cookies |= {line.partition("=")[0]: line.lower()}
    page = ada.get("/privacy").text
    named = set(re.findall(r"<code>([\w-]+)</code>", page))
    assert set(set_cookies) == named == {"__Host-session", "__Host-sign-in", "theme"}
    for line in set_cookies.values():
        assert ("secure" in line, "samesite=lax" in line) == (True, True), line
    secrets = {name: "httponly" in line for name, line in set_cookies.items()}
    assert secrets == {"__Host-session": True, "__Host-sign-in": True, "theme": False}
    assert ("max-age=43200" in set_cookies["__Host-session"], "12 hours after" in page) == (
        True,
        True,
    )
    assert ("max-age=31536000" in set_cookies["theme"], "after 365 days" in page) == (True, True)
    assert (timedelta(seconds=FLOW_S), "for 10 minutes" in page) == (timedelta(minutes=10), True)


def test_who_only_reads_gets_no_cookie_and_stands_in_no_row_and_no_log(
    api: "Api", logs: list[Any]
) -> None:
    before, sender = counts(api), {"User-Agent": "Marker/1", "X-Forwarded-For": "203.0.113.77"}
    for path in PAGES:
        answer = api.client.get(path, headers={**sender, "Accept": "text/html"})
        assert (answer.status_code, "set-cookie" in answer.headers) == (200, False), path
        assert answer.headers["referrer-policy"] in ("strict-origin", "no-referrer"), path
    assert counts(api) == before
    assert len([line for line in logs if line["event"] == "request"]) == len(PAGES)
    assert [line for line in logs if re.search(r"Marker|203\.0|testclient|phase=", str(line))] == []


def test_labels_of_metrics_name_nobody(api: "Api") -> None:
    api.score(api.submit("a").json()["id"])
    named = set(re.findall(r'[{,](\w+)="', api.get("/metrics").text))
    told = {"route", "method", "status", "state", "lane", "phase"}
    assert told <= named <= told | {"le", "worker", "trouble", "subject"}
    told_in_words = "their labels are routes, methods, states, lanes, troubles, ids of phases and workers, names of splits"
    assert told_in_words in DOCUMENT


def test_the_document_says_of_every_table_what_it_holds_of_people() -> None:
    places, _, rest = DOCUMENT.partition("Nothing of a person: ")
    rows = [line.split("|")[1] for line in places.splitlines() if line.startswith("| `")]
    without = rest.partition("the broker")[0]
    named = [name for text in (*rows, without) for name in re.findall(r"`(\w+)`", text)]
    assert sorted(named) == sorted({*Base.metadata.tables, "alembic_version"})
