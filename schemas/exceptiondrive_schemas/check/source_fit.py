"""The profile of a planning file, and the simple mistake that would explain it.

Source trajectories are plans for scenes that were actually driven, so their distance from the
recorded drive shows whether a file is what it claims to be. Nothing is refused here: the profile
warns. Pure Python, for client and server alike.

Distances of a trajectory are compared as shares of the recorded one's distance from the origin, so
that a shorter time does not fit better. On the 13 planners of LightEMMA (3,181 samples of nuScenes)
an unchanged file has 0.07 to 0.15, and every transformation fits at least 3.7 times worse. A file
with any of these mistakes is 5.0 to 1,400 times worse than the mended file. A mirrored file shows
where the drive turns, in the lateral position of its last waypoint: right files are off by 0.5 to
0.7 of the recorded distance there, 2.0 to 3.2 times less than mirrored ones. Rows that are off by
one show at the first waypoint, where two consecutive samples were driven at different speeds: at
most an eighth of the answers of a right file are nearer to the other sample's drive, and seven
eighths of a file that is off by one row.
"""

from __future__ import annotations  # array[float] is not subscriptable at runtime before 3.12

import math
import statistics
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, compress, starmap
from operator import neg, sub
from typing import TypeVar

from exceptiondrive_schemas.check.answers import TrajectoryPair
from exceptiondrive_schemas.check.tracks import Column, PairTracks, Steps, Tracks, Whole
from exceptiondrive_schemas.check.transformations import (
    EXCHANGE,
    MIRROR,
    SPATIAL,
    Compared,
    Points,
    Transformation,
    of_source,
    of_time,
    scaled,
)
from exceptiondrive_schemas.file_profile import FileProfile, Mend
from exceptiondrive_schemas.protocol import GeometrySection, PlausibilitySection

FITS = 0.25
"""A file is what it claims to be if its sources are at most this far off the recorded drives."""
FITS_BETTER = 3.0
"""A transformation is named if the file fits this many times better with it."""
MIRROR_FITS, MIRROR_FITS_BETTER = 0.75, 1.5
"""The same for lateral distances, where the drive turns."""
TURNS_ABOVE_M = 1.0
"""A recorded drive turns if it ends at least this far to a side."""
AT_ORIGIN_M = 0.05
"""A first point this close to the origin is the car at t = 0."""
FROM_ORIGIN = 0.9
"""If this share of the moving trajectories begins at the origin, t = 0 is written; if this share of
the standing ones is elsewhere, at one place, another point than the rear axle is written."""
FIRST_STEPS_LONGER = 1.6
"""If the median first step is this many times the second, the first waypoint is missing."""
LEAD_FITS_BETTER = 2.0
OFFSET_ABOVE_M, OFFSET_SPREADS_M, MIN_STANDING = 1.0, 0.5, 5
"""No standing car is this far away, and not all of them equally far all the time."""
ROWS_DIFFER_M = 1.5
"""First waypoints this far apart are of cars at different speeds."""
OF_NEIGHBOUR = 0.75
"""If this share of the answers is nearer to the neighbour's, rows are off by one."""
OF_OTHERS, IN_ORDER = 0.25, 0.12
"""If drives are this far off by sample, but this close when sorted by length, ids are mixed up."""
NO_PACE = 0.1
"""No planner intends less than this share of the recorded speed, or more than its inverse."""
ALL_ROWS = 0.8
"""If a transformation mends a smaller share of rows, it mends a part and spoils the others."""
MIN_COMPARED = 20
"""With fewer samples there is no verdict."""
MAX_COMPARED = 300
"""More samples add nothing: transformations are tried on evenly spaced ones."""
FIRST_LOOK, FAR_OFF = 12, 0.5
"""A transformation this far off on every twelfth sample is not tried on all."""
SECONDS_SHOWN = (1.0, 2.0, 3.0)
WITH_ITS_ID = "write each trajectory with its own sample id"


