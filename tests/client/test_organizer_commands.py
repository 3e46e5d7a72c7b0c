import json
import re
import tarfile
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import text
from tests.client.servers import run
from tests.phases.life import SAMPLES, split_of
from tests.support.records import add_sample_split
from tests.support.worker import add_split
from typer.testing import CliRunner

from exceptiondrive import Client, to_dataframe
from exceptiondrive.cli import app
from exceptiondrive.cli.organizer import rescoring
from exceptiondrive_records.audit.log import SPLIT_FLOOR_HELD, audit
from exceptiondrive_schemas.api.rescoring import (
    Comparison,
    EntryChange,
    PreviewView,
    Progress,
    RunState,
    RunView,
    SplitTrial,
    Standing,
)
from exceptiondrive_schemas.api.similarity import SimilarityReport
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.protocols.difference import Difference, Stage
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef

if TYPE_CHECKING:
    from tests.client.servers import CannedServer, Running


def organize(server: "Running", *arguments: object, token: str | None = None) -> Any:
    """Run an organizer's command."""
    return run(server, "organizer", *arguments, token=token or server.organizer_token)


def standings(server: "Running") -> dict[str, str]:
    """How each team stands, as the list says."""
    teams = json.loads(organize(server, "teams", "list", "--json").stdout)
    return {team["id"]: team["standing"] for team in teams}


def test_a_team_gets_a_token_that_works_until_it_is_revoked(running: "Running") -> None:
    assert organize(running, "teams", "create", "beta", "Team Beta").exit_code == 0
    teams = json.loads(organize(running, "teams", "list", "--json").stdout)
    assert [team["id"] for team in teams] == ["alpha", "beta"]
    issued = organize(running, "teams", "issue-token", "beta", "--name", "laptop")
    token = issued.stdout.strip()
    with Client(running.url, token) as client:
        assert client.me().team == "Team Beta"
    listed = json.loads(organize(running, "teams", "tokens", "beta", "--json").stdout)
    assert [row["name"] for row in listed] == ["laptop"]
    assert token not in json.dumps(listed)
    assert organize(running, "teams", "revoke-token", listed[0]["id"]).exit_code == 0
    assert organize(running, "teams", "list", token=token).exit_code == 4


def test_a_team_is_made_with_its_first_token(running: "Running") -> None:
    made = organize(running, "teams", "create", "gamma", "Gamma", "--with-token")
    token = made.stdout.strip()
    assert "shown only once" in made.stderr
    with Client(running.url, token) as client:
        assert client.me().team == "Gamma"


def test_what_is_made_twice_is_a_conflict(running: "Running") -> None:
    done = organize(running, "teams", "create", "alpha", "Again")
    assert done.exit_code == 4
    assert "alpha" in done.stderr


def test_a_team_may_not_organize(running: "Running") -> None:
    done = organize(running, "teams", "list", token=running.token)
    assert done.exit_code == 4
    assert "scope" in done.stderr


def test_a_phase_is_made_on_a_registered_split(running: "Running") -> None:
    splits = organize(running, "splits", "list")
    (tiny,) = json.loads(organize(running, "splits", "list", "--json").stdout)
    assert f" {tiny['revision']} " in splits.stdout, "in one piece, to be copied"
    made = organize(
        running,
        *("phases", "create", "test", "--title", "Test", "--split", "tiny"),
        *("--quota-per-day", "5", "--closes-at", "2030-01-01T00:00:00Z"),
    )
    told, _, note = made.stdout.partition("\n")
    assert (made.exit_code, told) == (
        0,
        "phase test created, 4 samples, protocol 1.0, quota 5 a day",
    )
    assert note.startswith("its teams are told: This split has no recorded drives")
    assert "accepts no files now" not in note
    over = ("phases", "create", "over", "--title", "Over", "--split", "tiny")
    made = organize(running, *over, "--closes-at", "2020-01-01T00:00:00Z")
    assert made.stdout.endswith("\nit accepts no files now: check its dates and visibility\n")
    with Client(running.url) as client:
        assert client.phase("test").quota_per_day == 5
    add_split(running.context.database, running.context.splits.folder, split_of(SAMPLES, "parted"))
    made = organize(running, "phases", "create", "p", "--title", "P", "--split", "parted")
    assert made.stdout.startswith("phase p created, 2 samples, ")
    few = ("phases", "create", "few", "--title", "Few", "--split", "tiny", "--quota-total", "20")
    assert " a day, 20 in all\n" in organize(running, *few).stdout
    unknown = organize(running, "phases", "create", "x", "--title", "X", "--split", "none")
    assert unknown.exit_code == 2


