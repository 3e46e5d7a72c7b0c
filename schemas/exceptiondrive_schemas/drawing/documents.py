"""A drawing as data: positions in metres, x forward and y left in the ego frame."""

from typing import Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.score_sheet import MetricRow

Position = tuple[float, float]
Outline = tuple[Position, ...]


class SampleDrawing(Document):
    """One sample of one entry, as the scoring code sees it.

    Attributes:
        sample_id: Key of the sample.
        family: Its family id.
        task: Its task id.
        hazard: The task in words.
        region: Corners of the hazard region.
        source: Waypoints with the origin in front; empty where missing.
        edited: The same of the edited scene.
        footprints: Vehicle rectangles along `edited`.
        tube: Convex pieces of the collision tube.
        segment: Ends of the clearance, on the tube and on the region; None on intrusion.
        clearance_m: Distance of tube and region; None where edited is missing.
        d_safe_m: Required clearance.
        metrics: Of this sample alone, by key; None where undefined.
    """

    sample_id: str
    family: str
    task: str
    hazard: str
    region: Outline
    source: Outline
    edited: Outline
    footprints: tuple[Outline, ...]
    tube: tuple[Outline, ...]
    segment: tuple[Position, Position] | None
    clearance_m: float | None
    d_safe_m: float
    metrics: MetricRow

    @property
    def is_intrusion(self) -> bool:
        """Whether the tube meets the region, or there is no edited trajectory."""
        return self.segment is None


class DrawnSample(Document):
    """A sample that stands for its family: its worst, or its middle by HCC, then clearance."""

    chosen_as: Literal["worst", "middle"]
    drawing: SampleDrawing


class EntryDrawings(Document):
    """What is drawn of one entry on a public split."""

    schema_: Literal["exceptiondrive.drawings/1"] = Field(
        default="exceptiondrive.drawings/1", alias="schema"
    )
    samples: tuple[DrawnSample, ...]


class ProtocolDrawing(Document):
    """A made-up sample under one protocol: what footprint, tube, region and clearance are.

    Attributes:
        pictured: Digest of what the drawing depends on (`pictured_digest`).
        sample: The made-up sample.
    """

    schema_: Literal["exceptiondrive.protocol-drawing/1"] = Field(
        default="exceptiondrive.protocol-drawing/1", alias="schema"
    )
    pictured: str
    sample: SampleDrawing
