"""The command line as scripts see it: exit codes, stdout, stderr, no terminal."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import typer
from tests.client.servers import SPLIT, STRAIGHT
from typer.main import get_group
from typer.testing import CliRunner

from exceptiondrive import __version__
from exceptiondrive.cli import COMMANDS, app
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.client.servers import CannedServer

MakeFile = Callable[..., Path]
ME = {"team": "alpha", "token_name": "ci", "scopes": ["submit"], "expires_at": None}


def run(*arguments: object, stdin: str = "") -> Any:
    """Run a command without a terminal."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments], input=stdin)


@pytest.mark.parametrize(
    ("status", "code", "exit_code"),
    [
        (400, "bad_request", 2),
        (404, "not_found", 2),
        (413, "upload_too_large", 2),
        (415, "unsupported_media_type", 2),
        (429, "quota_exceeded", 3),
        (429, "rejected_cap_exceeded", 3),
        (401, "not_signed_in", 4),
        (403, "not_allowed", 4),
        (403, "phase_closed", 4),
        (409, "conflict", 4),
        (500, "internal", 5),
    ],
)
def test_the_exit_code_tells_causes_apart(
    canned_server: "CannedServer", status: int, code: str, exit_code: int
) -> None:
    canned_server.problem("GET /me", status, code)
    done = run("whoami", "--server", canned_server.url)
    assert done.exit_code == exit_code
    assert done.stdout == ""
    assert done.stderr.startswith(f"error: The server says {code}.")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("leaderboard dev", "a phase is named by --phase PHASE"),
        ("news dev", "a phase is named by --phase PHASE"),
        ("organizer news list dev", "a phase is named by --phase PHASE"),
        ("report --phase dev", "this command takes the phase without it"),
        ("organizer phases freeze --phase dev", "this command takes the phase without it"),
    ],
)
def test_a_phase_that_is_named_the_other_way_is_told_the_right_one(words: str, told: str) -> None:
    done = run(*words.split())
    assert (done.exit_code, done.stdout) == (2, "")
    assert told in " ".join(done.stderr.split())


def test_a_phase_is_no_part_of_what_is_refused_where_none_is_taken() -> None:
    for words in ("whoami dev", "status --phase dev"):
        assert "a phase" not in run(*words.split()).stderr
        assert "the phase" not in run(*words.split()).stderr


def test_an_address_with_a_path_too_many_is_named_where_nothing_is_found(
    canned_server: "CannedServer",
) -> None:
    for path in ("/phases", "/api/v1/phases"):
        canned_server.problem(f"GET {path}", 404, "not_found")
    done = run("phases", "--server", f"{canned_server.url}/api/v1")
    assert done.exit_code == 2
    assert f"Asked was {canned_server.url}/api/v1/api/v1/phases: if /api/v1 is" in done.stderr
    assert "--server" in done.stderr
    assert "Asked was" not in run("phases", "--server", canned_server.url).stderr


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ALL_PROXY", "socks5://127.0.0.1:9"),
        ("HTTPS_PROXY", "ftp://127.0.0.1:9"),
        ("SSL_CERT_FILE", "nowhere.pem"),
    ],
)
def test_a_proxy_or_certificates_that_cannot_be_used_are_named(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    monkeypatch.setenv(name, value)
    done = run("whoami", "--server", "https://127.0.0.1:9")
    assert (done.exit_code, done.stdout) == (2, "")
    assert name in done.stderr
    assert "output" not in done.stderr
    assert ".." not in done.stderr


@pytest.mark.parametrize(
    ("variable", "proxy", "spared", "is_named"),
    [
        ("http_proxy", "http://me:hush@127.0.0.1:9/", "", True),
        ("http_proxy", "127.0.0.1:9", "", True),
        ("http_proxy", "http://me:hush@127.0.0.1:9", "127.0.0.1", False),
        ("all_proxy", "http://me:hush@127.0.0.1:9", "", True),
    ],
)
def test_a_proxy_that_does_not_answer_is_named_without_its_password(
    monkeypatch: pytest.MonkeyPatch, variable: str, proxy: str, spared: str, is_named: bool
) -> None:
    monkeypatch.setattr("exceptiondrive.transport.LONGEST_OF_ALL_RETRIES_S", -1.0)  # asked once
    monkeypatch.setenv(variable, proxy)
    monkeypatch.setenv("no_proxy", spared)
    done = run("whoami", "--server", "http://127.0.0.1:10")
    assert done.exit_code == 5
    assert ("through the proxy 127.0.0.1:9:" in done.stderr) == is_named
    assert ("NO_PROXY" in done.stderr) == is_named
    assert "hush" not in done.stderr


def test_done_is_0(canned_server: "CannedServer") -> None:
    canned_server.answer("GET /me", 200, ME)
    done = run("whoami", "--server", canned_server.url)
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0] == f"team alpha at {canned_server.url}"


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({}, "organizer"),
        ({"role": "owner", "phases": []}, "organizer (owner, of the whole site)"),
        ({"role": "helper", "phases": ["a", "b"]}, "organizer (helper, of a, b alone)"),
    ],
)
def test_an_organizer_reads_its_role_in_words(
    canned_server: "CannedServer", told: dict[str, Any], words: str
) -> None:
    canned_server.answer("GET /me", 200, {**ME, "team": None, **told})
    done = run("whoami", "--server", canned_server.url)
    assert done.stdout.splitlines()[0] == f"{words} at {canned_server.url}"


