"""One stage with a model: ask once about each open candidate, concurrently; keep all answers.

An answer is journalled under the digest of its question before anything is decided, and the
decision is appended after it. A run that is killed loses at most the answers in flight; the next
one asks for those alone. An unusable answer is retried, and recorded as such after the number of
attempts in the settings. Failures of an endpoint or a picture are not recorded: the next run
retries them.
"""

import asyncio
import os
import time
from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from exceptiondrive_build.candidates import Candidate, asked, walk
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.prompts import Prompts
from exceptiondrive_build.records import Kind, Record, now_text
from exceptiondrive_build.settings import ModelSection, Price
from exceptiondrive_build.values import Unanswered
from exceptiondrive_build.workshop import ANSWERS, Workshop
from exceptiondrive_endpoints.asking import ask_all, progress_bar
from exceptiondrive_endpoints.endpoint import Endpoint, EndpointSettings, ModelSettings
from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_endpoints.images import CleanImage, ImageDataError, clean_image
from exceptiondrive_endpoints.journal import Journal, read_journal
from exceptiondrive_schemas.base import Document, content_digest
from exceptiondrive_schemas.printable import counted

MAX_UNUSABLE_TEXT = 20_000
"""Maximum number of characters kept of an unusable answer; usable ones are kept whole."""


class AnswersHeader(Document):
    """First line of a journal of answers."""

    schema_: Literal["exceptiondrive_build-answers/1"] = Field(
        default="exceptiondrive_build-answers/1", alias="schema"
    )
    stage: Kind


class Answer(Document):
    """One question to a model, and the result.

    Attributes:
        key: Digest of the question: model, words, pictures, settings.
        candidate: Sample id.
        part: The view, if a candidate has a question for each.
        prompt: Digest of the prompt.
        asked_at: When the answer arrived, UTC.
        seconds: Duration, including retries and waiting for a slot.
        reason: Why it cannot be used, if so.
        detail: The reason in words.
        text: What the model said.
        image: Name of the edited picture.
        model: The requested model.
        answered_by: The endpoint's name of the model that answered.
        form: The API dialect of the answer.
        prompt_tokens: Tokens in, as the endpoint counts.
        completion_tokens: Tokens out.
    """

    key: str
    candidate: str
    part: str = ""
    prompt: str
    asked_at: str = Field(default_factory=now_text)
    seconds: float
    reason: Reason | None = None
    detail: str | None = None
    text: str | None = None
    image: str | None = None
    model: str
    answered_by: str | None = None
    form: str | None = None
    prompt_tokens: int | None = None
    completion_tokens: int | None = None

    def cost(self, price: Price) -> float:
        """Return the cost of the tokens and pictures received, usable or not."""
        tokens = (self.prompt_tokens or 0) * price.prompt
        tokens += (self.completion_tokens or 0) * price.completion
        had_picture = self.image is not None or self.reason is Reason.WRONG_SIZE
        return tokens / 1e6 + (price.image if had_picture else 0.0)


@dataclass(frozen=True)
class Question:
    """A question to a model about a candidate.

    Attributes:
        key: Digest of all of it.
        words: The prompt.
        images: Names of the pictures shown, in order, by the caption before each.
        part: The view, if a candidate has a question for each.
    """

    key: str
    words: tuple[str, ...]
    images: Mapping[str, str]
    part: str = ""


class Stage(ABC):
    """A stage: its questions, and the decisions made from the answers."""

    kind: ClassVar[Kind]

    def __init__(self, workshop: Workshop) -> None:
        """Read the prompts.

        Raises:
            BuildError: They cannot be read.
        """
        self.workshop = workshop
        self.prompts = Prompts(workshop)

    @property
    def section(self) -> ModelSection:
        """Settings of the model."""
        return self.workshop.settings.models[self.kind]

    @abstractmethod
    def is_open(self, candidate: Candidate) -> bool:
        """Whether the candidate waits for this stage."""

    @abstractmethod
    def questions(self, candidate: Candidate) -> tuple[Question, ...]:
        """Return all questions that must be answered before the candidate can be decided."""

    @abstractmethod
    async def ask(
        self, endpoint: Endpoint, candidate: Candidate, question: Question, known: dict[str, Any]
    ) -> None:
        """Ask, and fill fields of `Answer` into `known` as they become known.

        Raises:
            NoAnswerError: There is no usable answer.
        """

    @abstractmethod
    def value(self, candidate: Candidate, answers: Sequence[Answer]) -> Document:
        """Decide from the answers, which are in the order of the questions.

        Raises:
            NoAnswerError: A picture of the workshop cannot be read.
        """

    def question(self, words: Sequence[str], images: Mapping[str, str], part: str = "") -> Question:
        """Return a question to this stage's model, with its digest."""
        settings = self.section.model_dump(include=_ASKED)
        key = content_digest([self.kind, settings, list(words), list(images.values())])
        return Question(key, tuple(words), images, part)

    def picture(self, name: str) -> CleanImage:
        """Return a picture of the workshop without metadata.

        Raises:
            NoAnswerError: `unreadable_image`: it is missing, damaged, or neither JPEG nor PNG.
        """
        try:
            return clean_image(self.workshop.image(name))
        except BuildError as error:
            raise NoAnswerError(Reason.UNREADABLE_IMAGE, error.sentence) from None
        except ImageDataError as error:
            raise NoAnswerError(Reason.UNREADABLE_IMAGE, f"{name}: {error}") from None


