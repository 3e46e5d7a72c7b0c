"""A workshop folder: settings, records that stay, pictures under their digests."""

import hashlib
import sqlite3
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from exceptiondrive_build.cli import app
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.records import Author, Kind, Record, Records
from exceptiondrive_build.workshop import Workshop, new_workshop
from exceptiondrive_schemas.protocol import NEWEST

ADA, GRACE = Author(person="ada"), Author(person="grace")
KEY = "0" * 64


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    new_workshop(tmp_path / "shop", "made-2027", KEY)
    return Workshop(tmp_path / "shop")


def word(candidate: str, by: Author, passed: bool, supersedes: int | None = None) -> Record:
    return Record(
        kind=Kind.INSPECT,
        candidate=candidate,
        by=by,
        inputs=("sha256:a",),
        value={"passed": passed},
        supersedes=supersedes,
    )


def test_a_new_workshop_lets_in_its_owner_alone(workshop: Workshop) -> None:
    """Its records and answers hold verified regions, and are written with the usual rights."""
    assert stat.S_IMODE(workshop.folder.stat().st_mode) == 0o700


def test_a_workshop_in_a_folder_that_others_may_enter_shows_them_no_file(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    build = [sys.executable, "-c", "from exceptiondrive_build.cli import main; main()"]
    for command in (["new", ".", "--name", "made-2027"], ["report"]):
        subprocess.run(
            [*build, *command], cwd=tmp_path, capture_output=True, check=True, umask=0o022
        )
    assert (tmp_path / "records.sqlite3").exists()
    assert {path.name for path in tmp_path.rglob("*") if path.stat().st_mode & 0o077} == set()


def test_a_new_workshop_is_left_out_of_the_repository_that_it_stands_in(tmp_path: Path) -> None:
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    new_workshop(tmp_path / "w27", "made-2027", KEY)
    own = tmp_path / "mine" / ".gitignore"
    own.parent.mkdir()
    own.write_text("records.sqlite3\n")
    new_workshop(own.parent, "made-2028", KEY)
    assert own.read_text() == "records.sqlite3\n", "what was there stays"
    status = ["git", "-C", str(tmp_path), "status", "--porcelain"]
    told = subprocess.run(status, capture_output=True, text=True, check=True)
    assert told.stdout == "?? mine/\n"


def test_a_new_workshop_opens_with_words_for_every_task(workshop: Workshop) -> None:
    assert workshop.settings.name == "made-2027"
    assert len(workshop.tasks) == 21
    assert workshop.protocol.version == NEWEST
    assert set(workshop.task_texts) == {task.id for task in workshop.tasks}
    assert workshop.keyframes == {}


def test_the_command_makes_one_and_does_not_write_over_it(tmp_path: Path) -> None:
    command = ["new", str(tmp_path / "shop"), "--name", "made-2027"]
    assert CliRunner().invoke(app, command).exit_code == 0
    key = Workshop(tmp_path / "shop").settings.id_key
    again = CliRunner().invoke(app, command)
    assert (again.exit_code, "already" in again.output) == (2, True)
    assert Workshop(tmp_path / "shop").settings.id_key == key


@pytest.mark.parametrize(
    ("name", "key", "said"),
    [
        ('a"b', KEY, "is no name of a split"),
        ("", KEY, "is no name of a split"),
        ("x" * 300, KEY, "is no name of a split"),
        ("../x", KEY, "is no name of a split"),
        ("made\n", KEY, "is no name of a split"),
        ("made-2027", 'q"\n' * 16, "no key of sample ids"),
        ("made-2027", "\\" * 40, "no key of sample ids"),
        ("made-2027", "short", "no key of sample ids"),
        ("made-2027", "", "no key of sample ids"),
    ],
)
def test_a_name_or_key_that_is_none_makes_nothing(
    name: str, key: str, said: str, tmp_path: Path
) -> None:
    command = ["new", str(tmp_path / "shop"), "--name", name, "--id-key", key]
    result = CliRunner().invoke(app, command)
    assert (result.exit_code, said in result.output) == (2, True)
    assert not (tmp_path / "shop").exists()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('endpoint = "editor"', 'endpoint = "nowhere"', "nowhere"),
        ("min_mark = 3", "min_mark = 9", "review.min_mark"),
        ("min_mark = 3", "min_marc = 3", "review.min_marc"),
        ("[review]", "[review", "workshop.toml"),
        ('licence_url = ""', 'licence_url = "javascript:alert(1)"', "licence_url: expected http"),
        ('\nurl = ""', '\nurl = "example.org"', "datasheet.url: expected http"),
        ('published = ""', 'published = "2027-13-45"', "expected a day such as 2026-11-22"),
    ],
)
def test_wrong_settings_are_named(workshop: Workshop, old: str, new: str, said: str) -> None:
    path = workshop.folder / "workshop.toml"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(BuildError, match=said):
        Workshop(workshop.folder)


def test_a_task_of_the_settings_that_there_is_none_of_is_told_with_those_that_there_are(
    workshop: Workshop,
) -> None:
    path = workshop.folder / "workshop.toml"
    path.write_text(path.read_text().replace("tasks = []", 'tasks = ["T01", "SE1"]'))
    with pytest.raises(
        BuildError, match=r"does not know: T01\. It knows SE1, SE2, SE3, SE4, LB1, .*RS3\."
    ):
        _ = Workshop(workshop.folder).tasks


