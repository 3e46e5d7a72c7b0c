"""The SDK against set answers: retries, errors, waiting. The real server: test_with_server.py."""

import gzip
import json
import socket
import ssl
import threading
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from typer.testing import CliRunner

import exceptiondrive.client
from exceptiondrive import (
    Client,
    ExceptionDriveError,
    InvalidArgumentError,
    InvalidFileError,
    NetworkError,
    NotAllowedError,
    NotFoundError,
    NotSignedInError,
    QuotaError,
    ScoringFailedError,
    ServerError,
    Submission,
    WaitTimeoutError,
)
from exceptiondrive.checking import manifest_of
from exceptiondrive.cli import app
from exceptiondrive.cli.tables import outlook_view
from exceptiondrive.client import TeamTokens
from exceptiondrive.inputs import given_split
from exceptiondrive.organizer import Organizer
from exceptiondrive.transport import MAX_ANSWER_BYTES, upload_body
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.python310 import UTC

if TYPE_CHECKING:
    from tests.client.servers import CannedServer

ME = {"team": "alpha", "token_name": "ci", "scopes": ["submit"], "expires_at": None}
VIEW: dict[str, Any] = {
    "id": "abc",
    "phase": "dev",
    "challenge": "planning",
    "team": "alpha",
    "method": "Planner",
    "description": "",
    "links": {},
    "file_digest": "sha256:00",
    "size_bytes": 10,
    "status": "queued",
    "received_at": "2026-11-21T00:00:00Z",
    "status_at": "2026-11-21T00:00:00Z",
}
PHASE: dict[str, Any] = {
    "id": "dev",
    "challenge": "planning",
    "title": "Development",
    "description": "",
    "split": "tiny",
    "split_revision": "sha256:00",
    "split_is_public": True,
    "n_samples": 4,
    "protocol": "1.0",
    "protocol_digest": packaged_protocol().digest,
    "opens_at": None,
    "closes_at": None,
    "is_open": True,
    "quota_per_day": 3,
    "quota_total": None,
    "max_upload_bytes": 1_000_000,
    "quota": {
        "per_day": 3,
        "used_today": 0,
        "remaining_today": 3,
        "total": None,
        "used_total": 0,
        "resets_at": "2026-11-22T00:00:00Z",
        "rejected_per_day": 10,
        "rejected_today": 0,
    },
}


@pytest.fixture
def phase_dev(canned_server: "CannedServer", split_file: Path) -> "CannedServer":
    manifest = manifest_of(given_split(split_file), packaged_protocol())
    canned_server.answer("GET /phases/dev", 200, PHASE)
    canned_server.answer(
        "GET /phases/dev/manifest", 200, manifest.model_dump(mode="json", by_alias=True)
    )
    return canned_server


def test_the_entry_that_an_upload_replaces_is_found_behind_a_hundred_newer_submissions(
    phase_dev: "CannedServer", planning_file: Callable[..., Path]
) -> None:
    newer = [{**VIEW, "id": f"new{number}", "method": "Other"} for number in range(100)]
    stands = {**VIEW, "id": "old", "status": "scored"}
    phase_dev.answer("GET /submissions", 200, {"submissions": newer, "next": "new99"})
    phase_dev.answer("GET /submissions", 200, {"submissions": [stands], "next": None})
    with Client(phase_dev.url, "edk_t_1") as client:
        with pytest.raises(InvalidArgumentError, match="It replaces old "):
            client.submit(planning_file(), phase="dev", method="Planner")
        assert client.submissions(limit=None)[-1].id == "old"
    assert not [path for method, path, _ in phase_dev.requests if method == "POST"]


def test_a_withdrawal_says_what_stands_again_behind_a_hundred_newer_submissions(
    canned_server: "CannedServer",
) -> None:
    newer = [{**VIEW, "id": f"new{number}"} for number in range(100)]
    gone, before = {**VIEW, "status": "withdrawn"}, {**VIEW, "id": "old", "status": "scored"}
    canned_server.answer("GET /submissions/abc", 200, {**VIEW, "status": "scored"})
    canned_server.answer("GET /submissions", 200, {"submissions": newer, "next": "new99"})
    canned_server.answer(
        "GET /submissions", 200, {"submissions": [{**before, "replaced_by": "abc"}], "next": None}
    )
    canned_server.answer("POST /submissions/abc/withdraw", 200, gone)
    canned_server.answer("GET /submissions/old", 200, before)
    done = CliRunner().invoke(app, ["withdraw", "abc", "--yes", "--server", canned_server.url])
    assert "the next board shows old " in done.stdout