def file_profile(
    pairs: Mapping[str, TrajectoryPair],
    geometry: GeometrySection,
    plausibility: PlausibilitySection,
    recorded: Mapping[str, Points] | None = None,
    n_given: int | None = None,
    tracks: PairTracks | None = None,
) -> FileProfile | None:
    """Describe the content of a planning file.

    Args:
        pairs: Trajectories by sample id, metres; those without all waypoints are skipped.
        geometry: Waypoints and time step.
        plausibility: Thresholds of standing still and of equal pairs.
        recorded: The drives that were recorded in the source scenes, if public.
        n_given: Number of waypoints of the trajectories if it differs from the protocol's and
            `pairs` holds the first of them; then only their time step is estimated.
        tracks: The same trajectories column by column, if available and all complete.

    Returns:
        Medians and means over all samples; None for a file without a complete trajectory.
    """
    n_wanted = min(n_given or geometry.waypoints, geometry.waypoints)
    whole: Mapping[str, Whole] = pairs
    if tracks is None:
        whole = {
            sample_id: (_if_complete(pair.source, n_wanted), _if_complete(pair.edited, n_wanted))
            for sample_id, pair in pairs.items()
        }
        tracks = PairTracks.of(whole.values(), n_wanted)
    at_source, at_edit = tracks.source, tracks.edited
    if not at_source.n and not at_edit.n:
        return None
    compared = [
        Compared(recorded[sample_id], source, of_edit)
        for sample_id, (source, of_edit) in sorted(whole.items() if recorded else ())
        if source and recorded and sample_id in recorded
    ]
    best = _best_mend(compared, geometry, plausibility, n_given)
    if n_given is not None:
        return FileProfile(mend=best)
    of_pairs = at_source.first(tracks.n_both), at_edit.first(tracks.n_both)
    driven = Tracks.of([chain.from_iterable(each.recorded) for each in compared], n_wanted)
    beside = Tracks.of([each.flat_source for each in compared], n_wanted)
    mend = (
        _start_mend((at_source, at_edit), geometry, plausibility)
        or best
        or _row_mend(whole, tracks, recorded)
        or _id_mend(
            beside.ends_m,
            driven.ends_m,
            what="trajectories",
            lengths="lengths",
            own="the recorded drives",
        )
        or _edited_mend(*of_pairs, plausibility)
    )
    distances_m = list(beside.gaps_m(driven))
    at_s = dict(zip(SECONDS_SHOWN, _means_at(distances_m, geometry), strict=True))
    means_m = [math.fsum(of_one) / n_wanted for of_one in distances_m]
    shifts_m = _shifts_m(*of_pairs)
    lengths_m = zip(
        *(each.lengths_m[: tracks.n_both] for each in (at_source, at_edit)), strict=True
    )
    margin_m, reach_m = plausibility.blind_shift_below_m, plausibility.stationary_below_m
    return FileProfile(
        source_speed_mps=_median(at_source.lengths_m, 1 / geometry.horizon_s),
        recorded_speed_mps=_median(driven.lengths_m, 1 / geometry.horizon_s),
        standing_sources=_share([end_m < reach_m for end_m in at_source.ends_m]),
        standing_edited=_share([end_m < reach_m for end_m in at_edit.ends_m]),
        equal_pairs=_share([shift_m < margin_m for shift_m in shifts_m]),
        same_edited=_same_share(at_edit, plausibility),
        longer_sources=_share([source_m > edit_m + margin_m for source_m, edit_m in lengths_m]),
        source_l2_m=_mean(means_m),
        source_l2_1s_m=at_s[1.0],
        source_l2_2s_m=at_s[2.0],
        source_l2_3s_m=at_s[3.0],
        median_source_l2_m=_median(means_m),
        mend=mend,
    )


def _if_complete(flat: array[float] | None, n_wanted: int) -> array[float] | None:
    return flat if flat is not None and len(flat) == 2 * n_wanted else None


def _distances_m(points: Points, others: Points) -> list[float]:
    return [math.dist(point, other) for point, other in zip(points, others, strict=True)]


def _shifts_m(sources: Tracks, edited: Tracks) -> list[float]:
    """Return the shift of each pair, over the waypoints and t = 0, where both are at the origin."""
    n_points = len(sources.x_m) + 1
    return [total_m / n_points for total_m in map(sum, sources.gaps_m(edited))]


