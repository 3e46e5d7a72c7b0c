"""`workshop.toml` as a model: tasks in use, prompt files, endpoints by name, thresholds."""

from datetime import date
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from exceptiondrive_build.values import Mark
from exceptiondrive_endpoints.settings import checked_address, checked_fields
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.datasheet import Words
from exceptiondrive_schemas.split import SplitName

MIN_KEY_LENGTH = 32
Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]
MarkValue = Annotated[int, Field(ge=1, le=5)]


class EndpointSection(Document):
    """Address of an OpenAI-compatible endpoint, and its rate limits."""

    base_url: Annotated[str, AfterValidator(checked_address)]
    key_from: str = Field(
        default="EXCEPTIONDRIVE_BUILD_KEY", description="environment variable that holds its key"
    )
    concurrency: Annotated[int, Field(ge=1, le=256)] = 4
    requests_per_minute: Positive | None = None
    timeout_s: Positive = 120.0
    max_retries: Annotated[int, Field(ge=0, le=100)] = 5


class ModelSection(Document):
    """The model, its endpoint, and its prompts."""

    endpoint: str
    model: str
    prompt: str = Field(description="file in the workshop")
    extra: Annotated[dict[str, Any], AfterValidator(checked_fields)] = Field(
        default_factory=dict, description="more fields of the request"
    )
    attempts: Annotated[int, Field(ge=1, le=10)] = Field(
        default=2, description="how often it is asked before an unusable answer is recorded as such"
    )
    seconds_per_call: Positive = Field(
        default=10.0, description="guess for a dry run, until calls have been timed"
    )


class ChatSection(ModelSection):
    """A model that sees pictures and answers in text."""

    temperature: Annotated[float, Field(ge=0, le=2)] = 0.0
    max_tokens: Annotated[int, Field(ge=1)] = 1500


class EditSection(ModelSection):
    """The editing model."""

    seed: int = 1
    resample: bool = Field(
        default=True,
        description="scale an edited picture of the same shape but another size to the source's",
    )


class ReviewSection(ChatSection):
    """The reviewing model, and the thresholds of an edit. Changing these asks no model again."""

    min_mark: MarkValue = Field(default=3, description="least of any mark")
    min_marks: dict[Mark, MarkValue] = Field(
        default_factory=dict, description="least of single marks"
    )
    min_mean_mark: Annotated[float, Field(ge=1, le=5)] = 3.5
    min_change_inside: Share = Field(
        default=0.05, description="1 - structural similarity within the target area, in some view"
    )
    max_change_outside: Share = Field(
        default=0.2, description="1 - structural similarity outside of it, in every view"
    )


class InspectSection(Document):
    """What people inspect."""

    low_mark: MarkValue = Field(default=3, description="a mark of at most this is looked at")
    draw: Annotated[int, Field(ge=0)] = Field(
        default=168, description="accepted edits that are drawn at random"
    )
    seed: int = 1
    by_family: bool = Field(default=False, description="draw from each family by its share")


class AuxiliarySection(Document):
    """Pairs that are edited although the screening did not choose them."""

    draw: Annotated[int, Field(ge=0)] = 0
    seed: int = 1


class LocalizeSection(Document):
    """Which of a detector's boxes may become a region."""

    max_distance_m: Positive = Field(default=8.0, description="from the target to its centre")
    min_score: Share = 0.0


class VerifySection(Document):
    """How far two readings may differ before a third person decides."""

    min_iou: Share = 0.7
    max_corner_distance_m: Positive = 1.0


class FreezeSection(Document):
    """What goes into the split beside the regions."""

    recorded: bool = Field(default=True, description="the path that was really driven")
    recorded_is_public: bool = Field(
        default=False, description="the manifest tells it to participants"
    )
    pictures: bool = Field(
        default=False,
        description="the first camera's pictures of each sample lie beside it; needs `licence`",
    )
    controls: tuple[str, ...] = Field(
        default=(), description="sample ids whose region no good driver would heed"
    )
    public_part: tuple[str, ...] = Field(
        default=(),
        description="sample ids of the public part; the rest is private. Empty: no parts",
    )


class DatasheetSection(Words):
    """Texts for readers, in the organizers' own words."""

    examples: tuple[str, ...] = Field(
        default=(), description="sample ids whose pictures are shown; needs `licence`"
    )

    @field_validator("url", "licence_url")
    @classmethod
    def _is_an_address(cls, text: str) -> str:
        return checked_address(text) if text else text

    @field_validator("published")
    @classmethod
    def _is_a_day(cls, text: str) -> str:
        try:
            return date.fromisoformat(text).isoformat() if text else text
        except ValueError:
            raise ValueError(f"expected a day such as 2026-11-22, got {text!r}") from None


class Price(Document):
    """The price of a model, in the currency of the workshop."""

    prompt: Annotated[float, Field(ge=0)] = Field(default=0.0, description="a million tokens in")
    completion: Annotated[float, Field(ge=0)] = Field(default=0.0, description="a million out")
    image: Annotated[float, Field(ge=0)] = Field(default=0.0, description="an edited picture")


class WorkshopSettings(Document):
    """The whole file."""

    schema_: Literal["exceptiondrive.workshop/1"] = Field(alias="schema")
    name: SplitName
    title: str
    licence: str = Field(default="", description="of the pictures; empty: they are not shown")
    id_key: Annotated[str, Field(min_length=MIN_KEY_LENGTH)] = Field(
        description="keeps sample ids from telling keyframe and task; never published"
    )
    protocol: str = Field(default="", description="file with the taxonomy; by default the newest")
    task_texts: str = Field(default="tasks.toml", description="file with the words of each task")
    tasks: tuple[str, ...] = Field(default=(), description="ids of those in use; empty: all")
    endpoints: dict[str, EndpointSection]
    screen: ChatSection
    edit: EditSection
    review: ReviewSection
    inspect: InspectSection = InspectSection()
    auxiliary: AuxiliarySection = AuxiliarySection()
    localize: LocalizeSection = LocalizeSection()
    verify: VerifySection = VerifySection()
    freeze: FreezeSection = FreezeSection()
    datasheet: DatasheetSection = DatasheetSection()
    printed_family_shares: dict[str, float] = Field(
        default_factory=dict,
        description="per cent by family as a paper prints them; the report says what they fit",
    )
    currency: str = "USD"
    prices: dict[str, Price] = Field(default_factory=dict, description="by name of the model")

    @model_validator(mode="after")
    def _endpoints_are_there(self) -> Self:
        for stage, model in self.models.items():
            if model.endpoint not in self.endpoints:
                raise ValueError(
                    f"[{stage}] names the endpoint {model.endpoint!r}, which is not there"
                )
        return self

    @property
    def models(self) -> dict[str, ModelSection]:
        """The model that is asked at each stage."""
        return {"screen": self.screen, "edit": self.edit, "review": self.review}


class TaskTexts(Document):
    """Texts for the models about a task, and where its hazard may be.

    Attributes:
        suitable: When a scene suits it.
        rejections: When it does not: code of each rule, and its text.
        edit: What is to be drawn into the picture.
        ahead_m: Least and greatest distance of the target ahead of the rear axle.
        left_m: Least and greatest distance of the target to its left.
        size_m: Length, width and height of the space that the hazard takes.
    """

    suitable: str
    rejections: Annotated[dict[str, str], Field(min_length=1)]
    edit: str
    ahead_m: tuple[float, float] = (6.0, 45.0)
    left_m: tuple[float, float] = (-8.0, 8.0)
    size_m: tuple[Positive, Positive, Positive] = (5.0, 3.0, 2.0)
