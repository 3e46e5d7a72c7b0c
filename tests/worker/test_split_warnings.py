"""Lint of whole split files: the real ones have few warnings, each with its reason."""

import json
from gzip import decompress

import pytest
from tests.support import realdata
from tests.support.extract import make_extract

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.sample.scenes import sample_split
from exceptiondrive_worker.splits.store import read_split
from exceptiondrive_worker.splits.warnings import split_warnings


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # Regions were placed on the path at the speed of the time: some too near to stop for even
        # at walking pace, some nearer than the clearance that their task asks for.
        (
            "nuscenes-real",
            {
                "unavoidable": 39,
                "within_d_safe_of_the_start": 115,
                "small_cells": 6,
                "standing_still_suffices": 3066,
                "no_recorded_drive": 3181,
            },
        ),
        (
            "carla-pairs",
            {
                "unavoidable": 27,
                "within_d_safe_of_the_start": 84,
                "small_cells": 22,
                "no_recorded_drive": 1257,
            },
        ),
    ],
)
def test_a_real_split_has_few_warnings(
    name: str, expected: dict[str, int], protocol: ProtocolDocument
) -> None:
    realdata.require()
    found = split_warnings(read_split(realdata.split_path(name)), protocol)
    assert {warning.code: warning.count for warning in found} == expected


def test_recorded_paths_tell_what_was_unavoidable_at_the_true_speed(
    protocol: ProtocolDocument,
) -> None:
    """Every region was placed on or beside the path: none is out of reach, and none is missed."""
    realdata.require()
    data = realdata.file_path("nuscenes-real", "recorded-human").read_bytes()
    rows = json.loads(decompress(data))["predictions"]
    driven = {row["sample_id"]: tuple(map(tuple, row["edited"])) for row in rows}
    split = read_split(realdata.split_path("nuscenes-real"))
    samples = [it.model_copy(update={"recorded": driven[it.sample_id]}) for it in split.samples]
    recorded = split.model_copy(update={"samples": tuple(samples)})
    found = {warning.code: warning.count for warning in split_warnings(recorded, protocol)}
    assert found == {
        "unavoidable": 309,
        "within_d_safe_of_the_start": 115,
        "small_cells": 6,
        "standing_still_suffices": 3066,
    }


def test_the_made_extract_warns_of_what_it_was_made_with(protocol: ProtocolDocument) -> None:
    """It repeats what real splits hold: regions a hand's breadth ahead, tasks of few samples."""
    split = Split.model_validate_json(json.dumps(make_extract().split))
    found = {warning.code: warning.count for warning in split_warnings(split, protocol)}
    assert found == {
        "unavoidable": 2,
        "within_d_safe_of_the_start": 3,
        "unusual_area": 2,
        "small_cells": 27,
        "standing_still_suffices": 157,
        "no_recorded_drive": 160,
    }


def test_an_exchanged_real_split_is_found(protocol: ProtocolDocument) -> None:
    realdata.require()
    document = json.loads(decompress(realdata.split_path("nuscenes-real").read_bytes()))
    for sample in document["samples"]:
        sample["region"] = [[y, x] for x, y in sample["region"]]
    split = Split.model_validate_json(json.dumps(document))
    found = {warning.code: warning for warning in split_warnings(split, protocol)}
    assert found["x_and_y_exchanged"].count > 0.99 * len(split.samples)


# Parts.


def parted(split: Split, public_scenes: set[str], n_public_controls: int) -> Split:
    """Of these scenes the samples, and the first controls whatever their scene, are public."""
    public = {it.sample_id for it in split.controls[:n_public_controls]}
    public |= {it.sample_id for it in split.counted if it.scene_id in public_scenes}
    samples = (
        it.model_copy(update={"part": "public" if it.sample_id in public else "private"})
        for it in split.samples
    )
    return split.model_copy(update={"samples": tuple(samples)})


def test_what_is_doubted_of_a_part_alone_is_told_of_the_part(protocol: ProtocolDocument) -> None:
    """A board counts one part: with 4 of 21 controls it does not tell who always brakes."""
    split = sample_split()
    scenes = sorted({it.scene_id for it in split.samples})
    assert not {"standing_still_suffices", "few_scenes"} & {
        found.code for found in split_warnings(split, protocol, 1)
    }
    found = split_warnings(parted(split, set(scenes[:9]), 4), protocol, 1)
    told = {each.what: each.count for each in found if each.code == "standing_still_suffices"}
    starts = [what.split(": ")[0] for what in told]
    assert starts == ["in the public part", "in the private part"]
    assert [what.split("; ")[-1] for what in told] == ["there are 4", "there are 17"]
    assert sum(told.values()) <= len(split.counted)
    assert [each.what.split(",")[0] for each in found if each.code == "few_scenes"] == [
        "in the public part: all samples are of fewer than 10 scenes: intervals draw scenes again"
    ]


def test_single_samples_and_what_the_whole_has_too_are_told_once(
    protocol: ProtocolDocument,
) -> None:
    split = sample_split()
    first = split.counted[0]
    samples = (
        it.model_copy(update={"region": tuple((x - 80, y) for x, y in it.region)})
        if it.sample_id == first.sample_id
        else it
        for it in split.samples
        if it.task == first.task and not it.control
    )
    scenes = sorted({it.scene_id for it in split.samples})
    one_task = parted(split.model_copy(update={"samples": tuple(samples)}), set(scenes[::2]), 0)
    codes = [found.code for found in split_warnings(one_task, protocol)]
    assert codes.count("behind_the_car") == codes.count("one_task") == 1


def test_a_scene_in_both_parts_is_named_with_its_samples(protocol: ProtocolDocument) -> None:
    split = sample_split()
    scenes = sorted({it.scene_id for it in split.samples})
    by_scene = parted(split, set(scenes[:20]), 0)
    shared = by_scene.counted[0]
    assert shared.part is not None
    other = "private" if shared.part == "public" else "public"
    moved = (
        it.model_copy(update={"part": other}) if it.sample_id == shared.sample_id else it
        for it in by_scene.samples
        if not it.control
    )
    both = by_scene.model_copy(update={"samples": tuple(moved)})
    (found,) = (it for it in split_warnings(both, protocol, 1) if it.code == "scene_in_both_parts")
    of_scene = {it.sample_id for it in both.samples if it.scene_id == shared.scene_id}
    assert set(found.sample_ids) == of_scene
    apart = both.model_copy(
        update={"samples": tuple(it for it in both.samples if it.sample_id != shared.sample_id)}
    )
    assert "scene_in_both_parts" not in {it.code for it in split_warnings(apart, protocol, 1)}
