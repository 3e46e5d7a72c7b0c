"""The 45 broken files of an outside reader's walk, and more: what the report says mends them.

Each is made from one sound file, and checked with the manifest of its split, which tells the
recorded drives. A row says which faults there are, how they are counted, and the words without
which a reader would have to look elsewhere.
"""

import csv
import gzip
import io
import json
import math
import pickle
import random
import tarfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import pytest
from tests.support.extract import Path6, make_extract

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.check.transformations import (
    at_times,
    mirrored,
    rotated,
    scaled,
    swapped,
)
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Manifest

Document = dict[str, Any]
EXTRACT = make_extract()
DRIVES = EXTRACT.recorded
N = len(DRIVES)
ALL = f"in {N} of {N} samples"
MANIFEST = Manifest(
    schema_="exceptiondrive.manifest/1",
    name="extract",
    title="Made",
    revision="sha256:" + "0" * 64,
    waypoints=6,
    time_step_s=0.5,
    sample_ids=tuple(DRIVES),
    recorded={sample_id: tuple(drive) for sample_id, drive in DRIVES.items()},
    challenge=PLANNING.id,
)


def planned(drive: Path6, chance: random.Random) -> Path6:
    pace = chance.gauss(1.0, 0.08)
    return [(round(x * pace, 3), round(y * pace + 0.01, 3)) for x, y in drive]


def braked(path: Path6) -> Path6:
    shares = (1.0, 0.8, 0.65, 0.55, 0.48, 0.42)
    return [(round(x * s, 3), round(y * s, 3)) for (x, y), s in zip(path, shares, strict=True)]


def sound() -> Document:
    chance = random.Random(3)
    predictions = []
    for sample_id, drive in DRIVES.items():
        source = planned(drive, chance)
        predictions.append({"sample_id": sample_id, "source": source, "edited": braked(source)})
    return {
        "schema": "exceptiondrive.planning/1",
        "split": "extract",
        "predictions": json.loads(json.dumps(predictions)),
    }


def as_bytes(document: Any) -> bytes:
    return json.dumps(document).encode()


def paths(change: Callable[[Path6], Any]) -> bytes:
    """Return the sound file with every trajectory changed."""
    document = sound()
    for prediction in document["predictions"]:
        for side in ("source", "edited"):
            prediction[side] = change([(x, y) for x, y in prediction[side]])
    return as_bytes(document)


def first(change: Callable[[Document], None], n: int = 1) -> bytes:
    """Return the sound file with its first predictions changed."""
    document = sound()
    for prediction in document["predictions"][:n]:
        change(prediction)
    return as_bytes(document)


def outer(**changes: Any) -> bytes:
    return as_bytes(sound() | changes)


def put(value: Any) -> Callable[[Document], None]:
    """Put a value in place of the x of the third edited waypoint."""

    def change(prediction: Document) -> None:
        prediction["edited"][2][0] = value

    return change


def renamed() -> bytes:
    names = {"sample_id": "id", "source": "src", "edited": "edited_trajectory"}
    return outer(
        predictions=[{names[key]: value for key, value in each.items()} for each in predictions()]
    )


def predictions() -> list[Document]:
    found: list[Document] = sound()["predictions"]
    return found


def as_csv() -> bytes:
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(["sample_id", "trajectory", "step", "x_m", "y_m"])
    for each in predictions():
        rows.writerows(
            [each["sample_id"], side, step, *point]
            for side in ("source", "edited")
            for step, point in enumerate(each[side], start=1)
        )
    return text.getvalue().encode()


def in_zip() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("planner.json", as_bytes(sound()))
    return stream.getvalue()


def in_tar() -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        info = tarfile.TarInfo("planner.json")
        data = as_bytes(sound())
        info.size = len(data)
        archive.addfile(info, io.BytesIO(data))
    return stream.getvalue()


def sampled(step_s: float) -> Callable[[Path6], Any]:
    def sample(path: Path6) -> Any:
        (x0, y0), (x1, y1) = path[-2:]
        beyond = [(x1 + k * (x1 - x0), y1 + k * (y1 - y0)) for k in range(1, 7)]
        return at_times([*path, *beyond], 0.5, [step_s * step for step in range(1, 7)])

    return sample


def increments(path: Path6) -> Any:
    return [(x - x0, y - y0) for (x0, y0), (x, y) in zip([(0.0, 0.0), *path], path, strict=False)]