def test_an_upload_that_went_well_is_0_though_the_quota_cannot_be_asked_for_afterwards(
    phase_dev: "CannedServer", planning_file: Callable[..., Path]
) -> None:
    phase_dev.problem("GET /phases/dev", 500, "internal")
    phase_dev.answer("GET /submissions", 200, {"submissions": [{**VIEW, "method": "Other"}]})
    phase_dev.answer("POST /submissions", 202, VIEW)
    said = ("--phase", "dev", "--method", "Planner", "--server", phase_dev.url)
    done = CliRunner().invoke(app, ["submit", str(planning_file()), *said])
    assert phase_dev.requests[-1][:2] == ("GET", "/api/v1/phases/dev")
    assert (done.exit_code, "error" in done.stderr) == (0, False)
    assert "abc" in done.stdout


@pytest.mark.parametrize("token", ["edk_t_1", "edk_t_1\n", " edk_t_1\r\n"])
def test_the_token_travels_as_a_bearer(canned_server: "CannedServer", token: str) -> None:
    canned_server.answer("GET /me", 200, ME)
    with Client(canned_server.url, token) as client:
        assert client.me().team == "alpha"
    headers = {name.lower(): value for name, value in canned_server.headers[0].items()}
    assert headers["authorization"] == "Bearer edk_t_1"
    assert headers["user-agent"].startswith("exceptiondrive/")


@pytest.mark.parametrize("token", ["edk_t_\u00fc", "edk_t\n1", "edk_t\x001"])
def test_what_has_signs_that_no_token_has_is_refused_and_not_repeated(token: str) -> None:
    with pytest.raises(InvalidArgumentError, match="This is no token") as refused:
        Client("http://127.0.0.1:9", token)
    assert token not in str(refused.value)


def test_a_server_that_is_busy_for_a_moment_is_asked_again(canned_server: "CannedServer") -> None:
    canned_server.answer("GET /me", 503, b"", {"retry-after": "0"})
    canned_server.problem("GET /me", 429, "too_many_requests", retry_after_s=0)
    canned_server.answer("GET /me", 200, ME)
    with Client(canned_server.url) as client:
        assert client.me().team == "alpha"
    assert len(canned_server.requests) == 3


def test_what_would_be_made_twice_is_sent_once(canned_server: "CannedServer") -> None:
    canned_server.answer("POST /phases/dev/questions", 503, b"", {"retry-after": "0"})
    with Client(canned_server.url) as client, pytest.raises(ServerError, match="answered 503"):
        client.ask("When does it end?", "dev")
    assert len(canned_server.requests) == 1


def test_a_long_retry_after_is_not_sat_out(canned_server: "CannedServer") -> None:
    body = {
        "type": "/problems/store_unavailable",
        "title": "x",
        "status": 503,
        "code": "store_unavailable",
        "detail": "The database is being moved.",
    }
    canned_server.answer("GET /me", 503, body, {"retry-after": "3600"})
    with Client(canned_server.url) as client, pytest.raises(ServerError, match="being moved"):
        client.me()
    assert len(canned_server.requests) == 1


@pytest.mark.parametrize(
    ("status", "code", "kind", "exit_code"),
    [
        (400, "bad_request", InvalidArgumentError, 2),
        (401, "not_signed_in", NotSignedInError, 4),
        (403, "not_allowed", NotAllowedError, 4),
        (404, "not_found", NotFoundError, 2),
        (409, "conflict", NotAllowedError, 4),
        (403, "phase_closed", NotAllowedError, 4),
        (413, "upload_too_large", InvalidArgumentError, 2),
        (429, "quota_exceeded", QuotaError, 3),
        (429, "rejected_cap_exceeded", QuotaError, 3),
        (500, "internal", ServerError, 5),
    ],
)
def test_every_problem_is_an_error_of_its_kind(
    canned_server: "CannedServer",
    status: int,
    code: str,
    kind: type[ExceptionDriveError],
    exit_code: int,
) -> None:
    canned_server.problem("GET /me", status, code, fields={"method": "too long"})
    with Client(canned_server.url) as client, pytest.raises(kind) as caught:
        client.me()
    assert (caught.value.code, caught.value.exit_code) == (code, exit_code)
    assert caught.value.sentence.startswith(f"The server says {code}.")
    assert len(canned_server.requests) == 1, "none of these is asked again"


