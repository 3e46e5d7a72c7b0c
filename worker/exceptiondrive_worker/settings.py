"""The worker's settings: the only class that knows the location of withheld splits."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from exceptiondrive_records.db.settings import RecordsSettings, Seconds
from exceptiondrive_records.work.heartbeats import HEARTBEAT_TTL_S

MEBIBYTE = 2**20


class WorkerSettings(RecordsSettings):
    """Each field is set by an environment variable with the prefix `EXCEPTIONDRIVE_`."""

    splits_dir: Path = Path("hidden_splits")
    private_dir: Path = Path("data/private")
    soft_time_limit_s: Seconds = 75.0
    """A scoring run that lasts longer is stopped and tried again."""
    time_limit_s: Seconds = 90.0
    """A worker process that lasts longer in one job is killed."""
    board_lease_s: Seconds = 30.0
    """A board whose build took longer, or died, is built anew."""
    memory_headroom_bytes: Annotated[int, Field(ge=64 * MEBIBYTE)] = 1024 * MEBIBYTE
    """Address space that a worker process may take beyond what it has when it starts."""
    private_max_bytes: Annotated[int, Field(ge=16 * MEBIBYTE)] = 20 * 1024 * MEBIBYTE
    """Room for the private store; beyond it what was not used for longest is removed."""
    private_max_age_days: Annotated[float, Field(gt=0, le=3650)] = 180.0
    """What the private store was not asked for in so many days is removed."""
    heartbeat_every_s: Seconds = 4.0
    heartbeat_ttl_s: Seconds = HEARTBEAT_TTL_S
    """A worker that gave no sign of life for so long counts as dead."""

    @model_validator(mode="after")
    def _limits_are_in_order(self) -> Self:
        if not self.soft_time_limit_s < self.time_limit_s < self.lease_s:
            raise ValueError(
                "EXCEPTIONDRIVE_SOFT_TIME_LIMIT_S < EXCEPTIONDRIVE_TIME_LIMIT_S < "
                "EXCEPTIONDRIVE_LEASE_S must hold, or two workers would hold one job at a time"
            )
        if self.heartbeat_every_s * 2 > self.heartbeat_ttl_s:
            raise ValueError(
                "EXCEPTIONDRIVE_HEARTBEAT_EVERY_S must be at most half of "
                "EXCEPTIONDRIVE_HEARTBEAT_TTL_S"
            )
        return self