def exchanged() -> bytes:
    return outer(
        predictions=[
            {**each, "source": each["edited"], "edited": each["source"]} for each in predictions()
        ]
    )


def seven_kinds() -> bytes:
    document = sound()
    one, two, three, four, five = document["predictions"][:5]
    one["edited"][2][0] = float("nan")
    two["source"] = two["source"][:5]
    three["edited"][0] = [31.0, 0.0]
    four["colour"] = "red"
    five["sample_id"] = "nobody"
    document["predictions"].append(one)
    return as_bytes(document | {"team": "us"})


@dataclass(frozen=True)
class Row:
    """A broken file, and what its report has to say."""

    make: Callable[[], bytes]
    faults: Mapping[str, str] = field(default_factory=dict)
    """By code, how they are counted."""
    words: Sequence[str] = ()


WALK: dict[str, Row] = {
    "wrong key names": Row(
        renamed,
        {"unknown_key": f"{3 * N} keys"},
        [
            'did you mean "sample_id"?',
            'did you mean "source"?',
            'did you mean "edited"?',
        ],
    ),
    "NaN and Infinity": Row(
        lambda: first(put(float("nan"))),
        {"non_finite": f"1 number in 1 of {N} samples"},
        ["write null in place of the whole trajectory", "convert FILE --null-invalid"],
    ),
    "a huge number": Row(
        lambda: first(put(10**400)),
        {"non_finite": f"1 number in 1 of {N} samples"},
        ["too large to hold", "convert FILE --null-invalid"],
    ),
    "null inside a trajectory": Row(
        lambda: first(put(None)),
        {"wrong_type": f"1 value in 1 of {N} samples"},
        ["null stands for the whole trajectory"],
    ),
    "x right, y forward": Row(
        lambda: paths(lambda path: rotated(path, 1)),
        {"wrong_frame": "1 fault"},
        [
            "looks like x right / y forward: swap to (y, -x), `exceptiondrive convert FILE --rotate -90`"
        ],
    ),
    "x and y exchanged": Row(
        lambda: paths(swapped),
        {"wrong_frame": "1 fault"},
        ["looks like x and y exchanged (x left, y forward): `exceptiondrive convert FILE --swap`"],
    ),
    "mirrored": Row(
        lambda: paths(mirrored),
        {},
        ["looks like mirrored (y to the right)", "convert FILE --mirror"],
    ),
    "global": Row(
        lambda: paths(lambda path: [(x + 365_000.0, y + 143_000.0) for x, y in path]),
        {"wrong_frame": "1 fault"},
        ["looks like global or pixel coordinates", "by its pose"],
    ),
    "degrees": Row(
        lambda: paths(lambda path: [(1.3 + x / 111_000, 103.8 + y / 111_000) for x, y in path]),
        {"wrong_frame": "1 fault"},
        ["looks like degrees of latitude and longitude"],
    ),
    "centimetres": Row(
        lambda: paths(lambda path: scaled(path, 100)),
        {"wrong_frame": "1 fault"},
        ["m/s: looks like centimetres", "convert FILE --unit centimetres"],
    ),
    "missing samples": Row(
        lambda: outer(predictions=predictions()[40:]),
        {"missing_sample": "40 samples"},
        ["write one for every sample"],
    ),
    "doubles": Row(
        lambda: outer(predictions=predictions() + predictions()[:3]),
        {"duplicate_sample": "3 predictions in 3 of 163 samples"},
        ["also at $.predictions[0]"],
    ),
    "extra samples": Row(
        lambda: outer(
            predictions=[*predictions(), {"sample_id": "nobody", "source": None, "edited": None}]
        ),
        {"unknown_sample": "1 sample"},
        ["take the ids from the split's manifest"],
    ),
    "CSV": Row(
        as_csv,
        {"not_json": "1 fault"},
        ["looks like CSV with commas; `exceptiondrive convert FILE --split extract` makes"],
    ),
    "JSON lines": Row(
        lambda: b"\n".join(map(as_bytes, predictions())),
        {"trailing_data": "1 fault"},
        ["looks like JSON lines; `exceptiondrive convert FILE --split extract` makes"],
    ),
    "a bare list": Row(
        lambda: as_bytes(predictions()),
        {"wrong_type": "1 value"},
        ["a bare list of predictions; `exceptiondrive convert FILE --split extract` makes"],
    ),
    "by sample id": Row(
        lambda: as_bytes({each.pop("sample_id"): each for each in predictions()}),
        {"wrong_type": "1 value"},
        ["160 values under other keys", "`exceptiondrive convert FILE --split extract` makes"],
    ),
    "zip": Row(in_zip, {"wrong_file_kind": "1 fault"}, ["a zip archive", "send JSON"]),
    "tar.gz": Row(in_tar, {"wrong_file_kind": "1 fault"}, ["a tar archive", "send JSON"]),
    "pickle": Row(
        lambda: pickle.dumps(sound()),
        {"wrong_file_kind": "1 fault"},
        ["a Python pickle (never loaded", "send JSON"],
    ),
    "empty": Row(lambda: b"", {"empty_file": "1 fault"}, ["finished writing it"]),
    "half a gzip": Row(
        lambda: gzip.compress(as_bytes(sound()))[:-300],
        {"damaged_gzip": "1 fault"},
        ["was the upload or the copy cut off?"],
    ),
    "half a JSON": Row(
        lambda: as_bytes(sound())[:-300],
        {"not_json": "1 fault"},
        ["the end of the file", "what follows was not checked"],
    ),
    "a byte order mark": Row(
        lambda: b"\xef\xbb\xbf" + as_bytes(sound()),
        {"byte_order_mark": "1 fault"},
        ["save it as UTF-8 without", "`exceptiondrive convert FILE` writes it without"],
    ),
    "UTF-16": Row(
        lambda: as_bytes(sound()).decode().encode("utf-16"),
        {"wrong_file_kind": "1 fault"},
        ["UTF-16 or UTF-32 text", "`exceptiondrive convert FILE --split extract` makes"],
    ),
    "Latin-1": Row(
        lambda: as_bytes(sound()).replace(b"scene_0000/01", b"sc\xe8ne_0000/01"),
        {"not_utf8": "1 fault"},
        ["save it as UTF-8", "byte 0xe8"],
    ),
    "60 waypoints": Row(
        lambda: paths(lambda path: [(0.1 * step, 0.0) for step in range(1, 61)]),
        {"wrong_waypoint_count": f"{2 * N} trajectories {ALL}"},
        [
            "60 waypoints",
            "`exceptiondrive convert FILE --time-step-s S --truncate`, S the planner's own",
        ],
    ),
    "0.1 s apart": Row(
        lambda: paths(sampled(0.1)),
        {},
        [
            "looks like waypoints 0.1 s apart (the last at 0.6 s",
            "no conversion can mend that: let the planner plan 3 s ahead",
        ],
    ),
    "1 s apart": Row(
        lambda: paths(sampled(1.0)),
        {},
        ["looks like waypoints 1 s apart", "convert FILE --time-step-s 1 --truncate"],
    ),
    "increments": Row(
        lambda: paths(increments),
        {},
        ["looks like increments instead of positions", "convert FILE --cumulative"],
    ),
    "reversed time": Row(
        lambda: paths(lambda path: path[::-1]),
        {"step_too_long": f"19 steps in 19 of {N} samples"},
        ["looks like reversed in time", "convert FILE --reverse"],
    ),
    "source and edited exchanged": Row(
        exchanged, {}, ["looks like source and edited exchanged", "convert FILE --exchange"]
    ),
    "strings for numbers": Row(
        lambda: paths(lambda path: [(str(x), str(y)) for x, y in path]),
        {"wrong_type": f"{24 * N:,} values {ALL}"},
        ["numbers without", "`exceptiondrive convert FILE` does"],
    ),
    "a list of modes": Row(
        lambda: paths(lambda path: [path, path, path]),
        {"wrong_waypoint_shape": f"{2 * N} waypoints {ALL}"},
        ["a list of 3 trajectories", "not several modes", "convert FILE --mode 0"],
    ),
    "a trailing comma": Row(
        lambda: as_bytes(sound())[:-2] + b",]}",
        {"not_json": "1 fault"},
        ["a comma stands in front of this bracket: remove it"],
    ),
    "a comment": Row(
        lambda: as_bytes(sound()).replace(b'"split"', b'// my planner\n"split"', 1),
        {"not_json": "1 fault"},
        ["looks like a comment: JSON has none, remove it"],
    ),
    "Python's own words": Row(
        lambda: repr(sound()).encode(),
        {"not_json": "1 fault"},
        ["a key in double quotes", "write it with a JSON library"],
    ),
    "another split": Row(
        lambda: outer(
            split="carla",
            predictions=[
                {**each, "sample_id": f"carla/{n}"} for n, each in enumerate(predictions())
            ],
        ),
        {"wrong_split": "1 fault"},
        ['"carla"', "choose the phase that the file was made for"],
    ),
    "another challenge": Row(
        lambda: as_bytes(
            {
                "schema": "exceptiondrive.strategy/1",
                "split": "extract",
                "predictions": [
                    {"sample_id": each["sample_id"], "strategy": "C"} for each in predictions()
                ],
            }
        ),
        {"wrong_schema": "1 fault"},
        ["this is a strategy file, and a planning file is wanted"],
    ),
    "a later schema": Row(
        lambda: outer(schema="exceptiondrive.planning/2"),
        {"wrong_schema": "1 fault"},
        ["a newer form: take the newest client, from the server's page /client/"],
    ),
    "line ends of Windows": Row(
        lambda: json.dumps(sound(), indent=1).replace("\n", "\r\n").encode()
    ),
    "t = 0 included": Row(
        lambda: paths(lambda path: [(0, 0), *path]),
        {"wrong_waypoint_count": f"{2 * N} trajectories {ALL}"},
        ["leave out (0, 0) at t = 0", "`exceptiondrive convert FILE` does"],
    ),
    "a heading column": Row(
        lambda: paths(lambda path: [(x, y, 0.1) for x, y in path]),
        {"wrong_waypoint_shape": f"{12 * N:,} waypoints {ALL}"},
        ["without heading, z or time", "`exceptiondrive convert FILE` does"],
    ),
    "no schema and a foreign key": Row(
        lambda: as_bytes(
            {key: value for key, value in sound().items() if key != "schema"} | {"method": "x"}
        ),
        {"unknown_key": "1 key", "missing_key": "1 key"},
        ['the key "schema"', "travel with the upload"],
    ),
    "seven kinds at once": Row(
        seven_kinds,
        {
            "unknown_key": f"2 keys in 1 of {N + 1} samples",
            "unknown_sample": "1 sample",
            "missing_sample": "1 sample",
            "duplicate_sample": f"1 prediction in 1 of {N + 1} samples",
            "wrong_waypoint_count": f"1 trajectory in 1 of {N + 1} samples",
            "non_finite": f"2 numbers in 1 of {N + 1} samples",
            "step_too_long": f"1 step in 1 of {N + 1} samples",
        },
    ),
}


