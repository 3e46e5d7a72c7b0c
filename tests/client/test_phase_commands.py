"""The life of a phase from the command line, against the real server and the worker's functions."""

import json
import re
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.client.servers import run
from tests.support.records import add_sample_split

from exceptiondrive import Client, InvalidArgumentError, NotAllowedError, NotFoundError
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.splits.splits import manifest_of
from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.client.servers import Running

MakeFile = Callable[..., Path]
PAUSE_S = 0.05
CLOSES = "--closes-at=2031-01-01T00:00:00Z"
REASON = ("--reason", "as announced")


def organize(server: "Running", *arguments: object) -> Any:
    return run(server, "organizer", "phases", *arguments, token=server.organizer_token)


def make_phase(server: "Running", *settings: str) -> None:
    words = ("create", "test", "--title", "Test", "--split", "tiny", "--quota-per-day", "9")
    made = organize(server, *words, *settings)
    assert made.exit_code == 0, made.stderr


def shown(server: "Running") -> Any:
    return json.loads(organize(server, "show", "test", "--json").stdout)


def other_bytes(path: Path) -> Path:
    """The same answers in another file: the same bytes again would be the first submission."""
    path.write_text(path.read_text() + "\n" * len(path.stem))
    return path


def scored(server: "Running", path: Path, method: str) -> str:
    """Submit with the client and wait for the score, not for a rank: there may be none."""
    with server.client() as client:
        submission = client.submit(path, phase="test", method=method, replace=True)
        while not client.status(submission.id).status.is_terminal:
            time.sleep(PAUSE_S)
        view = client.status(submission.id)
        assert view.status == "scored", view
        return view.id


def board_shows(server: "Running", *ids: str) -> None:
    """Wait until the board holds exactly these entries; the suite's time limit ends a wrong wait."""
    with server.client() as client:
        entries: tuple[BoardEntry, ...] = ()
        while True:
            with suppress(NotFoundError):  # the first board is still made
                entries = client.leaderboard(phase="test").entries
            if {entry.submission_id for entry in entries if entry.submission_id} == set(ids):
                return
            time.sleep(PAUSE_S)


def test_a_phase_is_made_with_settings_shown_and_changed(running: "Running") -> None:
    make_phase(
        running, CLOSES, "--anonymous", "--late-entries=own_view", "--description=For papers"
    )
    phase = shown(running)
    assert (phase["policy"]["anonymous"], phase["policy"]["late_entries"]) == (True, "own_view")
    assert phase["description"] == "For papers"
    settings = ("--freezes-at", "2030-01-01T00:00:00Z", "--quota-total", "50")
    changed = organize(running, "update", "test", *settings)
    assert changed.exit_code == 0, changed.stderr
    total, freezes = changed.stdout.splitlines()
    assert total == "quota_total: - -> 50"
    assert freezes.startswith("freezes_at: - -> 2030-01-01T00:00:00")
    assert organize(running, "update", "test", *settings).stdout == "nothing changed\n"
    assert organize(running, "update", "test", "--freezes-at", "none").exit_code == 0
    assert shown(running)["policy"]["freezes_at"] is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("update", "test", "--anonymos"), "No such option: --anonymos"),
        (("update", "test", "--late-entries", "yes"), "refused or own_view, not 'yes'"),
        (("update", "test", "--quota-per-day", "many"), "from 1 to 10,000, not 'many'"),
        (("update", "test", "--quota-total", "0"), "from 1 to 1,000,000, not '0'"),
        (("update", "test"), "`--help` lists the settings"),
        (
            ("reveal", "test", "--what", "all", *REASON),
            "--what is board, names or split, not 'all'",
        ),
        (("reveal", "test", "--what", "split", *REASON), "has no parts"),
        (("show", "none"), "none"),
    ],
)
def test_what_cannot_be_done_is_said_in_words(
    running: "Running", words: tuple[str, ...], said: str
) -> None:
    make_phase(running)
    before = shown(running)
    refused = organize(running, *words)
    assert refused.exit_code != 0
    assert said in " ".join(refused.stderr.split())
    assert shown(running) == before


