"""The client as participants have it: its wheel alone, on the oldest and the newest Python found."""

import json
import subprocess
from dataclasses import dataclass
from email.parser import BytesParser
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.metadata import Metadata
from tests.client.servers import Running
from tests.support.distributions import bare_environment, build, names_in
from tests.support.pythons import Version, pythons

from exceptiondrive import __version__
from exceptiondrive.cli.reference import command_reference

OLDEST: Version = (3, 10)
SUPPORTED = {version: path for version, path in pythons().items() if version >= OLDEST}
ENDS = sorted({min(SUPPORTED), max(SUPPORTED)}) if SUPPORTED else []
PACKAGES = ["", "_agent", "_endpoints", "_schemas", "_scoring"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    (path,) = build("client", tmp_path_factory.mktemp("wheel"), "wheel")
    return path


@pytest.fixture(scope="module")
def metadata(wheel: Path) -> Metadata:
    with ZipFile(wheel) as archive:
        text = archive.read(f"exceptiondrive-{__version__}.dist-info/METADATA")
    assert BytesParser().parsebytes(text)["Description-Content-Type"] == "text/markdown"
    return Metadata.from_email(text, validate=True)


def test_it_holds_the_client_alone_and_says_that_it_is_typed(wheel: Path) -> None:
    names = names_in(wheel)
    folders = {name.split("/")[0] for name in names}
    info = f"exceptiondrive-{__version__}.dist-info"
    assert folders == {info, *(f"exceptiondrive{package}" for package in PACKAGES)}
    assert {f"exceptiondrive{package}/py.typed" for package in PACKAGES} <= set(names)
    assert "exceptiondrive/recorder.py" in names
    assert not [name for name in names if "split.json.gz" in name or "/tests/" in name]
    with ZipFile(wheel) as archive:
        commands = archive.read(f"{info}/entry_points.txt").decode().splitlines()
    assert commands == ["[console_scripts]", "exceptiondrive = exceptiondrive.__main__:main"]


def test_its_metadata_is_fit_for_an_index(metadata: Metadata) -> None:
    assert metadata.version is not None
    assert str(metadata.version) == __version__
    assert str(metadata.requires_python) == ">=3.10"
    assert metadata.description is not None
    assert metadata.description.startswith("# exceptiondrive")
    assert "Typing :: Typed" in (metadata.classifiers or [])
    plain = {each.name for each in metadata.requires_dist or [] if "extra" not in str(each.marker)}
    assert plain <= {
        *("httpx", "msgspec", "platformdirs", "pydantic", "rich", "typer"),
        *("tomli", "typing-extensions"),
    }
    assert metadata.provides_extra is not None
    assert {"evaluate", "plot", "parquet", "agent", "data", "receipts"} == {
        str(extra) for extra in metadata.provides_extra
    }


@dataclass(frozen=True)
class Bare:
    """An environment with the wheel, and a folder to work in."""

    bin: Path
    version: Version
    folder: Path

    def run(self, *arguments: str | Path, **environment: str) -> str:
        done = subprocess.run(
            [self.bin / "exceptiondrive", *arguments],
            cwd=self.folder,
            env={"PATH": "/usr/bin:/bin", "HOME": str(self.folder), **environment},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout


@pytest.fixture(scope="module", params=ENDS, ids=lambda version: f"3.{version[1]}")
def bare(
    request: pytest.FixtureRequest, wheel: Path, tmp_path_factory: pytest.TempPathFactory
) -> Bare:
    version: Version = request.param
    folder = tmp_path_factory.mktemp("bare")
    bin_ = bare_environment(folder / "venv", SUPPORTED[version], wheel, "evaluate")
    return Bare(bin_, version, folder)


EVERY_HELP = """
import json, sys
from typer.main import get_command
from exceptiondrive.cli import app
def walk(command, names):
    try:
        command.main([*names[len(names):], "--help"], prog_name=" ".join(names))
    except SystemExit as end:
        assert end.code == 0, names
    for name in command.list_commands(None) if hasattr(command, "list_commands") else ():
        walk(command.get_command(None, name), [*names, name])
walk(get_command(app), ["exceptiondrive"])
"""


def test_every_command_says_its_help(bare: Bare) -> None:
    done = subprocess.run(
        [bare.bin / "python", "-c", EVERY_HELP],
        env={"PATH": "/usr/bin:/bin", "HOME": str(bare.folder), "COLUMNS": "100"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    headings = [line for line in command_reference().splitlines() if line.startswith("### `")]
    assert len(headings) > 40
    for heading in headings:
        assert f"Usage: {heading.removeprefix('### `').removesuffix('`')} " in done.stdout


def test_a_file_is_converted_checked_scored_submitted_and_ranked(
    bare: Bare, working: Running, split_file: Path
) -> None:
    assert bare.run("--version") == f"exceptiondrive {__version__}\n"
    sample_ids = [each["sample_id"] for each in json.loads(split_file.read_text())["samples"]]
    lines = [
        json.dumps({"sample_id": each, "source": [[4.0, 0.0]] * 6, "edited": [[1.0, 0.0]] * 6})
        for each in sample_ids
    ]
    (bare.folder / "run.jsonl").write_text("\n".join(lines), encoding="utf-8")
    bare.run("convert", "run.jsonl", "-o", "planner.json.gz", "--split", "tiny")
    assert "is valid" in bare.run("check", "planner.json.gz", "--split", split_file)
    told = bare.run("evaluate", "planner.json.gz", "--split", split_file, "--json")
    environment = {"EXCEPTIONDRIVE_SERVER": working.url, "EXCEPTIONDRIVE_TOKEN": working.token}
    method = f"On {bare.version}"
    submit = ["submit", "planner.json.gz", "--phase", "dev", "--method", method, "--wait", "--json"]
    scored = json.loads(bare.run(*submit, **environment))
    assert scored["status"] == "scored"
    published, exact = scored["sheet"]["macro_family"], json.loads(told)["macro_family"]
    assert {key: published[key] for key in ("hcc", "ur")} == pytest.approx(
        {key: exact[key] for key in ("hcc", "ur")}, abs=1e-4
    )
