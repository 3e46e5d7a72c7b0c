"""Metrics of single samples, from clearances worked by hand (docs/protocol.md section 3)."""

from collections.abc import Callable

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import (
    clearance_compliance,
    grade,
    kept_clearances,
    proximity_response,
)
from exceptiondrive_scoring.kinematics import path_fit
from exceptiondrive_scoring.measure import Clearances, measure

MakeSplit = Callable[..., SplitArrays]
FRONT = 3.528


@pytest.mark.parametrize(
    ("clearance_m", "hcc", "hpr"),
    [
        (0.5, 0.25, 2 / 3.5),  # d_safe / (|0.5 - 2| + 2)
        (2.0, 1.0, 1.0),
        (8.0, 1.0, 0.25),
        (1e-9, 0.0, 0.0),
    ],
)
def test_hcc_grows_to_the_required_clearance_and_hpr_peaks_there(
    clearance_m: float, hcc: float, hpr: float
) -> None:
    clearance, required = np.array([clearance_m]), np.array([2.0])
    intrusion = clearance <= 1e-6
    assert clearance_compliance(clearance, intrusion, required) == pytest.approx(hcc)
    assert proximity_response(clearance, intrusion, required) == pytest.approx(hpr)


def _wall_ahead(distance_m: float) -> list[list[float]]:
    x0, x1 = FRONT + distance_m, FRONT + distance_m + 2
    return [[x0, -3.0], [x1, -3.0], [x1, 3.0], [x0, 3.0]]


def _standing(n: int, *, source: bool = True, edited: bool = True) -> TrajectoryPairs:
    still, missing = np.zeros((n, 6, 2)), np.full((n, 6, 2), np.nan)
    return TrajectoryPairs.from_columns(
        {"source": still if source else missing, "edited": still if edited else missing}
    )


def test_required_clearance_comes_from_task_or_sample_and_is_scaled(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    doubled = protocol.model_copy(
        update={"grading": protocol.grading.model_copy(update={"d_safe_scale": 2.0})}
    )
    split = make_split(np.array([_wall_ahead(1.0)] * 2), tasks=[0, 7])  # SE1 2 m, LB4 1 m
    measurements = measure(_standing(2), split.regions_m, protocol.geometry)
    np.testing.assert_allclose(grade(measurements, split, protocol).values[:, 0], [0.5, 1.0])
    np.testing.assert_allclose(grade(measurements, split, doubled).values[:, 0], [0.25, 0.5])
    own = make_split(np.array([_wall_ahead(1.0)] * 2), tasks=[0, 7], d_safe_m=4.0)
    np.testing.assert_allclose(grade(measurements, own, protocol).values[:, 0], [0.25, 0.25])


def test_a_missing_source_leaves_only_the_shift_undefined(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split(np.array([_wall_ahead(1.0)]), tasks=[0])
    measurements = measure(_standing(1, source=False), split.regions_m, protocol.geometry)
    (values,) = grade(measurements, split, protocol).values
    np.testing.assert_allclose(values[:3], [0.5, 0.0, 2 / 3])
    assert np.isnan(values[3:6]).all()


def test_a_missing_edited_trajectory_is_an_intrusion(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split(np.array([_wall_ahead(50.0)]), tasks=[0])
    measurements = measure(_standing(1, edited=False), split.regions_m, protocol.geometry)
    (values,) = grade(measurements, split, protocol).values
    np.testing.assert_array_equal(values[:3], [0.0, 1.0, 0.0])
    assert np.isnan(values[3:6]).all()


@pytest.mark.parametrize(("gap_m", "intrusion"), [(0.5e-6, True), (2e-6, False), (-0.1, True)])
def test_contact_has_the_tolerance_of_the_protocol(
    gap_m: float, intrusion: bool, make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split(np.array([_wall_ahead(gap_m)]))
    measurements = measure(_standing(1), split.regions_m, protocol.geometry)
    assert measurements.intrusion.tolist() == [intrusion]


def test_the_tolerance_itself_is_contact_and_the_required_clearance_itself_is_kept(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split(np.array([_wall_ahead(0.0005)] * 2), d_safe_m=1.0)
    standing, geometry = _standing(2), protocol.geometry
    (found_m, _) = measure(standing, split.regions_m, geometry).clearance_m.tolist()
    touched = geometry.model_copy(update={"contact_tolerance_m": found_m})
    assert measure(standing, split.regions_m, touched).intrusion.all()
    kept = kept_clearances(
        Clearances(np.array([1.0, np.nextafter(1.0, 0.0)]), np.zeros(2, np.bool_)), split, protocol
    )
    assert (kept["clear"].tolist(), kept["close"].tolist()) == ([True, False], [False, True])


def test_the_shift_is_the_mean_over_all_points_with_the_origin(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    source = np.zeros((1, 6, 2))
    edited: FloatArray = np.tile([3.0, -4.0], (1, 6, 1))
    split = make_split(np.array([_wall_ahead(50.0)]))
    pairs = TrajectoryPairs.from_columns({"source": source, "edited": edited})
    (values,) = grade(measure(pairs, split.regions_m, protocol.geometry), split, protocol).values
    np.testing.assert_allclose(values[3:6], np.array([5.0, 3.0, 4.0]) * 6 / 7)


@pytest.mark.parametrize(
    ("time_step_s", "places"),
    [
        (0.5, (1, 3, 5)),
        (0.25, (3, 7, None)),
        (0.2, (4, 9, None)),
        (1.0, (0, 1, 2)),
        (0.3, (None, None, 9)),
    ],
)
def test_source_fit_is_read_at_the_waypoints_of_its_times(
    time_step_s: float, places: tuple[int | None, ...], geometry: GeometrySection
) -> None:
    source = np.arange(20.0).reshape(1, 10, 2)
    recorded = source - np.stack([np.arange(1.0, 11.0), np.zeros(10)], axis=-1)
    fit = path_fit(source, recorded, geometry.model_copy(update={"time_step_s": time_step_s}))
    assert fit.source_l2_m[0] == 5.5
    found = [fit.source_l2_1s_m[0], fit.source_l2_2s_m[0], fit.source_l2_3s_m[0]]
    expected = [np.nan if place is None else place + 1.0 for place in places]
    np.testing.assert_array_equal(found, expected)
