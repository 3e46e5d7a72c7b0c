"""Rules for `exceptiondrive.planning/1`: trajectories, and the frame (docs/protocol.md 1, 5)."""

from __future__ import annotations  # array[float] is no runtime type before 3.12

import math
import statistics
from array import array
from collections.abc import Mapping
from typing import Any, ClassVar

from exceptiondrive_schemas.check.answers import PlanningDocument, TrajectoryPair
from exceptiondrive_schemas.check.fault_list import FaultList, Path, kind, shown
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import PlausibilitySection, ProtocolDocument

QUARTER_TURN_RAD = math.pi / 2


class FrameCheck:
    """Directions of net motion of the source trajectories that move at all."""

    def __init__(self, plausibility: PlausibilitySection) -> None:
        self._rules = plausibility
        self._angles_rad = array("d")

    def note(self, end_x_m: float, end_y_m: float) -> None:
        """Take the last waypoint of one source trajectory into account."""
        if end_x_m * end_x_m + end_y_m * end_y_m > self._rules.frame_check_min_motion_m**2:
            self._angles_rad.append(math.atan2(end_y_m, end_x_m))

    def finish(self, faults: FaultList) -> None:
        """Refuse the file where the median |angle to +x| is too large."""
        if len(self._angles_rad) < self._rules.frame_check_min_samples:
            return
        median_deg = math.degrees(statistics.median(abs(angle) for angle in self._angles_rad))
        if median_deg <= self._rules.frame_check_max_angle_deg:
            return
        verdict = frame_verdict(self._angles_rad)
        faults.add(
            FaultCode.WRONG_FRAME,
            ("predictions",),
            expected=f"a median angle to +x of at most {self._rules.frame_check_max_angle_deg:g} "
            "degrees over the source trajectories that move",
            got=f"{median_deg:.1f} degrees over {len(self._angles_rad):,} source trajectories",
            hint=verdict,
        )
        faults.say(FaultCode.WRONG_FRAME, f"The trajectories are not in the ego frame: {verdict}.")


def frame_verdict(angles_rad: array[float]) -> str:
    """Say which wrong frame the directions of motion fit best, and how to convert.

    Args:
        angles_rad: Directions of net motion in the file's own axes, in [-pi, pi].
    """
    n_along = [0, 0, 0, 0]
    for angle_rad in angles_rad:
        n_along[round(angle_rad / QUARTER_TURN_RAD) % 4] += 1
    return FRAME_VERDICTS[n_along.index(max(n_along))]


FRAME_VERDICTS = (
    "most motion is along +x, but it scatters too much for driving: start each one at heading 0",
    "looks like x right / y forward: swap to (y, -x)",
    "most motion is along -x: looks like x backward; turn it round to (-x, -y)",
    "most motion is along -y: looks like y backward; turn it to (-y, x)",
)
"""Verdicts for motion along +x, +y, -x, -y."""


NUMBERS = (float, int)


