"""Protocols as organizers see them: which are there, and what a new document would change."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from exceptiondrive_records.tables import Phase, ProtocolRow
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.protocol_difference import Difference


@dataclass(frozen=True)
class ProtocolLine:
    """One protocol in the list."""

    version: str
    title: str
    changes: str
    digest: str
    added_at: datetime
    phases: tuple[str, ...]
    """Phases that show it now."""


@dataclass(frozen=True)
class PhaseDifference:
    """What a document would change in one phase."""

    phase: str
    from_version: str
    difference: Difference


@dataclass(frozen=True)
class Verdict:
    """What a check came to: problems, or the differences phase by phase."""

    version: str = ""
    problems: tuple[str, ...] = ()
    is_known: bool = False
    """This very document is there already."""
    phases: tuple[PhaseDifference, ...] = ()

    @property
    def is_good(self) -> bool:
        """Whether the document may be added."""
        return not self.problems


@dataclass(frozen=True)
class ProtocolForm:
    """Everything that `protocol_new.html` needs."""

    toml: str
    verdict: Verdict | None
    starts: tuple[str, ...]
    """Versions that a new document may start from."""


def protocol_lines(
    rows: Sequence[ProtocolRow], protocols: Mapping[str, Protocol], phases: Sequence[Phase]
) -> tuple[ProtocolLine, ...]:
    """Return the list, newest first; `protocols` by digest."""
    return tuple(
        ProtocolLine(
            version=row.version,
            title=protocols[row.digest].title,
            changes=protocols[row.digest].changes,
            digest=row.digest,
            added_at=row.created_at,
            phases=tuple(phase.id for phase in phases if phase.protocol_digest == row.digest),
        )
        for row in reversed(rows)
    )


def refused(text: str) -> Verdict:
    """Return the verdict on a document that cannot be used; each line of `text` is a problem."""
    head, *problems = text.splitlines()
    return Verdict(problems=tuple(problems or [head]))
