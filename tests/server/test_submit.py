"""POST /submissions."""

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from sqlalchemy import func, select, update
from starlette.datastructures import FormData
from tests.support.documents import digest_of

from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.operations.dump import file_digests
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_server.submissions import upload
from exceptiondrive_server.web.forms import REASON, read_form

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]


def count(api: "Api", table: type) -> int:
    with api.database.read() as session:
        return session.scalar(select(func.count()).select_from(table)) or 0


def stored(api: "Api") -> set[str]:
    return {file.digest for file in api.services.files.stored()}


def mentioned(api: "Api") -> set[str]:
    with api.database.read() as session:
        return set(file_digests(session))


def test_an_upload_is_accepted_kept_and_shown(api_on_both: "Api") -> None:
    response = api_on_both.submit(
        b'{"any": "bytes"}',
        method=" Kestrel 2 ",
        description="Two\nlines.",
        paper_url="https://example.org/paper",
    )
    assert response.status_code == 202, response.text
    view = SubmissionView.model_validate_json(response.content)
    assert view.status == "received"
    assert view.method == "Kestrel 2"
    assert view.description == "Two\nlines."
    assert view.links.paper == "https://example.org/paper"
    assert view.links.code is None
    assert view.file_digest == digest_of(b'{"any": "bytes"}')
    assert view.size_bytes == 16
    assert view.queue is not None
    assert view.queue.workers_alive == 0
    assert response.headers["location"] == f"/api/v1/submissions/{view.id}"
    assert response.headers["cache-control"] == "no-store"
    stored = api_on_both.services.files.read(view.file_digest, limit_bytes=100)
    assert stored == b'{"any": "bytes"}'


def test_a_text_is_as_long_as_browsers_count_it(api: "Api", as_problem: Problem) -> None:
    text = "One line.\r\n" * 200 + "x"  # as a text area of 2,000 characters sends it
    longest = text.removesuffix("\r\nx")
    taken = api.submit("a", description=longest).json()["description"]
    assert taken == longest.replace("\r\n", "\n")
    as_problem(api.submit("b", description=text), 400, "bad_request")


def test_a_reason_is_as_long_as_browsers_count_it() -> None:
    lines = "\r\n".join(["a word"] * 143)  # 1,000 characters in a browser
    plain = lines.replace("\r\n", "\n")
    assert read_form([REASON], FormData([("reason", lines)])) == {"reason": plain}
    with pytest.raises(InvalidRecord, match="Reason"):
        read_form([REASON], FormData([("reason", f"{lines}x")]))


def test_the_answer_tells_what_is_left_of_the_quota(api: "Api") -> None:
    headers = api.submit("a").headers
    assert headers["ratelimit-limit"] == "5"
    assert headers["ratelimit-remaining"] == "4"
    assert 0 < int(headers["ratelimit-reset"]) <= 86_400


def test_the_same_bytes_give_the_first_submission_and_cost_nothing(api_on_both: "Api") -> None:
    first = api_on_both.submit("a", method="One").json()
    again = api_on_both.submit("a", method="One")
    assert again.status_code == 200
    assert again.json()["id"] == first["id"]
    assert again.json()["is_duplicate"] is True
    assert again.json()["method"] == "One"
    assert again.headers["ratelimit-remaining"] == "4"
    assert count(api_on_both, Job) == 1


def test_another_teams_same_bytes_are_another_submission(api: "Api") -> None:
    ids = {api.submit("a", who).json()["id"] for who in ("alpha", "beta")}
    assert len(ids) == 2


async def post_all(api: "Api", contents: list[str]) -> list[int]:
    transport = httpx.ASGITransport(app=api.app)

    async def post(content: str) -> int:
        response = await client.post(
            "/api/v1/submissions",
            headers=api.headers("alpha"),
            data={"phase": "dev", "method": "Planner"},
            files={"file": ("p.json", content.encode())},
        )
        return response.status_code

    async with httpx.AsyncClient(transport=transport, base_url="http://t", timeout=60) as client:
        return list(await asyncio.gather(*(post(content) for content in contents)))


