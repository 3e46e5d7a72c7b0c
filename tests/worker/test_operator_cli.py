"""The operator's commands, called as an operator calls them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.support.made_pictures import png

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.splits.splits import find_split, list_splits
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker import operator_cli
from exceptiondrive_worker.split_store import read_split

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
    monkeypatch.setattr(operator_cli, "configure_logging", lambda: None)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["exceptiondrive-worker", *arguments])
        with pytest.raises(SystemExit) as ended:
            operator_cli.main()
        printed = capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    return run


Operate = Callable[..., tuple[int, str, str]]


def test_a_database_in_which_nothing_is_set_up_yet_is_said_to_be_one(
    operate: Operate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABASE_URL", f"sqlite:///{tmp_path}/empty.sqlite3")
    assert operate("make-sample")[0] == 0
    code, _, err = operate("register-splits")
    assert (code, err.count("\n")) == (2, 1)
    assert "no such table" in err
    assert "exceptiondrive-server migrate" in err
    assert "EXCEPTIONDRIVE_DATABASE_URL" in err


def put(tmp_path: Path, split: Split) -> Path:
    path = tmp_path / "splits" / split.name / "split.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(split.model_dump_json(by_alias=True, exclude_none=True))
    return path


def test_the_sample_is_made_registered_and_published(
    operate: Operate, tmp_path: Path, sqlite_url: str
) -> None:
    assert operate("make-sample")[0] == 0
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


def test_publishing_an_unknown_split_says_so(operate: Operate) -> None:
    code, _, err = operate("publish-split", "nosuch")
    assert code == 2
    assert err == "exceptiondrive-worker: there is no split file for 'nosuch'\n"


def test_make_planners_needs_no_server(operate: Operate, tmp_path: Path) -> None:
    code, out, _ = operate("make-planners", str(tmp_path / "planners"))
    assert code == 0
    listing: list[dict[str, Any]] = json.loads((tmp_path / "planners/planners.json").read_text())
    assert len(out.splitlines()) == len(listing)


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
    assert operate("remove-pictures", "sample")[:2] == (0, "sample: no picture is shown any more\n")
