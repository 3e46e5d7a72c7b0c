"""Every conversion that `check` advises, carried out as it stands, makes the file pass."""

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.schemas.test_walk import (
    ALL_FILES,
    MANIFEST,
    N,
    as_bytes,
    as_csv,
    predictions,
    report_of,
    said_of,
    sound,
)
from typer.testing import CliRunner

from exceptiondrive.checking import check_file
from exceptiondrive.cli import app
from exceptiondrive_schemas.faults import MAX_EXAMPLES, FaultCode

STEPS_S = {"60 waypoints": "0.1"}
"""What only its author knows: how far apart the waypoints of a file are."""
BY_HAND = {"seven kinds at once", "ids that begin as the name of their column"}
"""What takes more than one mend, of which conversion is one."""
UNTOUCHED = {"60 waypoints", "null inside a trajectory", "NaN and Infinity", "a huge number"}
UNTOUCHED |= {"NaN as a text", "one a second", "1 s apart", "None as a text", "nan as a text"}
UNTOUCHED |= {"an empty text", "empty lists for nothing", "false for nothing"}
"""What is mended here is not the file that all of them come from: other numbers, or null."""
COMMAND = re.compile("`exceptiondrive convert FILE([^`]*)`")


def advised(name: str) -> list[str]:
    """Return the options of the conversions that the report advises, shards apart."""
    found = dict.fromkeys(COMMAND.findall(said_of(report_of(name))))
    return [options for options in found if "FILE" not in options]


CURABLE = [name for name in ALL_FILES if name not in BY_HAND]


def test_most_files_have_a_cure() -> None:
    assert len([name for name in CURABLE if advised(name)]) > 38


@pytest.mark.parametrize("name", CURABLE)
def test_every_conversion_that_is_advised_mends_the_file(name: str, tmp_path: Path) -> None:
    for place, options in enumerate(advised(name)):
        require_mended(name, options, tmp_path / f"{place}.broken", tmp_path / f"{place}.json")


def require_mended(name: str, options: str, file: Path, output: Path) -> None:
    """Convert a file as advised; what comes out passes, and is the file that was meant."""
    file.write_bytes(ALL_FILES[name].make())
    words = shlex.split(options.replace("--time-step-s S", f"--time-step-s {STEPS_S.get(name)}"))
    done = CliRunner().invoke(app, ["convert", str(file), *words, "-o", str(output)])
    assert done.exit_code == 0, done.output
    report = check_file(output, manifest=MANIFEST)
    assert report.is_valid
    if name in UNTOUCHED:
        return
    assert report.profile is not None
    assert report.profile.warnings == ()
    mended = json.loads(output.read_bytes())["predictions"]
    assert {each["sample_id"] for each in mended} == {each["sample_id"] for each in predictions()}
    own = {each["sample_id"]: each for each in predictions()}
    for each in mended:
        for side in ("source", "edited"):
            assert [list(point) for point in each[side]] == [
                pytest.approx(point, abs=0.011) for point in own[each["sample_id"]][side]
            ]


def test_two_runs_become_a_submission_as_the_advice_for_one_says(tmp_path: Path) -> None:
    runs = [tmp_path / f"{side}.json" for side in ("source", "edited")]
    for run in runs:
        run.write_text(json.dumps({each["sample_id"]: each[run.stem] for each in predictions()}))
    report = check_file(runs[0], manifest=MANIFEST)
    (fault,) = (example for group in report.faults for example in group.examples)
    assert fault.got == f"an object with {N} trajectories by id"
    (advice,) = re.findall("`exceptiondrive ([^`]*)`", str(fault.hint))
    refused = CliRunner().invoke(app, ["convert", str(runs[0]), "--split", MANIFEST.name])
    assert refused.exit_code == 2
    assert "source.json is one run of a planner" in refused.stderr
    assert advice.replace(MANIFEST.name, "NAME") in refused.stderr
    output = tmp_path / "out.json"
    files = map(str, runs)
    words = [next(files) if word == "FILE" else word for word in shlex.split(advice)]
    done = CliRunner().invoke(app, [*words, "-o", str(output)])
    assert done.exit_code == 0, done.output
    assert check_file(output, manifest=MANIFEST).is_valid


