"""Shared parts of the scoring tests: the protocol, small splits, real files where present."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.support import naive_scorer

from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs, split_arrays

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def protocol() -> ProtocolDocument:
    return packaged_protocol("1.0")


@pytest.fixture(scope="session")
def geometry(protocol: ProtocolDocument) -> GeometrySection:
    return protocol.geometry


@pytest.fixture(scope="session")
def read_case(
    protocol: ProtocolDocument,
) -> Callable[[Path, Path], tuple[TrajectoryPairs, SplitArrays]]:
    """Read a split and a submission as the kernel takes them."""

    def read(split_path: Path, file_path: Path) -> tuple[TrajectoryPairs, SplitArrays]:
        document = naive_scorer.read(split_path.read_bytes())
        split = Split.model_validate_json(json.dumps(document))
        answers = naive_scorer.read(file_path.read_bytes())["predictions"]
        answers.sort(key=lambda answer: answer["sample_id"])
        missing = [[float("nan")] * 2] * protocol.geometry.waypoints
        columns = {
            key: np.array([answer[key] or missing for answer in answers])
            for key in ("source", "edited")
        }
        pairs = TrajectoryPairs.from_columns(columns)
        return pairs, split_arrays(split.samples, protocol.taxonomy)

    return read


@pytest.fixture(scope="session")
def make_split(protocol: ProtocolDocument) -> Callable[..., SplitArrays]:
    """A split of N samples; tasks and scenes go round unless given."""

    def make(
        regions_m: FloatArray,
        *,
        tasks: list[int] | None = None,
        scenes: list[int] | None = None,
        d_safe_m: float | None = None,
    ) -> SplitArrays:
        n = len(regions_m)
        taxonomy = protocol.taxonomy
        families = [family.id for family in taxonomy.families]
        task_index = np.array(tasks if tasks is not None else [i % 21 for i in range(n)], dtype=int)
        scene_index = np.array(scenes if scenes is not None else list(range(n)), dtype=int)
        chosen = [taxonomy.tasks[index] for index in task_index]
        return SplitArrays(
            regions_m=regions_m,
            task_index=task_index,
            family_index=np.array([families.index(task.family) for task in chosen], dtype=int),
            scene_index=scene_index,
            n_scenes=int(scene_index.max()) + 1 if n else 0,
            d_safe_m=np.array([d_safe_m or task.d_safe_m for task in chosen]),
            acceptable=np.array([[s in task.acceptable for s in "ABCDE"] for task in chosen]),
        )

    return make
