"""The fast reader and the precise checker give one verdict and equal arrays."""

import gzip
import json
import random
import zlib
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support import extract, realdata
from tests.support.two_readings import check_both_ways
from zlib_ng import zlib_ng

from exceptiondrive_schemas.challenges import CHALLENGES, PLANNING, STRATEGY, Challenge, ChallengeId
from exceptiondrive_schemas.check import UnreadableFileError, inflate
from exceptiondrive_schemas.faults import CheckReport, FaultCode
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Manifest, Split
from exceptiondrive_scoring.challenge import document_columns
from exceptiondrive_worker.upload_reader import FAST_READERS, read_upload

READ_FAST = [CHALLENGES[challenge_id] for challenge_id in FAST_READERS]
PROTOCOL = packaged_protocol()
N_SAMPLES = 24  # enough for the frame check to look


def manifest_of(sample_ids: list[str], name: str = "example") -> Manifest:
    return Manifest(
        schema_="exceptiondrive.manifest/1",
        name=name,
        title="Test",
        revision="sha256:0",
        waypoints=6,
        time_step_s=0.5,
        sample_ids=tuple(sorted(sample_ids)),
    )


MANIFEST = manifest_of([f"s-{index:02d}" for index in range(N_SAMPLES)])


def trajectory(speed_m: float) -> list[list[float]]:
    return [[speed_m * t, -0.25 * t] for t in range(1, 7)]


def planning_file() -> dict[str, Any]:
    predictions: list[dict[str, Any]] = [
        {"sample_id": sample_id, "source": trajectory(1.5), "edited": trajectory(index / 8)}
        for index, sample_id in enumerate(reversed(MANIFEST.sample_ids))
    ]
    predictions[3]["edited"] = None
    predictions[5]["source"] = None
    return {"schema": PLANNING.file_schema, "split": "example", "predictions": predictions}


def strategy_file() -> dict[str, Any]:
    predictions: list[dict[str, Any]] = [
        {"sample_id": sample_id, "strategy": "ABCDE"[index % 5]}
        for index, sample_id in enumerate(MANIFEST.sample_ids)
    ]
    predictions[1]["strategy"] = None
    predictions[2]["reminder"] = None
    predictions[3]["reminder"] = {}
    predictions[4]["reminder"] = {
        "hazard_present": False,
        "hazard_type": "SE1",
        "relative_location": "left",
        "risk_level": "low",
        "evidence": "",
        "safety_constraint": None,
        "recommended_strategy": "B",
    }
    return {"schema": STRATEGY.file_schema, "split": "example", "predictions": predictions}


FILES: dict[ChallengeId, Callable[[], dict[str, Any]]] = {
    PLANNING.id: planning_file,
    STRATEGY.id: strategy_file,
}


def assert_one_verdict(text: bytes, challenge: Challenge, manifest: Manifest = MANIFEST) -> bool:
    """The fast reader never accepts what the checker refuses, and then reads the same."""
    fast = FAST_READERS[challenge.id](text, manifest, PROTOCOL)
    checked = check_both_ways(text, protocol=PROTOCOL, manifest=manifest, challenge=challenge.id)
    check_both_ways(text, protocol=PROTOCOL)
    read = read_upload(text, challenge=challenge, manifest=manifest, protocol=PROTOCOL)
    if checked.document is None:
        assert fast is None, checked.report
        assert read == checked.report.to_keep()
        return False
    assert not isinstance(read, CheckReport)
    precise = document_columns(checked.document, manifest.sample_ids)
    for columns in (read, fast or read):
        assert columns.keys() == precise.keys()
        for name, column in columns.items():
            assert column.dtype == precise[name].dtype
            assert column.tobytes() == precise[name].tobytes(), name
    return True


@pytest.mark.parametrize("challenge", READ_FAST, ids=tuple(FAST_READERS))
@pytest.mark.parametrize("indent", [None, 2])
def test_a_sound_file_is_read_fast(challenge: Challenge, indent: int | None) -> None:
    text = json.dumps(FILES[challenge.id](), indent=indent).encode()
    assert FAST_READERS[challenge.id](text, MANIFEST, PROTOCOL) is not None
    assert assert_one_verdict(text, challenge)


