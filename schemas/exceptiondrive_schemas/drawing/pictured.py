"""Which drawing belongs to which protocol, and the one that ships with this package."""

from functools import cache
from importlib import resources

from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.drawing.documents import ProtocolDrawing
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.taxonomy import Strategy, Task

PACKAGED = "1.0.drawing.json"


def pictured_task(protocol: Protocol) -> Task:
    """Return the first task in which a bypass is acceptable; else the first task."""
    fitting = (task for task in protocol.tasks if Strategy.E in task.acceptable)
    return next(fitting, protocol.tasks[0])


def pictured_digest(protocol: Protocol) -> str:
    """Return the digest of all that the drawing of a protocol depends on."""
    task = pictured_task(protocol)
    return content_digest(
        {
            "geometry": protocol.geometry_digest,
            "task": task.model_dump(mode="json"),
            "d_safe_scale": protocol.grading.d_safe_scale,
        }
    )


@cache
def packaged_drawing() -> ProtocolDrawing:
    """Return the drawing of protocol 1.0, written by `python -m exceptiondrive_worker.drawing`."""
    file = resources.files("exceptiondrive_schemas") / "protocols" / PACKAGED
    return ProtocolDrawing.model_validate_json(file.read_bytes())
