"""The taxonomy: tasks in families, as data of the protocol document (docs/protocol.md section 7).

Ids are opaque keys. Names and hazards are organisers' text; when the true list of the paper's
supplement appears, only the protocol document changes.
"""

from typing import Annotated

from pydantic import Field, model_validator

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.python310 import Self, StrEnum


class Strategy(StrEnum):
    """The five high-level strategies of the paper."""

    A = "A"
    B = "B"
    C = "C"
    D = "D"
    E = "E"

    @property
    def action(self) -> str:
        """The meaning of the letter."""
        return _ACTIONS[self]


_ACTIONS = {
    Strategy.A: "maintain path",
    Strategy.B: "slow down",
    Strategy.C: "stop",
    Strategy.D: "yield",
    Strategy.E: "prepare to bypass",
}


class RegionKind(StrEnum):
    """Whether a hazard region is occupied space or a no-go area."""

    PHYSICAL = "physical"
    CONFLICT = "conflict"


Key = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")]


class Family(Document):
    """One of the families of hazards that a protocol names."""

    id: Key
    title: str


class Task(Document):
    """One kind of hazard that a protocol names, with its required clearance and acceptable strategies."""

    id: Key
    name: Key
    family: Key
    hazard: str
    region: RegionKind
    acceptable: Annotated[tuple[Strategy, ...], Field(min_length=1)]
    under_warning: tuple[Strategy, ...]
    """Which answers warn too little: what the protocol's caution ranks make of `acceptable`."""
    d_safe_m: Annotated[float, Field(gt=0, le=20)]

    @property
    def title(self) -> str:
        """Its name as shown to readers: `stalled_vehicle` -> `Stalled vehicle`."""
        return self.name.replace("_", " ").capitalize()

    @property
    def label(self) -> str:
        """Its id and title, for use out of context."""
        return f"{self.id} {self.title}"


class Taxonomy(Document):
    """Families and tasks in their published order."""

    families: Annotated[tuple[Family, ...], Field(min_length=1)]
    tasks: Annotated[tuple[Task, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _keys_are_unique_and_known(self) -> Self:
        family_ids = [family.id for family in self.families]
        task_ids = [task.id for task in self.tasks]
        for kind, ids in (("family", family_ids), ("task", task_ids)):
            repeated = sorted({key for key in ids if ids.count(key) > 1})
            if repeated:
                raise ValueError(f"{kind} ids must be unique; repeated: {', '.join(repeated)}")
        unknown = sorted({task.family for task in self.tasks} - set(family_ids))
        if unknown:
            raise ValueError(f"tasks name families that are not listed: {', '.join(unknown)}")
        return self

    def task(self, task_id: str) -> Task:
        """Return the task with this id.

        Raises:
            KeyError: There is no such task.
        """
        for task in self.tasks:
            if task.id == task_id:
                return task
        raise KeyError(task_id)

    def tasks_of(self, family_id: str) -> tuple[Task, ...]:
        """Return the tasks of one family, in order."""
        return tuple(task for task in self.tasks if task.family == family_id)