@pytest.mark.parametrize(("said", "quota_total"), [((), 20), (("--quota-total", "none"), None)])
def test_no_limit_is_another_thing_than_nothing_said(
    running: "Running", said: tuple[str, ...], quota_total: int | None
) -> None:
    """A withheld split has a limit unless it is told otherwise."""
    with running.context.database.write() as session:
        add_sample_split(session)
    new = ("phases", "create", "next", "--title", "New", "--split", "sample", "--protocol", "1.0")
    made = organize(running, *new, *said, "--json")
    assert json.loads(made.stdout)["quota_total"] == quota_total


def test_a_protocol_is_added_once_and_checked_before_it_is_sent(
    running: "Running", tmp_path: Path
) -> None:
    path = tmp_path / "1.1.toml"
    path.write_text(packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"'))
    assert " added, sha256:" in organize(running, "protocols", "add", path).stdout
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())  # as some editors begin a file
    again = organize(running, "protocols", "add", path)
    assert (again.exit_code, "nothing was added" in again.stdout) == (0, True)
    listed = json.loads(organize(running, "protocols", "list", "--json").stdout)
    assert [row["version"] for row in listed] == ["1.0", "1.1"]
    for phase, chosen, version in (("a", (), "1.0"), ("b", ("--protocol", "1.1"), "1.1")):
        create = ("phases", "create", phase, "--title", phase, "--split", "tiny", *chosen, "--json")
        assert json.loads(organize(running, *create).stdout)["protocol"] == version
    path.write_text("version = 3")
    assert organize(running, "protocols", "add", path).exit_code == 2
    path.write_bytes(b"\xff\xfe")
    assert "is not UTF-8 text" in organize(running, "protocols", "add", path).stderr


@pytest.mark.parametrize("command", ["check", "diff"])
def test_what_nobody_can_mean_is_refused_at_home(
    running: "Running", tmp_path: Path, command: str
) -> None:
    path = tmp_path / "new.toml"
    text = packaged_protocol_toml().replace('version = "1.0"', 'version = "9.1"')
    path.write_text(re.sub(r"footprint_length_m = .*", "footprint_length_m = 60.0", text))
    done = organize(running, "protocols", command, path)
    assert (done.exit_code, "no vehicle is 60 m" in done.stderr) == (2, True)


def test_a_tampered_audit_log_is_found(running: "Running") -> None:
    whole = organize(running, "audit", "verify")
    assert whole.exit_code == 0
    assert "is intact" in whole.stdout
    head = whole.stdout.split()[-1]
    assert organize(running, "audit", "verify", "--head", head).exit_code == 0
    cut = organize(running, "audit", "verify", "--head", "f" * 64)
    assert (cut.exit_code, "was CUT OFF" in cut.stdout) == (1, True)
    assert "phase created" in organize(running, "audit", "list").stdout
    few = json.loads(organize(running, "audit", "list", "--limit", "2", "--json").stdout)
    assert len(few) == 2
    late = organize(running, "audit", "list", "--since", few[1]["at"], "--json").stdout
    assert [line["id"] for line in json.loads(late)] == [line["id"] for line in few]
    assert (
        json.loads(organize(running, "audit", "list", "--since", "2999-01-01", "--json").stdout)
        == []
    )
    assert organize(running, "audit", "list", "--since", "lately").exit_code == 2
    lines = json.loads(organize(running, "audit", "list", "--json").stdout)
    made = organize(running, "audit", "list", "--action", "phase created", "--json").stdout
    assert json.loads(made) == [line for line in lines if line["action"] == "phase created"]
    ids, cut = [line["id"] for line in lines], ("audit", "list", "--limit", "2")
    shown = organize(running, *cut).stdout.splitlines()
    assert shown[-1] == f"at most 2 are shown: --before {ids[1]} shows older ones"
    older = json.loads(organize(running, *cut, "--before", ids[1], "--json").stdout)
    assert [line["id"] for line in older] == ids[2:4]
    assert "are shown" not in organize(running, "audit", "list").stdout
    with running.context.database.write() as session:
        audit(session, "worker", SPLIT_FLOOR_HELD, "tiny", {"asked": ["d_safe_m is 6"]})
    assert "d_safe_m is 6" in organize(running, "audit", "list").stdout, "what workers refused"
    with running.context.database.write() as session:
        triggers = session.execute(text("SELECT name FROM sqlite_master WHERE type = 'trigger'"))
        for (name,) in list(triggers):
            session.execute(text(f'DROP TRIGGER "{name}"'))
        session.execute(text("UPDATE audit_lines SET action = 'nothing' WHERE id = 2"))
    broken = organize(running, "audit", "verify")
    assert broken.exit_code == 1
    assert "BROKEN at line 2" in broken.stdout


