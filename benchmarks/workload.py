"""A seeded, realistic workload: the speed of a pruned kernel depends on it, so it is fixed.

Trajectories: a smooth drive with speeds, braking, turns and standing starts as nuScenes has them.
Regions: quadrilaterals on or beside the edited path, 2 % concave, so that about 80 % of samples
are in contact, as in the paper's table (UR 78 ... 92 %).
"""

from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs

SEED = 20261121
BENCHMARK_SAMPLES = 3181
SAMPLES_PER_SCENE = 4
SHARE_CONCAVE = 0.02
SHARE_BESIDE = 0.12


@dataclass(frozen=True)
class Workload:
    """One submission and its split."""

    pairs: TrajectoryPairs
    split: SplitArrays


def make_workload(
    protocol: ProtocolDocument,
    n_samples: int = BENCHMARK_SAMPLES,
    n_waypoints: int = 6,
    seed: int = SEED,
) -> Workload:
    """Make one submission of `n_samples` pairs with its split."""
    rng = np.random.default_rng(seed)
    source = _drive(rng, n_samples, n_waypoints)
    scale = 1 - np.abs(rng.normal(0, 0.15, (n_samples, 1, 1)))
    edited = np.round(source * scale + rng.normal(0, 0.02, source.shape), 4)
    regions_m = _regions(rng, edited)
    given = np.ones(n_samples, dtype=np.bool_)
    pairs = TrajectoryPairs(np.round(source, 4), edited, given, given)
    return Workload(pairs, make_split(rng, regions_m, protocol))


def make_split(
    rng: np.random.Generator, regions_m: FloatArray, protocol: ProtocolDocument
) -> SplitArrays:
    """Give every region a task and a scene."""
    n_samples = len(regions_m)
    taxonomy = protocol.taxonomy
    family_ids = [family.id for family in taxonomy.families]
    task_index = rng.integers(0, len(taxonomy.tasks), n_samples)
    n_scenes = max(2, n_samples // SAMPLES_PER_SCENE)
    tasks = [taxonomy.tasks[index] for index in task_index]
    return SplitArrays(
        regions_m=regions_m,
        task_index=task_index,
        family_index=np.array([family_ids.index(task.family) for task in tasks]),
        scene_index=rng.integers(0, n_scenes, n_samples),
        n_scenes=n_scenes,
        d_safe_m=np.array([task.d_safe_m for task in tasks]),
        acceptable=np.array([[s in task.acceptable for s in "ABCDE"] for task in tasks]),
    )


def _drive(rng: np.random.Generator, n_samples: int, n_waypoints: int) -> FloatArray:
    """Waypoints of a car with constant acceleration and curvature, some standing; 3 s in all."""
    dt = 3.0 / n_waypoints
    time = dt * np.arange(n_waypoints)
    speed0 = np.where(rng.random(n_samples) < 0.12, 0.0, rng.gamma(3.0, 2.0, n_samples))
    acceleration = rng.normal(-0.2, 1.0, n_samples)
    speed = np.clip(speed0[:, None] + acceleration[:, None] * time, 0.0, 20.0)
    curvature = np.where(rng.random(n_samples) < 0.25, rng.normal(0, 0.06, n_samples), 0.0)
    heading = np.cumsum(curvature[:, None] * speed * dt, axis=1)
    step = np.stack([speed * np.cos(heading), speed * np.sin(heading)], axis=-1) * dt
    return np.cumsum(step, axis=1)


def _regions(rng: np.random.Generator, edited: FloatArray) -> FloatArray:
    """Quadrilaterals ahead of the first footprint, on the path or beside it."""
    n_samples = len(edited)
    along = 0.85 * rng.random(n_samples)
    path = np.concatenate([np.zeros((n_samples, 1, 2)), edited], axis=1)
    where = along * (path.shape[1] - 1)
    step = np.minimum(where.astype(int), path.shape[1] - 2)
    rows, part = np.arange(n_samples), (where - step)[:, None]
    centre = path[rows, step] * (1 - part) + path[rows, step + 1] * part
    centre[:, 0] += 3.528 + 1.5
    beside = rng.random(n_samples) < SHARE_BESIDE
    side = rng.choice([-1.0, 1.0], n_samples)
    centre[:, 1] += np.where(beside, side * rng.uniform(1.5, 5.0, n_samples), 0.0)
    length, width = rng.uniform(0.4, 4.5, n_samples), rng.uniform(0.4, 2.2, n_samples)
    return _quadrilaterals(rng, centre, length, width)


def _quadrilaterals(
    rng: np.random.Generator, centre: FloatArray, length: FloatArray, width: FloatArray
) -> FloatArray:
    n_samples = len(centre)
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2
    corners = signs * np.stack([length, width], axis=1)[:, None]
    corners = corners * rng.uniform(0.8, 1.2, corners.shape)
    concave = rng.random(n_samples) < SHARE_CONCAVE
    corners[concave, 0] *= -0.2
    angle = rng.normal(0, 0.3, n_samples)
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = corners[..., 0], corners[..., 1]
    turned = np.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)
    return turned + centre[:, None]
