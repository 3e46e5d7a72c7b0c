"""What a planning file looks like, and which simple mistake would explain it.

The source trajectories are plans for scenes that were really driven, so their distance from the
recorded drive tells at once whether a file is what it claims to be. Nothing is refused here: the
profile warns. Pure Python, for client and server alike.

Distances of a trajectory are compared as shares of the distance of the recorded one from the
origin, so that a shorter time shown is no better fit. On the 13 planners of LightEMMA (3,181
samples of nuScenes) a file as it is has 0.07 to 0.15, and every transformation fits at least 3.7
times worse. Each transformation of each of them is 5.0 to 1,400 times worse than the file mended. A
mirrored file shows where the drive turns, at its last waypoint, sideways: there right files are off
by 0.5 to 0.7 of the recorded distance, 2.0 to 3.2 times less than mirrored ones.
"""

import math
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from exceptiondrive_schemas.check.answers import TrajectoryPair
from exceptiondrive_schemas.file_profile import FileProfile, Mend
from exceptiondrive_schemas.protocol import GeometrySection, PlausibilitySection

Point = tuple[float, float]
Points = Sequence[Point]

FITS = 0.25
"""A file is what it claims to be if its sources are at most so far off the recorded drives."""
FITS_BETTER = 3.0
"""So many times better, and a transformation is named."""
MIRROR_FITS, MIRROR_FITS_BETTER = 0.75, 1.5
"""The same sideways, where the drive turns."""
TURNS_ABOVE_M = 1.0
"""A recorded drive that ends this far to a side turns."""
MIN_COMPARED = 20
"""Fewer samples tell nothing."""
MAX_COMPARED = 300
"""More tell nothing new: transformations are tried on every so-manieth sample."""
SAME_TIME_S = 1e-6
SECONDS_SHOWN = (1.0, 2.0, 3.0)


@dataclass(frozen=True)
class Compared:
    """One sample: what was driven, and what the file says."""

    recorded: Points
    source: Points
    edited: Points | None


@dataclass(frozen=True)
class Transformation:
    """A simple mistake and what mends it.

    Attributes:
        looks_like: What the file looks like, to stand after "looks like".
        option: What `exceptiondrive convert` needs to mend it; None where no conversion can.
        apply: Returns mended points and the recorded ones at the same times.
    """

    looks_like: str
    option: str | None
    apply: Callable[[Compared], tuple[Points, Points] | None]


def file_profile(
    pairs: Mapping[str, TrajectoryPair],
    geometry: GeometrySection,
    plausibility: PlausibilitySection,
    recorded: Mapping[str, Points] | None = None,
    n_given: int | None = None,
) -> FileProfile | None:
    """Describe what a planning file says.

    Args:
        pairs: Trajectories by sample id, metres; those without all waypoints are passed over.
        geometry: Waypoints and time step.
        plausibility: What stands still, and which pairs are equal.
        recorded: The drives that were recorded in the source scenes, where they are public.
        n_given: Waypoints that the trajectories have, where these are not those of the protocol and
            `pairs` tell the first of them: then only the time between them is looked for.

    Returns:
        Medians and means over all samples; None for a file without a whole trajectory.
    """
    n_wanted = min(n_given or geometry.waypoints, geometry.waypoints)
    whole = {
        sample_id: (_points(pair.source, n_wanted), _points(pair.edited, n_wanted))
        for sample_id, pair in pairs.items()
    }
    sources = [source for source, _ in whole.values() if source]
    both = [(source, edited) for source, edited in whole.values() if source and edited]
    n_edited = sum(edited is not None for _, edited in whole.values())
    if not sources and not n_edited:
        return None
    compared = [
        Compared(recorded[sample_id], source, edited)
        for sample_id, (source, edited) in sorted(whole.items())
        if source and recorded and sample_id in recorded
    ]
    mend = _best_mend(compared, geometry, plausibility, n_given)
    if n_given is not None:
        return FileProfile(mend=mend)
    distances_m = [_distances_m(each.source, each.recorded) for each in compared]
    at_s = dict(zip(SECONDS_SHOWN, _means_at(distances_m, geometry), strict=True))
    means_m = [statistics.fmean(of_one) for of_one in distances_m]
    lengths_m = [(_length_m(source), _length_m(edited)) for source, edited in both]
    margin_m = plausibility.blind_shift_below_m
    return FileProfile(
        source_speed_mps=_median(map(_length_m, sources), 1 / geometry.horizon_s),
        recorded_speed_mps=_median(
            (_length_m(each.recorded) for each in compared), 1 / geometry.horizon_s
        ),
        standing_sources=_share(
            math.hypot(*source[-1]) < plausibility.stationary_below_m for source in sources
        ),
        standing_edited=_share(
            math.hypot(*edited[-1]) < plausibility.stationary_below_m
            for _, edited in whole.values()
            if edited
        ),
        equal_pairs=_share(_mean_distance_m(*pair) < margin_m for pair in both),
        same_edited=_same_share([edited for _, edited in whole.values() if edited], plausibility),
        longer_sources=_share(source > edited + margin_m for source, edited in lengths_m),
        source_l2_m=_mean(means_m),
        source_l2_1s_m=at_s[1.0],
        source_l2_2s_m=at_s[2.0],
        source_l2_3s_m=at_s[3.0],
        median_source_l2_m=_median(means_m),
        mend=mend,
    )


