"""Files that are no sound JSON text at all: sizes, gzip, other kinds, encodings, hostile ones."""

import gzip
import io
import json
import pickle
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import pytest

from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.check import (
    UnreadableFileError,
    check,
    fault_list,
    inflate,
    json_stream,
)
from exceptiondrive_schemas.check.json_stream import CHUNK_BYTES, MAX_VALUE_CHARACTERS
from exceptiondrive_schemas.faults import CheckReport, FaultCode
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest

Check = Callable[[bytes], CheckReport]


@pytest.fixture
def checked(protocol: ProtocolDocument, manifest: Manifest) -> Check:
    return lambda data: check(data, protocol=protocol, manifest=manifest).report


@pytest.fixture
def sound(planning: dict[str, Any]) -> bytes:
    return json.dumps(planning).encode()


def codes(report: CheckReport) -> list[FaultCode]:
    return [group.code for group in report.faults]


def zipped(name: str) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(name, "{}")
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (zipped("planning.json"), "a zip archive"),
        (zipped("source.npy"), "a NumPy archive (.npz)"),
        (pickle.dumps({}, protocol=4), "a Python pickle"),
        (b"PAR1" + bytes(20), "a Parquet file"),
        (b"\x93NUMPY\x01\x00", "a NumPy array (.npy)"),
        (b"\x28\xb5\x2f\xfd" + bytes(20), "Zstandard data"),
        (zlib.compress(b"{}"), "zlib data without a gzip header"),
        (gzip.compress(gzip.compress(b"{}", mtime=0), mtime=0), "gzip data inside gzip data"),
        (gzip.compress(b"x" * 257 + b"ustar", mtime=0), "a tar archive"),
        ("{}".encode("utf-16"), "UTF-16 or UTF-32 text"),
        ('{\r\n\t"schema": ""}'.encode("utf-16-le"), "UTF-16 or UTF-32 text"),
        (b"<!DOCTYPE html>", "an HTML or XML file"),
    ],
)
def test_a_file_of_another_kind_is_named(data: bytes, kind: str, checked: Check) -> None:
    report = checked(data)
    assert codes(report) == [FaultCode.WRONG_FILE_KIND]
    assert report.faults[0].examples[0].got.startswith(kind)


@pytest.mark.parametrize(
    ("data", "hint"),
    [
        (
            b"PAR1" + bytes(20),
            "`exceptiondrive convert FILE --split example` makes a submission of it",
        ),
        (
            zipped("source.npy"),
            "`exceptiondrive convert FILE --split example` makes a submission of it",
        ),
        (zipped("planning.json"), None),
        (b"[" * 100_000, None),
        (b"[[[4.0, 0.0]]]", None),
    ],
)
def test_what_convert_reads_is_said(data: bytes, hint: str | None, checked: Check) -> None:
    assert checked(data).faults[0].examples[0].hint == hint


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-5],
        lambda data: data[:20],
        lambda data: data + b"rubbish",
        lambda data: data + data,
        lambda data: data[:-8] + b"\x00\x00\x00\x00" + data[-4:],
        lambda data: data[:2],
    ],
    ids=["no end", "cut off", "rubbish behind", "two streams", "checksum", "magic alone"],
)
def test_damaged_gzip_is_refused(
    damage: Callable[[bytes], bytes], sound: bytes, checked: Check
) -> None:
    assert codes(checked(damage(gzip.compress(sound)))) == [FaultCode.DAMAGED_GZIP]


def test_a_gzip_bomb_is_inflated_no_further_than_the_limit() -> None:
    bomb = gzip.compress(bytes(50_000_000))
    assert len(bomb) < 60_000
    with pytest.raises(UnreadableFileError) as refused:
        inflate(bomb, max_inflated_bytes=1_000_000)
    assert refused.value.code is FaultCode.INFLATES_TOO_LARGE


