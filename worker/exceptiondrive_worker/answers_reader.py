"""From the bytes of an upload to answers as columns, or to the report of all its faults."""

import numpy as np

from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.check import PlanningDocument, check
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_worker.stages import ReadAnswers


def answers_reader(*, max_upload_bytes: int, max_inflated_bytes: int) -> ReadAnswers:
    """Return the reader of both challenges, with these limits."""

    def read(
        data: bytes, challenge: Challenge, manifest: Manifest, protocol: Protocol
    ) -> Columns | CheckReport:
        checked = check(
            data,
            protocol=protocol,
            manifest=manifest,
            challenge=challenge.id,
            max_upload_bytes=max_upload_bytes,
            max_inflated_bytes=max_inflated_bytes,
        )
        document = checked.document
        if not isinstance(document, PlanningDocument):
            return checked.report
        flat = document.columns(manifest.sample_ids)
        shape = (-1, document.n_waypoints, 2)
        return {name: np.frombuffer(column).reshape(shape) for name, column in flat.items()}

    return read
