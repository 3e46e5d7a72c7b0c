"""The planning challenge with the metrics of the paper alone, for tests that give each a column."""

from exceptiondrive_schemas.challenges import PLANNING

KEYS = ("hcc", "ur", "hpr", "cts", "cts_x", "cts_y")
SIX_METRICS = PLANNING.model_copy(update={"metrics": tuple(map(PLANNING.metric, KEYS))})
