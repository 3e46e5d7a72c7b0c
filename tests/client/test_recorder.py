import ast
import gzip
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.full_disk import room_for
from tests.support.pythons import pythons

from exceptiondrive.recorder import Recorder, RecorderError, StrategyRecorder

STRAIGHT = [[1.0 * step, 0.0] for step in range(1, 7)]


def test_it_writes_a_submission_file(tmp_path: Path) -> None:
    path = tmp_path / "planner.json"
    with Recorder(path, split="sample") as recorder:
        recorder.add("s1", source=STRAIGHT, edited=None)
    assert json.loads(path.read_text()) == {
        "schema": "exceptiondrive.planning/1",
        "split": "sample",
        "predictions": [{"sample_id": "s1", "source": STRAIGHT, "edited": None}],
    }
    assert sorted(tmp_path.iterdir()) == [path]


def test_a_gz_suffix_compresses_and_equal_content_gives_equal_bytes(tmp_path: Path) -> None:
    for name in ("a.json.gz", "b.json.gz"):
        with Recorder(tmp_path / name, split="sample") as recorder:
            recorder.add("s1", source=STRAIGHT, edited=STRAIGHT)
    first, second = ((tmp_path / name).read_bytes() for name in ("a.json.gz", "b.json.gz"))
    assert first == second
    assert json.loads(gzip.decompress(first))["predictions"][0]["sample_id"] == "s1"


def test_behind_a_link_its_target_is_written(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "planner.json").symlink_to(tmp_path / "kept" / "run.json")
    with Recorder(tmp_path / "planner.json", split="sample") as recorder:
        recorder.add("s1", source=STRAIGHT, edited=None)
    assert (tmp_path / "planner.json").is_symlink()
    assert json.loads((tmp_path / "kept" / "run.json").read_text())["split"] == "sample"


def test_a_named_pipe_is_written_into_and_stays(pipe: tuple[Path, Callable[[], bytes]]) -> None:
    path, all_read = pipe
    with Recorder(path, split="sample") as recorder:
        recorder.add("s1", source=STRAIGHT, edited=None)
    assert json.loads(all_read())["split"] == "sample"


class Offers:
    """An array of another library, as of TensorFlow: `__array__` and no `tolist`."""

    def __init__(self, array: Any) -> None:
        self.array = np.asarray(array)

    def __array__(self) -> "np.ndarray[Any, Any]":
        return self.array


def test_two_that_record_to_one_path_are_told_before_one_loses_the_samples_of_the_other(
    tmp_path: Path,
) -> None:
    path = tmp_path / "p.json"
    first, second = (Recorder(path, split="sample") for _ in range(2))
    first.add("s1", source=STRAIGHT, edited=STRAIGHT)
    with pytest.raises(RecorderError, match=r"another process records to .* a path of its own"):
        second.add("s2", source=STRAIGHT, edited=STRAIGHT)
    with pytest.raises(RecorderError, match="another process records to"):
        first.write()
    for each in (first, second):
        each.close()
    assert not path.exists()
    journal = Path(f"{path}.journal")
    head, *samples = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join([head, head, *samples]))  # as if both had begun at once
    with Recorder(path, split="sample") as again:
        assert ("s1" in again, "s2" in again) == (True, True)


def test_who_goes_on_after_another_has_written_the_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    with Recorder(path, split="sample") as first:
        first.add("s1", source=STRAIGHT, edited=STRAIGHT)
        second = Recorder(path, split="sample")
    with pytest.raises(RecorderError, match="another process records to"):
        second.add("s2", source=STRAIGHT, edited=STRAIGHT)
    second.close()
    assert [each["sample_id"] for each in json.loads(path.read_text())["predictions"]] == ["s1"]


def test_it_takes_arrays_tuples_and_numpy_scalars(tmp_path: Path) -> None:
    array = np.array(STRAIGHT, dtype=np.float32)
    rows = [(np.float64(x), int(y)) for x, y in STRAIGHT]
    with Recorder(tmp_path / "p.json", split="sample") as recorder:
        recorder.add("s1", source=array, edited=rows)
        recorder.add("s2", source=list(array), edited=tuple(map(tuple, STRAIGHT)))
        recorder.add("s3", source=Offers(array), edited=[Offers(row) for row in array])
    for prediction in json.loads((tmp_path / "p.json").read_text())["predictions"]:
        assert prediction["source"] == prediction["edited"] == STRAIGHT


