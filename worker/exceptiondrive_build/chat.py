"""Screening and review: a chat model sees pictures, and its answer is checked against a schema."""

import asyncio
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from exceptiondrive_build.asking import Answer, Question, Stage
from exceptiondrive_build.candidates import Candidate
from exceptiondrive_build.measure import UnreadablePictureError, change, read_picture, target_area
from exceptiondrive_build.prompts import scene_words
from exceptiondrive_build.records import Kind
from exceptiondrive_build.values import Change, Edited, Mark, Reviewed, Screened, ViewEdit
from exceptiondrive_endpoints.answers import (
    Schema,
    json_object,
    object_of,
    one_of,
    or_null,
    sentence_of,
)
from exceptiondrive_endpoints.endpoint import Endpoint, Message, picture_part, text_part
from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.printable import printable

MAX_WORDS = 2000
Read = TypeVar("Read", bound=BaseModel)


class _Answered(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore", allow_inf_nan=False)


class _ViewEdit(_Answered):
    view: str
    instruction: str


class _Screened(_Answered):
    suitable: bool
    reason: str | None
    target_ahead_m: float | None
    target_left_m: float | None
    edits: list[_ViewEdit]
    note: str


class _Reviewed(_Answered):
    hazard_correctness: int
    physical_plausibility: int
    visibility: int
    cross_view_consistency: int
    source_preservation: int
    conflict_clarity: int
    note: str


class ChatStage(Stage):
    """A stage with one question to a chat model for each candidate."""

    @abstractmethod
    def schema(self, candidate: Candidate) -> Schema:
        """The schema of the answer."""

    @abstractmethod
    def read(self, candidate: Candidate, text: str) -> Document:
        """Parse the model's text.

        Raises:
            NoAnswerError: `not_json` or `wrong_schema`.
        """

    async def ask(
        self, endpoint: Endpoint, candidate: Candidate, question: Question, known: dict[str, Any]
    ) -> None:
        """Ask once, and check that the answer can be parsed."""
        instructions, *more = question.words
        pictures = await asyncio.to_thread(
            lambda: [self.picture(name) for name in question.images.values()]
        )
        parts = [text_part(text) for text in more]
        for label, picture in zip(question.images, pictures, strict=True):
            parts += [text_part(label), picture_part(picture)]
        messages: list[Message] = [
            {"role": "system", "content": instructions},
            {"role": "user", "content": parts},
        ]
        completion, dialect = await endpoint.complete(
            messages, self.kind.value, self.schema(candidate)
        )
        known |= {"answered_by": completion.model, "form": dialect.form.value}
        if completion.usage is not None:
            known |= completion.usage.model_dump()
        self.read(candidate, completion.text)
        known["text"] = completion.text


class ScreenStage(ChatStage):
    """Decides whether a task suits a scene, where the hazard goes, and what to draw where."""

    kind = Kind.SCREEN

    def is_open(self, candidate: Candidate) -> bool:
        """Whether it has not been screened."""
        return candidate.screened is None

    def questions(self, candidate: Candidate) -> tuple[Question, ...]:
        """One, with all views."""
        words = (self.prompts.screen(candidate.task.id), scene_words(candidate.keyframe))
        views = {f"View {camera.view}:": camera.image for camera in candidate.keyframe.cameras}
        return (self.question(words, views),)

    def schema(self, candidate: Candidate) -> Schema:
        """The schema with the rejection rules of the task and the views of the keyframe."""
        texts, number = self.workshop.task_texts[candidate.task.id], or_null({"type": "number"})
        views = one_of([camera.view for camera in candidate.keyframe.cameras])
        edit = object_of({"view": views, "instruction": {"type": "string"}})
        return object_of(
            {
                "suitable": {"type": "boolean"},
                "reason": or_null(one_of(list(texts.rejections))),
                "target_ahead_m": number,
                "target_left_m": number,
                "edits": {"type": "array", "items": edit},
                "note": {"type": "string"},
            }
        )

    def read(self, candidate: Candidate, text: str) -> Screened:
        """Suitable with a target in the task's range and some view, or rejected by a rule."""
        answer, texts = _read(text, _Screened), self.workshop.task_texts[candidate.task.id]
        if not answer.suitable:
            if answer.reason not in texts.rejections:
                raise _wrong("unsuitable, without the code of a rule", text)
            return Screened(suitable=False, reason=answer.reason, note=_words(answer.note))
        views = [edit.view for edit in answer.edits]
        known = [camera.view for camera in candidate.keyframe.cameras]
        if not views or len(set(views)) < len(views) or not set(views) <= set(known):
            raise _wrong("suitable, without views of the scene, each once", text)
        if not all(edit.instruction.strip() for edit in answer.edits):
            raise _wrong("a view without an instruction", text)
        ahead_m, left_m = answer.target_ahead_m, answer.target_left_m
        if ahead_m is None or left_m is None:
            raise _wrong("suitable, without a target", text)
        for name, value, (low, high) in (
            ("ahead", ahead_m, texts.ahead_m),
            ("left", left_m, texts.left_m),
        ):
            if not low <= value <= high:
                raise _wrong(f"target {value:g} m {name}; asked for {low:g} to {high:g}", text)
        edits = sorted(answer.edits, key=lambda edit: known.index(edit.view))
        return Screened(
            suitable=True,
            target_m=(ahead_m, left_m),
            views=tuple(
                ViewEdit(view=edit.view, instruction=_words(edit.instruction)) for edit in edits
            ),
            note=_words(answer.note),
        )

    def value(self, candidate: Candidate, answers: Sequence[Answer]) -> Screened:
        """The model's answer."""
        return self.read(candidate, answers[0].text or "")


class ReviewStage(ChatStage):
    """Combines the marks of a model with the measured change."""

    kind = Kind.REVIEW

    def is_open(self, candidate: Candidate) -> bool:
        """Whether it suits its scene, is edited and has not been reviewed."""
        is_edited = candidate.is_suitable and isinstance(candidate.edited, Edited)
        return is_edited and candidate.reviewed is None

    def questions(self, candidate: Candidate) -> tuple[Question, ...]:
        """One, with every pair of pictures."""
        words = self.prompts.review(candidate.task.id, _screened(candidate))
        pairs = {}
        for view, edited in _edited(candidate).images.items():
            pairs[f"View {view}, the source:"] = candidate.keyframe.camera(view).image
            pairs[f"View {view}, after the edit:"] = edited
        return (self.question([words], pairs),)

    def schema(self, candidate: Candidate) -> Schema:
        """Six marks and a note."""
        marks: Schema = {mark.value: {"type": "integer"} for mark in Mark}
        return object_of(marks | {"note": {"type": "string"}})

    def read(self, candidate: Candidate, text: str) -> Reviewed:
        """Six marks from 1 to 5; nothing measured yet."""
        answer = _read(text, _Reviewed)
        marks = {mark: getattr(answer, mark.value) for mark in Mark}
        if not all(1 <= value <= 5 for value in marks.values()):
            raise _wrong("a mark that is not from 1 to 5", text)
        return Reviewed(marks=marks, changes={}, note=_words(answer.note))

    def value(self, candidate: Candidate, answers: Sequence[Answer]) -> Reviewed:
        """The model's marks, and the change of every view as measured."""
        said = self.read(candidate, answers[0].text or "")
        return said.model_copy(update={"changes": self._changes(candidate)})

    def _changes(self, candidate: Candidate) -> dict[str, Change]:
        target_m = _screened(candidate).target_m or (0.0, 0.0)
        size_m = self.workshop.task_texts[candidate.task.id].size_m
        found = {}
        for view, edited in _edited(candidate).images.items():
            camera = candidate.keyframe.camera(view)
            try:
                before, after = (
                    read_picture(self.picture(name).data) for name in (camera.image, edited)
                )
            except UnreadablePictureError as error:
                raise NoAnswerError(Reason.UNREADABLE_IMAGE, f"{view}: {error}") from None
            found[view] = change(before, after, target_area(camera, target_m, size_m))
        return found


def _screened(candidate: Candidate) -> Screened:
    assert isinstance(candidate.screened, Screened)
    return candidate.screened


def _edited(candidate: Candidate) -> Edited:
    assert isinstance(candidate.edited, Edited)
    return candidate.edited


def _read(text: str, form: type[Read]) -> Read:
    try:
        return form.model_validate(json_object(text))
    except ValidationError as error:
        raise _wrong(sentence_of(error), text) from None


def _wrong(detail: str, text: str) -> NoAnswerError:
    return NoAnswerError(Reason.WRONG_SCHEMA, detail, text)


def _words(text: str) -> str:
    return printable(text.strip())[:MAX_WORDS]