@pytest.mark.parametrize(
    "arguments",
    [
        ["nonsense"],
        ["check"],
        ["submit", "planner.json", "--method", "Planner"],
        ["submit", "planner.json", "--phase", "dev"],
        ["evaluate", "planner.json"],
        ["whoami", "--server", "not an address"],
        ["check", "planner.json", "--split", "a", "--phase", "b"],
        ["submissions", "--status", "asleep"],
        ["whoami", "--token", "edk_t_1"],
    ],
)
def test_wrong_arguments_are_2(arguments: list[str]) -> None:
    done = run(*arguments)
    assert done.exit_code == 2
    assert done.stdout == ""
    assert done.stderr


def test_an_invalid_file_is_2_and_every_fault_is_shown(planning_file: MakeFile) -> None:
    path = planning_file(schema="exceptiondrive.planning/1", split=5, extra=1)
    done = run("check", path)
    assert done.exit_code == 2
    assert "planner.json is not valid: 2 faults of 2 kinds" in done.stdout
    assert "unknown_key" in done.stdout
    assert "wrong_type" in done.stdout


def test_a_valid_file_is_0(planning_file: MakeFile, split_file: Path) -> None:
    done = run("check", planning_file(), "--split", split_file)
    assert done.exit_code == 0
    assert done.stderr.startswith("The sources could not be compared with recorded drives")
    first, note, *profile = done.stdout.splitlines()
    assert first == "planner.json is valid: planning, 4 predictions, split tiny"
    assert "will be flagged Blind to the edit: source and edited are alike in 100%" in note
    assert [" ".join(line.split()) for line in profile] == [
        "source speed median 8.00 m/s",
        "standing still sources 0.0%, edited 0.0%",
        "equal pairs source and edited alike 100.0%",
        "longer source the source is the longer one 0.0%",
    ]


def test_check_says_when_sample_ids_were_not_checked(planning_file: MakeFile) -> None:
    assert "Only the form was checked" in run("check", planning_file()).stderr


def test_check_json_is_the_report_of_the_server(planning_file: MakeFile, split_file: Path) -> None:
    from exceptiondrive_schemas.faults import CheckReport

    done = run("check", planning_file(predictions=[]), "--split", split_file, "--json")
    assert done.exit_code == 2
    report = CheckReport.model_validate_json(done.stdout)
    assert [(group.code.value, group.count) for group in report.faults] == [("missing_sample", 4)]


def test_check_takes_a_manifest_but_only_one_source_of_samples(
    planning_file: MakeFile, split_file: Path, tmp_path: Path
) -> None:
    manifest = {
        "schema": "exceptiondrive.manifest/1",
        "name": "tiny",
        "title": "Tiny",
        "revision": "sha256:00",
        "waypoints": 6,
        "time_step_s": 0.5,
        "sample_ids": ["s0", "s1", "s2", "s3", "s4"],
    }
    path = tmp_path / "manifest.json"
    path.write_text(json.dumps(manifest))
    done = run("check", planning_file(), "--manifest", path)
    assert done.exit_code == 2
    assert "missing_sample" in done.stdout
    both = run("check", planning_file(), "--manifest", path, "--split", split_file)
    assert (both.exit_code, both.stdout) == (2, "")
    wrong = run("check", planning_file(), "--manifest", split_file)
    assert "is not a manifest" in wrong.stderr