@pytest.mark.parametrize(
    ("edited", "message"),
    [
        (STRAIGHT[:5], "needs exactly 6 waypoints, got 5"),
        ([[0.0, 0.0], *STRAIGHT], "leave out the point at t = 0"),
        (STRAIGHT + STRAIGHT, r"take those at 0.5, 1.0, ... 3.0 s: at 10 a second"),
        ([STRAIGHT], r"the one trajectory out of its batch: trajectory\[0\]"),
        (np.zeros((2, 6)), r"a row of x and one of y: trajectory.T"),
        ([[1.0, 2.0]] * 2, "needs exactly 6 waypoints, got 2$"),
        ([[1.0, 0.0, 0.1]] * 6, "leave out the heading"),
        ([[1.0]] * 6, r"must be \[x, y\]"),
        ([[math.nan, 0.0]] * 6, "record None where the planner failed"),
        ([[0.0, -math.inf]] * 6, "not finite"),
        ([[10**400, 0]] * 6, "not finite"),
        ([["1", "2"]] * 6, "must hold numbers"),
        ([[True, False]] * 6, "must hold numbers"),
        ("standing", "must be a list of waypoints or None"),
        (np.zeros((6, 3)), "leave out the heading"),
    ],
)
def test_a_trajectory_that_cannot_be_scored_is_refused_when_added(
    tmp_path: Path, edited: object, message: str
) -> None:
    with Recorder(tmp_path / "p.json", split="sample") as recorder:
        recorder.add("good", source=None, edited=STRAIGHT)
        with pytest.raises(RecorderError, match=message) as caught:
            recorder.add("s1", source=STRAIGHT, edited=edited)
        assert "s1: edited" in str(caught.value)
    ids = [p["sample_id"] for p in json.loads((tmp_path / "p.json").read_text())["predictions"]]
    assert ids == ["good"]


def test_a_sample_is_recorded_once(tmp_path: Path) -> None:
    with Recorder(tmp_path / "p.json", split="sample") as recorder:
        recorder.add("s1", source=STRAIGHT, edited=STRAIGHT)
        assert "s1" in recorder
        assert len(recorder) == 1
        with pytest.raises(RecorderError, match="already recorded"):
            recorder.add("s1", source=STRAIGHT, edited=STRAIGHT)


@pytest.mark.parametrize("sample_id", ["", "x" * 129, 7, None])
def test_a_sample_id_is_short_text(tmp_path: Path, sample_id: object) -> None:
    recorder = Recorder(tmp_path / "p.json", split="sample")
    with pytest.raises(RecorderError, match="sample_id must be text"):
        recorder.add(sample_id, source=None, edited=None)  # type: ignore[arg-type]
    recorder.close()


def test_an_exception_keeps_the_journal_and_writes_no_file(tmp_path: Path) -> None:
    path = tmp_path / "p.json"

    def planner_that_dies() -> None:
        with Recorder(path, split="sample") as recorder:
            recorder.add("s1", source=STRAIGHT, edited=STRAIGHT)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        planner_that_dies()
    assert not path.exists()
    with Recorder(path, split="sample") as recorder:
        assert "s1" in recorder
        recorder.add("s2", source=STRAIGHT, edited=STRAIGHT)
    assert len(json.loads(path.read_text())["predictions"]) == 2


def test_a_line_that_a_dead_run_did_not_finish_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    recorder = Recorder(path, split="sample")
    recorder.add("s1", source=STRAIGHT, edited=STRAIGHT)
    recorder.close()
    with Path(recorder.journal_path).open("a") as journal:
        journal.write('{"sample_id": "s2", "source": [[1.0, 0')
    with Recorder(path, split="sample") as recorder:
        assert "s1" in recorder
        assert "s2" not in recorder
        recorder.add("s2", source=None, edited=None)
    assert len(json.loads(path.read_text())["predictions"]) == 2


@pytest.mark.parametrize("rubbish", ["rubbish", "[" * 100_000], ids=["words", "deep"])
def test_a_damaged_journal_is_not_dropped_in_silence(tmp_path: Path, rubbish: str) -> None:
    journal = tmp_path / "p.json.journal"
    journal.write_text(f'{{"schema": "exceptiondrive.planning/1", "split": "sample"}}\n{rubbish}\n')
    with pytest.raises(RecorderError, match=f"damaged at b'{re.escape(rubbish[:60])}'"):
        Recorder(tmp_path / "p.json", split="sample")
    assert rubbish in journal.read_text()


