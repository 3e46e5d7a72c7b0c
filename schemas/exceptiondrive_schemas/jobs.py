"""Names and payloads of queue jobs. A payload is ids and nothing else."""

from enum import StrEnum


class JobName(StrEnum):
    """Celery task names: the server sends by name and never imports the worker."""

    SCORE = "exceptiondrive.score"
    """`(job_id)`: score one submission under one protocol and split revision."""
    BUILD_BOARD = "exceptiondrive.build_board"
    """`(phase_id, protocol_digest, split_revision)`: rank the scored entries into a new snapshot;
    without a revision, those of the one that the phase shows."""
    VERIFY = "exceptiondrive.verify"
    """`(item_id)`: recompute one sheet from its upload and compare every bit."""


class Lane(StrEnum):
    """Queues. Fresh submissions never wait behind a rescoring."""

    LIVE = "live"
    RESCORE = "rescore"
