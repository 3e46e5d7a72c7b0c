"""Splits that can be scored and make a bad benchmark: each is found, sound ones pass."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exceptiondrive_schemas.datasheet import NO_RECORDED_DRIVE
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Split, SplitSample
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import split_arrays
from exceptiondrive_scoring.split_lint import LintedSplit, LintWarning, lint

Region = Sequence[Sequence[float]]
Breaks = Callable[[int, SplitSample], dict[str, Any]]
N_BAD = 60
OF_FEW = {"few_scenes", "one_task", "few_scenes_of_a_family", "small_cells"}
"""What a single sample has anyway."""


@pytest.fixture(scope="module")
def sound() -> Split:
    """The synthetic split without its controls: nothing else is wrong with it."""
    pytest.importorskip("exceptiondrive_worker", reason="the client by itself")
    from exceptiondrive_worker.sample.scenes import sample_split

    split = sample_split()
    return split.model_copy(update={"samples": split.counted})


def found_in(
    samples: Sequence[SplitSample],
    protocol: ProtocolDocument,
    recorded: Mapping[str, Sequence[Sequence[float]]] | None = None,
    controls: Sequence[str] = (),
) -> dict[str, LintWarning]:
    ordered = [
        sample.model_copy(update={"recorded": (recorded or {}).get(sample.sample_id)})
        for sample in sorted(samples, key=lambda sample: sample.sample_id)
    ]
    split = LintedSplit(
        sample_ids=[sample.sample_id for sample in ordered],
        arrays=split_arrays(ordered, protocol.taxonomy),
        is_control=np.array([sample.sample_id in controls for sample in ordered]),
    )
    return {warning.code: warning for warning in lint(split, protocol)}


def changed(split: Split, breaks: Breaks, n: int | None = None) -> list[SplitSample]:
    """The samples, the first n (all, by default) broken."""
    samples = sorted(split.samples, key=lambda sample: sample.sample_id)
    return [
        sample.model_copy(update=breaks(row, sample)) if n is None or row < n else sample
        for row, sample in enumerate(samples)
    ]


def wall(row: int, sample: SplitSample) -> dict[str, Any]:
    near_m = 3.6 + row / 1e4  # 7 cm ahead of the bumper; none equals another
    return {"region": ((near_m, -20.0), (near_m + 1, -20.0), (near_m + 1, 20.0), (near_m, 20.0))}


def block(row: int, sample: SplitSample) -> dict[str, Any]:
    near_m = 3.6 + row / 1e4
    return {"region": ((near_m, -30.0), (near_m + 56, -30.0), (near_m + 56, 30.0), (near_m, 30.0))}


def moved(x_m: float, y_m: float) -> Breaks:
    return lambda row, sample: {"region": tuple((x + x_m, y + y_m) for x, y in sample.region)}


def exchanged(row: int, sample: SplitSample) -> dict[str, Any]:
    return {"region": tuple((y, x) for x, y in sample.region)}


def triangle(row: int, sample: SplitSample) -> dict[str, Any]:
    return {"region": (*sample.region[:3], sample.region[2])}


BAD: dict[str, tuple[Breaks, str]] = {
    "a wall that nobody avoids": (wall, "unavoidable"),
    "a block from the bumper on": (block, "unavoidable"),
    "behind the car": (moved(-80.0, 0.0), "behind_the_car"),
    "60 m aside": (moved(0.0, 60.0), "out_of_reach"),
    "x and y exchanged": (exchanged, "x_and_y_exchanged"),
    "repeated corners": (triangle, "repeated_corner"),
    "one region everywhere": (
        lambda row, sample: {"region": ((12.0, -1.0), (14.0, -1.0), (14.0, 1.0), (12.0, 1.0))},
        "one_region_in_many_samples",
    ),
    "ids that are markup": (
        lambda row, sample: {"sample_id": f"a {row}\n<script>"},
        "odd_sample_id",
    ),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("n", [N_BAD, 1])
def test_bad_samples_are_named_and_no_other(
    sound: Split, protocol: ProtocolDocument, name: str, n: int
) -> None:
    """Sixty of 420 are broken, or a single one; where a group is the evidence, one is not."""
    breaks, code = BAD[name]
    samples = changed(sound, breaks, n)
    found = found_in(samples, protocol).get(code)
    needs_more = {"x_and_y_exchanged": len(samples), "one_region_in_many_samples": 2}
    if n < needs_more.get(code, 1):
        assert found is None
        return
    assert found is not None
    assert set(found.sample_ids) == {sample.sample_id for sample in samples[:n]}


@pytest.mark.parametrize("name", BAD)
def test_a_wholly_bad_split_is_found(sound: Split, protocol: ProtocolDocument, name: str) -> None:
    breaks, code = BAD[name]
    assert found_in(changed(sound, breaks), protocol)[code].count == len(sound.samples)


@pytest.mark.parametrize(("field", "value"), [("scene_id", "sample-scene-007"), ("task", "LB1")])
def test_a_scene_or_a_task_in_another_frame_is_found(
    sound: Split, protocol: ProtocolDocument, field: str, value: str
) -> None:
    samples = [
        sample.model_copy(update=exchanged(0, sample))
        if getattr(sample, field) == value
        else sample
        for sample in sound.samples
    ]
    found = found_in(samples, protocol)["x_and_y_exchanged"]
    expected = {sample.sample_id for sample in samples if getattr(sample, field) == value}
    assert set(found.sample_ids) == expected


def test_one_scene_and_one_task_are_found(sound: Split, protocol: ProtocolDocument) -> None:
    of_one_scene = changed(sound, lambda row, sample: {"scene_id": "the-one"})
    assert found_in(of_one_scene, protocol)["few_scenes"].count == 420
    of_one_task = [sample for sample in sound.samples if sample.task == "LB1"]
    assert found_in(of_one_task, protocol)["one_task"].count == 20


@pytest.mark.parametrize(("n_scenes", "is_told"), [(4, True), (5, False), (0, False)])
def test_a_family_in_few_scenes_is_named(
    sound: Split, protocol: ProtocolDocument, n_scenes: int, is_told: bool
) -> None:
    """One that has no sample at all is no part of the mean."""
    scenes = sorted({it.scene_id for it in sound.samples if it.task.startswith("SR")})[:n_scenes]
    samples = [it for it in sound.samples if not it.task.startswith("SR") or it.scene_id in scenes]
    few = {it.sample_id for it in samples if it.task.startswith("SR")}
    ranking = protocol.ranking.model_copy(update={"min_scenes": 5})
    stricter = protocol.model_copy(update={"ranking": ranking})
    found = found_in(samples, stricter).get("few_scenes_of_a_family")
    assert (found is not None) == is_told
    if found is not None:
        assert set(found.sample_ids) == few
        assert "fewer than 5 scenes: it has no interval" in found.what
        assert found.what.endswith(": signal_and_rule_conflict")


def test_small_cells_are_named(sound: Split, protocol: ProtocolDocument) -> None:
    without_signals = [sample for sample in sound.samples if not sample.task.startswith("SR")]
    cells = found_in(without_signals, protocol)["small_cells"]
    assert cells.count == 4
    assert cells.what.endswith("signal_and_rule_conflict, SR1, SR2, SR3")
    publication = protocol.publication.model_copy(update={"min_samples_per_cell": 21})
    stricter = protocol.model_copy(update={"publication": publication})
    assert found_in(sound.samples, stricter)["small_cells"].count == 21


def test_cells_below_the_floor_of_a_withheld_split_are_named_whatever_the_protocol_shows(
    sound: Split, protocol: ProtocolDocument
) -> None:
    arrays = split_arrays(sound.samples, protocol.taxonomy)
    split = LintedSplit(
        [it.sample_id for it in sound.samples], arrays, np.zeros(arrays.n_samples, dtype=np.bool_)
    )
    (cells,) = (it for it in lint(split, protocol, 100) if it.code == "small_cells")
    assert cells.count == 6 + 21
    assert "100, the least that is published of a withheld split: sudden_emergence, " in cells.what


def test_size_and_distance_far_from_the_usual_are_found(
    sound: Split, protocol: ProtocolDocument
) -> None:
    def grown(row: int, sample: SplitSample) -> dict[str, Any]:
        centre = np.mean(sample.region, axis=0)
        corners = centre + 3 * (np.array(sample.region) - centre) + [30.0, 0.0]
        return {"region": tuple(map(tuple, corners.tolist()))}

    samples = changed(sound, grown, 1)
    assert found_in(samples, protocol)["unusual_area"].sample_ids == (samples[0].sample_id,)
    samples = changed(sound, moved(75.0, 0.0), 1)
    assert found_in(samples, protocol)["unusual_distance"].sample_ids == (samples[0].sample_id,)


def test_a_region_within_d_safe_of_the_start_is_found(
    sound: Split, protocol: ProtocolDocument
) -> None:
    near = ((4.0, -0.2), (4.4, -0.2), (4.4, 0.2), (4.0, 0.2))
    samples = changed(sound, lambda row, sample: {"region": near}, 1)
    found = found_in(samples, protocol)["within_d_safe_of_the_start"]
    assert found.sample_ids == (samples[0].sample_id,)


def test_the_synthetic_split_has_one_warning_that_is_meant(
    sound: Split, protocol: ProtocolDocument
) -> None:
    """Standing still suffices, which no split without controls escapes; and none has a drive here."""
    found = {"standing_still_suffices", NO_RECORDED_DRIVE}
    assert set(found_in(sound.samples, protocol)) == found


def test_every_warning_is_explained_in_the_documentation() -> None:
    root = Path(__file__).parents[2]
    files = ("exceptiondrive_scoring/split_lint.py", "exceptiondrive_worker/splits/warnings.py")
    source = "".join((root / "worker" / file).read_text() for file in files)
    codes = set(re.findall(r'(?:found|everything|LintWarning)\(\s*"([a-z_]+)"', source))
    page = (root / "docs/building-a-split.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    explained = {code for cell in rows for code in re.findall(r"`([a-z_]+)`", cell)}
    assert codes
    assert {*codes, NO_RECORDED_DRIVE} <= explained


# With recorded paths.


@pytest.mark.parametrize(
    ("speed_mps", "is_found"),
    [pytest.param(8.0, True, id="moves"), pytest.param(0.1, False, id="stands")],
)
def test_one_drive_in_several_scenes_is_found(
    sound: Split, protocol: ProtocolDocument, speed_mps: float, is_found: bool
) -> None:
    """Under another scene's name, and with a region a centimetre off; in one scene paths are alike."""
    own = {
        it.sample_id: straight(8.0 + row / 50)
        for row, it in enumerate(sorted(sound.samples, key=lambda it: it.sample_id))
    }
    assert "one_drive_in_several_scenes" not in found_in(sound.samples, protocol, own)
    first = sound.samples[0]
    x_m, y_m = 0.01, 0.0
    copy = first.model_copy(
        update={
            "sample_id": "copy",
            "scene_id": "another",
            "region": tuple((x + x_m, y + y_m) for x, y in first.region),
        }
    )
    same = straight(speed_mps)
    paths = own | {first.sample_id: same, "copy": same}
    found = found_in([*sound.samples, copy], protocol, paths).get("one_drive_in_several_scenes")
    assert (found is not None) == is_found
    if found is not None:
        assert set(found.sample_ids) == {first.sample_id, "copy"}
        of_one = [*sound.samples, copy.model_copy(update={"scene_id": first.scene_id})]
        assert "one_drive_in_several_scenes" not in found_in(of_one, protocol, paths)


