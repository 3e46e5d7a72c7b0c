"""The settings of a phase: what fits together, what may still change, and that it is audited."""

from datetime import timedelta
from typing import TYPE_CHECKING

import pytest
from tests.phases.life import PRIVATE_ONLY, PUBLIC_ONLY

from exceptiondrive_schemas.api.phase_settings import PhasePolicy

if TYPE_CHECKING:
    from tests.phases.life import Life

LATER = "2126-11-21T12:00:00Z"
LATER_STILL = "2126-12-21T12:00:00Z"


@pytest.mark.parametrize("time", ["2127-05-01T12:00:00", "2127-05-01", "2127-13-01T00:00:00Z"])
def test_a_time_without_a_zone_is_refused_in_words(life: "Life", time: str) -> None:
    life.make_phase(split="plain")
    answer = life.organize("/phases/test", {"closes_at": time}, "PATCH")
    words = "must be a time with its zone, such as 2026-11-21T12:00:00Z"
    assert (answer.status_code, answer.json()["fields"]) == (400, {"closes_at": words})


def test_every_setting_can_be_shown_in_a_form() -> None:
    for name, field in PhasePolicy.model_fields.items():
        assert field.title, name
        assert field.description, name
        assert field.description.endswith("."), name


def test_a_phase_shows_its_life(life: "Life") -> None:
    wanted = {"freezes_at": LATER, "entries_shown": "chosen", "anonymous": True}
    made = life.make_phase(split="plain", closes_at=LATER_STILL, policy=wanted)
    shown = life.json("/api/v1/phases/test")
    assert shown["policy"] == made["policy"]
    assert shown["policy"] | wanted == shown["policy"]
    assert shown["now"] == {
        "part": None,
        "n_counted": 5,
        "frozen_since": None,
        "families_shown_from": None,
        "is_anonymous": True,
        "takes_late_entries": False,
    }


def test_a_change_touches_what_is_sent_and_leaves_an_audit_line(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=LATER_STILL, policy={"freezes_at": LATER})
    changed = life.change({"quota_total": 7, "policy": {"late_entries": "own_view"}})
    assert changed["quota_total"] == 7
    assert changed["title"] == "Test"
    assert changed["policy"]["late_entries"] == "own_view"
    assert changed["policy"]["freezes_at"] == LATER
    line = life.json("/api/v1/organizer/audit?limit=1", "organizer")[0]
    assert (line["action"], line["subject"]) == ("phase changed", "test")
    assert line["detail"] == {"quota_total": [20, 7], "late_entries": ["refused", "own_view"]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"policy": {"freezes_at": LATER_STILL}}, "freezes_at must lie before closes_at"),
        (
            {"policy": {"freezes_at": "2001-01-01T00:00:00Z"}},
            "To freeze now, use the action freeze",
        ),
        ({"closes_at": None, "policy": {"late_entries": "own_view"}}, "set closes_at"),
        ({"closes_at": "2001-01-01T00:00:00Z"}, "would become late"),
        ({"opens_at": LATER_STILL}, "must close after it opens"),
    ],
)
def test_contradictions_are_named(life: "Life", change: dict[str, object], words: str) -> None:
    life.make_phase(split="plain", closes_at=LATER_STILL)
    before = life.json("/api/v1/phases/test")
    assert words in life.refused("/phases/test", change, 400, "PATCH")
    assert life.json("/api/v1/phases/test") == before


def test_what_is_wrong_with_a_new_phase_is_told_at_once(life: "Life") -> None:
    body = {"id": "Not an id", "title": "\0", "challenge": "planning", "split": "plain"}
    dates = {"opens_at": LATER_STILL, "closes_at": LATER}
    words = life.refused("/phases", {**body, **dates}, 400)
    assert "'Not an id' must be" in words
    assert "title" in words
    assert "must close after it opens" in words


@pytest.mark.parametrize("change", [{"anonymous": True}, {"entries_private": True}])
def test_what_teams_were_promised_does_not_change_under_them(
    life: "Life", change: dict[str, object]
) -> None:
    life.make_phase(split="plain")
    life.submit("alpha", 1.0, "Planner", "plain")
    words = life.refused("/phases/test", {"policy": change}, 409, "PATCH")
    assert "The phase has submissions" in words


