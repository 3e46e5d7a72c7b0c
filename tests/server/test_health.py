"""GET /healthz, /readyz, /metrics."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from fastapi import APIRouter
from sqlalchemy import text
from starlette.routing import Match
from starlette.types import Scope
from tests.later_release import become_later_release, write_as_later_release
from tests.support.databases import read_only

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.migrations import migrate
from exceptiondrive_records.submissions import file_store
from exceptiondrive_records.work.heartbeats import beat
from exceptiondrive_server.phases import api as phases

if TYPE_CHECKING:
    from tests.support.application import Api

MakeApi = Callable[..., "Api"]


def test_a_server_that_answers_is_alive(api: "Api") -> None:
    response = api.get("/healthz")
    assert (response.status_code, response.json()) == (200, {"status": "alive"})


@pytest.mark.parametrize(
    ("path", "is_api"), [("/healthz", False), ("/problems", False), ("/api/v1/phases", True)]
)
def test_whoever_asks_for_no_api_lets_none_of_its_routes_be_worked_out(
    make_api: MakeApi, database_url: str, monkeypatch: pytest.MonkeyPatch, path: str, is_api: bool
) -> None:
    """FastAPI does so for all routes of a router that it looks through, which takes a process 0.1 s."""
    asked = []

    def look(router: APIRouter, scope: Scope) -> tuple[Match, Scope]:
        asked.append(router)
        return look_as_before(router, scope)

    look_as_before = APIRouter.matches
    monkeypatch.setattr(APIRouter, "matches", look)
    assert make_api(database_url).client.get(path).status_code == 200
    assert (phases.router in asked) is is_api


def test_with_database_store_broker_and_worker_all_is_well(
    make_api: MakeApi, database_url: str, broker_url: str
) -> None:
    api = make_api(database_url, broker_url=broker_url)
    with api.database.write() as session:
        beat(session, "worker-1")
    response = api.get("/readyz")
    assert response.status_code == 200
    ready = response.json()
    assert all(ready[part] for part in ("is_ready", "database", "file_store", "broker"))
    assert (ready["live_workers"], ready["note"]) == (1, "")


def test_without_broker_and_worker_uploads_are_still_taken(api: "Api") -> None:
    response = api.get("/readyz")
    assert response.status_code == 200
    ready = response.json()
    assert ready["is_ready"]
    assert not ready["broker"]
    assert ready["live_workers"] == 0
    assert "delayed" in ready["note"]
    assert api.submit("a").status_code == 202


def test_without_the_database_it_is_not_ready_and_knows_of_no_worker(
    make_api: MakeApi, sqlite_url: str, broker_url: str, tmp_path: Path
) -> None:
    api = make_api(sqlite_url, broker_url=broker_url)
    break_database(api, tmp_path)
    response = api.get("/readyz")
    assert response.status_code == 503
    ready = response.json()
    assert (ready["is_ready"], ready["database"], ready["live_workers"]) == (False, False, None)
    assert "the records are away" in ready["note"]
    assert "Scoring" not in ready["note"]


def test_without_the_file_store_it_is_not_ready(
    make_api: MakeApi, sqlite_url: str, tmp_path: Path
) -> None:
    api = make_api(sqlite_url)
    break_store(tmp_path)
    response = api.get("/readyz")
    assert response.status_code == 503
    assert (response.json()["database"], response.json()["file_store"]) == (True, False)
    assert "the file store is away, full" in response.json()["note"]


def test_a_store_without_room_is_not_ready(
    make_api: MakeApi, sqlite_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    api = make_api(sqlite_url)
    monkeypatch.setattr(file_store, "LEAST_FREE_BYTES", 1 << 62)
    response = api.get("/readyz")
    assert response.status_code == 503
    assert (response.json()["database"], response.json()["file_store"]) == (True, False)
    refused = api.submit("a")
    assert refused.status_code == 503
    assert int(refused.headers["retry-after"]) > 0
    assert "no room" in refused.json()["detail"]
    assert list(api.services.files.stored()) == []


def test_an_empty_folder_of_a_server_with_uploads_takes_no_more(
    make_api: MakeApi,
    sqlite_url: str,
    tmp_path: Path,
    as_problem: Callable[[Any, int, str], dict[str, Any]],
    logs: list[Any],
) -> None:
    """So looks one on which nothing is mounted: what came now would lie under the mount."""
    api = make_api(sqlite_url)
    assert api.submit("a").status_code == 202, "a new server's folder is empty, too"
    (tmp_path / "uploads").rename(tmp_path / "away")
    (tmp_path / "uploads").mkdir()
    assert (api.get("/readyz").status_code, api.get("/readyz").json()["file_store"]) == (503, False)
    assert "\nexceptiondrive_ready 0.0\n" in api.get("/metrics").text
    as_problem(api.submit("b"), 503, "store_unavailable")
    assert (
        "the file store is away" in next(one for one in logs if one["event"] == "not ready")["note"]
    )
    (line,) = [line for line in logs if line["event"] == "file store unavailable"]
    assert (line["log_level"], line["reason"]) == (
        "warning",
        "The file store does not answer; try again later.",
    )
    assert list((tmp_path / "uploads").iterdir()) == []
    (tmp_path / "uploads").rmdir()
    (tmp_path / "away").rename(tmp_path / "uploads")
    assert api.get("/readyz").status_code == 200
    assert "\nexceptiondrive_ready 1.0\n" in api.get("/metrics").text
    assert api.submit("b").status_code == 202


def test_an_older_schema_is_not_ready_and_a_newer_one_is(
    api_on_both: "Api", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as upgraded:
        become_later_release(upgraded, tmp_path)
        response = api_on_both.get("/readyz")
        assert (response.status_code, response.json()["database"]) == (503, False)
        migrate(api_on_both.database.engine.url.render_as_string(hide_password=False))
    response = api_on_both.get("/readyz")
    assert (response.status_code, response.json()["database"]) == (200, True)


def test_an_older_server_goes_on_with_documents_of_a_newer_one(
    api: "Api", make_entry: Callable[..., Any]
) -> None:
    """They say more than it knows, while both run and after the older images are back."""
    own = api.submit("a", facts='{"map": "none"}').json()["id"]
    api.score(own)
    api.publish(make_entry("Planner", submission_id=own))
    links = {"paper_url": "https://example.org/p"}
    assert api.request("PATCH", "/organizer/site", "organizer", json=links).is_success
    note = {"words": "Look at it."}
    assert api.post(f"/organizer/submissions/{own}/note", "organizer", json=note).is_success
    assert write_as_later_release(api.database) >= {
        "boards.body",
        "board_flips.news",
        "notifications.body",
        "phases.policy",
        "score_sheets.sheet",
        "site_settings.value",
        "submissions.facts",
    }
    reads = ("/phases", "/leaderboard?phase=dev", f"/submissions/{own}", "/notifications", "/site")
    assert [api.get(path, "alpha").status_code for path in reads] == [200] * len(reads)
    assert api.submit("b").status_code == 202


def test_records_in_a_closed_folder_take_no_writes(tmp_path: Path) -> None:
    """A connection that is open still reads them; whether rows can be added is no error."""
    closed = tmp_path / "closed"
    closed.mkdir()
    url = f"sqlite:///{closed / 'records.db'}"
    Database(url).engine.connect().close()
    closed.chmod(0)
    done = subprocess.run(
        [sys.executable, "-c", _AS_SOMEBODY_ELSE, url], capture_output=True, text=True, check=False
    )
    closed.chmod(0o700)
    assert done.stdout == "False\n", done.stderr


_AS_SOMEBODY_ELSE = """
import os, sys
from exceptiondrive_records.db.database import Database
database = Database(sys.argv[1])
if os.geteuid() == 0:
    os.setgroups([]); os.setgid(10001); os.setuid(10001)
