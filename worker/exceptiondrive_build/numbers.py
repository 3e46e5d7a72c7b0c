"""Counts over decisions: the funnel, families and tasks, the audit and its plan, the deciders.

All of it follows from the present candidates and records; no number here reveals a region or a
sample.
"""

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from statistics import NormalDist

from exceptiondrive_build.agreement import outcome
from exceptiondrive_build.candidates import Candidate, walk
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.inspection import draw
from exceptiondrive_build.records import Kind, person_key
from exceptiondrive_build.settings import InspectSection, VerifySection
from exceptiondrive_build.values import Edited
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import Document, content_digest
from exceptiondrive_schemas.datasheet import Audit, Cell, Decider, Interval, Stage
from exceptiondrive_schemas.taxonomy import Family, Task

CONFIDENCE = 0.95
WIDTHS = (0.10, 0.08, 0.06, 0.05, 0.04, 0.03, 0.02)
EXPECTED_SHARE = 0.95


def is_verified(candidate: Candidate, limits: VerifySection) -> bool:
    """Whether readers agreed on a region for it."""
    return outcome(candidate.verifications, limits).state == "verified"


def stages(
    candidates: Iterable[Candidate], limits: VerifySection, frozen: Collection[str]
) -> tuple[Stage, ...]:
    """Return the funnel: how many candidates passed each stage, of those that reached it.

    `frozen` are the ids of the samples of the split that are not withdrawn.
    """
    ways: tuple[tuple[str, str, Callable[[Candidate], bool]], ...] = (
        ("suitable", "The task suits the scene", lambda it: it.is_suitable),
        ("edited", "Edited in every view", lambda it: isinstance(it.edited, Edited)),
        ("accepted", "Accepted by review and people", lambda it: it.is_accepted),
        ("localized", "Region proposed", lambda it: it.localized is not None),
        ("verified", "Region verified by two people", lambda it: is_verified(it, limits)),
        ("frozen", "In the split, not withdrawn", lambda it: it.sample_id in frozen),
    )
    left, found = list(candidates), []
    for stage_id, title, came_through in ways:
        entered, left = len(left), [it for it in left if came_through(it)]
        found.append(Stage(id=stage_id, title=title, n=len(left), of=entered))
    return tuple(found)


def cells(
    members: Sequence[Family] | Sequence[Task],
    candidates: Iterable[Candidate],
    counted: Collection[str],
) -> tuple[Cell, ...]:
    """Return how far the candidates of each family or task came; `counted` are in the split."""
    counts = {member.id: Counter[str]() for member in members}
    for it in candidates:
        cell = counts[it.task.id if it.task.id in counts else it.task.family]
        cell.update(
            candidates=1,
            suitable=int(it.is_suitable),
            accepted=int(it.is_accepted),
            n=int(it.sample_id in counted),
        )
    return tuple(
        Cell(
            id=member.id,
            title=member.title,
            **{key: counts[member.id][key] for key in ("candidates", "suitable", "accepted", "n")},
        )
        for member in members
    )


def audit(candidates: Mapping[str, Candidate], settings: InspectSection) -> Audit | None:
    """Return people's decisions on the random draw of accepted edits; None if there are none."""
    drawn = [candidates[sample_id].inspected for sample_id in draw(candidates, settings)]
    words = [word for word in drawn if word is not None]
    if not words:
        return None
    accepted = sum(it.passed_review for it in candidates.values())
    found = audited(accepted, len(words), sum(word.passed for word in words))
    return found.model_copy(update={"waiting": len(drawn) - len(words)})


def audited(accepted: int, drawn: int, passed: int) -> Audit:
    """Return an audit of `drawn` of `accepted` edits, of which `passed` passed."""
    return Audit(
        accepted=accepted,
        drawn=drawn,
        passed=passed,
        confidence=CONFIDENCE,
        wilson=wilson(passed / drawn, drawn),
        finite_population=finite_population(passed / drawn, drawn, accepted),
    )


def wilson(share: float, n: float) -> Interval:
    """Return the score interval of a share (E. B. Wilson, JASA 22, 1927, p. 209)."""
    z = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    centre, wide = share + z * z / (2 * n), 1 + z * z / n
    half = z * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return max((centre - half) / wide, 0.0), min((centre + half) / wide, 1.0)


def finite_population(share: float, n: int, population: int) -> Interval:
    """Return the same for a draw without replacement: n grows by (N - 1) / (N - n)."""
    if n >= population:
        return share, share
    return wilson(share, n * (population - 1) / (population - n))


def deciders(workshop: Workshop, candidates: Iterable[Candidate]) -> tuple[Decider, ...]:
    """Return who made how many of the standing decisions, by stage; people are numbered by name."""
    models = workshop.settings.models.items()
    digests = {stage: content_digest(workshop.text(model.prompt)) for stage, model in models}
    records = [record for it in candidates for record in it.decisions]
    counts = Counter((it.kind, it.by.model, person_key(it.by.person)) for it in records)
    people = sorted({person for _, model, person in counts if model is None})
    order = sorted(counts, key=lambda key: (list(Kind).index(key[0]), key[1] or "", key[2]))
    return tuple(
        Decider(
            stage=kind.value,
            by=model or f"person {people.index(person) + 1}",
            is_person=model is None,
            decisions=counts[kind, model, person],
            prompt=digests.get(kind, "") if model else "",
        )
        for kind, model, person in order
    )


class PlanRow(Document):
    """A width of the interval, and the smallest draw that reaches it."""

    width: float
    draw: int


class AuditPlan(Document):
    """The precision of draws of several sizes."""

    accepted: int
    share: float
    rows: tuple[PlanRow, ...]


def audit_plan(workshop: Workshop, share: float | None = None) -> AuditPlan:
    """Plan the draw from the edits that the review has accepted.

    The expected share that passes is by default the share so far, else 95 %.

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
    """Return the smallest draw without replacement whose 95 % interval is at most this wide.

    The interval is that of `finite_population`; its width falls as the draw grows.
    """

    def negative_width(drawn: int) -> float:
        low, high = finite_population(share, drawn, population)
        return low - high

    return 1 + bisect_left(range(1, population), -width, key=negative_width)
