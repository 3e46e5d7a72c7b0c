"""One kind of argument everywhere: the same submission, split and manifest in every form."""

import gzip
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import pandas as pd
import pytest

from exceptiondrive import (
    Client,
    ExceptionDriveError,
    InvalidArgumentError,
    Recorder,
    check_file,
    evaluate_file,
    evaluate_samples,
)
from exceptiondrive.checking import manifest_of
from exceptiondrive.inputs import given_manifest, given_protocol, given_split, given_submission
from exceptiondrive_schemas.split import Manifest, Split

if TYPE_CHECKING:
    from tests.client.servers import Running

MakeFile = Callable[..., Path]
IDS = [f"s{number}" for number in range(4)]
PATH = np.array([[4.0 * step, 0.0] for step in range(1, 7)], dtype=np.float32)
BROKEN = np.full((6, 2), np.nan)


class Offers:
    """An array of another library, as of TensorFlow or h5py: `__array__` and no `tolist`."""

    def __init__(self, array: Any) -> None:
        self.array = np.asarray(array)

    def __array__(self) -> "np.ndarray[Any, Any]":
        return self.array


class OtherFrame:
    """A data frame of another library, as of polars: its series offer `__array__` alone."""

    def __init__(self, columns: dict[str, Any]) -> None:
        self.columns = list(columns)
        self._columns = columns

    def __getitem__(self, name: str) -> Offers:
        return Offers(self._columns[name])

    def to_dict(self, *, as_series: bool = True) -> dict[str, Any]:
        return {name: self[name] for name in self.columns} if as_series else dict(self._columns)


def arrays() -> dict[str, Any]:
    """The file of `planning_file` with one answer missing, as a planner has it in memory."""
    return {
        "sample_id": np.array(IDS),
        "source": np.stack([PATH] * 4),
        "edited": np.stack([PATH, PATH, PATH, BROKEN]),
    }


def waypoints() -> pd.DataFrame:
    rows = [
        {"sample_id": sample_id, "trajectory": side, "step": step + 1, "x_m": x, "y_m": y}
        for sample_id in IDS
        for side in ("source", "edited")
        if (sample_id, side) != ("s3", "edited")
        for step, (x, y) in enumerate(PATH.tolist())
    ]
    return pd.DataFrame(rows).sample(frac=1, random_state=1)  # in no order


def in_steps(*steps: object) -> pd.DataFrame:
    """One trajectory, its rows in the order of these steps."""
    whose = {"sample_id": "s0", "trajectory": "source"}
    return pd.DataFrame(
        [
            {**whose, "step": step, "x_m": x, "y_m": y}
            for step, (x, y) in zip(steps, PATH.tolist(), strict=True)
        ]
    )


def closed(path: Path) -> BinaryIO:
    with path.open("rb") as stream:
        return stream


def nested(depth: int) -> list[Any]:
    outer: list[Any] = []
    for _ in range(depth):
        outer = [outer]
    return outer


@pytest.fixture
def document() -> dict[str, Any]:
    predictions = [
        {
            "sample_id": sample_id,
            "source": PATH.tolist(),
            "edited": None if sample_id == "s3" else PATH,
        }
        for sample_id in IDS
    ]
    schema = "exceptiondrive.planning/1"
    return {"schema": schema, "split": "tiny", "predictions": predictions}