def _points(flat: Sequence[float] | None, n_wanted: int) -> Points | None:
    if flat is None or len(flat) != 2 * n_wanted:
        return None
    return list(zip(flat[::2], flat[1::2], strict=True))


def _distances_m(points: Points, others: Points) -> list[float]:
    return [math.dist(point, other) for point, other in zip(points, others, strict=True)]


def _mean_distance_m(points: Points, others: Points) -> float:
    """Return the shift of a pair: over the waypoints and t = 0, where both are at the origin."""
    return sum(_distances_m(points, others)) / (len(points) + 1)


def _length_m(points: Points) -> float:
    return sum(map(math.dist, [(0.0, 0.0), *points[:-1]], points))


def _means_at(distances_m: list[list[float]], geometry: GeometrySection) -> Iterator[float | None]:
    for time_s in SECONDS_SHOWN:
        index = round(time_s / geometry.time_step_s) - 1
        is_waypoint = math.isclose((index + 1) * geometry.time_step_s, time_s)
        is_reached = is_waypoint and 0 <= index < geometry.waypoints
        yield _mean([of_one[index] for of_one in distances_m]) if is_reached else None


def _mean(values: Sequence[float]) -> float | None:
    return statistics.fmean(values) if values else None


def _median(values: Iterator[float] | Sequence[float], factor: float = 1.0) -> float | None:
    found = list(values)
    return statistics.median(found) * factor if found else None


def _share(answers: Iterator[bool]) -> float | None:
    found = list(answers)
    return sum(found) / len(found) if found else None


def _same_share(paths: Sequence[Points], plausibility: PlausibilitySection) -> float | None:
    """Return the share of paths whose distance of the end, end ahead and first step are the median's.

    None where the paths are few or short: those that stand or creep are told apart.
    """
    if len(paths) < plausibility.flag_family_min_samples:
        return None
    told = [(math.hypot(*path[-1]), path[-1][0], math.hypot(*path[0])) for path in paths]
    middle = [statistics.median(column) for column in zip(*told, strict=True)]
    if middle[0] < plausibility.progress_min_path_m:
        return None
    margin_m = plausibility.blind_shift_below_m
    return _share(
        all(abs(value - usual) < margin_m for value, usual in zip(each, middle, strict=True))
        for each in told
    )


# Transformations


def rotated(points: Points, quarter_turns: int) -> list[Point]:
    """Turn points counter-clockwise by quarter turns about the origin."""
    turns: tuple[Callable[[Point], Point], ...] = (
        lambda point: point,
        lambda point: (-point[1], point[0]),
        lambda point: (-point[0], -point[1]),
        lambda point: (point[1], -point[0]),
    )
    return list(map(turns[quarter_turns % 4], points))


