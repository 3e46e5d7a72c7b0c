"""All samples of one planning file on a split that is at hand, ready to be drawn."""

from collections.abc import Sequence

from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.check import CheckedDocument, PlanningDocument
from exceptiondrive_schemas.drawing import SampleDrawing
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.split import Split


class Scenes:
    """Draws samples with the scoring code itself (`exceptiondrive_scoring.drawing`)."""

    def __init__(self, document: CheckedDocument, split: Split, protocol: Protocol) -> None:
        from exceptiondrive_scoring.arrays import TrajectoryPairs
        from exceptiondrive_scoring.document_columns import document_columns
        from exceptiondrive_scoring.drawing import Drawer
        from exceptiondrive_scoring.measure import measure
        from exceptiondrive_scoring.split_arrays import split_arrays

        if not isinstance(document, PlanningDocument):
            raise InvalidArgumentError(
                "wrong_challenge",
                "Only planning files can be drawn: strategies have no trajectories.",
                "Give a file with the schema exceptiondrive.planning/1.",
            )
        self.sample_ids = tuple(sorted(sample.sample_id for sample in split.samples))
        arrays = split_arrays(split.samples, protocol.taxonomy)
        pairs = TrajectoryPairs.from_columns(document_columns(document, self.sample_ids))
        measured = measure(pairs, arrays.prepared_regions, protocol.geometry)
        self._drawer = Drawer(self.sample_ids, pairs, measured, arrays, protocol)

    def worst(self, count: int) -> list[str]:
        """Return the samples with the least HCC, then the least clearance; without answer: left out."""
        return [self.sample_ids[i] for i in self._drawer.from_worst_to_best()[:count]]

    def scene(self, sample_id: str) -> SampleDrawing:
        """Return what a picture of one sample shows.

        Raises:
            InvalidArgumentError: The split has no such sample.
        """
        if sample_id not in self.sample_ids:
            raise InvalidArgumentError(
                "unknown_sample",
                f"The split has no sample {sample_id!r}.",
                f"Its samples are {_few(self.sample_ids)}.",
            )
        return self._drawer.drawing(self.sample_ids.index(sample_id))


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
