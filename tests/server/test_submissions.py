"""GET /submissions, GET /submissions/{id}, POST /submissions/{id}/withdraw."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import pytest
from fastapi.concurrency import run_in_threadpool
from fastapi.dependencies import utils
from tests.support.application import entry

from exceptiondrive_records.submissions.submissions import KEYS_ARE_KEPT
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import SubmissionPage, SubmissionView
from exceptiondrive_schemas.score_sheet import ReminderEffect
from exceptiondrive_server.submissions.upload import NO_RESULTS

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]


def ids(response: Any) -> list[str]:
    assert response.status_code == 200, response.text
    page = SubmissionPage.model_validate_json(response.content)
    return [submission.id for submission in page.submissions]


def submit_all(api: "Api", who: str, *contents: str) -> list[str]:
    return [api.submit(content, who).json()["id"] for content in contents]


def test_a_team_sees_its_own_newest_first(api_on_both: "Api") -> None:
    own = submit_all(api_on_both, "alpha", "a", "b")
    submit_all(api_on_both, "beta", "c")
    assert ids(api_on_both.get("/submissions", "alpha")) == own[::-1]


def test_of_what_a_route_asks_first_the_records_alone_take_a_thread(
    api: "Api", monkeypatch: pytest.MonkeyPatch
) -> None:
    called: list[str] = []

    async def noted(call: Callable[..., Any], *given: Any, **named: Any) -> Any:
        called.append(call.__name__)
        return await run_in_threadpool(call, *given, **named)

    monkeypatch.setattr(utils, "run_in_threadpool", noted)
    assert api.get("/submissions", "alpha").status_code == 200
    assert called == ["principal_or_none"]


def test_an_organizer_sees_all(api: "Api") -> None:
    both = submit_all(api, "alpha", "a") + submit_all(api, "beta", "b")
    assert ids(api.get("/submissions", "organizer")) == both[::-1]


def test_pages_continue_where_the_last_one_ended(api: "Api") -> None:
    own = submit_all(api, "alpha", "a", "b", "c")[::-1]
    first = api.get("/submissions?limit=2", "alpha").json()
    assert first["next"] == own[1]
    rest = api.get(f"/submissions?limit=2&after={first['next']}", "alpha")
    assert ids(rest) == own[2:]
    assert rest.json()["next"] is None


def test_filters_narrow_the_list(api: "Api") -> None:
    one, two = submit_all(api, "alpha", "a", "b")
    api.score(one)
    assert ids(api.get("/submissions?status=scored", "alpha")) == [one]
    assert ids(api.get("/submissions?status=received", "alpha")) == [two]
    assert ids(api.get("/submissions?phase=nowhere", "alpha")) == []
    assert api.get("/submissions?phase=nowhere", "organizer").status_code == 404


@pytest.mark.parametrize("path", ["news", "questions", "rescoring", "rescoring/verifications"])
def test_organizers_are_told_of_a_phase_that_there_is_not(api: "Api", path: str) -> None:
    assert api.get(f"/organizer/{path}?phase=nowhere", "organizer").status_code == 404
    assert api.get(f"/organizer/{path}?phase=dev", "organizer").json() == []


@pytest.mark.parametrize("query", ["limit=0", "limit=201", "limit=x", "status=done"])
def test_a_wrong_filter_is_named(api: "Api", as_problem: Problem, query: str) -> None:
    problem = as_problem(api.get(f"/submissions?{query}", "alpha"), 400, "bad_request")
    assert list(problem["fields"]) == [query.split("=")[0]]


def test_a_page_after_another_teams_submission_is_refused(api: "Api", as_problem: Problem) -> None:
    (other,) = submit_all(api, "beta", "a")
    problem = as_problem(api.get(f"/submissions?after={other}", "alpha"), 400, "bad_request")
    assert problem["fields"] == {"after": "must be taken from the page before"}
    unknown = as_problem(api.get("/submissions?after=nothing", "alpha"), 400, "bad_request")
    assert unknown["detail"] == problem["detail"]


def test_a_submission_is_shown_with_its_sheet_once_scored(api: "Api") -> None:
    (own,) = submit_all(api, "alpha", "a")
    assert api.get(f"/submissions/{own}", "alpha").json()["sheet"] is None
    api.score(own, 0.75)
    shown = SubmissionView.model_validate_json(api.get(f"/submissions/{own}", "alpha").content)
    assert shown.status == "scored"
    assert shown.sheet is not None
    assert shown.sheet.macro_family["hcc"] == 0.75
    assert shown.queue is None


def test_the_rank_is_that_of_the_current_board(api: "Api", make_entry: Callable[..., Any]) -> None:
    (own,) = submit_all(api, "alpha", "a")
    api.score(own)
    api.publish(make_entry("Planner", submission_id=own, rank=7))
    assert api.get(f"/submissions/{own}", "alpha").json()["rank"] == 7


@pytest.mark.row("I24")
@pytest.mark.parametrize(
    ("method", "path"),
    [("GET", ""), ("GET", "/events"), ("GET", "/receipt"), ("POST", "/withdraw")],
)
def test_another_teams_submission_is_404_in_the_words_for_an_unknown_one(
    api_on_both: "Api", as_problem: Problem, method: str, path: str
) -> None:
    (other,) = submit_all(api_on_both, "beta", "a")
    unknown = "0" * len(other)
    answers = [
        as_problem(
            api_on_both.request(method, f"/submissions/{name}{path}", "alpha"), 404, "not_found"
        )
        for name in (other, unknown)
    ]
    for answer, name in zip(answers, (other, unknown), strict=True):
        del answer["request_id"]
        answer["detail"] = answer["detail"].replace(name, "...")
        answer["instance"] = answer["instance"].replace(name, "...")
    assert answers[0] == answers[1]
    assert api_on_both.get(f"/submissions/{other}", "beta").json()["status"] == "received"


def test_a_withdrawn_submission_is_withdrawn_once_and_its_quota_stays_used(api: "Api") -> None:
    (own,) = submit_all(api, "alpha", "a")
    for _ in range(2):
        response = api.post(f"/submissions/{own}/withdraw", "alpha")
        assert (response.status_code, response.json()["status"]) == (200, "withdrawn")
    assert api.get("/phases/dev", "alpha").json()["quota"]["used_today"] == 1


def test_a_token_that_may_only_read_cannot_withdraw(api: "Api", as_problem: Problem) -> None:
    (own,) = submit_all(api, "alpha", "a")
    body = {"name": "reader", "scopes": ["read:own"]}
    api.tokens["reader"] = api.post("/organizer/teams/alpha/tokens", "organizer", json=body).json()[
        "token"
    ]
    assert ids(api.get("/submissions", "reader")) == [own]
    as_problem(api.post(f"/submissions/{own}/withdraw", "reader"), 403, "not_allowed")
    as_problem(api.submit("b", "reader"), 403, "not_allowed")


def test_a_token_that_may_only_submit_is_told_neither_scores_nor_ranks(
    api: "Api", as_problem: Problem
) -> None:
    (own,) = submit_all(api, "alpha", "a")
    api.score(own)
    effect = ReminderEffect(without="b", without_method="Plain", differences={})
    row = entry("Planner", submission_id=own).model_copy(update={"reminder_effect": effect})
    api.publish(row)
    api.tokens["ci"] = api.post(
        "/organizer/teams/alpha/tokens", "organizer", json={"name": "ci", "scopes": ["submit"]}
    ).json()["token"]
    assert api.get(f"/submissions/{own}", "alpha").json()["rank"] == 1

    def answers(who: str) -> list[Any]:
        return [
            api.submit("a", who),
            api.request("PATCH", f"/submissions/{own}", who, json={"description": "A planner"}),
        ]

    for told in answers("alpha"):
        assert (told.json()["rank"], told.json()["sheet"]["micro"]["hcc"]) == (1, 0.5)
        assert told.json()["reminder_effect"]["without"] == "b"
    for told in answers("ci"):
        assert (told.status_code, told.json()["status"]) == (200, "scored")
        assert {name: told.json()[name] for name in NO_RESULTS} == NO_RESULTS
    withdrawn = api.post(f"/submissions/{own}/withdraw", "ci")
    assert withdrawn.json()["status"] == "withdrawn"
    hook = {"channel": "webhook", "address": "https://example.org/hook", "wishes": ["scored"]}
    as_problem(api.post("/contacts", "ci", json=hook), 403, "not_allowed")
    added = api.post("/contacts", "alpha", json=hook).json()["id"]
    wishes = api.request("PATCH", f"/contacts/{added}", "ci", json={"wishes": ["overtaken"]})
    as_problem(wishes, 403, "not_allowed")


def test_whether_a_token_that_may_only_submit_is_told_a_field_is_said_of_each() -> None:
    """`report` is told without what is asked, which may name scores."""
    told = {
        *("id", "phase", "challenge", "team", "method", "description", "links", "facts"),
        *("edited_at", "linked_to", "file_digest", "size_bytes", "status", "received_at"),
        *("status_at", "queue", "report", "failure", "headline", "awaits_board", "awaits_profile"),
        *("is_duplicate", "is_late", "is_chosen", "run_rule", "is_published"),
        *("score_kept_back_since", "disqualified_at", "known_as", "confirm_until", "confirmed_as"),
    }
    assert told | NO_RESULTS.keys() == SubmissionView.model_fields.keys()
    assert not told & NO_RESULTS.keys()


@pytest.mark.parametrize("path", ["/submissions", "/submissions/x", "/submissions/x/events"])
def test_without_a_token_it_is_401(api: "Api", as_problem: Problem, path: str) -> None:
    as_problem(api.get(path), 401, "not_signed_in")


@pytest.mark.parametrize("name", ["%00", "x%00y", "%ED%A0%80", "..%2f..", "'--", "x" * 65])
def test_strange_ids_are_refused_and_break_nothing(api_on_both: "Api", name: str) -> None:
    assert api_on_both.get(f"/submissions/{name}", "alpha").status_code in (400, 404)
    assert api_on_both.get(f"/submissions?phase={name}", "alpha").status_code in (200, 400)


def test_a_team_edits_what_it_says_and_others_cannot(
    api_on_both: "Api", as_problem: Problem
) -> None:
    one = submit_all(api_on_both, "alpha", "a")[0]
    before = api_on_both.get("/phases/dev", "alpha").json()["quota"]
    change = {"method": "Planner 2", "facts": {"type": "vla", "sensors": ["lidar"]}}
    as_problem(
        api_on_both.request("PATCH", f"/submissions/{one}", json=change), 401, "not_signed_in"
    )
    as_problem(
        api_on_both.request("PATCH", f"/submissions/{one}", "beta", json=change), 404, "not_found"
    )
    as_problem(api_on_both.get(f"/submissions/{one}/edits", "beta"), 404, "not_found")
    answer = api_on_both.request("PATCH", f"/submissions/{one}", "alpha", json=change)
    seen = SubmissionView.model_validate_json(answer.content)
    assert (seen.method, seen.facts.type, seen.facts.sensors) == ("Planner 2", "vla", ("lidar",))
    assert seen.edited_at is not None
    history = api_on_both.get(f"/submissions/{one}/edits", "alpha").json()
    assert [sorted(line["changed"]) for line in history] == [
        ["facts.sensors", "facts.type", "method"]
    ]
    assert api_on_both.get("/phases/dev", "alpha").json()["quota"] == before


@pytest.mark.parametrize(
    "change",
    [
        {"facts": {"type": "magic"}},
        {"facts": {"sensors": ["eyes"]}},
        {"facts": {"parameters_millions": -1}},
        {"facts": {"hardware": "x" * 121}},
        {"facts": {"colour": "red"}},
        {"status": "scored"},
        {"method": ""},
    ],
)
def test_a_wrong_edit_is_refused(api: "Api", as_problem: Problem, change: dict[str, Any]) -> None:
    one = submit_all(api, "alpha", "a")[0]
    as_problem(
        api.request("PATCH", f"/submissions/{one}", "alpha", json=change), 400, "bad_request"
    )


def test_facts_travel_with_the_upload(api: "Api", as_problem: Problem) -> None:
    seen = api.submit("a", facts='{"type": "rule", "sensors": ["lidar", "radar"]}').json()
    assert (seen["facts"]["type"], seen["facts"]["sensors"]) == ("rule", ["lidar", "radar"])
    problem = as_problem(api.submit("b", facts='{"type": "magic"}'), 400, "bad_request")
    assert list(problem["fields"]) == ["facts"]


def test_the_same_bytes_under_another_name_change_nothing(api: "Api", as_problem: Problem) -> None:
    one = api.submit("a", method="Planer").json()["id"]
    problem = as_problem(api.submit("a", method="Planner"), 409, "conflict")
    assert f"exceptiondrive edit {one}" in problem["detail"]
    link = "https://example.org/code"
    for field, text in {
        "description": "Other.",
        "code_url": link,
        "facts": '{"type": "vla"}',
    }.items():
        as_problem(api.submit("a", method="Planer", **{field: text}), 409, "conflict")
    assert api.submit("a", method="Planer").status_code == 200
    assert api.get(f"/submissions/{one}", "alpha").json()["method"] == "Planer"


def test_an_upload_that_is_sent_again_with_its_key_is_answered_as_the_first_time(
    api_on_both: "Api", as_problem: Problem
) -> None:
    api = api_on_both
    first = send(api, "a", "k1")
    again = send(api, "a", "k1")
    assert (first.status_code, again.status_code) == (202, 202)
    assert again.json() == first.json()
    assert again.headers["ratelimit-remaining"] == first.headers["ratelimit-remaining"]
    as_problem(send(api, "other bytes", "k1"), 409, "conflict")
    api.phase("second")
    as_problem(send(api, "a", "k1", phase="second"), 409, "conflict")
    assert send(api, "a", "k2").status_code == 200, "the same bytes under another key"
    assert ids(api.get("/submissions", "alpha")) == [first.json()["id"]]
    assert send(api, "other bytes", "k1", who="beta").status_code == 202, "keys are a team's own"


def test_the_key_finds_what_was_withdrawn_meanwhile_and_is_forgotten_after_a_day(
    api_on_both: "Api",
) -> None:
    api = api_on_both
    own = send(api, "a", "k1").json()["id"]
    api.post(f"/submissions/{own}/withdraw", "alpha")
    again = send(api, "a", "k1")
    assert (again.status_code, again.json()["id"]) == (202, own)
    assert again.json()["status"] == "withdrawn"
    with api.database.write() as session:
        row = session.get_one(Submission, own)
        row.received_at -= KEYS_ARE_KEPT
    assert send(api, "b", "k1").json()["id"] != own


def test_two_at_once_with_one_key_are_one(api_on_both: "Api") -> None:
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda _: send(api_on_both, "a", "k1"), range(4)))
    assert {answer.status_code for answer in answers} == {202}
    assert len({answer.json()["id"] for answer in answers}) == 1


@pytest.mark.parametrize("key", ["", "two words", "k" * 256, "\x7f"])
def test_a_key_is_short_and_printable(api: "Api", as_problem: Problem, key: str) -> None:
    assert list(as_problem(send(api, "a", key), 400, "bad_request")["fields"]) == [
        "idempotency-key"
    ]


def send(api: "Api", content: str, key: str, who: str = "alpha", phase: str = "dev") -> Any:
    return api.post(
        "/submissions",
        who,
        data={"phase": phase, "method": "Planner"},
        files={"file": ("planner.json", content.encode())},
        headers={"Idempotency-Key": key},
    )


def test_what_may_still_be_submitted_stands_in_the_headers_of_every_answer_of_a_phase(
    api: "Api",
) -> None:
    own = api.submit("a")
    told = {name: own.headers[name] for name in ("ratelimit-limit", "ratelimit-remaining")}
    for path in ("/phases/dev", f"/submissions/{own.json()['id']}", "/submissions?phase=dev"):
        answer = api.get(path, "alpha")
        assert {name: answer.headers[name] for name in told} == told, path
        assert int(answer.headers["ratelimit-reset"]) <= 86_400
    taken = [
        ("/submissions", "post", "200"),
        ("/submissions", "post", "202"),
        ("/submissions", "get", "200"),
        ("/submissions/{submission_id}", "get", "200"),
        ("/phases/{phase_id}", "get", "200"),
    ]
    paths = api.app.openapi()["paths"]
    for path, method, status in taken:
        declared = paths[f"/api/v1{path}"][method]["responses"][status]["headers"]
        assert {name.lower() for name in declared} >= {*told, "ratelimit-reset"}, path
    assert "ratelimit-limit" not in api.get("/phases/dev").headers
    assert "ratelimit-limit" not in api.get("/submissions?phase=nowhere", "alpha").headers


def test_facts_are_joined_to_a_board_when_it_is_read(
    api: "Api", make_entry: Callable[..., Any]
) -> None:
    one = api.submit("a").json()["id"]
    other = api.submit("b", "beta").json()["id"]
    api.score(one)
    api.publish(make_entry("Planner", submission_id=one))
    board = api.get("/leaderboard?phase=dev")
    for submission, who in ((one, "alpha"), (other, "beta")):
        change = {"facts": {"type": "vla", "hardware": "=1+1"}}
        assert api.request("PATCH", f"/submissions/{submission}", who, json=change).is_success
    told = api.get("/leaderboard/facts?phase=dev").json()
    assert list(told["entries"]) == [one], "what is on no board is its team's alone"
    assert told["entries"][one]["facts"]["type"] == "vla"
    assert told["changed_at"] >= told["entries"][one]["edited_at"]
    assert api.get(f"/entries/{one}").json()["facts"]["hardware"] == "=1+1"
    assert "'=1+1" in api.get("/leaderboard.csv?phase=dev").text
    again = api.get("/leaderboard?phase=dev")
    assert (again.content, again.headers["etag"]) == (board.content, board.headers["etag"])
