"""Floors of a withheld split: what nobody may publish of it, whatever a phase or protocol says.

They lie beside the split file, in `floors.toml`, where only workers read and no organizer, API or
server writes. A worker that is asked for more tells nothing of it, and says so in the audit log.
What the file does not say, or no file beside a split, is as advised: what protocol `1.1-withheld` asks
passes, and what shows smaller cells does not. A public split has nothing to hold back.
"""

import json
from collections.abc import Iterator
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, Self

import tomllib
from pydantic import Field, ValidationError, model_validator

from exceptiondrive_schemas.api.confirmation import PublicKey
from exceptiondrive_schemas.base import Document, faults_in
from exceptiondrive_schemas.protocol import ProtocolDocument

FLOORS_FILE = "floors.toml"

NEEDED = 2
"""How many organizers have to confirm, where a split asks for a second one."""
Bounds = tuple[float, float]
Count = Annotated[int, Field(ge=1)]
Decimals = Annotated[int, Field(ge=0, le=4)]
_GEOMETRY = (
    "footprint_length_m",
    "footprint_width_m",
    "footprint_centre_ahead_m",
    "waypoints",
    "max_step_m",
    "max_coordinate_m",
    "min_region_area_m2",
    "max_region_distance_m",
)
"""Fields of a protocol that have bounds by the same name."""


class SplitFloors(Document):
    """What a worker publishes of a withheld split at most.

    Bounds are the least and the largest value, both allowed; `d_safe_m` holds for every required
    clearance of the protocol, those of its sensitivity factors among them.
    """

    min_samples_per_cell: Count = 100
    max_percent_decimals: Decimals = 2
    max_metre_decimals: Decimals = 2
    max_compared_entries: Annotated[int, Field(ge=0)] = 10
    max_sensitivity_factors: Annotated[int, Field(ge=0)] = 2
    max_curve_points: Count = 21
    shows: tuple[Literal["clearance_curve", "outcome_cells"], ...] = ()
    """What a protocol may publish of all splits, and so of this one."""
    footprint_length_m: Bounds = (4.0, 6.0)
    footprint_width_m: Bounds = (1.6, 2.2)
    footprint_centre_ahead_m: Bounds = (1.0, 2.0)
    collision_tubes: tuple[Literal["hulls", "footprints"], ...] = ("hulls",)
    d_safe_m: Bounds = (0.25, 4.0)
    waypoints: Bounds = (6, 6)
    max_step_m: Bounds = (30.0, 30.0)
    max_coordinate_m: Bounds = (200.0, 200.0)
    min_region_area_m2: Bounds = (0.01, 0.01)
    max_region_distance_m: Bounds = (100.0, 100.0)
    """This and the two before refuse a split: a protocol that asks much sorts its samples."""
    max_protocols: Count = 3
    """Protocols that the split is ever scored under."""
    max_scored_per_day: Count = 100
    """Submissions that get their first sheet within 24 hours, over all phases and teams."""
    private_part_from: datetime | None = None
    """Before this the private part is not scored; with a time zone."""
    second_organizer: bool = False
    """Whether two of `organizers` have to sign that a revision is scored under a protocol."""
    organizers: dict[str, PublicKey] = Field(default_factory=dict)
    """Name to public key, as `exceptiondrive organizer protocols key` prints it."""

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> Self:
        for name in ("d_safe_m", *_GEOMETRY):
            least, most = getattr(self, name)
            if not 0 <= least <= most:
                raise ValueError(f"{name}: the least comes first, and none is negative")
        n_keys = len(set(self.organizers.values()))
        if n_keys < len(self.organizers):
            raise ValueError("organizers: each has a key of their own")
        if self.second_organizer and n_keys < NEEDED:
            raise ValueError(f"second_organizer needs {NEEDED} organizers with their keys")
        if self.private_part_from is not None and self.private_part_from.tzinfo is None:
            raise ValueError("private_part_from needs a time zone, such as Z")
        return self


class FloorsUnreadableError(ValueError):
    """The floors of a split cannot be read: nothing of it is scored until they can."""


class FloorHeldError(ValueError):
    """More was asked of a withheld split than its floors allow; `asked` says what, in words."""

    def __init__(self, *asked: str) -> None:
        self.asked = asked
        super().__init__("; ".join(asked))