def _means_at(
    distances_m: Sequence[Sequence[float]], geometry: GeometrySection
) -> Iterator[float | None]:
    for time_s in SECONDS_SHOWN:
        index = round(time_s / geometry.time_step_s) - 1
        is_waypoint = math.isclose((index + 1) * geometry.time_step_s, time_s)
        is_reached = is_waypoint and 0 <= index < geometry.waypoints
        yield _mean([of_one[index] for of_one in distances_m]) if is_reached else None


def _mean(values: Sequence[float]) -> float | None:
    return statistics.fmean(values) if values else None


def _median(values: Sequence[float], factor: float = 1.0) -> float | None:
    return statistics.median(values) * factor if values else None


def _share(answers: Sequence[bool]) -> float | None:
    return sum(answers) / len(answers) if answers else None


def _same_share(edited: Tracks, plausibility: PlausibilitySection) -> float | None:
    """Return the share of paths with the median's distance of the end, end ahead and first step.

    None if the paths are few or short: those that stand still or creep have their own numbers.
    """
    if len(edited.ends_m) < plausibility.flag_family_min_samples:
        return None
    told = (edited.ends_m, edited.x_m[-1], edited.step_lengths_m[0])
    end_m, ahead_m, first_m = map(statistics.median, told)
    if end_m < plausibility.progress_min_path_m:
        return None
    margin_m = plausibility.blind_shift_below_m
    return _share(
        [
            abs(end - end_m) < margin_m
            and abs(ahead - ahead_m) < margin_m
            and abs(first - first_m) < margin_m
            for end, ahead, first in zip(*told, strict=True)
        ]
    )


def _best_mend(
    compared: Sequence[Compared],
    geometry: GeometrySection,
    plausibility: PlausibilitySection,
    n_given: int | None,
) -> Mend | None:
    """Return the transformation after which the file fits, if it does not fit unchanged."""
    moving = [
        each
        for each in compared
        if math.hypot(*each.recorded[-1]) > plausibility.frame_check_min_motion_m
    ]
    if len(moving) < MIN_COMPARED:
        return None
    tried = _evenly_chosen(moving)
    as_is = [
        (each.source[: len(each.recorded)], each.recorded[: len(each.source)]) for each in tried
    ]
    error = _median_error(as_is)
    if n_given is not None:
        return _best_of(tried, error, of_time(geometry, n_given))
    transformations = [EXCHANGE]
    if error > FITS:
        transformations = [*of_time(geometry, geometry.waypoints), *SPATIAL, EXCHANGE]
    return (
        _best_of(tried, error, transformations, FITS_BETTER)
        or _offset_mend(compared)
        or _offset_of_moving(tried, error)
        or _scale_mend(tried, error)
        or _lead_mend(tried, error, geometry)
        or (_sideways_mend(moving) if error <= FITS else None)
    )


def _best_of(
    tried: Sequence[Compared],
    error: float,
    transformations: Iterable[Transformation],
    times_better: float | None = None,
) -> Mend | None:
    """Return the best fit, if it fits at all, and by this factor better than the unchanged file."""

    def after(transformation: Transformation, samples: Sequence[Compared]) -> float | None:
        known = list(filter(None, map(transformation.apply, samples)))
        return _median_error(known) if len(known) >= MIN_COMPARED else None

    near = (each for each in transformations if (after(each, tried[::FIRST_LOOK]) or 0) <= FAR_OFF)
    found = [(off, each) for each in near if (off := after(each, tried)) is not None]
    if not found:
        return None
    mended_error, best = min(found, key=lambda each: each[0])
    if mended_error > FITS or (times_better and error <= times_better * mended_error):
        return None
    changes = [
        (_relative_distance(each.source, each.recorded), _relative_distance(*pair))
        for each in tried
        if (pair := best.apply(each)) and len(each.source) == len(each.recorded)
    ]
    return _whole_or_part(best, error, mended_error, changes)


def _relative_distance(points: Points, recorded: Points) -> float:
    """Return the distance of points from recorded ones, as a share of the recorded distance."""
    scale_m = sum(math.hypot(*point) for point in recorded)
    return sum(_distances_m(points, recorded)) / scale_m if scale_m else 0.0