def a_file(path: Path) -> None:
    if path.is_dir():
        path.rmdir()
    path.write_text("")


@pytest.mark.parametrize(
    ("spoil", "command", "said"),
    [
        (lambda shop: a_file(shop / "images"), ["report", "-w", "shop"], "images: File exists."),
        (
            lambda shop: (shop / "scenes.jsonl").mkdir(),
            ["report", "-w", "shop"],
            "scenes.jsonl: Is a directory.",
        ),
        (lambda _: None, ["report", "-w", "x" * 300], "File name too long."),
        (lambda shop: a_file(shop / "file"), ["scenes", "make", "shop/file"], "Not a directory."),
        (lambda shop: a_file(shop / "file"), ["scenes", "make", "shop/file/x"], "Not a directory."),
        (lambda shop: a_file(shop / "file"), ["new", "shop/file/x", "--name", "a"], "Not a direc"),
    ],
)
def test_a_path_that_is_something_else_is_named(
    spoil: Callable[[Path], object],
    command: list[str],
    said: str,
    workshop: Workshop,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    spoil(workshop.folder)
    monkeypatch.chdir(workshop.folder.parent)
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2
    assert said in result.output


def test_without_a_workshop_the_advice_can_be_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    told = CliRunner().invoke(app, ["report"])
    assert told.exit_code == 2
    command = told.stderr.split("`")[1].replace("FOLDER", ".").replace("NAME", "made-2027").split()
    assert command.pop(0) == "exceptiondrive-build"
    assert CliRunner().invoke(app, command).exit_code == 0
    assert CliRunner().invoke(app, ["report"]).exit_code == 0


def test_records_are_appended_and_superseded_and_taken_back(workshop: Workshop) -> None:
    (first,) = workshop.records.append(word("a", ADA, True))
    workshop.records.append(word("a", GRACE, True))
    assert [r.by for r in workshop.records.standing(Kind.INSPECT)["a"]] == [ADA, GRACE]
    (second,) = workshop.records.append(word("a", ADA, False, supersedes=first.id))
    assert workshop.current(Kind.INSPECT)["a"] == second
    workshop.records.append(second.model_copy(update={"value": None, "supersedes": second.id}))
    assert [r.by for r in workshop.records.standing(Kind.INSPECT)["a"]] == [GRACE]
    assert len(list(workshop.records.read())) == 4


def test_what_is_superseded_cannot_be_superseded_again(workshop: Workshop) -> None:
    (first,) = workshop.records.append(word("a", ADA, True))
    workshop.records.append(word("a", ADA, False, supersedes=first.id))
    with pytest.raises(BuildError, match="superseded already"):
        workshop.records.append(word("b", ADA, True), word("a", GRACE, False, supersedes=first.id))
    assert "b" not in workshop.current(Kind.INSPECT)


def test_the_database_refuses_to_change_or_remove_a_record(workshop: Workshop) -> None:
    workshop.records.append(word("a", ADA, True))
    with sqlite3.connect(workshop.folder / "records.sqlite3") as connection:
        for change in ("DELETE FROM records", "UPDATE records SET value = 'null'"):
            with pytest.raises(sqlite3.IntegrityError, match="records are never"):
                connection.execute(change)


def test_the_digest_of_a_record_is_blind_to_when(workshop: Workshop) -> None:
    (kept,) = workshop.records.append(word("a", ADA, True))
    later = word("a", ADA, True).model_copy(update={"at": "2030-01-01T00:00:00+00:00"})
    assert kept.digest == later.digest != word("a", ADA, False).digest


def test_a_file_that_is_no_table_of_records_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "records.sqlite3"
    path.write_bytes(b"something else, and long enough to be read as a header" * 20)
    with pytest.raises(BuildError, match="not a database"):
        Records(path)


def test_records_that_are_gone_are_missed_and_may_be_begun_anew(workshop: Workshop) -> None:
    records = workshop.folder / "records.sqlite3"
    workshop.records.close()
    records.unlink()
    (workshop.folder / "answers").mkdir()
    with pytest.raises(BuildError, match="Put it back from a copy"):
        Workshop(workshop.folder)
    assert not records.exists()
    records.touch()
    with Workshop(workshop.folder) as anew:
        assert list(anew.records.read()) == []


def test_pictures_are_kept_under_their_digest(workshop: Workshop) -> None:
    name = workshop.keep_image(b"picture", "png")
    assert name == f"{hashlib.sha256(b'picture').hexdigest()}.png"
    assert workshop.keep_image(b"picture", "png") == name
    assert workshop.image(name) == b"picture"
    workshop.image_path(name).write_bytes(b"changed")
    with pytest.raises(BuildError, match="damaged"):
        workshop.image(name)


def test_sample_ids_tell_nothing_without_the_key(workshop: Workshop, tmp_path: Path) -> None:
    new_workshop(tmp_path / "other", "made-2027", "1" * 64)
    other = Workshop(tmp_path / "other")
    found = workshop.sample_id("token", "SE1")
    assert found == workshop.sample_id("token", "SE1")
    assert found not in (workshop.sample_id("token", "SE2"), other.sample_id("token", "SE1"))