def test_wrong_fields_are_named(canned_server: "CannedServer") -> None:
    canned_server.problem("GET /me", 422, "bad_request", fields={"method": "too long"})
    with Client(canned_server.url) as client, pytest.raises(InvalidArgumentError) as caught:
        client.me()
    assert "method: too long" in caught.value.sentence
    assert caught.value.document()["fields"] == {"method": "too long"}


def test_a_quota_of_one_is_told_as_one(
    canned_server: "CannedServer", split_file: Path, planning_file: Callable[..., Path]
) -> None:
    manifest = manifest_of(given_split(split_file), packaged_protocol())
    quota: dict[str, Any] = {
        "per_day": 1,
        "used_today": 1,
        "remaining_today": 0,
        "total": None,
        "used_total": 1,
    }
    quota |= {"resets_at": "2026-11-22T00:00:00Z", "rejected_per_day": 9, "rejected_today": 0}
    canned_server.answer("GET /phases/dev", 200, {**PHASE, "quota": quota})
    canned_server.answer("GET /phases/dev/manifest", 200, manifest.model_dump(by_alias=True))
    canned_server.answer("GET /submissions", 200, {"submissions": []})
    with Client(canned_server.url) as client:
        with pytest.raises(QuotaError, match="its 1 submission "):
            client.submit(planning_file(), phase="dev", method="Planner")
        outlook = client.outlook(planning_file(), phase="dev", method="Planner")
    used = "Your team has used its 1 submission of today. The count resets at 2026-11-22 00:00 UTC."
    assert list(outlook_view(outlook)) == [f"outlook: it will be refused now. {used}"]
    assert outlook.to_confirm == {}


def test_a_spent_quota_says_when_it_resets(canned_server: "CannedServer") -> None:
    """As the records say, whatever the clocks of server and client: they tell of a wait alone."""
    resets_at = "2026-11-22T00:00:00Z"
    canned_server.problem("GET /me", 429, "quota_exceeded", retry_after_s=1, resets_at=resets_at)
    with Client(canned_server.url) as client, pytest.raises(QuotaError) as caught:
        client.me()
    assert caught.value.resets_at == datetime(2026, 11, 22, tzinfo=UTC)
    assert "The count resets at 2026-11-22 00:00 UTC." in caught.value.advice


def test_a_text_of_another_locale_is_refused_with_a_cure_and_a_name_of_a_file_is_sent(
    canned_server: "CannedServer",
) -> None:
    """With LANG=C and without the UTF-8 mode, Python gives what is not ASCII as lone surrogates."""
    with Client(canned_server.url) as client, pytest.raises(InvalidArgumentError) as caught:
        client.ask("Wie sp\udcc3\udca4t?", "dev")
    assert "set PYTHONUTF8=1" in caught.value.advice
    name, *_ = upload_body("pl\udcc3\udca4n.json", b"", {}, "key")()["files"]["file"]
    assert name == "pl??n.json"


@pytest.mark.parametrize(
    ("status", "kind"),
    [(409, NotAllowedError), (404, NotFoundError), (422, InvalidArgumentError), (500, ServerError)],
)
def test_what_a_newer_server_says_with_a_code_of_its_own_is_told(
    canned_server: "CannedServer", status: int, kind: type[ExceptionDriveError]
) -> None:
    canned_server.problem("GET /me", status, "teams_asleep", detail="Your team sleeps.")
    with Client(canned_server.url) as client, pytest.raises(kind) as caught:
        client.me()
    assert (caught.value.code, caught.value.sentence) == ("teams_asleep", "Your team sleeps.")
    assert "/client/" in caught.value.advice