def _whole_or_part(
    best: Transformation,
    error: float,
    mended_error: float,
    changes: Sequence[tuple[float, float]],
) -> Mend:
    """Name a transformation; if it mends some rows and spoils the others, say so.

    The changes are the distances of each row, before and after, as shares.
    """
    nearer = [after < before for before, after in changes if abs(before - after) > FITS]
    share = sum(nearer) / len(nearer) if len(nearer) >= MIN_COMPARED else 1.0
    if share < ALL_ROWS:
        looks_like = (
            f"{best.looks_like} in a part of its rows: of those that it changes, {share:.0%} come nearer "
            "to the recorded drives, and the others go away from them"
        )
        return _by_hand(looks_like, "write all rows alike, where the planner writes them")
    return Mend(
        looks_like=best.looks_like,
        convert_option=best.option,
        error=error,
        mended_error=mended_error,
        by_hand=best.by_hand,
    )


def _by_hand(looks_like: str, cure: str) -> Mend:
    """Name a mistake that no conversion can mend, and that the fit does not show."""
    return Mend(looks_like=looks_like, convert_option=None, by_hand=cure)


_One = TypeVar("_One")


def _evenly_chosen(samples: Sequence[_One]) -> Sequence[_One]:
    return samples[:: math.ceil(len(samples) / MAX_COMPARED)]


def _median_error(pairs: Sequence[tuple[Points, Points]]) -> float:
    """Return the median distance as a share of the median recorded distance."""
    origin = (0.0, 0.0)
    distance_m = statistics.median(sum(_distances_m(*pair)) for pair in pairs)
    scale_m = statistics.median(
        sum(math.dist(point, origin) for point in recorded) for _, recorded in pairs
    )
    return distance_m / scale_m if scale_m else 0.0


def _sideways_mend(moving: Sequence[Compared]) -> Mend | None:
    """Return the mirror image as the mend of trajectories that turn to the other side."""
    turning = [each for each in moving if abs(each.recorded[-1][1]) > TURNS_ABOVE_M]
    if len(turning) < MIN_COMPARED:
        return None
    ends = [(each.source[-1][1], each.recorded[-1][1]) for each in _evenly_chosen(turning)]
    scale_m = statistics.median(abs(driven_m) for _, driven_m in ends)
    error = statistics.median(abs(y_m - driven_m) for y_m, driven_m in ends) / scale_m
    mended = statistics.median(abs(y_m + driven_m) for y_m, driven_m in ends) / scale_m
    if mended > MIRROR_FITS or error <= MIRROR_FITS_BETTER * mended:
        return None
    rows = [
        (abs((y_m - driven_m) / driven_m), abs((y_m + driven_m) / driven_m))
        for y_m, driven_m in ends
    ]
    mend = _whole_or_part(MIRROR, error, mended, rows)
    return mend.model_copy(update={"is_sideways": True})


# Mistakes that show in trajectories alone, or in their neighbours in the file


def _start_mend(
    sides: Iterable[Tracks], geometry: GeometrySection, plausibility: PlausibilitySection
) -> Mend | None:
    """Detect a first waypoint that is the car at t = 0, in the trajectories of either side."""
    shares = []
    for of_side in sides:
        begins = [
            first_m <= AT_ORIGIN_M
            for first_m, end_m in zip(of_side.step_lengths_m[0], of_side.ends_m, strict=True)
            if end_m > plausibility.frame_check_min_motion_m
        ]
        if len(begins) >= MIN_COMPARED:
            shares.append(_share(begins) or 0.0)
    share = max(shares, default=0.0)
    if share < FROM_ORIGIN:
        return None
    end_s = geometry.horizon_s - geometry.time_step_s
    return _by_hand(
        f"waypoints from t = 0 on (the last at {end_s:g} s, where {geometry.horizon_s:g} s are "
        f"wanted): {share:.0%} of the trajectories that move begin at (0, 0)",
        "leave out t = 0 and write the waypoint that is missing at the end",
    )