def as_points(path: Path6) -> Any:
    return [{"x": x, "y": y, "heading": 0.1} for x, y in path]


def longer(step_s: float, n: int, *, with_start: bool = False) -> Callable[[Path6], Any]:
    """Sample the path more finely or coarsely, and go on straight beyond its end."""

    def sample(path: Path6) -> Any:
        (x0, y0), (x1, y1) = path[-2:]
        beyond = [(x1 + k * (x1 - x0), y1 + k * (y1 - y0)) for k in range(1, 20)]
        start = [(0.0, 0.0)] if with_start else []
        times_s = [step_s * step for step in range(1, n + 1)]
        return start + at_times([*path, *beyond], 0.5, times_s)

    return sample


def with_decimal_commas() -> bytes:
    rows = as_csv().decode().splitlines()
    return "\r\n".join(row.replace(",", ";").replace(".", ",") for row in rows).encode()


def by_side() -> bytes:
    return as_bytes(
        {
            side: {each["sample_id"]: each[side] for each in predictions()}
            for side in ("source", "edited")
        }
    )


def in_columns(ids: str = "sample_id") -> bytes:
    columns = {ids: "sample_id", "source": "source", "edited": "edited"}
    return as_bytes({name: [each[key] for each in predictions()] for name, key in columns.items()})


