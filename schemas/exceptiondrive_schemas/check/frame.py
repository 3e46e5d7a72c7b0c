"""The frame check of docs/protocol.md section 5: which way do the source trajectories go?"""

from __future__ import annotations  # array[float] is no runtime type before 3.12

import math
import statistics
from array import array

from exceptiondrive_schemas.check.findings import Findings
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.protocol import PlausibilitySection

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

    def finish(self, findings: Findings) -> None:
        """Refuse the file where the median |angle to +x| is too large."""
        if len(self._angles_rad) < self._rules.frame_check_min_samples:
            return
        median_deg = math.degrees(statistics.median(abs(angle) for angle in self._angles_rad))
        if median_deg <= self._rules.frame_check_max_angle_deg:
            return
        verdict = frame_verdict(self._angles_rad)
        findings.add(
            FaultCode.WRONG_FRAME,
            ("predictions",),
            expected=f"a median angle to +x of at most {self._rules.frame_check_max_angle_deg:g} "
            "degrees over the source trajectories that move",
            got=f"{median_deg:.1f} degrees over {len(self._angles_rad):,} source trajectories",
            hint=verdict,
        )
        findings.say(
            FaultCode.WRONG_FRAME, f"The trajectories are not in the ego frame: {verdict}."
        )


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
