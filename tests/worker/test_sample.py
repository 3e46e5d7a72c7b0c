import gzip
import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.references import is_reserved
from exceptiondrive_schemas.submission_files import PlanningPrediction, PlanningSubmission
from exceptiondrive_scoring.challenge import scoring_of
from exceptiondrive_scoring.region import prepare_regions
from exceptiondrive_scoring.sheet import Breakdown, aggregate
from exceptiondrive_worker.sample.driving import Lane, Manoeuvre
from exceptiondrive_worker.sample.files import write_planners, write_sample_split
from exceptiondrive_worker.sample.hazards import PLACEMENTS
from exceptiondrive_worker.sample.planners import PLANNERS, Planner, predictions
from exceptiondrive_worker.sample.scenes import SEED, SampleScene, sample_scenes
from exceptiondrive_worker.splits.store import LoadedSplit, load_split, read_datasheet, read_split

ROOT = Path(__file__).parents[2]
COMMITTED = ROOT / "hidden_splits" / "sample" / "split.json.gz"
by_file_name = pytest.mark.parametrize("planner", PLANNERS, ids=lambda planner: planner.file_name)


@pytest.fixture(scope="module")
def samples() -> tuple[SampleScene, ...]:
    return sample_scenes()


@pytest.fixture(scope="module")
def loaded(protocol: ProtocolDocument) -> LoadedSplit:
    return load_split(read_split(COMMITTED), protocol)


def columns_of(
    answers: list[PlanningPrediction], loaded: LoadedSplit, *, of_controls: bool = False
) -> dict[str, np.ndarray]:
    """The answers about the samples that count, or about the controls."""
    missing = np.full((6, 2), np.nan)
    rows = loaded.control_rows if of_controls else loaded.rows
    return {
        key: np.array([missing if getattr(a, key) is None else getattr(a, key) for a in answers])[
            rows
        ]
        for key in ("source", "edited")
    }


def test_the_committed_split_is_what_the_generator_writes(tmp_path: Path) -> None:
    again = write_sample_split(tmp_path).read_bytes()
    committed = COMMITTED.read_bytes()
    assert gzip.decompress(again) == gzip.decompress(committed)
    assert again[4:8] == committed[4:8] == bytes(4), "the gzip header must carry no date"


def test_the_committed_datasheet_counts_the_committed_split(tmp_path: Path) -> None:
    made = write_sample_split(tmp_path)
    sheet = read_datasheet(COMMITTED)
    assert sheet is not None
    assert sheet == read_datasheet(made)
    assert sheet.revision == read_split(COMMITTED).revision
    assert (sheet.n_samples, sheet.n_scenes, sheet.n_controls) == (420, 120, 21)
    assert {cell.n for cell in sheet.tasks} == {20}
    assert sum(cell.n for cell in sheet.families) == 420


def test_the_committed_split_can_be_scored(loaded: LoadedSplit, protocol: ProtocolDocument) -> None:
    assert loaded.arrays.n_samples == 420
    assert loaded.arrays.n_scenes == 120
    assert np.bincount(loaded.arrays.task_index).tolist() == [20] * len(protocol.tasks)


def test_some_regions_are_concave(loaded: LoadedSplit) -> None:
    pieces = prepare_regions(loaded.arrays.regions_m)
    assert len(pieces.sample) > pieces.n_samples


def test_every_task_of_the_protocol_has_a_placement(protocol: ProtocolDocument) -> None:
    assert list(PLACEMENTS) == [task.id for task in protocol.tasks]


def test_speeds_are_realistic_and_some_lanes_bend(samples: tuple[SampleScene, ...]) -> None:
    speeds = [sample.speed_mps for sample in samples]
    assert min(speeds) >= 2
    assert max(speeds) <= 14
    bent = sum(sample.lane.curvature_per_m != 0 for sample in samples)
    assert 0.3 < bent / len(samples) < 0.6


def test_sample_ids_tell_nothing_of_task_or_scene(samples: tuple[SampleScene, ...]) -> None:
    tasks = [sample.task_id for sample in samples]
    changes = sum(one != other for one, other in itertools.pairwise(tasks))
    assert changes > 380, "neighbours in the order of ids would share a task"


