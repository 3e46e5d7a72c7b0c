"""GET /leaderboard, /leaderboard.csv and /boards/{phase}/{number}."""

import csv
import hashlib
import io
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from typing import TYPE_CHECKING, Any

import pytest
from tests.records.statements import of_board_texts, statements
from tests.support.records import next_moment

from exceptiondrive_schemas.board import Board, BoardEntry

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]
MakeEntry = Callable[..., BoardEntry]


@pytest.fixture
def lively(api: "Api", make_entry: MakeEntry) -> "Api":
    """A board of four scored entries, one without a score, a reference and a reported row."""
    api.publish(
        make_entry("first", rank=1, hcc=0.9, ur=0.3, submission_id="a"),
        make_entry("second", rank=2, hcc=0.5, ur=0.1, submission_id="b"),
        make_entry("third", rank=3, hcc=0.4, ur=0.2, submission_id="c"),
        make_entry("no score", rank=None, hcc=None, ur=None, submission_id="d"),
        make_entry("FREEZE", source="reference", rank=None, hcc=1.0, ur=0.0),
        make_entry("ST-P3", source="reported", rank=None, hcc=0.21, ur=0.78),
    )
    return api


PLAIN = {"Accept-Encoding": "identity"}


def methods(response: Any) -> list[str]:
    assert response.status_code == 200, response.text
    return [row.method for row in Board.model_validate_json(response.content).entries]


def test_the_board_is_the_stored_bytes(api_on_both: "Api", make_entry: MakeEntry) -> None:
    row = api_on_both.publish(make_entry("one", submission_id="a"))
    response = api_on_both.get("/leaderboard?challenge=planning", headers=PLAIN)
    assert response.content == row.body.encode()
    assert response.headers["content-type"] == "application/json"
    assert response.headers["etag"] == f'"{row.body_digest.removeprefix("sha256:")}"'


def test_the_strong_etag_is_the_digest_of_the_bytes(lively: "Api") -> None:
    response = lively.get("/leaderboard?phase=dev", headers=PLAIN)
    assert response.headers["etag"] == f'"{hashlib.sha256(response.content).hexdigest()}"'
    assert response.headers["cache-control"].startswith("public, max-age=")
    assert "stale-while-revalidate" in response.headers["cache-control"]
    assert response.headers["x-accel-expires"] == "5"


@pytest.mark.parametrize("query", ["", "&sort=ur", "&protocol=1.0"])
@pytest.mark.parametrize("path", ["/leaderboard", "/leaderboard.csv"])
def test_an_unchanged_board_is_304_without_a_body(lively: "Api", path: str, query: str) -> None:
    address = f"{path}?phase=dev{query}"
    etag = lively.get(address, headers=PLAIN).headers["etag"]
    for asked in (etag, f'"other", {etag}', f"W/{etag}", "*"):
        response = lively.get(address, headers={"If-None-Match": asked, **PLAIN})
        assert (response.status_code, response.content) == (304, b"")
        assert response.headers["etag"] == etag


def test_a_compressed_board_has_the_same_tag_as_a_weak_one(lively: "Api") -> None:
    plain = lively.get("/leaderboard?phase=dev", headers=PLAIN)
    packed = lively.get("/leaderboard?phase=dev", headers={"Accept-Encoding": "gzip"})
    assert (packed.content, packed.headers["content-encoding"]) == (plain.content, "gzip")
    assert packed.headers["etag"] == f"W/{plain.headers['etag']}"
    assert {each.headers["vary"] for each in (plain, packed)} == {"Accept-Encoding"}
    for tag in (plain.headers["etag"], packed.headers["etag"]):
        headers = {"If-None-Match": tag, "Accept-Encoding": "gzip"}
        again = lively.get("/leaderboard?phase=dev", headers=headers)
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == packed.headers["etag"]


def test_a_wrong_filter_is_called_as_the_address_calls_it(lively: "Api") -> None:
    problem = lively.get("/leaderboard?phase=dev&fact=colour:red").json()
    assert list(problem["fields"]) == ["fact"]
    assert problem["detail"].endswith(": fact.")


