import gzip
import json
import re
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from exceptiondrive import InvalidFileError, check_file
from exceptiondrive.cli import app
from exceptiondrive.cli.reference import command_reference, with_reference

if TYPE_CHECKING:
    from tests.client.servers import Running

DOCS = Path(__file__).parents[2] / "docs"
CLIENT = DOCS / "client.md"
QUICKSTART = DOCS / "quickstart.md"


def test_the_reference_is_what_the_commands_say_of_themselves() -> None:
    text = CLIENT.read_text(encoding="utf-8")
    assert with_reference(text) == text, (
        "run: python -m exceptiondrive.cli.reference docs/client.md"
    )


def test_every_command_is_in_the_reference() -> None:
    listed = CliRunner().invoke(app, ["--help"]).stdout.split("Commands:")[1]
    names = [line.split()[0] for line in listed.splitlines() if re.match(r"  \w", line)]
    assert len(names) > 12
    for name in names:
        assert f"### `exceptiondrive {name}" in command_reference()


def every_command(command: Any, names: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    yield names
    for name in command.list_commands(None) if hasattr(command, "list_commands") else ():
        yield from every_command(command.get_command(None, name), (*names, name))


def test_every_help_is_whole_in_80_columns() -> None:
    commands = list(every_command(get_command(app)))
    assert len(commands) > 100
    for names in commands:
        done = CliRunner().invoke(app, [*names, "--help"], terminal_width=80)
        assert done.exit_code == 0, names
        for line in done.stdout.splitlines():
            assert len(line) <= 80, (names, line)
            assert not re.search(r"\w\.\.\.$|…", line), (names, line)


def test_the_file_of_the_readme_is_sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (DOCS.parent / "client" / "README.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(.*?)Client\(\)", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    Path("example.py").write_text(program, encoding="utf-8")
    runpy.run_path("example.py")
    assert check_file("planner.json.gz").is_valid


def test_a_document_without_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="marks are missing"):
        with_reference("# Nothing")


def test_the_exit_codes_of_the_document_are_those_of_the_errors() -> None:
    from exceptiondrive import errors

    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type)]
    codes = {kind.exit_code for kind in kinds if issubclass(kind, errors.ExceptionDriveError)}
    table = CLIENT.read_text(encoding="utf-8").split("## Exit codes")[1].split("##")[0]
    listed = {int(code) for code in re.findall(r"^\| (\d) \|", table, flags=re.MULTILINE)}
    assert listed == (codes - {1}) | {0}


def test_the_sdk_of_the_document_runs_and_says_what_the_commands_say(
    working: "Running",
    planning_file: Callable[..., Path],
    split_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    document = CLIENT.read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", document.partition("## SDK")[2], re.DOTALL)
    assert len(blocks) >= 5
    (tmp_path / "planner.json.gz").write_bytes(gzip.compress(planning_file().read_bytes()))
    (tmp_path / "sample.split.json").write_bytes(split_file.read_bytes())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EXCEPTIONDRIVE_SERVER", working.url)
    monkeypatch.setenv("EXCEPTIONDRIVE_TOKEN", working.token)
    names: dict[str, Any] = {}
    for block in blocks:  # the names of the suite's phase and split in the place of the document's
        block = block.replace('phase="sample"', 'phase="dev"').replace('("sample")', '("tiny")')
        (tmp_path / "block.py").write_text(block, encoding="utf-8")
        goes_on = "to_dataframe(board)" in block  # each other one has its own imports
        names |= runpy.run_path("block.py", init_globals=names if goes_on else {})

    def said(*arguments: str) -> Any:
        return json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)

    def told(answer: Any) -> Any:
        return answer.model_dump(mode="json", by_alias=True)

    split = ("--split", "sample.split.json")
    assert told(names["report"]) == said("check", "planner.json.gz")
    assert told(names["sheet"]) == said("evaluate", "planner.json.gz", *split)
    assert names["view"].rank == 1
    assert told(names["board"]) == said("leaderboard", "--phase", "dev")
    assert [told(each) for each in names["mine"]] == said("submissions")
    shown = said("status", names["view"].id)
    assert shown.pop("awaits_profile"), "the command asks, too, what the file looks like"
    assert told(names["view"]) == {**shown, "awaits_profile": False}


def test_the_sdk_of_the_document_ends_with_the_faults_of_a_file(
    running: "Running",
    planning_file: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    block = CLIENT.read_text(encoding="utf-8").split("## SDK")[1].split("```python\n")[1]
    block = "\n".join(line for line in block.split("```")[0].splitlines() if "sheet =" not in line)
    (tmp_path / "planner.json.gz").write_bytes(gzip.compress(planning_file(split="x").read_bytes()))
    (tmp_path / "block.py").write_text(block.replace('"sample"', '"dev"'), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EXCEPTIONDRIVE_SERVER", running.url)
    monkeypatch.setenv("EXCEPTIONDRIVE_TOKEN", running.token)
    with pytest.raises(InvalidFileError):
        runpy.run_path("block.py", init_globals={})
    assert "wrong_split" in capsys.readouterr().out


def test_the_planner_of_the_quickstart_writes_a_sound_file(
    tmp_path: Path, split_file: Path
) -> None:
    from exceptiondrive import check_file
    from exceptiondrive.checking import manifest_of
    from exceptiondrive.inputs import given_split
    from exceptiondrive_schemas.protocol import packaged_protocol

    split = given_split(split_file)
    drive = tuple((4.0 * step, 0.0) for step in range(1, 7))
    samples = tuple(each.model_copy(update={"recorded": drive}) for each in split.samples)
    split = split.model_copy(update={"name": "sample", "samples": samples})
    manifest = manifest_of(split, packaged_protocol())
    (tmp_path / "sample.manifest.json").write_text(manifest.model_dump_json(by_alias=True))
    block = QUICKSTART.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    (tmp_path / "my_planner.py").write_text(block, encoding="utf-8")
    subprocess.run([sys.executable, "my_planner.py"], cwd=tmp_path, check=True)
    report = check_file(tmp_path / "my_planner.json.gz", manifest=manifest)
    assert report.is_valid
    assert report.unranked_because is None
    assert report.profile is not None
    assert report.profile.warnings == ()
