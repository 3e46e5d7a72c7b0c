"""Drawings of samples: as data in metres, and the one painter of their shapes.

The worker and `exceptiondrive plot` make the data with the scoring code's own geometry. Pages and
picture files paint it. A drawing shows a hazard region: it may be made of a public split alone.
"""

from exceptiondrive_schemas.drawing.documents import (
    DrawnSample,
    EntryDrawings,
    Outline,
    Position,
    ProtocolDrawing,
    SampleDrawing,
)
from exceptiondrive_schemas.drawing.pictured import (
    packaged_drawing,
    pictured_digest,
    pictured_task,
)
from exceptiondrive_schemas.drawing.shapes import caption, outcome, shapes
from exceptiondrive_schemas.drawing.view import View

__all__ = [
    "DrawnSample",
    "EntryDrawings",
    "Outline",
    "Position",
    "ProtocolDrawing",
    "SampleDrawing",
    "View",
    "caption",
    "outcome",
    "packaged_drawing",
    "pictured_digest",
    "pictured_task",
    "shapes",
]
