"""Every output of the server, tested with one table of strings (`nasty_strings.py`).

The strings that intake refuses are put into the records by hand: outputs have to be safe alone.
"""

import csv
import io
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as Xml

import pytest
from sqlalchemy import select
from tests.server.nasty_strings import ALL, BAD_LINKS, NASTY, UNSHOWABLE, steering_in

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.db.identifiers import checked_name
from exceptiondrive_records.notifications.channels import text_of
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_schemas.api.notifications import ChangedEntry, NotificationView
from exceptiondrive_schemas.api.rescoring import Comparison, EntryChange
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_server.rescoring.exports import comparison_csv

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Make = Callable[..., Any]
IDS = {key: f"nasty{number:03d}" for number, key in enumerate(ALL)}
HANDLERS = re.compile(r"^on[a-z]+$", re.IGNORECASE)
"""Attributes that would run a script."""


class Elements(HTMLParser):
    """Collects what a browser would make of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def assert_inert(page: str) -> Elements:
    """No script, handler or address comes from a name, and nothing steers the reader."""
    seen = Elements()
    seen.feed(page)
    for tag, attributes in seen.found:
        assert [name for name in attributes if HANDLERS.match(name)] == [], (tag, attributes)
        if tag == "script":
            assert (attributes.get("src") or "").startswith("/static/")
        assert (tag, attributes.get("src")) != ("img", "x")
        for name in ("href", "src", "action"):
            address = (attributes.get(name) or "").strip().lower()
            assert not address.startswith(("javascript:", "data:text", "file:", "//")), address
    assert steering_in(page) == []
    return seen


@pytest.fixture
def nasty(api: "Api", make_entry: Make) -> "Api":
    """A board, teams and submissions that hold every string, past every check of intake."""
    made = []
    for number, (key, text) in enumerate(ALL.items()):
        link = BAD_LINKS[number % len(BAD_LINKS)]
        submission_id = api.submit(f"file {number}", who="alpha").json().get("id")
        if submission_id is None:  # the quota is 5 a day
            submission_id = IDS[key]
        else:
            api.score(submission_id)
        IDS[key] = submission_id
        row = make_entry(text, submission_id=submission_id, team=text, rank=number + 1)
        links = Links(paper=link, code=link)
        made.append(row.model_copy(update={"description": text, "links": links}))
    with api.database.write() as session:
        for number, text in enumerate(ALL.values()):
            create_team(session, f"t{number}", f"Team {number}", actor="test").name = text
        for number, row in enumerate(session.scalars(select(Submission)).all()):
            row.method = row.description = list(UNSHOWABLE.values())[number]
            row.paper_url = row.code_url = BAD_LINKS[number]
        session.scalars(select(Phase)).one().title = "".join(ALL.values())
        session.scalars(select(Team).where(Team.slug == "alpha")).one().name = "\x1b[2J"
    api.publish(*made)
    return api


@pytest.fixture
def roomy(api: "Api") -> "Api":
    api.phase("many", quota_per_day=1000, rejected_per_day=1000)
    return api


def test_intake_takes_what_can_be_shown_and_gives_it_back_as_it_was(roomy: "Api") -> None:
    for key, text in NASTY.items():
        assert checked_name("team name", text) == text
        taken = roomy.submit(key, phase="many", method=text, description=text)
        assert taken.status_code == 202, taken.text
        shown = roomy.get(f"/submissions/{taken.json()['id']}", "alpha").json()
        assert (shown["method"], shown["description"]) == (text, text)


def test_intake_refuses_what_cannot_be_shown(roomy: "Api") -> None:
    for key, nasty in UNSHOWABLE.items():
        text = "x" + nasty  # blanks at the ends are cut
        with pytest.raises(InvalidRecord), roomy.database.write() as session:
            create_team(session, "new", text, actor="test")
        for field in ("method", "description"):
            if field == "description" and key in ("lines", "header"):
                continue  # it may have lines: it stands in no header and in no cell
            refused = roomy.submit(key, phase="many", **{"method": "M", field: text})
            assert refused.status_code == 400, (key, field)
            assert text not in refused.text
            assert not {"bcc", "set-cookie"} & set(refused.headers)


def test_intake_refuses_links_that_are_not_plain_https(roomy: "Api") -> None:
    for link in BAD_LINKS:
        for field in ("paper_url", "code_url"):
            refused = roomy.submit("a file", phase="many", **{field: link})
            assert refused.status_code == 400, (field, link)


READERS = (
    "/?phase=dev",
    "/?phase=dev&sort=ur",
    "/history?phase=dev",
    "/entries/{script}?phase=dev",
    "/entries/{attribute}?phase=dev",
    "/entries/{closing}?phase=dev",
    "/entries/{escape}?phase=dev",
    "/entries/{right-to-left}?phase=dev",
    "/entries/{header}?phase=dev",
    "/compare?phase=dev&a={script}&b={closing}",
    "/compare?phase=dev&a={escape}&b={image}",
    "/submit?phase=dev",
)
ORGANIZERS = (
    "/organize",
    "/organize/submissions",
    "/organize/submissions/{script}",
    "/organize/teams",
    "/organize/teams/t0",
    "/organize/teams/t20",
    "/organize/phases",
    "/organize/phases/dev",
    "/organize/similar/dev",
    "/organize/audit",
    "/organize/rescoring",
)
TEAMS = ("/my", "/my/team", "/my/tokens", "/submit", "/submissions/{script}")


def test_pages_of_readers_are_inert(nasty: "Api") -> None:
    for path in READERS:
        answer = nasty.client.get(path.format(**IDS))
        assert answer.status_code == 200, (path, answer.text[:200])
        seen = assert_inert(answer.text)
        assert "1337" not in answer.text, "a template was run"
        if path == "/?phase=dev":
            assert NASTY["script"] in "".join(seen.text)
        assert "'unsafe-inline'" not in answer.headers["content-security-policy"]


@pytest.mark.parametrize(("who", "paths"), [("organizer", ORGANIZERS), ("alpha", TEAMS)])
def test_pages_of_those_who_signed_in_are_inert(
    nasty: "Api", browse: Callable[..., "TeamBrowser"], who: str, paths: tuple[str, ...]
) -> None:
    browser = browse(nasty, who=who)
    for path in paths:
        answer = browser.get(path.format(**IDS))
        assert answer.status_code == 200, path
        assert_inert(answer.text)


def test_badges_and_pictures_are_made_whatever_the_name(nasty: "Api") -> None:
    for submission_id in IDS.values():
        badge = nasty.client.get(f"/badges/{submission_id}.svg?phase=dev")
        assert badge.status_code == 200
        for element in Xml.fromstring(badge.text).iter():
            assert element.tag.split("}")[-1] not in ("script", "image", "foreignObject")
            assert [name for name in element.attrib if HANDLERS.match(name)] == []
        assert steering_in(badge.text) == []
    paths = [f"/pictures/entries/{IDS[key]}.png?phase=dev" for key in ALL]
    for path in ("/pictures/board.png?phase=dev", *paths):
        picture = nasty.client.get(path)
        assert (picture.status_code, picture.content[:4]) == (200, b"\x89PNG"), path


def assert_no_formula(text: str, columns: tuple[str, ...], n_rows: int) -> None:
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == n_rows
    for row in rows:
        for column in columns:
            assert not row[column].startswith(tuple("=+-@\t\r\n\uff1d"))
            assert "\n" not in row[column]
    for cells in csv.reader(io.StringIO(text), delimiter=";", quoting=csv.QUOTE_NONE):
        assert not [cell for cell in cells if cell.strip().startswith(tuple("=+-@\uff1d"))]
    assert steering_in(text) == []
    assert "\r" not in text
    assert "\t" not in text


def test_files_of_a_board_run_nothing(nasty: "Api") -> None:
    for path in ("/api/v1/leaderboard.csv?phase=dev", "/export/board.csv?phase=dev"):
        assert_no_formula(nasty.client.get(path).text, ("method", "team"), len(ALL))
    text = nasty.client.get("/export/board.tex?phase=dev").text
    assert r"\input{" not in text
    assert steering_in(text) == []
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert len(rows) == len(ALL) + 1
    assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {1 + len(PLANNING.columns)}
    for line in rows:
        assert not re.search(r"(?<!\\)[%#]", line), line
    text = nasty.client.get("/feed.atom?phase=dev").text
    tags = {element.tag.split("}")[-1] for element in Xml.fromstring(text).iter()}
    assert tags <= {"feed", "title", "id", "link", "updated", "author", "name", "entry", "summary"}
    assert steering_in(text) == []


def test_json_holds_every_name_as_it_is(nasty: "Api") -> None:
    answer = nasty.client.get("/api/v1/leaderboard?phase=dev")
    assert {row["method"] for row in answer.json()["entries"]} == set(ALL.values())
    assert answer.headers["content-type"] == "application/json"
    assert answer.headers["x-content-type-options"] == "nosniff"


def notice(text: str, reference: dict[str, str]) -> NotificationView:
    told = ChangedEntry(submission_id="s", method=text, old=None, new=None)
    fields: dict[str, Any] = {"phase": "dev", "created_at": "2026-11-22T00:00:00Z"}
    return NotificationView.model_validate_json(
        json.dumps(
            {
                **fields,
                "id": "n1",
                "kind": "protocol_applied",
                "team": text,
                "title": text,
                "from_protocol": reference,
                "to_protocol": reference,
                "what_changed": [text],
                "entries": [told.model_dump(mode="json")],
                "comparison": "/api/v1/rescoring/r",
            }
        )
    )


REFERENCE = {"version": "1.0", "digest": "sha256:0"}


@pytest.mark.parametrize("text", ALL.values(), ids=ALL)
def test_an_email_gets_no_header_and_no_line_from_a_name(text: str) -> None:
    from exceptiondrive_records.notifications.channels import NoticeSettings, message_of

    message = message_of(NoticeSettings(), "to@example.org", notice(text, REFERENCE), "/leave")
    raw = message.as_bytes()
    sent = {"Subject", "From", "To", "Message-ID", "MIME-Version"}
    sent |= {"Content-Type", "Content-Transfer-Encoding"}
    sent |= {"List-Unsubscribe", "List-Unsubscribe-Post", "Date"}
    assert set(message.keys()) == sent
    assert b"\nBcc:" not in raw
    body = text_of(notice(text, REFERENCE), "https://board.example")
    assert body.count("\n") == text_of(notice("x", REFERENCE), "https://b").count("\n")
    assert steering_in(body) == []


@pytest.mark.parametrize("text", ALL.values(), ids=ALL)
def test_a_webhook_gets_the_name_as_a_json_string(text: str) -> None:
    from exceptiondrive_schemas.base import canonical_json

    body = canonical_json(notice(text, REFERENCE))
    assert json.loads(body)["title"] == text
    assert b"\n" not in body
    assert b"\r" not in body


def test_a_preview_for_spreadsheets_runs_nothing() -> None:
    changes = [
        EntryChange.model_validate(
            {
                "submission_id": "s",
                "method": text,
                "team": text,
                "change": "none",
                "newly_failing": False,
                "old": None,
                "new": None,
                "rank_shift": None,
                "metric_shifts": {},
                "family_shifts": {},
            }
        )
        for text in ALL.values()
    ]
    split = {"name": "sample", "revision": "sha256:0"}
    compared = Comparison.model_validate(
        {
            "phase": "dev",
            "challenge": "planning",
            "old_board": 1,
            "new_board": 2,
            "from_protocol": REFERENCE,
            "to_protocol": REFERENCE,
            "from_split": split,
            "to_split": split,
            "n_entries": len(changes),
            "n_numbers_changed": 0,
            "n_ranks_changed": 0,
            "n_newly_failing": 0,
            "worst_movers": (),
            "entries": tuple(changes),
        }
    )
    assert_no_formula(comparison_csv(compared, "apply"), ("method", "team"), len(ALL))
