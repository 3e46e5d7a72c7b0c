"""The final report of a phase: each claim is found again on its published boards."""

from typing import TYPE_CHECKING, Any

import pytest
from tests.phases.life import CAREFUL, PRIVATE_ONLY, PUBLIC_ONLY
from tests.phases.test_page import text_of
from tests.support.worker import due_jobs, score_submission

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.boards import flip_board, latest_board
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.phases import lock_phase
from exceptiondrive_records.phases.scoring_keys import key_of_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.phases.life import Life

REPORT, PAGE = "/api/v1/phases/test/report", "/phases/test/report"


def boards_of(life: "Life") -> list[Any]:
    """Every board that readers saw, oldest first, at its permanent address."""
    lines = life.json("/api/v1/boards?phase=test")
    return [life.json(line["address"]) for line in reversed(lines)]


def ranks(board: Any) -> dict[str, int]:
    return {e["submission_id"]: e["rank"] for e in board["entries"] if e["rank"] is not None}


def test_a_report_comes_with_the_end_and_tells_what_the_boards_tell(life: "Life") -> None:
    life.make_phase(closes_at=life.ahead(60))
    ids = [life.submit("alpha", PUBLIC_ONLY), life.submit("beta", PRIVATE_ONLY)]
    life.work()
    ids.append(life.submit("gamma", CAREFUL))
    life.work()
    assert life.get(REPORT).status_code == life.get(PAGE).status_code == 404
    assert "How it ended" not in life.get("/phases/test").text
    life.move(closes_at=life.now())
    assert life.json(REPORT)["shake_up"] is None
    assert "Only the public part of the split counts." in life.get(PAGE).text
    last_public = life.json(REPORT)["board"]
    life.apply(life.reveal())

    report, boards = life.json(REPORT), boards_of(life)
    final = boards[-1]
    assert (report["board"], report["n_samples"], report["part"]) == (final["board"], 3, "private")
    served = life.get(f"/api/v1/boards/test/{final['board']}").content
    assert report["board_digest"] == bytes_digest(served), "a draft is published when it is shown"
    by_id = {entry["submission_id"]: entry for entry in final["entries"]}
    assert report["n_boards"] == len({board["board"] for board in boards})
    assert f'<a href="/history?phase=test">{report["n_boards"]} boards</a>' in life.get(PAGE).text
    assert report["n_submissions"] == len({i for board in boards for i in ranks(board)}) == 3
    assert report["n_teams"] == len({by_id[key]["team"] for key in ids}) == 3
    assert report["protocols"] == sorted({board["protocol"]["version"] for board in boards})
    for winner in report["winners"]:
        assert winner == by_id[winner["submission_id"]]
    may_lead = {
        key
        for key, entry in by_id.items()
        if entry["rank_interval"] and entry["rank_interval"][0] == 1
    }
    assert set(report["may_be_first"]) <= may_lead

    shake_up = report["shake_up"]
    before = next(board for board in boards if board["board"] == shake_up["board"])
    assert (before["board"], before["part"]) == (last_public, "public")
    told = {one["submission_id"]: (one["before"], one["after"]) for one in shake_up["places"]}
    assert told == {key: (ranks(before)[key], ranks(final)[key]) for key in ids}
    assert told[ids[0]][0] < told[ids[0]][1], "good on the public part alone"

    page = life.get(PAGE).text
    words = text_of(page)
    assert f"board {final['board']}" in words
    assert "</a> ," not in page
    assert "3 teams" in words
    assert "by another run" not in words, "each is the same"
    assert "No more ranked" not in words, "each is"
    assert f'href="/?phase=test&amp;board={before["board"]}#board"' in page
    assert f"{told[ids[0]][1] - told[ids[0]][0]} down" in words
    for winner in report["winners"]:
        assert f"{winner['metrics']['hcc'] * 100:.2f}" in words
    assert 'href="/phases/test/report"' in life.get("/phases/test").text
    heading = "Ranks before and after the reveal"  # what came between may be a rescoring, too
    assert f">{heading}</h2>" in life.get(PAGE).text


@pytest.mark.parametrize("gone", [{"into": "alpha"}, None])
def test_the_later_deadline_of_a_team_that_is_no_more_keeps_no_report_back(
    life: "Life", gone: dict[str, str] | None
) -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60))
    life.submit("beta", 1.0, "Early", "plain")
    life.work()
    until = {"closes_at": life.ahead(90), "reason": "ill"}
    life.done("/teams/gamma/allowances/test", until, "PATCH")
    life.move(closes_at=life.now())
    assert life.get(REPORT).status_code == 404, "gamma is not done"
    life.done(f"/teams/gamma/{'merge' if gone else 'forget'}", {"reason": "asked", **(gone or {})})
    assert life.get(REPORT).status_code == 200