@pytest.mark.parametrize("status", [301, 302, 307, 308])
def test_an_answer_that_leads_elsewhere_says_where_and_is_not_followed(
    canned_server: "CannedServer", status: int
) -> None:
    there = {"location": "https://board.example.org/api/v1/me?state=secret"}
    canned_server.answer("GET /me", status, b"", there)
    with Client(canned_server.url, "edk_t_1") as client, pytest.raises(ServerError) as caught:
        client.me()
    assert "which leads to https://board.example.org/api/v1/me;" in caught.value.sentence
    assert "--server" in caught.value.advice
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("wait_s", "told"),
    [("45", "in 45 s,"), ("181", "in 4 minutes,"), ("9" * 400, " minutes,"), ("", "Wait a little")],
)
@pytest.mark.parametrize(
    ("status", "code"), [(429, "too_many_requests"), (503, "store_unavailable")]
)
@pytest.mark.parametrize("by_a_proxy", [False, True])
def test_who_has_to_wait_longer_than_the_client_does_is_told_how_long(
    canned_server: "CannedServer", wait_s: str, told: str, status: int, code: str, by_a_proxy: bool
) -> None:
    headers = {"retry-after": wait_s} if wait_s else {}
    document = {"type": code, "title": code, "status": status, "code": code, "detail": "No."}
    canned_server.answer("GET /me", status, b"<html>" if by_a_proxy else document, headers)
    with Client(canned_server.url, attempts=1) as client, pytest.raises(NetworkError) as caught:
        client.me()
    assert told in caught.value.advice
    assert caught.value.code == code


def test_an_answer_of_a_year_that_no_clock_has_is_read(canned_server: "CannedServer") -> None:
    date = {"date": "Mon, 30 Nov 2026 10:00:00 +9999999999999999"}
    canned_server.problem("GET /me", 401, "not_signed_in")
    canned_server.answers["GET /me"][0][1].update(date)
    with Client(canned_server.url) as client, pytest.raises(NotSignedInError):
        client.me()


@pytest.mark.parametrize("body", [b"<html>proxy</html>", b'{"detail": "no"}'])
def test_an_answer_of_something_else_is_not_taken_for_ours(
    canned_server: "CannedServer", body: bytes
) -> None:
    canned_server.answer("GET /me", 418, body)
    with Client(canned_server.url) as client, pytest.raises(ServerError, match="answered 418"):
        client.me()


@pytest.mark.parametrize(
    ("status", "kind", "code", "sentence", "tries"),
    [
        (413, InvalidArgumentError, "upload_too_large", "takes no file so large", 1),
        (429, NetworkError, "too_many_requests", "wants fewer requests", 2),
        (502, ServerError, "store_unavailable", "no server behind this address answers", 2),
        (503, ServerError, "store_unavailable", "no server behind this address answers", 2),
        (504, ServerError, "store_unavailable", "no server behind this address answers", 2),
    ],
)
def test_the_bare_page_of_a_proxy_is_understood(
    canned_server: "CannedServer",
    status: int,
    kind: type[ExceptionDriveError],
    code: str,
    sentence: str,
    tries: int,
) -> None:
    from exceptiondrive.transport import Transport

    page = b"<html><head><title>502 Bad Gateway</title></head></html>"
    canned_server.answer("GET /me", status, page, {"retry-after": "0"})
    transport = Transport(canned_server.url, None, attempts=2)
    with pytest.raises(kind, match=sentence) as caught:
        transport.get("/me")
    transport.close()
    assert (type(caught.value), caught.value.code) == (kind, code)
    assert caught.value.advice
    assert len(canned_server.requests) == tries


def test_a_form_that_is_not_known_asks_for_a_newer_client(canned_server: "CannedServer") -> None:
    canned_server.answer("GET /me", 200, {**ME, "scopes": {"submit": True}})
    with Client(canned_server.url) as client, pytest.raises(ServerError) as caught:
        client.me()
    assert "/client/" in caught.value.advice


def test_an_address_where_nobody_listens_is_a_network_error() -> None:
    from exceptiondrive.transport import Transport

    transport = Transport("http://127.0.0.1:9", None, attempts=2)
    with pytest.raises(NetworkError, match="cannot be reached"):
        transport.get("/me")
    transport.close()


def test_a_server_that_hangs_up_is_told_in_one_sentence() -> None:
    """As while it is restarted in the middle of an upload."""
    from exceptiondrive.transport import Transport

    with socket.create_server(("127.0.0.1", 0)) as listening:
        transport = Transport(f"http://127.0.0.1:{listening.getsockname()[1]}", None, attempts=1)
        hang_up = threading.Thread(target=lambda: listening.accept()[0].close())
        hang_up.start()
        with pytest.raises(NetworkError, match="cannot be reached: ") as caught:
            transport.get("/me")
        hang_up.join()
        transport.close()
    assert caught.value.sentence.count(". ") == 0
    assert ".." not in str(caught.value)


