"""The numbers of a workshop: progress of the candidates, quality of the pictures, and cost.

All of it is computed from records and answers each time. Nothing here names a region or a sample.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from itertools import pairwise
from typing import Annotated

from pydantic import Field

from exceptiondrive_build.agreement import agreement, outcome, readings, readings_left
from exceptiondrive_build.asking import Stage, read_answers
from exceptiondrive_build.candidates import Candidate, walk
from exceptiondrive_build.dry_run import StagePlan, dry_run
from exceptiondrive_build.inspection import to_inspect
from exceptiondrive_build.numbers import audit, cells, is_verified
from exceptiondrive_build.records import Kind, person_key, standing
from exceptiondrive_build.settings import VerifySection
from exceptiondrive_build.stages import STAGES
from exceptiondrive_build.values import Edited, Mark, Reviewed, Screened, Unanswered
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.datasheet import Agreement, Audit, Cell

PAUSE_S = 300.0
"""A longer gap between two decisions of a person counts as a pause, not as work."""
NO_REASON = "no_reason"


class Line(Document):
    """A count, and its share of the total."""

    id: str
    title: str
    n: int
    of: int

    @property
    def percent(self) -> float | None:
        """The share in per cent, two decimals; None if the total is 0."""
        return round(100 * self.n / self.of, 2) if self.of else None


class Spent(Document):
    """Cost of a stage so far, and of what remains.

    Attributes:
        calls: Answers so far, usable or not.
        hours: Sum of the calls' times; several run at once.
        cost: From the price table, if it has the model.
        left: The open part, as computed by a dry run.
    """

    stage: Kind
    calls: int
    hours: float
    prompt_tokens: int
    completion_tokens: int
    cost: float | None
    left: StagePlan


class People(Document):
    """What people decided by hand at a stage and did not take back; its duration; what is open."""

    stage: Kind
    decisions: int
    hours: float
    open: int
    hours_left: float | None


class Report(Document):
    """All numbers of a workshop."""

    name: str
    funnel: tuple[Line, ...]
    rejected_because: dict[str, int]
    unsuitable_because: dict[str, int]
    without_answer: dict[str, int]
    families: tuple[Cell, ...]
    tasks: tuple[Cell, ...]
    marks: dict[Mark, Annotated[tuple[int, ...], Field(min_length=5, max_length=5)]]
    audit: Audit | None
    agreement: Agreement | None
    spent: tuple[Spent, ...]
    people: tuple[People, ...]
    currency: str
    notes: tuple[str, ...]

    def line(self, line_id: str) -> Line:
        """Return a line of the funnel by its id."""
        return next(line for line in self.funnel if line.id == line_id)


def report(workshop: Workshop) -> Report:
    """Count everything.

    Raises:
        BuildError: The workshop cannot be read.
        JournalError: The answers cannot be read.
    """
    candidates = walk(workshop)
    everything = candidates.values()
    settings, taxonomy = workshop.settings, workshop.protocol.taxonomy
    used = {task.id for task in workshop.tasks}
    funnel = _funnel(workshop, candidates)
    verifications = {key: c.verifications for key, c in candidates.items() if c.verifications}
    return Report(
        name=settings.name,
        funnel=funnel,
        rejected_because=_counted(
            code for c in everything for code in _rejections(c, settings.verify)
        ),
        unsuitable_because=_counted(
            f"{c.task.id} {c.screened.reason}"
            for c in everything
            if isinstance(c.screened, Screened) and not c.screened.suitable
        ),
        without_answer=_counted(
            f"{kind} {value.failure}"
            for c in everything
            for kind, value in (
                (Kind.SCREEN, c.screened),
                (Kind.EDIT, c.edited),
                (Kind.REVIEW, c.reviewed),
            )
            if isinstance(value, Unanswered)
        ),
        families=cells(taxonomy.families, everything, ()),
        tasks=cells([task for task in taxonomy.tasks if task.id in used], everything, ()),
        marks=_marks(everything),
        audit=audit(candidates, settings.inspect),
        agreement=agreement(verifications, settings.verify) if verifications else None,
        spent=tuple(_spent(stage(workshop), candidates) for stage in STAGES.values()),
        people=_people(workshop, candidates),
        currency=settings.currency,
        notes=_notes(settings.printed_family_shares, funnel),
    )


def _funnel(workshop: Workshop, candidates: Mapping[str, Candidate]) -> tuple[Line, ...]:
    """Return counts by the review alone, then by people's decisions; and the auxiliary set."""
    everything = candidates.values()
    screened = sum(c.screened is not None for c in everything)
    suitable = [c for c in everything if c.is_suitable]
    edited = [c for c in suitable if isinstance(c.edited, Edited)]
    reviewed = [c for c in edited if isinstance(c.reviewed, Reviewed)]
    accepted = [c for c in reviewed if c.passed_review]
    rejected = len(reviewed) - len(accepted)
    audited = audit(candidates, workshop.settings.inspect)
    kept = [c for c in suitable if c.is_accepted]
    located = [c for c in kept if c.localized is not None]
    verified = sum(is_verified(c, workshop.settings.verify) for c in located)
    drawn = sum(not c.is_suitable and isinstance(c.edited, Edited) for c in everything)
    pairs = len(accepted) + drawn + rejected
    inspected, passed = (audited.drawn, audited.passed) if audited else (0, 0)
    rows = (
        ("combinations", "scene and task combinations", len(candidates), len(candidates)),
        ("screened", "screened", screened, len(candidates)),
        ("suitable", "suitable", len(suitable), len(candidates)),
        ("edited", "edited in every view", len(edited), len(suitable)),
        ("reviewed", "reviewed", len(reviewed), len(edited)),
        ("accepted", "accepted by the review", len(accepted), len(suitable)),
        ("rejected", "rejected by the review", rejected, len(suitable)),
        ("inspected", "of the accepted, drawn and inspected", inspected, len(accepted)),
        ("passed", "of these, passed", passed, inspected),
        ("kept", "accepted after people's words", len(kept), len(suitable)),
        ("localized", "with a proposed region", len(located), len(kept)),
        ("verified", "with a verified region", verified, len(located)),
        ("drawn", "auxiliary, drawn and edited", drawn, pairs),
        ("auxiliary", "auxiliary, with those that the review rejected", drawn + rejected, pairs),
        ("pairs", "source and edited pairs in all", pairs, pairs),
    )
    return tuple(Line(id=key, title=title, n=n, of=of) for key, title, n, of in rows)