CONVERT = "`exceptiondrive convert FILE"
WITH_SPLIT = f"{CONVERT} --split extract`"
ONE_A_SAMPLE = "write a list of predictions, one object a sample"
MORE: dict[str, Row] = {
    "all under one key": Row(
        lambda: as_bytes({"results": sound()}),
        {"wrong_type": "1 value"},
        ['everything under the key "results"', "write what is under it alone"],
    ),
    "results beside their meta data": Row(
        lambda: as_bytes(
            {
                "meta": {"use_camera": True},
                "results": {e.pop("sample_id"): e for e in predictions()},
            }
        ),
        {"wrong_type": "1 value"},
        ['everything under the key "results"', "write what is under it alone"],
    ),
    "predictions by another name": Row(
        lambda: as_bytes(
            {"results" if key == "predictions" else key: value for key, value in sound().items()}
        ),
        {"unknown_key": "1 key", "missing_key": "1 key"},
        ['are they under "results"? Call it predictions'],
    ),
    "each side by sample id": Row(
        by_side, {"wrong_type": "1 value"}, ["2 values under other keys", ONE_A_SAMPLE]
    ),
    "columns": Row(
        in_columns, {"wrong_type": "1 value"}, ["3 values under other keys", ONE_A_SAMPLE]
    ),
    "columns, the ids in the plural": Row(
        partial(in_columns, "sample_ids"), {"wrong_type": "1 value"}, [ONE_A_SAMPLE]
    ),
    "ids that begin as the name of their column": Row(
        lambda: as_bytes({f"sample_id_{n}": each for n, each in enumerate(predictions())}),
        {"wrong_type": "1 value"},
        [CONVERT],
    ),
    "UTF-16 without a mark": Row(
        lambda: as_bytes(sound()).decode().encode("utf-16-le"),
        {"wrong_file_kind": "1 fault"},
        ["UTF-16 or UTF-32 text", WITH_SPLIT],
    ),
    "CSV with semicolons": Row(
        with_decimal_commas, {"not_json": "1 fault"}, ["looks like CSV with semicolons", WITH_SPLIT]
    ),
    "CSV with tabs": Row(
        lambda: as_csv().replace(b",", b"\t"),
        {"not_json": "1 fault"},
        ["looks like CSV with tabs", WITH_SPLIT],
    ),
    "NaN as a text": Row(
        lambda: first(put("NaN"), 3),
        {"wrong_type": f"3 values in 3 of {N} samples"},
        ["null stands for the whole trajectory", f"{CONVERT} --null-invalid`"],
    ),
    "waypoints as objects": Row(
        lambda: paths(as_points),
        {"wrong_waypoint_shape": f"{12 * N:,} waypoints {ALL}"},
        ["write [x, y]", f"{CONVERT}` does"],
    ),
    "times before x and y": Row(
        lambda: paths(lambda path: [(0.5 * t, x, y) for t, (x, y) in enumerate(path, start=1)]),
        {"wrong_waypoint_shape": f"{12 * N:,} waypoints {ALL}"},
        ["without heading, z or time", f"{CONVERT}` does"],
    ),
    "feet": Row(
        lambda: paths(lambda path: scaled(path, 1 / 0.3048)),
        {},
        ["looks like feet", f"{CONVERT} --unit feet`"],
    ),
    "millimetres": Row(
        lambda: paths(lambda path: scaled(path, 1000)),
        {"wrong_frame": "1 fault"},
        ["looks like millimetres", f"{CONVERT} --unit millimetres`"],
    ),
    "8 s": Row(
        lambda: paths(longer(0.5, 16)),
        {"wrong_waypoint_count": f"{2 * N} trajectories {ALL}"},
        ["looks like 16 waypoints 0.5 s apart", f"{CONVERT} --time-step-s 0.5 --truncate`"],
    ),
    "10 a second, from t = 0 on": Row(
        lambda: paths(longer(0.1, 60, with_start=True)),
        {"wrong_waypoint_count": f"{2 * N} trajectories {ALL}"},
        ["looks like 60 waypoints 0.1 s apart", f"{CONVERT} --time-step-s 0.1 --truncate`"],
    ),
    "one a second": Row(
        lambda: paths(longer(1.0, 3)),
        {"wrong_waypoint_count": f"{2 * N} trajectories {ALL}"},
        ["looks like 3 waypoints 1 s apart", f"{CONVERT} --time-step-s 1`"],
    ),
    "a list of lists of predictions": Row(
        lambda: outer(predictions=[predictions()[:80], predictions()[80:]]),
        {"wrong_type": "2 values"},
        ["write all predictions into one list", f"{CONVERT}` does"],
    ),
    "numbers as sample ids": Row(
        lambda: outer(
            predictions=[{**each, "sample_id": n} for n, each in enumerate(predictions())]
        ),
        {"wrong_type": f"{N} values"},
        ["take the ids from the manifest; a number"],
    ),
    "a pointer of Git LFS": Row(
        lambda: b"version https://git-lfs.github.com/spec/v1\noid sha256:aa\nsize 12\n",
        {"wrong_file_kind": "1 fault"},
        ["git lfs pull"],
    ),
    "y backward": Row(
        lambda: paths(lambda path: rotated(path, -1)),
        {"wrong_frame": "1 fault"},
        ["looks like x left / y backward", f"{CONVERT} --rotate 90`"],
    ),
}
"""More of them, met or thought of since."""


