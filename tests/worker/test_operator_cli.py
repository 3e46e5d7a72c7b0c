"""The operator's commands, called as an operator calls them."""

import gzip
import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from structlog.testing import capture_logs
from tests.support.floors import write_floors
from tests.support.made_pictures import png

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.splits.splits import find_split, list_splits
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_schemas.datasheet import Datasheet, SplitChange
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker import operator_cli
from exceptiondrive_worker.splits.admin import current_split
from exceptiondrive_worker.splits.store import SplitStore, read_split

MakeSplit = Callable[..., Split]


@pytest.fixture
def operate(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    sqlite_url: str,
) -> Callable[..., tuple[int, str, str]]:
    """Run a command; return exit code, stdout and stderr."""
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABASE_URL", sqlite_url)
    monkeypatch.setenv("EXCEPTIONDRIVE_FILE_STORE_URL", f"file://{tmp_path}/uploads")
    monkeypatch.setenv("EXCEPTIONDRIVE_SPLITS_DIR", str(tmp_path / "splits"))
    monkeypatch.setattr(operator_cli, "set_up_logs", lambda _: None)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["exceptiondrive-worker", *arguments])
        with pytest.raises(SystemExit) as ended:
            operator_cli.main()
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    return run


Operate = Callable[..., tuple[int, str, str]]


OF_RECORDS = [
    ("run",),
    ("heartbeat-age",),
    ("register-splits",),
    ("publish-split", "sample"),
    ("publish-pictures", "sample", "--licence", "CC0 1.0"),
    ("remove-pictures", "sample"),
    ("seed-sample",),
]