def test_names_cannot_leave_their_place_in_the_path(canned_server: "CannedServer") -> None:
    with Client(canned_server.url) as client, pytest.raises(ServerError):
        client.status("../me?x=1")
    assert canned_server.requests[0][1] == "/api/v1/submissions/..%2Fme%3Fx%3D1"


def test_a_file_with_faults_is_never_sent(
    phase_dev: "CannedServer", planning_file: Callable[..., Path]
) -> None:
    with Client(phase_dev.url) as client, pytest.raises(InvalidFileError):
        client.submit(planning_file(split="other"), phase="dev", method="Planner")
    assert [method for method, *_ in phase_dev.requests] == ["GET", "GET"]


def test_a_refusal_speaks_of_scopes_only_where_one_is_missing(
    canned_server: "CannedServer",
) -> None:
    """A disqualified team, or one that owes its consent to terms, needs no other token."""
    canned_server.problem("GET /me", 403, "not_allowed")
    with Client(canned_server.url) as client, pytest.raises(NotAllowedError) as caught:
        client.me()
    assert "scope" not in f"{caught.value.sentence} {caught.value.advice}"


def test_an_upload_that_is_sent_again_is_whole_again(
    phase_dev: "CannedServer", planning_file: Callable[..., Path]
) -> None:
    path = planning_file()
    phase_dev.problem("GET /submissions", 403, "not_allowed")  # a token that may only submit
    phase_dev.answer("POST /submissions", 503, b"", {"retry-after": "0"})
    phase_dev.answer("POST /submissions", 202, VIEW)
    seen: list[tuple[int, int]] = []
    with Client(phase_dev.url) as client:
        submission = client.submit(
            path,
            phase="dev",
            method="Planner",
            paper="https://example.org/paper",
            replace=True,  # what it replaces cannot be told
            on_progress=lambda sent, total: seen.append((sent, total)),
        )
    bodies = [body for method, _, body in phase_dev.requests if method == "POST"]
    assert len(bodies) == 2
    assert all(
        path.read_bytes() in body and b"https://example.org/paper" in body for body in bodies
    )
    assert all(b"code_url" not in body for body in bodies), "empty fields are left out"
    size = path.stat().st_size
    assert seen[-1] == (size, size)
    assert isinstance(submission, Submission)
    assert submission.id == "abc"


def test_a_closed_client_is_an_error_of_this_package(canned_server: "CannedServer") -> None:
    client = Client(canned_server.url)
    client.close()
    with pytest.raises(InvalidArgumentError, match="This client was closed"):
        client.phases()


def test_a_download_tells_how_much_of_it_has_come(
    canned_server: "CannedServer", split_file: Path
) -> None:
    canned_server.answer("GET /splits/tiny", 200, json.loads(split_file.read_bytes()))
    told: list[tuple[int, int]] = []
    with Client(canned_server.url) as client:
        client.split("tiny", on_progress=lambda *done: told.append(done))
    come, size = told[-1]
    assert come == size == len(json.dumps(json.loads(split_file.read_bytes())))
    assert [first for first, _ in told] == sorted(first for first, _ in told)


@pytest.mark.parametrize("status", [200, 404])
def test_an_answer_that_unpacks_without_end_is_given_up(
    canned_server: "CannedServer", status: int
) -> None:
    packed = gzip.compress(b" " * (MAX_ANSWER_BYTES + 1), 1)
    assert len(packed) < 2_000_000
    canned_server.answer("GET /phases", status, packed, {"content-encoding": "gzip"})
    with Client(canned_server.url) as client, pytest.raises(ServerError, match="256,000,000 bytes"):
        client.phases()
    assert len(canned_server.requests) == 1


def test_submissions_of_a_phase_that_is_not_there_name_the_phases(
    canned_server: "CannedServer",
) -> None:
    canned_server.answer("GET /submissions", 200, {"submissions": [], "next": None})
    canned_server.problem("GET /phases/dvev", 404, "not_found")
    canned_server.answer("GET /phases", 200, [PHASE])
    with Client(canned_server.url) as client, pytest.raises(NotFoundError) as caught:
        client.submissions(phase="dvev")
    assert "Did you mean 'dev'?" in caught.value.advice