def _offset_mend(compared: Sequence[Compared]) -> Mend | None:
    """Detect waypoints of another point than the rear axle, by standing cars that are elsewhere."""
    standing = [each for each in compared if math.hypot(*each.recorded[-1]) < OFFSET_SPREADS_M]
    if len(standing) < MIN_STANDING:
        return None
    offset_m = statistics.median(each.source[0][0] for each in standing)
    are_alike = _share(
        [max(abs(x_m - offset_m) for x_m, _ in each.source) < OFFSET_SPREADS_M for each in standing]
    )
    if abs(offset_m) < OFFSET_ABOVE_M or (are_alike or 0.0) < FROM_ORIGIN:
        return None
    shifted = _origin_ahead(offset_m)
    return Mend(
        looks_like=f"{shifted.looks_like}: there begin those of cars that stand",
        convert_option=shifted.option,
    )


def _offset_of_moving(tried: Sequence[Compared], error: float) -> Mend | None:
    """Detect the same without standing cars: all waypoints are equally far ahead of the drive."""
    gaps_m = [
        own[0] - at[0] for each in tried for own, at in zip(each.source, each.recorded, strict=True)
    ]
    offset_m = statistics.median(gaps_m)
    if abs(offset_m) < OFFSET_ABOVE_M:
        return None
    return _best_of(tried, error, [_origin_ahead(offset_m)], FITS_BETTER)


def _origin_ahead(offset_m: float) -> Transformation:
    return of_source(
        f"waypoints of a point {offset_m:.2f} m ahead of the rear axle",
        f"--origin-offset-m {-offset_m:.2f} --follows rear-axle",
        lambda points: [(x - offset_m, y) for x, y in points],
    )


def _scale_mend(tried: Sequence[Compared], error: float) -> Mend | None:
    """Detect positions that are too short or too long by one factor, such as normalised ones."""
    shares = [math.hypot(*each.source[-1]) / math.hypot(*each.recorded[-1]) for each in tried]
    factor = statistics.median(shares)
    if factor == 0 or NO_PACE <= factor <= 1 / NO_PACE:
        return None
    normalised = of_source(
        f"positions {factor:.2g} times as far as the recorded ones, as normalised ones are",
        None,
        partial(scaled, factor=1 / factor),
        f"write metres, {1 / factor:.2g} times as much",
    )
    return _best_of(tried, error, [normalised], FITS_BETTER)


def _lead_mend(tried: Sequence[Compared], error: float, geometry: GeometrySection) -> Mend | None:
    """Detect waypoints that begin one time step late: the first step is twice the next."""
    steps = [
        math.hypot(*each.source[0]) / max(math.dist(*each.source[:2]), AT_ORIGIN_M)
        for each in tried
        if len(each.source) > 1
    ]
    if not steps or statistics.median(steps) < FIRST_STEPS_LONGER:
        return None
    step_s = geometry.time_step_s
    late = Transformation(
        f"waypoints from {2 * step_s:g} s on (the one at {step_s:g} s is missing)",
        None,
        lambda each: (each.source[:-1], each.recorded[1:]),
        f"write the waypoint at {step_s:g} s first",
    )
    return _best_of(tried, error, [late], LEAD_FITS_BETTER)


def _row_mend(
    whole: Mapping[str, Whole], tracks: PairTracks, recorded: Mapping[str, Points] | None
) -> Mend | None:
    """Detect trajectories off by one row: each is that of the sample before or after it."""
    if tracks.n_both == len(whole):  # all rows are in the columns, in their order
        sources, edits = ((side.x_m[0], side.y_m[0]) for side in (tracks.source, tracks.edited))
    else:
        sources = _first_points(source for source, _ in whole.values())
        edits = _first_points(of_edit for _, of_edit in whole.values())
    of_edited = _nearer_neighbour(sources, edits)
    found = None
    if recorded:
        drives = (recorded[name][0] if name in recorded else None for name in whole)
        found = _nearer_neighbour(_first_points(drives), sources)
    if found is not None:
        what = "trajectories" if of_edited is None else "source trajectories"
        own = "drive"
    elif of_edited is not None:
        found, own = of_edited, "source trajectory"
        what = "edited trajectories" if recorded else "edited trajectories, or the source ones,"
    else:
        return None
    share, side = found
    return _by_hand(
        f"{what} that stand one row off: where two rows differ, {share:.0%} begin nearer to "
        f"the {own} of the sample {side} than to their own",
        WITH_ITS_ID,
    )


