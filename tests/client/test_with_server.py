"""SDK and command line against the real application, records, file store and scoring.

The server runs in a thread on the loopback over a SQLite file; the worker's own functions run in
another thread, in place of Celery, which tests/end_to_end has.
"""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from tests.client.servers import run, submit
from typer.testing import CliRunner

from exceptiondrive import (
    Client,
    InvalidArgumentError,
    InvalidFileError,
    NotFoundError,
    NotSignedInError,
    QuotaError,
    StrategyRecorder,
    WaitTimeoutError,
    evaluate_file,
)
from exceptiondrive.cli import app
from exceptiondrive.outlook import Outlook
from exceptiondrive_records.notifications.inbox import tell_team
from exceptiondrive_records.teams.teams import find_team

if TYPE_CHECKING:
    from tests.client.servers import Running

MakeFile = Callable[..., Path]
QUOTA = 2
NO_NAMES = {
    " ": "must not be empty",
    "M" * 500: "is longer than 80 characters",
    "back\u202e": "cannot be shown by themselves, such as U.202E",
    "two\nlines": "such as U.000A",
}
"""And what is said of each."""
WITHDRAWN = "{} withdrawn: no other run takes its place on the board\n"


def test_all_notices_come_however_many_there_are(running: "Running") -> None:
    with running.context.database.write() as session:
        for number in range(130):
            tell_team(session, find_team(session, "alpha"), "message", f"Note {number}.", ())
    with running.client() as client:
        assert len({one.id for one in client.notices(limit=None)}) == 130
        assert [len(client.notices(limit=n)) for n in (5, 100, 110, 500)] == [5, 100, 110, 130]
    told = json.loads(run(running, "notices", "--limit", "1000", "--json").stdout)
    assert len(told) == 130
    cut = "at most {} are shown: --limit N shows more"
    assert run(running, "notices").stdout.splitlines()[-1] == cut.format(20)
    assert cut.format(130) in run(running, "notices", "--limit", "130").stdout
    assert "are shown" not in run(running, "notices", "--limit", "131").stdout


def test_from_file_to_rank(working: "Running", planning_file: MakeFile, split_file: Path) -> None:
    path = planning_file()
    done = submit(working, path, "--wait", "--description", "It drives.", "--json")
    assert done.exit_code == 0, done.stderr
    view = json.loads(done.stdout)
    assert (view["status"], view["rank"], view["team"]) == ("scored", 1, "Alpha")
    told = json.loads(run(working, "check", path, "--phase", "dev", "--json").stdout)
    assert view["report"] is None, "whoever submitted was told before"
    while (seen := json.loads(run(working, "status", view["id"], "--json").stdout))[
        "awaits_profile"
    ]:
        time.sleep(0.1)
    assert seen["report"]["profile"] == told["profile"], "the worker says what the client says"
    assert told["profile"]["source_speed_mps"] == pytest.approx(8.0)
    exact = evaluate_file(path, split=split_file)
    for key, value in view["sheet"]["macro_family"].items():
        assert value == pytest.approx(exact.macro_family[key], abs=0.005)


def test_people_read_rank_families_quota_and_the_page(
    working: "Running", planning_file: MakeFile
) -> None:
    done = submit(working, planning_file(), "--wait")
    assert done.exit_code == 0, done.stderr
    assert "rank 1 in phase dev" in done.stdout
    assert "Sudden Emergence" in done.stdout
    assert "1 of 2 submissions left today" in done.stdout
    address = next(line for line in done.stdout.splitlines() if line.startswith(working.url))
    page = httpx.get(address)  # for the team's eyes: a browser is asked to sign in first
    assert (page.status_code, page.headers["location"].split("?")[0]) == (303, "/sign-in")