def _rejections(candidate: Candidate, limits: VerifySection) -> Iterator[str]:
    """Yield rejection codes: from the review; from people `inspected:<mark>`, `region:<check>`."""
    yield from candidate.review_faults
    if candidate.inspected is not None and not candidate.inspected.passed:
        yield f"inspected:{candidate.inspected.reason or NO_REASON}"
    if outcome(candidate.verifications, limits).state == "rejected":
        words = [word for _, word in readings(candidate.verifications) if not word.accepted]
        yield from {f"region:{word.reason or NO_REASON}" for word in words}


def _counted(codes: Iterable[str]) -> dict[str, int]:
    return dict(sorted(Counter(codes).items(), key=lambda item: (-item[1], item[0])))


def _marks(candidates: Iterable[Candidate]) -> dict[Mark, tuple[int, ...]]:
    counts = {mark: [0] * 5 for mark in Mark}
    for candidate in candidates:
        if isinstance(candidate.reviewed, Reviewed):
            for mark, value in candidate.reviewed.marks.items():
                counts[mark][value - 1] += 1
    return {mark: tuple(found) for mark, found in counts.items()}


def _spent(stage: Stage, candidates: Mapping[str, Candidate]) -> Spent:
    answers = read_answers(stage.workshop, stage.kind)
    prices = stage.workshop.settings.prices
    models = {answer.model for answer in answers}
    cost = sum(a.cost(prices[a.model]) for a in answers) if models <= prices.keys() else None
    return Spent(
        stage=stage.kind,
        calls=len(answers),
        hours=round(sum(answer.seconds for answer in answers) / 3600, 3),
        prompt_tokens=sum(answer.prompt_tokens or 0 for answer in answers),
        completion_tokens=sum(answer.completion_tokens or 0 for answer in answers),
        cost=None if cost is None else round(cost, 2),
        left=dry_run(stage, candidates),
    )


def _people(workshop: Workshop, candidates: Mapping[str, Candidate]) -> tuple[People, ...]:
    settings = workshop.settings
    open_pictures = sum(
        candidates[sample_id].inspected is None
        for sample_id in to_inspect(candidates, settings.inspect)
    )
    open_regions = sum(
        readings_left(candidate.verifications, settings.verify)
        for candidate in candidates.values()
        if candidate.is_accepted and candidate.localized is not None and candidate.withdrawn is None
    )
    found = []
    for kind, left in ((Kind.INSPECT, open_pictures), (Kind.VERIFY, open_regions)):
        times: dict[str, list[float]] = defaultdict(list)
        records = tuple(workshop.records.read(kind))
        for record in (it for it in records if it.value is not None):
            times[person_key(record.by.person)].append(
                datetime.fromisoformat(record.at).timestamp()
            )
        decisions = sum(map(len, standing(records).values()))
        gaps = [b - a for one in times.values() for a, b in pairwise(sorted(one))]
        worked = [gap for gap in gaps if gap <= PAUSE_S]
        hours_left = left * sum(worked) / len(worked) / 3600 if worked else None
        found.append(
            People(
                stage=kind,
                decisions=decisions,
                hours=round(sum(worked) / 3600, 3),
                open=left,
                hours_left=None if hours_left is None else round(hours_left, 3),
            )
        )
    return tuple(found)


def _notes(printed: Mapping[str, float], funnel: Sequence[Line]) -> tuple[str, ...]:
    """Find totals of which the printed family shares can be shares, by whole numbers."""
    if not printed:
        return ()
    totals = {line.n: line.title for line in funnel if line.id in _TOTALS and line.n}
    fits = [n for n in totals if shares_fit(printed.values(), n)]
    which = " or ".join(f"the {n:,} {totals[n]}" for n in fits) or "none of these totals"
    others = ", ".join(f"the {n:,} {totals[n]}" for n in totals if n not in fits)
    rest = f"; no whole numbers of {others}" if others else ""
    return (f"The printed family shares fit {which}{rest}.",)


_TOTALS = ("accepted", "auxiliary", "pairs")


def shares_fit(percents: Iterable[float], total: int) -> bool:
    """Whether whole numbers that sum to `total` print as these shares of it, to two decimals."""
    least, most = 0, 0
    for percent in percents:
        near = round(percent * total / 100)
        possible = [
            n for n in range(near - 2, near + 3) if abs(100 * n / total - percent) <= 0.005 + 1e-9
        ]
        if not possible:
            return False
        least, most = least + min(possible), most + max(possible)
    return least <= total <= most