_ASKED = {"model", "temperature", "max_tokens", "extra", "seed", "resample"}
"""The settings that are part of a question; thresholds are not."""


@dataclass(frozen=True)
class Outcome:
    """The result for a candidate in this run."""

    sample_id: str
    reason: Reason | None = None
    detail: str | None = None


class StageReport(Document):
    """The result of one run of a stage."""

    stage: Kind
    decided: int
    recorded_without_answer: int
    failed: dict[str, int]
    first_failures: dict[str, str]
    still_open: int
    calls: int
    requests: int
    prompt_tokens: int
    completion_tokens: int
    seconds: float
    cost: float | None
    currency: str

    @property
    def is_unreachable(self) -> bool:
        """Whether candidates are left open because an endpoint never answered."""
        return any(Reason(reason).is_unreachable for reason in self.failed)

    @property
    def is_in_vain(self) -> bool:
        """Whether questions were asked, and none had a usable answer."""
        return bool(self.failed) and not (self.decided or self.recorded_without_answer)


def read_answers(workshop: Workshop, kind: Kind) -> tuple[Answer, ...]:
    """Return all answers of a stage so far, in the order of their arrival.

    Raises:
        JournalError: The file is not such a journal.
    """
    path = _journal_path(workshop, kind)
    return read_journal(path, AnswersHeader, Answer)[1] if path.is_file() else ()


def awaited(kind: Kind, candidate: Candidate) -> Kind | None:
    """Return the earlier stage that must decide a candidate before this one can, if any."""
    if kind is not Kind.SCREEN and candidate.screened is None:
        return Kind.SCREEN
    is_awaited = kind is Kind.REVIEW and candidate.is_suitable and candidate.edited is None
    return Kind.EDIT if is_awaited else None


def run_stage(stage: Stage, limit: int | None = None) -> StageReport:
    """Ask about every open candidate, or the first `limit` of them.

    Raises:
        BuildError: The workshop cannot be read or written, such as when the disk is full; or all
            that remains waits for an earlier stage.
        EndpointError: The endpoint refuses everything, or is gone; or another run is at this stage.
    """
    workshop = stage.workshop
    header = AnswersHeader(stage=stage.kind)
    with Journal(_journal_path(workshop, stage.kind), header, Answer) as journal:
        candidates = walk(workshop)
        waiting = [it for it in candidates.values() if stage.is_open(it)]
        earlier = [first for it in candidates.values() if (first := awaited(stage.kind, it))]
        if earlier and not waiting:
            raise BuildError(
                f"Nothing can be asked: {counted(len(earlier), 'candidate')} must pass an earlier stage.",
                f"Run first: exceptiondrive-build run {min(earlier, key=list(Kind).index)}",
            )
        run = _Run(stage, journal)
        asyncio.run(run.ask(waiting[:limit]))
        return run.report(len(waiting))


def _journal_path(workshop: Workshop, kind: Kind) -> Path:
    return workshop.folder / ANSWERS / f"{kind}.jsonl"


