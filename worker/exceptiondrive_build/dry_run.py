"""The cost of a stage: calls, pictures, hours, and with a price table money. Nothing is asked.

Time and tokens of a call are the means measured so far with the same model; before the first call
they are guesses, and marked as such.
"""

from collections.abc import Mapping, Sequence
from statistics import fmean

from exceptiondrive_build.asking import (
    Answer,
    Question,
    Stage,
    awaited,
    read_answers,
)
from exceptiondrive_build.candidates import Candidate
from exceptiondrive_build.records import Kind
from exceptiondrive_schemas.base import Document

CHARACTERS_PER_TOKEN = 4
PIXELS_PER_TOKEN = 28 * 28
"""For common vision models, which see a picture in patches of this size."""
GUESSED_COMPLETION_TOKENS = 200


class StagePlan(Document):
    """The cost of running one stage now.

    Attributes:
        candidates: Candidates that wait for it.
        not_ready: Candidates that an earlier stage has not decided yet; they may follow.
        calls: Questions without an answer so far, each counted once.
        pictures: Pictures that would be sent with them.
        hours: From the time of a call, the concurrency and the pace of the endpoint.
        cost: From the price table, if it has the model.
        timed_calls: Number of calls on which times and tokens were measured; 0: they are guesses.
    """

    stage: Kind
    candidates: int
    not_ready: int
    calls: int
    pictures: int
    hours: float
    cost: float | None
    currency: str
    timed_calls: int


def dry_run(
    stage: Stage, candidates: Mapping[str, Candidate], limit: int | None = None
) -> StagePlan:
    """Plan the run that `run_stage` would do.

    Raises:
        BuildError: The workshop cannot be read.
        JournalError: The answers of earlier runs cannot be read.
    """
    workshop, section = stage.workshop, stage.section
    waiting = [it for it in candidates.values() if stage.is_open(it)][:limit]
    answers = read_answers(workshop, stage.kind)
    usable = {answer.key for answer in answers if answer.reason is None}
    to_ask = [
        (candidate, question)
        for candidate in waiting
        for question in stage.questions(candidate)
        if question.key not in usable
    ]
    timed = [a for a in answers if a.model == section.model and a.reason is None]
    call_s = fmean(a.seconds for a in timed) if timed else section.seconds_per_call
    endpoint = workshop.settings.endpoints[section.endpoint]
    seconds = len(to_ask) * call_s / endpoint.concurrency
    if endpoint.requests_per_minute is not None:
        seconds = max(seconds, 60 * len(to_ask) / endpoint.requests_per_minute)
    return StagePlan(
        stage=stage.kind,
        candidates=len(waiting),
        not_ready=sum(awaited(stage.kind, it) is not None for it in candidates.values()),
        calls=len(to_ask),
        pictures=sum(len(question.images) for _, question in to_ask),
        hours=round(seconds / 3600, 3),
        cost=_cost(stage, to_ask, timed),
        currency=workshop.settings.currency,
        timed_calls=len(timed),
    )


def _cost(
    stage: Stage, to_ask: Sequence[tuple[Candidate, Question]], timed: Sequence[Answer]
) -> float | None:
    price = stage.workshop.settings.prices.get(stage.section.model)
    if price is None:
        return None
    if timed:
        return round(len(to_ask) * fmean(answer.cost(price) for answer in timed), 2)
    if stage.kind is Kind.EDIT:
        return round(len(to_ask) * price.image, 2)
    tokens = sum(_tokens(candidate, question) for candidate, question in to_ask)
    completion = GUESSED_COMPLETION_TOKENS * len(to_ask)
    return round((tokens * price.prompt + completion * price.completion) / 1e6, 2)


def _tokens(candidate: Candidate, question: Question) -> float:
    camera = candidate.keyframe.cameras[0]
    pictures = len(question.images) * camera.width_px * camera.height_px / PIXELS_PER_TOKEN
    return sum(map(len, question.words)) / CHARACTERS_PER_TOKEN + pictures