def test_evaluate_shows_both_aggregates_labelled(planning_file: MakeFile, split_file: Path) -> None:
    done = run("evaluate", planning_file(), "--split", split_file)
    assert done.exit_code == 0, done.stderr
    for words in (
        "mean of families",
        "mean of samples",
        "Sudden Emergence",
        "LB1 stalled_vehicle",
        "Blind to the edit",
    ):
        assert words in done.stdout


def test_evaluate_says_which_samples_of_a_file_count(
    planning_file: MakeFile, split_file: Path, tmp_path: Path
) -> None:
    split = json.loads(split_file.read_text())
    split["samples"][0]["withdrawn"] = "its hazard is hidden by a bus"
    path = tmp_path / "withdrawn.json"
    path.write_text(json.dumps(split))
    done = run("evaluate", planning_file(), "--split", path)
    assert done.exit_code == 0, done.stderr
    words = " ".join(done.stdout.split())
    assert "4 samples, 3 of them in the score, the others controls or withdrawn" in words


def test_evaluate_works_out_nothing_that_it_does_not_say(
    planning_file: MakeFile, split_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from exceptiondrive_schemas import split
    from exceptiondrive_schemas.check.planning_rules import PlanningRules

    def must_not_be_asked(*_: object) -> None:
        raise AssertionError("nobody is told that")

    command = ("evaluate", planning_file(), "--split", split_file)
    before = run(*command)
    monkeypatch.setattr(split, "content_digest", must_not_be_asked)
    monkeypatch.setattr(PlanningRules, "unranked_because", must_not_be_asked)
    done = run(*command)
    assert (done.exit_code, done.stdout) == (0, before.stdout)
    assert isinstance(run(*command, "--json").exception, AssertionError), "the sheet names it"


def test_evaluate_json_is_the_exact_sheet(planning_file: MakeFile, split_file: Path) -> None:
    from exceptiondrive import evaluate_file
    from exceptiondrive_schemas.score_sheet import ScoreSheet

    done = run("evaluate", planning_file(), "--split", split_file, "--json")
    exact = evaluate_file(planning_file(), split=split_file)
    assert ScoreSheet.model_validate_json(done.stdout) == exact


def test_evaluate_follows_another_protocol(
    planning_file: MakeFile, split_file: Path, tmp_path: Path
) -> None:
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    path = tmp_path / "1.1.toml"
    path.write_text(toml, encoding="utf-8")
    done = run("evaluate", planning_file(), "--split", split_file, "--protocol", path, "--json")
    assert json.loads(done.stdout)["protocol"]["version"] == "1.1"
    path.write_text("version = 3", encoding="utf-8")
    assert run("check", planning_file(), "--protocol", path).exit_code == 2
    unknown = run("check", planning_file(), "--protocol", "9.9")
    assert "neither a protocol file nor a version" in unknown.stderr


def test_evaluate_without_numpy_names_the_extra(
    planning_file: MakeFile, split_file: Path, tmp_path: Path
) -> None:
    """A module that cannot be found, as on a machine without the extra."""
    code = (
        "import sys; sys.modules['numpy'] = None; "
        f"sys.argv = ['exceptiondrive', 'evaluate', {str(planning_file())!r}, "
        f"'--split', {str(split_file)!r}]; from exceptiondrive.cli import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert 'pip install "exceptiondrive[evaluate]"' in done.stderr


def test_convert_says_exactly_what_it_did(planning_file: MakeFile, tmp_path: Path) -> None:
    sideways = [[0.0, 2.0 * step] for step in range(7)]
    path = planning_file(predictions=[{"sample_id": "s0", "source": sideways, "edited": None}])
    output = tmp_path / "out.json"
    done = run("convert", path, "-o", output, "--rotate", "-90")
    assert done.exit_code == 0, done.stderr
    first, *rest = done.stdout.splitlines()
    assert first == "- turned by -90 degrees: (x, y) -> (y, -x)"
    assert rest[:3] == [
        "- left out the first point of 1 trajectories: within 0.05 m of the origin, it is t = 0",
        "1 prediction",
        f"{output} is valid: planning, 1 prediction, split tiny",
    ]
    assert json.loads(output.read_text())["predictions"][0]["source"][0] == [2.0, 0.0]
    assert run("check", output).exit_code == 0


def test_what_is_written_over_is_said_and_what_is_read_is_left_as_it_is(
    planning_file: MakeFile, tmp_path: Path
) -> None:
    path, output = planning_file(), tmp_path / "out.json"
    for there in (False, True):
        done = run("convert", path, "-o", output)
        assert (done.exit_code, f"{output} was there, and is replaced" in done.stderr) == (0, there)
    rules = tmp_path / "rules.toml"
    rules.write_text(packaged_protocol_toml("1.1"))
    for option, read in (("--rotate=-90", path), ("--manifest", output), ("--protocol", rules)):
        kept, value = read.read_bytes(), () if "=" in option else (read,)
        done = run("convert", path, option, *value, "-o", read)
        assert (done.exit_code, "is what is read; it was left as it is" in done.stderr) == (2, True)
        assert read.read_bytes() == kept


def test_convert_says_where_there_was_no_mode_to_choose(
    planning_file: MakeFile, tmp_path: Path
) -> None:
    said = "- no trajectory has several modes: --mode 3 chose nothing"
    output = ("-o", tmp_path / "out.json")
    assert said in run("convert", planning_file(), "--mode", 3, *output).stdout.splitlines()
    token_file = tmp_path / "run.json"
    token_file.write_text(json.dumps({f"s{number}": STRAIGHT for number in range(4)}))
    runs = ("--source-run", token_file, "--edited-run", token_file, "--split", "tiny")
    assert said in run("convert", *runs, "--mode", 3, *output).stdout.splitlines()
    modes = {"predictions": [{"sample_id": "s0", "source": [STRAIGHT] * 4, "edited": None}]}
    assert said not in run("convert", planning_file(**modes), "--mode", 3, *output).stdout


def test_convert_says_or_refuses_what_goes_against_the_files(
    planning_file: MakeFile, tmp_path: Path
) -> None:
    output = tmp_path / "o.json"
    pairs = ("convert", planning_file(), "-o", output)
    assert f"- split {SPLIT['name']} -> other" in run(*pairs, "--split", "other").stdout
    assert "->" not in run(*pairs, "--split", SPLIT["name"]).stdout
    refused = run(*pairs, "--from", "vad")
    assert (refused.exit_code, "--from says whose form two runs have" in refused.stderr) == (
        2,
        True,
    )


def test_a_number_of_more_digits_than_python_reads_becomes_null(tmp_path: Path) -> None:
    path, output = tmp_path / "a.jsonl", tmp_path / "o.json"
    point = f"[1{'0' * 5000}, 0.0]"
    points = ", ".join([point, *["[1.0, 0.0]"] * 5])
    path.write_text(f'{{"sample_id": "s0", "source": null, "edited": [{points}]}}\n')
    done = run("convert", path, "-o", output, "--split", "tiny", "--null-invalid")
    assert (done.exit_code, "null: s0" in done.stdout) == (0, True), done.stderr


def test_convert_needs_a_split_and_sound_options(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text('{"sample_id": "s0", "source": null, "edited": null}\n')
    output = tmp_path / "o.json"
    assert "Add --split NAME" in run("convert", path, "-o", output).stderr
    named = ("convert", path, "-o", output, "--split", "tiny")
    assert run(*named, "--follows", "camera").exit_code == 2
    assert run(*named, "--origin-offset-m", "nan").exit_code == 2
    assert "cannot be written" in run(*named[:3], tmp_path / "none" / "o", *named[4:]).stderr
    done = run(*named, "--json")
    assert json.loads(done.stdout) == {
        "output": str(output),
        "split": "tiny",
        "n_predictions": 1,
        "size_bytes": output.stat().st_size,
        "done": ["read predictions in another form than that of a submission"],
        "nulled": [],
    }
    assert run(*named, "--rotate", "45").exit_code == 2
    assert run(*named, "--time-step-s", "0").exit_code == 2
    assert run(*named, "--from", "unidad", "--source-run", path).exit_code == 2
    assert run(*named, "--source-run", path).exit_code == 2


def test_convert_never_writes_what_is_not_valid(planning_file: MakeFile, tmp_path: Path) -> None:
    leap = [[40.0 * step, 0.0] for step in range(1, 7)]
    path = planning_file(predictions=[{"sample_id": "s0", "source": leap, "edited": None}])
    output = tmp_path / "out.json"
    done = run("convert", path, "-o", output)
    assert done.exit_code == 2
    assert "no waypoint was moved" not in done.stdout
    assert "step_too_long" in done.stdout
    assert "was not written" in done.stderr
    assert not output.exists()
    done = run("convert", path, "-o", output, "--mirror")
    assert (done.exit_code, done.stderr.splitlines()[0]) == (2, "- mirrored: (x, y) -> (x, -y)")
    done = run("convert", path, "-o", output, "--null-invalid")
    assert done.exit_code == 0
    assert "  null: s0: source has a coordinate of 240 m, out of bounds" in done.stdout
    assert json.loads(output.read_text())["predictions"][0]["source"] is None


def test_convert_tells_all_faults_of_what_is_nearly_a_submission_at_once(
    planning_file: MakeFile, tmp_path: Path
) -> None:
    six = [[2.0 * step, 0.0] for step in range(1, 7)]
    twice = {"sample_id": "s0", "source": six, "edited": None}
    path = planning_file(predictions=[{**twice, "note": 1}, twice, {"source": six, "edited": "x"}])
    done = run("convert", path, "-o", tmp_path / "out.json")
    assert done.exit_code == 2
    assert "s0: unknown key note" in done.stderr
    for code in ("unknown_key", "duplicate_sample", "missing_key"):
        assert code in done.stdout


@pytest.mark.parametrize(
    ("planner", "content", "form"),
    [(("--from", "waymo"), '{"n0": {"of_another_form": 1}}', "waymo"), ((), "{}", "trajectories")],
)
def test_convert_says_where_it_found_nothing(
    planner: tuple[str, ...], content: str, form: str, tmp_path: Path
) -> None:
    file, out = tmp_path / "run.json", tmp_path / "out.json"
    file.write_text(content)
    runs = (*planner, "--source-run", str(file), "--edited-run", str(file))
    done = run("convert", *runs, "--split", "sample", "--output", str(out))
    assert done.exit_code == 2
    assert "No prediction was found" in done.stderr
    assert f"Runs in the form of {form} look as docs/client.md says." in done.stderr
    assert not out.exists()


def test_convert_takes_two_runs_and_checks_them_with_the_manifest(
    tmp_path: Path,
) -> None:
    known = ["s0", "s1", "s2"]
    manifest_file, run_file, output = (tmp_path / name for name in ("m.json", "run.json", "o.json"))
    manifest_file.write_text(
        json.dumps(
            {
                "schema": "exceptiondrive.manifest/1",
                "name": "tiny",
                "title": "Tiny",
                "revision": "sha256:" + "0" * 64,
                "waypoints": 6,
                "time_step_s": 0.5,
                "sample_ids": known,
            }
        )
    )
    sideways = [[[0.0, 2.0 * step] for step in range(1, 7)]]
    runs = ("--from", "uniad", "--source-run", run_file, "--edited-run", run_file)
    command = ("convert", "-o", output, *runs, "--manifest", manifest_file)
    run_file.write_text(json.dumps(dict.fromkeys(known, sideways)))
    done = run(*command)
    assert done.exit_code == 0, done.stderr
    assert run("check", output, "--manifest", manifest_file).exit_code == 0
    run_file.write_text(json.dumps(dict.fromkeys(known[1:], sideways)))
    done = run(*command)
    assert done.exit_code == 2
    assert "missing_sample" in done.stdout


def test_check_names_every_sample_where_asked(planning_file: MakeFile) -> None:
    leap = [[40.0 * step, 0.0] for step in range(1, 6)] + [[0.0, 0.0]]
    ids = [f"sample-{number}" for number in range(9)]
    path = planning_file(
        predictions=[{"sample_id": each, "source": leap, "edited": leap} for each in ids]
    )
    short = run("check", path)
    assert "step_too_long  108 steps in 9 of 9 samples" in short.stdout
    assert "... and 4 samples more; --all names every one" in short.stdout
    assert ids[-1] not in short.stdout
    assert " ".join(ids) in " ".join(run("check", path, "--all").stdout.split())
    (group,) = json.loads(run("check", path, "--json").stdout)["faults"]
    assert group["sample_ids"] == ids
    assert [example["sample_id"] for example in group["examples"]] == ids


def test_an_error_is_json_too_where_json_was_asked_for(canned_server: "CannedServer") -> None:
    resets_at = "2026-11-22T00:00:00Z"
    canned_server.problem("GET /me", 429, "quota_exceeded", resets_at=resets_at)
    done = run("whoami", "--server", canned_server.url, "--json")
    assert done.exit_code == 3
    error = json.loads(done.stdout)["error"]
    assert (error["code"], error["exit_code"]) == ("quota_exceeded", 3)
    assert error["resets_at"] == "2026-11-22T00:00:00+00:00"


def test_login_reads_stdin_tries_the_token_and_keeps_it(
    canned_server: "CannedServer", home: Path
) -> None:
    canned_server.answer("GET /me", 200, ME)
    done = run("login", "--server", canned_server.url, stdin="edk_t_1\n")
    assert done.exit_code == 0, done.stderr
    assert "edk_t_1" not in done.stdout + done.stderr
    assert run("whoami").exit_code == 0, "the server of the last login is the usual one"
    sent = [{k.lower(): v for k, v in headers.items()} for headers in canned_server.headers]
    assert [headers["authorization"] for headers in sent] == ["Bearer edk_t_1"] * 2
    assert "forgotten" in run("logout").stdout
    assert "no token" in run("logout", "--server", canned_server.url).stdout


def test_a_token_that_is_refused_is_not_kept(canned_server: "CannedServer", home: Path) -> None:
    canned_server.problem("GET /me", 401, "not_signed_in")
    assert run("login", "--server", canned_server.url, stdin="wrong\n").exit_code == 4
    assert not list(home.rglob("credentials.json"))


def test_login_without_a_terminal_and_without_a_token_does_not_ask() -> None:
    done = run("login")
    assert done.exit_code == 4
    assert "No token was given" in done.stderr
    assert done.stdout == ""


def in_a_process(*arguments: object, **environment: str) -> "subprocess.CompletedProcess[str]":
    code = "from exceptiondrive.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
        env={**os.environ, **environment},
    )


def test_piped_output_has_no_colour_no_motion_and_whole_lines(
    planning_file: MakeFile, split_file: Path
) -> None:
    done = in_a_process("evaluate", planning_file(), "--split", split_file, TERM="xterm-256color")
    assert done.returncode == 0
    assert done.stderr == ""
    assert "\x1b" not in done.stdout
    assert "…" not in done.stdout


def test_a_stdout_that_was_closed_is_said_before_anything_is_done() -> None:
    code = "import sys; sys.stdout = None; from exceptiondrive.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=False
    )
    closed = "error: The output cannot be written: stdout is closed.\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", closed)


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="needs /dev/full")
@pytest.mark.parametrize("arguments", [(), ("--json",), ("--split", "none.json", "--json")])
def test_a_full_disk_behind_stdout_is_said_in_one_sentence(
    planning_file: MakeFile, arguments: tuple[str, ...]
) -> None:
    code = "from exceptiondrive.cli import main; main()"
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", code, "check", str(planning_file()), *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert "error: The output cannot be written: No space left on device." in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_output_survives_a_terminal_that_knows_ascii_only(
    planning_file: MakeFile, split_file: Path
) -> None:
    done = in_a_process(
        "evaluate", planning_file(), "--split", split_file, PYTHONIOENCODING="ascii", LC_ALL="C"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are a POSIX matter")
@pytest.mark.parametrize(("no_color", "has_colour"), [("", True), ("1", False)])
def test_a_terminal_gets_colour_unless_no_color_is_set(
    planning_file: MakeFile, no_color: str, has_colour: bool
) -> None:
    import pty

    main_end, terminal = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "NO_COLOR": no_color}
    process = subprocess.Popen(
        [sys.executable, "-m", "exceptiondrive", "check", str(planning_file())],
        stdout=terminal,
        stderr=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
        env=environment,
    )
    output = os.read(main_end, 4096)
    process.wait()
    os.close(terminal)
    os.close(main_end)
    assert (b"\x1b[1;32m" in output) is has_colour
    assert b"is valid" in output


