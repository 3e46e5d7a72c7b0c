"""Scenes and samples of the synthetic split: 20 samples of every task and a control, in 120 scenes."""

import math
from dataclasses import dataclass
from random import Random

from exceptiondrive_schemas.split import Split, SplitSample
from exceptiondrive_schemas.submission_files import Trajectory
from exceptiondrive_worker.sample.driving import Lane, Manoeuvre
from exceptiondrive_worker.sample.hazards import PLACEMENTS, Hazard, place

SEED = 20261120
SPLIT_NAME = "sample"
SPLIT_TITLE = (
    "Synthetic development split: 420 samples, 20 of each task, and 21 controls; regions public"
)
N_SCENES = 120
SAMPLES_PER_TASK = 20
SPEED_RANGE_MPS = (2.0, 14.0)
STRAIGHT_SHARE = 0.55
RADIUS_RANGE_M = (25.0, 90.0)
MAX_LATERAL_ACCELERATION_MPS2 = 2.5


@dataclass(frozen=True)
class SampleScene:
    """One sample with what its planner would see: lane, own speed and the hazard."""

    sample_id: str
    scene_id: str
    task_id: str
    lane: Lane
    speed_mps: float
    hazard: Hazard
    is_control: bool = False


@dataclass(frozen=True)
class _Scene:
    scene_id: str
    lane: Lane
    speed_mps: float


def sample_scenes() -> tuple[SampleScene, ...]:
    """Draw all samples, sorted by sample id; ids reveal neither task nor scene nor control."""
    rng = Random(SEED)
    scenes = [_scene(number, rng) for number in range(1, N_SCENES + 1)]
    tasks = _shuffled([task for task in PLACEMENTS for _ in range(SAMPLES_PER_TASK)], rng)
    samples = [
        _sample(scenes[position % N_SCENES], task, rng) for position, task in enumerate(tasks)
    ]
    rng_of_controls = Random(f"{SEED}/controls")
    samples += [
        _sample(rng_of_controls.choice(scenes), task, rng_of_controls, is_control=True)
        for task in PLACEMENTS
    ]
    return tuple(sorted(samples, key=lambda sample: sample.sample_id))


def sample_split() -> Split:
    """Return the synthetic split."""
    return Split(
        schema_="exceptiondrive.split/1",
        name=SPLIT_NAME,
        title=SPLIT_TITLE,
        recorded_is_public=True,
        samples=tuple(
            SplitSample(
                sample_id=sample.sample_id,
                scene_id=sample.scene_id,
                task=sample.task_id,
                region=sample.hazard.region,
                recorded=_recorded(sample),
                control=sample.is_control,
            )
            for sample in sample_scenes()
        ),
    )


def _scene(number: int, rng: Random) -> _Scene:
    slow, fast = SPEED_RANGE_MPS
    speed_mps = slow + (fast - slow) * (rng.random() + rng.random()) / 2
    return _Scene(f"sample-scene-{number:03d}", _lane(speed_mps, rng), speed_mps)


def _lane(speed_mps: float, rng: Random) -> Lane:
    is_straight = rng.random() < STRAIGHT_SHARE
    bends_left = rng.random() < 0.5
    radius_m = max(rng.uniform(*RADIUS_RANGE_M), speed_mps**2 / MAX_LATERAL_ACCELERATION_MPS2)
    if is_straight:
        return Lane(0.0)
    return Lane(math.copysign(1 / radius_m, 1 if bends_left else -1))


def _sample(scene: _Scene, task_id: str, rng: Random, *, is_control: bool = False) -> SampleScene:
    slow, fast = SPEED_RANGE_MPS
    speed_mps = min(max(scene.speed_mps * rng.uniform(0.85, 1.1), slow), fast)
    return SampleScene(
        sample_id=f"{rng.getrandbits(64):016x}",
        scene_id=scene.scene_id,
        task_id=task_id,
        lane=scene.lane,
        speed_mps=speed_mps,
        hazard=place(task_id, scene.lane, speed_mps, rng, is_beside=is_control),
        is_control=is_control,
    )


def _recorded(sample: SampleScene) -> Trajectory:
    """Return the drive without a hazard: along the lane, not quite in its centre."""
    rng = Random(f"{SEED}/recorded/{sample.sample_id}")
    drive = Manoeuvre(sample.speed_mps, rng.uniform(-0.6, 0.6), aside_m=rng.uniform(-0.4, 0.4))
    return drive.trajectory(sample.lane)


def _shuffled(items: list[str], rng: Random) -> list[str]:
    keyed = sorted((rng.random(), position) for position in range(len(items)))
    return [items[position] for _, position in keyed]
