"""The split (withheld) and its manifest (public, derived)."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document, content_digest
from exceptiondrive_schemas.submission_files import SampleId, Trajectory, Waypoint
from exceptiondrive_schemas.taxonomy import Strategy

SPLIT_NAME_PATTERN = r"^[a-z0-9][a-z0-9.-]{0,63}$"
SplitName = Annotated[str, Field(pattern=SPLIT_NAME_PATTERN)]


class SplitSample(Document):
    """One sample: its scene, its task and its hazard region."""

    sample_id: SampleId
    scene_id: Annotated[str, Field(min_length=1, max_length=128)]
    task: Annotated[str, Field(max_length=64)]
    region: Annotated[tuple[Waypoint, ...], Field(min_length=4, max_length=4)]
    part: Literal["public", "private"] | None = None
    d_safe_m: Annotated[float, Field(gt=0, le=20)] | None = None
    acceptable: Annotated[tuple[Strategy, ...], Field(min_length=1)] | None = None


class Split(Document):
    """A named set of samples with its withheld regions."""

    schema_: Literal["exceptiondrive.split/1"] = Field(alias="schema")
    name: SplitName
    title: str
    samples: Annotated[tuple[SplitSample, ...], Field(min_length=1)]

    @property
    def revision(self) -> str:
        """Digest of the canonical content, blind to the order of samples."""
        document = self.model_dump(mode="json", by_alias=True, exclude_none=True)
        document["samples"].sort(key=lambda sample: sample["sample_id"])
        return content_digest(document)

    @property
    def has_parts(self) -> bool:
        """Whether samples are parted into public and private ones."""
        return any(sample.part is not None for sample in self.samples)

    def part(self, part: Literal["public", "private"]) -> "Split":
        """Return the samples of a part as a split of its own, with its own revision."""
        chosen = tuple(sample for sample in self.samples if sample.part == part)
        return self.model_copy(update={"samples": chosen})


class SplitRef(Document):
    """Which split, at which revision."""

    name: str
    revision: str


class Manifest(Document):
    """What participants may know of a split: no task, region or scene."""

    schema_: Literal["exceptiondrive.manifest/1"] = Field(alias="schema")
    name: SplitName
    title: str
    revision: str
    waypoints: int
    time_step_s: float
    sample_ids: tuple[SampleId, ...]
    recorded: Mapping[str, Trajectory] | None = Field(
        default=None, exclude_if=lambda it: it is None
    )
    """Sample id to the path that was really driven; left out where that is not public."""

    @property
    def ref(self) -> SplitRef:
        """Name and revision."""
        return SplitRef(name=self.name, revision=self.revision)