@pytest.mark.parametrize("command", OF_RECORDS, ids=lambda command: command[0])
def test_no_command_makes_a_database_where_there_is_none(
    operate: Operate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    assert operate("make-sample")[0] == 0
    monkeypatch.delenv("EXCEPTIONDRIVE_DATABASE_URL")
    other = tmp_path / "other"
    code, out, err = operate(*command, "--data", str(other))
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"there are no records at {other}/records.sqlite3. Name the folder of" in err
    assert not other.exists()


def test_a_database_that_was_only_looked_at_is_none(
    operate: Operate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = tmp_path / "empty.sqlite3"
    empty.touch()
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABASE_URL", f"sqlite:///{empty}")
    code, _, err = operate("heartbeat-age")
    assert code == 2
    assert f"there are no records at {empty}. Name the folder" in err
    assert empty.stat().st_size == 0


def test_the_folder_of_the_server_is_named_by_data(
    operate: Operate,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    migrated_sqlite: Path,
    make_split: MakeSplit,
) -> None:
    for name in ("DATABASE_URL", "FILE_STORE_URL"):
        monkeypatch.delenv(f"EXCEPTIONDRIVE_{name}")
    data = tmp_path / "data"
    data.mkdir()
    shutil.copy(migrated_sqlite, data / "records.sqlite3")
    put(tmp_path, make_split({"a": {}}))
    code, out, _ = operate("register-splits", "--data", str(data))
    assert (code, out.splitlines()[0][:20]) == (0, "tiny: 1 samples, sha")
    assert operate("heartbeat-age", "--data", str(data))[:2] == (1, "no sign of life\n")


def test_where_no_split_lies_it_is_said_where_one_was_looked_for(
    operate: Operate, tmp_path: Path
) -> None:
    code, out, err = operate("register-splits")
    assert (code, out) == (2, "")
    assert f"there is no split in {tmp_path}/splits, as NAME/split.json.gz" in err
    assert "EXCEPTIONDRIVE_SPLITS_DIR" in err


def test_a_worker_that_finds_no_split_says_so_as_it_starts(
    operate: Operate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make_split: MakeSplit
) -> None:
    """It starts all the same: the folder may be mounted, or filled, later."""
    monkeypatch.setattr("exceptiondrive_worker.process.run_worker", lambda *_: None)
    with capture_logs() as lines:
        assert operate("run")[0] == 0
    assert [line["folder"] for line in lines] == [f"{tmp_path}/splits"]
    assert "EXCEPTIONDRIVE_SPLITS_DIR" in lines[0]["event"]
    put(tmp_path, make_split({"a": {}}))
    with capture_logs() as lines:
        assert operate("run")[0] == 0
    assert lines == []


def test_a_file_that_is_refused_is_named_and_keeps_no_other_back(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    good = make_split({"a": {}})
    put(tmp_path, good)
    (tmp_path / "splits/aaa").mkdir()
    (tmp_path / "splits/aaa/split.json").write_text("{")
    put(tmp_path, good).parent.rename(tmp_path / "splits" / "other")
    put(tmp_path, good)
    code, out, err = operate("register-splits")
    assert (code, out.splitlines()[0]) == (2, f"tiny: 1 samples, {good.revision}")
    assert f"{tmp_path}/splits/aaa/split.json: split.json is not a split" in err
    assert "it holds split 'tiny', which workers look for in a folder of that name: rename" in err
    assert f"rename {tmp_path}/splits/other to tiny" in err


def test_a_split_is_added_from_anywhere_with_its_datasheet(
    operate: Operate, tmp_path: Path, sqlite_url: str, make_split: MakeSplit
) -> None:
    split = make_split({"a": {}, "b": {}})
    file = tmp_path / "private" / "split-of-mine.json.gz"
    file.parent.mkdir()
    file.write_bytes(
        gzip.compress(split.model_dump_json(by_alias=True, exclude_none=True).encode())
    )
    sheet = datasheet_of(split)
    (file.parent / "datasheet-of-mine.json").write_text(sheet.model_dump_json(by_alias=True))
    for _ in range(2):  # a second time nothing changes
        code, out, err = operate("add-split", str(file))
        assert (code, err) == (0, "")
    lies_at = tmp_path / "splits" / "tiny" / "split.json.gz"
    assert out.startswith("tiny: 2 samples, sha256:")
    assert out.endswith(f"it is at {lies_at}\n")
    assert lies_at.read_bytes() == file.read_bytes()
    assert lies_at.stat().st_mode & 0o777 == 0o600
    assert sorted(path.name for path in lies_at.parent.iterdir()) == [
        "datasheet.json",
        "split.json.gz",
    ]
    database = Database(sqlite_url)
    with database.read() as session:
        (row,) = list_splits(session)
        assert row.revision == split.revision
    database.dispose()


def datasheet_of(split: Split) -> Datasheet:
    return Datasheet(
        schema_="exceptiondrive.datasheet/1",
        name=split.name,
        title=split.title,
        revision=split.revision,
        protocol="1.0",
        n_samples=len(split.samples),
        n_scenes=1,
        stages=(),
        families=(),
        tasks=(),
    )


def test_a_datasheet_of_another_revision_is_refused_before_anything_is_copied(
    operate: Operate, tmp_path: Path, sqlite_url: str, make_split: MakeSplit
) -> None:
    split = make_split({"a": {}, "b": {}})
    file, beside = tmp_path / "private" / "split.json", tmp_path / "private" / "datasheet.json"
    file.parent.mkdir()
    file.write_text(split.model_dump_json(by_alias=True, exclude_none=True))
    sheet = datasheet_of(split)
    other = sheet.model_copy(update={"revision": make_split({"a": {}}).revision})
    for text, words in (
        (other.model_dump_json(by_alias=True), "datasheet.json is of split 'tiny' at revision"),
        ("{", "datasheet.json is no datasheet"),
    ):
        beside.write_text(text)
        code, _, err = operate("add-split", str(file))
        assert (code, words in err) == (2, True)
        assert not (tmp_path / "splits" / "tiny").exists()

    for title in ("Tiny", "Tiny, in better words"):
        right = sheet.model_copy(update={"title": title}).model_dump_json(by_alias=True)
        beside.write_text(right)
        assert operate("add-split", str(file))[0] == 0
        assert (tmp_path / "splits" / "tiny" / "datasheet.json").read_text() == right
        database = Database(sqlite_url)
        with database.read() as session:
            (row,) = list_splits(session)
            assert row.datasheet is not None
            assert row.datasheet.title == title
        database.dispose()


def test_a_split_is_not_added_over_another_revision_nor_where_it_is_refused(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    held = put(tmp_path, make_split({"a": {}}))
    before = held.read_bytes()
    file = tmp_path / "private" / "new.json"
    file.parent.mkdir()
    newer = make_split({"a": {"task": "LB1"}})
    file.write_text(newer.model_dump_json(by_alias=True, exclude_none=True))
    code, _, err = operate("add-split", str(file))
    assert code == 2
    assert f"{held} holds another revision of split 'tiny'" in err
    assert f'exceptiondrive-worker add-split {file} --words "..."' in err
    assert held.read_bytes() == before
    bad = make_split({"a": {"task": "Q1"}}).model_copy(update={"name": "bad"})
    file.write_text(bad.model_dump_json(by_alias=True, exclude_none=True))
    assert operate("add-split", str(file))[0] == 2
    assert not (tmp_path / "splits" / "bad").exists()


@pytest.mark.parametrize("sheet_says", [True, False])
def test_the_words_about_a_revision_are_those_of_its_datasheet_or_are_asked_for(
    operate: Operate, tmp_path: Path, sqlite_url: str, make_split: MakeSplit, sheet_says: bool
) -> None:
    held = put(tmp_path, make_split({"a": {}}))
    operate("register-splits")
    later = make_split({"a": {"task": "LB1"}})
    file = tmp_path / "private" / "split.json"
    file.parent.mkdir()
    file.write_text(later.model_dump_json(by_alias=True, exclude_none=True))
    change = SplitChange.between(read_split(held), later, "Another task.")
    sheet = datasheet_of(later).model_copy(update={"changes": change if sheet_says else None})
    file.with_name("datasheet.json").write_text(sheet.model_dump_json(by_alias=True))
    command = ("add-split", str(file))
    refused = (
        operate(*command, "--words", "Words of the command.") if sheet_says else operate(*command)
    )
    assert refused[0] == 2
    assert ("'Another task.'. Leave --words out" in refused[2]) == sheet_says
    assert [path.name for path in held.parent.iterdir()] == [held.name], "nothing was copied"
    code, _, err = operate(*command) if sheet_says else operate(*command, "--words", change.words)
    assert (code, err) == (0, "")
    with Database(sqlite_url).read() as session:
        row = find_split(session, "tiny")
        assert (row.revision, row.changes) == (later.revision, change)


def put(tmp_path: Path, split: Split) -> Path:
    path = tmp_path / "splits" / split.name / "split.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(split.model_dump_json(by_alias=True, exclude_none=True))
    return path


def test_the_sample_is_made_registered_and_published(
    operate: Operate, tmp_path: Path, sqlite_url: str
) -> None:
    assert operate("seed-sample")[0] == 0
    code, out, _ = operate("seed-sample")
    assert code == 0, "a second time nothing changes"
    assert "sample is public now" in out
    database = Database(sqlite_url)
    with database.read() as session:
        row = find_split(session, "sample")
    assert row.public_file_digest is not None
    published = FileStore(f"file://{tmp_path}/uploads").read(
        row.public_file_digest, limit_bytes=2**20
    )
    assert published == (tmp_path / "splits" / "sample" / "split.json.gz").read_bytes()
    database.dispose()


def test_registering_publishes_nothing(
    operate: Operate, tmp_path: Path, sqlite_url: str, make_split: MakeSplit
) -> None:
    put(tmp_path, make_split({"a": {}, "b": {"task": "LB1"}}))
    code, out, _ = operate("register-splits")
    assert code == 0
    assert out.startswith("tiny: 2 samples, sha256:")
    database = Database(sqlite_url)
    with database.read() as session:
        (row,) = list_splits(session)
    assert row.public_file_digest is None
    assert row.family_counts == {"sudden_emergence": 1, "lane_blockage": 1}
    assert not list((tmp_path / "uploads").rglob("*"))
    database.dispose()


def test_check_split_lists_every_offending_sample(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    touching = [[0.0, 0.0], [5.0, 0.0], [5.0, 1.0], [0.0, 1.0]]
    path = put(tmp_path, make_split({"good": {}, "x": {"region": touching}, "y": {"task": "Q1"}}))
    code, out, err = operate("check-split", str(path))
    assert code == 2
    assert out == ""
    assert "touch the footprint at t = 0 (1): x" in err
    assert "does not know (1): y" in err
    assert "good" not in err


def test_check_split_says_that_a_split_is_sound(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    code, out, _ = operate("check-split", str(put(tmp_path, make_split({"a": {}}))))
    assert code == 0
    assert out.startswith("tiny: 1 samples, sha256:")


def test_check_split_takes_a_protocol_with_a_mark_of_byte_order_and_refuses_what_is_no_text(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    split, protocol = put(tmp_path, make_split({"a": {}})), tmp_path / "own.toml"
    protocol.write_bytes(b"\xef\xbb\xbf" + packaged_protocol_toml().encode())
    assert operate("check-split", str(split), "--protocol", str(protocol))[0] == 0
    protocol.write_bytes(b"version = \xe9")
    code, out, err = operate("check-split", str(split), "--protocol", str(protocol))
    assert (code, out) == (2, "")
    assert "the file is not UTF-8 text; a protocol is a TOML file" in err


def test_check_split_warns_of_a_doubtful_split_and_does_not_refuse_it(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    behind = [[-9.0, -1.0], [-7.0, -1.0], [-7.0, 1.0], [-9.0, 1.0]]
    path = put(tmp_path, make_split({"good": {}, "bad": {"region": behind}}))
    code, out, err = operate("check-split", str(path))
    assert (code, err) == (0, "")
    assert "warning behind_the_car (1): no corner of the region lies ahead" in out
    assert out.splitlines()[1].endswith(": bad")
    code, out, _ = operate("check-split", "--json", str(path))
    report = json.loads(out)
    assert (code, report["faults"]) == (0, [])
    found = {warning["code"]: warning for warning in report["warnings"]}
    assert (found["behind_the_car"]["count"], found["behind_the_car"]["sample_ids"]) == (1, ["bad"])


def test_check_split_says_as_json_why_it_refuses(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    path = put(tmp_path, make_split({"good": {}, "y": {"task": "Q1"}}))
    code, out, err = operate("check-split", "--json", str(path))
    report = json.loads(out)
    assert (code, err, report["warnings"]) == (2, "", [])
    (fault,) = report["faults"]
    assert (fault["count"], fault["sample_ids"]) == (1, ["y"])


def test_registering_tells_the_server_how_many_samples_are_doubtful_and_not_which(
    operate: Operate, tmp_path: Path, sqlite_url: str, make_split: MakeSplit
) -> None:
    behind = [[-9.0, -1.0], [-7.0, -1.0], [-7.0, 1.0], [-9.0, 1.0]]
    put(tmp_path, make_split({"good": {}, "bad-canary": {"region": behind}}))
    _, out, _ = operate("register-splits")
    assert "warning behind_the_car (1)" in out
    assert "canary" not in out
    database = Database(sqlite_url)
    with database.read() as session:
        (row,) = list_splits(session)
        warnings = row.warnings
    database.dispose()
    assert {found.code: found.count for found in warnings.found}["behind_the_car"] == 1
    assert "canary" not in warnings.model_dump_json()


def test_cells_are_small_by_the_floor_of_the_split_until_it_is_public(
    operate: Operate, tmp_path: Path, sqlite_url: str
) -> None:
    def small_cells() -> str:
        with Database(sqlite_url).read() as session:
            (row,) = list_splits(session)
            return "".join(it.what for it in row.warnings.found if it.code == "small_cells")

    operate("make-sample")
    path = tmp_path / "splits" / "sample" / "split.json.gz"
    assert "fewer samples than 100, " in operate("check-split", str(path))[1]
    floors = path.with_name("floors.toml")
    floors.unlink()
    operate("register-splits")
    assert "fewer samples than 100, the least that is published of a withheld" in small_cells()
    floors.write_text("min_samples_per_cell = 21")
    operate("register-splits")
    assert "fewer samples than 21, " in small_cells()
    for command in (("publish-split", "sample"), ("register-splits",)):
        assert operate(*command)[0] == 0
        assert small_cells() == ""


WRONG_DRIVES: dict[str, tuple[Callable[[float], list[list[float]]], int, str]] = {
    "another frame": (
        lambda speed: [[0.0, speed * step] for step in range(1, 7)],
        24,
        "looks like x right / y forward: swap to (y, -x)",
    ),
    "few in another frame": (
        lambda speed: [[0.0, speed * step] for step in range(1, 7)],
        4,
        "No car makes 4 of 4 recorded drives that move",
    ),
    "one point": (lambda speed: [[speed + 190, 0.0]] * 6, 24, "looks like one point repeated"),
    "few of one point": (lambda speed: [[speed + 190, 0.0]] * 6, 3, "No car makes 3 of 3 recorded"),
}


@pytest.mark.parametrize("what", WRONG_DRIVES)
def test_drives_that_an_upload_could_not_hold_are_not_added(
    operate: Operate, tmp_path: Path, make_split: MakeSplit, what: str
) -> None:
    path, n, words = WRONG_DRIVES[what]
    split = make_split({f"s{row}": {} for row in range(n)})
    held, drives, new = put(tmp_path, split), tmp_path / "drives.json", tmp_path / "new.json.gz"
    rows = [
        {"sample_id": f"s{row}", "source": path(2 + row / 10), "edited": None} for row in range(n)
    ]
    document = {"schema": "exceptiondrive.planning/1", "split": "tiny", "predictions": rows}
    drives.write_text(json.dumps(document))
    code, out, err = operate("add-drives", str(held), str(drives), str(new))
    assert (code, out, new.exists()) == (2, "", False)
    assert "drives.json holds no recorded drives: " in err
    assert words in err


def test_a_single_car_that_backs_out_is_warned_of_and_refuses_nothing(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    held = put(tmp_path, make_split({"back": {}, "ahead": {}}))
    drives, new = tmp_path / "drives.json", tmp_path / "new.json.gz"
    rows = [
        {"sample_id": key, "source": [[pace * step, 0.0] for step in range(1, 7)], "edited": None}
        for key, pace in (("back", -1.0), ("ahead", 3.0))
    ]
    document = {"schema": "exceptiondrive.planning/1", "split": "tiny", "predictions": rows}
    drives.write_text(json.dumps(document))
    assert operate("add-drives", str(held), str(drives), str(new))[0] == 0
    out = operate("check-split", str(new))[1]
    (line,) = (line for line in out.splitlines() if "recorded_not_drivable" in line)
    assert line.startswith("warning recorded_not_drivable (1): no car makes the recorded path: ")
    assert line.endswith(": back")


def test_cars_that_stand_are_driven_as_they_are_measured(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    """To all sides by centimetres, which no car would drive."""
    draw = random.Random(1)
    paths = {
        f"s{row}": [[draw.gauss(0, 0.1), draw.gauss(0, 0.1)] for _ in range(6)] for row in range(20)
    } | {"ahead": [[3.0 * step, 0.0] for step in range(1, 7)]}
    held = put(tmp_path, make_split({key: {} for key in paths}))
    drives, new = tmp_path / "drives.json", tmp_path / "new.json.gz"
    rows = [{"sample_id": key, "source": path, "edited": None} for key, path in paths.items()]
    document = {"schema": "exceptiondrive.planning/1", "split": "tiny", "predictions": rows}
    drives.write_text(json.dumps(document))
    assert operate("add-drives", str(held), str(drives), str(new))[0] == 0
    assert "recorded_not_drivable" not in operate("check-split", str(new))[1]


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("register-splits", ("sample ids", "family sizes", "warnings by count", "datasheet")),
        (
            "publish-split",
            ("regions", "tasks", "controls", "recorded paths", "private part", "taken back"),
        ),
    ],
)
def test_the_help_says_what_leaves_the_worker(
    operate: Operate, command: str, told: tuple[str, ...]
) -> None:
    code, out, _ = operate(command, "--help")
    assert code == 0
    text = " ".join(out.split())
    assert [words for words in told if words not in text] == []


@pytest.mark.publishes_regions
@pytest.mark.parametrize("has_parts", [True, False])
def test_publishing_says_where_a_private_part_goes_public_too(
    operate: Operate, make_split: MakeSplit, tmp_path: Path, has_parts: bool
) -> None:
    parts = {"a": {"part": "public"}, "b": {"part": "private"}}
    split = make_split(parts if has_parts else {"a": {}, "b": {}})
    put(tmp_path, split)
    code, out, _ = operate("publish-split", "tiny")
    assert code == 0
    assert out.endswith(f"{split.revision}{', its private part, too' if has_parts else ''}\n")


def test_publishing_an_unknown_split_says_so(operate: Operate) -> None:
    code, _, err = operate("publish-split", "nosuch")
    assert code == 2
    assert "there is no split file for 'nosuch' in " in err


def test_make_planners_needs_no_server(operate: Operate, tmp_path: Path) -> None:
    code, out, _ = operate("make-planners", str(tmp_path / "planners"))
    assert code == 0
    listing: list[dict[str, Any]] = json.loads((tmp_path / "planners/planners.json").read_text())
    assert len(out.splitlines()) == len(listing)


def test_a_store_that_takes_no_file_is_told_with_what_it_said(
    operate: Operate, tmp_path: Path
) -> None:
    """Trying again helps nobody who may not write there."""
    operate("make-sample")
    operate("register-splits")
    for number in range(256):
        (tmp_path / "uploads").mkdir(exist_ok=True)
        (tmp_path / f"uploads/{number:02x}").touch()
    code, _, err = operate("publish-split", "sample")
    assert code == 2
    assert "does not take files now; try again later. (" in err
    assert str(tmp_path / "uploads") in err


def test_an_unknown_lane_is_refused(operate: Operate) -> None:
    code, _, err = operate("run", "--lanes", "live,fast")
    assert code == 2
    assert "unknown lane 'fast'" in err


def test_without_a_sign_of_life_the_health_check_fails(operate: Operate) -> None:
    assert operate("heartbeat-age")[:2] == (1, "no sign of life\n")


def test_pictures_are_shown_and_taken_away_by_command(operate: Operate, tmp_path: Path) -> None:
    operate("make-sample")
    operate("register-splits")
    folder = tmp_path / "splits" / "sample"
    (folder / "pictures").mkdir()
    sample_id = read_split(folder / "split.json.gz").samples[0].sample_id
    (folder / "pictures" / f"{sample_id}.source.png").write_bytes(png(64, 40))
    show = ("publish-pictures", "sample", "--licence", "CC0 1.0")
    code, _, err = operate(*show)
    assert (code, err.count("\n")) == (2, 1)
    assert "is not public" in err
    operate("seed-sample")
    assert operate(*show)[:2] == (0, "sample: 1 pictures are shown, under: CC0 1.0\n")
    assert operate("publish-pictures", "sample")[0] == 2, "the licence is asked for"
    assert operate("remove-pictures", "sample")[:2] == (0, "sample: pictures are no longer shown\n")


def test_a_revision_of_other_samples_is_refused_and_nothing_is_copied(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    held = put(tmp_path, make_split({"a": {}, "b": {"task": "LB1"}}))
    before = held.read_bytes()
    operate("register-splits")
    others: list[dict[str, dict[str, Any]]] = [{"a": {}}, {"a": {}, "b": {"task": "LB1"}, "c": {}}]
    for samples in others:
        new = tmp_path / "new-split.json"
        new.write_text(make_split(samples).model_dump_json(by_alias=True, exclude_none=True))
        code, _, err = operate("add-split", str(new), "--words", "Others.")
        assert code == 2
        assert '"withdrawn": "why"' in " ".join(err.split())
    assert held.read_bytes() == before
    assert [path.name for path in held.parent.iterdir()] == [held.name]


@pytest.mark.parametrize(
    ("way", "later"),
    [
        ("add-split", None),
        ("add-split", "public"),
        ("beside", None),
        ("beside", "public"),
        ("over", None),
    ],
)
def test_a_revision_that_takes_samples_out_of_their_part_is_refused(
    operate: Operate,
    tmp_path: Path,
    sqlite_url: str,
    make_split: MakeSplit,
    way: str,
    later: str | None,
) -> None:
    """Else what is private would be scored with all that counts; also where a file is put by hand."""
    parts = {"a": "public", "b": "private", "c": "private"}
    parted = make_split({key: {"part": part} for key, part in parts.items()})
    held = put(tmp_path, parted)
    assert operate("register-splits")[0] == 0
    after = {"a": later, "b": later, "c": later and "private"}
    moved = make_split({key: {"part": part} for key, part in after.items()})
    text = moved.model_dump_json(by_alias=True, exclude_none=True)
    if way == "beside":
        held.rename(held.with_name("split-1.json"))
    file = tmp_path / "new-split.json" if way == "add-split" else held
    file.write_text(text)
    command = ("add-split", str(file)) if way == "add-split" else ("register-splits",)
    code, _, err = operate(*command, "--words", "Regions lay wrong.")
    assert code == 2
    assert "keeps the part of each sample" in err or "has parts, and revision" in err
    with Database(sqlite_url).read() as session:
        assert {row.revision for row in list_splits(session)} == {
            split.revision for split in (parted, parted.part("public"), parted.part("private"))
        }
    assert way != "add-split" or [path.name for path in held.parent.iterdir()] == [held.name]


def test_a_split_may_get_parts_and_its_records_be_made_anew(
    operate: Operate, tmp_path: Path, make_split: MakeSplit
) -> None:
    held = put(tmp_path, make_split({"a": {}, "b": {}}))
    held.rename(held.with_name("split-1.json"))
    put(tmp_path, make_split({"a": {"part": "public"}, "b": {"part": "private"}}))
    for _ in range(2):
        code, _, err = operate("register-splits", "--words", "Half is kept for the end.")
        assert (code, err) == (0, "")


def test_an_earlier_revision_that_is_held_is_nothing_new(
    operate: Operate, tmp_path: Path, sqlite_url: str, make_split: MakeSplit
) -> None:
    """`exceptiondrive-server run --split FILE` adds the file of the first start at each start."""
    (tmp_path / "private").mkdir()
    first, later = (tmp_path / "private" / f"split-{name}.json" for name in ("first", "later"))
    for file, task in ((first, "SE1"), (later, "LB1")):
        split = make_split({"a": {"task": task}})
        file.write_text(split.model_dump_json(by_alias=True, exclude_none=True))
        sheet = datasheet_of(split).model_dump_json(by_alias=True)
        file.with_name(file.name.replace("split", "datasheet")).write_text(sheet)
    assert operate("add-split", str(first))[0] == 0
    assert operate("add-split", str(later), "--words", "One region lay wrong.")[0] == 0
    folder = tmp_path / "splits" / "tiny"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(before) == ["datasheet-1.json", "datasheet.json", "split-1.json", "split.json"]
    code, out, err = operate("add-split", str(first))
    assert (code, err) == (0, "")
    assert read_split(later).revision in out, "the current one is told"
    assert f"an earlier revision, {read_split(first).revision}: it is already held" in out
    assert "A datasheet beside it replaces the one held" in out
    assert "--split-revision" in out
    assert "it is at" not in out
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    sheet_file = first.with_name("datasheet-first.json")
    edited = Datasheet.model_validate_json(sheet_file.read_bytes()).model_copy(
        update={"title": "Another title"}
    )
    sheet_file.write_text(edited.model_dump_json(by_alias=True))
    assert operate("add-split", str(first))[0] == 0
    assert (folder / "datasheet-1.json").read_bytes() == sheet_file.read_bytes()
    for _ in range(2):
        assert operate("register-splits")[0] == 0
    with Database(sqlite_url).read() as session:
        replaced = select(AuditLine).where(AuditLine.action == "datasheet replaced")
        assert [line.detail for line in session.scalars(replaced)] == [
            {"revision": read_split(first).revision}
        ]
        shown = find_split(session, "tiny", read_split(first).revision).datasheet
        assert shown == edited


def test_records_that_are_made_anew_know_which_revision_is_the_current_one(
    operate: Operate, tmp_path: Path, sqlite_url: str, make_split: MakeSplit
) -> None:
    folder = tmp_path / "splits" / "tiny"
    write_floors(folder)
    for name, task in (("split.json", "RS1"), ("split-1.json", "SE1"), ("split-2.json", "LB1")):
        split = make_split({"a": {"task": task}})
        (folder / name).write_text(split.model_dump_json(by_alias=True, exclude_none=True))
    assert operate("register-splits")[0] == 0
    current = read_split(folder / "split.json").revision
    with Database(sqlite_url).read() as session:
        came = {row.revision: row.registered_at for row in list_splits(session)}
    assert came[current] == max(came.values())


@pytest.mark.parametrize("removed", [None, 1, 2], ids=["none removed", "first", "second"])
def test_every_revision_stays_whether_its_file_was_gzipped_or_not(
    operate: Operate, tmp_path: Path, make_split: MakeSplit, removed: int | None
) -> None:
    (tmp_path / "private").mkdir()
    folder, added = tmp_path / "splits" / "tiny", []
    for number, task in enumerate(("SE1", "LB1", "SR1", "IC1", "RS1")):
        split = make_split({"a": {"task": task}})
        text = split.model_dump_json(by_alias=True, exclude_none=True).encode()
        is_gzipped = number == 1
        source = tmp_path / "private" / f"new.json{'.gz' * is_gzipped}"
        source.write_bytes(gzip.compress(text) if is_gzipped else text)
        assert operate("add-split", str(source), "--words", "Another task.")[0] == 0
        assert current_split(SplitStore(folder.parent), "tiny")[0].revision == split.revision
        added.append(split.revision)
        if number == 3 and removed is not None:
            (gone,) = folder.glob(f"split-{removed}.json*")
            added.remove(read_split(gone).revision)
            gone.unlink()
    held = [read_split(path).revision for path in folder.glob("split*.json*")]
    assert sorted(held) == sorted(added)


def test_drives_are_added_to_a_split_and_to_its_registered_revision(
    operate: Operate, tmp_path: Path, sqlite_url: str, make_split: MakeSplit
) -> None:
    held = put(tmp_path, make_split({"a": {}, "b": {"task": "LB1"}}))
    before = read_split(held)
    operate("register-splits")
    drives, new = tmp_path / "private" / "drives.json.gz", tmp_path / "private" / "new.json.gz"
    drives.parent.mkdir()
    path = [[8.0 * step, 0.0] for step in range(1, 7)]
    rows = [{"sample_id": one, "source": path, "edited": path} for one in ("a", "b")]
    document = {"schema": "exceptiondrive.planning/1", "split": "tiny", "predictions": rows}
    drives.write_bytes(gzip.compress(json.dumps(document).encode()))
    code, out, err = operate("add-drives", str(held), str(drives), str(new))
    assert (code, err) == (0, "")
    assert out.startswith(f"{new}: 2 of 2 samples have a recorded drive\n")
    assert operate("add-drives", str(held), str(drives), str(new))[0] == 2, "never written over"
    after = read_split(new)
    assert [sample.region for sample in after.samples] == [one.region for one in before.samples]
    assert not after.recorded_is_public
    code, out, err = operate("add-split", str(new), "--words", "The drives were added.")
    assert (code, err) == (0, "")
    assert "no_recorded_drive" not in out
    assert read_split(held.with_name("split-1.json")).revision == before.revision
    assert read_split(held.with_name("split.json.gz")).revision == after.revision
    database = Database(sqlite_url)
    with database.read() as session:
        newest, first = list_splits(session)
        assert (newest.revision, newest.lacks_drives) == (after.revision, False)
        assert (first.revision, first.lacks_drives) == (before.revision, True)
        assert newest.changes is not None
        assert newest.changes.words == "The drives were added."
    database.dispose()
    document["split"] = "other"
    drives.write_bytes(json.dumps(document).encode())
    code, _, err = operate("add-drives", str(held.with_name("split-1.json")), str(drives), "x")
    assert code == 2
    assert "the drives are of split 'other'" in err