@pytest.mark.parametrize("challenge", READ_FAST, ids=tuple(FAST_READERS))
def test_rows_are_in_the_order_of_the_manifest(challenge: Challenge) -> None:
    document = FILES[challenge.id]()
    text = json.dumps(document).encode()
    random.Random(7).shuffle(document["predictions"])
    shuffled = json.dumps(document).encode()
    first, second = (
        read_upload(each, challenge=challenge, manifest=MANIFEST, protocol=PROTOCOL)
        for each in (text, shuffled)
    )
    assert not isinstance(first, CheckReport)
    assert not isinstance(second, CheckReport)
    for name in first:
        assert first[name].tobytes() == second[name].tobytes()


def test_a_missing_trajectory_is_a_row_of_nan() -> None:
    document = planning_file()
    text = json.dumps(document).encode()
    read = read_upload(text, challenge=PLANNING, manifest=MANIFEST, protocol=PROTOCOL)
    assert not isinstance(read, CheckReport)
    sample_id = document["predictions"][3]["sample_id"]
    row = MANIFEST.sample_ids.index(sample_id)
    assert np.isnan(read["edited"][row]).all()
    assert np.isnan(read["edited"]).sum() == 12
    np.testing.assert_array_equal(read["source"][row], trajectory(1.5))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"split": "example"', b'"split": "ex\\u0061mple"'),
        (b'"s-07"', b'"s-\\u0030\\u0037"'),
        (b'"edited": null', b'"\\u0065dited": null'),
        (b"-0.25", b"-25e-2"),
        (b"9.0", b"9"),
        (b"-0.25", b"-0.0"),
        (b"-0.25", b"-0"),
        (b"1.5,", b"1.500000000000000000000000000000000000000000000000000001,"),
        (b"1.5,", b"1.4999999999999997779553950749686919152736663818359376,"),
        (b"1.5,", b"15000000000000000000000000e-25,"),
        (b"-0.25", b"1e-400"),
    ],
)
def test_an_unusual_but_sound_file_is_accepted(old: bytes, new: bytes) -> None:
    text = json.dumps(planning_file()).encode()
    assert old in text
    assert assert_one_verdict(text.replace(old, new, 1), PLANNING)


