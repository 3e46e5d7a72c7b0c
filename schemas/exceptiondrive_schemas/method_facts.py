"""Facts about a method from its team: type, sensors, data, size, speed. All of them are optional.

One schema serves the file of `submit --facts`, its options, the form, the API, the pages and the
exports. Facts are unverified and do not affect a score. They may change after a board was
published, so boards do not contain them: whoever shows a board adds the present facts.
"""

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic.config import JsonDict

from exceptiondrive_schemas.base import Document

MethodType = Literal[
    "end_to_end", "modular", "vla", "vlm_zero_shot", "vlm_tuned", "world_model", "rule", "other"
]
Sensor = Literal["front_camera", "surround_cameras", "lidar", "radar", "gnss_imu", "ego_state"]
YesNo = Literal["yes", "no"]

LABELS: Mapping[str, Mapping[str, str]] = {
    "type": {
        "end_to_end": "End-to-end",
        "modular": "Modular",
        "vla": "VLA",
        "vlm_zero_shot": "VLM, zero-shot",
        "vlm_tuned": "VLM, fine-tuned",
        "world_model": "World model",
        "rule": "Rule-based",
        "other": "Other",
    },
    "sensors": {
        "front_camera": "Front camera",
        "surround_cameras": "Surround cameras",
        "lidar": "Lidar",
        "radar": "Radar",
        "gnss_imu": "GNSS/IMU",
        "ego_state": "Ego state",
    },
    "map": {"none": "No map", "sd": "Navigation map", "hd": "HD map"},
    "extra_data": {
        "none": "No extra data",
        "public": "Public extra data",
        "private": "Private extra data",
    },
    "open_code": {"yes": "Open code", "no": "Closed code"},
    "open_weights": {"yes": "Open weights", "no": "Closed weights"},
}
"""The label of each value, by field: the words of form, page and filter."""


def _each_once(sensors: tuple[Sensor, ...]) -> tuple[Sensor, ...]:
    return tuple(sensor for sensor in LABELS["sensors"] if sensor in sensors)


def _choice_titles(name: str) -> JsonDict:
    """Return the titles of the choices for a form that is made from the JSON Schema."""
    return {"x-titles": dict(LABELS[name])}


class Links(Document):
    """Where a method is described; https only."""

    paper: str | None = None
    code: str | None = None