def test_a_board_is_frozen_and_revealed(working: "Running", planning_file: MakeFile) -> None:
    make_phase(working)
    first = scored(working, planning_file(), "First")
    board_shows(working, first)
    frozen = organize(working, "freeze", "test", *REASON)
    assert frozen.exit_code == 0, frozen.stderr
    assert re.fullmatch(
        r"the board of test has been frozen since .*; organizer phases reveal test --what board .* ends the freeze\n",
        frozen.stdout,
    )
    assert shown(working)["now"]["frozen_since"] is not None
    second = scored(working, other_bytes(planning_file("two.json")), "Second")
    board_shows(working, first)
    asked = ("leaderboard", "--phase", "test")
    assert "\nfrozen since 2" in run(working, *asked).stdout
    assert "frozen" not in run(working, *asked, "--as-of", "2099-01-01").stdout
    cited = json.loads(run(working, *asked, "--json").stdout)
    revealed = organize(working, "reveal", "test", "--what", "board", "--yes", *REASON)
    assert revealed.exit_code == 0, revealed.stderr
    assert revealed.stdout.startswith("the newest board of test is shown")
    board_shows(working, first, second)
    assert "frozen" not in run(working, *asked).stdout
    of_number = run(working, *asked, "--board", str(cited["board"]), "--json")
    assert json.loads(of_number.stdout) == cited
    with Client(working.url) as client:
        assert client.leaderboard(phase="test", board=cited["board"]).board == cited["board"]


def test_a_reveal_of_hidden_scores_says_before_it_asks_that_later_deadlines_end(
    running: "Running",
) -> None:
    make_phase(running, "--frozen-scores", "hidden", CLOSES)
    named = f"{running.url}/organize/phases/test/reveal-board names any."
    for what, is_said in (("board", True), ("names", False)):
        asked = organize(running, "reveal", "test", "--what", what, *REASON)
        assert asked.exit_code == 2
        assert (named in asked.stderr) is is_said


def test_a_withdrawal_behind_a_hidden_freeze_says_that_the_reveal_tells_what_stands(
    working: "Running", planning_file: MakeFile
) -> None:
    make_phase(working, "--frozen-scores", "hidden")
    assert organize(working, "freeze", "test", *REASON).exit_code == 0
    files = planning_file(), other_bytes(planning_file("two.json"))
    _, second = (scored(working, file, "Planner") for file in files)
    gone = run(working, "withdraw", second)
    assert (
        gone.stdout == f"{second} withdrawn: which run counts is shown when the board is revealed\n"
    )


def test_names_are_revealed(working: "Running", planning_file: MakeFile) -> None:
    make_phase(working, "--anonymous")
    mine = scored(working, planning_file(), "Planner")
    board_shows(working, mine)
    assert "Alpha" not in run(working, "leaderboard", "--phase", "test").stdout
    unasked = organize(working, "reveal", "test", "--what", "names", *REASON)
    assert (unasked.exit_code, "add --yes" in unasked.stderr) == (2, True)
    assert shown(working)["now"]["is_anonymous"]
    named = organize(working, "reveal", "test", "--what", "names", "--yes", *REASON)
    assert named.exit_code == 0
    with working.client() as client:
        while client.leaderboard(phase="test").entries[0].team != "Alpha":
            time.sleep(PAUSE_S)


def test_a_team_chooses_its_entry(working: "Running", planning_file: MakeFile) -> None:
    make_phase(working, "--entries-shown=chosen")
    first = scored(working, planning_file(), "First")
    second = scored(working, other_bytes(planning_file("two.json")), "Second")
    board_shows(working, second)
    chosen = run(working, "choose", first)
    assert (chosen.exit_code, chosen.stdout) == (0, f"{first} stands\n")
    board_shows(working, first)
    assert json.loads(run(working, "choose", second, "--json").stdout)["is_chosen"] is True
    board_shows(working, second)
    refused = run(working, "publish", first)
    assert refused.exit_code == 4
    assert "shows every scored entry" in refused.stderr


@pytest.mark.parametrize("setting", ["--entries-shown=chosen", "--run-choice=team"])
def test_check_says_that_the_run_that_was_chosen_stays(
    working: "Running", planning_file: MakeFile, setting: str
) -> None:
    make_phase(working, setting)
    chosen = scored(working, planning_file(), "Planner")
    board_shows(working, chosen)
    assert run(working, "choose", chosen).exit_code == 0
    file = other_bytes(planning_file("two.json"))
    told = run(working, "check", file, "--phase", "test", "--method", "Planner").stdout
    assert f"it will be scored, but not appear on the board: {chosen} (HCC " in told
    assert "To say otherwise: exceptiondrive choose." in told
    for wrong in ("it will be ranked", "takes the place"):
        assert wrong not in told
    second = scored(working, file, "Planner")
    view = json.loads(run(working, "status", second, "--json").stdout)
    assert view["replaced_by"] == chosen