def test_a_submission_is_the_same_in_every_form(
    tmp_path: Path, split_file: Path, document: dict[str, Any]
) -> None:
    data = given_submission(document).data
    path = tmp_path / "planner.json.gz"
    path.write_bytes(gzip.compress(data))
    exact = evaluate_file(path, split=split_file)
    assert exact.coverage.edited == 0.75
    with path.open("rb") as stream:
        forms: list[Any] = [str(path), data, bytearray(data), io.BytesIO(data), stream, document]
        forms += [arrays(), waypoints()]
        forms += [{name: Offers(column) for name, column in arrays().items()}, OtherFrame(arrays())]
        listed = {name: list(column) for name, column in arrays().items()}
        forms += [pd.DataFrame(listed), {name: pd.Series(listed[name]) for name in listed}]
        for form in forms:
            assert evaluate_file(form, split=split_file) == exact, type(form)
    assert evaluate_samples(arrays(), split=split_file) == evaluate_samples(path, split=split_file)


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ((1, 2, 4, 5, 6, 7), "s0: source: steps must run from 0 or 1 without a gap"),
        ((2, 3, 4, 5, 6, 7), "s0: source: steps must run from 0 or 1 without a gap"),
        ((5, 10, 15, 20, 25, 30), "s0: source: steps must run from 0 or 1 without a gap"),
        ((1, 2, 3, 4, 5, 5), "row 6: step 5 occurs twice"),
        ((1, 2, 3, 4, 5, np.nan), "row 6: step must be a whole number"),
    ],
)
def test_steps_of_a_data_frame_are_those_of_a_csv_file(
    steps: tuple[object, ...], said: str
) -> None:
    with pytest.raises(InvalidArgumentError, match=f"data frame: {said}"):
        given_submission(in_steps(*steps), "tiny")


def test_steps_that_are_texts_are_in_the_order_of_numbers() -> None:
    """As texts, 10 would stand before 2."""
    frame = pd.concat([in_steps(*map(str, numbers)) for numbers in (range(1, 7), range(7, 13))])
    frame["x_m"] = range(12)
    (prediction,) = json.loads(given_submission(frame, "tiny").data)["predictions"]
    assert [x for x, _ in prediction["source"]] == [*range(12)]


def test_a_split_is_the_same_in_every_form(planning_file: MakeFile, split_file: Path) -> None:
    exact = evaluate_file(planning_file(), split=split_file)
    data = split_file.read_bytes()
    for form in (str(split_file), data, gzip.compress(data), json.loads(data), given_split(data)):
        assert evaluate_file(planning_file(), split=form) == exact


def test_a_manifest_is_the_same_in_every_form(
    tmp_path: Path, planning_file: MakeFile, split_file: Path
) -> None:
    manifest = Manifest.of(given_split(split_file), given_protocol(None).geometry)
    text = manifest.model_dump_json(by_alias=True)
    path = tmp_path / "m.json"
    path.write_text(text)
    missing = planning_file(predictions=[])
    exact = check_file(missing, manifest=path)
    assert not exact.is_valid
    newer = {**json.loads(text), "of_a_newer_server": 1}
    for form in (
        str(path),
        text.encode(),
        json.loads(text),
        newer,
        manifest,
        given_split(split_file),
    ):
        assert check_file(missing, manifest=form).faults == exact.faults
    assert given_manifest(manifest) is manifest


@pytest.mark.parametrize("protocol", [True, 5, 1.0, {}, b"1.1", "9.9", "a\0", "\ud800"])
def test_what_is_no_protocol_is_refused(planning_file: MakeFile, protocol: Any) -> None:
    with pytest.raises(InvalidArgumentError, match="is neither a protocol file nor a v") as told:
        check_file(planning_file(), protocol=protocol)
    assert told.value.sentence.startswith(f"{protocol!r} is")
    assert ("A version is a text" in told.value.advice) == (not isinstance(protocol, str))


def test_what_pandas_calls_missing_is_null() -> None:
    columns = {"sample_id": ["s0", "s1"], "strategy": pd.array(["1. Stop", pd.NA], dtype="string")}
    frame = waypoints().convert_dtypes()
    frame.loc[frame["sample_id"] == "s0", ["x_m", "y_m"]] = pd.NA
    for given, key in (
        (columns, "strategy"),
        (pd.DataFrame(columns), "strategy"),
        (frame, "source"),
    ):
        predictions = json.loads(given_submission(given, "tiny").data)["predictions"]
        missing = [each["sample_id"] for each in predictions if each[key] is None]
        assert missing == ["s0" if key == "source" else "s1"]


@pytest.mark.parametrize("named", ["tiny", None])
def test_a_split_that_is_named_goes_before_that_of_what_is_given(named: str | None) -> None:
    frame = waypoints()
    frame.attrs["split"] = "own"
    for given in (frame, {**arrays(), "split": "own"}):
        assert json.loads(given_submission(given, named).data)["split"] == (named or "own")