@pytest.mark.parametrize("is_compressed", [True, False])
def test_the_limits_are_inclusive(is_compressed: bool) -> None:
    text = b" " * 1000
    data = gzip.compress(text) if is_compressed else text
    assert inflate(data, max_upload_bytes=len(data), max_inflated_bytes=1000) == text
    with pytest.raises(UnreadableFileError, match="at most 999 bytes of JSON"):
        inflate(data, max_inflated_bytes=999)
    with pytest.raises(UnreadableFileError, match=f"at most {len(data) - 1:,} bytes"):
        inflate(data, max_upload_bytes=len(data) - 1)


@pytest.mark.parametrize("data", [b"", b" \n\t ", gzip.compress(b"", mtime=0)])
def test_an_empty_file_is_called_empty(data: bytes, checked: Check) -> None:
    assert codes(checked(data)) == [FaultCode.EMPTY_FILE]


@pytest.mark.parametrize(
    ("data", "code", "expected", "got"),
    [
        (b"[]", FaultCode.WRONG_TYPE, "an object with the key `schema`", "a list"),
        (b"null", FaultCode.NOT_JSON, "{", '"null" at line 1 column 1'),
        (b"sample_id,x,y", FaultCode.NOT_JSON, "{", '"sample_id,x,y" at line 1 column 1'),
        (
            b"{",
            FaultCode.NOT_JSON,
            "a key in double quotes",
            "the end of the file at line 1 column 2",
        ),
        (b'{"a": 1', FaultCode.NOT_JSON, "a comma or }", "the end of the file at line 1 column 8"),
        (b'{\n "split" "x"}', FaultCode.NOT_JSON, "a colon", '""x"}" at line 2 column 10'),
        (
            b"{'split': 1}",
            FaultCode.NOT_JSON,
            "a key in double quotes",
            "\"'split':\" at line 1 column 2",
        ),
        (
            b'{"split": "a\nb"}',
            FaultCode.NOT_JSON,
            "no raw control character in a text (escape it)",
            "the end of the file at line 1 column 13",
        ),
        (
            b'{"split": "\\x"}',
            FaultCode.NOT_JSON,
            "a legal escape",
            '"\\x"}" at line 1 column 12',
        ),
        (
            b'{"schema": ["planning"]}',
            FaultCode.WRONG_TYPE,
            " or ".join(f'"{each.file_schema}"' for each in CHALLENGES.values()),
            "a list of 1 value",
        ),
    ],
)
def test_broken_json_is_shown_where_it_breaks(
    data: bytes, code: FaultCode, expected: str, got: str, checked: Check
) -> None:
    groups = {group.code: group.examples[0] for group in checked(data).faults}
    assert (groups[code].expected, groups[code].got) == (expected, got)


def test_faults_before_a_break_are_still_reported(planning: dict[str, Any], checked: Check) -> None:
    planning["predictions"][0]["source"][0] = [999.0, 0.0]
    report = checked(json.dumps(planning).encode()[:-40])
    assert codes(report) == [FaultCode.NOT_JSON, FaultCode.OUT_OF_BOUNDS]
    assert report.faults[0].examples[0].path == "$.predictions[2]"
    assert report.notes == ("Reading stopped there: what follows was not checked.",)


@pytest.mark.parametrize("shift", range(-3, 4))
def test_what_lies_across_a_chunk_is_read_whole(
    shift: int, planning: dict[str, Any], protocol: ProtocolDocument, manifest: Manifest
) -> None:
    text = json.dumps(planning).encode()
    middle = text.index(b"s-002") + 2
    blanks = b"\n" * (CHUNK_BYTES - middle + shift)
    report = check(b"{" + blanks + text[1:], protocol=protocol, manifest=manifest).report
    assert report.is_valid


def test_a_place_far_into_the_file_is_counted_in_lines_and_columns(checked: Check) -> None:
    report = checked(b"{" + b"\n" * (3 * CHUNK_BYTES) + '  "é" x'.encode())
    assert report.faults[0].examples[0].got == '"x" at line 3,145,729 column 7'


def test_a_value_may_be_as_long_as_the_limit_and_no_longer(
    planning: dict[str, Any], checked: Check
) -> None:
    text = json.dumps(planning, separators=(",", ":")).encode()
    spare = MAX_VALUE_CHARACTERS - len(text)
    padded = text.replace(b"1.5,0.0", b"1.5," + b" " * spare + b"0.0", 1)
    assert checked(padded + b" " * 2 * CHUNK_BYTES).is_valid
    too_long = text.replace(b"1.5,0.0", b"1.5," + b" " * 3 * CHUNK_BYTES + b"0.0", 1)
    assert FaultCode.VALUE_TOO_LONG in codes(checked(too_long))