def test_the_report_of_alike_submissions_names_teams_and_is_for_organizers(
    working: "Running", planning_file: Any
) -> None:
    organize(working, "teams", "create", "beta", "Team Beta")
    token = organize(working, "teams", "issue-token", "beta", "--name", "x").stdout.strip()
    path = planning_file()
    for sender in (working.token, token):
        with Client(working.url, sender) as client:
            client.submit(path, phase="dev", method="Planner")
    text = organize(working, "similar", "--phase", "dev", "--json").stdout
    assert list(to_dataframe(SimilarityReport.read(text))["kind"]) == ["equal_files"]
    shown = organize(working, "similar", "--phase", "dev").stdout
    assert "equal files" in shown
    assert "Team Beta: Planner" in shown.replace("\n", " ")
    assert organize(working, "similar", "--phase", "dev", token=token).exit_code == 4
    assert organize(working, "similar", "--phase", "none").exit_code == 2


def test_a_season_with_teams_from_the_command_line(running: "Running", tmp_path: Path) -> None:
    table = tmp_path / "teams.csv"
    table.write_text("id,name,affiliation\nalef,Alef,Lab\nbet,Bet,\n", encoding="utf-8")
    made = organize(running, "teams", "import", table)
    assert (made.exit_code, made.stdout.count(",edk_")) == (0, 2)
    why = ("--reason", "asked for by mail")
    assert organize(running, "teams", "change", "bet", "--name", "Beth", *why).exit_code == 0
    assert organize(running, "teams", "change", "bet", *why).exit_code == 2
    out = organize(running, "teams", "disqualify", "bet", "--phase", "dev", *why, "--json")
    number = json.loads(out.stdout)["id"]
    assert "bet" in organize(running, "teams", "disqualified").stdout
    assert standings(running) == {"alpha": "", "alef": "", "bet": "disqualified in dev"}
    assert "disqualified in dev\n" in organize(running, "teams", "show", "bet").stdout
    assert organize(running, "teams", "reinstate", number, *why).stdout == "bet reinstated\n"
    own = ("teams", "limits", "bet", "--phase", "dev", *why)
    assert organize(running, *own).exit_code == 2
    assert organize(running, *own, "--quota-total", 0).exit_code == 2
    assert organize(running, *own, "--quota-total", 2).exit_code == 0
    limits = "team bet in dev: closes_at as for all teams, quota_per_day 3, quota_total {}\n"
    assert organize(running, *own, "--quota-per-day", 3).stdout == limits.format(2)
    back = organize(running, *own, "--quota-total", "none")
    assert back.stdout == limits.format("as for all teams")
    text = tmp_path / "text.txt"
    text.write_text("It moves.", encoding="utf-8")
    to = ("message", "The deadline", "--text", text, "--to", "alef", "--to", "bet")
    preview = organize(running, *to, "--preview").stdout
    assert "would reach 2 teams" in preview
    assert preview.endswith("as they read it:\n  The deadline\n  It moves.\n")
    assert "would reach 1 team\n" in organize(running, *to[:-2], "--preview").stdout
    assert "sent to 2 teams" in organize(running, *to, "--yes").stdout
    assert organize(running, *to, "--yes").exit_code == 4
    to_all = organize(running, *to[:4])
    assert to_all.exit_code == 2
    assert "Send this to 3 teams? It cannot be recalled. Nothing was sent." in " ".join(
        to_all.stderr.split()
    )
    merge = ("teams", "merge", "alef", "--into", "bet", *why)
    for action in (merge, ("teams", "forget", "alef", *why), ("people", "forget", "alef", *why)):
        unasked = organize(running, *action)
        assert (unasked.exit_code, "add --yes" in unasked.stderr) == (2, True)
    with pytest.MonkeyPatch.context() as on_terminal:
        on_terminal.setattr("exceptiondrive.cli.output.can_ask", lambda: True)
        for action in (
            merge,
            ("teams", "forget", "alef", *why),
            ("people", "forget", "alef", *why),
        ):
            asked = organize(running, *action)
            assert (asked.exit_code, "alef" in asked.stderr, "for good?" in asked.stderr) == (
                130,
                True,
                True,
            )
            assert ("Its tokens are revoked" in asked.stderr) == (action is merge)
        assert "Only one run of a method counts" in " ".join(
            organize(running, *merge).stderr.split()
        )
        assert standings(running)["alef"] == ""
        merged = organize(running, *merge, "--yes")
    assert merged.stdout == "team alef is now part of bet, and brought no submissions\n"
    shown = organize(running, "teams", "show", "bet").stdout
    assert "quota per day" in shown
    assert shown.startswith("Beth\n")
    assert standings(running) == {"alpha": "", "alef": "part of bet", "bet": ""}
    known = ("--affiliation", "Lab", "--email", "gimel@example.org")
    assert organize(running, "teams", "create", "gimel", "Gimel", *known).exit_code == 0
    shown = organize(running, "teams", "show", "gimel").stdout
    assert shown.startswith("Gimel, Lab\n")
    assert "gimel@example.org" in shown
    none = run(running, "terms", "--phase", "dev")
    assert (none.exit_code, "no terms to accept" in none.stderr) == (2, True)
    asked = ("--terms", "Be fair.", "--terms-required")
    assert organize(running, "phases", "update", "dev", *asked).exit_code == 0
    shown = run(running, "terms", "--phase", "dev").stdout
    version = shown.split("version ")[1].split(";")[0]
    assert run(running, "terms", "--phase", "dev", "--accept", version).exit_code == 0
    assert "accepted 2" in run(running, "terms", "--phase", "dev").stdout


