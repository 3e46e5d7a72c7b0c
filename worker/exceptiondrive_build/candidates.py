"""What is true now of every candidate, read from the records alone.

A record of a model counts while the same model would be asked the same words about the same
pictures; a person's, while the pictures are the same. Thresholds are applied when this is read, so
a change of them asks nobody anew.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

from exceptiondrive_build.prompts import Prompts, chat_author, edit_author, scene_words
from exceptiondrive_build.records import Author, Kind, Record, newest
from exceptiondrive_build.scenes.keyframe import Keyframe
from exceptiondrive_build.settings import ReviewSection
from exceptiondrive_build.values import (
    Edited,
    Inspected,
    Localized,
    Mark,
    Reviewed,
    Screened,
    Unanswered,
    Withdrawn,
)
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.taxonomy import Task

Value = TypeVar("Value", bound=Document)


@dataclass(eq=False)
class Candidate:
    """One keyframe and one task, and what has been decided.

    Attributes:
        sample_id: Its id, in the workshop and in a split.
        keyframe: The moment.
        task: The task.
        thresholds: What an edit must reach.
        current: The record that counts now, by kind; of `verify` the newest.
        inspections: All words of people about these pictures, oldest first.
        verifications: All words of people about the region, oldest first.
    """

    sample_id: str
    keyframe: Keyframe
    task: Task
    thresholds: ReviewSection
    current: dict[Kind, Record] = field(default_factory=dict)
    inspections: tuple[Record, ...] = ()
    verifications: tuple[Record, ...] = ()

    @cached_property
    def screened(self) -> Screened | Unanswered | None:
        """Whether the task suits the scene."""
        return self._answer(Kind.SCREEN, Screened)

    @cached_property
    def edited(self) -> Edited | Unanswered | None:
        """The edited pictures."""
        return self._answer(Kind.EDIT, Edited)

    @cached_property
    def reviewed(self) -> Reviewed | Unanswered | None:
        """Marks and measured change."""
        return self._answer(Kind.REVIEW, Reviewed)

    @cached_property
    def inspected(self) -> Inspected | None:
        """The newest word of a person about the pictures."""
        return self._value(Kind.INSPECT, Inspected)

    @cached_property
    def localized(self) -> Localized | None:
        """The proposed region."""
        return self._value(Kind.LOCALIZE, Localized)

    @cached_property
    def withdrawn(self) -> Withdrawn | None:
        """Set where a later revision counts the sample no more."""
        return self._value(Kind.WITHDRAW, Withdrawn)

    @property
    def is_suitable(self) -> bool:
        """Whether screening found that the task suits the scene."""
        return isinstance(self.screened, Screened) and self.screened.suitable

    @cached_property
    def review_faults(self) -> tuple[str, ...]:
        """Codes of the thresholds that the review misses; empty where it meets all."""
        if not isinstance(self.reviewed, Reviewed):
            return ()
        return review_faults(self.reviewed, self.thresholds)

    @property
    def passed_review(self) -> bool:
        """Whether the edit was reviewed and meets every threshold."""
        return isinstance(self.reviewed, Reviewed) and not self.review_faults

    @property
    def is_accepted(self) -> bool:
        """Whether the pictures are good enough: a person's newest word, else the review's."""
        return self.passed_review if self.inspected is None else self.inspected.passed

    @cached_property
    def pictures(self) -> tuple[str, ...]:
        """Digests of what people look at: source, then edited, of each edited view."""
        if not isinstance(self.edited, Edited):
            return ()
        return picture_digests(
            name
            for view, edited in self.edited.images.items()
            for name in (self.keyframe.camera(view).image, edited)
        )

    def _value(self, kind: Kind, value: type[Value]) -> Value | None:
        record = self.current.get(kind)
        return None if record is None else value.model_validate(record.value, strict=False)

    def _answer(self, kind: Kind, value: type[Value]) -> Value | Unanswered | None:
        record = self.current.get(kind)
        if record is not None and record.value is not None and "failure" in record.value:
            return Unanswered.model_validate(record.value)
        return self._value(kind, value)


def picture_digests(names: Iterable[str]) -> tuple[str, ...]:
    """Digests of pictures by their names in the workshop."""
    return tuple(f"sha256:{name.partition('.')[0]}" for name in names)


def walk(workshop: Workshop) -> dict[str, Candidate]:
    """Every candidate of the workshop by sample id: keyframes in their order, tasks in theirs.

    Raises:
        BuildError: Settings, words, scenes or records cannot be read.
    """
    prompts = Prompts(workshop)
    records = {kind: workshop.records.standing(kind) for kind in Kind}
    found: dict[str, Candidate] = {}
    for keyframe in workshop.keyframes.values():
        for task in workshop.tasks:
            sample_id = workshop.sample_id(keyframe.keyframe_id, task.id)
            of_it = {kind: records[kind].get(sample_id, ()) for kind in Kind}
            found[sample_id] = _candidate(workshop, prompts, sample_id, keyframe, task, of_it)
    return found


def _candidate(
    workshop: Workshop,
    prompts: Prompts,
    sample_id: str,
    keyframe: Keyframe,
    task: Task,
    records: dict[Kind, tuple[Record, ...]],
) -> Candidate:
    found = Candidate(sample_id, keyframe, task, workshop.settings.review)

    def look(kind: Kind, inputs: tuple[str, ...], by: Author | None = None) -> None:
        record = newest(records[kind], inputs, by)
        if record is not None:
            found.current[kind] = record

    by, inputs = screen_asked(workshop, prompts, keyframe, task)
    look(Kind.SCREEN, inputs, by)
    if not isinstance(found.screened, Screened) or not found.screened.suitable:
        return found
    by, inputs = edit_asked(workshop, prompts, found, found.screened)
    look(Kind.EDIT, inputs, by)
    if not found.pictures:
        return found
    by, inputs = review_asked(workshop, prompts, found, found.screened)
    look(Kind.REVIEW, inputs, by)
    for kind in (Kind.INSPECT, Kind.LOCALIZE, Kind.VERIFY):
        look(kind, found.pictures)
    found.inspections, found.verifications = (
        tuple(record for record in records[kind] if record.inputs == found.pictures)
        for kind in (Kind.INSPECT, Kind.VERIFY)
    )
    if records[Kind.WITHDRAW]:
        found.current[Kind.WITHDRAW] = records[Kind.WITHDRAW][-1]
    return found


def screen_asked(
    workshop: Workshop, prompts: Prompts, keyframe: Keyframe, task: Task
) -> tuple[Author, tuple[str, ...]]:
    """Who is asked whether the task suits the scene, and the digests of what is shown."""
    words = (prompts.screen(task.id), scene_words(keyframe))
    inputs = picture_digests(camera.image for camera in keyframe.cameras)
    return chat_author(workshop.settings.screen, *words), inputs


def edit_asked(
    workshop: Workshop, prompts: Prompts, candidate: Candidate, screened: Screened
) -> tuple[Author, tuple[str, ...]]:
    """Who is asked to edit the views, and the digests of the sources."""
    words = [prompts.edit(candidate.task.id, view.instruction) for view in screened.views]
    inputs = picture_digests(candidate.keyframe.camera(view.view).image for view in screened.views)
    return edit_author(workshop.settings.edit, *words), inputs


def review_asked(
    workshop: Workshop, prompts: Prompts, candidate: Candidate, screened: Screened
) -> tuple[Author, tuple[str, ...]]:
    """Who is asked for marks, and the digests of the pairs of pictures."""
    words = prompts.review(candidate.task.id, screened)
    return chat_author(workshop.settings.review, words), candidate.pictures


def review_faults(reviewed: Reviewed, settings: ReviewSection) -> tuple[str, ...]:
    """Codes of the thresholds that a review misses.

    `low_mark:<mark>`, `low_mean_mark`; and by measure `target_not_in_view`, `nothing_changed`
    within the target area of any view, `background_changed` outside of it in some view.
    """
    marks = reviewed.marks
    faults = [
        f"low_mark:{mark}"
        for mark in Mark
        if marks[mark] < settings.min_marks.get(mark, settings.min_mark)
    ]
    if sum(marks.values()) < settings.min_mean_mark * len(marks):
        faults.append("low_mean_mark")
    inside = [c.inside for c in reviewed.changes.values() if c.inside is not None]
    if not inside:
        faults.append("target_not_in_view")
    elif max(inside) < settings.min_change_inside:
        faults.append("nothing_changed")
    if any(c.outside > settings.max_change_outside for c in reviewed.changes.values()):
        faults.append("background_changed")
    return tuple(faults)