def _id_mend(lengths_m: Column, own_m: Column, *, what: str, lengths: str, own: str) -> Mend | None:
    """Detect trajectories under wrong sample ids: of the right lengths, but in another order.

    The words name the trajectories, these lengths, and the lengths that they should have.
    """
    scale_m = math.fsum(own_m)
    if len(own_m) < MIN_COMPARED or not scale_m:
        return None
    by_sample = math.fsum(map(abs, map(sub, lengths_m, own_m))) / scale_m
    if by_sample < OF_OTHERS:
        return None
    by_order = math.fsum(map(abs, map(sub, sorted(lengths_m), sorted(own_m)))) / scale_m
    if by_order > IN_ORDER or by_sample < FITS_BETTER * by_order:
        return None
    return _by_hand(
        f"{what} under the ids of other samples: sample by sample their {lengths} are "
        f"{by_sample:.0%} off {own}, and in order of length {by_order:.0%}",
        WITH_ITS_ID,
    )


def _edited_mend(sources: Tracks, edited: Tracks, plausibility: PlausibilitySection) -> Mend | None:
    """Detect edited trajectories in another frame, or of other samples, than their source ones.

    Decided by the first waypoint: no braking and no swerve moves it far.
    """
    at_edit, at_source = next(edited.steps), next(sources.steps)
    is_moving = [length_m > plausibility.stationary_below_m for length_m in at_source.length_m]
    if sum(is_moving) < MIN_COMPARED:
        return None
    own, at = (
        Steps(*(_evenly_chosen(list(compress(column, is_moving))) for column in step))
        for step in (at_edit, at_source)
    )
    scale_m = statistics.median(at.length_m)

    def off(x_m: Iterable[float], y_m: Iterable[float]) -> float:
        gaps_m = map(math.hypot, map(sub, x_m, at.x_m), map(sub, y_m, at.y_m))
        return statistics.median(gaps_m) / scale_m

    error = off(own.x_m, own.y_m)
    if error > FITS:
        left, back = list(map(neg, own.y_m)), list(map(neg, own.x_m))
        turned = (off(left, own.x_m), off(back, left), off(own.y_m, back))
        if min(turned) <= min(FITS, error / FITS_BETTER):
            return _by_hand(
                "edited trajectories in another frame than the source ones",
                "write both with x forward and y left",
            )
    return _id_mend(
        at_edit.length_m,
        at_source.length_m,
        what="edited trajectories",
        lengths="first steps",
        own="those of the source ones",
    )


def _first_points(points: Iterable[Sequence[float] | None]) -> tuple[Column, Column]:
    """Return x and y of the first point of each, NaN where there is none."""
    firsts = [_ABSENT if point is None else (point[0], point[1]) for point in points]
    x_m, y_m = zip(*firsts, strict=True)
    return x_m, y_m


_ABSENT = (math.nan, math.nan)


def _nearer_neighbour(
    own: tuple[Column, Column], answers: tuple[Column, Column]
) -> tuple[float, str] | None:
    """Return the share of answers that are nearer to a neighbour's drive, and on which side it is.

    Both arguments are first waypoints, x and y, in the order of the file.
    """
    most_farther = (1 - OF_NEIGHBOUR) * len(own[0])
    for step, side in ((1, "behind"), (-1, "before")):
        others = [(*axis[step:], *axis[:step]) for axis in own]
        pairs = (own, others), (answers, own), (answers, others)
        n_nearer = n_farther = 0
        for apart_m, to_own_m, to_other_m in zip(*starmap(_gaps_m, pairs), strict=True):
            if apart_m > ROWS_DIFFER_M and not math.isnan(to_own_m):
                n_nearer += to_other_m < to_own_m
                n_farther += to_other_m >= to_own_m
                if n_farther > most_farther:
                    break  # the share stays too small
        n_told = n_nearer + n_farther
        if n_told >= MIN_COMPARED and n_nearer >= OF_NEIGHBOUR * n_told:
            return n_nearer / n_told, side
    return None


def _gaps_m(points: Sequence[Column], others: Sequence[Column]) -> Iterator[float]:
    """Yield the distances between points and others, each x and y columns."""
    return map(math.hypot, *(map(sub, *axes) for axes in zip(points, others, strict=True)))
