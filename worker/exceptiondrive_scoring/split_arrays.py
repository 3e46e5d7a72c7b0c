"""From the samples of a split to arrays in canonical order."""

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from exceptiondrive_schemas.taxonomy import Strategy, Taxonomy
from exceptiondrive_scoring.aliases import IntArray
from exceptiondrive_scoring.arrays import SplitArrays

STRATEGIES = tuple(Strategy)


class Sample(Protocol):
    """What scoring needs to know of a sample; `exceptiondrive_schemas.split.SplitSample` fits."""

    @property
    def sample_id(self) -> str:
        """Key of the sample."""

    @property
    def scene_id(self) -> str:
        """Scene that the sample was made from."""

    @property
    def task(self) -> str:
        """Task id."""

    @property
    def region(self) -> Sequence[Sequence[float]]:
        """Four corners, metres."""

    @property
    def d_safe_m(self) -> float | None:
        """Required clearance, where it differs from the task's."""

    @property
    def acceptable(self) -> Sequence[Strategy] | None:
        """Acceptable strategies, where they differ from the task's."""


def split_arrays(samples: Iterable[Sample], taxonomy: Taxonomy) -> SplitArrays:
    """Arrays of a split, sorted by sample id, under one taxonomy.

    Raises:
        ValueError: The split names tasks that the taxonomy does not list.
    """
    ordered = sorted(samples, key=lambda sample: sample.sample_id)
    position = {task.id: index for index, task in enumerate(taxonomy.tasks)}
    unknown = sorted({sample.task for sample in ordered} - position.keys())
    if unknown:
        raise ValueError(f"the protocol does not list these tasks: {', '.join(unknown)}")
    task_index = np.array([position[sample.task] for sample in ordered], dtype=np.intp)
    scenes = sorted({sample.scene_id for sample in ordered})
    scene_position = {scene: index for index, scene in enumerate(scenes)}
    return SplitArrays(
        regions_m=np.array([sample.region for sample in ordered], dtype=np.float64),
        task_index=task_index,
        family_index=_family_of_task(taxonomy)[task_index],
        scene_index=np.array([scene_position[s.scene_id] for s in ordered], dtype=np.intp),
        n_scenes=len(scenes),
        d_safe_m=np.array(
            [_d_safe_m(s, taxonomy.tasks[position[s.task]].d_safe_m) for s in ordered]
        ),
        acceptable=np.array(
            [_acceptable(s, taxonomy.tasks[position[s.task]].acceptable) for s in ordered]
        ),
    )


def _family_of_task(taxonomy: Taxonomy) -> IntArray:
    family = {family.id: index for index, family in enumerate(taxonomy.families)}
    return np.array([family[task.family] for task in taxonomy.tasks], dtype=np.intp)


def _d_safe_m(sample: Sample, of_task: float) -> float:
    return of_task if sample.d_safe_m is None else sample.d_safe_m


def _acceptable(sample: Sample, of_task: Sequence[Strategy]) -> list[bool]:
    acceptable = of_task if sample.acceptable is None else sample.acceptable
    return [strategy in acceptable for strategy in STRATEGIES]
