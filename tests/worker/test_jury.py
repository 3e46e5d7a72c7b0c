"""Known planners judge a split before anybody is judged by it."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from tests.support import realdata

from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.jury import Verdict, files_of_jury, jury
from exceptiondrive_worker.sample.files import write_planners
from exceptiondrive_worker.sample.scenes import sample_split
from exceptiondrive_worker.splits.store import load_split, read_split


def judged(
    split: Split, protocol: ProtocolDocument, files: dict[str, bytes], folder: Path
) -> dict[str, Verdict]:
    loaded = load_split(split, protocol)
    return {each.method: each for each in jury(loaded, protocol, files, folder)}


def planners(folder: Path) -> dict[str, bytes]:
    write_planners(folder)
    (folder / "planners.json").unlink()
    files = files_of_jury(folder)
    return {name: data for name, data in files.items() if b"planning/1" in gzip.decompress(data)}


def with_regions(split: Split, moved_m: tuple[float, float]) -> Split:
    x_m, y_m = moved_m
    samples = [
        it.model_copy(update={"region": tuple((x + x_m, y + y_m) for x, y in it.region)})
        for it in split.samples
    ]
    return split.model_copy(update={"samples": tuple(samples)})


def test_the_synthetic_split_stands_before_its_jury(
    tmp_path: Path, protocol: ProtocolDocument
) -> None:
    found = judged(sample_split(), protocol, planners(tmp_path / "files"), tmp_path / "kept")
    assert "FREEZE" in found
    assert {"late-braker.json.gz", "careful-follower.json.gz"} <= set(found)
    assert {name: each.objection for name, each in found.items() if each.objection} == {}
    assert found["FREEZE"].ur == 0


def test_a_split_that_tells_nobody_apart_is_objected_to(
    tmp_path: Path, protocol: ProtocolDocument
) -> None:
    aside = with_regions(sample_split(), (0.0, 60.0))
    found = judged(aside, protocol, planners(tmp_path / "files"), tmp_path / "kept")
    assert "tells nobody apart" in found["late-braker.json.gz"].objection
    assert found["late-braker.json.gz"].flags == ()
    assert found["FREEZE"].objection == ""


def test_regions_that_crowd_the_start_and_paths_that_miss_are_objected_to(
    tmp_path: Path, protocol: ProtocolDocument
) -> None:
    near = ((3.9, -0.5), (4.9, -0.5), (4.9, 0.5), (3.9, 0.5))
    away = tuple((0.5 * t, 0.0) for t in range(1, 7))
    samples = [
        it.model_copy(update={"region": near, "recorded": away if i % 2 else None})
        for i, it in enumerate(sample_split().samples)
    ]
    crowded = sample_split().model_copy(update={"samples": tuple(samples)})
    assert "stands still" in judged(crowded, protocol, {}, tmp_path / "1")["FREEZE"].objection
    standing = tuple((0.0, 0.0) for _ in range(6))
    parked = [it.model_copy(update={"recorded": standing}) for it in sample_split().samples]
    missed = sample_split().model_copy(update={"samples": tuple(parked)})
    verdict = judged(missed, protocol, {}, tmp_path / "2")["SOURCE AS EDITED"]
    assert "should hit at least 50%" in verdict.objection


@pytest.mark.parametrize(
    ("source_mps", "edited_mps", "flags"),
    [
        (0.0, 0.0, {"source_stands_still"}),
        (8.0, 0.0, {"stands_still", "hardly_moves"}),
        (8.0, 1.0, {"hardly_moves"}),
    ],
)
def test_a_file_that_does_not_move_is_no_moving_planner(
    tmp_path: Path,
    protocol: ProtocolDocument,
    source_mps: float,
    edited_mps: float,
    flags: set[str],
) -> None:
    split = with_regions(sample_split(), (20.0, 0.0))

    def path(speed_mps: float) -> list[list[float]]:
        return [[0.5 * speed_mps * step, 0.0] for step in range(1, 7)]

    rows = [
        {"sample_id": it.sample_id, "source": path(source_mps), "edited": path(edited_mps)}
        for it in split.samples
    ]
    document = {"schema": "exceptiondrive.planning/1", "split": split.name, "predictions": rows}
    found = judged(split, protocol, {"zeros": json.dumps(document).encode()}, tmp_path)["zeros"]
    assert found.hcc is not None
    assert found.hcc > 0.95
    assert (set(found.flags), found.objection) == (flags, "")


def test_a_file_that_cannot_be_scored_is_an_objection(
    tmp_path: Path, protocol: ProtocolDocument
) -> None:
    files = {"empty": b'{"schema": "exceptiondrive.planning/1", "split": "x", "predictions": []}'}
    verdict = judged(sample_split(), protocol, files, tmp_path)["empty"]
    assert verdict.hcc is None
    assert "missing_sample" in verdict.objection


def test_the_scores_are_those_of_the_reference(tmp_path: Path) -> None:
    realdata.require()
    for name, method in realdata.WITH_REFERENCE:
        golden = json.loads((realdata.GOLDEN / f"{name}.{method}.json").read_text())
        split = read_split(realdata.split_path(name))
        files = {method: realdata.file_path(name, method).read_bytes()}
        found = judged(split, packaged_protocol("1.0"), files, tmp_path / name)[method]
        expected = golden["macro_family"]
        assert found.hcc == pytest.approx(expected["hcc"], abs=1e-9)
        assert found.ur == pytest.approx(expected["ur"], abs=1e-9)


def test_the_real_split_stands_before_six_real_planners(
    tmp_path: Path, protocol: ProtocolDocument
) -> None:
    realdata.require()
    data = realdata.file_path("nuscenes-real", "recorded-human").read_bytes()
    rows = json.loads(gzip.decompress(data))["predictions"]
    driven = {row["sample_id"]: tuple(map(tuple, row["edited"])) for row in rows}
    split = read_split(realdata.split_path("nuscenes-real"))
    samples = [it.model_copy(update={"recorded": driven[it.sample_id]}) for it in split.samples]
    recorded = split.model_copy(update={"samples": tuple(samples)})
    files = {
        method: realdata.file_path("nuscenes-real", method).read_bytes()
        for method in realdata.PLANNERS["nuscenes-real"]
    }
    found = judged(recorded, protocol, files, tmp_path)
    assert not [each for each in found.values() if each.objection]
    unaware, freeze = found["SOURCE AS EDITED"], found["FREEZE"]
    assert unaware.ur is not None
    assert unaware.ur > 0.9
    assert freeze.hcc is not None
    assert (freeze.hcc > 0.98, freeze.ur) == (True, 0.0)
    assert unaware.hcc == pytest.approx(found["recorded-human"].hcc)
    assert np.ptp([each.hcc for each in found.values() if each.hcc is not None]) > 0.9
