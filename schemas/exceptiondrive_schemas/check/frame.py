"""Frame check: whether trajectories are in the ego frame, in metres; one verdict per file.

Only source trajectories are used (docs/protocol.md section 5).
"""

import math
import statistics
from collections.abc import Sequence
from functools import cached_property
from operator import sub

from exceptiondrive_schemas.check.fault_list import FaultList
from exceptiondrive_schemas.check.tracks import Tracks
from exceptiondrive_schemas.check.transformations import UNITS_M
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.file_profile import CONVERT, FileProfile
from exceptiondrive_schemas.protocol import ProtocolDocument

DEGREES_EXTENT = 0.01
"""A drive of 3 s spans less than this in degrees, and more in metres unless the car stands."""
FAR_M = 100.0
"""Metres that no car covers from its own origin in half a second."""
EXTENTS_AWAY = 3.0
"""A position this many drive lengths away from the origin is not the start of a drive."""
SMALLER_UNITS = ("feet", "centimetres", "millimetres")
"""Units in which the numbers of a drive are too fast for metres, of those that planners use."""


class FrameCheck:
    """Start and end points of the complete source trajectories of a file."""

    def __init__(self, sources: Tracks, protocol: ProtocolDocument) -> None:
        self._sources, self._protocol = sources, protocol
        from_m2 = protocol.plausibility.frame_check_min_motion_m**2
        last = zip(sources.x_m[-1], sources.y_m[-1], strict=True)
        self._angles_rad = [math.atan2(y, x) for x, y in last if x * x + y * y > from_m2]

    @cached_property
    def _medians_m(self) -> tuple[float, float]:
        """Median distance of the first waypoint from the origin, and of the last from the first."""
        x_m, y_m = self._sources.x_m, self._sources.y_m
        extents_m = map(math.hypot, map(sub, x_m[-1], x_m[0]), map(sub, y_m[-1], y_m[0]))
        return statistics.median(map(math.hypot, x_m[0], y_m[0])), statistics.median(extents_m)

    @property
    def is_judged(self) -> bool:
        """Whether enough trajectories move for a verdict."""
        return len(self._angles_rad) >= self._protocol.plausibility.frame_check_min_samples

    @property
    def is_of_the_car(self) -> bool:
        """Whether trajectories start at the car; otherwise they are not comparable with drives."""
        return not self.is_judged or self._not_at_car() is None

    def finish(self, faults: FaultList, profile: FileProfile | None) -> None:
        """Refuse a file in another frame or unit, in place of faults for all its numbers.

        If recorded drives are known, the profile distinguishes a frame from its mirror image, and
        units from each other.
        """
        if not self.is_judged:
            return
        mended = _mend_verdict(profile)
        wrong_unit = self._not_at_car() or self._too_large(mended)
        if wrong_unit is not None:
            faults.forget(FaultCode.OUT_OF_BOUNDS, FaultCode.STEP_TOO_LONG)
            first, extent = self._medians_m
            got = (
                f"a first waypoint {first:.4g} from the origin, the last {extent:.4g} from it; median "
                f"of {len(self._sources.x_m[0]):,} source trajectories"
            )
            self._add_fault(faults, "metres, from the rear axle at t = 0", got, wrong_unit)
            return
        limit_deg = self._protocol.plausibility.frame_check_max_angle_deg
        median_deg = math.degrees(statistics.median(map(abs, self._angles_rad)))
        if median_deg > limit_deg:
            self._add_fault(
                faults,
                f"a median angle to +x of at most {limit_deg:g} "
                "degrees over the source trajectories that move",
                f"{median_deg:.1f} degrees over {len(self._angles_rad):,} source trajectories",
                mended or frame_verdict(self._angles_rad, math.radians(limit_deg)),
            )

    def _not_at_car(self) -> str | None:
        """Describe the file if its trajectories do not begin at the car."""
        first, extent = self._medians_m
        if extent == 0 and first > 1:
            return (
                "looks like one point repeated, such as the goal; write where the car is at every "
                "time step"
            )
        if extent < DEGREES_EXTENT and first > 1:
            return (
                "looks like degrees of latitude and longitude; turn each trajectory into the frame "
                "of the car at t = 0 by its pose"
            )
        if first > FAR_M and first > EXTENTS_AWAY * extent:
            return (
                "looks like global or pixel coordinates; turn each trajectory into the frame of the "
                "car at t = 0 by its pose"
            )
        return None

    def _too_large(self, mended: str | None) -> str | None:
        """Describe the file if no car is so fast: by the smallest unit that makes it plausible."""
        geometry = self._protocol.geometry
        _, extent = self._medians_m
        speed_mps = extent / (geometry.horizon_s - geometry.time_step_s)
        limit_mps = geometry.max_step_m / geometry.time_step_s
        if speed_mps <= limit_mps:
            return None
        units = (unit for unit in SMALLER_UNITS if speed_mps * UNITS_M[unit] <= limit_mps)
        unit = next(units, None)
        guess = (
            "no unit that is known makes a car of it"
            if unit is None
            else f"looks like {unit}; {CONVERT} --unit {unit}`"
        )
        return f"sources of {speed_mps:.4g} m/s: {mended or guess}"

    def _add_fault(self, faults: FaultList, expected: str, got: str, verdict: str) -> None:
        faults.add(
            FaultCode.WRONG_FRAME, ("predictions",), expected=expected, got=got, hint=verdict
        )
        sentence = f"The trajectories are not in the ego frame, in metres: {verdict}."
        faults.say(FaultCode.WRONG_FRAME, sentence)


def _mend_verdict(profile: FileProfile | None) -> str | None:
    if profile is None or profile.mend is None:
        return None
    mend = profile.mend
    if mend.convert_option is None:
        return f"looks like {mend.looks_like}"
    if mend.convert_option == "--rotate -90":
        return _RIGHT_FORWARD
    return f"looks like {mend.looks_like}: {CONVERT} {mend.convert_option}`"


def frame_verdict(angles_rad: Sequence[float], limit_rad: float) -> str:
    """Return the wrong frame that best explains the directions of motion, and how to convert.

    Args:
        angles_rad: Directions of net motion in the file's own axes, in [-pi, pi].
        limit_rad: Median angle to an axis within which motion is along it.
    """
    scatter_rad = [
        statistics.median(
            abs(math.remainder(angle - turns * math.pi / 2, math.tau)) for angle in angles_rad
        )
        for turns in range(len(FRAME_VERDICTS))
    ]
    best = scatter_rad.index(min(scatter_rad))
    return FRAME_VERDICTS[best] if scatter_rad[best] <= limit_rad else SCATTERED


_RIGHT_FORWARD = f"looks like x right / y forward: swap to (y, -x), {CONVERT} --rotate -90`"
SCATTERED = (
    "motion scatters too much for driving, as in the axes of a map: start each trajectory at (0, 0) and "
    "turn it by minus the heading of the car at t = 0"
)
FRAME_VERDICTS = (
    SCATTERED,
    f"{_RIGHT_FORWARD}; only where x points left, to (y, x), {CONVERT} --swap`",
    f"most motion is along -x: looks like x backward; turn it round to (-x, -y), {CONVERT} --rotate 180`",
    f"most motion is along -y: looks like y backward; turn it to (-y, x), {CONVERT} --rotate 90`",
)
"""Verdicts for motion along +x, +y, -x, -y."""
