"""Reference rows and flags (docs/protocol.md section 5) stand on every kind of board."""

import csv
import io
import json
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.phases.browsing import HTML, visitor

from exceptiondrive_records.accounts.tokens import TEAM_SCOPES, issue_token
from exceptiondrive_records.teams.teams import create_team

if TYPE_CHECKING:
    from tests.phases.life import Life

STANDS_MPS, BLIND_MPS = 0.1, 4.0
"""Ends 0.3 m from the start; drives as before the edit."""
FLAGS = {"stands_still": "Stands still", "blind_to_the_edit": "Blind to the edit"}


@pytest.fixture
def watched(life: "Life") -> "Life":
    """The organizers' own planner submits as the team `freeze`."""
    with life.database.write() as session:
        team = create_team(session, "freeze", "References", is_reference=True, actor="test")
        life.tokens["freeze"] = issue_token(session, team.id, "t", TEAM_SCOPES, actor="test")[0]
    return life


SENT_BY = {"stands_still": "alpha", "blind_to_the_edit": "beta"}


def enter(life: "Life", split: str) -> dict[str, str]:
    """Enter the reference, one that stands still, one that does not react, and an honest one."""
    ids = {
        "reference": life.submit("freeze", 0.0, "STANDSTILL", split),
        "stands_still": life.submit("alpha", STANDS_MPS, "Sleeper", split),
        "blind_to_the_edit": life.submit("beta", BLIND_MPS, "Blind", split),
        "honest": life.submit("gamma", 1.5, "Honest", split),
    }
    life.work()
    return ids


def on_plain(life: "Life") -> tuple[dict[str, str], str]:
    life.make_phase(split="plain")
    return enter(life, "plain"), ""


def on_public_part(life: "Life") -> tuple[dict[str, str], str]:
    life.make_phase(split="parted")
    return enter(life, "parted"), ""


def on_frozen(life: "Life") -> tuple[dict[str, str], str]:
    life.make_phase(split="plain", policy={"frozen_scores": "hidden"})
    ids = enter(life, "plain")
    life.done("/phases/test/freeze")
    life.submit("gamma", STANDS_MPS, "Later", "plain")
    life.work()
    return ids, ""


def on_late_view(life: "Life") -> tuple[dict[str, str], str]:
    closing: dict[str, Any] = {"closes_at": life.ahead(60), "policy": {"late_entries": "own_view"}}
    life.make_phase(split="plain", **closing)
    early = life.submit("freeze", 0.0, "STANDSTILL", "plain")
    life.submit("gamma", 2.5, "Early", "plain")
    life.work()
    life.move(closes_at=life.now())
    ids = {
        "stands_still": life.submit("alpha", STANDS_MPS, "Sleeper", "plain"),
        "blind_to_the_edit": life.submit("beta", BLIND_MPS, "Blind", "plain"),
        "honest": life.submit("gamma", 1.5, "Honest", "plain"),
    }
    life.work()
    return {"reference": early, **ids}, "&view=late"