@pytest.mark.row("I19")
async def test_30_parallel_posts_at_quota_5_give_exactly_5(api_on_both: "Api") -> None:
    statuses = await post_all(api_on_both, [f"file {number}" for number in range(30)])
    assert sorted(statuses) == [202] * 5 + [429] * 25
    assert count(api_on_both, Submission) == 5
    assert stored(api_on_both) == mentioned(api_on_both), "what was refused is gone"


@pytest.mark.row("I18")
async def test_20_parallel_copies_are_one_submission(api_on_both: "Api") -> None:
    statuses = await post_all(api_on_both, ["the same"] * 20)
    assert sorted(statuses) == [200] * 19 + [202]
    assert count(api_on_both, Submission) == 1


def test_a_spent_quota_says_when_it_begins_anew(api: "Api", as_problem: Problem) -> None:
    for number in range(5):
        assert api.submit(f"file {number}").status_code == 202
    response = api.submit("one more")
    problem = as_problem(response, 429, "quota_exceeded")
    resets_at = datetime.fromisoformat(problem["resets_at"])
    now = datetime.now(UTC)
    assert resets_at.time() == datetime.min.time()
    assert timedelta(0) < resets_at - now <= timedelta(days=1)
    wait_s = int(response.headers["retry-after"])
    assert wait_s == problem["retry_after_s"] == int(response.headers["ratelimit-reset"])
    assert abs(wait_s - (resets_at - now).total_seconds()) < 60
    assert response.headers["ratelimit-remaining"] == "0"


def test_a_spent_total_quota_never_begins_anew(api: "Api", as_problem: Problem) -> None:
    api.phase("twice", quota_total=2)
    assert as_told(api.submit("a", phase="twice")) == {"limit": "2", "remaining": "1"}
    assert api.submit("b", phase="twice").status_code == 202
    response = api.submit("c", phase="twice")
    problem = as_problem(response, 429, "quota_exceeded")
    assert "resets_at" not in problem
    assert "retry-after" not in response.headers
    for answer in (response, api.get("/phases/twice", "alpha"), api.submit("a", phase="twice")):
        assert as_told(answer) == {"limit": "2", "remaining": "0"}, "no day resets it"


def as_told(answer: httpx.Response) -> dict[str, str]:
    """The headers of what may still be submitted."""
    return {
        name.removeprefix("ratelimit-"): value
        for name, value in answer.headers.items()
        if name.startswith("ratelimit-")
    }


def test_rejected_files_cost_no_quota_but_are_capped(api: "Api", as_problem: Problem) -> None:
    api.phase("strict", quota_per_day=5, rejected_per_day=1)
    taken = api.submit("a", phase="strict").json()
    report = CheckReport(
        challenge=None, split=None, n_predictions=None, digest=taken["file_digest"], size_bytes=1
    )
    api.reject(taken["id"], report)
    quota = api.get("/phases/strict", "alpha").json()["quota"]
    assert (quota["used_today"], quota["rejected_today"]) == (0, 1)
    refused = api.submit("b", phase="strict")
    assert "resets_at" in as_problem(refused, 429, "rejected_cap_exceeded")
    assert as_told(refused) == {}, "they count submissions, not files that were rejected"


@pytest.mark.parametrize("which", ["opens_at", "closes_at"])
def test_a_closed_phase_takes_nothing(api: "Api", as_problem: Problem, which: str) -> None:
    now = datetime.now(UTC)
    dates = {"opens_at": now + timedelta(days=1), "closes_at": now - timedelta(days=1)}
    api.phase("shut", **{which: dates[which]})
    problem = as_problem(api.submit("a", phase="shut"), 403, "phase_closed")
    assert "UTC" in problem["detail"]


@pytest.mark.parametrize("refused", ["closed", "spent", "not approved", "link"])
def test_of_a_refused_upload_no_byte_is_stored(
    api: "Api", monkeypatch: pytest.MonkeyPatch, refused: str
) -> None:
    """Known before it is stored; else a team could fill the disk with what nobody takes."""
    phase, fields = "dev", {}
    if refused == "closed":
        api.phase("shut", closes_at=datetime.now(UTC) - timedelta(days=1))
        phase = "shut"
    elif refused == "spent":
        api.phase("once", quota_total=1)
        api.submit("a", phase="once")
        phase = "once"
    elif refused == "not approved":
        with api.database.write() as session:
            session.get_one(Team, api.team_ids["alpha"]).pending_since = database_now(session)
    else:
        fields = {"linked_to": "nothing"}
    before = stored(api)

    def store(*_: object, **__: object) -> None:
        raise AssertionError("it was stored")

    monkeypatch.setattr(FileStore, "put_stream", store)
    assert api.submit("refused", phase=phase, **fields).status_code in (400, 403, 429)
    assert stored(api) == before