@pytest.mark.parametrize("text", ["\\u0000", "\\ud800", "\\u202e", "\\u200b", "<script>", "é"])
def test_a_report_shows_texts_escaped_and_can_be_sent(
    text: str, planning: dict[str, Any], protocol: ProtocolDocument
) -> None:
    data = json.dumps(planning).replace('"example"', f'"{text}"').encode()
    report = check(data, protocol=protocol).report
    assert codes(report) == [FaultCode.WRONG_SPLIT]
    shown = report.faults[0].examples[0].got
    assert shown.isprintable()
    assert CheckReport.model_validate_json(report.model_dump_json()) == report


@pytest.mark.parametrize("text", ["\\u0000", "\\ud800", "\\u0007", "x" * 129])
def test_an_id_that_cannot_be_kept_is_refused_without_a_manifest(
    text: str, planning: dict[str, Any], protocol: ProtocolDocument
) -> None:
    data = json.dumps(planning).replace('"s-001"', f'"{text}"').encode()
    found = codes(check(data, protocol=protocol).report)
    assert found in ([FaultCode.INVALID_TEXT], [FaultCode.TEXT_TOO_LONG])


def test_reading_stops_after_so_many_faults(
    monkeypatch: pytest.MonkeyPatch, checked: Check
) -> None:
    monkeypatch.setattr(fault_list, "MAX_FAULTS", 1000)
    report = checked(b'{"predictions":[' + b"0," * 5000)
    assert codes(report) == [FaultCode.WRONG_TYPE]
    assert report.faults[0].count == 1000
    assert report.notes == ("Reading stopped after too many faults; the counts are incomplete.",)


def test_reading_over_a_second_list_stops_somewhere(
    monkeypatch: pytest.MonkeyPatch, checked: Check
) -> None:
    monkeypatch.setattr(json_stream, "MAX_SKIPPED", 1000)
    report = checked(b'{"schema":"x","predictions":[],"predictions":[' + b"0," * 5000)
    assert FaultCode.VALUE_TOO_LONG in codes(report)


HOSTILE = {
    "many empty lists": b'{"predictions":[' + b"[]," * 100_000,
    "one list of lists": b'{"predictions":[[' + b"[]," * 3_000_000,
    "many keys": b"{" + b"".join(b'"%d":0,' % n for n in range(40_000)),
    "equal keys": b'{"predictions":[{' + b'"a":0,' * 30_000 + b'"a":0}]}',
    "long text": b'{"split":"' + b"x" * 5_000_000,
    "faulty samples": b'{"predictions":['
    + b'{"sample_id":"\\ud800","source":[["",NaN]],"method":0},' * 10_000,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_report_stays_small_whatever_is_in_the_file(name: str, checked: Check) -> None:
    report = checked(HOSTILE[name])
    assert not report.is_valid
    assert len(report.model_dump_json()) < 20_000


MEMORY_PROBE = """
import resource, sys
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.protocol import packaged_protocol
protocol = packaged_protocol()
data = eval(sys.argv[1])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
report = check(data, protocol=protocol, max_upload_bytes=1 << 26).report
assert not report.is_valid
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs the resource module")
@pytest.mark.parametrize(
    "data",
    [
        """b'{"predictions":[[' + b"[]," * 20_000_000""",
        """b'{"predictions":[' + b"[" * 60_000_000""",
        """b'{"split":"' + b"\\xf0\\x9f\\x98\\x80" * 15_000_000""",
    ],
    ids=["list of lists", "depth", "wide characters"],
)
def test_the_worst_files_take_little_memory(data: str) -> None:
    grown = subprocess.run(
        [sys.executable, "-c", MEMORY_PROBE, data], capture_output=True, text=True, check=True
    )
    assert int(grown.stdout) < 64 * 1024, "kilobytes"