def test_planners_json_lists_the_files_beside_it(tmp_path: Path) -> None:
    paths = write_planners(tmp_path)
    listing = json.loads((tmp_path / "planners.json").read_text())
    assert [row["file"] for row in listing] == [path.name for path in paths]
    assert not any(is_reserved(row["method"]) for row in listing)
    for row in [row for row in listing if row["challenge"] == "planning"]:
        submission = PlanningSubmission.model_validate_json(
            gzip.decompress((tmp_path / row["file"]).read_bytes())
        )
        assert submission.split == "sample"
        assert len(submission.predictions) == 441


@by_file_name
def test_a_planner_repeats_itself(planner: Planner, samples: tuple[SampleScene, ...]) -> None:
    assert predictions(planner, samples, SEED) == predictions(planner, samples, SEED)


@by_file_name
def test_every_motion_is_one_a_car_can_make(
    planner: Planner,
    samples: tuple[SampleScene, ...],
    loaded: LoadedSplit,
    protocol: ProtocolDocument,
) -> None:
    scoring = scoring_of(PLANNING.id)
    columns = columns_of(predictions(planner, samples, SEED), loaded)
    measurements = scoring.measure(columns, loaded.arrays, protocol.geometry)
    assert scoring.plausibility(measurements, loaded.arrays, protocol).shares["impossible"] == 0
    assert np.nanmax(measurements["peak_acceleration_mps2"]) < 10


@pytest.fixture(scope="module")
def breakdowns(loaded: LoadedSplit, protocol: ProtocolDocument) -> dict[str, Breakdown]:
    scoring, found = scoring_of(PLANNING.id), {}
    for planner in PLANNERS:
        columns = columns_of(predictions(planner, sample_scenes(), SEED), loaded)
        measurements = scoring.measure(columns, loaded.arrays, protocol.geometry)
        scores = scoring.grade(measurements, loaded.arrays, protocol)
        found[planner.method] = aggregate(scores, loaded.arrays, protocol.taxonomy)
    return found


def test_the_board_of_the_planners_is_lively(breakdowns: dict[str, Breakdown]) -> None:
    hcc = [found.macro_family["hcc"] or 0 for found in breakdowns.values()]
    assert len({round(value, 4) for value in hcc}) == len(PLANNERS)
    assert all(0.1 < value < 0.6 for value in hcc)
    assert max(hcc) - min(hcc) < 0.2


def test_planners_heed_what_lies_beside_the_road_if_they_startle(
    samples: tuple[SampleScene, ...], loaded: LoadedSplit, protocol: ProtocolDocument
) -> None:
    assert len(loaded.control_rows) == len(PLACEMENTS) == 21
    found = {
        planner.method: scoring_of(PLANNING.id)
        .of_controls(
            columns_of(predictions(planner, samples, SEED), loaded, of_controls=True), protocol
        )
        .metrics["over_caution"]
        for planner in PLANNERS
    }
    assert found["Bypass Planner"] == 0
    assert 0 < (found["Late Braker"] or 0) < (found["Careful Follower"] or 0) < 0.5


def test_sources_are_near_the_recorded_drives(breakdowns: dict[str, Breakdown]) -> None:
    for method, found in breakdowns.items():
        assert 0.1 < (found.micro["source_l2_m"] or 0) < 2, method


def test_one_planner_leaves_under_one_per_cent_out(samples: tuple[SampleScene, ...]) -> None:
    missing = {
        planner.method: sum(
            (answer.source is None) + (answer.edited is None)
            for answer in predictions(planner, samples, SEED)
        )
        for planner in PLANNERS
    }
    noisy = missing.pop("Noisy Human")
    assert 0 < noisy < 0.01 * len(samples)
    assert set(missing.values()) == {0}


def test_a_lane_bends_left_with_positive_curvature() -> None:
    quarter = Lane(1 / 10).position_m(np.pi * 5, 0.0)
    assert quarter == pytest.approx((10, 10))
    assert Lane(0.0).position_m(7, -1) == (7, -1)
    assert Lane(1 / 10).position_m(0, 2) == pytest.approx((0, 2))


def test_a_braking_car_stops_and_stays() -> None:
    manoeuvre = Manoeuvre(speed_mps=5, brake_at_s=1, brake_mps2=5)
    assert [manoeuvre.along_m(t) for t in (0.5, 1, 1.5, 2, 3)] == [2.5, 5, 6.875, 7.5, 7.5]