def lines(start: int | None, stop: int | None) -> Callable[[bytes], bytes]:
    return lambda data: b"\n".join(data.splitlines()[start:stop])


def as_meant(data: bytes) -> bytes:
    """Take the ids that the examples of the report say were meant."""
    meant = {}
    document = json.loads(data)
    for start in range(0, N, MAX_EXAMPLES):
        part = document | {"predictions": document["predictions"][start : start + MAX_EXAMPLES]}
        (group,) = (
            group
            for group in check_file(as_bytes(part), manifest=MANIFEST).faults
            if group.code is FaultCode.UNKNOWN_SAMPLE
        )
        for each in group.examples:
            meant[json.loads(each.got)] = str(each.hint).split('"')[1]
    for prediction in document["predictions"]:
        prediction["sample_id"] = meant[prediction["sample_id"]]
    return as_bytes(document)


def test_what_the_advice_says_to_do_by_hand_mends_the_file() -> None:
    cures: dict[str, Callable[[bytes], bytes]] = {
        "a log before it": lines(2, None),
        "a log behind it": lines(None, 1),
        "paths of images as ids": as_meant,
        "ids in capitals": as_meant,
        "CSV without its header": lambda data: as_csv().splitlines()[0] + b"\n" + data,
    }
    for name, cure in cures.items():
        mended = cure(ALL_FILES[name].make())
        if name.startswith("CSV"):
            report = check_file(mended, manifest=MANIFEST)
            assert "`exceptiondrive convert FILE --split extract`" in said_of(report)
        else:
            assert json.loads(mended) == sound(), name


def test_shards_become_the_file(tmp_path: Path) -> None:
    report = check_file(
        as_bytes(sound() | {"predictions": predictions()[: N // 4]}), manifest=MANIFEST
    )
    assert "`exceptiondrive convert FILE FILE ...` makes one file" in said_of(report)
    names = []
    for number in range(4):
        path = tmp_path / f"{number}.json"
        path.write_bytes(as_bytes(sound() | {"predictions": predictions()[number::4]}))
        names.append(str(path))
    output = tmp_path / "whole.json"
    assert CliRunner().invoke(app, ["convert", *names, "-o", str(output)]).exit_code == 0
    assert check_file(output, manifest=MANIFEST).is_valid


def test_what_came_by_stdin_is_mended(tmp_path: Path) -> None:
    output = tmp_path / "mended.json"
    for name in ("a list of modes", "gzip files by cat"):
        done = CliRunner().invoke(
            app,
            ["convert", "-", "--mode", "0", "-o", str(output)],
            input=ALL_FILES[name].make(),
        )
        assert done.exit_code == 0, done.output
        assert json.loads(output.read_bytes())["predictions"] == predictions()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("CSV", "read CSV"),
        ("JSON lines", "read 160 JSON documents in a row"),
        ("UTF-16", "read text with a byte order mark, or in another encoding than UTF-8"),
        ("a foreign schema", "read a file of the schema 'my.planner/1'"),
        ("None as a text", "read text in the place of null"),
    ],
)
def test_convert_says_which_form_it_read(name: str, said: str, tmp_path: Path) -> None:
    file, output = tmp_path / "broken", tmp_path / "mended.json"
    file.write_bytes(ALL_FILES[name].make())
    done = CliRunner().invoke(
        app, ["convert", str(file), "--split", "extract", "-o", str(output), "--json"]
    )
    assert said in json.loads(done.stdout)["done"]


def test_convert_that_fails_speaks_of_no_submission(tmp_path: Path) -> None:
    file = tmp_path / "broken"
    file.write_bytes(ALL_FILES["centimetres"].make())
    done = CliRunner().invoke(app, ["convert", str(file), "-o", str(tmp_path / "out.json")])
    assert done.exit_code == 2
    assert "was not written" in done.stderr
    assert "submit again" not in done.stderr