def swapped(points: Points) -> list[Point]:
    """Exchange x and y."""
    return [(y, x) for x, y in points]


def mirrored(points: Points) -> list[Point]:
    """Turn y to the other side."""
    return [(x, -y) for x, y in points]


def scaled(points: Points, factor: float) -> list[Point]:
    """Multiply every coordinate."""
    return [(x * factor, y * factor) for x, y in points]


def summed(points: Points) -> list[Point]:
    """Add up increments to positions."""
    total_x = total_y = 0.0
    positions = []
    for x, y in points:
        total_x, total_y = total_x + x, total_y + y
        positions.append((total_x, total_y))
    return positions


def at_times(points: Points, time_step_s: float, times_s: Sequence[float]) -> list[Point]:
    """Return where a trajectory is at given times, on straight lines between its waypoints.

    Args:
        points: Waypoints at one, two, ... time steps; (0, 0) is put in front.
        time_step_s: Time between two of them.
        times_s: Times from 0 to the last waypoint's.
    """
    whole = [(0.0, 0.0), *points]
    found = []
    for time_s in times_s:
        index = min(int(time_s / time_step_s + 1e-9), len(points) - 1)
        share = time_s / time_step_s - index
        (x0, y0), (x1, y1) = whole[index], whole[index + 1]
        found.append((x0 + share * (x1 - x0), y0 + share * (y1 - y0)))
    return found


def _of_source(change: Callable[[Points], Points], sample: Compared) -> tuple[Points, Points]:
    return change(sample.source), sample.recorded


def _exchanged(sample: Compared) -> tuple[Points, Points] | None:
    return None if sample.edited is None else (sample.edited, sample.recorded)


def _with_step(given_s: float, wanted_s: float, sample: Compared) -> tuple[Points, Points]:
    """Take the source as waypoints `given_s` apart, and compare as far as both reach."""
    step_s = min(given_s, wanted_s)
    reach_s = min(given_s * len(sample.source), wanted_s * len(sample.recorded))
    times_s = [step_s * step for step in range(1, round(reach_s / step_s) + 1)]
    return (
        at_times(sample.source, given_s, times_s),
        at_times(sample.recorded, wanted_s, times_s),
    )


UNITS_M: Mapping[str, float] = MappingProxyType(
    {
        "millimetres": 0.001,
        "centimetres": 0.01,
        "inches": 0.0254,
        "feet": 0.3048,
        "kilometres": 1000.0,
    }
)
"""Units that trajectories come in, other than metres, each in metres."""
_SPATIAL: tuple[tuple[str, str, Callable[[Points], Points]], ...] = (
    ("mirrored (y to the right)", "--mirror", mirrored),
    ("x and y exchanged (x left, y forward)", "--swap", swapped),
    ("x right / y forward", "--rotate -90", partial(rotated, quarter_turns=-1)),
    ("x left / y backward", "--rotate 90", partial(rotated, quarter_turns=1)),
    ("x backward / y right", "--rotate 180", partial(rotated, quarter_turns=2)),
    *((unit, f"--unit {unit}", partial(scaled, factor=metres)) for unit, metres in UNITS_M.items()),
    ("increments instead of positions", "--cumulative", summed),
    ("reversed in time", "--reverse", lambda points: points[::-1]),
)
TIME_FACTORS = (0.1, 0.2, 0.4, 0.5, 1.0, 2.0, 5.0, 10.0)
MIRROR = _SPATIAL[0]
EXCHANGE = Transformation("source and edited exchanged", "--exchange", _exchanged)
"""Where edits are slight, a file fits exchanged, too, and much better as it should be."""


def _of_space() -> Iterator[Transformation]:
    for looks_like, option, change in _SPATIAL:
        yield Transformation(looks_like, option, partial(_of_source, change))
    yield EXCHANGE


