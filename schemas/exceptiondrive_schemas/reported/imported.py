"""Rows of an external board, as an organizer imports them: never ranked beside own entries."""

from collections.abc import Iterator

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.protocol import Average
from exceptiondrive_schemas.score_sheet import MetricRow
from exceptiondrive_schemas.split import SplitRef


class ImportedRow(Document):
    """One method on another board, with what it was measured on; None is what is not told.

    Shares are fractions, lengths are metres. `families` holds the first metric of the challenge.
    """

    method: str
    team: str = ""
    metrics: MetricRow
    families: MetricRow = {}
    n_samples: int | None = None
    split: SplitRef
    protocol: str
    protocol_digest: str | None = None
    average: Average | None = None
    cite: str = ""
    """Where the row is found; empty: where the whole table is."""


class ImportedRows(Document):
    """The rows of one import, as they are kept."""

    rows: tuple[ImportedRow, ...]


class Measured(Document):
    """What a phase measures by: of its board as readers see it, else of the phase itself."""

    split: SplitRef
    protocol: str
    protocol_digest: str
    average: Average
    n_samples: int | None = None

    @classmethod
    def on(cls, board: Board) -> "Measured":
        """Return the basis of measurement of a board."""
        return cls(
            split=board.split,
            protocol=board.protocol.version,
            protocol_digest=board.protocol.digest,
            average=board.headline,
            n_samples=board.n_samples,
        )


def differences(row: ImportedRow, own: Measured) -> Iterator[str]:
    """Yield the reasons why a row cannot be compared with a phase's own entries, if any."""
    if row.split.name != own.split.name:
        yield f"Split {row.split.name}, not {own.split.name}."
    elif row.split.revision != own.split.revision:
        yield f"Another revision of split {own.split.name}."
    if row.protocol_digest != own.protocol_digest:
        if row.protocol != own.protocol:
            yield f"Protocol {row.protocol}, not {own.protocol}."
        elif row.protocol_digest is None:
            yield f"The digest of protocol {row.protocol} is not told."
        else:
            yield f"Another document under the version {row.protocol}."
    if row.n_samples is None:
        yield "How many samples is not told."
    elif own.n_samples not in (None, row.n_samples):
        yield f"{row.n_samples:,} samples, not {own.n_samples:,}."
    if row.average is None:
        yield "Which average is not told."
    elif row.average != own.average:
        yield f"The average {row.average}, not {own.average}."
