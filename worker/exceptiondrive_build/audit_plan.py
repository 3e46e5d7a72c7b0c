"""How many accepted edits people have to look at, for an interval of which width."""

from bisect import bisect_left

from exceptiondrive_build.candidates import walk
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.numbers import audit, finite_population
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import Document

WIDTHS = (0.10, 0.08, 0.06, 0.05, 0.04, 0.03, 0.02)
EXPECTED_SHARE = 0.95


class PlanRow(Document):
    """A width of the interval, and the smallest draw that reaches it."""

    width: float
    draw: int


class AuditPlan(Document):
    """What draws of how many tell."""

    accepted: int
    share: float
    rows: tuple[PlanRow, ...]


def audit_plan(workshop: Workshop, share: float | None = None) -> AuditPlan:
    """Plan the draw from what the review has accepted.

    Args:
        workshop: The workshop.
        share: Expected share that passes; by default what people said so far, else 95 %.

    Raises:
        BuildError: Nothing is accepted.
    """
    candidates = walk(workshop)
    accepted = sum(candidate.passed_review for candidate in candidates.values())
    if not accepted:
        raise BuildError("No edit is accepted by the review.", "Run screen, edit and review first.")
    seen = audit(candidates, workshop.settings.inspect)
    if share is None:
        share = seen.passed / seen.drawn if seen else EXPECTED_SHARE
    rows = (PlanRow(width=width, draw=draw_for(width, share, accepted)) for width in WIDTHS)
    return AuditPlan(accepted=accepted, share=share, rows=tuple(rows))


def draw_for(width: float, share: float, population: int) -> int:
    """The smallest draw without replacement whose 95 % interval is at most so wide.

    The interval is that of `numbers.finite_population`; its width falls as the draw grows.
    """

    def negative_width(drawn: int) -> float:
        low, high = finite_population(share, drawn, population)
        return low - high

    return 1 + bisect_left(range(1, population), -width, key=negative_width)
