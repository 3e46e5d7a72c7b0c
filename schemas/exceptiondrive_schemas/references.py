"""The reference rows of a board: planners and agents that need no skill.

Every board has those of its challenge; the worker makes and scores them like entries
(`exceptiondrive_scoring.references`), and they never rank. No team or method may use their names.
"""

import unicodedata
from dataclasses import dataclass

from exceptiondrive_schemas.challenges import PLANNING, STRATEGY, ChallengeId

TEAM = "Reference"
PAPER_TEAM = "ExceptionDrive paper"
"""Team name of the rows that the paper reports (`reported`)."""


@dataclass(frozen=True)
class Reference:
    """A row on a board beside the entries."""

    method: str
    description: str


FREEZE = Reference("FREEZE", "Stands still in every sample.")
CONSTANT_VELOCITY = Reference(
    "CONSTANT VELOCITY",
    "Goes on as it was driven in the first step of the recorded path, and never reacts.",
)
SOURCE_AS_EDITED = Reference(
    "SOURCE AS EDITED",
    "Drives the recorded path of the source scene, and never reacts.",
)
ALWAYS_STOP = Reference("ALWAYS STOP", "Answers C, stop, in every sample.")

REFERENCES: dict[ChallengeId, tuple[Reference, ...]] = {
    PLANNING.id: (FREEZE, CONSTANT_VELOCITY, SOURCE_AS_EDITED),
    STRATEGY.id: (ALWAYS_STOP,),
}


def is_reserved(name: str) -> bool:
    """Whether a team's or method's name reads like a reference row, or like the paper's rows."""
    return _as_read(name) in _RESERVED


def _as_read(name: str) -> str:
    """Return letters and digits alone, case-folded, without variants of width or style."""
    return "".join(c for c in unicodedata.normalize("NFKC", name).casefold() if c.isalnum())


RESERVED_NAMES = (
    TEAM,
    f"ExceptionDrive {TEAM}",
    PAPER_TEAM,
    *(each.method for references in REFERENCES.values() for each in references),
)
_RESERVED = {_as_read(name) for name in RESERVED_NAMES}