KINDS: dict[str, Callable[["Life"], tuple[dict[str, str], str]]] = {
    "plain": on_plain,
    "public part": on_public_part,
    "frozen": on_frozen,
    "late view": on_late_view,
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_board_of_planners_shows_references_and_flags(watched: "Life", kind: str) -> None:
    ids, query = KINDS[kind](watched)
    rows = {row["submission_id"]: row for row in watched.board(query)["entries"]}
    assert set(ids.values()) <= set(rows)
    reference = rows[ids["reference"]]
    assert (reference["source"], reference["rank"]) == ("reference", None)
    page = watched.get(f"/?phase=test{query}").text
    assert "STANDSTILL" in page
    text = watched.get(f"/export/board.csv?phase=test{query}").text
    in_file = {row["submission_id"]: row for row in csv.DictReader(io.StringIO(text))}
    for code, label in FLAGS.items():
        row = rows[ids[code]]
        assert code in [flag["code"] for flag in row["flags"]], "the flag is gone"
        assert row["rank"] is not None, "a flag is shown, and folded into nothing"
        assert label in page
        assert code in in_file[ids[code]]["flags"]
        assert label in watched.get(f"/entries/{ids[code]}").text
        (detail,) = [flag["detail"] for flag in row["flags"] if flag["code"] == code]
        own = visitor(watched, SENT_BY[code]).get(f"/submissions/{ids[code]}").text
        assert f'<p class="flagline"><b>{label}.</b> {detail}</p>' in own
    assert [flag["code"] for flag in rows[ids["honest"]]["flags"]] == []
    assert in_file[ids["reference"]]["source"] == "reference"


def answers(strategy: str, sent_by: str, **reminder: bool) -> bytes:
    """Return a file of one answer throughout, and of one record, where one is given."""
    predictions = [
        {"sample_id": key, "strategy": strategy, "reminder": reminder or None} for key in "abcde"
    ]
    head = {"schema": "exceptiondrive.strategy/1", "split": "plain"}
    return (json.dumps({**head, "predictions": predictions}) + " " * len(sent_by)).encode()


def test_a_board_of_strategies_sets_references_apart(watched: "Life") -> None:
    """Who always answers C is the reference that an agent has to beat; it takes no rank."""
    watched.make_phase(split="plain", challenge="strategy")
    ids = {}
    for who, strategy in (("freeze", "C"), ("alpha", "C"), ("beta", "A")):
        sent = watched.request(
            "POST",
            "/api/v1/submissions",
            who,
            data={"phase": "test", "method": f"Always {strategy}"},
            files={"file": ("agent.json", answers(strategy, who))},
        )
        assert sent.status_code == 202, sent.text
        ids[who] = sent.json()["id"]
    watched.work()
    rows = {row["submission_id"]: row for row in watched.board()["entries"]}
    assert (rows[ids["freeze"]]["source"], rows[ids["freeze"]]["rank"]) == ("reference", None)
    assert [rows[ids[who]]["rank"] for who in ("alpha", "beta")] == [1, 2]
    assert rows[ids["freeze"]]["metrics"] == rows[ids["alpha"]]["metrics"]
    assert "References" in watched.get("/?phase=test").text


def test_an_agent_with_a_reminder_is_linked_to_the_one_without_in_the_browser(
    watched: "Life",
) -> None:
    watched.make_phase(split="plain", challenge="strategy")
    alpha = visitor(watched, "alpha")
    assert 'name="linked_to"' not in alpha.get("/submit").text, "there is none to link"
    sent = {"phase": "test", "method": "Without"}
    files = {"file": ("agent.json", answers("A", "alpha"))}
    without = watched.request("POST", "/api/v1/submissions", "alpha", data=sent, files=files)
    watched.work()
    page = alpha.get("/submit").text
    option = (
        f'<option value="{without.json()["id"]}" data-phase="test"[^>]*>\\s*Without, Test</option>'
    )
    assert re.search(option, page)
    token = re.search(r'name="form_token" value="([0-9a-f]{64})"', page)
    assert token is not None
    fields = {"form_token": token[1], "phase": "test", "method": "With"}
    files = {"file": ("agent.json", answers("C", "alpha", hazard_present=True))}
    for linked_to, status in (("of-nobody", 404), (without.json()["id"], 303)):
        data = {**fields, "linked_to": linked_to}
        done = alpha.post("/submit", data=data, files=files, headers=HTML)
        assert done.status_code == status, done.text
    watched.work()
    rows = {row["method"]: row for row in watched.board()["entries"]}
    assert rows["With"]["reminder_effect"]["without_method"] == "Without"
    assert re.search(r"</a>, rank 1; <a [^>]*>Without</a>", alpha.get("/submit").text)
    page = alpha.get(f"/submissions/{rows['With']['submission_id']}").text
    link = f'<a href="/submissions/{without.json()["id"]}">{without.json()["id"]}</a>'
    assert f"Without the reminder it is {link}; by the reminder Accuracy +" in page
    lost = "What a reminder changed against it is then no longer shown."
    assert lost not in page, "nothing is linked to one with records"
    page = alpha.get(f"/submissions/{without.json()['id']}").text
    assert lost in page