def test_the_version_is_an_option() -> None:
    done = run("--version")
    assert (done.exit_code, done.stdout) == (0, f"exceptiondrive {__version__}\n")


def test_help_says_whole_sentences_in_eighty_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = " ".join(run("--help").stdout.split())
    assert [words for _, words in COMMANDS.values() if words not in text] == []
    assert "..." not in text.partition("Commands:")[2]


def imported_by(command: list[str], heavy: set[str]) -> str:
    """Which of these modules a process of its own has imported once it has run a command."""
    code = (
        "import sys; from exceptiondrive.cli import app; "
        f"app({command!r}, standalone_mode=False); print(sorted({heavy!r} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1]


def test_help_imports_nothing_heavy() -> None:
    """`--help` stays fast: no HTTP library, no numpy, no models, no tables."""
    heavy = {"httpx", "numpy", "pydantic", "stamina", "rich.table", "platformdirs", "openai"}
    assert imported_by(["--help"], heavy) == "[]"


def test_the_table_of_commands_says_what_the_commands_say_of_themselves() -> None:
    group = get_group(app)
    context = typer.Context(group)
    for name, (_, words) in COMMANDS.items():
        command = group.get_command(context, name)
        assert command is not None, name
        assert (command.help or "").split("\n\n")[0].replace("\n", " ") == words


def test_one_command_is_made_of_all_in_its_module() -> None:
    group = get_group(app)
    assert group.get_command(typer.Context(group), "status") is not None
    assert list(group.commands) == ["status"]


def test_evaluate_alone_touches_the_scoring_package(planning_file: MakeFile) -> None:
    heavy = {"numpy", "exceptiondrive_scoring", "httpx"}
    assert imported_by(["check", str(planning_file())], heavy) == "[]"


def test_a_check_imports_nothing_of_submissions_drawings_or_progress(
    planning_file: MakeFile,
) -> None:
    schemas = "exceptiondrive_schemas"
    heavy = {f"{schemas}.{name}" for name in ("api.submission", "api.rescoring", "drawing")}
    assert imported_by(["check", str(planning_file())], heavy | {"rich.progress"}) == "[]"


def test_an_evaluate_imports_neither_drawings_nor_masked_arrays(
    planning_file: MakeFile, split_file: Path
) -> None:
    command = ["evaluate", str(planning_file()), "--split", str(split_file)]
    heavy = {"exceptiondrive_schemas.drawing", "exceptiondrive_scoring.drawing", "numpy.ma"}
    assert imported_by(command, heavy) == "[]"


def test_a_submit_imports_nothing_of_boards_receipts_rescoring_nor_what_draws_bars() -> None:
    """`httpx` itself imports bars where Click is installed, so it is left out here."""
    names = ("api.phase_report", "api.rescoring", "board", "receipt")
    heavy = {f"exceptiondrive_schemas.{name}" for name in names}
    code = (
        "import sys, exceptiondrive.cli.submission_commands; "
        "print('rich.progress' in sys.modules); import exceptiondrive.client; "
        f"print(sorted({heavy!r} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "[]"]


def test_a_check_looks_for_no_cycles(planning_file: MakeFile) -> None:
    """Not once while it imports, reads and tells, where Python by itself would do so many times.

    What is held at the end is kept from the last look, too.
    """
    code = (
        "import gc, sys; from exceptiondrive.__main__ import main; begun = []; "
        "gc.callbacks.append(lambda phase, _: begun.append(phase)); "
        f"sys.argv = ['exceptiondrive', 'check', {str(planning_file())!r}]\n"
        "try: main()\n"
        "finally:\n"
        "    gc.callbacks.clear(); print('collections:', begun.count('start'))\n"
        "    print('kept:', gc.get_freeze_count() > len(gc.get_objects()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-2:] == ["collections: 0", "kept: True"]


@pytest.mark.parametrize(
    "words",
    [
        "convert {long}",
        "convert --source-run {long} --edited-run {long} --split dev",
        "convert {file} --output {long}",
        "remind {long} --out {long} --base-url http://127.0.0.1:9/v1 --model m",
        "organizer protocols key --key {long}",
    ],
)
def test_a_name_too_long_for_any_file_is_named(words: str, planning_file: MakeFile) -> None:
    long = "x" * 300
    done = run(*words.format(long=long, file=planning_file()).split())
    assert done.exit_code == 2, done.exception
    assert f"error: {long}" in done.stderr