def from_start(path: Path6) -> Path6:
    return [(0.0, 0.0), *path[:-1]]


def late(path: Path6) -> Path6:
    (x0, y0), (x1, y1) = path[-2:]
    return [*path[1:], (2 * x1 - x0, 2 * y1 - y0)]


def shifted(*sides: str) -> bytes:
    """Give each sample what belongs to the one behind it."""
    found = predictions()
    behind = [*predictions()[1:], predictions()[0]]
    return outer(
        predictions=[
            {**each, **{side: other[side] for side in sides}}
            for each, other in zip(found, behind, strict=True)
        ]
    )


def without(key: str) -> bytes:
    return outer(
        predictions=[
            {name: value for name, value in each.items() if name != key} for each in predictions()
        ]
    )


def named(change: Callable[[str], str]) -> bytes:
    return outer(
        predictions=[{**each, "sample_id": change(each["sample_id"])} for each in predictions()]
    )


def halves() -> list[bytes]:
    return [
        as_bytes(sound() | {"predictions": half})
        for half in (predictions()[:80], predictions()[80:])
    ]


def put_edited(value: Any) -> bytes:
    return first(lambda prediction: prediction.update(edited=value), 5)


TWO_RUNS = "convert --source-run FILE --edited-run FILE` makes a submission of two runs"
NULL_WORD = (
    {"wrong_type": f"5 values in 5 of {N} samples"},
    ["null stands without quotes", f"{CONVERT}` writes it so"],
)
SECOND_WALK: dict[str, Row] = {
    "t = 0 in place of 3 s": Row(
        lambda: paths(from_start),
        {},
        [
            "looks like waypoints from t = 0 on (the last at 2.5 s, where 3 s are wanted)",
            "leave out t",
        ],
    ),
    "t = 0 in the edited ones": Row(
        lambda: outer(
            predictions=[{**each, "edited": from_start(each["edited"])} for each in predictions()]
        ),
        {},
        ["looks like waypoints from t = 0 on", "write the waypoint that is missing at the end"],
    ),
    "without the waypoint at 0.5 s": Row(
        lambda: paths(late),
        {},
        ["looks like waypoints from 1 s on (the one at 0.5 s is missing)", "write the waypoint at"],
    ),
    "rows one off": Row(
        lambda: shifted("source", "edited"),
        {},
        [
            "like trajectories that stand one row off",
            "the drive of the sample behind",
            "own sample id",
        ],
    ),
    "edited rows one off": Row(
        lambda: shifted("edited"),
        {},
        ["like edited trajectories that stand one row off", "the source trajectory of the sample"],
    ),
    "source rows one off": Row(
        lambda: shifted("source"), {}, ["like source trajectories that stand one row off"]
    ),
    "the camera's frame": Row(
        lambda: paths(lambda path: [(-y, 1.5, x) for x, y in path]),
        {"wrong_waypoint_shape": f"{12 * N:,} waypoints {ALL}"},
        ["looks like camera coordinates (x right, y down, z ahead)", f"{CONVERT} --camera`"],
    ),
    "a split file": Row(
        lambda: as_bytes(EXTRACT.split),
        {"wrong_schema": "1 fault"},
        ["The file is a split file, which says what is scored: hand in what the planner answered."],
    ),
    "a manifest": Row(
        lambda: MANIFEST.model_dump_json(by_alias=True).encode(),
        {"wrong_schema": "1 fault"},
        ["The file is the manifest, which lists the samples to answer: hand in"],
    ),
    "a foreign schema": Row(
        lambda: outer(schema="my.planner/1"),
        {"wrong_schema": "1 fault"},
        ["no form of ours", f'{CONVERT}` writes "exceptiondrive.planning/1"'],
    ),
    "another key for the schema": Row(
        lambda: as_bytes(
            {"$schema" if key == "schema" else key: value for key, value in sound().items()}
        ),
        {"unknown_key": "1 key", "missing_key": "1 key"},
        ['the key "schema"', WITH_SPLIT],
    ),
    "no edited": Row(
        lambda: without("edited"),
        {"missing_key": f"{N} keys {ALL}"},
        ['No prediction has the key "edited", what the planner answered to the edited', TWO_RUNS],
    ),
    "no source": Row(
        lambda: without("source"),
        {"missing_key": f"{N} keys {ALL}"},
        ['No prediction has the key "source", what the planner answered to the scene as', TWO_RUNS],
    ),
    "null for every edited": Row(
        lambda: outer(predictions=[{**each, "edited": None} for each in predictions()]),
        {},
        [
            "edited is null for every sample. It is what the planner answered to the edited",
            TWO_RUNS,
        ],
    ),
    "None as a text": Row(lambda: put_edited("None"), *NULL_WORD),
    "nan as a text": Row(lambda: put_edited("nan"), *NULL_WORD),
    "an empty text": Row(lambda: put_edited(""), *NULL_WORD),
    "a log before it": Row(
        lambda: b"[INFO] loading\n2026-11-22 12:00:00 done\n" + as_bytes(sound()),
        {"not_json": "1 fault"},
        ["looks like 2 lines of a log: remove what stands before the JSON"],
    ),
    "a log behind it": Row(
        lambda: as_bytes(sound()) + b"\nDone in 12.3 s\n",
        {"trailing_data": "1 fault"},
        ["remove what stands behind the last }", "line 2"],
    ),
    "paths of images as ids": Row(
        lambda: named(lambda name: f"/data/images/{name}.jpg"),
        {"unknown_sample": f"{N} samples"},
        ["they look like names of images; write the ids", f'did you mean "{next(iter(DRIVES))}"?'],
    ),
    "names of images as ids": Row(
        lambda: named(lambda name: f"{name.replace('/', '_')}__CAM_FRONT__1531.jpg"),
        {"unknown_sample": f"{N} samples"},
        ["they look like names of images", f'did you mean "{next(iter(DRIVES))}"?'],
    ),
    "gzip files by cat": Row(
        lambda: b"".join(map(gzip.compress, halves())),
        {"damaged_gzip": "1 fault"},
        ["several gzip streams in a row, as `cat` makes of several files", WITH_SPLIT],
    ),
    "files by cat": Row(
        lambda: b"\n".join(halves()),
        {"trailing_data": "1 fault"},
        ["looks like several files in one", WITH_SPLIT],
    ),
}
"""Those of a second reader's walk that were not told well, and their like."""