def test_what_is_refused_in_the_transaction_is_deleted_unless_somebody_else_sent_it(
    api: "Api", monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two uploads of a team at once: both are acceptable before they are stored, one is after."""
    api.phase("once", quota_total=1)
    monkeypatch.setattr(upload, "require_acceptable", lambda *_, **__: None)
    assert api.submit("a", "beta").status_code == 202
    assert api.submit("first", phase="once").status_code == 202
    for content in ("second", "a"):
        assert api.submit(content, phase="once").status_code == 429
    assert stored(api) == mentioned(api)
    assert len(stored(api)) == 2


def test_an_unknown_phase_is_404_and_nothing_is_stored(
    api: "Api", as_problem: Problem, tmp_path: Path
) -> None:
    as_problem(api.submit("a", phase="nowhere"), 404, "not_found")
    assert not any(path.is_file() for path in (tmp_path / "uploads").rglob("*"))


def test_an_empty_file_is_refused(api: "Api", as_problem: Problem) -> None:
    as_problem(api.submit(b""), 400, "upload_empty")
    assert count(api, Submission) == 0


@pytest.mark.parametrize("missing", ["phase", "method"])
def test_a_missing_field_is_named(api: "Api", as_problem: Problem, missing: str) -> None:
    problem = as_problem(api.submit("a", **{missing: None}), 400, "bad_request")
    assert list(problem["fields"]) == [missing]


def test_a_missing_file_is_named(api: "Api", as_problem: Problem) -> None:
    response = api.post(
        "/submissions", "alpha", files={"phase": (None, "dev"), "method": (None, "M")}
    )
    assert list(as_problem(response, 400, "bad_request")["fields"]) == ["file"]


def test_a_file_without_a_filename_is_told_so(api: "Api", as_problem: Problem) -> None:
    fields = {"phase": (None, "dev"), "method": (None, "Planner")}

    def sent(data: str) -> dict[str, Any]:
        answer = api.post("/submissions", "alpha", files={**fields, "file": (None, data)})
        return as_problem(answer, 400, "bad_request")

    assert sent("{}")["fields"] == {"file": "Send the file in this field, with a filename."}
    assert "without a filename" in sent("x" * 20_000)["detail"]
    form = api.app.openapi()["paths"]["/api/v1/submissions"]["post"]["requestBody"]["content"]
    told = form["multipart/form-data"]["schema"]["properties"]["file"]["description"]
    assert "filename" in told


def test_an_empty_name_is_refused_in_our_words(api: "Api", as_problem: Problem) -> None:
    problem = as_problem(api.submit("a", method=""), 400, "bad_request")
    assert problem["fields"] == {"method": "must not be empty"}


def test_a_misspelt_field_is_refused_and_not_repeated(api: "Api", as_problem: Problem) -> None:
    response = api.submit("a", **{"paper-secret": "x"})
    problem = as_problem(response, 400, "bad_request")
    assert "(unknown field)" in problem["fields"]
    assert "paper-secret" not in response.text


def test_a_repeated_field_is_refused(api: "Api", as_problem: Problem) -> None:
    as_problem(api.submit("a", method=["One", "Two"]), 400, "bad_request")


def test_two_files_are_refused(api: "Api", as_problem: Problem) -> None:
    files = [("file", ("a", b"a")), ("file", ("b", b"b"))]
    form = {"phase": "dev", "method": "M"}
    response = api.post("/submissions", "alpha", data=form, files=files)
    as_problem(response, 400, "bad_request")


@pytest.mark.parametrize(
    "method",
    [
        "",
        "   ",
        "x" * 81,
        "two\nlines",
        "nul\x00",
        "zero\u200bwidth",
        "turned\u202eround",
        "\ud800",
    ],
)
def test_a_method_name_that_cannot_be_shown_is_refused(
    api_on_both: "Api", as_problem: Problem, method: str
) -> None:
    name = method.encode("utf-8", "surrogatepass")
    files = [("file", ("a", b"a")), ("phase", (None, b"dev")), ("method", (None, name))]
    response = api_on_both.post("/submissions", "alpha", files=files)
    as_problem(response, 400, "bad_request")
    assert count(api_on_both, Submission) == 0


def test_a_method_name_is_kept_in_one_unicode_form(api: "Api") -> None:
    decomposed = "Mo\u0308ller"
    assert api.submit("a", method=decomposed).json()["method"] == "M\u00f6ller"


@pytest.mark.parametrize(
    "link",
    [
        "http://example.org",
        "javascript:alert(1)",
        "https://",
        "https://user:secret@example.org",
        "https://example.org/<script>",
        "https://example.org/\nx",
        "https://example.org/" + "x" * 500,
    ],
)
def test_a_link_must_be_plain_https(api: "Api", as_problem: Problem, link: str) -> None:
    as_problem(api.submit("a", code_url=link), 400, "bad_request")


def test_a_charset_that_makes_lone_surrogates_is_refused(api: "Api", as_problem: Problem) -> None:
    body = (
        b'--x\r\nContent-Disposition: form-data; name="phase"\r\n\r\n\\ud800\r\n'
        b'--x\r\nContent-Disposition: form-data; name="method"\r\n\r\n\\ud800\r\n'
        b'--x\r\nContent-Disposition: form-data; name="file"; filename="a"\r\n\r\na\r\n--x--\r\n'
    )
    kind = "multipart/form-data; boundary=x; charset=raw_unicode_escape"
    response = api.post("/submissions", "alpha", content=body, headers={"Content-Type": kind})
    as_problem(response, 400, "bad_request")


def test_the_name_of_the_file_means_nothing(api: "Api", tmp_path: Path) -> None:
    files = {"file": ("../../../../tmp/evil\x00.json", b"a")}
    form = {"phase": "dev", "method": "M"}
    response = api.post("/submissions", "alpha", data=form, files=files)
    assert response.status_code == 202
    assert "evil" not in response.text
    names = [path.name for path in (tmp_path / "uploads").rglob("*") if path.is_file()]
    assert names == [response.json()["file_digest"].removeprefix("sha256:")]


def test_without_a_token_it_is_401(api: "Api", as_problem: Problem) -> None:
    response = api.submit("a", None)
    as_problem(response, 401, "not_signed_in")
    assert response.headers["www-authenticate"].startswith("Bearer")


def test_an_organizer_without_a_team_cannot_submit(api: "Api", as_problem: Problem) -> None:
    as_problem(api.submit("a", "organizer"), 403, "not_allowed")


def test_get_on_a_withdrawal_is_405(api: "Api", as_problem: Problem) -> None:
    taken = api.submit("a").json()
    response = api.get(f"/submissions/{taken['id']}/withdraw", "alpha")
    as_problem(response, 405, "method_not_allowed")
    assert response.headers["allow"] == "POST"


def test_put_on_upload_is_405(api: "Api", as_problem: Problem) -> None:
    as_problem(api.request("PUT", "/submissions", "alpha"), 405, "method_not_allowed")


def test_a_token_that_is_revoked_while_its_upload_is_in_the_air_brings_nothing_in(
    api_on_both: "Api", monkeypatch: pytest.MonkeyPatch, as_problem: Problem
) -> None:
    """An upload may take a quarter of an hour; whoever stole the token has until then."""
    api, put = api_on_both, FileStore.put_stream
    before = stored(api)

    def revoked_meanwhile(*arguments: Any, **options: Any) -> Any:
        with api.database.write() as session:
            mine = update(Token).where(Token.team_id == api.team_ids["alpha"])
            session.execute(mine.values(revoked_at=database_now(session)))
        return put(*arguments, **options)

    monkeypatch.setattr(FileStore, "put_stream", revoked_meanwhile)
    refused = as_problem(api.submit("a"), 403, "not_allowed")
    assert "ended meanwhile" in refused["detail"]
    assert (count(api, Submission), stored(api)) == (0, before)
