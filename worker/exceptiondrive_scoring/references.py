"""Answers of the reference rows of a board (names: `exceptiondrive_schemas.references`)."""

import numpy as np

from exceptiondrive_schemas.check import StrategyAnswer
from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_schemas.references import ALWAYS_STOP, CONSTANT_VELOCITY, FREEZE, Reference
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_scoring.aliases import Columns, FloatArray
from exceptiondrive_scoring.strategy import strategy_answers


def reference_answers(
    reference: Reference, n_samples: int, geometry: GeometrySection, recorded_m: FloatArray | None
) -> Columns | None:
    """Return the answers of a reference as columns, one row per sample of the split.

    Args:
        reference: The reference row.
        n_samples: M, the number of samples of the whole split, as a file answers it.
        geometry: Holds the number of waypoints T.
        recorded_m: (M, T, 2) the path driven in each source scene, NaN where it is not known.

    Returns:
        None if the split lacks the data for the reference.
    """
    if reference == ALWAYS_STOP:
        return strategy_answers([StrategyAnswer(Strategy.C, None)] * n_samples).columns()
    if reference == FREEZE:
        return _in_both_scenes(np.zeros((n_samples, geometry.waypoints, 2)))
    if recorded_m is None or recorded_m.shape[1] != geometry.waypoints:
        return None
    if reference == CONSTANT_VELOCITY:
        return _in_both_scenes(np.arange(1, geometry.waypoints + 1)[:, None] * recorded_m[:, :1])
    return _in_both_scenes(recorded_m)


def _in_both_scenes(path_m: FloatArray) -> Columns:
    """The same (M, T, 2) trajectories for the source and the edited scenes."""
    return {"source": path_m, "edited": path_m}
