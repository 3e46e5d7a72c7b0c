"""Ask every unfinished sample once, several at a time, and journal each outcome."""

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from exceptiondrive.agent.endpoint import Endpoint
from exceptiondrive.agent.errors import EndpointGoneError, NoAnswerError, Reason
from exceptiondrive.agent.images import ImagePaths, load_images
from exceptiondrive.agent.journal import MAX_RAW_CHARACTERS, JournalLine
from exceptiondrive.agent.prompts import Message, messages
from exceptiondrive.agent.question import Question

GIVE_UP_AFTER = 20

Ask = Callable[[str], Awaitable[JournalLine]]
Take = Callable[[JournalLine], None]


async def ask_sample(
    sample_id: str, question: Question, images: ImagePaths, endpoint: Endpoint
) -> JournalLine:
    """Ask one sample; whatever keeps it from an answer becomes the line's reason."""
    known: dict[str, Any] = {
        "sample_id": sample_id,
        "given_reminder_digest": question.given_reminder_digest(sample_id),
    }
    try:
        request = await asyncio.to_thread(_request, sample_id, question, images)
        completion, dialect = await endpoint.complete(request, question.name, question.schema)
        known |= {"model": completion.model, "form": dialect.form.value}
        if completion.usage is not None:
            known |= completion.usage.model_dump()
        return JournalLine(**known, **question.read(completion.text))
    except NoAnswerError as error:
        raw = None if error.raw is None else error.raw[:MAX_RAW_CHARACTERS]
        return JournalLine(**known, reason=error.reason, detail=error.detail, raw=raw)


def _request(sample_id: str, question: Question, images: ImagePaths) -> list[Message]:
    loaded = load_images(images.get(sample_id, ()))
    if question.views and len(question.views) != len(loaded):
        detail = f"{len(question.views)} views are named, the sample has {len(loaded)} images"
        raise NoAnswerError(Reason.WRONG_IMAGE_COUNT, detail)
    reminder = question.reminders.get(sample_id)
    return messages(question.instructions, loaded, question.views, reminder)


async def ask_all(sample_ids: Iterable[str], ask: Ask, take: Take, concurrency: int) -> None:
    """Ask the samples in order, at most `concurrency` at a time; hand each line to `take`.

    Raises:
        ExceptionDriveError: The endpoint refuses the run, or failed for 20 samples in a row.
    """
    queue = iter(sample_ids)
    watch = _Watch()

    async def work() -> None:
        for sample_id in queue:
            line = await ask(sample_id)
            take(line)
            watch.note(line)

    try:
        async with asyncio.TaskGroup() as group:
            for _ in range(concurrency):
                group.create_task(work())
    except ExceptionGroup as errors:
        raise errors.exceptions[0] from None


class _Watch:
    """Stops a run whose endpoint has gone, before every sample has waited for it in vain."""

    def __init__(self) -> None:
        self._failures_in_a_row = 0

    def note(self, line: JournalLine) -> None:
        failed = line.reason is not None and line.reason.is_from_endpoint
        self._failures_in_a_row = self._failures_in_a_row + 1 if failed else 0
        if self._failures_in_a_row >= GIVE_UP_AFTER:
            raise EndpointGoneError(
                f"The endpoint failed for {GIVE_UP_AFTER} samples in a row, the last time with: "
                f"{line.detail}."
            )