def test_a_byte_order_mark_before_a_split_or_manifest_is_passed_over(
    tmp_path: Path, split_file: Path
) -> None:
    split = given_split(split_file)
    manifest = Manifest.of(split, given_protocol(None).geometry)
    marked = tmp_path / "marked.json"
    marked.write_text(split_file.read_text("utf-8"), encoding="utf-8-sig")
    assert given_split(marked) == split
    assert given_manifest(gzip.compress(manifest.model_dump_json().encode("utf-8-sig"))) == manifest


def test_what_json_cannot_hold_is_told_with_what_it_can() -> None:
    as_bytes = {**arrays(), "sample_id": np.array(IDS, dtype="S2")}
    with pytest.raises(InvalidArgumentError, match="type bytes is not JSON") as told:
        check_file(as_bytes)
    assert ".astype(str)" in told.value.advice


def test_a_manifest_in_the_place_of_a_split_says_where_splits_are(
    planning_file: MakeFile, split_file: Path
) -> None:
    wrong: Any = Manifest.of(given_split(split_file), given_protocol(None).geometry)
    with pytest.raises(InvalidArgumentError, match="is of type Manifest") as told:
        evaluate_file(planning_file(), split=wrong)
    assert "exceptiondrive split download" in told.value.advice


def test_an_empty_name_is_said_to_be_empty() -> None:
    with Client("http://127.0.0.1:9") as client, pytest.raises(InvalidArgumentError, match="empty"):
        client.status("")


def test_who_names_a_split_and_no_file_of_it_is_told_where_to_take_it(
    planning_file: MakeFile,
) -> None:
    with pytest.raises(InvalidArgumentError, match="cannot be read") as caught:
        evaluate_file(planning_file(), split="sample")
    assert "exceptiondrive split download" in caught.value.advice
    with pytest.raises(InvalidArgumentError, match="cannot be read") as caught:
        check_file(planning_file(), manifest="dev")
    assert "exceptiondrive manifest PHASE" in caught.value.advice


def test_a_series_is_no_submission() -> None:
    with pytest.raises(InvalidArgumentError, match="is of type Series, which is not taken") as told:
        check_file(pd.Series([1.0]))
    assert "columns `sample_id`, `source` and `edited`" in told.value.advice


@pytest.mark.parametrize(
    ("text", "said"), [('{"schema":' + " " * 5000, "JSON in"), (" ", "an empty")]
)
def test_a_text_that_is_no_path_is_not_said_back(text: str, said: str) -> None:
    with pytest.raises(InvalidArgumentError, match=f"is {said}.* text; a text is taken as") as told:
        check_file(text)
    assert "text.encode()" in told.value.advice
    assert len(str(told.value)) < 200


def test_columns_that_are_not_equally_long_are_told_with_their_lengths() -> None:
    with pytest.raises(InvalidArgumentError, match="sample_id 4, source 4, edited 3") as told:
        check_file({**arrays(), "edited": np.stack([PATH] * 3)})
    assert "one value a sample" in told.value.sentence


def with_drives(split_file: Path, n_waypoints: int) -> Split:
    document = json.loads(split_file.read_text())
    for sample in document["samples"]:
        sample["recorded"] = [[2.0 * step, 0.1] for step in range(1, n_waypoints + 1)]
    return Split.model_validate_json(json.dumps(document))


@pytest.mark.parametrize("n_waypoints", [0, 5, 7])
def test_drives_of_other_waypoints_than_the_protocol_asks_for_are_refused(
    planning_file: MakeFile, split_file: Path, n_waypoints: int
) -> None:
    split = with_drives(split_file, n_waypoints)
    for reads in (
        lambda: check_file(planning_file(), manifest=split),
        lambda: evaluate_file(planning_file(), split=split),
    ):
        with pytest.raises(
            InvalidArgumentError, match="4 recorded paths of other than 6 waypoints"
        ):
            reads()


