import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.admin import read_drives
from exceptiondrive_worker.splits.faults import SplitRefusedError
from exceptiondrive_worker.splits.store import (
    SplitStore,
    SplitUnavailableError,
    SplitUnreadableError,
    family_counts,
    load_split,
    read_split,
)

MakeSplit = Callable[..., Split]
ROTATED = ((12.0, -1.0), (12.0, 1.0), (10.0, 1.0), (10.0, -1.0))


def text_of(split: Split) -> str:
    return split.model_dump_json(by_alias=True, exclude_none=True)


def put(folder: Path, split: Split, file_name: str = "split.json") -> Path:
    path = folder / split.name / file_name
    path.parent.mkdir(parents=True, exist_ok=True)
    data = text_of(split).encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return path


def faults_of(split: Split, protocol: ProtocolDocument) -> dict[str, tuple[str, ...]]:
    with pytest.raises(SplitRefusedError) as caught:
        load_split(split, protocol)
    return {fault.what: fault.sample_ids for fault in caught.value.faults}


def test_samples_are_sorted_by_id_and_arrays_follow(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split({"b": {"task": "LB1", "scene_id": "scene-2"}, "a": {"region": ROTATED}})
    loaded = load_split(split, protocol)
    assert loaded.manifest.sample_ids == ("a", "b")
    assert loaded.arrays.regions_m[0].tolist() == [list(corner) for corner in ROTATED]
    assert loaded.arrays.task_index.tolist() == [0, 4]
    assert loaded.arrays.family_index.tolist() == [0, 1]
    assert loaded.arrays.scene_index.tolist() == [0, 1]
    assert loaded.arrays.n_scenes == 2
    assert loaded.arrays.d_safe_m.tolist() == [2.0, 1.0]
    assert loaded.arrays.acceptable.tolist() == [
        [False, False, True, True, False],
        [False, False, True, False, False],
    ]


def test_a_sample_overrides_clearance_and_strategies_of_its_task(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split({"a": {"d_safe_m": 0.25, "acceptable": ("A",)}})
    arrays = load_split(split, protocol).arrays
    assert arrays.d_safe_m.tolist() == [0.25]
    assert arrays.acceptable.tolist() == [[True, False, False, False, False]]


def test_the_order_of_samples_changes_neither_revision_nor_arrays(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    one = load_split(make_split({"a": {}, "b": {"task": "RS1"}}), protocol)
    other = load_split(make_split({"b": {"task": "RS1"}, "a": {}}), protocol)
    assert one.manifest == other.manifest
    assert one.regions_digest == other.regions_digest
    assert one.grading_digest == other.grading_digest


def test_the_manifest_carries_no_region_task_or_scene(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    manifest = load_split(make_split({"a": {"scene_id": "scene-canary"}}), protocol).manifest
    assert set(manifest.model_dump(by_alias=True)) == {
        "schema",
        "name",
        "title",
        "revision",
        "waypoints",
        "time_step_s",
        "sample_ids",
    }
    assert "canary" not in manifest.model_dump_json()


@pytest.mark.row("I32")
@pytest.mark.parametrize(
    ("region", "what"),
    [
        pytest.param(
            ((10, -1), (12, 1), (12, -1), (10, 1)),
            "hazard regions that cross or touch themselves",
            id="bow-tie",
        ),
        pytest.param(
            ((10, 0), (11, 0), (12, 0), (13, 0)),
            "hazard regions that cross or touch themselves",
            id="all corners on one line",
        ),
        pytest.param(
            ((10, 0), (10.09, 0), (10.09, 0.1), (10, 0.1)),
            "hazard regions smaller than 0.01 m2",
            id="degenerate",
        ),
        pytest.param(
            ((99, -1), (100, -1), (100, 1), (99, 1)),
            "hazard regions with a corner more than 100 m away",
            id="too far",
        ),
        pytest.param(
            ((-1e308, -1e308), (1e308, -1e308), (1e308, 1e308), (-1e308, 1e308)),
            "hazard regions with a corner more than 100 m away",
            id="farther than numbers go",
        ),
        pytest.param(
            ((3.528, -1), (5, -1), (5, 1), (3.528, 1)),
            "hazard regions that touch the footprint at t = 0",
            id="touching the front bumper",
        ),
        pytest.param(
            ((-9, -9), (9, -9), (9, 9), (-9, 9)),
            "hazard regions that touch the footprint at t = 0",
            id="around the car",
        ),
    ],
)
def test_an_unusable_region_is_refused(
    make_split: MakeSplit,
    protocol: ProtocolDocument,
    region: tuple[tuple[float, float], ...],
    what: str,
) -> None:
    corners = tuple((float(x), float(y)) for x, y in region)
    assert faults_of(make_split({"good": {}, "bad": {"region": corners}}), protocol) == {
        what: ("bad",)
    }


@pytest.mark.parametrize(
    "region",
    [
        pytest.param(((10.0, 0.0), (14.0, 2.0), (11.5, 0.0), (14.0, -2.0)), id="concave"),
        pytest.param(((3.53, -1.0), (5.0, -1.0), (5.0, 1.0), (3.53, 1.0)), id="2 mm ahead"),
        pytest.param(((10.0, 0.0), (10.0, 1.0), (12.0, 1.0), (12.0, 0.0)), id="clockwise"),
    ],
)
def test_an_unusual_but_sound_region_is_taken(
    make_split: MakeSplit, protocol: ProtocolDocument, region: tuple[tuple[float, float], ...]
) -> None:
    assert load_split(make_split({"a": {"region": region}}), protocol).arrays.n_samples == 1


def test_every_offending_sample_is_listed_at_once(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    inf = float("inf")
    good = make_split({"a": {}, "b": {}, "c": {}, "d": {}, "e": {}})
    sample = good.samples[0]
    bad = good.model_copy(
        update={
            "samples": (
                *good.samples[:2],
                sample.model_copy(update={"sample_id": "a"}),
                sample.model_copy(update={"sample_id": "f", "task": "XX1"}),
                sample.model_copy(update={"sample_id": "g", "region": ((inf, 0.0),) * 4}),
                sample.model_copy(update={"sample_id": "i", "region": ((0.0, 0.0),) * 4}),
                sample.model_copy(update={"sample_id": "h", "region": ((0.0, 0.0),) * 4}),
            )
        }
    )
    assert faults_of(bad, protocol) == {
        "sample ids that occur more than once": ("a",),
        "samples of a task that protocol 1.0 does not know": ("f",),
        "hazard regions with a corner that is not finite": ("g",),
        "hazard regions smaller than 0.01 m2": ("h", "i"),
    }


def test_a_wider_footprint_refuses_what_a_narrow_one_takes(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    beside = ((0.0, 1.0), (2.0, 1.0), (2.0, 2.0), (0.0, 2.0))
    split = make_split({"a": {"region": beside}})
    load_split(split, protocol)
    wide = protocol.geometry.model_copy(update={"footprint_width_m": 2.2})
    with pytest.raises(SplitRefusedError, match=r"touch the footprint at t = 0 \(1\): a"):
        load_split(split, protocol.model_copy(update={"geometry": wide}))


def test_family_counts_leave_out_families_without_samples(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split({"a": {"task": "RS1"}, "b": {"task": "SE4"}, "c": {"task": "RS2"}})
    assert family_counts(split, protocol) == {"sudden_emergence": 1, "road_surface_hazard": 2}


@pytest.mark.parametrize("file_name", ["split.json", "split.json.gz", "split-2025.json.gz"])
def test_the_store_finds_a_split_by_name_and_revision(
    tmp_path: Path, make_split: MakeSplit, protocol: ProtocolDocument, file_name: str
) -> None:
    split = make_split({"a": {}})
    put(tmp_path, split, file_name)
    store = SplitStore(tmp_path)
    loaded = store.find("tiny", split.revision, protocol)
    assert loaded.manifest.sample_ids == ("a",)
    assert store.find("tiny", split.revision, protocol) is loaded


def test_an_older_revision_is_still_found_beside_the_current_one(
    tmp_path: Path, make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    new, old = make_split({"a": {}}), make_split({"a": {}, "b": {}})
    put(tmp_path, new)
    put(tmp_path, old, "split-1.json.gz")
    store = SplitStore(tmp_path)
    assert [path.name for path in store.files()] == ["split.json", "split-1.json.gz"]
    assert store.find("tiny", old.revision, protocol).arrays.n_samples == 2
    assert store.find("tiny", new.revision, protocol).arrays.n_samples == 1


def test_a_file_with_another_revision_is_unavailable_until_it_comes_back(
    tmp_path: Path, make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    registered, changed = make_split({"a": {}}), make_split({"a": {}, "b": {}})
    store = SplitStore(tmp_path)
    with pytest.raises(SplitUnavailableError, match="no readable file"):
        store.find("tiny", registered.revision, protocol)
    put(tmp_path, changed)
    with pytest.raises(SplitUnavailableError, match=changed.revision):
        store.find("tiny", registered.revision, protocol)
    put(tmp_path, registered)
    assert store.find("tiny", registered.revision, protocol).arrays.n_samples == 1


@pytest.mark.parametrize("harm", ["file", "folder", "changed"])
def test_what_is_in_memory_is_served_while_its_file_lies_there(
    tmp_path: Path, make_split: MakeSplit, protocol: ProtocolDocument, harm: str
) -> None:
    split, folder = make_split({"a": {}}), tmp_path / "tiny"
    put(tmp_path, split)
    store = SplitStore(tmp_path)
    loaded = store.find("tiny", split.revision, protocol)
    away = (folder if harm == "folder" else folder / "split.json").rename(tmp_path / "away")
    if harm == "changed":
        put(tmp_path, make_split({"a": {}, "b": {}}))
    with pytest.raises(SplitUnavailableError, match=split.revision):
        store.find("tiny", split.revision, protocol)
    away.rename(folder if harm == "folder" else folder / "split-1.json")
    assert store.find("tiny", split.revision, protocol) is loaded


def test_another_protocol_gets_arrays_of_its_own(
    tmp_path: Path, make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split({"a": {"task": "LB1"}})
    put(tmp_path, split)
    tasks = [task.model_copy(update={"d_safe_m": 3.0}) for task in protocol.tasks]
    other = protocol.model_copy(update={"tasks": tuple(tasks), "version": "1.1"})
    store = SplitStore(tmp_path)
    one = store.find("tiny", split.revision, protocol)
    two = store.find("tiny", split.revision, other)
    assert (one.arrays.d_safe_m[0], two.arrays.d_safe_m[0]) == (1.0, 3.0)
    assert one.grading_digest != two.grading_digest
    assert one.regions_digest == two.regions_digest


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"\x1f\x8b junk",
        b"[1, 2]",
        b'{"schema": "exceptiondrive.split/1", "name": "x", "title": "x", "samples": [3]}',
    ],
)
def test_what_is_no_split_is_unreadable(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "split.json"
    path.write_bytes(data)
    with pytest.raises(SplitUnreadableError, match=r"split\.json"):
        read_split(path)


def test_problems_name_samples_and_no_values(tmp_path: Path, make_split: MakeSplit) -> None:
    document: dict[str, Any] = json.loads(text_of(make_split({name: {} for name in "abcd"})))
    document["samples"][1]["region"][2][0] = float("nan")
    document["samples"][2]["region"].append([77.125, 1.0])
    document["samples"][3]["withdrawn"] = True
    path = tmp_path / "split.json"
    path.write_text(json.dumps(document))
    with pytest.raises(SplitUnreadableError) as caught:
        read_split(path)
    message = str(caught.value)
    assert "sample b.region.2.0: Input should be a finite number" in message
    assert "sample c.region" in message
    assert "sample d.withdrawn: must say why the sample counts no more" in message
    assert "77.125" not in message


def test_corners_keep_their_bits(make_split: MakeSplit, protocol: ProtocolDocument) -> None:
    third = 10 + 1 / 3
    split = make_split({"a": {"region": ((third, 0.0), (12.0, 0.0), (12.0, 1.0), (third, 1.0))}})
    again = Split.model_validate_json(text_of(split))
    assert np.array_equal(
        load_split(again, protocol).arrays.regions_m, load_split(split, protocol).arrays.regions_m
    )


STRAIGHT = tuple((2.0 * step, 0.0) for step in range(1, 7))


def test_controls_and_withdrawn_samples_are_answered_and_do_not_count(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    plain = make_split({"a": {}, "b": {"task": "LB1"}, "c": {"task": "RS1"}, "d": {}})
    marked = make_split(
        {
            "a": {},
            "b": {"task": "LB1", "control": True},
            "c": {"task": "RS1", "withdrawn": "another place"},
            "d": {},
        }
    )
    loaded = load_split(marked, protocol)
    assert loaded.manifest.sample_ids == ("a", "b", "c", "d")
    assert loaded.rows is not None
    assert (loaded.rows.tolist(), loaded.control_rows.tolist()) == ([0, 3], [1])
    assert loaded.arrays.n_samples == 2
    assert family_counts(marked, protocol) == {"sudden_emergence": 2}
    assert loaded.manifest.revision != plain.revision
    text = loaded.manifest.model_dump_json()
    assert not any(word in text for word in ("control", "withdrawn", "another place"))
    assert load_split(plain, protocol).rows is None


def test_recorded_paths_are_told_where_the_split_says_so(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    withheld = make_split({"a": {"recorded": STRAIGHT}, "b": {}})
    told = withheld.model_copy(update={"recorded_is_public": True})
    loaded = load_split(withheld, protocol)
    assert "recorded" not in loaded.manifest.model_dump()
    assert load_split(told, protocol).manifest.recorded == {"a": STRAIGHT}
    assert loaded.recorded_m is not None
    assert loaded.recorded_m[0].tolist() == [list(point) for point in STRAIGHT]
    assert np.isnan(loaded.recorded_m[1]).all()
    assert (
        loaded.regions_digest != load_split(make_split({"a": {}, "b": {}}), protocol).regions_digest
    )


def test_what_a_split_need_not_say_leaves_its_revision(make_split: MakeSplit) -> None:
    split = make_split({"a": {}})
    said = {"control": False, "withdrawn": None, "recorded": None}
    stated = Split.model_validate_json(
        json.dumps(
            {
                **json.loads(text_of(split)),
                "recorded_is_public": False,
                "samples": [json.loads(text_of(split))["samples"][0] | said],
            }
        )
    )
    assert stated.revision == split.revision


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"recorded": STRAIGHT[:5]}, "recorded paths of other than 6 waypoints"),
        ({"recorded": ()}, "recorded paths of other than 6 waypoints"),
        ({"recorded": (*STRAIGHT[:5], (201.0, 0.0))}, "recorded paths beyond 200 m"),
        ({"control": True}, "no sample counts: all are controls or withdrawn"),
        ({"withdrawn": "why"}, "no sample counts: all are controls or withdrawn"),
    ],
)
def test_what_cannot_be_counted_or_compared_is_refused(
    changes: dict[str, Any], what: str, make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    assert faults_of(make_split({"a": changes}), protocol) == {what: ("a",)}


def test_a_part_without_a_sample_that_counts_is_refused(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split({"a": {"part": "public"}, "b": {"part": "private", "control": True}})
    what = "no sample counts: all are controls or withdrawn in the private part"
    assert faults_of(split, protocol) == {what: ("b",)}


@pytest.mark.parametrize("damage", ["cut short", "changed inside", "another checksum"])
def test_a_damaged_file_is_told_and_keeps_no_other_from_being_found(
    make_split: MakeSplit, protocol: ProtocolDocument, tmp_path: Path, damage: str
) -> None:
    split = make_split({f"sample-{number}": {} for number in range(50)})
    path, whole = put(tmp_path, split, "split.json.gz"), put(tmp_path, split, "split-1.json.gz")
    data = bytearray(whole.read_bytes())
    middle = len(data) // 2
    if damage == "cut short":
        del data[middle:]
    elif damage == "changed inside":
        data[middle : middle + 40] = bytes(byte ^ 0xFF for byte in data[middle : middle + 40])
    else:
        data[-8] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(
        SplitUnreadableError, match=r"^split\.json\.gz is damaged or cut short: put"
    ):
        read_split(path)
    found = SplitStore(tmp_path).find(split.name, split.revision, protocol)
    assert found.manifest.revision == split.revision


def test_a_file_that_is_not_there_is_told_in_words(tmp_path: Path) -> None:
    with pytest.raises(SplitUnreadableError, match=r"^none\.json cannot be read: No such file"):
        read_split(tmp_path / "none.json")


def test_damaged_drives_are_refused_in_words(tmp_path: Path) -> None:
    data = bytearray(gzip.compress(b"".join(b"%d" % number for number in range(500))))
    data[20:60] = bytes(byte ^ 0xFF for byte in data[20:60])
    (tmp_path / "drives.json.gz").write_bytes(data)
    with pytest.raises(SplitUnreadableError, match=r"drives\.json\.gz is no trajectory file"):
        read_drives(tmp_path / "drives.json.gz")