class SplitDayFullError(FloorHeldError):
    """As many submissions as the floors allow have been scored within a day."""


def read_floors(folder: Path) -> SplitFloors:
    """Return the floors that lie in the folder of a split; the advised ones where a split lies there alone.

    Raises:
        FloorsUnreadableError: The file is no floors, each problem is named; or no split lies there, as
            where the folder is not mounted.
    """
    try:
        return _floors_of((folder / FLOORS_FILE).read_text("utf-8"))
    except FileNotFoundError:
        if not any(folder.glob("split*.json*")):
            raise FloorsUnreadableError(f"there is no split in {folder.absolute()}") from None
        return SplitFloors()
    except ValidationError as error:
        lines = "\n".join(faults_in(error))
        raise FloorsUnreadableError(f"{FLOORS_FILE} of {folder.name}:\n{lines}") from None
    except (OSError, ValueError) as error:
        raise FloorsUnreadableError(
            f"{FLOORS_FILE} of {folder.name} cannot be read ({type(error).__name__})"
        ) from None


@lru_cache(maxsize=64)
def _floors_of(text: str) -> SplitFloors:
    """Every score reads the file; it is parsed when its text is new."""
    document = tomllib.loads(text)
    return SplitFloors.model_validate_json(json.dumps(document, default=str))


def breaches(floors: SplitFloors, protocol: ProtocolDocument) -> Iterator[str]:
    """Yield in words what of a protocol lies below the floors."""
    publication, geometry = protocol.publication, protocol.geometry
    least = floors.min_samples_per_cell
    if publication.min_samples_per_cell < least:
        yield f"min_samples_per_cell is {publication.min_samples_per_cell}, the floor is {least}"
    numbers = (
        ("percent_decimals", publication.percent_decimals, floors.max_percent_decimals),
        ("metre_decimals", publication.metre_decimals, floors.max_metre_decimals),
        ("compared_entries", publication.compared_entries, floors.max_compared_entries),
        (
            "the number of sensitivity_factors",
            len(protocol.grading.sensitivity_factors),
            floors.max_sensitivity_factors,
        ),
        (
            "the number of points of a clearance_curve",
            _curve_points(protocol),
            floors.max_curve_points,
        ),
    )
    for name, value, most in numbers:
        if value > most:
            yield f"{name} is {value}, at most {most} may be"
    for name in ("clearance_curve", "outcome_cells"):
        if getattr(publication, name) == "all_splits" and name not in floors.shows:
            yield f'{name} is "all_splits", which the floors do not show'
    if geometry.collision_tube not in floors.collision_tubes:
        yield f'collision_tube is "{geometry.collision_tube}", which the floors do not allow'
    ranges = (
        *((name, getattr(geometry, name)) for name in _GEOMETRY),
        *(("d_safe_m", value) for value in _required_clearances_m(protocol)),
    )
    told = set()
    for name, number in ranges:
        low, high = getattr(floors, name)
        if not low <= number <= high and name not in told:
            told.add(name)
            yield f"{name} is {number:g}, it must lie from {low:g} to {high:g}"


def unconfirmed(floors: SplitFloors, keys: set[str]) -> Iterator[str]:
    """Yield in words whose confirmation is missing.

    The keys are those whose signature holds for what is asked; of nobody named there they count nothing.
    """
    names = sorted(name for name, key in floors.organizers.items() if key in keys)
    if floors.second_organizer and len(names) < NEEDED:
        who = f"{' and '.join(names)} alone" if names else "nobody"
        yield f"it is confirmed by {who}, and {NEEDED} of {len(floors.organizers)} organizers must"


def _curve_points(protocol: ProtocolDocument) -> int:
    """Of the clearance curve of a withheld split; 0 where none is published."""
    grading = protocol.grading
    if not protocol.publication.shows_curve(is_public_split=False):
        return 0
    return 1 + round(grading.clearance_curve_until / grading.clearance_curve_step)


def _required_clearances_m(protocol: ProtocolDocument) -> list[float]:
    grading = protocol.grading
    d_safe_m = [task.d_safe_m * grading.d_safe_scale for task in protocol.tasks]
    return [each * factor for each in d_safe_m for factor in (1.0, *grading.sensitivity_factors)]
