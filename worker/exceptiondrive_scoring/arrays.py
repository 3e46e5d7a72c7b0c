"""The two inputs of scoring as arrays: what was submitted, and what is withheld.

All arrays over samples are in the canonical order of the split (sorted by sample id).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.split import SplitSample
from exceptiondrive_schemas.taxonomy import Strategy, Taxonomy
from exceptiondrive_scoring.aliases import BoolArray, Columns, FloatArray, IntArray
from exceptiondrive_scoring.region import PreparedRegions, prepare_regions


@dataclass(frozen=True)
class TrajectoryPairs:
    """Submitted waypoints t = 1..T, without the origin.

    Attributes:
        source: (N, T, 2) float64, metres; rows of NaN where missing.
        edited: (N, T, 2) float64, metres; rows of NaN where missing.
        source_given: (N,) bool.
        edited_given: (N,) bool.
    """

    source: FloatArray
    edited: FloatArray
    source_given: BoolArray
    edited_given: BoolArray

    @classmethod
    def from_columns(cls, columns: Columns) -> "TrajectoryPairs":
        """Read the columns `source` and `edited`; a trajectory of NaN counts as missing."""
        source, edited = columns["source"], columns["edited"]
        return cls(source, edited, ~np.isnan(source[:, 0, 0]), ~np.isnan(edited[:, 0, 0]))


@dataclass(frozen=True)
class TaskGroups:
    """The G tasks that have samples, grouped by family, and the samples of each.

    Attributes:
        order: (N,) samples sorted by task, else in split order; None where they are sorted already.
        n_samples: N.
        starts: (G,) where each task begins in `order`.
        task_index: (G,) position in `taxonomy.tasks`.
        family_starts: (F,) where each family with samples begins among the G tasks.
        family_index: (F,) position of each of those families in `taxonomy.families`.
    """

    order: IntArray | None
    n_samples: int
    starts: IntArray
    task_index: IntArray
    family_starts: IntArray
    family_index: IntArray

    @cached_property
    def sizes(self) -> IntArray:
        """(F + G + 1,) number of samples of each family, of each task, and of all."""
        sizes: IntArray = self.with_totals(np.diff(self.starts, append=self.n_samples))
        return sizes

    def with_totals(self, of_tasks: NDArray[Any]) -> NDArray[Any]:
        """Sum up tasks by family, by task, and in total: (..., G) to (..., F + G + 1)."""
        of_families = np.add.reduceat(of_tasks, self.family_starts, axis=-1)
        of_all = of_tasks.sum(axis=-1, keepdims=True)
        return np.concatenate([of_families, of_tasks, of_all], axis=-1)


@dataclass(frozen=True)
class SplitArrays:
    """A split under one taxonomy, sorted by sample id. Withheld: never leaves the worker.

    Attributes:
        regions_m: (N, 4, 2) corners of the hazard regions, either rotation.
        task_index: (N,) position in `taxonomy.tasks`.
        family_index: (N,) position in `taxonomy.families`.
        scene_index: (N,) 0 <= scene < n_scenes; the unit of the bootstrap.
        n_scenes: Number of scenes.
        d_safe_m: (N,) required clearance: the sample's own if it has one, else that of its task.
        acceptable: (N, 5) bool, strategies A..E.
        recorded_m: (N, T, 2) the path actually driven, rows of NaN where it is not known; None
            where the split records none.
    """

    regions_m: FloatArray
    task_index: IntArray
    family_index: IntArray
    scene_index: IntArray
    n_scenes: int
    d_safe_m: FloatArray
    acceptable: BoolArray
    recorded_m: FloatArray | None = None

    @property
    def n_samples(self) -> int:
        """N."""
        return len(self.task_index)

    @cached_property
    def by_task(self) -> TaskGroups:
        """Samples grouped by task, once per split."""
        order = np.lexsort((self.task_index, self.family_index))
        starts = np.flatnonzero(np.diff(self.task_index[order], prepend=-1))
        family_index = self.family_index[order[starts]]
        family_starts = np.flatnonzero(np.diff(family_index, prepend=-1))
        return TaskGroups(
            order=order if (np.diff(order) < 0).any() else None,
            n_samples=len(order),
            starts=starts,
            task_index=self.task_index[order[starts]],
            family_starts=family_starts,
            family_index=family_index[family_starts],
        )

    @cached_property
    def task_by_task(self) -> "SplitArrays":
        """The same samples in the order of `by_task`, cached because they are summed many times."""
        order = self.by_task.order
        if order is None:
            return self
        per_sample = {
            each.name: getattr(self, each.name)[order]
            for each in fields(self)
            if isinstance(getattr(self, each.name), np.ndarray)
        }
        return replace(self, **per_sample)

    @cached_property
    def prepared_regions(self) -> PreparedRegions:
        """Regions cut into convex pieces, once per split."""
        return prepare_regions(self.regions_m)


STRATEGIES = tuple(Strategy)


def split_arrays(samples: Iterable[SplitSample], taxonomy: Taxonomy) -> SplitArrays:
    """Return arrays of the samples that count, sorted by sample id, under one taxonomy.

    Raises:
        ValueError: No sample counts, a task is not in the taxonomy, or recorded paths are of different
            lengths.
    """
    ordered = sorted(samples, key=attrgetter("sample_id"))
    if not ordered:
        raise ValueError("no sample counts: all are controls or withdrawn")
    tasks, scene_ids, regions_m, d_safe_m, acceptable, paths_m = zip(
        *map(_TOLD, ordered), strict=True
    )
    position = {task.id: index for index, task in enumerate(taxonomy.tasks)}
    unknown = sorted(set(tasks) - position.keys())
    if unknown:
        raise ValueError(f"the protocol does not list these tasks: {', '.join(unknown)}")
    task_index = np.array([position[task] for task in tasks], dtype=np.intp)
    scenes = sorted(set(scene_ids))
    scene_position = {scene: index for index, scene in enumerate(scenes)}
    return SplitArrays(
        regions_m=_points_m(regions_m, 4),
        task_index=task_index,
        family_index=family_of_task(taxonomy)[task_index],
        scene_index=np.array([scene_position[scene] for scene in scene_ids], dtype=np.intp),
        n_scenes=len(scenes),
        d_safe_m=_own_or_of_task(
            d_safe_m, np.array([task.d_safe_m for task in taxonomy.tasks])[task_index]
        ),
        acceptable=_own_or_of_task(
            [own and _is_acceptable(own) for own in acceptable],
            np.array([_is_acceptable(task.acceptable) for task in taxonomy.tasks])[task_index],
        ),
        recorded_m=recorded_m(paths_m),
    )


_TOLD = attrgetter("task", "scene_id", "region", "d_safe_m", "acceptable", "recorded")


def recorded_m(paths: Sequence[Sequence[Sequence[float]] | None]) -> FloatArray | None:
    """Return recorded paths, (N, T, 2) metres, NaN where one is unknown; None if there are none.

    Raises:
        ValueError: They are of different lengths.
    """
    lengths = {len(path) for path in paths if path is not None}
    if not lengths:
        return None
    if len(lengths) > 1:
        raise ValueError("the recorded paths have different numbers of waypoints")
    (n_waypoints,) = lengths
    unknown = [(math.nan, math.nan)] * n_waypoints
    return _points_m([unknown if path is None else path for path in paths], n_waypoints)


def _points_m(rows: Sequence[Sequence[Sequence[float]]], n_points: int) -> FloatArray:
    """Return nested sequences as (N, n_points, 2), in half the time of `np.array`."""
    flat = chain.from_iterable(chain.from_iterable(rows))
    return np.fromiter(flat, np.float64, 2 * n_points * len(rows)).reshape(-1, n_points, 2)


def family_of_task(taxonomy: Taxonomy) -> IntArray:
    """Return the position of the family of each task, in the order of `taxonomy.tasks`."""
    family = {family.id: index for index, family in enumerate(taxonomy.families)}
    return np.array([family[task.family] for task in taxonomy.tasks], dtype=np.intp)


def _own_or_of_task(own: Sequence[Any], of_task: NDArray[Any]) -> NDArray[Any]:
    """Return each sample's own value, or that of its task where it has none; (N, ...)."""
    for row, value in enumerate(own):
        if value is not None:
            of_task[row] = value
    return of_task


def _is_acceptable(acceptable: Sequence[Strategy]) -> list[bool]:
    return [strategy in acceptable for strategy in STRATEGIES]