def straight(speed_mps: float, bend_per_m: float = 0.0) -> list[list[float]]:
    along_m = speed_mps * 0.5 * np.arange(1, 7)
    if bend_per_m == 0:
        return [[float(x), 0.0] for x in along_m]
    turn = bend_per_m * along_m
    arc: FloatArray = np.stack([np.sin(turn), 1 - np.cos(turn)], axis=-1) / bend_per_m
    return [[float(x), float(y)] for x, y in arc]


def one(region: Region, task: str = "LB1") -> SplitSample:
    corners = tuple((float(x), float(y)) for x, y in region)
    return SplitSample(sample_id="one", scene_id="scene", task=task, region=corners)


def box(x_m: float, y_m: float, length_m: float = 2.0, width_m: float = 2.0) -> Region:
    low, high, right, left = x_m, x_m + length_m, y_m - width_m / 2, y_m + width_m / 2
    return ((low, right), (high, right), (high, left), (low, left))


@pytest.mark.parametrize(
    ("region", "speed_mps", "bend_per_m", "expected"),
    [
        pytest.param(box(20, 0), 8.0, 0.0, set(), id="ahead, in time"),
        pytest.param(box(10, 0, width_m=40), 8.0, 0.0, set(), id="in time to stop"),
        pytest.param(box(20, 0, width_m=14), 16.0, 0.0, {"unavoidable"}, id="too late to stop"),
        pytest.param(box(45, 0, width_m=14), 24.0, 0.0, {"unavoidable"}, id="wider than the road"),
        pytest.param(box(20, 0, width_m=2), 12.0, 0.0, set(), id="too late to stop, not to pass"),
        pytest.param(box(20, 6), 8.0, 0.0, {"recorded_path_misses"}, id="beside the path"),
        pytest.param(box(60, 0), 8.0, 0.0, {"out_of_reach"}, id="too far for this speed"),
        pytest.param(box(16, 8), 8.0, 1 / 20, set(), id="in the bend"),
        pytest.param(box(20, 0), 8.0, 1 / 20, {"recorded_path_misses"}, id="past the bend"),
        pytest.param(box(0, 20), 8.0, 0.0, {"x_and_y_exchanged", "behind_the_car"}, id="exchanged"),
        pytest.param(box(-9, 0), 8.0, 0.0, {"behind_the_car"}, id="behind"),
        pytest.param(box(10, 0), 6.0, 1 / 5, {"recorded_path_misses"}, id="ahead of a tight turn"),
        pytest.param(box(20, 0), -4.0, 0.0, {"recorded_not_drivable"}, id="driven backwards"),
        pytest.param(
            box(20, 0), 65.0, 0.0, {"recorded_not_drivable", "unavoidable"}, id="too fast for a car"
        ),
        pytest.param(
            box(5, 0, length_m=80, width_m=52), 8.0, 0.0, {"unusual_area", "unavoidable"}, id="huge"
        ),
        pytest.param(box(20, 0), 0.0, 0.0, {"recorded_path_misses"}, id="a car that stands"),
    ],
)
def test_a_recorded_path_tells_more(
    protocol: ProtocolDocument,
    region: Region,
    speed_mps: float,
    bend_per_m: float,
    expected: set[str],
) -> None:
    found = found_in([one(region)], protocol, {"one": straight(speed_mps, bend_per_m)})
    about_the_split = {*OF_FEW, "standing_still_suffices"}
    assert set(found) - about_the_split == expected


