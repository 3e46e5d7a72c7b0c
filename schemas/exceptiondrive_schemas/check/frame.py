"""Whether trajectories are in the ego frame, in metres: one verdict over a whole file.

Only source trajectories are looked at (docs/protocol.md section 5).
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field

from exceptiondrive_schemas.check.fault_list import FaultList
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.file_profile import FileProfile
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument

QUARTER_TURN_RAD = math.pi / 2
DEGREES_EXTENT = 0.01
"""A drive of 3 s spans less than this in degrees, and more in metres unless the car stands."""
FAR_M = 100.0
"""No car is so far from its own origin half a second later."""
EXTENTS_AWAY = 3.0
"""A position that is so many drives away from the origin does not begin there."""
CENTIMETRES = 100.0


@dataclass
class FrameCheck:
    """Where the source trajectories of a file begin and end.

    Attributes:
        protocol: Gives bounds, horizon and the angles that are refused.
    """

    protocol: ProtocolDocument
    _first_m: list[float] = field(default_factory=list)
    _extents_m: list[float] = field(default_factory=list)
    _angles_rad: list[float] = field(default_factory=list)

    def note(self, flat: Sequence[float]) -> None:
        """Take one whole source trajectory into account, flat (x1, y1, x2, y2, ...)."""
        x_m, y_m = flat[-2], flat[-1]
        self._first_m.append(math.hypot(flat[0], flat[1]))
        self._extents_m.append(math.hypot(x_m - flat[0], y_m - flat[1]))
        if x_m * x_m + y_m * y_m > self.protocol.plausibility.frame_check_min_motion_m**2:
            self._angles_rad.append(math.atan2(y_m, x_m))

    def finish(self, faults: FaultList, profile: FileProfile | None) -> None:
        """Refuse the file where it is in another frame or unit, in place of every number of it.

        Args:
            faults: Takes the fault.
            profile: What the file looks like; where recorded drives are known it tells a frame from
                its mirror image.
        """
        rules = self.protocol.plausibility
        if len(self._angles_rad) < rules.frame_check_min_samples:
            return
        unit = _wrong_unit(self._first_m, self._extents_m, self.protocol.geometry)
        if unit is not None:
            got, verdict = unit
            faults.forget(FaultCode.OUT_OF_BOUNDS, FaultCode.STEP_TOO_LONG)
            self._refuse(faults, "metres, from the rear axle at t = 0", got, verdict)
            return
        median_deg = math.degrees(statistics.median(map(abs, self._angles_rad)))
        if median_deg > rules.frame_check_max_angle_deg:
            self._refuse(
                faults,
                f"a median angle to +x of at most {rules.frame_check_max_angle_deg:g} "
                "degrees over the source trajectories that move",
                f"{median_deg:.1f} degrees over {len(self._angles_rad):,} source trajectories",
                _mend_verdict(profile) or frame_verdict(self._angles_rad),
            )

    def _refuse(self, faults: FaultList, expected: str, got: str, verdict: str) -> None:
        faults.add(
            FaultCode.WRONG_FRAME, ("predictions",), expected=expected, got=got, hint=verdict
        )
        sentence = f"The trajectories are not in the ego frame, in metres: {verdict}."
        faults.say(FaultCode.WRONG_FRAME, sentence)


def _wrong_unit(
    first_m: list[float], extents_m: list[float], geometry: GeometrySection
) -> tuple[str, str] | None:
    """Return what was found and what it looks like, where it is no frame of the car at all."""
    first, extent = statistics.median(first_m), statistics.median(extents_m)
    n_sources = f"median of {len(first_m):,} source trajectories"
    got = (
        f"a first waypoint {first:.4g} from the origin, the last {extent:.4g} from it; {n_sources}"
    )
    if extent < DEGREES_EXTENT and first > 1:
        return got, (
            "looks like degrees of latitude and longitude; turn each trajectory into the frame of "
            "the car at t = 0 by its pose"
        )
    if first > FAR_M and first > EXTENTS_AWAY * extent:
        return got, (
            "looks like global or pixel coordinates; turn each trajectory into the frame of the "
            "car at t = 0 by its pose"
        )
    speed_mps = extent / (geometry.horizon_s - geometry.time_step_s)
    if speed_mps > geometry.max_step_m / geometry.time_step_s:
        return f"{speed_mps:.4g} m/s, {n_sources}", (
            f"{CENTIMETRES:g} times too large: looks like centimetres; "
            "exceptiondrive convert --centimetres"
        )
    return None


def _mend_verdict(profile: FileProfile | None) -> str | None:
    if profile is None or profile.mend is None:
        return None
    mend = profile.mend
    if mend.convert_option == "--rotate -90":
        return _RIGHT_FORWARD
    return f"looks like {mend.looks_like}: exceptiondrive convert {mend.convert_option}"


def frame_verdict(angles_rad: Sequence[float]) -> str:
    """Say which wrong frame the directions of motion fit best, and how to convert.

    Args:
        angles_rad: Directions of net motion in the file's own axes, in [-pi, pi].
    """
    n_along = [0, 0, 0, 0]
    for angle_rad in angles_rad:
        n_along[round(angle_rad / QUARTER_TURN_RAD) % 4] += 1
    return FRAME_VERDICTS[n_along.index(max(n_along))]


_RIGHT_FORWARD = (
    "looks like x right / y forward: swap to (y, -x) (exceptiondrive convert --rotate -90)"
)
FRAME_VERDICTS = (
    "most motion is along +x, but it scatters too much for driving: start each one at heading 0",
    f"{_RIGHT_FORWARD}; only where x points left, to (y, x) (--swap)",
    "most motion is along -x: looks like x backward; turn it round to (-x, -y) (--rotate 180)",
    "most motion is along -y: looks like y backward; turn it to (-y, x) (--rotate 90)",
)
"""Verdicts for motion along +x, +y, -x, -y."""
