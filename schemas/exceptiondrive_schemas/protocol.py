"""The protocol document: every constant that turns a trajectory into a score (docs/protocol.md).

A protocol is TOML on disk, immutable once used, and identified by version and content digest. Its
sections have their own digests, so that a change repeats only the steps that read the section:
`geometry` -> measure, `grading` and the taxonomy -> grade, `ranking` -> rank. A digest covers what
a document contains: a later field with a default does not change the digests of older documents.
"""

import json
from collections.abc import Collection, Mapping
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from exceptiondrive_schemas.base import Document, content_digest
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, RankKey
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.forgiving import FORGIVING
from exceptiondrive_schemas.protocols.faults import faults_of, unkeepable
from exceptiondrive_schemas.python310 import Self, tomllib
from exceptiondrive_schemas.taxonomy import Family, Strategy, Task, Taxonomy

PositiveMetres = Annotated[float, Field(gt=0, le=1000)]
Share = Annotated[float, Field(ge=0, le=1)]
Average = Literal["micro", "macro_family"]
ClearanceFactor = Annotated[float, Field(gt=0, le=10)]


class GeometrySection(Document):
    """Read by check and measure: frame, waypoints, heading, footprint, tube, contact."""

    frame: Literal["rear_axle_flu"]
    waypoints: Annotated[int, Field(ge=1, le=200)]
    time_step_s: Annotated[float, Field(gt=0, le=5)]
    max_coordinate_m: PositiveMetres
    max_step_m: PositiveMetres
    heading_hold_m: Annotated[float, Field(ge=0, le=5)]
    heading_hold_tolerance_m: Annotated[float, Field(ge=0, le=0.01)]
    reverse_above_deg: Annotated[float, Field(gt=0, le=180)]
    footprint_length_m: PositiveMetres
    footprint_width_m: PositiveMetres
    footprint_centre_ahead_m: Annotated[float, Field(ge=-20, le=20)]
    collision_tube: Literal["hulls", "footprints"]
    contact_tolerance_m: Annotated[float, Field(gt=0, le=0.001)]
    min_region_area_m2: Annotated[float, Field(gt=0, le=100)]
    max_region_distance_m: PositiveMetres

    @property
    def horizon_s(self) -> float:
        """Time of the last waypoint."""
        return self.waypoints * self.time_step_s


class GradingSection(Document):
    """Read by grade; the required clearances stand with the tasks."""

    headline: Average
    d_safe_scale: Annotated[float, Field(gt=0, le=10)] = 1.0
    sensitivity_factors: Annotated[tuple[ClearanceFactor, ...], Field(max_length=8)] = ()
    clearance_curve_step: Annotated[float, Field(ge=0.01, le=1)] = 0.1
    clearance_curve_until: Annotated[float, Field(ge=1, le=10)] = 2.0
    caution: dict[str, Annotated[int, Field(ge=0, le=100)]]

    @field_validator("sensitivity_factors")
    @classmethod
    def _each_factor_stands_once(cls, factors: tuple[float, ...]) -> tuple[float, ...]:
        if len(set(factors)) < len(factors):
            raise ValueError("sensitivity_factors must differ from one another")
        return factors

    @model_validator(mode="after")
    def _every_strategy_has_a_caution_rank(self) -> Self:
        expected = [strategy.value for strategy in Strategy]
        if sorted(self.caution) != expected:
            raise ValueError(f"caution must rank exactly the strategies {', '.join(expected)}")
        return self

    def under_warning(self, acceptable: Collection[Strategy]) -> tuple[Strategy, ...]:
        """Return answers less cautious than the least cautious acceptable one."""
        least = min(self.caution[strategy.value] for strategy in acceptable)
        return tuple(strategy for strategy in Strategy if self.caution[strategy.value] < least)


