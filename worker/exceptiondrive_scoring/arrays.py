"""Array types, and the two inputs of planning: what was submitted, and what is withheld.

All arrays over samples are in the split's canonical order (sorted by sample id).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_scoring.aliases import BoolArray, Columns, FloatArray, IntArray
from exceptiondrive_scoring.region import PreparedRegions, prepare_regions

__all__ = [
    "BoolArray",
    "Columns",
    "FloatArray",
    "IntArray",
    "SplitArrays",
    "TaskGroups",
    "TrajectoryPairs",
]


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
        """Read the columns `source` and `edited`; a trajectory of NaN is a missing one."""
        source, edited = columns["source"], columns["edited"]
        return cls(source, edited, ~np.isnan(source[:, 0, 0]), ~np.isnan(edited[:, 0, 0]))

    def columns(self) -> dict[str, NDArray[Any]]:
        """What a store keeps: `source` and `edited`, NaN where missing."""
        return {"source": self.source, "edited": self.edited}


@dataclass(frozen=True)
class TaskGroups:
    """The G tasks that have samples, family by family, and which samples they have.

    Attributes:
        order: (N,) samples, task by task, else in canonical order.
        starts: (G,) where each task begins in `order`.
        sizes: (G,) number of samples.
        task_index: (G,) position in `taxonomy.tasks`.
        family_starts: Where each family that has samples begins among the G tasks.
        family_index: Position of each of those families in `taxonomy.families`.
    """

    order: IntArray
    starts: IntArray
    sizes: IntArray
    task_index: IntArray
    family_starts: IntArray
    family_index: IntArray


@dataclass(frozen=True)
class SplitArrays:
    """A split under one taxonomy, sorted by sample id. Withheld: never leaves the worker.

    Attributes:
        regions_m: (N, 4, 2) corners of the hazard regions, either rotation.
        task_index: (N,) position in `taxonomy.tasks`.
        family_index: (N,) position in `taxonomy.families`.
        scene_index: (N,) 0 <= scene < n_scenes; the unit of the bootstrap.
        n_scenes: Number of scenes.
        d_safe_m: (N,) required clearance: of the sample if it has one, else of its task.
        acceptable: (N, 5) bool, strategies A..E.
    """

    regions_m: FloatArray
    task_index: IntArray
    family_index: IntArray
    scene_index: IntArray
    n_scenes: int
    d_safe_m: FloatArray
    acceptable: BoolArray

    @property
    def n_samples(self) -> int:
        """N."""
        return len(self.task_index)

    @cached_property
    def by_task(self) -> "TaskGroups":
        """Samples grouped by task, once per split."""
        order = np.lexsort((self.task_index, self.family_index))
        starts = np.flatnonzero(np.diff(self.task_index[order], prepend=-1))
        family_index = self.family_index[order[starts]]
        family_starts = np.flatnonzero(np.diff(family_index, prepend=-1))
        return TaskGroups(
            order=order,
            starts=starts,
            sizes=np.diff(starts, append=self.n_samples),
            task_index=self.task_index[order[starts]],
            family_starts=family_starts,
            family_index=family_index[family_starts],
        )

    @cached_property
    def prepared_regions(self) -> PreparedRegions:
        """Regions cut into convex pieces, once per split."""
        return prepare_regions(self.regions_m)
