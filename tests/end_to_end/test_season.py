"""A season on real processes, as its organizers run it from the command line.

Clone last year's phase, announce, open, a question, 40 teams, a disqualification, a withdrawn sample
together with protocol 1.1, freeze, reveal, close, report, export, archive, forget one team: at the end every
board has the digest that it was published with.
"""

import gzip
import json
import shutil
import sqlite3
import tarfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from tests.support import extract
from tests.support.floors import leave_open
from tests.support.processes import wait_until
from tests.support.system import System, running_system

from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.split import Split

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
PHASE, LAST_YEAR, N_TEAMS = "year-2", "year-1", 40
WHY = ("--reason", "as the rules say")
MADE = extract.make_extract()


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """A system with a withheld split and last year's phase."""
    base = tmp_path_factory.mktemp("season")
    MADE.write(base / "files")
    leave_open(base / "splits" / extract.NAME)
    shutil.copy(base / "files" / "split.json.gz", base / "splits" / extract.NAME / "split.json.gz")
    with running_system(base / "data", base / "splits") as running:
        running.work("register-splits")
        running.open_phase(LAST_YEAR, extract.NAME, "--rejected-per-day", "7")
        yield running


def board(system: System) -> dict[str, Any]:
    """The public board, by team."""
    entries = system.get(f"/leaderboard?phase={PHASE}")["entries"]
    return {entry["team"]: entry for entry in entries if entry["source"] == "scored"}


def digests(system: System) -> dict[int, tuple[str, str]]:
    """Of every board of the season: of what it says, and of its bytes."""
    with sqlite3.connect(system.data / "records.sqlite3") as records:
        query = "SELECT number, digest, body_digest FROM boards WHERE phase_id = ?"
        return {number: (said, body) for number, said, body in records.execute(query, [PHASE])}


def rescore(system: System, *words: str) -> Any:
    return json.loads(system.organize("rescore", *words, "--json"))


def without_a_sample(system: System, folder: Path) -> str:
    """Register a revision of the split of which one sample is withdrawn."""
    later = json.loads(json.dumps(MADE.split))
    later["samples"][0]["withdrawn"] = "The region lies on the wrong lane."
    file, text = folder / "split.json.gz", json.dumps(later)
    file.write_bytes(gzip.compress(text.encode()))
    system.work("add-split", file, "--words", "One sample of the audit is withdrawn.")
    return Split.model_validate_json(text).revision


