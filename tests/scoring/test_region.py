"""Regions become convex pieces; split samples become arrays."""

import numpy as np
import pytest
import shapely

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import SplitSample
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import split_arrays
from exceptiondrive_scoring.region import (
    crosses_itself,
    is_far,
    is_small,
    prepare_regions,
    signed_area_m2,
)

SQUARE = [[1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]]
DART = [[0.0, 0.0], [4.0, 0.0], [1.0, 1.0], [0.0, 4.0]]
BOW_TIE = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]


def _piece_areas(regions: FloatArray) -> tuple[list[float], list[int]]:
    prepared = prepare_regions(regions)
    corners = np.stack([prepared.x_m, prepared.y_m], axis=-1).transpose(1, 0, 2)
    return signed_area_m2(corners).tolist(), prepared.sample.tolist()


@pytest.mark.parametrize("rotation", [1, -1])
@pytest.mark.parametrize("first", range(4))
def test_a_concave_region_becomes_two_triangles_at_its_reflex_corner(
    first: int, rotation: int
) -> None:
    dart = np.roll(DART, first, axis=0)[::rotation]
    areas, sample = _piece_areas(np.array([SQUARE, dart, SQUARE]))
    assert sample == [0, 1, 2, 1]
    assert areas == pytest.approx([1, 2, 1, 2])


def test_a_convex_region_stays_whole_in_either_rotation() -> None:
    assert _piece_areas(np.array([SQUARE, SQUARE[::-1]])) == ([1.0, 1.0], [0, 1])


def test_each_region_is_far_or_small_by_itself(protocol: ProtocolDocument) -> None:
    """Too far away for a number is too far away."""
    geometry, small = protocol.geometry, np.multiply(SQUARE, 1e-3)
    regions = np.array([SQUARE, np.multiply(SQUARE, 8.5e307), small, np.add(SQUARE, [0.0, 1e6])])
    assert is_far(regions, geometry).tolist() == [False, True, False, True]
    assert is_small(np.array([SQUARE, small, SQUARE]), geometry).tolist() == [False, True, False]


def test_a_region_that_crosses_itself_is_refused() -> None:
    with pytest.raises(ValueError, match="crosses itself"):
        prepare_regions(np.array([SQUARE, BOW_TIE]))


@pytest.mark.parametrize("step", [1.0, 0.1])
def test_a_region_crosses_or_touches_itself_where_shapely_says_so(step: float) -> None:
    """Corners on a small lattice are often on one line, or the same; 0.1 is no binary number."""
    lattice = np.random.default_rng(7).integers(0, 4, (20_000, 4, 2))
    drawn = np.asarray(lattice * step + 20, dtype=np.float64)
    regions = drawn[np.abs(signed_area_m2(drawn)) > step**2 / 4]
    simple = np.asarray(shapely.is_valid(shapely.polygons(regions)))
    assert simple.any()
    assert not simple.all()
    assert (crosses_itself(regions) == ~simple).all()


def _sample(sample_id: str, scene_id: str, task: str, **overrides: object) -> SplitSample:
    return SplitSample.model_validate(
        {
            "sample_id": sample_id,
            "scene_id": scene_id,
            "task": task,
            "region": tuple((x, y) for x, y in SQUARE),
            **overrides,
        }
    )


def test_a_split_is_sorted_by_sample_and_takes_defaults_from_its_tasks(
    protocol: ProtocolDocument,
) -> None:
    split = split_arrays(
        [
            _sample("b", "scene-2", "LB1"),
            _sample("c", "scene-1", "SE1", d_safe_m=0.7, acceptable=(Strategy.D,)),
            _sample("a", "scene-2", "SE1"),
        ],
        protocol.taxonomy,
    )
    assert split.task_index.tolist() == [0, 4, 0]
    assert split.family_index.tolist() == [0, 1, 0]
    assert (split.scene_index.tolist(), split.n_scenes) == ([1, 1, 0], 2)
    assert split.d_safe_m.tolist() == [2.0, 1.0, 0.7]
    letters = [
        "".join(x for x, ok in zip("ABCDE", row, strict=True) if ok) for row in split.acceptable
    ]
    assert letters == ["CD", "C", "D"]


def test_a_task_that_the_protocol_does_not_list_is_named(protocol: ProtocolDocument) -> None:
    with pytest.raises(ValueError, match="does not list these tasks: ZZ9"):
        split_arrays([_sample("a", "s", "ZZ9")], protocol.taxonomy)


def test_recorded_paths_of_different_lengths_are_refused(protocol: ProtocolDocument) -> None:
    paths = [((1.0, 0.0),) * n_waypoints for n_waypoints in (6, 5)]
    with pytest.raises(ValueError, match="different numbers of waypoints"):
        split_arrays(
            [_sample(f"s-{len(path)}", "s", "SE1", recorded=path) for path in paths],
            protocol.taxonomy,
        )


def test_samples_of_which_none_counts_are_refused(protocol: ProtocolDocument) -> None:
    with pytest.raises(ValueError, match="no sample counts"):
        split_arrays([], protocol.taxonomy)