class RankingSection(Document):
    """Read by rank: order, coverage and flags that keep from ranking, bootstrap."""

    order: dict[str, Annotated[tuple[RankKey, ...], Field(min_length=1)]]
    min_coverage: Share
    bootstrap_draws: Annotated[int, Field(ge=100, le=100_000)]
    bootstrap_seed: Annotated[int, Field(ge=0, lt=2**63)]
    confidence: Annotated[float, Field(gt=0.5, lt=1)]
    min_scenes: Annotated[int, Field(ge=2)] = 2
    """A mean over fewer scenes has no interval, nor has a mean of families one of which has fewer."""
    unranked_flags: tuple[str, ...] = ()
    """Flags with which an entry is listed and takes no rank."""

    def order_of(self, challenge: Challenge) -> tuple[RankKey, ...]:
        """Return the keys that rank the entries of a challenge, the most significant first."""
        return self.order.get(challenge.id, challenge.primary_order)

    @field_validator("unranked_flags")
    @classmethod
    def _flags_are_known(cls, codes: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        unknown = [code for code in codes if code not in FLAGS]
        if unknown and info.context != FORGIVING:
            raise ValueError(f"no flag is called {unknown[0]!r}; there are {', '.join(FLAGS)}")
        if len(set(codes)) < len(codes):
            raise ValueError("unranked_flags must differ from one another")
        return codes

    @model_validator(mode="after")
    def _order_names_primary_metrics(self, info: ValidationInfo) -> Self:
        if info.context == FORGIVING:
            return self
        needed = [key for key, each in CHALLENGES.items() if each.is_ordered_by_protocol]
        if not set(needed) <= set(self.order) <= set(CHALLENGES):
            raise ValueError(f"order needs exactly the challenges {', '.join(CHALLENGES)}")
        for challenge_id, keys in self.order.items():
            primary = {key.metric for key in CHALLENGES[challenge_id].primary_order}
            for key in keys:
                if key.metric not in primary:
                    raise ValueError(
                        f"{key.metric!r} cannot rank the {challenge_id} challenge; "
                        f"its primary metrics are {', '.join(sorted(primary))}"
                    )
        return self


class PlausibilitySection(Document):
    """Published beside the score, never folded into it; and the frame check at upload.

    What has a default came after protocol 1.0 (docs/protocol.md section 9).
    """

    stationary_below_m: PositiveMetres
    blind_shift_below_m: PositiveMetres
    max_acceleration_mps2: Annotated[float, Field(gt=0, le=1000)]
    min_turn_radius_m: PositiveMetres
    flag_edited_stationary_excess: Share
    flag_source_stationary: Share
    flag_blind: Share
    flag_impossible: Share
    frame_check_min_motion_m: PositiveMetres
    frame_check_max_angle_deg: Annotated[float, Field(gt=0, lt=180)]
    frame_check_min_samples: Annotated[int, Field(ge=1)]
    reaction_shift_m: PositiveMetres = 0.5
    progress_min_path_m: PositiveMetres = 2.0
    over_caution_below: Share = 0.5
    first_step_from_mps: Annotated[float, Field(gt=0, le=60)] = 2.0
    flag_first_step: Share = 0.01
    flag_reverses_excess: Share = 0.05
    flag_off_course_m: PositiveMetres = 5.0
    flag_progress: Share = 0.2
    flag_family_progress: Share = 0.1
    flag_family_min_samples: Annotated[int, Field(ge=1)] = 20
    flag_over_caution: Share = 0.5
    flag_same_answer: Share = 0.95


class PublicationSection(Document):
    """What leaves the server: digits (per cent for fractions, metres for lengths), cells, curves."""

    percent_decimals: Annotated[int, Field(ge=0, le=4)]
    metre_decimals: Annotated[int, Field(ge=0, le=4)]
    min_samples_per_cell: Annotated[int, Field(ge=1)]
    compared_entries: Annotated[int, Field(ge=0, le=50)] = 0
    clearance_curve: Literal["public_splits", "all_splits", "never"] = "public_splits"
    outcome_cells: Literal["public_splits", "all_splits"] = "public_splits"
    """Whose sheets carry the outcome shares by family and task; the totals always do."""

    def shows_curve(self, *, is_public_split: bool) -> bool:
        """Whether the sheets of a split are published with their clearance curve."""
        return self.clearance_curve == "all_splits" or (
            is_public_split and self.clearance_curve == "public_splits"
        )

    def shows_outcome_cells(self, *, is_public_split: bool) -> bool:
        """Whether the sheets of a split are published with outcome shares by family and task."""
        return is_public_split or self.outcome_cells == "all_splits"


class ProtocolDocument(Document):
    """A complete, versioned protocol."""

    decides_scores = True
    schema_: Literal["exceptiondrive.protocol/1"] = Field(alias="schema")
    version: Annotated[str, Field(pattern=r"^\d+\.\d+(\.\d+)?(-[a-z0-9.]+)?$")]
    title: str
    changes: str
    geometry: GeometrySection
    grading: GradingSection
    ranking: RankingSection
    plausibility: PlausibilitySection
    publication: PublicationSection
    families: tuple[Family, ...]
    tasks: tuple[Task, ...]

    @model_validator(mode="after")
    def _taxonomy_is_sound(self) -> Self:
        _ = self.taxonomy
        return self

    @model_validator(mode="after")
    def _under_warning_sets_follow_from_caution(self) -> Self:
        wrong = [
            f"under_warning of task {task.id} must be {_strategy_list(expected)}, not "
            f"{_strategy_list(task.under_warning)}"
            for task in self.tasks
            if set(expected := self.grading.under_warning(task.acceptable))
            != set(task.under_warning)
        ]
        if wrong:
            raise ValueError(f"caution and acceptable say otherwise: {'; '.join(wrong)}")
        return self

    @cached_property
    def taxonomy(self) -> Taxonomy:
        """Families and tasks."""
        return Taxonomy(families=self.families, tasks=self.tasks)

    @cached_property
    def digest(self) -> str:
        """Digest of the whole document."""
        return content_digest(_digest_value(self))

    @cached_property
    def geometry_digest(self) -> str:
        """Digest of what `measure` reads."""
        return content_digest(_digest_value(self.geometry))

    @cached_property
    def grading_digest(self) -> str:
        """Digest of what `grade` reads besides measurements and the split."""
        return content_digest(
            {
                "grading": _digest_value(self.grading),
                "plausibility": _digest_value(self.plausibility),
                "taxonomy": _digest_value(self.taxonomy),
            }
        )

    @cached_property
    def plausibility_digest(self) -> str:
        """Digest of what those parts of `grade` read that use no required clearance."""
        return content_digest(_digest_value(self.plausibility))

    @cached_property
    def ranking_digest(self) -> str:
        """Digest of what `rank` reads besides score sheets."""
        return content_digest(
            {"ranking": _digest_value(self.ranking), "publication": _digest_value(self.publication)}
        )


_DIGESTED_DEFAULTS = frozenset({"d_safe_scale", "sensitivity_factors", "compared_entries"})
"""Fields of the first protocols. Later fields need a default and must not be added here: protocols
without them keep their digests, so all results made under these stay valid."""


def _digest_value(value: Any) -> Any:
    """Return the input of digests: the value as JSON without the fields left at a default."""
    if isinstance(value, Document):
        return {
            field.alias or name: _digest_value(getattr(value, name))
            for name, field in type(value).model_fields.items()
            if name in _DIGESTED_DEFAULTS
            or getattr(value, name) != field.get_default(call_default_factory=True)
        }
    if isinstance(value, dict):
        return {key: _digest_value(item) for key, item in value.items()}
    return [_digest_value(item) for item in value] if isinstance(value, tuple) else value


_MODELS: Mapping[str, type[Document]] = {
    "": ProtocolDocument,
    "geometry": GeometrySection,
    "grading": GradingSection,
    "ranking": RankingSection,
    "plausibility": PlausibilitySection,
    "publication": PublicationSection,
    "families": Family,
    "tasks": Task,
}


def _strategy_list(strategies: Collection[Strategy]) -> str:
    return f"[{', '.join(strategies)}]"


class ProtocolError(ValueError):
    """The protocol document is invalid; each line says where and why."""

    def __init__(self, faults: list[str]) -> None:
        self.faults = faults
        super().__init__("the protocol document is not valid:\n" + "\n".join(faults))


def parse_protocol(toml: str) -> ProtocolDocument:
    """Read a protocol from TOML.

    Raises:
        ProtocolError: Not TOML, or the document violates the schema; every fault is listed.
    """
    try:
        document = tomllib.loads(toml)
        unkept = list(unkeepable(document))
        if unkept:
            raise ProtocolError(unkept)
        return ProtocolDocument.model_validate_json(json.dumps(document))
    except tomllib.TOMLDecodeError as error:
        raise ProtocolError([f"not TOML: {error}"]) from None
    except RecursionError:
        raise ProtocolError(["not a protocol: nested too deeply"]) from None
    except ValidationError as error:
        raise ProtocolError(faults_of(error, document, _MODELS)) from None
    except ProtocolError:
        raise
    except ValueError:
        raise ProtocolError(["not a protocol: a number has too many digits"]) from None


def read_protocol(path: Path) -> ProtocolDocument:
    """Read a protocol from a TOML file; it may begin with a byte order mark.

    Raises:
        ProtocolError: Not UTF-8, not TOML, or the document violates the schema.
        OSError: It cannot be read.
    """
    try:
        return parse_protocol(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError:
        raise ProtocolError(["the file is not UTF-8 text; a protocol is a TOML file"]) from None


PACKAGED_PROTOCOLS = Path(__file__).parent / "protocols"
"""Folder of the protocols that ship with this package."""
NEWEST = "1.1"
"""Version of the packaged protocol for a new phase."""
NEWEST_WITHHELD = "1.1-withheld"
"""Version for a new phase on a withheld split: the same scores, and no cells below 100."""


def packaged_protocol_toml(version: str = "1.0") -> str:
    """Return the TOML text of a protocol that ships with this package.

    Raises:
        FileNotFoundError: No such version ships.
    """
    return (PACKAGED_PROTOCOLS / f"{version}.toml").read_text(encoding="utf-8")


@cache
def packaged_protocol(version: str = "1.0") -> ProtocolDocument:
    """Return a protocol that ships with this package, read once.

    Raises:
        FileNotFoundError: No such version ships.
    """
    return parse_protocol(packaged_protocol_toml(version))


@cache
def packaged_digests() -> frozenset[str]:
    """Return the digests of all protocols that ship with this package; they are public."""
    files = PACKAGED_PROTOCOLS.glob("*.toml")
    return frozenset(parse_protocol(file.read_text(encoding="utf-8")).digest for file in files)