def submit_before_and_after_a_freeze(life: "Life") -> tuple[str, str]:
    """Return an entry of the frozen board, and a better file that came after it and waits for its score."""
    life.make_phase(split="plain", closes_at=life.ahead(60))
    early = life.submit("alpha", 1.0, "Early", "plain")
    life.work()
    life.done("/phases/test/freeze")
    return early, life.submit("beta", 0.5, "Behind the freeze", "plain")


def test_a_freeze_and_a_team_with_a_later_deadline_keep_the_report_back(life: "Life") -> None:
    early, late = submit_before_and_after_a_freeze(life)
    life.work()
    allowance = "/teams/gamma/allowances/test"
    life.done(allowance, {"closes_at": life.ahead(90), "reason": "ill"}, "PATCH")
    life.move(closes_at=life.now())
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    assert life.get(REPORT).status_code == 404, "gamma is not done"
    life.done(allowance, {"closes_at": None, "reason": "it is well again"}, "PATCH")
    shake_up = life.json(REPORT)["shake_up"]
    assert {one["submission_id"]: one["before"] for one in shake_up["places"]} == {
        early: 1,
        late: None,
    }
    words = text_of(life.get(PAGE).text)
    assert "ranked anew" in words
    assert "No more ranked" not in words, "each of the frozen board is"
    life.done("/phases/test/freeze")
    assert life.get(REPORT).status_code == 404
    life.done("/phases/test/reveal", {"what": "board", "reason": "frozen by mistake"})
    assert life.json(REPORT)["shake_up"] == shake_up, "the first reveal counts"


def test_a_freeze_that_hid_nothing_is_no_reveal(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60))
    for speed in (1.0, 0.5):
        life.submit("alpha", speed, f"At {speed}", "plain")
        life.work()
    life.move(closes_at=life.now())
    life.done("/phases/test/freeze")
    life.done("/phases/test/reveal", {"what": "board", "reason": "frozen by mistake"})
    assert life.json(REPORT)["shake_up"] is None
    with life.database.write() as session:
        add_protocol(session, packaged_protocol_toml("1.1"), "test")
    life.apply(life.start_run(protocol="1.1"))
    assert life.json(REPORT)["shake_up"] is None, "an update is no reveal"


def test_a_freeze_that_ends_before_its_newest_scores_stand_on_a_board_is_a_reveal(
    life: "Life",
) -> None:
    early, late = submit_before_and_after_a_freeze(life)
    life.move(closes_at=life.now())
    for job_id in due_jobs(life.database):
        score_submission(life.context, job_id)
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    life.work()
    places = life.json(REPORT)["shake_up"]["places"]
    assert {one["submission_id"]: one["before"] for one in places} == {early: 1, late: None}


def test_a_reveal_of_a_version_that_named_no_board_in_the_audit_log_is_told(life: "Life") -> None:
    early, late = submit_before_and_after_a_freeze(life)
    life.work()
    life.move(closes_at=life.now())
    with life.database.write() as session:
        phase = lock_phase(session, "test")
        phase.unfrozen_at = database_now(session)
        row = latest_board(session, phase.id, key_of_phase(phase))
        assert row is not None
        flip_board(session, phase, row)
        audit(session, "test", "freeze ended", phase.id, {"reason": "the end"})
    places = life.json(REPORT)["shake_up"]["places"]
    assert {one["submission_id"]: one["before"] for one in places} == {early: 1, late: None}


def test_a_reveal_that_ended_a_freeze_and_was_rolled_back_is_told_as_its_end(life: "Life") -> None:
    life.make_phase(closes_at=life.ahead(60))
    early = life.submit("alpha", 1.0, "Early")
    life.work()
    frozen = life.board()["board"]
    life.done("/phases/test/freeze")
    late = life.submit("beta", 0.5, "Behind the freeze")
    life.work()
    life.move(closes_at=life.now())
    run = life.reveal()
    life.apply(run)
    life.done(f"/rescoring/{run}/rollback", {"reason": "a mistake"})
    for _ in range(2):
        shake_up = life.json(REPORT)["shake_up"]
        assert (shake_up["board"], shake_up["part"]) == (frozen, "public")
        before = {one["submission_id"]: one["before"] for one in shake_up["places"]}
        assert before == {early: 1, late: None}
        life.done("/phases/test/freeze")
        life.done("/phases/test/reveal", {"what": "board", "reason": "frozen by mistake"})