def _of_time(geometry: GeometrySection, n_given: int) -> Iterator[Transformation]:
    """Yield what waypoints another time apart would be; fewer than the horizon takes cannot be mended."""
    for factor in TIME_FACTORS:
        given_s = factor * geometry.time_step_s
        n_needed = waypoints_needed(geometry, given_s)
        cut = " --truncate" if n_given > n_needed else ""
        count = "" if n_given == geometry.waypoints else f"{n_given} "
        looks_like = [f"{count}waypoints {given_s:g} s apart"]
        if n_given < n_needed:
            end_s = given_s * n_given
            looks_like.append(
                f"(the last at {end_s:g} s, where {geometry.horizon_s:g} s are wanted)"
            )
        if n_given == geometry.waypoints:
            looks_like.append(f"or like a planner at {factor:g} times the recorded speed")
        yield Transformation(
            " ".join(looks_like),
            None if n_given < n_needed else f"--time-step-s {given_s:g}{cut}",
            partial(_with_step, given_s, geometry.time_step_s),
        )


def waypoints_needed(geometry: GeometrySection, time_step_s: float) -> int:
    """Return how many waypoints so far apart in time reach the protocol's horizon."""
    return math.ceil((geometry.horizon_s - SAME_TIME_S) / time_step_s)


def _best_mend(
    compared: Sequence[Compared],
    geometry: GeometrySection,
    plausibility: PlausibilitySection,
    n_given: int | None,
) -> Mend | None:
    """Return the transformation after which the file fits, if it does not fit as it is."""
    moving = [
        each
        for each in compared
        if math.hypot(*each.recorded[-1]) > plausibility.frame_check_min_motion_m
    ]
    if len(moving) < MIN_COMPARED:
        return None
    tried = _some(moving)
    as_is = [_with_step(geometry.time_step_s, geometry.time_step_s, each) for each in tried]
    error = _error(as_is)
    if n_given is not None:
        return _best(tried, error, _of_time(geometry, n_given))
    if error <= FITS:
        transformations = [EXCHANGE]
    else:
        transformations = [*_of_time(geometry, geometry.waypoints), *_of_space()]
    best = _best(tried, error, transformations)
    if best is not None and error > FITS_BETTER * best.mended_error:
        return best
    return _mirror_mend(moving) if error <= FITS else None


def _best(
    tried: Sequence[Compared], error: float, transformations: Iterable[Transformation]
) -> Mend | None:
    """Return what fits best, if it fits at all."""
    mends: list[Mend] = []
    for transformation in transformations:
        applied = [found for each in tried if (found := transformation.apply(each)) is not None]
        if len(applied) >= MIN_COMPARED:
            mends.append(
                Mend(
                    looks_like=transformation.looks_like,
                    convert_option=transformation.option,
                    error=error,
                    mended_error=_error(applied),
                )
            )
    best = min(mends, key=lambda mend: mend.mended_error, default=None)
    return best if best is not None and best.mended_error <= FITS else None


def _some(samples: Sequence[Compared]) -> Sequence[Compared]:
    return samples[:: math.ceil(len(samples) / MAX_COMPARED)]


def _error(pairs: Sequence[tuple[Points, Points]]) -> float:
    """Return the median distance as a share of the median distance of what was recorded."""
    origin = (0.0, 0.0)
    distance_m = statistics.median(sum(_distances_m(*pair)) for pair in pairs)
    scale_m = statistics.median(
        sum(math.dist(point, origin) for point in recorded) for _, recorded in pairs
    )
    return distance_m / scale_m if scale_m else 0.0


def _mirror_mend(moving: Sequence[Compared]) -> Mend | None:
    turning = [each for each in moving if abs(each.recorded[-1][1]) > TURNS_ABOVE_M]
    if len(turning) < MIN_COMPARED:
        return None
    sides_m = [(each.source[-1][1], each.recorded[-1][1]) for each in _some(turning)]
    scale_m = statistics.median(abs(recorded) for _, recorded in sides_m)
    error = statistics.median(abs(source - recorded) for source, recorded in sides_m) / scale_m
    mended = statistics.median(abs(-source - recorded) for source, recorded in sides_m) / scale_m
    if mended > MIRROR_FITS or error <= MIRROR_FITS_BETTER * mended:
        return None
    looks_like, option, _ = MIRROR
    return Mend(looks_like=looks_like, convert_option=option, error=error, mended_error=mended)
