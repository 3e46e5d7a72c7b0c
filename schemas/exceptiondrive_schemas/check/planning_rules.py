"""Rules for `exceptiondrive.planning/1`: trajectories (docs/protocol.md 1)."""

from __future__ import annotations  # array[float] is not subscriptable at runtime before 3.12

import math
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check.answers import (
    PairsOfColumns,
    PlanningDocument,
    TrajectoryPair,
)
from exceptiondrive_schemas.check.fault_list import FaultList, Path, kind, shown
from exceptiondrive_schemas.check.frame import FrameCheck
from exceptiondrive_schemas.check.motion import motion_flags, wrong_first_steps
from exceptiondrive_schemas.check.planning_columns import PlanningColumns
from exceptiondrive_schemas.check.source_fit import AT_ORIGIN_M, file_profile
from exceptiondrive_schemas.check.tracks import PairTracks, Tracks
from exceptiondrive_schemas.check.trajectory_forms import (
    is_null_word,
    is_number,
    number_in,
    point_in,
)
from exceptiondrive_schemas.coverage import too_little_covered
from exceptiondrive_schemas.faults import MESSAGES, FaultCode
from exceptiondrive_schemas.file_profile import CONVERT, FileProfile
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.printable import counted, share_past
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest

NUMBERS = (float, int)
_RUN_BOTH = (
    "run it on both; `exceptiondrive convert --source-run FILE --edited-run FILE` makes a submission "
    "of two runs"
)
SIDES_MISSING: Mapping[str, str] = {
    "source": f"what the planner answered to the scene as it was recorded: {_RUN_BOTH}",
    "edited": f"what the planner answered to the edited scene: {_RUN_BOTH}",
}
"""What is missing and how to get it, if a whole file lacks one side of its pairs."""
FARTHEST_M = 1e9
"""Farther than any coordinate on earth: such a number cannot be explained."""
STEP_MARGIN = 1e-9
"""Steps this close to the longest allowed one are left to the exact test of `_check_step`."""