print(database.takes_writes())
"""


def test_records_that_are_read_only_are_not_ready(api_on_both: "Api") -> None:
    """Reads go on, and every upload would be refused."""
    with read_only(api_on_both.database):
        api_on_both.services.database.engine.dispose()
        response = api_on_both.get("/readyz")
        assert (response.status_code, response.json()["database"]) == (503, False)
        assert api_on_both.get("/phases").status_code == 200
    api_on_both.services.database.engine.dispose()
    assert api_on_both.get("/readyz").status_code == 200


def test_without_the_database_every_answer_is_503_and_says_when_to_come_back(
    api: "Api", as_problem: Callable[[Any, int, str], dict[str, Any]], tmp_path: Path
) -> None:
    break_database(api, tmp_path)
    for response in (api.get("/phases"), api.get("/leaderboard"), api.get("/me", "alpha")):
        as_problem(response, 503, "store_unavailable")
        assert int(response.headers["retry-after"]) > 0
    assert "sqlite" not in api.get("/phases").text.lower()


@pytest.mark.postgres
@pytest.mark.parametrize("database_url", ["postgres"], indirect=True)
def test_a_right_that_is_missing_is_said_in_the_log_alone(
    make_api: MakeApi,
    database_url: str,
    as_problem: Callable[[Any, int, str], dict[str, Any]],
    logs: list[Any],
) -> None:
    api = make_api(database_url)
    with api.database.write() as session:
        session.execute(text(f"REVOKE ALL ON phases FROM {Role.API}"))
    answer = api.get("/phases")
    as_problem(answer, 500, "internal")
    assert "permission" not in answer.text
    (line,) = [line for line in logs if line["event"] == "database error"]
    assert line["reason"].startswith("permission denied for table phases; its owner gives")
    assert not line["is_outage"]  # the server asked for more than its role may: a bug or an attack


def test_without_the_file_store_an_upload_is_503_and_costs_no_quota(
    api: "Api", as_problem: Callable[[Any, int, str], dict[str, Any]], tmp_path: Path
) -> None:
    break_store(tmp_path)
    response = api.submit("a")
    as_problem(response, 503, "store_unavailable")
    assert int(response.headers["retry-after"]) > 0
    assert api.get("/phases/dev", "alpha").json()["quota"]["used_today"] == 0


def test_metrics_tell_queue_submissions_workers_and_requests(api_on_both: "Api") -> None:
    api_on_both.submit("a")
    own = api_on_both.submit("b").json()["id"]
    api_on_both.score(own)
    with api_on_both.database.write() as session:
        beat(session, "worker-1")
    api_on_both.get(f"/entries/{own}")
    api_on_both.request("BREW", "/coffee")
    response = api_on_both.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain; version=0.0.4")
    lines = dict(
        line.rsplit(" ", 1) for line in response.text.splitlines() if not line.startswith("#")
    )
    assert lines['exceptiondrive_jobs{lane="live",state="queued"}'] == "1.0"
    assert lines['exceptiondrive_jobs{lane="rescore",state="failed"}'] == "0.0", "before any fails"
    assert lines["exceptiondrive_last_backup_timestamp_seconds"] == "0.0"
    assert 'exceptiondrive_oldest_queued_seconds{lane="rescore"}' not in lines
    assert lines['exceptiondrive_submissions{status="scored"}'] == "1.0"
    assert 0 <= float(lines['exceptiondrive_oldest_queued_seconds{lane="live"}']) < 600
    assert 0 <= float(lines['exceptiondrive_worker_heartbeat_age_seconds{worker="worker-1"}']) < 600
    assert 0 <= float(lines["exceptiondrive_scoring_seconds"]) < 600
    assert lines['exceptiondrive_boards_wanted{phase="dev"}'] in ("0.0", "1.0")
    name = "exceptiondrive_request_seconds_count"
    route = "/api/v1/entries/{submission_id}"
    assert lines[f'{name}{{method="GET",route="{route}",status="404"}}'] == "1.0"
    assert lines[f'{name}{{method="other",route="unmatched",status="404"}}'] == "1.0"
    assert own not in response.text


def break_database(api: "Api", tmp_path: Path) -> None:
    """Put a folder where the database was."""
    api.database.dispose()
    for path in tmp_path.glob("records.sqlite3*"):
        path.unlink()
    (tmp_path / "records.sqlite3").mkdir()


def break_store(tmp_path: Path) -> None:
    """Put a file where the folder of uploads was."""
    folder = tmp_path / "uploads"
    folder.rmdir()
    folder.write_text("not a folder")