@pytest.mark.parametrize("encoding", ["identity", "gzip"])
@pytest.mark.parametrize("address", ["/leaderboard?phase=dev", "/leaderboard.csv?phase=dev"])
def test_a_304_says_by_what_the_answer_varies(lively: "Api", encoding: str, address: str) -> None:
    asks = {"Accept-Encoding": encoding}
    whole = lively.get(address, headers=asks)
    again = lively.get(address, headers={**asks, "If-None-Match": whole.headers["etag"]})
    assert again.status_code == 304
    assert again.headers["vary"] == whole.headers["vary"] == "Accept-Encoding"


def test_a_changed_board_is_sent_whole(lively: "Api", make_entry: MakeEntry) -> None:
    before = lively.get("/leaderboard?phase=dev").headers["etag"]
    lively.publish(make_entry("new"))
    response = lively.get("/leaderboard?phase=dev", headers={"If-None-Match": before})
    assert methods(response) == ["new"]
    assert response.headers["etag"] != before


@pytest.mark.parametrize(
    ("sort", "order"),
    [
        ("ur", ["second", "third", "first", "no score"]),
        ("-ur", ["first", "third", "second", "no score"]),
        ("-hcc", ["first", "second", "third", "no score"]),
        ("hcc", ["third", "second", "first", "no score"]),
    ],
)
def test_sorting_keeps_ranks_and_puts_no_value_last(
    lively: "Api", sort: str, order: list[str]
) -> None:
    response = lively.get(f"/leaderboard?phase=dev&sort={sort}")
    assert methods(response) == [*order, "FREEZE", "ST-P3"]
    ranks = {row["method"]: row["rank"] for row in response.json()["entries"]}
    assert [ranks[name] for name in ("first", "second", "third", "no score")] == [1, 2, 3, None]


@pytest.mark.parametrize("sort", ["team", "accuracy", "--ur", "ur;drop", "", "-", "__class__"])
def test_only_metrics_of_the_challenge_sort(lively: "Api", as_problem: Problem, sort: str) -> None:
    problem = as_problem(lively.get(f"/leaderboard?phase=dev&sort={sort}"), 400, "bad_request")
    assert "or one of hcc, ur, " in problem["fields"]["sort"]


@pytest.mark.parametrize("sort", ["HCC", "-HCC", "hccc"])
def test_a_metric_in_other_letters_is_told_what_was_meant(
    lively: "Api", as_problem: Problem, sort: str
) -> None:
    problem = as_problem(lively.get(f"/leaderboard?phase=dev&sort={sort}"), 400, "bad_request")
    assert problem["fields"]["sort"].startswith("did you mean hcc? sort by rank, ")


@pytest.mark.parametrize(
    "query",
    [
        "phase=nowhere",
        "phase=dev&challenge=strategy",
        "challenge=strategy",
        "phase=dev&protocol=9.9",
        "phase=dev&as_of=2001-01-01",
    ],
)
def test_an_unknown_board_is_404(lively: "Api", as_problem: Problem, query: str) -> None:
    as_problem(lively.get(f"/leaderboard?{query}"), 404, "not_found")
    as_problem(lively.get(f"/leaderboard.csv?{query}"), 404, "not_found")


def test_a_phase_without_a_board_yet_is_404(api: "Api", as_problem: Problem) -> None:
    as_problem(api.get("/leaderboard?phase=dev"), 404, "not_found")


def test_as_of_gives_the_board_that_was_current_then(lively: "Api", make_entry: MakeEntry) -> None:
    between = datetime.now(UTC)
    next_moment(lively.database)
    lively.publish(make_entry("later"))
    today = between.date()
    assert methods(lively.get("/leaderboard", params={"as_of": between.isoformat()}))[0] == "first"
    assert methods(lively.get(f"/leaderboard?as_of={today + timedelta(days=1)}")) == ["later"]
    east = between.astimezone(timezone(timedelta(hours=2))).isoformat()
    assert "+02:00" in east  # a blank once it went through an address unescaped
    assert methods(lively.get(f"/leaderboard?as_of={east}"))[0] == "first"


def test_as_of_a_date_means_its_end(lively: "Api") -> None:
    today = datetime.now(UTC).date()
    assert methods(lively.get(f"/leaderboard?as_of={today}"))[0] == "first"


