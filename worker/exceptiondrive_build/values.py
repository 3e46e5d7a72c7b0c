"""The decision of each kind of record: the documents in `Record.value`."""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.submission_files import Waypoint

MAX_REASON_LENGTH = 500
"""Maximum length of the reason of a withdrawal, as in split files."""
Corners = tuple[Waypoint, Waypoint, Waypoint, Waypoint]


class Mark(StrEnum):
    """The criteria for an edit, from 1 (bad) to 5 (good)."""

    HAZARD_CORRECTNESS = "hazard_correctness"
    PHYSICAL_PLAUSIBILITY = "physical_plausibility"
    VISIBILITY = "visibility"
    CROSS_VIEW_CONSISTENCY = "cross_view_consistency"
    SOURCE_PRESERVATION = "source_preservation"
    CONFLICT_CLARITY = "conflict_clarity"


class Unanswered(Document):
    """A model was asked as often as the settings allow, and gave no usable answer."""

    failure: str
    detail: str


class ViewEdit(Document):
    """One view to edit, and the instruction for the editing model."""

    view: str
    instruction: str


class Screened(Document):
    """Whether the task suits the scene; if so, where, and which views to edit.

    Attributes:
        reason: Code of the rejection rule, if it does not.
        target_m: Place of the hazard in metres ahead and left of the rear axle.
        views: Views in which the hazard is visible.
    """

    suitable: bool
    reason: str | None = None
    target_m: Waypoint | None = None
    views: tuple[ViewEdit, ...] = ()
    note: str = ""


class Edited(Document):
    """The edited picture of each view, by name in the workshop's `images` folder."""

    images: dict[str, str]


class Change(Document):
    """How much a view changed: 1 - structural similarity, mean over the pixels of the area.

    Attributes:
        inside: Within the target area as projected into the view; none if it is not in view.
        outside: Everywhere else.
    """

    inside: float | None = None
    outside: float


class Reviewed(Document):
    """The model's marks, and the measured change of each view."""

    marks: dict[Mark, Annotated[int, Field(ge=1, le=5)]]
    changes: dict[str, Change]
    note: str = ""


class Inspected(Document):
    """A person's decision on the pictures of a candidate: whether they show what they should."""

    passed: bool
    reason: Mark | None = None
    note: str = ""


class Localized(Document):
    """A proposal for the region: four corners in order around it, ego frame, metres.

    Attributes:
        source: `detector`, or `by_hand` for a rectangle at the target that is to be moved.
        score: The detector's confidence.
    """

    corners: Corners
    source: Literal["detector", "by_hand"]
    score: float | None = None


Checked = Literal["location", "views", "calibration", "task"]


class Verified(Document):
    """A person's decision on the region: accepted with these corners, or rejected.

    Attributes:
        checked: Which of the four checks were made: the intended location, the views, the
            calibration, the task.
        reason: The check that a rejection is for.
        blind: Whether the person decided without seeing others' decisions, unlike a third reader.
    """

    accepted: bool
    corners: Corners | None = None
    checked: tuple[Checked, ...] = ()
    reason: Checked | None = None
    note: str = ""
    blind: bool = True


class Withdrawn(Document):
    """A sample that a later revision no longer counts, and why, in words for readers."""

    reason: Annotated[str, Field(min_length=1)]