def test_a_second_run_of_a_method_is_told_before_it_replaces_the_first(
    working: "Running", planning_file: MakeFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = json.loads(submit(working, planning_file(), "--wait", "--json").stdout)
    slower = [[3.0 * step, 0.0] for step in range(1, 7)]
    predictions = [{"sample_id": f"s{n}", "source": slower, "edited": slower} for n in range(4)]
    second_file = planning_file("second.json", predictions=predictions)
    refused = submit(working, second_file)
    assert refused.exit_code == 2
    assert f"It replaces {first['id']} (HCC " in refused.stderr
    assert ', rank 1) of "Planner". Nothing was sent.' in refused.stderr
    assert "add --replace" in refused.stderr
    monkeypatch.setattr("exceptiondrive.cli.output.can_ask", lambda: True)
    command = ["submit", str(second_file), "--phase", "dev", "--method", "Planner"]
    env = {"EXCEPTIONDRIVE_SERVER": working.url, "EXCEPTIONDRIVE_TOKEN": working.token}
    no = CliRunner().invoke(app, command, env=env, input="n\n")
    assert no.exit_code == 2
    assert len(json.loads(run(working, "submissions", "--json").stdout)) == 1
    assert submit(working, planning_file()).exit_code == 0, "the same bytes replace nothing"
    done = submit(working, second_file, "--replace", "--wait", "--json")
    assert done.exit_code == 0, done.stderr
    second = json.loads(done.stdout)
    told = run(working, "status", first["id"]).stdout
    assert f"not on the board in phase dev: replaced by {second['id']}" in told
    assert f"replaced by {second['id']}" in run(working, "submissions").stdout
    assert run(working, "withdraw", second["id"], "--yes").exit_code == 0
    assert json.loads(run(working, "status", first["id"], "--json").stdout)["replaced_by"] is None


def slower_file(planning_file: MakeFile, name: str = "slower.json") -> Path:
    slower = [[3.0 * step, 0.0] for step in range(1, 7)]
    predictions = [{"sample_id": f"s{n}", "source": slower, "edited": slower} for n in range(4)]
    return planning_file(name, predictions=predictions)


def test_the_sdk_replaces_an_entry_only_where_that_is_meant(
    working: "Running", planning_file: MakeFile
) -> None:
    second = slower_file(planning_file)
    with working.client() as client:
        first = client.submit(planning_file(), phase="dev", method="Planner")
        first.wait()
        with pytest.raises(InvalidArgumentError, match=f"It replaces {first.id} \\(HCC") as caught:
            client.submit(second, phase="dev", method="Planner")
        assert "Nothing was sent" in caught.value.sentence
        assert caught.value.advice == "To send it, say replace=True."
        assert len(client.submissions()) == 1
        again = client.submit(planning_file(), phase="dev", method="Planner")
        assert again.id == first.id, "the same bytes are no replacement"
        sent = client.submit(second, phase="dev", method="Planner", replace=True)
        retried = client.submit(second, phase="dev", method="Planner")
        assert retried.id == sent.id, "nor are those that are still waiting"
        for name, wrong in NO_NAMES.items():
            with pytest.raises(InvalidArgumentError, match=wrong):
                client.submit(second, phase="dev", method=name)
            told = run(working, "check", second, "--phase", "dev", "--method", name)
            assert (told.exit_code, re.search(wrong, told.stderr) is None) == (2, False)


@pytest.mark.parametrize("late", ["refused", "own_view"])
def test_check_says_that_a_closed_phase_refuses_unless_it_takes_late_entries(
    running: "Running", planning_file: MakeFile, late: str
) -> None:
    from tests.support.records import add_phase

    from exceptiondrive_records.db.clock import database_now
    from exceptiondrive_records.phases.phases import find_phase

    with running.context.database.write() as session:
        closes_at = database_now(session) + timedelta(days=1)
        add_phase(
            session, "ended", split="tiny", closes_at=closes_at, policy={"late_entries": late}
        )
        find_phase(session, "ended").closes_at = database_now(session)
    told = run(running, "check", "--phase", "ended", str(planning_file())).stdout
    assert ("will be refused: the phase takes none now" in told) is (late == "refused")
    assert ("appear on the late view only" in told) is (late == "own_view")
    assert "will be ranked" not in told, "late files take no rank on the board"
    assert "newest run of each method counts" not in told
    unanswered = [{"sample_id": f"s{n}", "source": None, "edited": None} for n in range(4)]
    file = str(planning_file(predictions=unanswered))
    sent = run(running, "submit", file, "--phase", "ended", "--method", "Planner")
    assert sent.exit_code == (4 if late == "refused" else 2), "asked only where it could be sent"


def test_check_says_what_an_upload_will_do(working: "Running", planning_file: MakeFile) -> None:
    checked = ("check", "--phase", "dev", "--method", "Planner")
    before = run(working, *checked, str(planning_file())).stdout
    assert "outlook: it will be ranked, as far as can be told here" in before
    assert "it replaces no other entry" in before
    first = json.loads(submit(working, planning_file(), "--wait", "--json").stdout)
    other = ("check", "--phase", "dev", "--method", "planner", str(slower_file(planning_file)))
    assert "replaces no other entry; 'Planner' is another method" in run(working, *other).stdout
    told = run(working, *checked, str(slower_file(planning_file))).stdout
    assert f"outlook: it replaces {first['id']} (HCC " in told
    assert "newest run of each method counts" in told
    report = json.loads(run(working, *checked, "--json", str(slower_file(planning_file))).stdout)
    (asked,) = report["to_confirm"]
    assert asked.startswith(f"It replaces {first['id']} (HCC ")
    assert "submitted before" in run(working, *checked, str(planning_file())).stdout
    from exceptiondrive_records.participation.disqualification import (
        disqualify_submission,
        disqualify_team,
    )

    why = {"reason": "copied", "actor": "test"}
    with working.context.database.write() as session:
        disqualify_submission(session, first["id"], **why)
    told = run(working, *checked, str(planning_file())).stdout
    assert f"it will be refused: these bytes, as {first['id']}, are disqualified in this" in told
    assert "stands, no quota is spent" not in told
    assert "disqualified in phase " in run(working, "status", first["id"]).stdout
    assert "will be ranked" in run(working, *checked, str(slower_file(planning_file))).stdout
    with working.context.database.write() as session:
        disqualify_team(session, "alpha", **why)
    told = run(working, *checked, str(slower_file(planning_file))).stdout
    assert "it will be refused: your team is disqualified in this phase since 2" in told
    assert "will be ranked" not in told
    assert "nothing: disqualified since 2" in run(working, "phases").stdout
    unanswered = [{"sample_id": f"s{n}", "source": None, "edited": None} for n in range(4)]
    file = planning_file("empty.json", predictions=unanswered)
    report = json.loads(run(working, *checked, "--json", str(file)).stdout)
    assert report["unranked_because"] is not None
    assert report["to_confirm"] == [], "what will be refused is not asked for"


def test_a_withdrawal_asks_and_says_what_stands_again(
    working: "Running", planning_file: MakeFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = json.loads(submit(working, planning_file(), "--wait", "--json").stdout)
    done = submit(working, slower_file(planning_file), "--replace", "--wait", "--json")
    second = json.loads(done.stdout)
    with monkeypatch.context() as on_terminal:
        for module in ("output", "submission_commands"):
            on_terminal.setattr(f"exceptiondrive.cli.{module}.can_ask", lambda: True)
        asked = run(working, "withdraw", second["id"], typed="n\n")
        assert f"Withdraw {second['id']} (HCC " in asked.stderr
        assert "Nothing was changed." in asked.stderr
        assert asked.exit_code == 2
        stranger = run(working, "withdraw", second["id"], token="edk_s_unknown")
        assert (stranger.exit_code, "Withdraw" in stranger.stderr) == (4, False)
        told = run(working, "withdraw", second["id"], "--yes").stdout
    assert f"withdrawn: the next board shows {first['id']} (HCC " in told
    assert "no other run takes its place" in run(working, "withdraw", first["id"]).stdout
    again = run(working, "withdraw", second["id"]).stdout
    assert again == f"{second['id']} withdrawn: it was withdrawn before, and nothing changed\n"


def test_a_link_is_told_by_status_and_before_what_ends_it(
    working: "Running", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def send(letters: str, *more: str) -> Any:
        path = tmp_path / f"{letters}.json"
        with working.client() as client:
            manifest = client.manifest("words")
        with StrategyRecorder(path, split=manifest.name) as recorder:
            for number, sample_id in enumerate(manifest.sample_ids):
                recorder.add(sample_id, letters[number % len(letters)])
        where = ("--phase", "words", "--method", letters, "--allow-unranked", "--wait", "--json")
        done = run(working, "submit", path, *where, *more)
        assert done.exit_code == 0, done.stderr
        return json.loads(done.stdout)

    plain = send("AB")
    linked = send("CD", "--without-reminder", plain["id"])
    told = run(working, "status", linked["id"]).stdout
    assert f"Without the reminder it is {plain['id']}; by the reminder Accuracy +" in " ".join(
        told.split()
    )
    lost = f"The board then shows no effect of the reminder in {linked['id']}."
    with monkeypatch.context() as on_terminal:
        for module in ("output", "submission_commands"):
            on_terminal.setattr(f"exceptiondrive.cli.{module}.can_ask", lambda: True)
        asked = run(working, "withdraw", plain["id"], typed="n\n")
        assert f"{lost} Withdraw {plain['id']} (Accuracy " in asked.stderr
        asked = run(working, "withdraw", linked["id"], typed="n\n")
        assert asked.stderr.startswith("Withdraw ")
    assert lost in run(working, "withdraw", plain["id"]).stdout


def test_a_withdrawal_after_the_deadline_says_that_the_place_stays_empty(
    working: "Running", planning_file: MakeFile
) -> None:
    from exceptiondrive_records.db.clock import database_now
    from exceptiondrive_records.phases.phases import find_phase

    first = json.loads(submit(working, planning_file(), "--wait", "--json").stdout)
    done = submit(working, slower_file(planning_file), "--replace", "--wait", "--json")
    second = json.loads(done.stdout)
    with working.context.database.write() as session:
        find_phase(session, "dev").closes_at = database_now(session)
    told = run(working, "withdraw", second["id"], "--yes").stdout
    assert "shows" not in told
    assert f"the previous run, {first['id']} (HCC " in told
    assert "is not ranked now" in told
    assert "the place stays empty" in " ".join(told.split())


def test_two_files_are_told_to_become_one(working: "Running", planning_file: MakeFile) -> None:
    one, two = planning_file("one.json"), planning_file("two.json")
    for command in (("submit", "--phase", "dev", "--method", "M"), ("check",)):
        done = run(working, *command, str(one), str(two))
        assert done.exit_code == 2
        assert "One file is one submission, and 2 were named." in done.stderr
        assert f"exceptiondrive convert {one} {two}" in done.stderr


def test_evaluate_takes_the_protocol_of_the_phase_and_says_whether_it_would_rank(
    running: "Running", planning_file: MakeFile, split_file: Path
) -> None:
    from tests.support.records import ACTOR, add_phase

    from exceptiondrive_records.protocols.protocols import add_protocol
    from exceptiondrive_schemas.protocol import packaged_protocol_toml

    with running.context.database.write() as session:
        add_protocol(session, packaged_protocol_toml("1.1"), ACTOR)
        add_phase(
            session, "strict", challenge="planning", split="tiny", quota_per_day=2, protocol="1.1"
        )
    standing = [[0.0, 0.0]] * 6
    moving = [[4.0 * step, 0.0] for step in range(1, 7)]
    predictions = [{"sample_id": f"s{n}", "source": moving, "edited": standing} for n in range(4)]
    file = planning_file("still.json", predictions=predictions)
    options = ("--split", str(split_file))
    assert "protocol 1.1" in run(running, "evaluate", str(file), *options).stdout
    first = run(running, "evaluate", str(file), *options, "--protocol", "1.0").stdout
    assert "it would be ranked under protocol 1.0" in first
    strict = run(running, "evaluate", str(file), *options, "--phase", "strict").stdout
    assert "protocol 1.1" in strict
    assert "it will be scored but not ranked: flagged Stands still" in strict
    told = run(running, "check", str(file), "--phase", "strict").stdout
    assert "not ranked: flagged Stands still: 100% of the edited trajectories stand" in told


def test_another_method_replaces_nothing(working: "Running", planning_file: MakeFile) -> None:
    assert submit(working, planning_file(), "--wait").exit_code == 0
    slower = [[3.0 * step, 0.0] for step in range(1, 7)]
    predictions = [{"sample_id": f"s{n}", "source": slower, "edited": slower} for n in range(4)]
    other = planning_file("other.json", predictions=predictions)
    assert submit(working, other, method="Another").exit_code == 0


def test_an_entry_without_a_rank_says_why(working: "Running", planning_file: MakeFile) -> None:
    straight = [[4.0 * step, 0.0] for step in range(1, 7)]
    predictions = [
        {"sample_id": f"s{n}", "source": straight, "edited": straight if n else None}
        for n in range(4)
    ]
    file = planning_file(predictions=predictions)
    refused = submit(working, file, "--wait")
    assert refused.exit_code == 2
    assert (
        "75.00% of the samples as edited are answered; a rank needs 99%. Nothing was sent."
        in refused.stderr
    )
    assert "add --allow-unranked" in refused.stderr
    assert run(working, "submissions").stdout == "no submissions\n"
    done = submit(working, file, "--wait", "--allow-unranked")
    assert done.exit_code == 0, done.stderr
    assert "not ranked in phase dev: 75.00% of the samples as edited are answered" in done.stdout


def test_all_that_has_to_be_confirmed_is_asked_at_once(
    working: "Running", planning_file: MakeFile
) -> None:
    assert submit(working, planning_file(), "--wait").exit_code == 0
    straight = [[4.0 * step, 0.0] for step in range(1, 7)]
    predictions = [{"sample_id": f"s{n}", "source": straight, "edited": None} for n in range(4)]
    file = planning_file("empty.json", predictions=predictions)
    refused = submit(working, file)
    assert "It replaces" in refused.stderr
    assert "add --replace and --allow-unranked." in refused.stderr
    with working.client() as client, pytest.raises(InvalidArgumentError) as caught:
        client.submit(file, phase="dev", method="Planner")
    assert caught.value.advice == "To send it, say replace=True and allow_unranked=True."
    told = submit(working, file, "--replace").stderr
    assert "add --allow-unranked." in told, "what was said is not asked for"
    assert submit(working, file, "--replace", "--allow-unranked").exit_code == 0


def test_the_same_bytes_are_the_same_submission_and_cost_nothing(
    working: "Running", planning_file: MakeFile
) -> None:
    path = planning_file()
    with working.client() as client:
        first = client.submit(path, phase="dev", method="Planner")
        first.wait()
        again = client.submit(path, phase="dev", method="Planner")
        assert again.id == first.id
        assert again.view.is_duplicate
        assert again.wait().is_duplicate
        assert client.phase("dev").quota is not None
        assert client.phase("dev").quota.used_today == 1  # type: ignore[union-attr]
    assert "The same bytes were submitted before" in submit(working, path).stdout


def test_the_quota_is_3_and_says_when_it_resets(
    running: "Running", planning_file: MakeFile
) -> None:
    straight = [[4.0 * step, 0.0] for step in range(1, 7)]
    for number in range(QUOTA + 1):
        bent = [[x, 0.01 * number] for x, _ in straight]
        predictions = [{"sample_id": f"s{n}", "source": straight, "edited": bent} for n in range(4)]
        done = submit(running, planning_file(predictions=predictions))
        assert done.exit_code == (0 if number < QUOTA else 3)
    assert "resets at" in done.stderr
    assert "00:00 UTC" in done.stderr
    unranked = [{"sample_id": f"s{n}", "source": straight, "edited": None} for n in range(4)]
    told = submit(running, planning_file(predictions=unranked))
    assert told.exit_code == 3, "nobody is asked about what could not be sent anyway"
    assert "has used its" in told.stderr
    assert "--allow-unranked" not in told.stderr
    path = planning_file(predictions=predictions)
    with running.client() as client, pytest.raises(QuotaError):
        client.submit(path, phase="dev", method="Planner")


def test_an_invalid_file_is_refused_here_with_the_words_of_the_server(
    working: "Running", planning_file: MakeFile
) -> None:
    sideways = [[0.0, 4.0 * step] for step in range(1, 7)]
    path = planning_file(
        predictions=[{"sample_id": "s7", "source": sideways, "edited": sideways[:3]}]
    )
    here = submit(working, path, "--json")
    assert here.exit_code == 2
    with working.client() as client:
        assert client.submissions() == ()
        sent = client._transport.post(
            "/submissions",
            lambda: {
                "data": {"phase": "dev", "method": "Planner"},
                "files": {"file": ("p.json", path.read_bytes())},
            },
        )
        with pytest.raises(InvalidFileError) as there:
            client.submission(sent.json()["id"]).wait()
        assert client.phase("dev").quota.rejected_today == 1  # type: ignore[union-attr]
    report = json.loads(here.stdout)["error"]["report"]
    assert report == there.value.report.model_dump(mode="json")


def test_waiting_too_long_is_7_and_the_submission_stays(
    running: "Running", planning_file: MakeFile
) -> None:
    done = submit(running, planning_file(), "--wait", "--timeout", "0.3", "--json")
    assert done.exit_code == 7
    error = json.loads(done.stdout)["error"]
    assert error["submission"]["status"] in ("received", "queued")
    shown = run(running, "status", error["submission"]["id"])
    assert shown.exit_code == 0
    assert "no worker can score it now" in shown.stdout
    with running.client() as client, pytest.raises(WaitTimeoutError):
        client.submission(error["submission"]["id"]).wait(timeout_s=0.1)


def test_without_a_token_it_is_4(running: "Running", planning_file: MakeFile) -> None:
    done = run(running, "whoami", token="edk_t_wrong")
    assert done.exit_code == 4
    assert "exceptiondrive login" in done.stderr
    for token in (None, running.organizer_token):
        asked: list[Outlook] = []
        with (
            Client(running.url, token) as client,
            pytest.raises(NotSignedInError, match="Only teams submit, and no token of a team"),
        ):
            client.submit(
                planning_file(), phase="dev", method="Planner", before_upload=asked.append
            )
        assert asked == [], "who cannot submit is told so before any consent is asked"


def test_what_is_not_there_is_2(running: "Running") -> None:
    for arguments in (
        ("status", "nothing"),
        ("withdraw", "nothing"),
        ("manifest", "nothing"),
        ("split", "download", "nothing"),
        ("leaderboard", "--phase", "nothing"),
    ):
        done = run(running, *arguments)
        assert done.exit_code == 2, arguments
        assert done.stderr.startswith("error: ")
    with running.client() as client, pytest.raises(NotFoundError):
        client.phase("nothing")


def test_phases_manifest_and_split_make_a_file_that_can_be_evaluated(
    running: "Running",
    planning_file: MakeFile,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert "2 of 2 today" in run(running, "phases").stdout
    manifest, split = tmp_path / "m.json", tmp_path / "s.json.gz"
    assert run(running, "manifest", "dev", "-o", manifest).exit_code == 0
    done = run(running, "split", "download", "tiny", "-o", split, "--json")
    told = json.loads(done.stdout)
    assert told["n_samples"] == 4
    this_one = ("split", "download", "tiny", "-o", split, "--revision")
    assert run(running, *this_one, told["revision"]).exit_code == 0
    other = run(running, *this_one, "sha256:00")
    assert other.exit_code == 2
    assert "There is no revision of split 'tiny' like 'sha256:00'." in other.stderr
    path = planning_file()
    assert run(running, "check", path, "--manifest", manifest).exit_code == 0
    other = run(running, "evaluate", path, "--split", split, "--phase", "words")
    assert (other.exit_code, "wrong_schema" in other.stdout) == (2, True)
    monkeypatch.chdir(tmp_path)
    assert "in dev.manifest.json" in run(running, "manifest", "dev").stdout
    assert run(running, "check", path, "--phase", "dev").exit_code == 0
    assert run(running, "check", path, "--phase", "words").exit_code == 2
    assert run(running, "evaluate", path, "--split", split).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("manifest", "dve"), "Did you mean 'dev'? There are the phases dev, words."),
        (("leaderboard", "--phase", "wrds"), "Did you mean 'words'?"),
        (("leaderboard", "--phase", "dev", "--protocol", "9.9"), "There are the protocols 1.0."),
        (("quota", "--phase", "dew"), "Did you mean 'dev'?"),
        (("quota", "--phase", "DEV"), "Did you mean 'dev'?"),
        (("submissions", "--phase", "dvev"), "Did you mean 'dev'?"),
        (("split", "download", "tinny"), "Did you mean 'tiny'? There are the public splits tiny."),
    ],
)
def test_a_name_that_is_not_there_is_answered_with_what_was_meant(
    running: "Running", arguments: tuple[str, ...], words: str
) -> None:
    done = run(running, *arguments)
    assert done.exit_code == 2
    assert words in done.stderr


def test_a_protocol_that_is_not_there_is_answered_with_those_that_are(running: "Running") -> None:
    with running.client() as client, pytest.raises(NotFoundError) as caught:
        client.protocol("9")
    assert caught.value.advice.startswith("There are the protocols 1.0")


def test_the_quota_is_shown_by_phase_and_belongs_to_teams(running: "Running") -> None:
    found = json.loads(run(running, "quota", "--json").stdout)
    assert set(found) == {"dev", "words"}
    assert found["dev"]["remaining_today"] == QUOTA
    assert f"{QUOTA} of {QUOTA}" in run(running, "quota", "--phase", "dev").stdout
    organizer = run(running, "quota", token=running.organizer_token)
    assert (organizer.exit_code, "Only teams have a quota" in organizer.stderr) == (4, True)


def test_the_quota_of_a_phase_that_takes_nothing_is_shown_where_it_is_named_alone(
    running: "Running",
) -> None:
    from exceptiondrive_records.db.clock import database_now
    from exceptiondrive_records.phases.phases import find_phase

    nothing = "nothing can be sent now"
    assert nothing not in run(running, "quota", "--phase", "dev").stdout
    with running.context.database.write() as session:
        find_phase(session, "dev").closes_at = database_now(session)
    assert set(json.loads(run(running, "quota", "--json").stdout)) == {"words"}
    named = run(running, "quota", "--phase", "dev").stdout
    assert (f"{QUOTA} of {QUOTA}" in named, nothing in named) == (True, True)
    with running.context.database.write() as session:
        find_phase(session, "words").visibility = "archived"
    assert run(running, "quota").stdout.startswith(nothing)


def test_the_address_of_a_page_does_for_an_id_on_its_own_server_alone(
    running: "Running", planning_file: MakeFile
) -> None:
    own = json.loads(submit(running, planning_file(), "--json").stdout)["id"]
    for address in (f"{running.url}/submissions/{own}", f"{running.url}/entries/{own}?tab=a#b"):
        assert json.loads(run(running, "status", address, "--json").stdout)["id"] == own
    other = run(running, "status", f"https://board.example.org/submissions/{own}")
    assert (other.exit_code, "Say which server" in other.stderr) == (2, True)
    no_page = run(running, "status", f"{running.url}/phases/dev")
    assert f"It is like {running.url}/submissions/ID" in no_page.stderr


def test_stdin_is_a_file_like_any_other(
    working: "Running", planning_file: MakeFile, split_file: Path
) -> None:
    data = planning_file().read_bytes()

    def piped(*arguments: object) -> Any:
        env = {"EXCEPTIONDRIVE_SERVER": working.url, "EXCEPTIONDRIVE_TOKEN": working.token}
        words = [str(argument) for argument in arguments]
        return CliRunner().invoke(app, words, input=data, env=env)

    assert "stdin is valid" in piped("check", "-", "--phase", "dev").stdout
    exact = json.loads(piped("evaluate", "-", "--split", split_file, "--json").stdout)
    assert exact == json.loads(
        run(working, "evaluate", planning_file(), "--split", split_file, "--json").stdout
    )
    done = piped("submit", "-", "--phase", "dev", "--method", "Piped", "--wait", "--json")
    assert json.loads(done.stdout)["rank"] == 1


def test_the_phase_of_the_environment_is_meant_where_none_is_named(
    working: "Running", planning_file: MakeFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_PHASE", "dev")
    done = run(working, "submit", planning_file(), "--method", "M", "--wait", "--json")
    assert json.loads(done.stdout)["phase"] == "dev"
    assert "phase dev" in run(working, "leaderboard").stdout
    assert "split tiny" in run(working, "check", planning_file()).stdout
    assert "of the phase 'dev'" in run(working, "report").stderr, "it has not ended"
    words = json.loads(run(working, "leaderboard", "--challenge", "strategy", "--json").stdout)
    assert words["phase"] == "words", "a challenge that is named comes before a phase that is not"


def test_the_board_in_all_its_forms(working: "Running", planning_file: MakeFile) -> None:
    submit(working, planning_file(), "--wait")
    table = run(working, "leaderboard", "--phase", "dev")
    assert "Planner" in table.stdout
    assert "HCC % ^" in table.stdout
    board = json.loads(run(working, "leaderboard", "--phase", "dev", "--json").stdout)
    assert [(row["source"], row["rank"]) for row in board["entries"]] == [
        ("scored", 1),
        ("reference", None),
    ]
    by_ur = run(working, "leaderboard", "--phase", "dev", "--sort", "ur", "--json")
    assert json.loads(by_ur.stdout)["entries"] == board["entries"]
    assert run(working, "leaderboard", "--phase", "dev", "--sort", "beauty").exit_code == 2
    assert "ur lowest first, -hcc highest" in " ".join(
        run(working, "leaderboard", "--help").stdout.split()
    )


def test_a_withdrawn_entry_leaves_the_board_and_stays_in_the_list(
    working: "Running", planning_file: MakeFile
) -> None:
    view = json.loads(submit(working, planning_file(), "--wait", "--json").stdout)
    done = run(working, "withdraw", view["id"])
    assert (done.exit_code, done.stdout) == (0, WITHDRAWN.format(view["id"]))
    listed = run(working, "submissions", "--status", "withdrawn", "--json")
    assert [row["id"] for row in json.loads(listed.stdout)] == [view["id"]]
    with working.client() as client:
        while any(row.submission_id for row in client.leaderboard(phase="dev").entries):
            time.sleep(0.02)


HEEDS_INTERRUPTS = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from exceptiondrive.__main__ import main
main()
"""
"""The command as in a terminal: whoever starts tests in the background has them ignore interrupts."""
Process = subprocess.Popen[bytes]


def in_a_terminal(
    running: "Running",
    words: Sequence[object],
    look: Callable[[Process, bytes], object] = lambda *_: None,
) -> tuple[int, bytes, bytes]:
    """Run a command whose stderr is a terminal; return exit code, stdout, and what was shown.

    `look` is called with what was shown so far, each time that there is more.
    """
    import pty

    main_end, terminal = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", HEEDS_INTERRUPTS, *map(str, words)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=terminal,
        env={
            **os.environ,
            "TERM": "xterm-256color",
            "EXCEPTIONDRIVE_SERVER": running.url,
            "EXCEPTIONDRIVE_TOKEN": running.token,
        },
    )
    os.close(terminal)
    shown = b""
    with contextlib.suppress(OSError):  # the other end is closed: the command has ended
        while chunk := os.read(main_end, 4096):
            shown += chunk
            look(process, shown)
    os.close(main_end)
    stdout, _ = process.communicate()
    return process.returncode, stdout, shown


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are a POSIX matter")
def test_progress_is_shown_on_a_terminal_and_never_on_stdout(
    working: "Running", planning_file: MakeFile
) -> None:
    submit = ("submit", planning_file(), "--phase", "dev", "--method", "Planner", "--wait")
    code, stdout, shown = in_a_terminal(working, [*submit, "--json"])
    assert code == 0
    assert b"uploading planner.json" in shown
    assert json.loads(stdout)["rank"] == 1


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are a POSIX matter")
def test_who_interrupts_the_waiting_reads_that_the_submission_goes_on(
    running: "Running", planning_file: MakeFile
) -> None:
    ids: list[str] = []

    def interrupt(process: Process, shown: bytes) -> None:
        if not ids and (found := re.search(rb"\b[0-9a-z]{16}\b", shown)):
            ids.append(found[0].decode())
            process.send_signal(signal.SIGINT)

    submit = ("submit", planning_file(), "--phase", "dev", "--method", "Planner", "--wait")
    code, _, shown = in_a_terminal(running, submit, interrupt)
    assert code == 130
    said = f"It is safe and will be scored; look with: exceptiondrive status {ids[0]}"
    assert said in shown.decode()


@pytest.mark.skipif(sys.platform == "win32", reason="no other process is interrupted there")
def test_who_interrupts_the_sending_reads_that_nothing_counts_twice(
    running: "Running", planning_file: MakeFile
) -> None:
    submit = ("submit", str(planning_file()), "--phase", "dev", "--method", "Planner")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        silent.settimeout(60)
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        mine = {"EXCEPTIONDRIVE_SERVER": address, "EXCEPTIONDRIVE_TOKEN": running.token}
        process = subprocess.Popen(
            [sys.executable, "-c", HEEDS_INTERRUPTS, *submit],
            stderr=subprocess.PIPE,
            env={**os.environ, **mine},
        )
        connection, _ = silent.accept()
        with connection:
            connection.recv(1)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate()
    assert process.returncode == 130
    assert b"Sent again, the same bytes count once." in said