def assert_both_find(challenge: Challenge, old: bytes, new: bytes, code: FaultCode) -> None:
    """A sound file with one text in place of another has this fault, for both readers."""
    text = json.dumps(FILES[challenge.id]()).encode()
    assert old in text
    broken = text.replace(old, new, 1)
    assert not assert_one_verdict(broken, challenge)
    report = read_upload(broken, challenge=challenge, manifest=MANIFEST, protocol=PROTOCOL)
    assert isinstance(report, CheckReport)
    assert code in {group.code for group in report.faults}


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        (b"-0.25", b"NaN", FaultCode.NON_FINITE),
        (b"-0.25", b"-Infinity", FaultCode.NON_FINITE),
        (b"-0.25", b"1e309", FaultCode.NON_FINITE),
        (b"-0.25", b"1" + b"0" * 400, FaultCode.NON_FINITE),
        (b"-0.25", b"7" * 5000, FaultCode.NON_FINITE),
        (b"-0.25", b"251", FaultCode.OUT_OF_BOUNDS),
        (b"-0.25", b"1e154", FaultCode.OUT_OF_BOUNDS),
        (b"-0.25", b"30.0000001", FaultCode.STEP_TOO_LONG),
        (b"-0.25", b'"-0.25"', FaultCode.WRONG_TYPE),
        (b"-0.25", b"true", FaultCode.WRONG_TYPE),
        (b"-0.25", b"null", FaultCode.WRONG_TYPE),
        (b"-0.25", b"-0.25, 0.0", FaultCode.WRONG_WAYPOINT_SHAPE),
        (b"[1.5, -0.25], ", b"", FaultCode.WRONG_WAYPOINT_COUNT),
        (b"[[1.5", b"[[0, 0], [1.5", FaultCode.WRONG_WAYPOINT_COUNT),
        (b'"edited": null', b'"edited": null, "edited": null', FaultCode.DUPLICATE_KEY),
        (b'"edited": null', b'"edited": null, "\\u0065dited": null', FaultCode.DUPLICATE_KEY),
        (b'"schema"', b'"split": "example", "schema"', FaultCode.DUPLICATE_KEY),
        (b'"edited": null', b'"edited": null, "x": null', FaultCode.UNKNOWN_KEY),
        (b', "edited": null', b"", FaultCode.MISSING_KEY),
        (b'"s-07"', b'"s-08"', FaultCode.DUPLICATE_SAMPLE),
        (b'"s-07"', b'"s-7"', FaultCode.UNKNOWN_SAMPLE),
        (b'"s-07"', b'"s-07\\u0000"', FaultCode.UNKNOWN_SAMPLE),
        (b'"s-07"', b'"\\ud800"', FaultCode.UNKNOWN_SAMPLE),
        (b'"s-07"', b'"s-\xff"', FaultCode.NOT_UTF8),
        (b'"s-07"', b'"s-\xed\xa0\x80"', FaultCode.NOT_UTF8),
        (b'"example"', b'"other"', FaultCode.WRONG_SPLIT),
        (b"planning/1", b"strategy/1", FaultCode.WRONG_SCHEMA),
        (b'{"schema"', b'\xef\xbb\xbf{"schema"', FaultCode.BYTE_ORDER_MARK),
        (b"]}]}", b"]}]} {}", FaultCode.TRAILING_DATA),
        (b"]}]}", b"]}]", FaultCode.NOT_JSON),
        (b"-0.25", b"-.25", FaultCode.NOT_JSON),
        (b"[[1.5, -0.25], ", b"1.5[[, -0.25], ", FaultCode.NOT_JSON),
        (b"[[1.5, -0.25], ", b"[[1.5, -0.25]7, ", FaultCode.NOT_JSON),
        (b"[[1.5, -0.25], ", b"[[1.5, -0.25, ], [", FaultCode.NOT_JSON),
        (b"[[1.5, -0.25], ", b"[[1.5 -0.25], ", FaultCode.NOT_JSON),
        (b"1.5, -0.25", b"1.5, - 0.25", FaultCode.NOT_JSON),
        (b"-0.25", b"[" * 200_000, FaultCode.NESTED_TOO_DEEPLY),
    ],
)
def test_a_fault_is_found_by_both_readers(old: bytes, new: bytes, code: FaultCode) -> None:
    assert_both_find(PLANNING, old, new, code)


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        (b'"strategy": "A"', b'"strategy": "F"', FaultCode.UNKNOWN_STRATEGY),
        (b'"strategy": "A"', b'"strategy": 1', FaultCode.WRONG_TYPE),
        (b'"reminder": {}', b'"reminder": "stop"', FaultCode.WRONG_TYPE),
        (b'"reminder": {}', b'"reminder": {"colour": "red"}', FaultCode.UNKNOWN_KEY),
        (b'"SE1"', b'"XX1"', FaultCode.UNKNOWN_HAZARD_TYPE),
        (b'"low"', b'"extreme"', FaultCode.UNKNOWN_RISK_LEVEL),
        (b'"left"', b'"' + b"x" * 2001 + b'"', FaultCode.TEXT_TOO_LONG),
        (b'"left"', b'"\\u001b[31m"', FaultCode.INVALID_TEXT),
    ],
)
def test_a_fault_of_strategies_is_found_by_both_readers(
    old: bytes, new: bytes, code: FaultCode
) -> None:
    assert_both_find(STRATEGY, old, new, code)


@pytest.mark.parametrize("challenge", READ_FAST, ids=tuple(FAST_READERS))
def test_a_prediction_that_is_too_long_for_its_blanks_gets_one_verdict(
    challenge: Challenge,
) -> None:
    text = json.dumps(FILES[challenge.id]()).encode()
    assert not assert_one_verdict(
        text.replace(b'"s-07",', b'"s-07",' + b" " * 2_000_000), challenge
    )


def turned(x_m: float, y_m: float) -> bytes:
    document = planning_file()
    for prediction in document["predictions"]:
        prediction["source"] = [[x_m * t, y_m * t] for t in range(1, 7)]
    return json.dumps(document).encode()


@pytest.mark.parametrize("x_m", [1.0, 1 - 1e-9, 1 + 1e-9, 0.5, -1.0, 0.0])
def test_the_frame_is_judged_alike(x_m: float) -> None:
    assert assert_one_verdict(turned(x_m, 1.0), PLANNING) == (x_m >= 1.0)


@pytest.mark.parametrize("metres_on", [0.0, 0.001, 0.02, 0.3, 2.0])
@pytest.mark.parametrize("first_m", [0.5, 5.0, 20.0])
def test_trajectories_that_do_not_begin_at_the_car_are_judged_alike(
    first_m: float, metres_on: float
) -> None:
    document = planning_file()
    for prediction in document["predictions"]:
        prediction["source"] = [[first_m + metres_on * t / 5, 0.0] for t in range(6)]
    is_of_the_car = first_m < 1 or metres_on > 0.01
    assert assert_one_verdict(json.dumps(document).encode(), PLANNING) == is_of_the_car