class MethodFacts(Document):
    """Facts of a method, each of which may be left out."""

    type: MethodType | None = Field(
        default=None,
        title="Type",
        description="What kind of planner or agent it is.",
        json_schema_extra=_choice_titles("type"),
    )
    type_note: str = Field(
        default="", max_length=60, title="Type in words", description="Where no type fits."
    )
    sensors: Annotated[tuple[Sensor, ...], AfterValidator(_each_once)] = Field(
        default=(),
        strict=False,
        title="Sensors",
        description="What it looks at.",
        json_schema_extra=_choice_titles("sensors"),
    )
    map: Literal["none", "sd", "hd"] | None = Field(
        default=None,
        title="Map",
        description="Which map it uses.",
        json_schema_extra=_choice_titles("map"),
    )
    extra_data: Literal["none", "public", "private"] | None = Field(
        default=None,
        title="Extra data",
        description="Driving data beyond what the benchmark gives, in training or prompts.",
        json_schema_extra=_choice_titles("extra_data"),
    )
    extra_data_note: str = Field(
        default="", max_length=200, title="Which extra data", description="Names of data sets."
    )
    open_code: YesNo | None = Field(
        default=None,
        title="Open code",
        description="Whether anyone can read the code.",
        json_schema_extra=_choice_titles("open_code"),
    )
    open_weights: YesNo | None = Field(
        default=None,
        title="Open weights",
        description="Whether anyone can have the weights.",
        json_schema_extra=_choice_titles("open_weights"),
    )
    parameters_millions: float | None = Field(
        default=None,
        ge=0.001,
        le=100_000_000,
        title="Parameters in millions",
        description="7000 for seven billion.",
    )
    hardware: str = Field(
        default="", max_length=120, title="Hardware", description="On which it ran."
    )
    time_per_sample_s: float | None = Field(
        default=None,
        ge=0.000_001,
        le=1_000_000,
        title="Seconds a sample",
        description="On that hardware, mean over the samples.",
    )

    @property
    def tag(self) -> str:
        """The type in a word or two; empty if not given."""
        if self.type == "other" or self.type is None:
            return self.type_note or _label("type", self.type)
        return _label("type", self.type)

    @property
    def lines(self) -> tuple[tuple[str, str], ...]:
        """Title and words of each given fact, in the order of the form."""
        words = {
            "type": self.tag,
            "sensors": ", ".join(_label("sensors", sensor) for sensor in self.sensors),
            "map": _label("map", self.map),
            "extra_data": ": ".join(
                filter(None, (_label("extra_data", self.extra_data), self.extra_data_note))
            ),
            "open_code": (self.open_code or "").capitalize(),
            "open_weights": (self.open_weights or "").capitalize(),
            "parameters_millions": size_words(self.parameters_millions),
            "hardware": self.hardware,
            "time_per_sample_s": ""
            if self.time_per_sample_s is None
            else f"{self.time_per_sample_s:g} s",
        }
        titles = {name: str(type(self).model_fields[name].title) for name in words}
        titles |= {"parameters_millions": "Parameters", "time_per_sample_s": "Time per sample"}
        return tuple((titles[name], said) for name, said in words.items() if said)

    @property
    def cells(self) -> dict[str, str | float | None]:
        """One cell per field, for tables: several values in one cell are separated by a blank."""
        told = self.model_dump()
        return {**told, "sensors": " ".join(self.sensors)}


Told = str | float | tuple[str, ...] | None


class EditChanges(Document):
    """What one edit changed: before and after of each field, `facts.map` for a fact."""

    changed: dict[str, tuple[Told, Told]]


class SubmissionChange(Document):
    """What a team wants to say of a submission from now on; what is left out stays.

    Of the facts, too, only those that are sent are changed; null, or an empty text, takes one away.
    """

    method: str | None = Field(default=None, min_length=1, max_length=80)
    description: str | None = Field(default=None, max_length=2000)
    paper_url: str | None = Field(default=None, max_length=500)
    code_url: str | None = Field(default=None, max_length=500)
    facts: MethodFacts | None = None
    replace: bool = False
    """Let a new name that is another method's take an entry of the team off the board; else the answer is
    `not_confirmed`, and nothing is changed."""


class SubmissionEditView(EditChanges):
    """One edit as the team and the organizers see it."""

    edited_at: datetime
    by: str
    """Who: a member, a token and its team, or the team."""


class EntryFacts(Document):
    """What a team tells of an entry now, and when it last changed name, words, links or facts."""

    facts: MethodFacts = MethodFacts()
    edited_at: datetime | None = None


FactsOfBoard = Mapping[str, EntryFacts]
"""Facts by submission; entries without facts are left out."""
NO_FACTS: FactsOfBoard = {}


class PhaseFacts(Document):
    """The facts of the entries on a board as they are now, by submission.

    An entry that tells nothing is left out.
    """

    phase: str
    board: int
    changed_at: datetime | None
    """When a team of the phase last edited an entry."""
    entries: dict[str, EntryFacts]


def size_words(parameters_millions: float | None) -> str:
    """Write a size in the usual form: `350 M`, `7 B`, `1.2 T`; empty if not given."""
    if parameters_millions is None:
        return ""
    for unit, millions in (("T", 1e6), ("B", 1e3)):
        if parameters_millions >= millions:
            return f"{parameters_millions / millions:.4g} {unit}"
    return f"{parameters_millions:.4g} M"


def _label(name: str, value: str | None) -> str:
    return LABELS[name][value] if value is not None else ""