class PlanningRules:
    """Checks source and edited trajectories, and the frame over the whole file."""

    required_keys: ClassVar = frozenset({"sample_id", "source", "edited"})
    optional_keys: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, protocol: ProtocolDocument, faults: FaultList) -> None:
        self._protocol = protocol
        self._geometry = protocol.geometry
        self._faults = faults
        self._refuse = faults.add
        self._sources: list[array[float]] = []
        self._n_missing = {"source": 0, "edited": 0}
        self._n_trajectories = 0
        self._tracks: PairTracks | None = None
        self._wrong_counts: Counter[int] = Counter()
        self._columns: Counter[str] = Counter()

    def answer(self, prediction: dict[str, Any], path: Path, sample_id: str | None) -> Any:
        """Check the trajectories of one prediction and return them."""
        pair = TrajectoryPair(
            *(
                self._trajectory(prediction.get(key), (*path, key), sample_id)
                for key in ("source", "edited")
            )
        )
        if pair.source is not None and len(pair.source) == 2 * self._geometry.waypoints:
            self._sources.append(pair.source)
        for key, trajectory in zip(self._n_missing, pair, strict=True):
            self._n_missing[key] += trajectory is None
        return pair

    def take(self, columns: PlanningColumns) -> Mapping[str, TrajectoryPair] | None:
        """Take all predictions of a file at once; None, and none, if one may be out of bounds."""
        n_waypoints, sides = self._geometry.waypoints, (columns.source, columns.edited)
        source, edited = (_flat_array(side.numbers) for side in sides)
        answers: Mapping[str, TrajectoryPair]
        if all(all(side.is_given) for side in sides):
            answers = PairsOfColumns(columns.sample_ids, source, edited, n_waypoints)
            tracks = PairTracks(
                Tracks.cut(source, n_waypoints), Tracks.cut(edited, n_waypoints), len(answers)
            )
        else:
            sources = _trajectories(columns.source.is_given, source, 2 * n_waypoints)
            edits = _trajectories(columns.edited.is_given, edited, 2 * n_waypoints)
            answers = dict(
                zip(columns.sample_ids, map(TrajectoryPair, sources, edits), strict=True)
            )
            tracks = PairTracks.of(answers.values(), n_waypoints)
        if not (self._is_within_bounds(tracks.source) and self._is_within_bounds(tracks.edited)):
            return None
        self._tracks = tracks
        for key, side in zip(self._n_missing, sides, strict=True):
            self._n_missing[key] = side.is_given.count(False)
        return answers

    def _is_within_bounds(self, tracks: Tracks) -> bool:
        """Whether certainly no coordinate and no step is too large."""
        if not tracks.n:
            return True
        longest_m, margin = max(map(max, tracks.step_lengths_m)), 1 - STEP_MARGIN
        most_m = self._geometry.max_coordinate_m
        is_near = longest_m * len(tracks.step_lengths_m) < most_m * margin  # no path reaches it
        columns = () if is_near else (*tracks.x_m, *tracks.y_m)
        return longest_m < self._geometry.max_step_m * margin and all(
            -most_m <= min(column) and max(column) <= most_m for column in columns
        )

    def finish(self, answers: Mapping[str, Any], manifest: Manifest | None) -> FileProfile | None:
        """Run the checks over all predictions; return the profile of the file."""
        n_waypoints, tracks = self._geometry.waypoints, self._tracks
        if tracks is None and self._faults.is_empty:  # all are complete
            tracks = self._tracks = PairTracks.of(answers.values(), n_waypoints)
        sources = tracks.source if tracks else Tracks.of(self._sources, n_waypoints)
        frame = FrameCheck(sources, self._protocol)
        profile = file_profile(
            answers,
            self._geometry,
            self._protocol.plausibility,
            manifest.drives(self._geometry) if manifest and frame.is_of_the_car else None,
            self._n_given,
            tracks,
        )
        frame.finish(self._faults, profile)
        if self._n_given is not None:
            mend = profile.mend if profile else None
            advice = mend.sentence if mend else self._time_step_advice(self._n_given)
            message = MESSAGES[FaultCode.WRONG_WAYPOINT_COUNT]
            self._faults.say(FaultCode.WRONG_WAYPOINT_COUNT, f"{message} {advice}")
        if self._columns["camera"] > self._columns["ego"]:
            code = FaultCode.WRONG_WAYPOINT_SHAPE
            self._faults.advise(code, COLUMNS_HINT, CAMERA_HINT)
            self._faults.say(code, f"{MESSAGES[code]} The file {CAMERA_HINT}.")
        return profile

    def _time_step_advice(self, n_given: int) -> str:
        """Say what another number of waypoints in most trajectories may mean."""
        step_s, horizon_s = self._geometry.time_step_s, self._geometry.horizon_s
        if n_given > self._geometry.waypoints:
            return (
                f"A finer time step or a longer horizon? {CONVERT} --time-step-s S --truncate`, S the "
                f"planner's own, keeps those {step_s:g} s apart up to {horizon_s:g} s."
            )
        return (
            f"A coarser time step? {CONVERT} --time-step-s S`, S the planner's own, reads those "
            f"{step_s:g} s apart off straight lines, if they reach {horizon_s:g} s."
        )

    @property
    def _n_given(self) -> int | None:
        """Number of waypoints in most trajectories, if it is not the required one."""
        n_right = self._n_trajectories - self._wrong_counts.total()
        ((n_given, n_wrong),) = self._wrong_counts.most_common(1) or ((0, 0),)
        return n_given if n_wrong > n_right else None

    def notes(self, n_predictions: int, profile: FileProfile | None) -> tuple[str, ...]:
        """Say what a sound file leaves out, what that costs, and whether it is flagged as blind."""
        costs = {"source": "its shift is undefined", "edited": "it counts as unsafe"}
        missing = (
            f"{key} is null for {self._n_missing[key]:,} of {n_predictions:,} samples: "
            f"for each, {cost}"
            if self._n_missing[key] < n_predictions
            else f"{key} is null for every sample. It is {SIDES_MISSING[key]}."
            for key, cost in costs.items()
            if self._n_missing[key]
        )
        blind = (
            f"it will be flagged {FLAGS[code].label}: {why}"
            for code, why in self._blind_flag(profile)
            if code not in self._protocol.ranking.unranked_flags
        )
        return *missing, *self._zero_warnings(n_predictions), *blind

    def _zero_warnings(self, n_predictions: int) -> Iterator[str]:
        """Warn of zeros that may mean no answer: the car was too fast to stand still at once."""
        if self._tracks is None:
            return
        source, edited, n_both = self._tracks
        lengths_m, firsts_m = edited.lengths_m[:n_both], source.step_lengths_m[0][:n_both]
        sources_m = [first for first, length in zip(firsts_m, lengths_m, strict=True) if not length]
        n_zeros = len(wrong_first_steps(sources_m, [0.0] * len(sources_m), self._protocol))
        if n_zeros:
            yield (
                f"edited is all zeros for {n_zeros:,} of {n_predictions:,} samples, though the car is "
                "too fast there to stand at once: where the planner gave nothing, write null"
            )

    def unranked_because(self, n_predictions: int, profile: FileProfile | None) -> str | None:
        """Say why a sound file would be scored but not ranked; None if nothing shows that."""
        ranking = self._protocol.ranking
        shares = {
            key: 1 - self._n_missing[key] / max(n_predictions, 1) for key in ("edited", "source")
        }
        reasons = [too_little_covered(PLANNING.words.covered, shares, ranking.min_coverage)]
        if ranking.unranked_flags and all(shares.values()):
            for code, why in self._file_flags(n_predictions, profile, shares):
                if code in ranking.unranked_flags:
                    reasons.append(f"flagged {FLAGS[code].label}: {why}")
        return "; ".join(filter(None, reasons)) or None

    def _file_flags(
        self, n_predictions: int, profile: FileProfile | None, shares: Mapping[str, float]
    ) -> Iterator[tuple[str, str]]:
        """Yield the flags of a file that need no regions, and why (docs/protocol.md 5).

        Shares are over all samples: a missing trajectory counts as one that stands still.
        """
        if profile is None or self._tracks is None:
            return
        section = self._protocol.plausibility
        edited = 1 - shares["edited"] * (1 - (profile.standing_edited or 0.0))
        source = 1 - shares["source"] * (1 - (profile.standing_sources or 0.0))
        if edited - source > section.flag_edited_stationary_excess:
            are = "are missing or stand still" if shares["edited"] < 1 else "stand still"
            text = f"{edited:.0%} of the edited trajectories {are}, of the source {source:.0%}"
            yield "stands_still", text
        if source > section.flag_source_stationary:
            are = "are missing or stand still" if shares["source"] < 1 else "stand still"
            share = share_past(source, section.flag_source_stationary)
            yield "source_stands_still", f"{share} of the source trajectories {are}"
        yield from self._blind_flag(profile)
        yield from motion_flags(self._tracks, n_predictions, self._protocol)
        same = profile.same_edited or 0.0
        if same > section.flag_same_answer:
            share = share_past(same, section.flag_same_answer)
            yield "same_answer", f"{share} of the edited trajectories are the same"
        median_m = profile.median_source_l2_m
        if median_m is not None and median_m > section.flag_off_course_m:
            yield "off_course", f"median source L2 {median_m:.2f} m"

    def _blind_flag(self, profile: FileProfile | None) -> Iterator[tuple[str, str]]:
        """Yield the flag of a file whose pairs are nearly all equal, and why."""
        equal = 0.0 if profile is None else profile.equal_pairs or 0.0
        most = self._protocol.plausibility.flag_blind
        if equal > most:
            share = share_past(equal, most)
            yield (
                "blind_to_the_edit",
                f"source and edited are alike in {share} of the pairs: it reacts to no hazard",
            )

    def document(self, split: str, answers: Mapping[str, Any]) -> PlanningDocument:
        """Return the sound file."""
        return PlanningDocument(split, answers, self._geometry.waypoints)

    def _trajectory(self, value: Any, path: Path, sample_id: str | None) -> array[float] | None:
        if value is None:
            return None
        sound = self._sound_trajectory(value)
        if sound is not None:
            return sound
        if not isinstance(value, list):
            is_null = is_null_word(value)
            got = shown(value) if is_null else kind(value)
            advice = NULL_WORD_HINT if is_null else None
            self._refuse(FaultCode.WRONG_TYPE, path, self._trajectory_form, got, sample_id, advice)
            return None
        if value and all(type(each) in NUMBERS for each in value):
            got = f"one flat list of {counted(len(value), 'number')}"
            self._refuse(
                FaultCode.WRONG_WAYPOINT_SHAPE, path, self._trajectory_form, got, sample_id
            )
            return None
        if value and all(map(_is_trajectory, value)):
            got = f"a list of {counted(len(value), 'trajectory', 'trajectories')}"
            hint = f"write one trajectory, not several modes; {CONVERT} --mode 0` takes the first"
            self._refuse(
                FaultCode.WRONG_WAYPOINT_SHAPE, path, self._trajectory_form, got, sample_id, hint
            )
            return None
        return self._waypoints(value, path, sample_id)

    def _sound_trajectory(self, value: Any) -> array[float] | None:
        """Return a trajectory without a fault; None if its points must be checked one by one."""
        if type(value) is not list or len(value) != self._geometry.waypoints:
            return None
        bound_m, longest_m2 = self._geometry.max_coordinate_m, self._geometry.max_step_m**2
        flat, before_x, before_y = array("d"), 0.0, 0.0
        for point in value:
            if type(point) is not list or len(point) != 2:
                return None
            x, y = point
            if type(x) not in NUMBERS or type(y) not in NUMBERS:
                return None
            if not (-bound_m <= x <= bound_m and -bound_m <= y <= bound_m):
                return None
            if (x - before_x) ** 2 + (y - before_y) ** 2 > longest_m2:
                return None
            flat.extend((x + 0.0, y + 0.0))
            before_x, before_y = x, y
        self._n_trajectories += 1
        return flat

    def _waypoints(self, value: list[Any], path: Path, sample_id: str | None) -> array[float]:
        """Return the finite points unchanged, so that a cause of many faults can be found."""
        self._note_columns(value)
        flat = array("d")
        previous: tuple[float, float] | None = (0.0, 0.0)
        start = 1 if len(value) > self._geometry.waypoints and _is_origin(value[0]) else 0
        n_read = start + self._geometry.waypoints
        for t, waypoint in enumerate(value[start:n_read], start):
            point = self._waypoint(waypoint, (*path, t), sample_id)
            if point is None:
                previous = None
                continue
            flat.extend(point)
            is_within = max(map(abs, point)) <= self._geometry.max_coordinate_m
            if previous is not None and is_within:
                self._check_step(previous, point, (*path, t), sample_id)
            previous = point if is_within else None
        self._n_trajectories += 1
        if len(value) != self._geometry.waypoints:
            self._refuse_count(value, path, sample_id, has_start=start > 0)
        return flat

    def _note_columns(self, value: list[Any]) -> None:
        """Note whether waypoints of three columns advance in the last one or in another."""
        if not value or not all(_is_row_of_three(value[end]) for end in (0, -1)):
            return
        *others, depth_m = (
            abs(end - start) for start, end in zip(value[0], value[-1], strict=True)
        )
        if max(*others, depth_m) > CLEARLY_MOVES_M:
            self._columns["camera" if depth_m > max(others) else "ego"] += 1

    def _waypoint(
        self, value: Any, path: Path, sample_id: str | None
    ) -> tuple[float, float] | None:
        if type(value) is not list or len(value) != 2:
            self._refuse(
                FaultCode.WRONG_WAYPOINT_SHAPE,
                path,
                "[x, y]",
                shown(value),
                sample_id,
                _shape_hint(value),
            )
            return None
        x, y = value
        x_is_finite = self._is_finite(x, path, 0, sample_id)
        y_is_finite = self._is_finite(y, path, 1, sample_id)
        return (x + 0.0, y + 0.0) if x_is_finite and y_is_finite else None

    def _is_finite(self, value: Any, path: Path, axis: int, sample_id: str | None) -> bool:
        """Refuse what is no finite number, or out of bounds; return whether it may be on earth."""
        bound_m = self._geometry.max_coordinate_m
        hint = None
        if type(value) in NUMBERS:
            if -bound_m <= value <= bound_m:
                return True
            if math.isfinite(value):
                code, expected = FaultCode.OUT_OF_BOUNDS, f"at most {bound_m:g} m either way"
            else:
                code, expected = FaultCode.NON_FINITE, "a finite number"
        else:
            code, expected = FaultCode.WRONG_TYPE, "a number"
            hint = _number_hint(value)
        self._refuse(code, (*path, axis), expected, shown(value), sample_id, hint)
        return code is FaultCode.OUT_OF_BOUNDS and abs(value) <= FARTHEST_M

    def _check_step(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        path: Path,
        sample_id: str | None,
    ) -> None:
        step_x_m, step_y_m = end[0] - start[0], end[1] - start[1]
        if step_x_m * step_x_m + step_y_m * step_y_m > self._geometry.max_step_m**2:
            limit_mps = self._geometry.max_step_m / self._geometry.time_step_s
            expected = f"a step of at most {self._geometry.max_step_m:g} m ({limit_mps:g} m/s)"
            got = f"{math.hypot(step_x_m, step_y_m):.2f} m"
            self._refuse(FaultCode.STEP_TOO_LONG, path, expected, got, sample_id)

    def _refuse_count(
        self, value: list[Any], path: Path, sample_id: str | None, *, has_start: bool
    ) -> None:
        n_given = len(value) - has_start
        self._wrong_counts[n_given] += n_given != self._geometry.waypoints
        hint = None
        if n_given == self._geometry.waypoints:
            hint = f"leave out (0, 0) at t = 0; it is put in front for you, {CONVERT}` does"
        elif not value:
            hint = NULL_HINT
        expected = counted(self._geometry.waypoints, "waypoint")
        got = counted(len(value), "waypoint")
        self._refuse(FaultCode.WRONG_WAYPOINT_COUNT, path, expected, got, sample_id, hint)

    @property
    def _trajectory_form(self) -> str:
        return f"[[x, y] x {self._geometry.waypoints}] or null"


