"""Where the region of each task lies: on the path, at the kerb, across the junction."""

from dataclasses import dataclass
from random import Random

from exceptiondrive_worker.sample.driving import Lane, Position

FRONT_BUMPER_M = 3.528
"""Distance of the front end of protocol 1.0's footprint ahead of the rear axle."""
LEAST_GAP_M = 1.2
CONCAVE_SHARE = 0.35
BESIDE_M = (5.0, 8.0)
"""Distance from the lane's centre to the nearer edge of a region beside the road."""
Range = tuple[float, float]


@dataclass(frozen=True)
class Placement:
    """Ranges from which a region is drawn: size, lateral position, and slant.

    Attributes:
        length_m: Extent along the lane.
        width_m: Extent across it.
        left_m: Centre, to the left of the lane's centre; negative is the kerb side.
        slant: Shift along the lane per metre across it.
        may_be_concave: Whether one corner may be moved inwards.
    """

    length_m: Range
    width_m: Range
    left_m: Range
    slant: Range = (0.0, 0.0)
    may_be_concave: bool = False


PLACEMENTS = {
    "SE1": Placement((0.5, 0.9), (0.6, 1.8), (-2.0, 0.4)),
    "SE2": Placement((1.6, 2.0), (0.6, 0.9), (-2.1, -0.6), slant=(-0.4, 0.4)),
    "SE3": Placement((0.6, 1.2), (0.5, 1.0), (-1.8, 1.2)),
    "SE4": Placement((3.8, 4.8), (1.7, 2.0), (-2.6, -1.2), slant=(0.2, 0.6)),
    "LB1": Placement((4.2, 5.0), (1.8, 2.1), (-0.4, 0.4)),
    "LB2": Placement((4.0, 8.0), (3.0, 4.5), (-0.5, 0.5), (-0.4, 0.4), may_be_concave=True),
    "LB3": Placement((0.6, 1.2), (3.2, 3.8), (-0.2, 0.2)),
    "LB4": Placement((0.7, 1.6), (3.5, 6.0), (-0.6, 0.6), slant=(-0.5, 0.5)),
    "BG1": Placement((4.2, 5.2), (1.8, 2.1), (-1.9, -1.1)),
    "BG2": Placement((5.0, 9.0), (1.0, 1.8), (-1.9, -1.2), may_be_concave=True),
    "BG3": Placement((0.8, 1.2), (0.8, 1.1), (-1.9, -1.2)),
    "BG4": Placement((5.0, 9.0), (3.0, 5.0), (0.2, 1.4)),
    "SR1": Placement((5.0, 9.0), (3.2, 3.6), (-0.2, 0.2)),
    "SR2": Placement((4.0, 8.0), (3.2, 3.6), (-0.2, 0.2)),
    "SR3": Placement((6.0, 9.0), (3.2, 3.6), (-0.2, 0.2)),
    "IC1": Placement((2.2, 3.4), (6.0, 10.0), (-1.5, 1.5), slant=(-0.2, 0.2)),
    "IC2": Placement((2.5, 4.0), (5.0, 8.0), (0.5, 2.5), slant=(0.3, 0.8)),
    "IC3": Placement((5.0, 8.0), (4.0, 6.0), (-0.8, 0.8)),
    "RS1": Placement((2.0, 4.5), (2.0, 3.4), (-0.6, 0.6), may_be_concave=True),
    "RS2": Placement((0.5, 1.2), (0.5, 1.0), (-0.9, 0.9)),
    "RS3": Placement((3.0, 6.5), (1.4, 3.0), (-0.7, 0.7), may_be_concave=True),
}


@dataclass(frozen=True)
class Hazard:
    """A placed hazard, as a planner might see it, and its region.

    Attributes:
        ahead_m: Free road between the front bumper and the hazard.
        right_m: Its edge on the kerb side, to the left of the lane's centre.
        left_m: Its other edge.
        region: Four corners in the ego frame, metres, to the millimetre.
    """

    ahead_m: float
    right_m: float
    left_m: float
    region: tuple[Position, ...]


def place(
    task_id: str, lane: Lane, speed_mps: float, rng: Random, *, is_beside: bool = False
) -> Hazard:
    """Draw a hazard of this task about 0.5 to 2 seconds ahead of a car at this speed.

    With `is_beside` it lies beside the road, where no good driver heeds it.
    """
    placement = PLACEMENTS[task_id]
    length = rng.uniform(*placement.length_m)
    width = rng.uniform(*placement.width_m)
    centre_left = rng.uniform(*placement.left_m)
    slant = rng.uniform(*placement.slant)
    if is_beside:
        centre_left = rng.choice((-1, 1)) * (width / 2 + rng.uniform(*BESIDE_M))
    gap = LEAST_GAP_M + speed_mps * rng.uniform(0.45, 2.0)
    near = FRONT_BUMPER_M + gap + abs(slant) * width / 2
    right, left = centre_left - width / 2, centre_left + width / 2
    corners = [
        (near + end * length + slant * (side - centre_left), side)
        for end, side in ((0, right), (1, right), (1, left), (0, left))
    ]
    if placement.may_be_concave and rng.random() < CONCAVE_SHARE:
        corners[2] = _pushed_in(corners)
    region = tuple(_rounded(lane.position_m(along, side)) for along, side in corners)
    return Hazard(ahead_m=gap, right_m=right, left_m=left, region=region)


def _pushed_in(corners: list[Position]) -> Position:
    """Return a third corner inside the triangle of the others, which makes the region concave."""
    first, second, _, fourth = corners
    return (
        0.3 * first[0] + 0.35 * (second[0] + fourth[0]),
        0.3 * first[1] + 0.35 * (second[1] + fourth[1]),
    )


def _rounded(position: Position) -> Position:
    return round(position[0], 3), round(position[1], 3)