def test_a_manifest_with_drives_of_other_waypoints_than_it_tells_is_refused(
    planning_file: MakeFile, split_file: Path
) -> None:
    manifest = manifest_of(with_drives(split_file, 6), given_protocol(None))
    document = {**json.loads(manifest.model_dump_json(by_alias=True)), "waypoints": 5}
    with pytest.raises(InvalidArgumentError, match="4 recorded paths of other than 5 waypoints"):
        check_file(planning_file(), manifest=document)


@pytest.mark.parametrize(("waypoints", "time_step_s"), [(12, 0.5), (6, 0.25)])
def test_drives_at_other_times_than_the_protocol_asks_for_are_compared_with_nothing(
    planning_file: MakeFile, split_file: Path, waypoints: int, time_step_s: float
) -> None:
    usual = given_protocol(None)
    manifest = manifest_of(with_drives(split_file, 6), usual)
    times = {"waypoints": waypoints, "time_step_s": time_step_s}
    other = usual.model_copy(update={"geometry": usual.geometry.model_copy(update=times)})
    path = [[2.0 * step, 0.1] for step in range(1, waypoints + 1)]
    told = [{"sample_id": each, "source": path, "edited": path} for each in IDS]
    compared = check_file(planning_file(), manifest=manifest).profile
    profile = check_file(planning_file(predictions=told), manifest=manifest, protocol=other).profile
    assert compared is not None
    assert profile is not None
    assert compared.source_l2_m is not None
    assert profile.source_l2_m is None


def test_the_recorder_takes_a_manifest_too(tmp_path: Path, split_file: Path) -> None:
    manifest = Manifest.of(given_split(split_file), given_protocol(None).geometry)
    for form in (manifest, json.loads(manifest.model_dump_json(by_alias=True))):
        with Recorder(tmp_path / "p.json", split="tiny", manifest=form) as recorder:
            for sample_id in IDS:
                recorder.add(sample_id, source=PATH, edited=None)
            with pytest.raises(ExceptionDriveError, match="no such sample"):
                recorder.add("s9", source=None, edited=None)


def test_strategies_come_as_a_data_frame(split_file: Path) -> None:
    table = pd.DataFrame({"sample_id": IDS, "strategy": ["A", "B", None, "C"]})
    assert check_file(table, manifest=given_split(split_file)).challenge == "strategy"
    assert evaluate_file(table, split=split_file).coverage.edited == 0.75


def test_a_client_submits_what_is_in_memory(working: "Running") -> None:
    with working.client() as client:
        view = client.submit(
            {**arrays(), "edited": np.stack([PATH] * 4)}, phase="dev", method="In memory"
        ).wait()
        assert view.rank == 1
        assert client.check(waypoints(), phase="dev").is_valid


@pytest.mark.parametrize(
    "call",
    [
        lambda split: check_file(17),  # type: ignore[arg-type]
        lambda split: check_file("no such file"),
        lambda split: check_file("nul\0"),
        lambda split: check_file(closed(split)),
        lambda split: check_file(io.StringIO("{}")),  # type: ignore[arg-type]
        lambda split: check_file({"a": object()}),
        lambda split: check_file(b"{}", manifest=split.parent),
        lambda split: check_file(b"{}", manifest=b"{}"),
        lambda split: check_file(b"{}", manifest=3),  # type: ignore[arg-type]
        lambda split: check_file(b"{}", protocol="9.9"),
        lambda split: check_file(b"{}", protocol=split),
        lambda split: evaluate_file(b"{}", split={"schema": "x"}),
        lambda split: evaluate_file(b"{}", split={"samples": nested(5000)}),
        lambda split: evaluate_file(b"{}", split=split),
        lambda split: evaluate_file({"sample_id": ["a"], "source": []}, split=split),
        lambda split: evaluate_file(pd.DataFrame({"trajectory": ["source"]}), split=split),
        lambda split: evaluate_file(waypoints().replace("source", "both"), split=split),
        lambda split: Recorder(split.with_name("p.json"), "tiny", manifest=3),
        lambda split: Recorder(split.with_name("p.json"), "tiny", manifest="nowhere"),
    ],
)
def test_what_is_wrong_is_an_error_of_this_package(
    call: Callable[[Path], Any], split_file: Path
) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        call(split_file)
    assert caught.value.sentence
    assert caught.value.exit_code == 2