@pytest.mark.parametrize("as_of", ["9999-12-31", "0001-01-01", "9999-12-31T23:59:59+00:00"])
def test_the_ends_of_the_calendar_are_dates_too(api_on_both: "Api", as_of: str) -> None:
    response = api_on_both.get("/leaderboard", params={"phase": "dev", "as_of": as_of})
    assert response.status_code == 404


def test_every_board_keeps_its_address(
    lively: "Api", make_entry: MakeEntry, as_problem: Problem
) -> None:
    body = lively.get("/boards/dev/1").content
    lively.publish(make_entry("later"))
    response = lively.get("/boards/dev/1")
    assert response.content == body
    told = response.headers
    assert (told["x-accel-expires"], told["cache-control"]) == ("5", "no-cache")
    assert list(told).index("x-accel-expires") < list(told).index("cache-control")
    again = lively.get("/boards/dev/1", headers={"If-None-Match": told["etag"]})
    assert (again.status_code, again.headers["x-accel-expires"]) == (304, "5")
    assert methods(lively.get("/boards/dev/2")) == ["later"]
    as_problem(lively.get("/boards/dev/3"), 404, "not_found")
    as_problem(lively.get("/boards/nowhere/1"), 404, "not_found")
    as_problem(lively.get("/boards/dev/0"), 400, "bad_request")


def test_html_in_a_method_name_is_data(api: "Api", make_entry: MakeEntry) -> None:
    api.publish(make_entry("<script>alert(1)</script>", submission_id="a"))
    response = api.get("/leaderboard?phase=dev")
    assert response.headers["content-type"] == "application/json"
    assert response.headers["x-content-type-options"] == "nosniff"
    assert response.json()["entries"][0]["method"] == "<script>alert(1)</script>"


def rows_of(response: Any) -> list[dict[str, str]]:
    assert response.headers["content-type"] == "text/csv; charset=utf-8"
    return list(csv.DictReader(io.StringIO(response.text)))


@pytest.mark.parametrize("name", ["=cmd|'/C calc'!A0", "+1", "-1+1", "@SUM(A1)", "=HYPERLINK(1)"])
def test_a_formula_as_a_name_is_text_in_csv(api: "Api", make_entry: MakeEntry, name: str) -> None:
    api.publish(make_entry(name, team=name))
    row = rows_of(api.get("/leaderboard.csv?phase=dev"))[0]
    assert row["method"] == row["team"] == "'" + name


def test_csv_names_protocol_and_split_by_digest(lively: "Api") -> None:
    rows = rows_of(lively.get("/leaderboard.csv?phase=dev&sort=ur"))
    board = lively.get("/leaderboard?phase=dev").json()
    assert [row["method"] for row in rows][:2] == ["second", "third"]
    for row in rows:
        assert row["protocol"] == "1.0"
        assert row["protocol_digest"] == board["protocol"]["digest"]
        assert row["split_revision"] == board["split"]["revision"]
    assert rows[0]["hcc"] == "0.5"
    assert rows[0]["cts_y"] == ""


def test_head_gives_the_headers_of_get_without_the_body(lively: "Api") -> None:
    got, head = (lively.request(method, "/leaderboard") for method in ("GET", "HEAD"))
    assert (head.status_code, head.content) == (200, b"")
    for name in ("etag", "content-length", "content-type"):
        assert head.headers[name] == got.headers[name]


def test_post_on_a_board_is_405(lively: "Api", as_problem: Problem) -> None:
    as_problem(lively.post("/leaderboard", "alpha"), 405, "method_not_allowed")


def pages(api: "Api", address: str) -> list[Board]:
    """Every page from this one on, as the links lead."""
    found = []
    while address:
        answer = api.get(address)
        assert answer.status_code == 200, answer.text
        found.append(Board.model_validate_json(answer.content))
        address = answer.links.get("next", {}).get("url", "").removeprefix("/api/v1")
    return found