def edited_ones(change: Callable[[list[Path6]], Sequence[Any]]) -> bytes:
    """Return the sound file with its edited trajectories, all together, changed."""
    edited = change([each["edited"] for each in predictions()])
    return outer(
        predictions=[
            {**each, "edited": own} for each, own in zip(predictions(), edited, strict=True)
        ]
    )


def shuffled(paths: list[Path6]) -> list[Path6]:
    return random.Random(5).sample(paths, len(paths))


def zeros_for_some(paths: list[Path6]) -> list[Path6]:
    return [path if n % 8 else [(0.0, 0.0)] * 6 for n, path in enumerate(paths)]


def unturned() -> bytes:
    """Return the sound file in the axes of a map: moved to the car, not turned with it."""
    chance = random.Random(5)
    found = predictions()
    for each in found:
        angle = chance.uniform(-math.pi, math.pi)
        ahead, aside = math.cos(angle), math.sin(angle)
        for side in ("source", "edited"):
            each[side] = [(x * ahead - y * aside, x * aside + y * ahead) for x, y in each[side]]
    return outer(predictions=found)


THIRD_WALK: dict[str, Row] = {
    "normalised": Row(
        lambda: paths(lambda path: [(x / 50, y / 50) for x, y in path]),
        {},
        ["looks like positions 0.02", "times as far as the recorded ones", "write metres, "],
    ),
    "the edited ones x right and y forward": Row(
        lambda: edited_ones(lambda edited: [rotated(path, 1) for path in edited]),
        {},
        ["looks like edited trajectories in another frame than the source ones", "y left"],
    ),
    "the edited ones shuffled": Row(
        lambda: edited_ones(shuffled),
        {},
        ["looks like edited trajectories under the ids of other samples", "its own sample id"],
    ),
    "zeros for no answer": Row(
        lambda: edited_ones(zeros_for_some),
        {},
        ["edited is all zeros for ", f" of {N} samples, though the car is too fast", "write null"],
    ),
    "the axes of a map": Row(
        unturned,
        {"wrong_frame": "1 fault"},
        ["as in the axes of a map", "turn it by minus the heading of the car at t = 0"],
    ),
}
"""Those of a third one."""
OWN: dict[str, Row] = {
    "X and Y in capitals": Row(
        lambda: paths(lambda path: [{"X": x, "Y": y} for x, y in path]),
        {"wrong_waypoint_shape": f"{12 * N:,} waypoints {ALL}"},
        ["write [x, y]", f"{CONVERT}` does"],
    ),
    "empty lists for nothing": Row(
        lambda: put_edited([]),
        {"wrong_waypoint_count": f"5 trajectories in 5 of {N} samples"},
        ["null stands for the whole trajectory", f"{CONVERT} --null-invalid`"],
    ),
    "false for nothing": Row(lambda: put_edited(False), *NULL_WORD),
    "decimal commas": Row(
        lambda: paths(lambda path: [[str(c).replace(".", ",") for c in point] for point in path]),
        {"wrong_type": f"{24 * N:,} values {ALL}"},
        ["without quotes", f"{CONVERT}` does"],
    ),
    "ids in capitals": Row(
        lambda: named(str.upper),
        {"unknown_sample": f"{N} samples"},
        ["take the ids from the split's manifest", f'did you mean "{next(iter(DRIVES))}"?'],
    ),
    "JSON within JSON": Row(
        lambda: as_bytes(json.dumps(sound())),
        {"not_json": "1 fault"},
        ["JSON within a JSON text: write the object itself"],
    ),
    "CSV without its header": Row(
        lambda: b"\n".join(as_csv().splitlines()[1:]),
        {"not_json": "1 fault"},
        ["looks like CSV with commas, without sample_id, trajectory", "one waypoint a row under"],
    ),
    "null for the split": Row(
        lambda: outer(split=None), {"wrong_type": "1 value"}, ['"extract"', WITH_SPLIT]
    ),
    "the path of the bumper": Row(
        lambda: paths(lambda path: [(x + 3.5, y) for x, y in path]),
        {},
        [
            "a point 3.50 m ahead of the rear axle",
            f"{CONVERT} --origin-offset-m -3.50 --follows rear",
        ],
    ),
    "a comment in the first line": Row(
        lambda: b"// my planner\n" + as_bytes(sound()),
        {"not_json": "1 fault"},
        ["looks like a comment: JSON has none, remove it"],
    ),
    "a file that stops within a number": Row(
        lambda: as_bytes(sound())[: len(as_bytes(sound())) // 2].rpartition(b".")[0] + b".",
        {"not_json": "1 fault"},
        ["it stops before its end; was the copy cut off?"],
    ),
    "the goal six times": Row(
        lambda: paths(lambda path: [path[-1]] * 6),
        {"wrong_frame": "1 fault"},
        ["looks like one point repeated, such as the goal; write where the car is at every"],
    ),
}
"""And what else code around a planner writes."""


ALL_FILES = WALK | MORE | SECOND_WALK | THIRD_WALK | OWN


@cache
def report_of(name: str) -> CheckReport:
    """Return the report of a file, which is checked once in a process."""
    return check(ALL_FILES[name].make(), protocol=packaged_protocol(), manifest=MANIFEST).report


def test_there_are_45_files() -> None:
    assert len(WALK) == 45


def test_the_file_that_they_come_from_is_sound() -> None:
    report = check(as_bytes(sound()), protocol=packaged_protocol(), manifest=MANIFEST).report
    assert report.is_valid
    assert report.profile is not None
    assert report.profile.warnings == ()


def said_of(report: CheckReport) -> str:
    """Return all words of a report."""
    examples = [each for group in report.faults for each in group.examples]
    said = [group.message for group in report.faults] + list(report.notes)
    said += [text for each in examples for text in (each.got, each.expected, each.hint) if text]
    said += report.profile.warnings if report.profile else ()
    return "\n".join(said)


@pytest.mark.parametrize("name", ALL_FILES)
def test_the_report_says_what_mends_the_file(name: str) -> None:
    report = report_of(name)
    found = {group.code.value: group.extent(report.n_predictions) for group in report.faults}
    assert found == ALL_FILES[name].faults
    text = said_of(report)
    for words in ALL_FILES[name].words:
        assert words in text


@pytest.mark.parametrize("name", ALL_FILES)
def test_every_sample_with_a_fault_is_named_and_one_example_of_each_is_shown(name: str) -> None:
    for group in report_of(name).faults:
        assert len(group.sample_ids) == group.n_samples == len(set(group.sample_ids))
        shown = [each.sample_id for each in group.examples if each.sample_id is not None]
        assert len(shown) == len(set(shown))