@pytest.mark.parametrize(
    ("region", "recorded", "expected"),
    [
        pytest.param(box(20, 0), straight(8.0), {"control_in_the_way"}, id="in the way"),
        pytest.param(box(20, 8), straight(8.0), set(), id="aside"),
        pytest.param(box(-9, 0), straight(8.0), set(), id="behind"),
        pytest.param(box(20, 8), straight(0.1), {"control_of_a_standing_car"}, id="standing"),
        pytest.param(box(20, 0), None, {"control_in_the_way"}, id="straight ahead"),
        pytest.param(box(20, 60), None, set(), id="far aside"),
    ],
)
def test_a_control_is_judged_the_other_way_round(
    protocol: ProtocolDocument,
    region: Region,
    recorded: list[list[float]] | None,
    expected: set[str],
) -> None:
    paths = {"one": recorded} if recorded else None
    found = found_in([one(region)], protocol, paths, controls=["one"])
    assert set(found) - OF_FEW == expected


@pytest.mark.parametrize("n", [1, 19, 20])
def test_controls_tell_a_standing_car_where_they_are_as_many_as_the_flag_asks_for(
    sound: Split, protocol: ProtocolDocument, n: int
) -> None:
    controls = {
        f"control-{row}": one(box(20 + row / 100, 9)).model_copy(
            update={"sample_id": f"control-{row}", "scene_id": "sample-scene-001"}
        )
        for row in range(n)
    }
    found = found_in([*sound.samples, *controls.values()], protocol, controls=list(controls))
    suffices = found.pop("standing_still_suffices", None)
    assert set(found) == {NO_RECORDED_DRIVE}
    assert (suffices is None) == (n == 20)
    if suffices is not None:
        assert suffices.what.endswith(
            f"only with 20 controls it is told from a careful one; there are {n}"
        )