def test_a_new_run_during_a_freeze_is_told_as_the_same_method(life: "Life") -> None:
    """Also where the board before has pseudonyms, which the boards of a freeze keep with their names."""
    life.make_phase(split="plain", closes_at=life.ahead(60), policy={"anonymous": True})
    early = {
        who: life.submit(who, speed, "One", "plain")
        for who, speed in (("alpha", 1.0), ("beta", 2.0))
    }
    life.work()
    frozen = {entry["submission_id"]: entry["team"] for entry in life.board()["entries"]}
    life.done("/phases/test/freeze")
    later = life.submit("beta", 0.5, "One", "plain")
    life.move(closes_at=life.now())
    life.done("/phases/test/reveal", {"what": "names", "reason": "the end"})
    life.work()
    assert {entry["submission_id"]: entry["team"] for entry in life.board()["entries"]} == frozen
    words = "Teams and methods stand under pseudonyms until the organizers show names."
    assert words in life.get("/?phase=test").text
    assert words in text_of(life.get("/phases/test").text)
    assert life.json(f"/api/v1/submissions/{later}", "beta")["known_as"] == frozen[early["beta"]]
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    life.work()
    assert words not in life.get("/?phase=test").text + text_of(life.get("/phases/test").text)
    assert life.json(f"/api/v1/submissions/{later}", "beta")["known_as"] is None
    places = life.json(REPORT)["shake_up"]["places"]
    assert {one["submission_id"]: (one["team"], one["is_another_run"]) for one in places} == {
        early["alpha"]: ("Alpha Institute", False),
        later: ("Beta Labs", True),
    }
    assert None not in [rank for one in places for rank in (one["before"], one["after"])]
    assert "by another run" in text_of(life.get(PAGE).text)


def test_a_freeze_that_ended_before_the_deadline_is_no_reveal(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60))
    life.submit("alpha", 1.0, "Early", "plain")
    life.work()
    life.done("/phases/test/freeze")
    life.done("/phases/test/reveal", {"what": "board", "reason": "by mistake"})
    life.submit("beta", 0.5, "Later", "plain")
    life.work()
    life.move(closes_at=life.now())
    assert life.json(REPORT)["shake_up"] is None
    assert "before and after the reveal" not in life.get(PAGE).text


def test_the_report_says_of_what_lost_its_rank_that_it_is_ranked_no_more(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60))
    life.submit("alpha", 1.0, "Stays", "plain")
    gone = life.submit("beta", 0.5, "Goes", "plain")
    life.work()
    life.done("/phases/test/freeze")
    life.done(f"/submissions/{gone}/disqualify", {"reason": "it used the map"})
    life.work()
    told = str(life.json("/api/v1/notifications", "beta"))
    assert gone in life.entry_ids()
    assert "a frozen board goes on showing it until it is revealed" in told
    life.move(closes_at=life.now())
    life.done("/phases/test/reveal", {"what": "board", "reason": "the end"})
    life.work()
    (place,) = (p for p in life.json(REPORT)["shake_up"]["places"] if p["submission_id"] == gone)
    assert place["after"] is None
    words = text_of(life.get(PAGE).text)
    assert "no more ranked" in words
    assert "replaced, withdrawn, disqualified or listed without a rank" in words
    assert "ranked anew" not in words, "nothing is"


def test_the_report_waits_for_what_came_in_time_and_not_for_what_is_late(life: "Life") -> None:
    late = {"late_entries": "own_view"}
    life.make_phase(split="plain", closes_at=life.ahead(60), policy=late)
    life.submit("alpha", 1.0, "First", "plain")
    life.work()
    in_time = life.submit("beta", 0.5, "In the queue", "plain")
    life.move(closes_at=life.now())
    assert life.get(REPORT).status_code == life.get(PAGE).status_code == 404
    assert "what they sent in time is scored" in life.get(REPORT).json()["detail"]
    assert "How it ended" not in life.get("/phases/test").text
    life.work()
    life.submit("gamma", 3.0, "Too late", "plain")
    assert life.json(REPORT)["n_ranked"] == 2
    assert in_time in life.entry_ids()


def test_the_first_places_are_those_of_entries_that_may_lead(life: "Life") -> None:
    life.make_phase(split="plain", closes_at=life.ahead(60))
    parked = [life.submit("alpha", each / 100, f"Parked {each}", "plain") for each in (1, 2, 3)]
    honest = life.submit("beta", 1.5, "Honest", "plain")
    same = life.submit("gamma", 1.5, "Same", "plain")
    life.work()
    life.move(closes_at=life.now())
    assert ranks(life.board()) == {**dict.fromkeys(parked, 1), honest: 4, same: 4}
    assert "Honest leads" in life.get("/?phase=test").text
    assert [entry["submission_id"] for entry in life.json(REPORT)["winners"]] == [honest, same]
    words = text_of(life.get(PAGE).text)
    assert "What ranks above them carries a flag that bars it from leading." in words
    assert "No entry took a rank" not in words
