"""Columns of trajectories against the same lengths and distances taken one by one."""

import math
import random
from array import array
from itertools import pairwise

import pytest

from exceptiondrive_schemas.check.tracks import Tracks, both_first

N, T = 7, 6


def trajectories(seed: int) -> list["array[float]"]:
    rng = random.Random(seed)
    return [array("d", [rng.uniform(-20, 20) for _ in range(2 * T)]) for _ in range(N)]


def points(flat: "array[float]") -> list[tuple[float, float]]:
    return list(zip(flat[::2], flat[1::2], strict=True))


def test_lengths_ends_and_steps_are_those_of_each_trajectory() -> None:
    given = trajectories(1)
    tracks = Tracks.of(given, T)
    for row, flat in enumerate(given):
        path = [(0.0, 0.0), *points(flat)]
        steps = [math.dist(*ends) for ends in pairwise(path)]
        assert [step.length_m[row] for step in tracks.steps] == steps
        assert tracks.lengths_m[row] == sum(steps)
        assert tracks.ends_m[row] == math.hypot(*path[-1])


def test_gaps_are_taken_waypoint_by_waypoint() -> None:
    given, others = trajectories(1), trajectories(2)
    gaps_m = Tracks.of(given, T).first(3).gaps_m(Tracks.of(others, T).first(3))
    assert list(gaps_m) == [
        tuple(map(math.dist, points(one), points(other)))
        for one, other in zip(given[:3], others[:3], strict=True)
    ]


def test_without_trajectories_every_column_is_empty() -> None:
    none = Tracks.of([], T)
    assert not [*none.lengths_m, *none.ends_m, *none.gaps_m(none)]


def test_trajectories_of_other_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="different numbers of waypoints"):
        Tracks.of([*trajectories(1), array("d", [1.0, 2.0])], T)


def test_pairs_with_one_side_come_behind_those_with_both() -> None:
    a, b, c, d = trajectories(1)[:4]
    assert both_first([(None, a), (b, None), (None, None), (c, d)]) == ([c, b], [d, a], 1)