NULL_HINT = (
    "null stands for the whole trajectory: write it in place of the list of waypoints "
    f"({CONVERT} --null-invalid` does)"
)
NULL_WORD_HINT = f"null stands without quotes: {CONVERT}` writes it so"
COLUMNS_HINT = f"write x and y alone, without heading, z or time; {CONVERT}` does"
CAMERA_HINT = f"looks like camera coordinates (x right, y down, z ahead): {CONVERT} --camera`"
CLEARLY_MOVES_M = 5.0
"""Farther than a column of times, headings or heights changes in a few seconds."""


_NEGATIVE_ZERO = array("d", [-0.0]).tobytes()


def _flat_array(numbers: Sequence[float]) -> array[float]:
    """Return an array without negative zeros."""
    flat = array("d", numbers)
    as_bytes, size, at = flat.tobytes(), flat.itemsize, -1
    while (at := as_bytes.find(_NEGATIVE_ZERO, at + 1)) >= 0:
        if at % size == 0:  # otherwise it spans two numbers
            flat[at // size] = 0.0
    return flat


def _trajectories(
    is_given: Sequence[bool], flat: array[float], width: int
) -> list[array[float] | None]:
    """Return N flat trajectories, None for null."""
    given = (flat[start : start + width] for start in range(0, len(flat), width))
    return [next(given) if is_there else None for is_there in is_given]


def _is_row_of_three(point: Any) -> bool:
    return isinstance(point, list) and len(point) == 3 and all(map(is_number, point))


def _is_origin(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) >= 2
        and all(type(each) in NUMBERS for each in value[:2])
        and math.hypot(*value[:2]) <= AT_ORIGIN_M
    )


def _number_hint(value: Any) -> str | None:
    if value is None:
        return NULL_HINT
    number = number_in(value)
    if number is None:
        return None
    return f"without quotes; {CONVERT}` does" if math.isfinite(number) else NULL_HINT


def _shape_hint(value: Any) -> str | None:
    if value is None:
        return NULL_HINT
    if point_in(value) is not None:
        return f"write [x, y]; {CONVERT}` does"
    if isinstance(value, list) and len(value) > 2:
        return COLUMNS_HINT
    return None


def _is_trajectory(value: Any) -> bool:
    """Whether it is a list of points in place of one point."""
    return isinstance(value, list) and bool(value) and all(isinstance(each, list) for each in value)
