"""The worked example of docs/rescoring.md: a live phase moves from protocol 1.0 to 1.1 and back."""

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient
from tests.rescoring.application import (
    SITE,
    Organizer,
    Serve,
    Visitor,
    application_over,
    organizers_token,
)
from tests.support.floors import write_floors

from exceptiondrive_records.audit.log import audit_page
from exceptiondrive_records.notifications.channels import text_of
from exceptiondrive_records.notifications.inbox import list_notifications
from exceptiondrive_records.rescoring.changes import CURE_OF_FLOORS
from exceptiondrive_records.rescoring.views import board_history
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_worker.trial_run import try_next_split

Stage = Any
WHY = "flagged Stands still, Impossible motion and Hardly moves; protocol 1.1 ranks no such entry"
REASON = ("--reason", "a parked car is no planner")


@pytest.fixture
def parked(stage: Stage) -> Stage:
    """Three planners, and a team that stands still in every edited scene."""
    stage.submit(0.0, "Parked", "gamma")
    stage.work()
    return stage


def ranks(body: str | bytes) -> dict[str, int | None]:
    rows = json.loads(body)["entries"]
    return {row["method"]: row["rank"] for row in rows if row["submission_id"]}


def test_a_parked_car_leaves_rank_1_by_a_run_that_says_so(
    parked: Stage, serve: Serve, tmp_path: Path
) -> None:
    organizer = Organizer(*serve(parked), tmp_path)
    toml = tmp_path / "1.1.toml"
    toml.write_text(packaged_protocol_toml("1.1"))
    before = organizer.board()
    assert ranks(before) == {"Parked": 1, "slow": 1, "middle": 3, "fast": 4}

    told = organizer.say("protocols", "diff", str(toml), "--phase", "dev")
    assert "flags with which an entry is listed without a rank: none -> Stands still, " in told
    organizer.say("protocols", "add", str(toml))
    draft = ("--phase", "dev", "--protocol", "1.1", "--draft")
    run = organizer.rescore("start", *draft, *REASON)
    organizer.rescore("begin", run["id"], *REASON)
    parked.work()

    said = organizer.say("rescore", "preview", run["id"], "--csv", str(tmp_path / "new.csv"))
    words = " ".join(said.split())
    assert f"no longer ranked: Parked (Gamma): {WHY}" in words
    assert words.startswith("what readers would see change if it is applied: 1.0 -> 1.1, board ")
    assert "3 with a new rank, 0 newly ranked, 1 no longer ranked" in words
    assert "HCC %" in words, "as the board shows it"
    assert re.search(r"[1-9]\d\.\d\d -> [1-9]\d\.\d\d", words), words
    rows = {
        row["method"]: row
        for row in csv.DictReader((tmp_path / "new.csv").read_text().splitlines())
    }
    assert (rows["Parked"]["old_rank"], rows["Parked"]["new_rank"]) == ("1", "")
    assert rows["Parked"]["new_unranked_because"] == WHY
    assert rows["slow"]["new_unranked_because"] == ""
    preview = organizer.rescore("preview", run["id"])
    changes = {entry["method"]: entry for entry in preview["comparison"]["entries"]}
    assert preview["comparison"]["worst_movers"][0] == changes["Parked"]["submission_id"]
    assert changes["Parked"]["new"]["unranked_because"] == WHY
    assert changes["Parked"]["change"] == changes["middle"]["change"] == "rank_only"
    assert changes["Parked"]["old"]["metrics"] == changes["Parked"]["new"]["metrics"]
    assert organizer.board() == before

    organizer.rescore("apply", run["id"], "--preview", preview["digest"], *REASON)
    said = organizer.say("rescore", "preview", run["id"])
    assert said.startswith("it is applied; what readers would see change if it is rolled back:")
    after = organizer.board()
    assert ranks(after) == {"slow": 1, "middle": 2, "fast": 3, "Parked": None}
    assert list(ranks(after))[-1] == "Parked", "it stands below the ranked ones"
    organizer.rescore("rollback", run["id"], *REASON)
    assert organizer.board() == before


def test_pages_history_notices_and_audit_tell_it_in_words(parked: Stage) -> None:
    run_id = parked.ready(packaged_protocol_toml("1.1"))
    with TestClient(application_over(parked), base_url=SITE) as client:
        visitor = Visitor(client, organizers_token(parked))
        page = visitor.get(f"/organize/rescoring/{run_id}/preview").text
        assert "no longer ranked" in page
        assert WHY in page
        apply_page = visitor.get(
            f"/organize/rescoring/{run_id}/apply?preview={visitor.seen_digest(run_id)}"
        ).text
        assert f"Parked: not ranked: {WHY}" in apply_page
    parked.apply(run_id)
    with parked.database.read() as session:
        (notice,) = list_notifications(session, find_team(session, "gamma").id)
        assert f"now:    not ranked: {WHY}" in text_of(notice, "https://board.example")
        line = board_history(session, "dev")[0]
        assert any("listed without a rank: none -> Stands still" in w for w in line.what_changed)
        applied = [row for row in audit_page(session) if row.action == "rescoring applied"]
        assert list(applied[0].detail["no_longer_ranked"].values()) == [f"not ranked: {WHY}"]
    parked.rollback(run_id)
    with parked.database.read() as session:
        newest = list_notifications(session, find_team(session, "gamma").id)[0]
        assert f"before: not ranked: {WHY}" in text_of(newest, "https://board.example")


def test_a_run_that_the_floors_of_the_split_forbid_stays_a_draft(
    parked: Stage, serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    organizer = Organizer(*serve(parked), tmp_path)
    write_floors(parked.settings.splits_dir / "tiny", "max_protocols = 1")
    parked.add_protocol(packaged_protocol_toml("1.1"))

    def a_worker_tries(_: float) -> None:
        try_next_split(parked.context)

    clock = SimpleNamespace(sleep=a_worker_tries)
    monkeypatch.setattr("exceptiondrive.cli.organizer.rescoring.time", clock)
    start = ("rescore", "start", "--phase", "dev", "--protocol", "1.1", *REASON)
    organizer.refuse("The floors of the withheld split forbid it: it would be protocol", *start)
    (run,) = organizer.rescore("status")
    assert run["state"] == "draft"
    assert CURE_OF_FLOORS in run["blockers"][0]
    organizer.rescore("begin", run["id"], *REASON)
    (run,) = organizer.rescore("status")
    assert run["blockers"] == ["4 sheets of 4 are still missing."], (
        "what was said of the draft is over"
    )