def test_a_chosen_run_that_is_private_is_not_said_to_stand(
    working: "Running", planning_file: MakeFile
) -> None:
    make_phase(working, "--entries-shown=chosen", "--entries-private")
    chosen = scored(working, planning_file(), "Planner")
    said = run(working, "choose", chosen)
    assert said.stdout == f"{chosen} stands once your team publishes it\n"
    file = other_bytes(planning_file("two.json"))
    check = ("check", file, "--phase", "test", "--method", "Planner")
    assert "it will be ranked once your team publishes it" in run(working, *check).stdout
    assert run(working, "publish", chosen).exit_code == 0
    assert f"not appear on the board: {chosen} (HCC " in run(working, *check).stdout


def test_a_team_publishes_and_takes_back(working: "Running", planning_file: MakeFile) -> None:
    make_phase(working, "--entries-private")
    mine = scored(working, planning_file(), "Planner")
    published = run(working, "publish", mine)
    assert (published.exit_code, published.stdout) == (0, f"{mine} is public\n")
    board_shows(working, mine)
    undone = run(working, "publish", mine, "--undo")
    status = run(working, "status", mine).stdout
    assert f"it is private: exceptiondrive publish {mine} shows it" in status
    assert (undone.exit_code, undone.stdout) == (0, f"{mine} is private\n")
    board_shows(working)
    with working.client() as client:
        assert client.publish(mine).is_published
        assert not client.unpublish(mine).is_published
        with pytest.raises(NotAllowedError, match="nothing to choose"):
            client.choose(mine)


def test_publish_names_the_public_run_before_it_takes_its_place(
    working: "Running", planning_file: MakeFile
) -> None:
    make_phase(working, "--entries-private")
    first = scored(working, planning_file(), "Planner")
    second = scored(working, other_bytes(planning_file("two.json")), "Planner")
    assert run(working, "publish", first).exit_code == 0
    board_shows(working, first)
    asked = run(working, "publish", second)
    assert asked.exit_code == 2
    assert f"It replaces {first} (HCC " in asked.stderr
    assert ', rank 1) of "Planner". Nothing was changed.' in asked.stderr
    assert "add --replace" in asked.stderr
    with working.client() as client, pytest.raises(InvalidArgumentError, match="replace=True"):
        client.publish(second)
    assert run(working, "publish", second, "--replace").exit_code == 0
    board_shows(working, second)


def test_check_says_what_a_rank_still_needs(working: "Running", planning_file: MakeFile) -> None:
    make_phase(working, "--entries-private", "--terms", "Be fair.", "--terms-required")
    unanswered = [{"sample_id": f"s{n}", "source": None, "edited": None} for n in range(4)]
    files = planning_file(), planning_file("none.json", predictions=unanswered)
    told = run(working, "check", files[0], "--phase", "test").stdout
    accept = "it will be refused until your team accepts the terms"
    assert f"{accept}: see `exceptiondrive terms --phase test`" in told
    assert "outlook: then it will be ranked once your team publishes it" in told
    refused = run(working, "submit", files[1], "--phase", "test", "--method", "None")
    assert (refused.exit_code, "terms" in refused.stderr) == (4, True), "nothing is asked first"
    with working.client() as client:
        client.accept_terms("test", str(client.phase("test").terms_version))
    told = run(working, "check", files[0], "--phase", "test").stdout
    assert "outlook: it will be ranked once your team publishes it" in told
    assert "accepts the terms" not in told


def test_late_entries_are_read_with_view_late(working: "Running", planning_file: MakeFile) -> None:
    make_phase(working, CLOSES, "--late-entries=own_view")
    in_time = scored(working, planning_file(), "InTime")
    board_shows(working, in_time)
    early = run(working, "leaderboard", "--phase", "test", "--view", "late")
    assert early.exit_code != 0
    assert "no late entry counts on it now" in early.stderr
    with working.context.database.write() as session:
        find_phase(session, "test").closes_at = database_now(session)
    late = scored(working, other_bytes(planning_file("late.json")), "TooLate")
    asked = ("leaderboard", "--phase", "test")
    while run(working, *asked, "--view", "late").exit_code != 0:
        time.sleep(PAUSE_S)
    table = run(working, *asked, "--view", "late").stdout
    assert "late view" in table
    assert "TooLate" in table
    assert "TooLate" not in run(working, *asked).stdout
    with Client(working.url) as client:
        entries = client.leaderboard(phase="test", view="late").entries
        assert {row.submission_id: row.is_late for row in entries if row.submission_id} == {
            in_time: False,
            late: True,
        }
    assert run(working, *asked, "--view", "later").exit_code == 2


