"""I09 at a million: the checker stops after a counted amount of work, whatever stands in a file."""

import gzip

import pytest

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import check, json_stream
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_worker.upload_reader import read_upload

PROTOCOL = packaged_protocol()
MILLION = 1_000_000
MOST_VALUES = 210_000
"""Values that may be decoded: a key and a value for each of 100,000 members, and a few more."""
HEAD = b'{"schema":"exceptiondrive.planning/1","split":"tiny","predictions":'
MANIFEST = Manifest(
    schema_="exceptiondrive.manifest/1",
    name="tiny",
    title="Tiny",
    revision="sha256:0",
    waypoints=6,
    time_step_s=0.5,
    sample_ids=("s0", "s1"),
)


def numbered(before: bytes, item: bytes, after: bytes) -> bytes:
    return before + b",".join(item % number for number in range(MILLION)) + after


HUGE = {
    "keys": lambda: numbered(b"{", b'"%d":1', b"}"),
    "equal-keys": lambda: b"{" + b",".join([b'"split":1'] * MILLION) + b"}",
    "samples": lambda: numbered(HEAD + b"[", b'{"sample_id":"%d"}', b"]}"),
    "equal-samples": lambda: HEAD + b"[" + b",".join([b'{"sample_id":"s0"}'] * MILLION) + b"]}",
    "numbers": lambda: HEAD + b"[" + b",".join([b"1"] * MILLION) + b"]}",
    "keyed-samples": lambda: numbered(HEAD + b"{", b'"%d":1', b"}}"),
    "second-list": lambda: HEAD + b'[],"predictions":[' + b",".join([b"1"] * MILLION) + b"]}",
    "second-object": lambda: numbered(HEAD + b'[],"predictions":{', b'"%d":1', b"}}"),
    "inner-keys": lambda: numbered(HEAD + b"[{", b'"%d":1', b"}]}"),
    "waypoints": lambda: HEAD + b'[{"source":[' + b",".join([b"[1,2]"] * MILLION) + b"]}]}",
    "depth": lambda: HEAD + b"[" * 200_000,
    "closed-depth": lambda: HEAD + b"[" * 200_000 + b"]" * 200_000 + b"}",
    "blanks": lambda: HEAD + b" " * 20 * MILLION + b"[]}",
}


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many values the checker has decoded."""
    n_values = [0]
    value = json_stream.JsonStream.value

    def counted(stream: json_stream.JsonStream) -> object:
        n_values[0] += 1
        return value(stream)

    monkeypatch.setattr(json_stream.JsonStream, "value", counted)
    return n_values


@pytest.mark.row("I09")
@pytest.mark.parametrize("name", HUGE)
def test_a_million_of_anything_is_refused_after_bounded_work(name: str, decoded: list[int]) -> None:
    data = gzip.compress(HUGE[name](), 1)
    report = read_upload(data, challenge=PLANNING, manifest=MANIFEST, protocol=PROTOCOL)
    assert isinstance(report, CheckReport)
    assert report.faults
    assert decoded[0] <= MOST_VALUES
    assert len(report.model_dump_json()) < 32 * 1024


@pytest.mark.row("I09")
def test_every_coordinate_of_the_papers_split_may_be_wrong_and_is_counted() -> None:
    way = b"[" + b",".join([b"[null,null]"] * 6) + b"]"
    answer = b'{"sample_id":"%d","source":' + way + b',"edited":' + way + b"}"
    data = HEAD + b"[" + b",".join(answer % number for number in range(3181)) + b"]}"
    report = check(data, protocol=PROTOCOL).report
    assert sum(group.count for group in report.faults) >= 3181 * 12
    assert not report.notes