def test_a_table_in_an_encoding_of_old_makes_no_team(running: "Running", tmp_path: Path) -> None:
    table = tmp_path / "teams.csv"
    table.write_bytes("id,name\ndalet,Dalét\n".encode("cp1252"))
    refused = organize(running, "teams", "import", table)
    assert (refused.exit_code, "save it as UTF-8" in refused.stderr) == (2, True)
    table.write_text("id\tname\ndalet\tDalet, third\n", encoding="utf-8-sig")
    made = organize(running, "teams", "import", table)
    assert (made.exit_code, "1 team created" in made.stderr) == (0, True)


def test_what_is_done_with_a_submission_from_the_command_line(
    running: "Running",
    tmp_path: Path,
    planning_file: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = planning_file()
    with running.client() as client:
        sent = client.submit(path, phase="dev", method="Planner")
        client.withdraw(sent.id)
    of = ("submissions",)
    back = organize(running, *of, "restore", sent.id, "--reason", "by mistake")
    assert back.stdout == f"submission {sent.id} is received\n"
    assert organize(running, *of, "restore", sent.id, "--reason", "again").exit_code == 4
    told = organize(running, *of, "note", sent.id, "--words", "It stands again.")
    assert told.stdout.startswith("sent to Alpha: notice ")
    words_file = tmp_path / "words.txt"
    words_file.write_text("It stays.", encoding="utf-8")
    page = f"{running.url}/submissions/{sent.id}"
    assert organize(running, *of, "note", page, "--words", f"@{words_file}").exit_code == 0
    with running.client() as client:
        told_so = [notice.what_changed for notice in client.notices()]
    restored = "It is withdrawn no longer, and has its old place in time."
    assert told_so == [("It stays.",), ("It stands again.",), (restored,)]
    no_sheet = organize(running, *of, "verify", sent.id, "--reason", "a dispute")
    assert (no_sheet.exit_code, "no score sheet" in no_sheet.stderr) == (2, True)
    upload = tmp_path / "upload.json"
    got = organize(running, *of, "download", sent.id, "--output", upload)
    assert got.exit_code == 0, got.stderr
    assert upload.read_bytes() == path.read_bytes()
    assert organize(running, *of, "download", sent.id, "--output", upload).exit_code == 2
    for command, name in (("folder", f"submission-{sent.id}/upload.json"), ("archive", None)):
        file = tmp_path / f"{command}.tar"
        more = [page] if command == "folder" else ["--team", "alpha"]
        assert organize(running, *of, command, *more, "--output", file).exit_code == 0
        with tarfile.open(file) as tar:
            assert (name or f"dev/alpha/{sent.id}.json") in tar.getnames()
    monkeypatch.chdir(tmp_path)
    named = {"download": f"{sent.id}.json", "folder": f"submission-{sent.id}.tar"}
    for command, kept_as in named.items():
        assert organize(running, *of, command, page).exit_code == 0
        assert Path(kept_as).is_file(), "named by the id, of an address too"
    story = organize(running, *of, "show", page).stdout
    for words in ("told ", "submission restored", "upload downloaded", "story downloaded"):
        assert words in story
    assert "by mistake" in organize(running, "audit", "list").stdout, "why it was done"
    about = json.loads(organize(running, "audit", "list", "--subject", sent.id, "--json").stdout)
    assert {line["subject"] for line in about} == {sent.id}


def test_a_protocol_is_confirmed_with_a_key_of_this_machine(
    running: "Running", tmp_path: Path
) -> None:
    key, document = tmp_path / "key.pem", tmp_path / "1.1.toml"
    document.write_text(packaged_protocol_toml("1.1"))
    shown = organize(running, "protocols", "key", "--key", key)
    assert (shown.exit_code, str(key) in shown.stderr) == (0, True)
    public_key = shown.stdout.strip()
    splits = json.loads(organize(running, "splits", "list", "--json").stdout)
    what = ("--split", "tiny", "--revision", splits[0]["revision"], "--key", key)
    unknown = organize(running, "protocols", "confirm", document, *what)
    assert unknown.exit_code == 2
    assert organize(running, "protocols", "add", document).exit_code == 0
    done = organize(running, "protocols", "confirm", document, *what)
    assert (done.exit_code, "confirmed: protocol 1.1" in done.stdout) == (0, True)
    written = organize(running, "protocols", "confirm", document, *what, "-o", tmp_path / "c.json")
    assert written.exit_code == 0
    for read in (document, key):
        over = organize(running, "protocols", "confirm", document, *what, "-o", read)
        assert (over.exit_code, "is what is read" in over.stderr) == (2, True)
    nowhere = organize(running, "protocols", "confirm", document, *what, "-o", tmp_path / "x" / "c")
    assert (nowhere.exit_code, "cannot be written" in nowhere.stderr) == (2, True)
    (kept,) = json.loads(organize(running, "protocols", "confirmations", "--json").stdout)
    assert kept["confirmation"] == json.loads((tmp_path / "c.json").read_text())
    assert kept["confirmation"]["public_key"] == public_key
    why = ("--reason", "wrong document")
    assert organize(running, "protocols", "withdraw-confirmation", kept["id"], *why).exit_code == 0
    assert json.loads(organize(running, "protocols", "confirmations", "--json").stdout) == []


def test_an_external_board_is_imported_listed_and_withdrawn(
    running: "Running", tmp_path: Path
) -> None:
    revision = "sha256:" + "a" * 64
    file = tmp_path / "board.csv"
    file.write_text(f"method;hcc;split;split_revision;protocol\nFar;0.2;far;{revision};1.0\n")
    phases = ("phases", "import-reported", "dev", file, "--title", "Far", "--cite", "Far et al.")
    made = json.loads(organize(running, *phases, "--json").stdout)
    assert made["rows"][0]["differences"][0].startswith("Split far, not ")
    assert "Far" in organize(running, "phases", "reported", "dev").stdout
    again = organize(running, *phases)
    assert (again.exit_code, "already" in again.stderr) == (4, True)
    file.write_text(f"method;hcc;split;split_revision;protocol\nNear;0.3;far;{revision};1.0\n")
    assert organize(running, *phases).stdout.startswith("1 row imported as ")
    file.write_text(f"method;hcc;split;split_revision;protocol\nFar;20;far;{revision};1.0\n")
    bad = organize(running, *phases)
    assert (bad.exit_code, "Line 2: hcc is 20" in bad.stderr) == (2, True)
    file.write_bytes(
        f"method;hcc;split;split_revision;protocol\nFür;0.2;far;{revision};1.0\n".encode("cp1252")
    )
    old = organize(running, *phases)
    assert (old.exit_code, "board.csv is not UTF-8 text" in old.stderr) == (2, True)
    gone = ("phases", "withdraw-reported", "dev", made["id"], "--reason", "wrong")
    assert "Far withdrawn" in organize(running, *gone).stdout
    (line,) = json.loads(organize(running, "audit", "list", "--limit", "1", "--json").stdout)
    assert (line["action"], line["subject"]) == ("reported board withdrawn", made["id"])


def test_news_and_answers_come_from_files_as_other_long_texts_do(
    running: "Running", tmp_path: Path
) -> None:
    words, of = tmp_path / "words.md", ("--phase", "dev")
    words.write_text("It is on **Friday** now.\n", encoding="utf-8")
    news = ("news", "publish", *of, "--title", "The workshop moves", "--text")
    missing = organize(running, *news, f"@{words}.none")
    assert (missing.exit_code, "cannot be read" in missing.stderr) == (2, True)
    assert organize(running, *news, f"@{words}").exit_code == 0
    with running.client() as client:
        asked = client.ask("When?", "dev")
        answer = ("questions", "answer", asked["id"], "--text", f"@{words}")
        assert organize(running, *answer).exit_code == 0
        assert [one["text"].strip() for one in client.news("dev")] == ["It is on **Friday** now."]
        assert client.questions("dev")[0]["answer"].strip() == "It is on **Friday** now."


def test_a_list_of_several_teams_submissions_says_whose_each_is(
    running: "Running", planning_file: Callable[..., Path]
) -> None:
    with running.client() as client:
        client.submit(planning_file(), phase="dev", method="Planner")

    def shown() -> str:
        return str(run(running, "submissions", token=running.organizer_token).stdout)

    assert "team" not in shown(), "of one team"
    token = organize(running, "teams", "create", "beta", "Team Beta", "--with-token").stdout.strip()
    with Client(running.url, token) as client:
        client.submit(planning_file(), phase="dev", method="Planner")
    assert ("Team Beta" in shown(), "Alpha" in shown()) == (True, True)


@pytest.mark.parametrize(
    ("words", "listed_by"),
    [
        ("phases freeze nope --reason why", "phases"),
        ("phases create newer --title New --split nope", "organizer splits list"),
        ("teams approve nope", "organizer teams list"),
        ("rescore start --phase dev --protocol 9.9 --reason why", "organizer protocols list"),
        ("rescore preview nope", "organizer rescore status"),
        ("submissions show nope", "submissions"),
        ("questions answer nope --text yes", "organizer questions list"),
        ("news withdraw nope --reason why", "organizer news list"),
        ("people set nope", "organizer people list"),
        ("people forget nope --yes --reason why", "organizer people list"),
        ("teams reinstate 9 --reason why", "organizer teams disqualified"),
    ],
)
def test_a_name_that_is_not_known_is_answered_by_what_lists_them(
    running: "Running", words: str, listed_by: str
) -> None:
    missing = organize(running, *words.split())
    assert missing.exit_code == 2
    assert f"`exceptiondrive {listed_by}` lists what there is." in missing.stderr
    assert CliRunner().invoke(app, [*listed_by.split(), "--help"]).exit_code == 0


VERSION = ProtocolRef(version="1.0", digest="sha256:2")
SIDES: Any = {"from_protocol": VERSION, "to_protocol": VERSION}
SIDES |= {
    f"{end}_split": SplitRef(name="tiny", revision=f"sha256:{digit * 64}")
    for end, digit in (("from", "5"), ("to", "7"))
}


def run_in(state: RunState, trial: SplitTrial | None = None) -> Any:
    """What the server answers of a run."""
    ended: Any = dict.fromkeys(("started_at", "applied_at", "ended_at"))
    difference = Difference(changes=(), stage=Stage.NONE, n_sheets=0, sentence="Nothing else.")
    return RunView(
        id="R",
        phase="dev",
        state=state,
        reason="why",
        actor="token:x",
        created_at=datetime(2026, 11, 20, tzinfo=timezone.utc),
        progress=Progress(done=1, total=1, failed=0),
        blockers=(),
        difference=difference,
        trial=trial,
        **SIDES,
        **ended,
    ).model_dump(mode="json")


def test_where_the_server_dies_after_the_draft_what_will_work_is_named(
    canned_server: "CannedServer",
) -> None:
    """The same command again would be refused: a phase has one open run."""
    canned_server.answer("POST /organizer/rescoring", 200, run_in(RunState.DRAFT))
    canned_server.problem("POST /organizer/rescoring/R/start", 503, "store_unavailable")
    to = {"EXCEPTIONDRIVE_SERVER": canned_server.url, "EXCEPTIONDRIVE_TOKEN": "edk_x"}
    words = ("organizer", "rescore", "start", "--phase", "dev", "--protocol", "1.1")
    done = CliRunner().invoke(app, [*words, "--reason", "why"], env=to)
    said = " ".join(done.stderr.split())
    assert (done.exit_code, "The run R is drafted." in said) == (5, True), said
    assert "organizer rescore begin R" in said
    assert "the command again" not in said


def test_what_is_to_be_typed_after_a_split_that_nobody_tried_can_be_typed(
    canned_server: "CannedServer", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rescoring, "_MAX_POLLS", 1)
    waiting = run_in(RunState.DRAFT, SplitTrial())
    canned_server.answer("POST /organizer/rescoring", 200, waiting)
    canned_server.answer("GET /organizer/rescoring/R", 200, waiting)
    to = {"EXCEPTIONDRIVE_SERVER": canned_server.url, "EXCEPTIONDRIVE_TOKEN": "edk_x"}
    words = ("organizer", "rescore", "start", "--phase", "dev", "--protocol", "1.1")
    done = CliRunner().invoke(app, [*words, "--reason", "why"], env=to)
    said = " ".join(done.stderr.split())
    assert 'organizer rescore begin R --reason "…"' in said


def test_a_preview_and_an_apply_say_whose_deadline_a_reveal_ends(
    canned_server: "CannedServer",
) -> None:
    words = "Beta has a deadline of its own, 2026-12-01 12:00 UTC: it ends with the reveal."
    revisions = f"{'5' * 12} -> {'7' * 12}"
    counts: Any = dict.fromkeys(
        ("old_board", "new_board", "n_entries", "n_numbers_changed", "n_ranks_changed",
         "n_newly_failing"), 1)  # fmt: skip
    ranked = Standing(rank=1, rank_interval=None, unranked_because=None, metrics={}, families={})
    gone = EntryChange(
        submission_id="s",
        method="Third",
        team="Alef",
        change="disappears",
        newly_failing=True,
        old=ranked,
        new=None,
        rank_shift=None,
        metric_shifts={},
        family_shifts={},
    )
    comparison = Comparison(
        phase="dev", challenge=PLANNING.id, worst_movers=(), entries=(gone,), **SIDES, **counts
    )
    preview = PreviewView(
        run="R",
        digest="sha256:seen",
        is_stale=False,
        blockers=(),
        warnings=(words,),
        comparison=comparison,
    ).model_dump(mode="json")
    canned_server.answer("GET /organizer/rescoring/R/preview", 200, preview)
    canned_server.answer("POST /organizer/rescoring/R/apply", 200, run_in(RunState.APPLIED))
    to = {"EXCEPTIONDRIVE_SERVER": canned_server.url, "EXCEPTIONDRIVE_TOKEN": "edk_x"}

    def said(*words: str) -> Any:
        return CliRunner().invoke(app, ["organizer", "rescore", *words], env=to)

    seen = " ".join(said("preview", "R").stdout.split())
    assert words in seen
    assert f"{revisions}, board 1 -> 1" in seen
    assert (
        "Third (Alef): not on the new board: on its way, replaced, withdrawn or disqualified"
        in seen
    )
    done = said("apply", "R", "--preview", "sha256:seen", "--reason", "the end")
    assert (done.exit_code, words in done.stderr) == (0, True), done.stderr
    assert done.stdout.startswith(f"run R  applied  phase dev  {revisions}\n")
    unseen = said("apply", "R", "--reason", "the end")
    assert (unseen.exit_code, "--preview" in unseen.stderr) == (2, True), unseen.stderr


def test_who_takes_a_role_or_forgets_a_person_reads_which_tokens_work_on(
    canned_server: "CannedServer",
) -> None:
    door = {"id": "q3", "name": "door", "prefix": "edk_s_q3", "made_by": "Ben"}
    left = {"name": "Ben", "role": None, "still_work": [door]}
    canned_server.answer("POST /organizer/people/ben/organizer", 200, left)
    canned_server.answer("POST /organizer/people/ben/forget", 200, left)
    to = {"EXCEPTIONDRIVE_SERVER": canned_server.url, "EXCEPTIONDRIVE_TOKEN": "edk_x"}
    for words in (("set", "ben"), ("forget", "ben", "--yes", "--reason", "why")):
        done = CliRunner().invoke(app, ["organizer", "people", *words], env=to)
        assert done.exit_code == 0, done.stderr
        assert "tokens that they made keep working; revoke these too" in done.output
        assert "q3  door  (edk_s_q3, made by Ben)" in done.output
