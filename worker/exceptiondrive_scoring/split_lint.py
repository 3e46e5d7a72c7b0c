"""Lint: what makes a scorable split a bad benchmark (docs/building-a-split.md).

These are warnings, not refusals: each may be intended. They are withheld like the split itself:
sample ids stay with the worker and the workshop; other readers get code, sentence and count.

A control is a region that no good driver would heed, so it is judged the other way round. Whether a
car can avoid or reach a region is judged at its recorded speed at t = 0; a sample without a
recorded path gets the benefit of the doubt: the car may creep, and may be fast.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from exceptiondrive_schemas.check.drives import not_driven
from exceptiondrive_schemas.check.tracks import Tracks
from exceptiondrive_schemas.datasheet import NO_RECORDED_DRIVE, SplitWarning
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument
from exceptiondrive_scoring.aliases import BoolArray, FloatArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.clearance import clearance_m
from exceptiondrive_scoring.kinematics import heading_vectors, positions, steps
from exceptiondrive_scoring.region import prepare_regions, signed_area_m2

BRAKE_MPS2 = 6.0
"""Hard braking on a dry road; tyres allow as much lateral acceleration."""
THROTTLE_MPS2 = 3.0
SLOW_MPS, FAST_MPS = 3.0, 20.0
"""Speeds assumed without a recorded path: slow for avoiding the region, fast for reaching it."""
ROAD_REACH_M = 7.0
"""How far to the side a car may pass: two lanes."""
TIGHTEST_TURN_M = 4.0
REACHED_M = 3.5
"""With half a car width, more than half the gap between neighbouring arcs of the fan."""
_BENDS_PER_M = np.geomspace(0.002, 1 / TIGHTEST_TURN_M, 20)
SWERVES_M = (1.0, 2.0, 3.5, 5.0, ROAD_REACH_M)
MISS_M = 3.0
"""A recorded path that keeps more than this distance from a region does not meet it."""
SAME_CORNER_M = 0.01
LARGEST_M2 = 500.0
"""More than any hazard within 3 s covers: a lane is 3.5 m wide. Real ones have up to 42 m2."""
USUAL_FACTOR = 5.0
"""A value this many times above or below the median of its task is unusual."""
LEAST_FOR_USUAL = 10
LEAST_SCENES = 10
"""With under ten scenes, resampling them says little about others."""
MANY_ALIKE = 4
LEAST_EXCHANGED = 3
NEARLY_ALL = 0.95
LEAST_PATH_M = 2.0
"""Progress on a shorter path is undefined, and a control exists for its progress; paths of cars
that hardly move are alike by chance."""
_PLAIN_ID = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._:/@#=+-")


@dataclass(frozen=True)
class LintWarning:
    """One kind of doubt about a split.

    Attributes:
        code: Stable name.
        what: Sentence about the samples; it reveals no value of one.
        count: Number of samples concerned (of `small_cells`: families and tasks).
        sample_ids: Their ids, sorted; withheld.
    """

    code: str
    what: str
    count: int
    sample_ids: tuple[str, ...]

    @property
    def told(self) -> SplitWarning:
        """The part that readers outside worker and workshop get."""
        return SplitWarning(code=self.code, what=self.what, count=self.count)


@dataclass(frozen=True)
class LintedSplit:
    """The input of lint; arrays in the order of the sample ids.

    `is_control`, (N,), marks regions that no good driver would heed.
    """

    sample_ids: Sequence[str]
    arrays: SplitArrays
    is_control: BoolArray

    def ids_of(self, which: BoolArray) -> tuple[str, ...]:
        """Ids of some samples, sorted."""
        return tuple(sorted(compress(self.sample_ids, which)))

    @property
    def has_recorded(self) -> BoolArray:
        """Whether a sample has a recorded path, (N,)."""
        if self.arrays.recorded_m is None:
            return np.zeros(len(self.sample_ids), dtype=np.bool_)
        given: BoolArray = ~np.isnan(self.arrays.recorded_m[:, 0, 0])
        return given


def lint(
    split: LintedSplit, protocol: ProtocolDocument, min_samples_per_cell: int = 1
) -> tuple[LintWarning, ...]:
    """Return all warnings about a scorable split, in a fixed order.

    The split holds all samples that are not withdrawn; regions are finite, simple and clear of the
    footprint at t = 0. Cells below the split's floor, or below that of the protocol, are small.
    """
    arrays, geometry = split.arrays, protocol.geometry
    counted, scene, task = ~split.is_control, arrays.scene_index, arrays.task_index
    drives = _Drives(split, geometry)
    drives_wrong = _not_driven(split, protocol)
    still_m, recorded_m = drives.clearance_m(drives.standing()), drives.of_recorded_m()

    def found(code: str, what: str, which: BoolArray) -> Iterator[LintWarning]:
        ids = split.ids_of(which)
        if ids:
            yield LintWarning(code, what, len(ids), ids)

    def everything(code: str, what: str, is_so: bool) -> Iterator[LintWarning]:
        yield from found(code, what, counted & is_so)

    front_m = geometry.footprint_centre_ahead_m + geometry.footprint_length_m / 2
    behind = counted & (arrays.regions_m[..., 0].max(axis=1) <= front_m)
    away = ~drives.reaches() & counted & ~behind
    area_m2 = np.abs(signed_area_m2(arrays.regions_m))
    distance_m = np.linalg.norm(arrays.regions_m.mean(axis=1), axis=-1)
    suffices = counted & (still_m >= arrays.d_safe_m)
    n_controls, enough = int(split.is_control.sum()), protocol.plausibility.flag_family_min_samples
    nearly_all = suffices.sum() >= NEARLY_ALL * counted.sum() and n_controls < enough
    return (
        *found(
            "odd_sample_id",
            "the sample id holds blanks or signs that pages, shells and tables read otherwise",
            np.array([not _PLAIN_ID.issuperset(sample_id) for sample_id in split.sample_ids]),
        ),
        *found(
            "repeated_corner",
            "two corners of the region are the same: a triangle, or a corner was lost",
            _repeats_a_corner(arrays.regions_m),
        ),
        *found(
            "one_region_in_many_samples",
            f"the same region stands in samples of several scenes, or in {MANY_ALIKE} or more",
            _same_in_many(arrays.regions_m, scene),
        ),
        *found(
            "recorded_not_drivable",
            "no car makes the recorded path: it sets off aside or backwards, or is too fast, too sharp or "
            "too sudden; planners that plan well would be called off course",
            drives_wrong,
        ),
        *found(
            "one_drive_in_several_scenes",
            "the same recorded path stands in samples of several scenes: one scene under several names "
            "counts as often, and intervals are too narrow",
            _same_drive(drives, scene),
        ),
        *found(
            "x_and_y_exchanged",
            "the region lies aside, and ahead once x and y are exchanged",
            _x_y_exchanged(drives, recorded_m),
        ),
        *found(
            "behind_the_car",
            "no corner of the region lies ahead of the front bumper",
            behind,
        ),
        *found(
            "out_of_reach",
            f"no car gets to the region within {geometry.horizon_s:g} s: any answer scores full",
            away,
        ),
        *found(
            "unavoidable",
            f"no moving car avoids the region, neither stopping at {BRAKE_MPS2:g} m/s2 nor passing "
            f"up to {ROAD_REACH_M:g} m aside",
            ~drives.avoids() & counted,
        ),
        *found(
            "within_d_safe_of_the_start",
            "the region lies within d_safe of the car at t = 0: no answer scores full",
            counted & (still_m < arrays.d_safe_m),
        ),
        *found(
            "recorded_path_misses",
            f"the recorded path keeps more than {MISS_M:g} m and d_safe from the region: who "
            "ignores it scores full",
            (recorded_m > np.maximum(MISS_M, arrays.d_safe_m))
            & (counted & ~behind & ~away & ~drives_wrong),
        ),
        *found(
            "unusual_area",
            f"the area of the region is over {LARGEST_M2:g} m2, or over {USUAL_FACTOR:g} times, or under "
            f"1/{USUAL_FACTOR:g} of, the task's median",
            _far_from_usual(area_m2, task, counted) | (counted & (area_m2 > LARGEST_M2)),
        ),
        *found(
            "unusual_distance",
            f"the distance of the region is over {USUAL_FACTOR:g} times, or under "
            f"1/{USUAL_FACTOR:g} of, the task's median",
            _far_from_usual(distance_m, task, counted),
        ),
        *found(
            "control_in_the_way",
            "a control, which no good driver would heed, lies within d_safe of the recorded path "
            "(without one: of the way straight ahead)",
            split.is_control & (drives.unheeding_m(recorded_m) < arrays.d_safe_m),
        ),
        *found(
            "control_of_a_standing_car",
            f"the recorded path of a control is under {LEAST_PATH_M:g} m: it has no "
            "progress, and tells nothing about over-caution",
            split.is_control & (drives.recorded_length_m() < LEAST_PATH_M),
        ),
        *everything(
            "few_scenes",
            f"all samples are of fewer than {LEAST_SCENES} scenes: intervals draw scenes again, "
            "and say little",
            len(np.unique(scene[counted])) < LEAST_SCENES,
        ),
        *everything("one_task", "all samples are of one task", len(np.unique(task[counted])) == 1),
        *_few_scenes_of_a_family(split, protocol),
        *_small_cells(split, protocol, min_samples_per_cell),
        *found(
            "standing_still_suffices",
            "a car that stands still scores full in (nearly) all samples, and only with "
            f"{enough} controls it is told from a careful one; there are {n_controls}",
            suffices & nearly_all,
        ),
        *found(
            NO_RECORDED_DRIVE,
            "nothing compares source trajectories with the drive of the scene, which is not "
            "recorded here: a wrong time step, unit or axis goes unseen. Cure: "
            "exceptiondrive-worker add-drives",
            counted & ~split.has_recorded,
        ),
    )


def _not_driven(split: LintedSplit, protocol: ProtocolDocument) -> BoolArray:
    """Whether a sample has a recorded path that no car can drive, (N,)."""
    wrong = np.zeros(len(split.sample_ids), dtype=np.bool_)
    if split.arrays.recorded_m is not None:
        rows = np.flatnonzero(split.has_recorded)
        paths = split.arrays.recorded_m[rows].reshape(len(rows), -1)
        tracks = Tracks.of(paths.tolist(), protocol.geometry.waypoints)
        wrong[rows[sorted(not_driven(tracks, protocol))]] = True
    return wrong


def _repeats_a_corner(regions_m: FloatArray) -> BoolArray:
    first, second = np.triu_indices(4, k=1)
    apart_m = np.linalg.norm(regions_m[:, first] - regions_m[:, second], axis=-1)
    repeats: BoolArray = apart_m.min(axis=1) < SAME_CORNER_M
    return repeats


def _same_in_many(regions_m: FloatArray, scene_index: IntArray) -> BoolArray:
    """Whether other scenes, or many samples, have the same region (to 1 mm, any corner order)."""
    corners_mm = np.round(regions_m * 1000)
    order = np.lexsort((corners_mm[..., 1], corners_mm[..., 0]))
    n_scenes, n_samples = _numbers_of_same(
        np.take_along_axis(corners_mm, order[..., None], axis=1), scene_index
    )
    many: BoolArray = (n_scenes > 1) | (n_samples >= MANY_ALIKE)
    return many


def _same_drive(drives: "_Drives", scene_index: IntArray) -> BoolArray:
    """Whether other scenes have the same recorded path of a moving car, to the millimetre."""
    moves: BoolArray = drives.recorded_length_m() >= LEAST_PATH_M
    n_scenes, _ = _numbers_of_same(np.round(drives.recorded() * 1000), scene_index)
    return moves & (n_scenes > 1)


def _numbers_of_same(points_mm: FloatArray, scene_index: IntArray) -> tuple[IntArray, IntArray]:
    """Return the numbers of scenes and of samples that have the same points as each sample."""
    rows = points_mm.reshape(len(points_mm), -1)
    _, which, n_samples = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    pairs = np.unique(np.stack([which, scene_index], axis=1), axis=0)
    n_scenes = np.bincount(pairs[:, 0], minlength=len(n_samples))
    return n_scenes[which], n_samples[which]


def _x_y_exchanged(drives: "_Drives", recorded_m: FloatArray) -> BoolArray:
    """Whether x and y look exchanged: by the recorded path, or if most of a group lies to the side.

    A region may well lie more to the side than ahead, in a bend; if those of a whole scene, task or
    split do, the coordinate frame is probably wrong.
    """
    split, arrays = drives.split, drives.split.arrays
    exchanged_m = drives.of_recorded_m(arrays.regions_m[..., ::-1])
    meets_exchanged = (recorded_m > MISS_M) & (exchanged_m <= arrays.d_safe_m)
    centre_m = np.abs(arrays.regions_m.mean(axis=1))
    aside: BoolArray = (centre_m[:, 1] > centre_m[:, 0]) & ~split.is_control
    whole = np.zeros(len(aside), dtype=np.intp)
    mostly = np.zeros_like(aside)
    for group in (whole, arrays.scene_index, arrays.task_index):
        sizes, n_aside = np.bincount(group), np.bincount(group[aside], minlength=group.max() + 1)
        mostly |= ((n_aside >= LEAST_EXCHANGED) & (2 * n_aside > sizes))[group]
    return aside & np.where(split.has_recorded, meets_exchanged, mostly)


def _far_from_usual(values: FloatArray, task_index: IntArray, counted: BoolArray) -> BoolArray:
    far = np.zeros(len(values), dtype=np.bool_)
    for task in np.unique(task_index[counted]):
        rows = np.flatnonzero(counted & (task_index == task))
        if len(rows) >= LEAST_FOR_USUAL:
            ratio = values[rows] / np.median(values[rows])
            far[rows] = (ratio > USUAL_FACTOR) | (ratio < 1 / USUAL_FACTOR)
    return far


def _few_scenes_of_a_family(
    split: LintedSplit, protocol: ProtocolDocument
) -> Iterator[LintWarning]:
    arrays, least = split.arrays, protocol.ranking.min_scenes
    pairs = np.stack([arrays.family_index, arrays.scene_index], axis=1)[~split.is_control]
    n_scenes = np.bincount(np.unique(pairs, axis=0)[:, 0])
    few = np.flatnonzero((n_scenes > 0) & (n_scenes < least))
    ids = split.ids_of(~split.is_control & np.isin(arrays.family_index, few))
    if ids:
        names = ", ".join(protocol.families[family].id for family in few)
        what = (
            f"the family has samples in fewer than {least} scenes: it has no interval, nor has the mean "
            f"of families, and ranks by that have no ranges: {names}"
        )
        yield LintWarning("few_scenes_of_a_family", what, len(ids), ids)


def _small_cells(
    split: LintedSplit, protocol: ProtocolDocument, floor: int
) -> Iterator[LintWarning]:
    """Warn of families and tasks with too few samples to be published, including empty ones."""
    taxonomy, shown_from = protocol.taxonomy, protocol.publication.min_samples_per_cell
    least, withheld = max(floor, shown_from), " of a withheld split" * (floor > shown_from)
    counted, names, rows = ~split.is_control, [], np.zeros(len(split.sample_ids), dtype=np.bool_)
    cells = (
        (taxonomy.families, split.arrays.family_index),
        (taxonomy.tasks, split.arrays.task_index),
    )
    for members, index in cells:
        sizes = np.bincount(index[counted], minlength=len(members))
        for position in np.flatnonzero(sizes < least):
            names.append(members[position].id)
            rows |= counted & (index == position)
    if names:
        what = (
            f"families and tasks with fewer samples than {least}, the least that is published{withheld}: "
            + ", ".join(names)
        )
        yield LintWarning("small_cells", what, len(names), split.ids_of(rows))


class _Drives:
    """What cars can do in the samples of a split; each drive is (N, T + 1, 2) positions."""

    def __init__(self, split: LintedSplit, geometry: GeometrySection) -> None:
        self.split = split
        self._geometry = geometry
        self._regions = prepare_regions(split.arrays.regions_m)
        self._times_s: FloatArray = np.array(range(geometry.waypoints + 1)) * geometry.time_step_s
        first_step_m = np.linalg.norm(self.recorded()[:, 1], axis=-1)
        self._speed_mps = first_step_m / geometry.time_step_s

    def clearance_m(self, points_m: FloatArray) -> FloatArray:
        """Clearance of a drive in every sample, (N,)."""
        return clearance_m(points_m, self._regions, self._geometry)

    def standing(self) -> FloatArray:
        """Return the drive that stands still."""
        return np.zeros((len(self.split.sample_ids), self._geometry.waypoints + 1, 2))

    def recorded(self) -> FloatArray:
        """Return the recorded path; where there is none, the drive that stands still."""
        points_m = self.standing()
        if self.split.arrays.recorded_m is not None:
            points_m[:, 1:] = np.nan_to_num(self.split.arrays.recorded_m)
        return points_m

    def of_recorded_m(self, regions_m: FloatArray | None = None) -> FloatArray:
        """Clearance of the recorded path, from other regions if given; NaN where there is none."""
        regions = self._regions if regions_m is None else prepare_regions(regions_m)
        clearance = clearance_m(self.recorded(), regions, self._geometry)
        return np.where(self.split.has_recorded, clearance, np.nan)

    def recorded_length_m(self) -> FloatArray:
        """Length of the recorded path, (N,); NaN where there is none."""
        steps_m = np.linalg.norm(np.diff(self.recorded(), axis=1), axis=-1)
        return np.where(self.split.has_recorded, steps_m.sum(axis=1), np.nan)

    def unheeding_m(self, recorded_m: FloatArray) -> FloatArray:
        """Clearance of a drive that heeds nothing: the recorded path, else fast straight on."""
        ahead = self.standing()
        ahead[..., 0] = FAST_MPS * self._times_s
        return np.where(self.split.has_recorded, recorded_m, self.clearance_m(ahead))

    def avoids(self) -> BoolArray:
        """Whether a moving car can keep clear of the region."""
        speed_mps = np.where(self.split.has_recorded, self._speed_mps, SLOW_MPS)
        braking_s = np.minimum(self._times_s, speed_mps[:, None] / BRAKE_MPS2)
        stopping_m = speed_mps[:, None] * braking_s - BRAKE_MPS2 * braking_s**2 / 2
        cruising_m = speed_mps[:, None] * self._times_s
        sideways_mps2 = np.minimum(BRAKE_MPS2, speed_mps**2 / TIGHTEST_TURN_M)[:, None]

        def drives() -> Iterator[FloatArray]:
            for road in (_xy_positions, _Road(self.recorded(), self._geometry).positions_m):
                yield road(stopping_m, np.zeros_like(stopping_m))
                for aside_m in SWERVES_M:
                    shift_m = _swerve_m(self._times_s, aside_m, sideways_mps2)
                    yield road(cruising_m, shift_m)
                    yield road(cruising_m, -shift_m)

        return self._is_some_drive(
            drives(), lambda gap_m: gap_m > self._geometry.contact_tolerance_m
        )

    def reaches(self) -> BoolArray:
        """Whether a fan of arcs, each as fast as tyres and engine allow, comes near the region."""
        horizon_s = self._geometry.horizon_s
        speed_mps = np.where(
            self.split.has_recorded, self._speed_mps + THROTTLE_MPS2 * horizon_s / 2, FAST_MPS
        )

        def arcs() -> Iterator[FloatArray]:
            for bend_per_m in np.concatenate([[1e-6], -_BENDS_PER_M, _BENDS_PER_M]):
                gripping_mps = np.sqrt(BRAKE_MPS2 / abs(bend_per_m))
                turn = bend_per_m * np.minimum(speed_mps, gripping_mps)[:, None] * self._times_s
                yield np.stack([np.sin(turn), 1 - np.cos(turn)], axis=-1) / bend_per_m

        return self._is_some_drive(arcs(), lambda gap_m: gap_m <= REACHED_M)

    def _is_some_drive(
        self, drives: Iterator[FloatArray], is_so: Callable[[FloatArray], BoolArray]
    ) -> BoolArray:
        """Whether some drive has such a clearance, (N,); settled samples are not computed again."""
        regions_m = self.split.arrays.regions_m
        some = np.zeros(len(regions_m), dtype=np.bool_)
        for points_m in drives:
            open_ = np.flatnonzero(~some)
            regions = prepare_regions(regions_m[open_])
            some[open_] = is_so(clearance_m(points_m[open_], regions, self._geometry))
        return some


def _xy_positions(along_m: FloatArray, aside_m: FloatArray) -> FloatArray:
    """Positions along the x axis and to its left, (N, T + 1, 2)."""
    return np.stack([along_m, aside_m], axis=-1)


class _Road:
    """A recorded path as a road: maps length along it and distance to its left to positions."""

    def __init__(self, points_m: FloatArray, geometry: GeometrySection) -> None:
        moves = steps(positions(points_m))
        cos, sin = heading_vectors(moves, geometry)
        self._points_m = points_m
        self._ahead = np.stack([cos[1:], sin[1:]], axis=-1).transpose(1, 0, 2)
        self._begin_m = np.zeros(points_m.shape[:2])
        self._begin_m[:, 1:] = np.cumsum(moves.length_m, axis=0).T

    def positions_m(self, along_m: FloatArray, aside_m: FloatArray) -> FloatArray:
        """(N, T + 1, 2); beyond its end the road continues straight."""
        is_past = along_m[:, :, None] >= self._begin_m[:, None, 1:]
        segment = np.minimum(is_past.sum(axis=2), self._ahead.shape[1] - 1)
        rest_m = along_m - np.take_along_axis(self._begin_m, segment, axis=1)
        begin, ahead = (
            np.take_along_axis(of_segment, segment[..., None], axis=1)
            for of_segment in (self._points_m, self._ahead)
        )
        left = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
        at_m: FloatArray = begin + rest_m[..., None] * ahead + aside_m[..., None] * left
        return at_m


def _swerve_m(times_s: FloatArray, aside_m: float, sideways_mps2: FloatArray) -> FloatArray:
    """Lateral position of a car that swerves as fast as it can and stays there, (N, T + 1)."""
    sideways_mps2 = np.maximum(sideways_mps2, 1e-6)  # a standing car never gets there
    half_s = np.sqrt(aside_m / sideways_mps2)
    left_s = np.maximum(2 * half_s - times_s, 0.0)
    out = sideways_mps2 * times_s**2 / 2
    back = aside_m - sideways_mps2 * left_s**2 / 2
    return np.where(times_s < half_s, out, back)
