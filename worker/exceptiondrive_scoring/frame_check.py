"""Frame check at upload: the likeliest mistake of a submission (PROTOCOL.md section 5)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from exceptiondrive_schemas.protocol import PlausibilitySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs

FrameFaultKind = Literal["x_right_y_forward", "backward"]
SENTENCES: dict[FrameFaultKind, str] = {
    "x_right_y_forward": "looks like x right / y forward: swap to (y, -x)",
    "backward": "most motion is along -x: x must point forward",
}


@dataclass(frozen=True)
class FrameFault:
    """Why the file looks as if it were in another frame."""

    kind: FrameFaultKind
    median_angle_deg: float
    n_moving: int

    @property
    def sentence(self) -> str:
        """What a participant reads."""
        return SENTENCES[self.kind]


def frame_check(pairs: TrajectoryPairs, section: PlausibilitySection) -> FrameFault | None:
    """Look at where the source trajectories go, over those that move far enough.

    Returns:
        A fault if the median angle of their net motion to +x is too large, else None; also None
        where too few trajectories move.
    """
    end = pairs.source[pairs.source_given, -1]
    end = end[np.hypot(end[:, 0], end[:, 1]) > section.frame_check_min_motion_m]
    if len(end) < section.frame_check_min_samples:
        return None
    angle_deg = np.degrees(np.abs(np.arctan2(end[:, 1], end[:, 0])))
    median_deg = float(np.median(angle_deg))
    if not median_deg > section.frame_check_max_angle_deg:
        return None
    kind: FrameFaultKind = "backward" if _is_backward(end) else "x_right_y_forward"
    return FrameFault(kind, median_deg, len(end))


def _is_backward(end_m: FloatArray) -> bool:
    """Whether most net motions are nearer to -x than to +-y."""
    along_minus_x = -end_m[:, 0] > np.abs(end_m[:, 1])
    return bool(np.count_nonzero(along_minus_x) * 2 > len(end_m))