class _Run:
    def __init__(self, stage: Stage, journal: Journal[AnswersHeader, Answer]) -> None:
        self._stage = stage
        self._journal = journal
        self._n_before = len(journal.lines)
        self._known: dict[str, list[Answer]] = defaultdict(list)
        for answer in journal.lines:
            self._known[answer.key].append(answer)
        self._outcomes: list[Outcome] = []
        self._n_requests = 0
        self._began = time.monotonic()

    async def ask(self, candidates: Sequence[Candidate]) -> None:
        section = self._stage.section
        endpoint_section = self._stage.workshop.settings.endpoints[section.endpoint]
        settings = EndpointSettings(
            base_url=endpoint_section.base_url,
            key=os.environ.get(endpoint_section.key_from),
            timeout_s=endpoint_section.timeout_s,
            max_retries=endpoint_section.max_retries,
            requests_per_minute=endpoint_section.requests_per_minute,
            key_advice=f"Set {endpoint_section.key_from}.",
            address_advice="Correct base_url or model in workshop.toml.",
        )
        model = section.model_dump(include={"model", "temperature", "max_tokens", "extra"})
        async with Endpoint(settings, ModelSettings(**model)) as endpoint:
            with progress_bar(self._stage.kind, len(candidates)) as advance:

                def take(outcome: Outcome) -> None:
                    self._outcomes.append(outcome)
                    advance(outcome)

                decide = partial(self._decide, endpoint)
                has_answered = any(
                    answer.reason is None and answer.model == section.model
                    for answer in self._journal.lines
                )
                await ask_all(
                    candidates,
                    decide,
                    take,
                    endpoint_section.concurrency,
                    has_answered=has_answered,
                )
            self._n_requests = endpoint.n_requests

    async def _decide(self, endpoint: Endpoint, candidate: Candidate) -> Outcome:
        answers = []
        for question in self._stage.questions(candidate):
            answer = await self._answered(endpoint, candidate, question)
            if answer.reason is not None:
                if answer.reason.is_from_model:
                    detail = answer.detail or ""
                    self._record(candidate, Unanswered(failure=answer.reason, detail=detail))
                return Outcome(candidate.sample_id, answer.reason, answer.detail)
            answers.append(answer)
        try:
            value = await asyncio.to_thread(self._stage.value, candidate, answers)
        except NoAnswerError as error:
            return Outcome(candidate.sample_id, error.reason, error.detail)
        self._record(candidate, value)
        return Outcome(candidate.sample_id)

    async def _answered(
        self, endpoint: Endpoint, candidate: Candidate, question: Question
    ) -> Answer:
        """Return the usable answer, or the last unusable one."""
        kept = self._known[question.key]
        for answer in kept:
            if answer.reason is None:
                return answer
        unusable = [a for a in kept if a.reason is not None and a.reason.is_from_model]
        while len(unusable) < self._stage.section.attempts:
            answer = await self._asked(endpoint, candidate, question)
            if answer.reason is None or not answer.reason.is_from_model:
                return answer
            unusable.append(answer)
        return unusable[-1]

    async def _asked(self, endpoint: Endpoint, candidate: Candidate, question: Question) -> Answer:
        known: dict[str, Any] = {
            "key": question.key,
            "candidate": candidate.sample_id,
            "part": question.part,
            "prompt": content_digest(list(question.words)),
            "model": self._stage.section.model,
        }
        began = time.perf_counter()
        try:
            await self._stage.ask(endpoint, candidate, question, known)
        except NoAnswerError as error:
            text = None if error.raw is None else error.raw[:MAX_UNUSABLE_TEXT]
            known |= {"reason": error.reason, "detail": error.detail, "text": text}
        answer = Answer(**known, seconds=round(time.perf_counter() - began, 3))
        self._journal.append(answer)
        self._known[question.key].append(answer)
        return answer

    def _record(self, candidate: Candidate, value: Document) -> None:
        stage = self._stage
        by, inputs = asked(stage.kind, stage.workshop, stage.prompts, candidate)
        stage.workshop.records.append(
            Record(
                kind=stage.kind,
                candidate=candidate.sample_id,
                by=by,
                inputs=inputs,
                value=value.model_dump(mode="json", exclude_none=True),
            )
        )

    def report(self, n_waiting: int) -> StageReport:
        answers = self._journal.lines[self._n_before :]
        settings = self._stage.workshop.settings
        price = settings.prices.get(self._stage.section.model)
        failed = [outcome for outcome in self._outcomes if outcome.reason is not None]
        final = sum(o.reason is not None and o.reason.is_from_model for o in failed)
        decided = len(self._outcomes) - len(failed)
        return StageReport(
            stage=self._stage.kind,
            decided=decided,
            recorded_without_answer=final,
            failed=dict(Counter(str(outcome.reason) for outcome in failed).most_common()),
            first_failures={o.sample_id: f"{o.reason}: {o.detail}" for o in failed[:10]},
            still_open=n_waiting - decided - final,
            calls=len(answers),
            requests=self._n_requests,
            prompt_tokens=sum(answer.prompt_tokens or 0 for answer in answers),
            completion_tokens=sum(answer.completion_tokens or 0 for answer in answers),
            seconds=round(time.monotonic() - self._began, 1),
            cost=None if price is None else round(sum(a.cost(price) for a in answers), 4),
            currency=settings.currency,
        )