def test_a_change_of_the_policy_keeps_the_board_and_every_pseudonym(life: "Life") -> None:
    life.make_phase(split="plain", policy={"anonymous": True})
    life.submit("alpha", 1.0, "Planner", "plain")
    life.work()
    before = life.board()
    life.change({"policy": {"entries_shown": "chosen"}})
    assert life.board() == before
    life.submit("beta", 2.0, "Planner", "plain")
    life.work()
    after = {row["submission_id"]: row["team"] for row in life.board()["entries"]}
    assert len(after) == 2
    assert [after[row["submission_id"]] for row in before["entries"]] == [
        row["team"] for row in before["entries"]
    ]


def test_after_a_freeze_beyond_the_deadline_other_settings_can_be_changed(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=LATER)
    life.move(closes_at=life.now() - timedelta(minutes=1))
    life.done("/phases/test/freeze", {"reason": "before the prizes"})
    assert life.change({"quota_total": 7})["quota_total"] == 7


def test_only_organizers_change_a_phase(life: "Life") -> None:
    life.make_phase(split="plain")
    for path in ("", "/freeze", "/reveal"):
        method = "POST" if path else "PATCH"
        address = f"/api/v1/organizer/phases/test{path}"
        assert life.request(method, address, "alpha", json={}).status_code == 403
        assert life.request(method, address, json={}).status_code == 401


def test_a_time_is_text_and_an_unknown_setting_an_error(life: "Life") -> None:
    life.make_phase(split="plain")
    for wrong in ({"freezes_at": 1900000000}, {"freezes_at": "soon"}, {"hides": True}):
        assert life.organize("/phases/test", {"policy": wrong}, "PATCH").status_code == 400


STANDS = {"entries_shown": "chosen", "run_choice": "team"}


def test_what_stands_is_settled_at_the_deadline(life: "Life") -> None:
    """Who knows the ranks would choose them; who has time to answer is told."""
    life.make_phase(split="plain", closes_at=life.ahead(60))
    life.submit("alpha", 1.0, "Planner", "plain")
    life.change({"policy": STANDS})
    life.move(closes_at=life.now())
    for key, words in (("entries_shown", "entries of a team stand"), ("run_choice", "run of a")):
        back = {"policy": {key: {"entries_shown": "all", "run_choice": "newest"}[key]}}
        refusal = life.refused("/phases/test", back, 409, "PATCH")
        assert refusal.startswith("What counts at the deadline is final: which ")
        assert words in refusal
        life.change({"policy": {key: STANDS[key], "late_entries": "own_view"}})
        life.change({"closes_at": life.ahead(60), **back})
        life.move(closes_at=life.now())


@pytest.mark.parametrize("is_taken_back", [False, True])
def test_what_stands_and_what_counts_is_settled_by_a_reveal(
    life: "Life", is_taken_back: bool
) -> None:
    """One of two files stands for its team: what the other is worth there, nobody learns."""
    life.make_phase(closes_at=life.ahead(60), policy={"entries_shown": "chosen"})
    life.submit("alpha", PRIVATE_ONLY)
    chosen = life.submit("alpha", PUBLIC_ONLY, "Other")
    life.work()
    life.change({"policy": {"revealed_part": "whole"}})
    life.change({"policy": {"revealed_part": "private"}})
    life.move(closes_at=life.now())
    run = life.reveal()
    life.apply(run)
    if is_taken_back:
        life.done(f"/rescoring/{run}/rollback", {"reason": "a mistake"})
        life.work()
    for change, words in (
        ({"entries_shown": "all"}, "entries of a team stand"),
        ({"run_choice": "team"}, "which run of a method stands"),
        ({"revealed_part": "whole"}, "which samples count after the reveal"),
    ):
        refusal = life.refused("/phases/test", {"policy": change}, 409, "PATCH")
        assert refusal.startswith("What was hidden has been revealed: ")
        assert words in refusal
    assert life.entry_ids() == [chosen]