def test_a_season_from_clone_to_archive(system: System, tmp_path: Path) -> None:
    organize = system.organize
    options = ("--split", extract.NAME, "--protocol", "1.0", "--title", "The second year")
    organize("phases", "create", PHASE, "--like", LAST_YEAR, *options)
    assert system.get(f"/phases/{PHASE}")["rejected_per_day"] == 7, "taken over from last year"
    table = tmp_path / "teams.csv"
    lines = (f"team-{n},Team {n},Lab {n}" for n in range(N_TEAMS))
    table.write_text("\n".join(("id,name,affiliation", *lines)), encoding="utf-8")
    made = json.loads(organize("teams", "import", str(table), "--json"))["teams"]
    tokens = {team["id"]: team["token"] for team in made}
    text = tmp_path / "text.txt"
    text.write_text("The phase is open.", encoding="utf-8")
    message = ("message", "We begin", "--text", str(text), "--yes")
    assert f"sent to {N_TEAMS} teams" in organize(*message)
    told = json.loads(system.client("notices", "--json", token=tokens["team-39"]).stdout)
    assert [(one["kind"], one["title"]) for one in told] == [("message", "We begin")]

    asked = ("ask", "May a planner use a map?", "--phase", PHASE, "--json")
    question = json.loads(system.client(*asked, token=tokens["team-7"]).stdout)["id"]
    organize("questions", "answer", question, "--text", "Any map.", "--to-all")
    page = system.read(f"/phases/{PHASE}")
    assert ("Any map." in page, "Team 7" in page) == (True, False)

    ids = {}
    for number, (team, token) in enumerate(tokens.items()):
        file = tmp_path / f"{team}.json"
        file.write_bytes(extract.varied(MADE.files["braking"], number))
        ids[team] = system.post(token, file, PHASE, "Planner")["id"]
    wait_until(lambda: len(board(system)) == N_TEAMS, "forty entries on the board", 400)

    note = ("--public-note", "Drew on what is withheld.")
    organize("submissions", "disqualify", ids["team-3"], *WHY, *note)
    wait_until(lambda: "Team 3" not in board(system), "a board without the entry", 120)
    notes = system.get(f"/phases/{PHASE}/disqualifications")
    assert [(one["team"], one["note"]) for one in notes] == [("Team 3", note[1])]
    again = system.client(
        *("submit", str(tmp_path / "team-3.json"), "--phase", PHASE, "--method", "Again"),
        token=tokens["team-3"],
    )
    assert (again.returncode, "disqualified" in again.stderr) == (4, True)
    assert len(board(system)) == N_TEAMS - 1

    toml = tmp_path / "1.1.toml"
    toml.write_text(packaged_protocol_toml("1.1"), encoding="utf-8")
    organize("protocols", "add", str(toml))
    revision = without_a_sample(system, tmp_path)
    run = rescore(
        system,
        *("start", "--phase", PHASE, "--protocol", "1.1", "--split-revision", revision, *WHY),
    )["id"]
    wait_until(
        lambda: rescore(system, "status", run)["state"] == "ready", "the update to be ready", 400
    )
    preview = rescore(system, "preview", run)
    rescore(system, "apply", run, "--preview", preview["digest"], *WHY)
    now = system.get(f"/leaderboard?phase={PHASE}")
    assert (now["protocol"]["version"], now["n_samples"]) == ("1.1", extract.N_SAMPLES - 1)
    assert "withdrawn" in system.read(f"/history?phase={PHASE}")
    assert len(board(system)) == N_TEAMS - 1

    before = digests(system)
    organize("phases", "freeze", PHASE, *WHY)
    organize("teams", "disqualify", "team-4", "--phase", PHASE, *WHY)
    wait_until(lambda: len(digests(system)) > len(before), "a board behind the freeze", 120)
    assert "Team 4" in board(system)
    soon = datetime.now(UTC) + timedelta(seconds=30)
    organize("phases", "update", PHASE, "--closes-at", soon.isoformat())
    wait_until(lambda: datetime.now(UTC) > soon, "the deadline", 120)
    organize("phases", "reveal", PHASE, "--what", "board", "--yes", *WHY)
    wait_until(lambda: "Team 4" not in board(system), "the revealed board", 120)
    wait_until(lambda: f"/phases/{PHASE}/report" in system.read(f"/phases/{PHASE}"), "the end", 120)
    organize("phases", "update", PHASE, "--visibility", "archived")
    report = json.loads(system.client("report", PHASE, "--json").stdout)
    last = system.get(f"/leaderboard?phase={PHASE}")
    frozen = system.get(f"/boards/{PHASE}/{report['shake_up']['board']}")
    ranks = [{e["submission_id"]: e["rank"] for e in each["entries"]} for each in (frozen, last)]
    assert (ids["team-4"] in ranks[0], ids["team-4"] in ranks[1]) == (True, False)
    for one in report["shake_up"]["places"]:
        name = one["submission_id"]
        assert (one["before"], one["after"]) == (ranks[0].get(name), ranks[1].get(name))
    assert (report["board"], report["n_submissions"]) == (last["board"], N_TEAMS)
    assert report["protocols"] == ["1.0", "1.1"]
    archive = tmp_path / "year-2.tar"
    organize("phases", "export", PHASE, "--output", str(archive))
    with tarfile.open(archive) as tar:
        held = {name.split("/", 1)[1] for name in tar.getnames()}
    assert {"README.md", "report.json", f"boards/board-{last['board']}.json"} <= held
    assert sum(name.startswith("every_eval_ever/") for name in held) == len(board(system))

    numbers = digests(system)
    assert {number: numbers[number] for number in before} == before
    current = system.get(f"/leaderboard?phase={PHASE}")["board"]
    shown = system.get(f"/boards/{PHASE}/{current}")
    organize("teams", "forget", "team-5", "--yes", *WHY)
    told_now = system.get(f"/boards/{PHASE}/{current}")
    names = {entry["submission_id"]: entry["team"] for entry in told_now["entries"]}
    assert names[ids["team-5"]].startswith("Former team ")
    assert [one["metrics"] for one in told_now["entries"]] == [
        one["metrics"] for one in shown["entries"]
    ]
    for path in (f"/?phase={PHASE}", f"/history?phase={PHASE}", f"/entries/{ids['team-5']}"):
        assert "Team 5<" not in system.read(path), path
    assert {number: digests(system)[number] for number in numbers} == numbers
    assert "the audit log is intact" in organize("audit", "verify")
    system.operate("exceptiondrive-server", "verify")  # fails where an invariant is broken