PIECES = (
    rb'" \ { } [ ] , : null NaN 1e999 - 0 9 . e true "A" A "edited" "sample_id" '
    b'"source":null, "strategy":"A", "reminder":{}, \\u0041 \x00 \x7f \xc3\xa9 \xff'
)
REPLACEMENTS = st.sampled_from([*PIECES.split(b" "), b" ", b"\n"])


@pytest.mark.row("I31")
@pytest.mark.parametrize("challenge", READ_FAST, ids=tuple(FAST_READERS))
@settings(max_examples=400, deadline=None)
@given(data=st.data())
def test_any_mutation_gets_one_verdict(challenge: Challenge, data: st.DataObject) -> None:
    text = json.dumps(FILES[challenge.id](), separators=(",", ":")).encode()
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        length = data.draw(st.integers(0, 6))
        text = (
            text[:start] + data.draw(REPLACEMENTS | st.binary(max_size=3)) + text[start + length :]
        )
    assert_one_verdict(text, challenge)


NUMBERS = st.one_of(
    st.floats(-250, 250, allow_nan=False).map(repr),
    st.integers(-(10**25), 10**25).map(str),
    st.decimals(-40, 40, places=25, allow_nan=False).map(str),
    st.sampled_from(["-0", "0.0", "1E1", "-2.5e+0", "01", "+1", "1.", "0x1", "30", "200"]),
)


@settings(max_examples=300, deadline=None)
@given(numbers=st.lists(NUMBERS, min_size=1, max_size=4))
def test_any_number_is_read_alike(numbers: list[str]) -> None:
    text = json.dumps(planning_file())
    for number in numbers:
        text = text.replace("-0.25", number, 1)
    assert_one_verdict(text.encode(), PLANNING)


def inflated(data: bytes, library: ModuleType) -> bytes | str:
    try:
        return inflate(data, max_inflated_bytes=20_000, library=library)
    except UnreadableFileError as refused:
        return str(refused)


@given(data=st.data())
def test_a_damaged_gzip_stream_is_judged_alike_by_worker_and_client(data: st.DataObject) -> None:
    text = json.dumps(planning_file()).encode() * data.draw(st.integers(1, 4))
    level = data.draw(st.integers(0, 9))
    stream = bytearray(gzip.compress(text, level, mtime=0))
    for place in data.draw(st.lists(st.integers(0, len(stream) - 1), max_size=3)):
        stream[place] ^= 1 << data.draw(st.integers(0, 7))
    end = data.draw(st.integers(0, len(stream)) | st.just(len(stream)))
    behind = data.draw(st.sampled_from([b"", b"\0", b"x" * 100, gzip.compress(text, mtime=0)]))
    sent = bytes(stream[:end]) + behind
    assert inflated(sent, zlib) == inflated(sent, zlib_ng)


@pytest.mark.parametrize("place", range(10))
@pytest.mark.parametrize("bit", range(8))
def test_each_bit_of_a_gzip_head_is_judged_alike(place: int, bit: int) -> None:
    stream = bytearray(gzip.compress(json.dumps(planning_file()).encode(), mtime=0))
    stream[place] ^= 1 << bit
    assert inflated(bytes(stream), zlib) == inflated(bytes(stream), zlib_ng)


REAL_FILES = [(split, method) for split, methods in realdata.PLANNERS.items() for method in methods]


@pytest.mark.parametrize("planner", extract.PLANNERS)
def test_files_of_the_extract_are_read_fast_and_alike(planner: str) -> None:
    made = extract.make_extract()
    text = extract.unpacked(made.files[planner])
    assert_fast_and_alike(text, Split.model_validate_json(json.dumps(made.split)))


@pytest.mark.parametrize(("split_name", "method"), REAL_FILES)
def test_real_planner_files_are_read_fast_and_alike(split_name: str, method: str) -> None:
    realdata.require()
    document = gzip.decompress(realdata.split_path(split_name).read_bytes())
    text = gzip.decompress(realdata.file_path(split_name, method).read_bytes())
    assert_fast_and_alike(text, Split.model_validate_json(document))


def assert_fast_and_alike(text: bytes, split: Split) -> None:
    manifest = manifest_of([sample.sample_id for sample in split.samples], split.name)
    assert FAST_READERS[PLANNING.id](text, manifest, PROTOCOL) is not None
    assert assert_one_verdict(text, PLANNING, manifest)
