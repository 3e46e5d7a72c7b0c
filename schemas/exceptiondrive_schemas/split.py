"""The split (withheld) and its manifest (public, derived)."""

from collections.abc import Mapping
from functools import cached_property
from operator import attrgetter, itemgetter
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, model_validator

from exceptiondrive_schemas.base import Document, content_digest, in_words
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_schemas.python310 import Self
from exceptiondrive_schemas.submission_files import SampleId, Trajectory, Waypoint
from exceptiondrive_schemas.taxonomy import Strategy

SPLIT_NAME_PATTERN = r"^[a-z0-9][a-z0-9.-]{0,63}$"
SplitName = Annotated[str, Field(pattern=SPLIT_NAME_PATTERN)]


class SplitSample(Document):
    """One sample: its scene, its task and its hazard region.

    Every sample is answered by files. A control and a withdrawn sample count in no number of
    samples and no mean; which samples these are is withheld.
    """

    sample_id: SampleId
    scene_id: Annotated[str, Field(min_length=1, max_length=128)]
    task: Annotated[str, Field(max_length=64)]
    region: Annotated[tuple[Waypoint, ...], Field(min_length=4, max_length=4)]
    part: Literal["public", "private"] | None = None
    d_safe_m: Annotated[float, Field(gt=0, le=20)] | None = None
    acceptable: Annotated[tuple[Strategy, ...], Field(min_length=1)] | None = None
    recorded: Trajectory | None = Field(default=None, exclude_if=lambda it: it is None)
    """The path that was really driven in the source scene: waypoints as a submission has them."""
    control: bool = Field(default=False, exclude_if=lambda it: not it)
    """The region lies where no good driver would heed it: only over-caution is taken from it."""
    withdrawn: (
        Annotated[
            str,
            Field(min_length=1, max_length=500),
            in_words("must say why the sample counts no more, in at most 500 characters"),
        ]
        | None
    ) = Field(default=None, exclude_if=lambda it: it is None)
    """Why it counts no more."""

    @property
    def counts(self) -> bool:
        """Whether it is one of the N samples."""
        return not self.control and self.withdrawn is None


class Split(Document):
    """A named set of samples with its withheld regions."""

    model_config = ConfigDict(cache_strings="keys")  # ids occur once: reading takes a fifth less
    decides_scores = True

    schema_: Literal["exceptiondrive.split/1"] = Field(alias="schema")
    name: SplitName
    title: str
    samples: Annotated[tuple[SplitSample, ...], Field(min_length=1)]
    recorded_is_public: bool = Field(default=False, exclude_if=lambda it: not it)
    """Whether the manifest tells the recorded paths."""

    @cached_property
    def revision(self) -> str:
        """Digest of the canonical content, independent of the order of samples."""
        document = self.model_dump(mode="json", by_alias=True, exclude_none=True)
        document["samples"].sort(key=lambda sample: sample["sample_id"])
        return content_digest(document)

    @cached_property
    def counted(self) -> tuple[SplitSample, ...]:
        """The N samples that count, by sample id."""
        found = [each for each in self.samples if each.counts]
        return tuple(sorted(found, key=attrgetter("sample_id")))

    @property
    def controls(self) -> tuple[SplitSample, ...]:
        """The controls that are not withdrawn, by sample id."""
        found = [each for each in self.samples if each.control and each.withdrawn is None]
        return tuple(sorted(found, key=attrgetter("sample_id")))

    @property
    def has_parts(self) -> bool:
        """Whether samples are divided into public and private ones."""
        return any(sample.part is not None for sample in self.samples)

    @property
    def ref(self) -> "SplitRef":
        """Name and revision."""
        return SplitRef(name=self.name, revision=self.revision)

    def part(self, part: Literal["public", "private"] | None) -> "Split":
        """Return a part as a split of its own, with its own revision; None: all of it."""
        if part is None:
            return self
        chosen = tuple(sample for sample in self.samples if sample.part == part)
        return self.model_copy(update={"samples": chosen})


class SplitRef(Document):
    """Which split, at which revision."""

    name: str
    revision: str


class Manifest(Document):
    """What participants may know of a split: no task, region, scene or mark of a sample."""

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
    challenge: ChallengeId | None = Field(default=None, exclude_if=lambda it: it is None)
    """Of the phase that it was asked of: what a file for these samples must be."""

    @model_validator(mode="after")
    def _paths_are_whole(self) -> Self:
        wrong = [key for key, path in (self.recorded or {}).items() if len(path) != self.waypoints]
        if wrong:
            paths = counted(len(wrong), "recorded path")
            raise ValueError(
                f"{paths} of other than {self.waypoints} waypoints, the first of {wrong[0]}"
            )
        return self

    @classmethod
    def of(cls, split: Split, geometry: GeometrySection, revision: str | None = None) -> Self:
        """Return the public part of a split, samples by id.

        It has all samples that a file answers; the revision is that of the part that counts, by
        default of the whole.
        """
        told = sorted(map(attrgetter("sample_id", "recorded"), split.samples), key=itemgetter(0))
        paths = {sample_id: path for sample_id, path in told if path is not None}
        return cls(
            schema_="exceptiondrive.manifest/1",
            name=split.name,
            title=split.title,
            revision=split.revision if revision is None else revision,
            waypoints=geometry.waypoints,
            time_step_s=geometry.time_step_s,
            sample_ids=tuple(sample_id for sample_id, _ in told),
            recorded=paths if split.recorded_is_public and paths else None,
        )

    def drives(self, geometry: GeometrySection) -> Mapping[str, Trajectory] | None:
        """Return the recorded paths, if they are public and have a protocol's waypoint times."""
        has_times = (self.waypoints, self.time_step_s) == (geometry.waypoints, geometry.time_step_s)
        return self.recorded if has_times else None

    @property
    def ref(self) -> SplitRef:
        """Name and revision."""
        return SplitRef(name=self.name, revision=self.revision)