@pytest.mark.parametrize("query", ["", "&sort=ur", "&q=r"])
@pytest.mark.parametrize("limit", [1, 2, 4, 6, 1000])
def test_pages_together_are_the_board(lively: "Api", query: str, limit: int) -> None:
    whole = Board.model_validate_json(lively.get(f"/leaderboard?phase=dev{query}").content)
    found = pages(lively, f"/leaderboard?phase=dev{query}&limit={limit}")
    assert [entry for page in found for entry in page.entries] == list(whole.entries)
    assert len(found) == -(-len(whole.entries) // limit)
    assert found[0].comparisons == whole.comparisons


def test_pages_stay_with_their_board_when_another_is_the_current_one(
    lively: "Api", make_entry: MakeEntry
) -> None:
    first = lively.get("/leaderboard?phase=dev&limit=2")
    lively.publish(make_entry("alone", submission_id="e"))
    following = first.links["next"]["url"].removeprefix("/api/v1")
    assert [row.method for page in pages(lively, following) for row in page.entries] == [
        "third",
        "no score",
        "FREEZE",
        "ST-P3",
    ]
    assert methods(lively.get("/leaderboard?phase=dev&limit=2")) == ["alone"]


def test_a_page_by_a_fact_begins_after_the_last_entry_whatever_teams_edit_meanwhile(
    api: "Api", make_entry: MakeEntry
) -> None:
    rule = '{"type": "rule"}'
    own = [api.submit(name, method=name, facts=rule).json()["id"] for name in "abcd"]
    api.publish(*(make_entry(f"a {n}", rank=n, submission_id=it) for n, it in enumerate(own, 1)))
    first = api.get("/leaderboard?phase=dev&sort=-method&fact=type:rule&limit=2")
    assert methods(first) == ["a 4", "a 3"]
    edited = api.request("PATCH", f"/submissions/{own[3]}", "alpha", json={"facts": {"type": None}})
    assert edited.status_code == 200
    following = first.links["next"]["url"].removeprefix("/api/v1")
    assert methods(api.get(following)) == ["a 2", "a 1"]


def test_the_list_of_boards_comes_in_pages_that_no_new_board_moves_and_is_304_if_unchanged(
    api: "Api", make_entry: MakeEntry
) -> None:
    for name in "abcde":
        api.publish(make_entry(name))
    listed = "/boards?phase=dev"
    assert [line["board"] for line in api.get(listed).json()] == [5, 4, 3, 2, 1]
    first = api.get(f"{listed}&limit=2")
    api.publish(make_entry("f"))
    found, answer = [line["board"] for line in first.json()], first
    while "next" in answer.links:
        answer = api.get(answer.links["next"]["url"].removeprefix("/api/v1"))
        found += [line["board"] for line in answer.json()]
        assert len(answer.json()) <= 2
    assert found == [5, 4, 3, 2, 1]
    for asked in (listed, f"{listed}&limit=2"):
        tag = {"If-None-Match": api.get(asked).headers["etag"]}
        assert (api.get(asked, headers=tag).status_code, api.get(asked).json()[0]["board"]) == (
            304,
            6,
        )
    assert first.headers["etag"] not in tag.values()


def test_a_page_of_a_board_that_was_read_reads_none_of_its_text(lively: "Api") -> None:
    first = lively.get("/leaderboard?phase=dev&limit=2")
    following = first.links["next"]["url"].removeprefix("/api/v1")
    with statements(lively.services.database) as sent:
        assert len(pages(lively, following)) > 1
    assert sent
    assert not of_board_texts(sent)


@pytest.mark.parametrize("after", ["1", "1.", "x.1", "0.1", "1.1.1", "1.-1"])
def test_what_is_no_place_in_a_board_is_refused(
    lively: "Api", after: str, as_problem: Problem
) -> None:
    answer = lively.get(f"/leaderboard?phase=dev&after={after}")
    problem = as_problem(answer, 400, "bad_request")
    assert problem["fields"] == {"after": "must be taken from the `Link` of the page before"}


def test_without_a_limit_a_page_is_all_that_is_left(lively: "Api") -> None:
    whole = methods(lively.get("/leaderboard?phase=dev"))
    assert methods(lively.get("/leaderboard?phase=dev&after=1.2")) == whole[2:]


def test_a_page_of_a_board_that_is_not_there_is_not_found(
    lively: "Api", as_problem: Problem
) -> None:
    as_problem(lively.get("/leaderboard?phase=dev&limit=2&after=99.2"), 404, "not_found")
    assert methods(lively.get("/leaderboard?phase=dev&limit=2&after=1.999")) == []
