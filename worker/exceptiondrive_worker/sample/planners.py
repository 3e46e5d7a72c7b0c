"""Synthetic planners: simple drivers that react to the hazard too late, sideways, or not at all.

Each is a function of what the ego car knows, so that source and edited trajectories differ only
because of the hazard. All motion is physically possible.
"""

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from exceptiondrive_schemas.submission_files import PlanningPrediction, Trajectory
from exceptiondrive_worker.sample.driving import Manoeuvre
from exceptiondrive_worker.sample.scenes import SampleScene

PASSING_GAP_M = 1.6
"""Distance from the edge of the hazard to the centre of the car that passes it."""

Driver = Callable[[SampleScene, Random], tuple[Trajectory | None, Trajectory | None]]


@dataclass(frozen=True)
class Planner:
    """A synthetic planner: its name on the board, what it does, and how it drives.

    `startles` is the share of controls in which it reacts to a region beside the road.
    """

    file_name: str
    method: str
    description: str
    drive: Driver
    startles: float


def late_braker(sample: SampleScene, rng: Random) -> tuple[Trajectory, Trajectory]:
    """Follow the lane; brake late for most hazards, and miss the others."""
    cruise = _cruise(sample, rng)
    reaction_s = rng.uniform(0.6, 1.3)
    brake = Manoeuvre(sample.speed_mps, brake_at_s=reaction_s, brake_mps2=rng.uniform(4.0, 6.5))
    reacts = rng.random() < 0.8
    return cruise.trajectory(sample.lane), (brake if reacts else cruise).trajectory(sample.lane)


def bypass_planner(sample: SampleScene, rng: Random) -> tuple[Trajectory, Trajectory]:
    """Pass the hazard on the side that needs less room, slowing a little; never stop."""
    cruise = _cruise(sample, rng)
    aside_m = _aside_m(sample)
    slow = Manoeuvre(sample.speed_mps, -rng.uniform(0.2, 0.6), aside_m=aside_m)
    reacts = rng.random() < 0.85
    return cruise.trajectory(sample.lane), (slow if reacts else cruise).trajectory(sample.lane)


def noisy_human(sample: SampleScene, rng: Random) -> tuple[Trajectory | None, Trajectory | None]:
    """Brake, swerve or do nothing, with unsteady steering; now and then there is no answer."""
    mood, gives_edited, gives_source = rng.random(), rng.random() >= 0.007, rng.random() >= 0.003
    start = Manoeuvre(sample.speed_mps, rng.uniform(-0.5, 0.4), aside_m=rng.uniform(-0.3, 0.3))
    brake_at_s, brake_mps2 = rng.uniform(0.3, 0.9), rng.uniform(3.0, 8.0)
    if mood < 0.5:
        edited = Manoeuvre(sample.speed_mps, 0.0, brake_at_s, brake_mps2, start.aside_m)
    elif mood < 0.75:
        aside_m = _aside_m(sample) * rng.uniform(0.7, 1.1)
        edited = Manoeuvre(sample.speed_mps, 0.0, brake_at_s, 1.5, aside_m)
    else:
        edited = start
    source = start.trajectory(sample.lane) if gives_source else None
    return source, edited.trajectory(sample.lane) if gives_edited else None


def careful_follower(sample: SampleScene, rng: Random) -> tuple[Trajectory, Trajectory]:
    """See near hazards early and brake gently, which at speed is not enough."""
    cruise = _cruise(sample, rng)
    brake = Manoeuvre(sample.speed_mps, brake_at_s=0.4, brake_mps2=rng.uniform(2.5, 3.5))
    reacts = rng.random() < 0.95
    return cruise.trajectory(sample.lane), (brake if reacts else cruise).trajectory(sample.lane)


PLANNERS = (
    Planner(
        "late-braker",
        "Late Braker",
        "Follows the lane; sees four hazards in five and brakes for them, late.",
        late_braker,
        0.1,
    ),
    Planner(
        "bypass-planner",
        "Bypass Planner",
        "Passes every hazard it sees on the side that needs less room, and never stops.",
        bypass_planner,
        0.05,
    ),
    Planner(
        "noisy-human",
        "Noisy Human",
        "Brakes, swerves or does nothing, with wandering hands; some answers are missing.",
        noisy_human,
        0.3,
    ),
    Planner(
        "careful-follower",
        "Careful Follower",
        "Sees hazards early and brakes gently, which at speed is not enough.",
        careful_follower,
        0.9,
    ),
)


def predictions(
    planner: Planner, samples: tuple[SampleScene, ...], seed: int
) -> list[PlanningPrediction]:
    """Drive one planner through all samples; the same seed gives the same answers."""
    rng, rng_of_controls = (Random(f"{seed}/{planner.file_name}{of}") for of in ("", "/controls"))
    answers = []
    for sample in samples:
        source, edited = planner.drive(sample, rng_of_controls if sample.is_control else rng)
        if sample.is_control and rng_of_controls.random() >= planner.startles:
            edited = source
        answers.append(PlanningPrediction(sample_id=sample.sample_id, source=source, edited=edited))
    return answers


def _cruise(sample: SampleScene, rng: Random) -> Manoeuvre:
    return Manoeuvre(sample.speed_mps, rng.uniform(-0.3, 0.3))


def _aside_m(sample: SampleScene) -> float:
    """Return the nearer lateral position from which the hazard is passed; at most one lane over."""
    to_the_left = max(sample.hazard.left_m + PASSING_GAP_M, 0.0)
    to_the_right = min(sample.hazard.right_m - PASSING_GAP_M, 0.0)
    nearer = to_the_left if to_the_left <= -to_the_right else to_the_right
    return min(max(nearer, -3.5), 3.5)