def test_texts_come_from_files_and_a_phase_is_made_like_another(
    running: "Running", tmp_path: Path
) -> None:
    rules = tmp_path / "rules.md"
    rules.write_text("# Rules\n\nBe *fair*.")
    make_phase(running, "--rules", f"@{rules}", "--data-licence", "CC0", CLOSES)
    assert shown(running)["page"]["rules"] == "# Rules\n\nBe *fair*."
    words = ("create", "next", "--title", "Next", "--split", "tiny", "--like", "test")
    assert organize(running, *words, "--quota-per-day", "4").exit_code == 0
    made = json.loads(organize(running, "show", "next", "--json").stdout)
    assert made["page"] == shown(running)["page"]
    assert (made["title"], made["quota_per_day"], made["closes_at"]) == ("Next", 4, None)
    assert organize(running, "update", "test", "--visibility", "archived").exit_code == 0
    later = organize(running, "create", "later", "--title", "Later", "--like", "test", "--json")
    assert json.loads(later.stdout)["visibility"] == "shown"
    missing = organize(running, "update", "next", "--terms", f"@{tmp_path / 'none.md'}")
    assert missing.exit_code == 2


def test_a_phase_made_like_another_has_its_split_and_challenge_unless_told(
    running: "Running",
) -> None:
    words = ("--title", "Next", "--json")
    refused = organize(running, "create", "first", *words)
    assert refused.exit_code == 2
    assert "Add --split or --like." in refused.stderr
    strategy = ("--split", "tiny", "--challenge", "strategy")
    assert organize(running, "create", "first", *strategy, *words).exit_code == 0
    for more, challenge in (((), "strategy"), (("--challenge", "planning"), "planning")):
        done = organize(running, "create", challenge, "--like", "first", *more, *words)
        made = json.loads(done.stdout)
        assert (made["split"], made["challenge"]) == ("tiny", challenge)


def test_a_phase_made_like_another_has_its_split_revision(running: "Running") -> None:
    make_phase(running)
    with running.context.database.write() as session:  # a later one, that no phase stands on
        later = {"revision": f"sha256:{'9' * 64}"}
        add_sample_split(session, manifest_of(session, "tiny").model_copy(update=later))
    words = ("create", "next", "--title", "Next", "--split", "tiny")
    assert organize(running, *words, "--like", "test").exit_code == 0
    made = json.loads(organize(running, "show", "next", "--json").stdout)
    assert made["split_revision"] == shown(running)["split_revision"]
    made = json.loads(organize(running, "create", "last", *words[2:], "--json").stdout)
    assert made["split_revision"] == later["revision"]


def test_a_new_phase_takes_no_draft_unless_it_is_named(running: "Running", tmp_path: Path) -> None:
    draft = tmp_path / "draft.toml"
    draft.write_text(packaged_protocol_toml().replace('version = "1.0"', 'version = "9.9"'))
    added = run(running, "organizer", "protocols", "add", str(draft), token=running.organizer_token)
    assert added.exit_code == 0, added.stderr
    make_phase(running)
    assert shown(running)["protocol"] == "1.0", "the one that a phase stands under"
    named = ("create", "named", "--title", "Named", "--split", "tiny")
    assert "protocol 9.9" in organize(running, *named, "--protocol", "9.9").stdout
    like = ("create", "next", "--title", "Next", "--split", "tiny", "--like")
    assert "protocol 1.0" in organize(running, *like, "test").stdout


def test_a_phase_is_featured_and_hidden(running: "Running") -> None:
    make_phase(running)
    assert organize(running, "feature", "test", *REASON).exit_code == 0
    first = json.loads(run(running, "phases", "--json").stdout)
    assert first[0]["id"] == "test"
    assert organize(running, "update", "test", "--visibility", "hidden").exit_code == 0
    seen = json.loads(run(running, "phases", "--json").stdout)
    assert "test" not in [one["id"] for one in seen]
    assert "test" in [one["id"] for one in json.loads(
        run(running, "phases", "--json", token=running.organizer_token).stdout)]  # fmt: skip


def test_the_links_of_the_site_are_set_and_shown(running: "Running") -> None:
    def site(*words: str) -> Any:
        return run(running, "organizer", "site", *words, token=running.organizer_token)

    assert site("set", "--paper-url", "https://paper.example.org").exit_code == 0
    assert json.loads(site("show", "--json").stdout)["paper_url"] == "https://paper.example.org"
    assert site("set").exit_code == 2
    assert site("set", "--contact", "javascript:alert(1)").exit_code == 2