def test_a_journal_of_another_split_is_refused(tmp_path: Path) -> None:
    Recorder(tmp_path / "p.json", split="sample").close()
    with pytest.raises(RecorderError, match="belongs to another recording"):
        Recorder(tmp_path / "p.json", split="other")


def test_an_empty_recording_is_an_error(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "p.json", split="sample")
    with pytest.raises(RecorderError, match="nothing was recorded"):
        recorder.write()
    recorder.close()


def test_a_manifest_refuses_unknown_samples_and_names_missing_ones(tmp_path: Path) -> None:
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({"name": "sample", "sample_ids": ["s1", "s2"], "waypoints": 6}))
    recorder = Recorder(tmp_path / "p.json", split="sample", manifest=manifest)
    recorder.add("s1", source=STRAIGHT, edited=STRAIGHT)
    with pytest.raises(RecorderError, match="no such sample"):
        recorder.add("s3", source=STRAIGHT, edited=STRAIGHT)
    with pytest.raises(RecorderError, match=r"1 samples .* missing, the first: s2"):
        recorder.write()
    assert recorder.missing == {"s2"}
    recorder.add("s2", source=STRAIGHT, edited=STRAIGHT)
    recorder.write()
    assert (tmp_path / "p.json").exists()


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        ({"name": "other", "sample_ids": ["s1"]}, "manifest of 'other'"),
        ({"name": "sample"}, "is not a manifest"),
        ({"name": "sample", "sample_ids": ["s1"], "waypoints": 8}, "asks for 8 waypoints"),
    ],
)
def test_a_wrong_manifest_is_refused(
    tmp_path: Path, manifest: dict[str, object], message: str
) -> None:
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RecorderError, match=message):
        Recorder(tmp_path / "p.json", split="sample", manifest=tmp_path / "manifest.json")


def test_strategies_are_recorded_with_their_reminder(tmp_path: Path) -> None:
    with StrategyRecorder(tmp_path / "a.json", split="sample") as recorder:
        recorder.add("s1", strategy="C", reminder={"hazard_present": True, "risk_level": "high"})
        recorder.add("s2", strategy=None, reminder={"hazard_type": "of_another_protocol"})
        for wrong in ("stop", ["A"], np.array(["A", "B"])):
            with pytest.raises(RecorderError, match="one of A, B, C, D, E or None"):
                recorder.add("s3", strategy=wrong)  # type: ignore[arg-type]
        for key, value, told in (
            ("hazard_type", 7, "expected a task id or null, got a number"),
            ("risk_level", "High", 'expected none, low, medium, high or null, got "High"'),
            ("recommended_strategy", "stop", 'expected A, B, C, D, E or null, got "stop"'),
            ("hazard_present", 1, "expected true, false or null, got a number"),
            ("evidence", "x" * 2001, "got 2,001"),
            ("safety_constraint", "a\x00b", "got"),
        ):
            with pytest.raises(RecorderError, match=f"^s3: reminder.{key}: .*{told}"):
                recorder.add("s3", strategy="C", reminder={key: value})
        with pytest.raises(RecorderError, match="unknown reminder key colour"):
            recorder.add("s3", strategy="C", reminder={"colour": "red"})
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "schema": "exceptiondrive.strategy/1",
        "split": "sample",
        "predictions": [
            {
                "sample_id": "s1",
                "strategy": "C",
                "reminder": {"hazard_present": True, "risk_level": "high"},
            },
            {
                "sample_id": "s2",
                "strategy": None,
                "reminder": {"hazard_type": "of_another_protocol"},
            },
        ],
    }


def test_of_strategies_one_process_records_those_of_all(tmp_path: Path) -> None:
    first, second = (StrategyRecorder(tmp_path / "a.json", split="sample") for _ in range(2))
    first.add("s1", strategy="C")
    with pytest.raises(RecorderError, match="let one process record the answers of all"):
        second.add("s2", strategy="C")
    for each in (first, second):
        each.close()


