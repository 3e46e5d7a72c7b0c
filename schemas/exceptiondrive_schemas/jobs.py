"""The broker's messages: one task, whose payload is the name of a lane and nothing else."""

from exceptiondrive_schemas.python310 import StrEnum


class JobName(StrEnum):
    """Celery task names: the server sends by name and never imports the worker."""

    WAKE = "exceptiondrive.wake"
    """`(lane)`: do what is to be done in a lane, until nothing is left."""


class Lane(StrEnum):
    """Queues. Fresh submissions never wait behind a rescoring."""

    LIVE = "live"
    RESCORE = "rescore"