def test_submissions_are_read_page_by_page(canned_server: "CannedServer") -> None:
    canned_server.answer("GET /submissions", 200, {"submissions": [VIEW, VIEW], "next": "abc"})
    canned_server.answer("GET /submissions", 200, {"submissions": [VIEW], "next": None})
    with Client(canned_server.url) as client:
        assert len(client.submissions(phase="dev")) == 3
    assert "after=abc" in canned_server.requests[1][1]
    assert "after" not in canned_server.requests[0][1]


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exceptiondrive.client, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(exceptiondrive.client, "WAIT_FOR_RANK_S", 0.05)


def followed(canned_server: "CannedServer") -> Submission:
    return Submission(
        Client(canned_server.url), SubmissionView.model_validate_json(json.dumps(VIEW))
    )


@pytest.mark.usefixtures("impatient")
def test_waiting_follows_every_change_until_the_rank(canned_server: "CannedServer") -> None:
    queue = {"position": 2, "expected_wait_s": 3.0, "attempts": 0, "workers_alive": 1}
    for change in (
        {"queue": queue},
        {"status": "scoring"},
        {"status": "scored", "awaits_board": True},
        {"status": "scored", "rank": 3},
    ):
        canned_server.answer("GET /submissions/abc", 200, {**VIEW, **change})
    submission = followed(canned_server)
    seen: list[str] = []
    view = submission.wait(on_change=lambda view: seen.append(view.status.value))
    assert view.rank == 3
    assert seen == ["queued", "scoring", "scored", "scored"]


@pytest.mark.usefixtures("impatient")
def test_an_outage_while_the_rank_is_waited_for_is_waited_out(
    canned_server: "CannedServer",
) -> None:
    scored = {**VIEW, "status": "scored"}
    canned_server.answer("GET /submissions/abc", 200, {**scored, "awaits_board": True})
    canned_server.answer("GET /submissions/abc", 500, b"no problem document")
    canned_server.answer("GET /submissions/abc", 200, {**scored, "rank": 3})
    assert followed(canned_server).wait().rank == 3


def test_an_outage_that_ends_the_wait_names_the_submission_that_is_safe(
    canned_server: "CannedServer",
) -> None:
    canned_server.answer("GET /submissions/abc", 500, b"no problem document")
    with pytest.raises(NetworkError) as caught:
        list(followed(canned_server).waiting())
    assert (
        caught.value.advice == "Submission abc is safe; look later with: exceptiondrive status abc"
    )


def test_a_token_that_ends_while_waiting_leaves_the_submission_safe(
    canned_server: "CannedServer",
) -> None:
    canned_server.problem("GET /submissions/abc", 401, "not_signed_in")
    with pytest.raises(NotSignedInError, match="not_signed_in") as caught:
        list(followed(canned_server).waiting())
    assert (
        caught.value.advice == "Submission abc is safe; look later with: exceptiondrive status abc"
    )


@pytest.mark.usefixtures("impatient")
def test_a_damaged_answer_is_asked_for_again(canned_server: "CannedServer") -> None:
    packed = {"content-encoding": "gzip"}
    canned_server.answer("GET /submissions/abc", 200, b"no gzip", packed)
    canned_server.answer("GET /submissions/abc", 200, {**VIEW, "status": "scored", "rank": 3})
    assert followed(canned_server).refresh().rank == 3
    canned_server.answer("GET /submissions/ab", 200, b"no gzip", packed)
    with Client(canned_server.url, attempts=1) as client, pytest.raises(NetworkError):
        client.status("ab")


@pytest.mark.usefixtures("impatient")
def test_a_wait_that_ends_while_the_server_is_away_says_that_nothing_is_known(
    canned_server: "CannedServer",
) -> None:
    canned_server.answer("GET /submissions/abc", 500, b"no problem document")
    with pytest.raises(WaitTimeoutError, match="not known: the server is away"):
        for _ in followed(canned_server).waiting(timeout_s=0.5):
            pass


def test_a_submission_that_is_not_there_leads_to_those_that_are(
    canned_server: "CannedServer",
) -> None:
    detail = "There is no submission 'abc'."
    canned_server.problem("GET /submissions/abc", 404, "not_found", detail=detail)
    with pytest.raises(NotFoundError) as caught:
        Client(canned_server.url).status("abc")
    assert caught.value.advice == "`exceptiondrive submissions` lists what there is."


