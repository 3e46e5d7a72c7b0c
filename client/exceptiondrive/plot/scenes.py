"""What a picture of one sample shows, taken from the scoring code itself."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.check import CheckedDocument, PlanningDocument
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.split import Split

if TYPE_CHECKING:
    from exceptiondrive_scoring.aliases import FloatArray
    from exceptiondrive_scoring.arrays import SplitArrays
    from exceptiondrive_scoring.measure import Measurements

Position = tuple[float, float]
Outline = tuple[Position, ...]


@dataclass(frozen=True)
class Scene:
    """One sample of one submission; positions in metres, x forward and y left.

    Attributes:
        sample_id: Key of the sample.
        hazard: Its task in words.
        task: Its task id.
        region: Corners of the hazard region.
        source: Waypoints with the origin in front; empty where missing.
        edited: The same of the edited scene.
        footprints: Vehicle rectangles along `edited`.
        tube: Convex pieces of the collision tube.
        segment: Ends of the clearance; None on intrusion.
        clearance_m: Distance of tube and region; None where edited is missing.
        d_safe_m: Required clearance.
        metrics: Of this sample alone, by key; None where undefined.
    """

    sample_id: str
    hazard: str
    task: str
    region: Outline
    source: Outline
    edited: Outline
    footprints: tuple[Outline, ...]
    tube: tuple[Outline, ...]
    segment: tuple[Position, Position] | None
    clearance_m: float | None
    d_safe_m: float
    metrics: dict[str, float | None]

    @property
    def is_intrusion(self) -> bool:
        """Whether the tube meets the region, or there is no edited trajectory."""
        return self.segment is None


class Scenes:
    """All samples of one planning file on a split that is at hand."""

    def __init__(self, document: CheckedDocument, split: Split, protocol: Protocol) -> None:
        from exceptiondrive_scoring.arrays import TrajectoryPairs
        from exceptiondrive_scoring.document_columns import document_columns
        from exceptiondrive_scoring.grade import grade
        from exceptiondrive_scoring.measure import measure
        from exceptiondrive_scoring.split_arrays import split_arrays

        if not isinstance(document, PlanningDocument):
            raise InvalidArgumentError(
                "wrong_challenge",
                "Only planning files can be drawn: strategies have no trajectories.",
                "Give a file with the schema exceptiondrive.planning/1.",
            )
        self._protocol = protocol
        self._samples = {sample.sample_id: sample for sample in split.samples}
        self.sample_ids = tuple(sorted(self._samples))
        self._arrays: SplitArrays = split_arrays(split.samples, protocol.taxonomy)
        self._pairs = TrajectoryPairs.from_columns(document_columns(document, self.sample_ids))
        self._measured: Measurements = measure(
            self._pairs, self._arrays.prepared_regions, protocol.geometry
        )
        self._scores = grade(self._measured, self._arrays, protocol)

    def worst(self, count: int) -> list[str]:
        """Return the samples with the least HCC, then the least HPR; missing ones are left out."""
        hcc, hpr = (self._scores.metric_keys.index(key) for key in ("hcc", "hpr"))
        values = self._scores.values
        given = [i for i in range(len(self.sample_ids)) if self._measured.edited_given[i]]
        given.sort(key=lambda i: (values[i, hcc], values[i, hpr], self.sample_ids[i]))
        return [self.sample_ids[i] for i in given[:count]]

    def scene(self, sample_id: str) -> Scene:
        """Return what a picture of one sample shows.

        Raises:
            InvalidArgumentError: The split has no such sample.
        """
        if sample_id not in self._samples:
            raise InvalidArgumentError(
                "unknown_sample",
                f"The split has no sample {sample_id!r}.",
                f"Its samples are {_few(self.sample_ids)}.",
            )
        return self._scene(self.sample_ids.index(sample_id))

    def _scene(self, index: int) -> Scene:
        from exceptiondrive_scoring.collision_tube import tube_pieces_m
        from exceptiondrive_scoring.footprint import footprints_m
        from exceptiondrive_scoring.nearest_points import clearance_segment_m

        sample, geometry = self._samples[self.sample_ids[index]], self._protocol.geometry
        task = self._protocol.taxonomy.task(sample.task)
        region = self._arrays.regions_m[index]
        edited, source = _path(self._pairs.edited[index]), _path(self._pairs.source[index])
        has_edited = bool(self._measured.edited_given[index])
        segment = None
        if has_edited and not self._measured.intrusion[index]:
            found = clearance_segment_m(edited, region, geometry)
            segment = (_position(found.on_tube_m), _position(found.on_region_m))
        return Scene(
            sample_id=sample.sample_id,
            hazard=task.hazard,
            task=task.id,
            region=_outline(region),
            source=_outline(source) if self._measured.source_given[index] else (),
            edited=_outline(edited) if has_edited else (),
            footprints=_outlines(footprints_m(edited[None], geometry)[0]) if has_edited else (),
            tube=_outlines(tube_pieces_m(edited, geometry)) if has_edited else (),
            segment=segment,
            clearance_m=float(self._measured.clearance_m[index]) if has_edited else None,
            d_safe_m=float(self._arrays.d_safe_m[index]) * self._protocol.grading.d_safe_scale,
            metrics=self._metrics(index),
        )

    def _metrics(self, index: int) -> dict[str, float | None]:
        row = self._scores.values[index].tolist()
        pairs = zip(self._scores.metric_keys, row, strict=True)
        return {key: None if value != value else value for key, value in pairs}  # noqa: PLR0124


def _path(waypoints: "FloatArray") -> "FloatArray":
    """Put the origin in front: (T, 2) -> (T + 1, 2)."""
    import numpy as np

    return np.concatenate([np.zeros((1, 2)), waypoints])


def _position(point: Any) -> Position:
    return float(point[0]), float(point[1])


def _outline(points: Any) -> Outline:
    return tuple(_position(point) for point in points)


def _outlines(pieces: Any) -> tuple[Outline, ...]:
    return tuple(_outline(piece) for piece in pieces)


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