class PlanningRules:
    """Checks source and edited trajectories, and the frame over the whole file."""

    required_keys: ClassVar = frozenset({"sample_id", "source", "edited"})
    optional_keys: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, protocol: ProtocolDocument, faults: FaultList) -> None:
        self._geometry = protocol.geometry
        self._faults = faults
        self._frame = FrameCheck(protocol.plausibility)
        self._n_missing = {"source": 0, "edited": 0}

    def answer(self, prediction: dict[str, Any], path: Path, sample_id: str | None) -> Any:
        """Check the trajectories of one prediction and return them."""
        pair = TrajectoryPair(
            *(
                self._trajectory(prediction.get(key), (*path, key), sample_id)
                for key in ("source", "edited")
            )
        )
        if pair.source is not None and len(pair.source) == 2 * self._geometry.waypoints:
            self._frame.note(pair.source[-2], pair.source[-1])
        for key, trajectory in zip(self._n_missing, pair, strict=True):
            self._n_missing[key] += trajectory is None
        return pair

    def finish(self) -> None:
        """Check what can be told only over all predictions."""
        self._frame.finish(self._faults)

    def notes(self, n_predictions: int) -> tuple[str, ...]:
        """Say what a sound file leaves out, and what that costs."""
        costs = {"source": "its shift is undefined", "edited": "it counts as unsafe"}
        return tuple(
            f"{key} is null for {self._n_missing[key]:,} of {n_predictions:,} samples: "
            f"for each, {cost}"
            for key, cost in costs.items()
            if self._n_missing[key]
        )

    def document(self, split: str, answers: Mapping[str, Any]) -> PlanningDocument:
        """Return the sound file."""
        return PlanningDocument(split, answers, self._geometry.waypoints)

    def _trajectory(self, value: Any, path: Path, sample_id: str | None) -> array[float] | None:
        if value is None:
            return None
        if not isinstance(value, list):
            self._refuse(FaultCode.WRONG_TYPE, path, self._form, kind(value), sample_id)
            return None
        if value and all(type(each) in NUMBERS for each in value):
            got = f"one flat list of {counted(len(value), 'number')}"
            self._refuse(FaultCode.WRONG_WAYPOINT_SHAPE, path, self._form, got, sample_id)
            return None
        return self._waypoints(value, path, sample_id)

    def _waypoints(self, value: list[Any], path: Path, sample_id: str | None) -> array[float]:
        flat = array("d")
        previous: tuple[float, float] | None = (0.0, 0.0)
        for t, waypoint in enumerate(value[: self._geometry.waypoints]):
            point = self._waypoint(waypoint, (*path, t), sample_id)
            if point is not None:
                flat.extend(point)
                if previous is not None:
                    self._check_step(previous, point, (*path, t), sample_id)
            previous = point
        if len(value) != self._geometry.waypoints:
            self._refuse_count(value, path, sample_id)
        return flat

    def _waypoint(
        self, value: Any, path: Path, sample_id: str | None
    ) -> tuple[float, float] | None:
        if type(value) is not list or len(value) != 2:
            hint = "write x and y alone, without heading, z or time" if _is_longer(value) else None
            self._refuse(
                FaultCode.WRONG_WAYPOINT_SHAPE, path, "[x, y]", shown(value), sample_id, hint
            )
            return None
        x, y = value
        x_is_sound = self._is_sound(x, path, 0, sample_id)
        y_is_sound = self._is_sound(y, path, 1, sample_id)
        return (x + 0.0, y + 0.0) if x_is_sound and y_is_sound else None

    def _is_sound(self, value: Any, path: Path, axis: int, sample_id: str | None) -> bool:
        bound_m = self._geometry.max_coordinate_m
        if type(value) in NUMBERS:
            if -bound_m <= value <= bound_m:
                return True
            if math.isfinite(value):
                code, expected = FaultCode.OUT_OF_BOUNDS, f"at most {bound_m:g} m either way"
            else:
                code, expected = FaultCode.NON_FINITE, "a finite number"
        else:
            code, expected = FaultCode.WRONG_TYPE, "a number"
        self._refuse(code, (*path, axis), expected, shown(value), sample_id)
        return False

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

    def _refuse_count(self, value: list[Any], path: Path, sample_id: str | None) -> None:
        starts_at_origin = len(value) == self._geometry.waypoints + 1 and value[0] == [0, 0]
        hint = "leave out (0, 0) at t = 0; it is put in front for you" if starts_at_origin else None
        expected = counted(self._geometry.waypoints, "waypoint")
        got = counted(len(value), "waypoint")
        self._refuse(FaultCode.WRONG_WAYPOINT_COUNT, path, expected, got, sample_id, hint)

    @property
    def _form(self) -> str:
        return f"[[x, y] x {self._geometry.waypoints}] or null"

    def _refuse(
        self,
        code: FaultCode,
        path: Path,
        expected: str,
        got: str,
        sample_id: str | None,
        hint: str | None = None,
    ) -> None:
        self._faults.add(code, path, expected=expected, got=got, sample_id=sample_id, hint=hint)


def _is_longer(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 2