def test_a_reminder_that_json_cannot_hold_is_refused_by_its_sample(tmp_path: Path) -> None:
    wrong: Any
    with StrategyRecorder(tmp_path / "a.json", split="sample") as recorder:
        for wrong in (math.nan, ["high"], {"evidence": math.nan}, {"evidence": {"van"}}, {1: 2}):
            with pytest.raises(RecorderError, match="s1: "):
                recorder.add("s1", strategy="C", reminder=wrong)
        recorder.add("s1", strategy="C", reminder={"hazard_present": np.bool_(True)})
    document = json.loads((tmp_path / "a.json").read_text())
    assert document["predictions"][0]["reminder"] == {"hazard_present": True}
    with pytest.raises(RecorderError, match="a split is named by"):
        Recorder(tmp_path / "b.json", split=math.nan)  # type: ignore[arg-type]


def test_a_full_disk_loses_no_sample_that_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "planner.json"
    names = [f"s{number}" for number in range(40)]

    def record_all() -> None:
        with Recorder(path, split="sample") as recorder:
            for name in names:
                if name not in recorder:
                    recorder.add(name, source=STRAIGHT, edited=None)

    with pytest.raises(RecorderError, match="the samples before stay in it"), room_for(2_000):
        record_all()
    assert not path.exists()
    left = Recorder(path, split="sample")
    assert 0 < len(left) < len(names)
    left.close()
    record_all()
    assert [each["sample_id"] for each in json.loads(path.read_text())["predictions"]] == names


def test_a_file_for_which_there_is_no_room_leaves_the_journal_and_no_half(tmp_path: Path) -> None:
    path = tmp_path / "planner.json"
    recorder = Recorder(path, split="sample")
    recorder.add("s1", source=STRAIGHT, edited=None)
    with pytest.raises(RecorderError, match="what is recorded stays in"), room_for(20):
        recorder.write()
    assert sorted(tmp_path.iterdir()) == [tmp_path / "planner.json.journal"]
    assert recorder.write() == str(path)


def test_a_recording_that_was_closed_takes_no_more(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "planner.json", split="sample")
    recorder.close()
    with pytest.raises(RecorderError, match="is closed; open another"):
        recorder.add("s1", source=STRAIGHT, edited=None)


KILLED_PLANNER = """
import os, signal, sys
from recorder import Recorder
with Recorder(sys.argv[1], split="sample") as recorder:
    for i in range(4):
        if "s%d" % i in recorder:
            continue
        if i == 2 and len(sys.argv) > 2:
            os.kill(os.getpid(), signal.SIGKILL)
        recorder.add("s%d" % i, source=[[float(i), 0.0]] * 6, edited=None)
"""


@pytest.mark.parametrize(
    "python", [*pythons().values(), Path(sys.executable)], ids=lambda path: path.parts[-3]
)
def test_a_copied_recorder_survives_sigkill_on_every_python_found(
    tmp_path: Path, python: Path
) -> None:
    import exceptiondrive.recorder

    if sys.platform == "win32":
        pytest.skip("SIGKILL is not a Windows signal")
    source = Path(exceptiondrive.recorder.__file__).read_text(encoding="utf-8")
    (tmp_path / "recorder.py").write_text(source, encoding="utf-8")
    (tmp_path / "planner.py").write_text(KILLED_PLANNER, encoding="utf-8")
    run = [str(python), "-E", "planner.py", "out.json.gz"]
    killed = subprocess.run(
        [*run, "die"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert killed.returncode == -9, killed.stderr
    assert not (tmp_path / "out.json.gz").exists()
    finished = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    document = json.loads(gzip.decompress((tmp_path / "out.json.gz").read_bytes()))
    assert [p["sample_id"] for p in document["predictions"]] == ["s0", "s1", "s2", "s3"]


def test_an_older_python_was_found() -> None:
    if min(pythons(), default=(3, 11)) >= (3, 11):
        pytest.skip("no Python older than 3.11 here: the recorder ran on newer ones alone")


def test_the_recorder_keeps_to_python_3_6() -> None:
    import exceptiondrive.recorder

    source = Path(exceptiondrive.recorder.__file__).read_text(encoding="utf-8")
    assert ast.parse(source, feature_version=(3, 6)).body


def test_the_recorder_needs_nothing_but_the_standard_library() -> None:
    code = (
        "import sys; import exceptiondrive.recorder; "
        "print(sorted({'pydantic', 'numpy', 'httpx', 'typer'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