@pytest.mark.usefixtures("impatient")
def test_a_rejected_file_ends_the_wait_with_its_report(canned_server: "CannedServer") -> None:
    report = {
        "challenge": "planning",
        "split": "tiny",
        "n_predictions": 4,
        "digest": "sha256:00",
        "size_bytes": 10,
        "faults": [
            {
                "code": "wrong_frame",
                "message": "Wrong frame.",
                "count": 1,
                "examples": [{"path": "$", "expected": "x forward", "got": "x right"}],
            }
        ],
    }
    rejected = {**VIEW, "status": "rejected", "report": report}
    canned_server.answer("GET /submissions/abc", 200, rejected)
    with pytest.raises(InvalidFileError) as caught:
        followed(canned_server).wait()
    assert caught.value.report.faults[0].code == "wrong_frame"


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"status": "failed", "failure": {"code": "x", "message": "No memory."}}, "No memory"),
        ({"status": "failed"}, "no reason was given"),
        ({"status": "withdrawn"}, "was withdrawn"),
    ],
)
def test_what_will_get_no_score_ends_the_wait(
    canned_server: "CannedServer", change: dict[str, Any], message: str
) -> None:
    canned_server.answer("GET /submissions/abc", 200, {**VIEW, **change})
    with pytest.raises(ScoringFailedError, match=message) as caught:
        followed(canned_server).wait()
    assert caught.value.exit_code == 6


@pytest.mark.usefixtures("impatient")
def test_a_wait_ends_in_time_and_says_that_the_submission_is_safe(
    canned_server: "CannedServer",
) -> None:
    canned_server.answer("GET /submissions/abc", 200, VIEW)
    with pytest.raises(WaitTimeoutError, match=r"within 0\.05 s") as caught:
        followed(canned_server).wait(timeout_s=0.05)
    assert "exceptiondrive status abc" in caught.value.advice
    assert caught.value.submission.id == "abc"


@pytest.mark.parametrize("answer", [b"<html>a page of a proxy</html>", b'["of another form"]'])
def test_an_answer_in_another_form_is_said_by_every_reader(
    canned_server: "CannedServer", answer: bytes
) -> None:
    for path in ("GET /me", "GET /phases", "GET /tokens", "GET /phases/dev", "POST /tokens"):
        canned_server.answer(path, 200, answer)
    tokens = TeamTokens(canned_server.url, "edk_t_1")
    readers: list[Callable[[], object]] = [
        Client(canned_server.url).me,
        Client(canned_server.url).phases,
        tokens.all,
        lambda: tokens.create("ci"),
        lambda: Organizer(canned_server.url).phase("dev"),
    ]
    for read in readers:
        with pytest.raises(ServerError, match="in a form that this client does not know") as caught:
            read()
        assert caught.value.code == "unexpected_answer"


def test_a_page_that_asks_to_sign_in_is_no_answer_of_a_server(
    canned_server: "CannedServer",
) -> None:
    page, kind = (
        b"<html>Sign in to the network</html>",
        {"content-type": "text/html; charset=utf-8"},
    )
    canned_server.answer("GET /me", 200, page, kind)
    with Client(canned_server.url) as client:
        with pytest.raises(ServerError, match="answered 200, and not in the form") as caught:
            client.me()
        assert "asks to sign in" in caught.value.advice


def test_who_speaks_in_the_clear_trusts_no_certificate_at_all() -> None:
    """Those of all are read for an https server alone; nobody is trusted by mistake meanwhile."""
    from exceptiondrive.transport import trusts_nobody

    context = trusts_nobody()
    assert context.verify_mode is ssl.CERT_REQUIRED
    assert context.check_hostname
    assert not context.get_ca_certs()


def test_a_request_waits_as_long_as_the_client_is_told_to(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(httpx, "Client", lambda **given: seen.append(given.get("timeout")))
    Client("http://a.example", timeout_s=7)
    assert seen == [httpx.Timeout(7)]


@pytest.mark.parametrize(
    ("server", "is_clear"), [("http://a.example", True), ("https://a.example", False)]
)
def test_an_https_server_is_asked_for_a_certificate_that_is_known(
    server: str, is_clear: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    from exceptiondrive.transport import Transport

    seen = []
    monkeypatch.setattr(httpx, "Client", lambda **given: seen.append(given["verify"]))
    Transport(server, None)
    assert [trust is True for trust in seen] == [not is_clear]
