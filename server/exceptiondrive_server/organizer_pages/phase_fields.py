"""The settings of a phase as fields of a form.

What `PhasePolicy` holds becomes a field by itself, from its title, sentence and type; another column
is one line in `PLAIN_FIELDS`.
"""

from collections.abc import Mapping
from datetime import datetime
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from pydantic import AwareDatetime, ValidationError
from pydantic.fields import FieldInfo

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_records.tables import Phase
from exceptiondrive_schemas.phase_settings import PhasePolicy
from exceptiondrive_server.organizer_pages.forms import Field, Kind, text_of

PLAIN_FIELDS = (
    Field("title", "Title", hint="shown to readers", is_required=True, max_length=120),
    Field("description", "Description", "lines", "shown to readers", max_length=4000),
    Field("opens_at", "Opens at", "moment", "empty: open from the start"),
    Field("closes_at", "Closes at", "moment", "the deadline; empty: open for ever"),
    Field("quota_per_day", "Submissions a day", "whole", "of a team, per UTC day",
          is_required=True, highest=10_000),
    Field("quota_total", "Submissions in all", "whole", "of a team; empty: no limit"),
    Field("quota_concurrent", "Waiting at once", "whole", "of a team; empty: no limit",
          highest=10_000),
    Field("rejected_per_day", "Wrong files a day", "whole", "of a team, per UTC day",
          is_required=True, highest=10_000),
    Field("shows_reported", "Show the paper's rows", "yes", "beside the scored entries"),
)  # fmt: skip
NEW_DEFAULTS = {"quota_per_day": "3", "rejected_per_day": "20"}
_LIFE = "life_"


def life_fields() -> tuple[Field, ...]:
    """Return a field for each setting of `PhasePolicy`."""
    return tuple(_life_field(name, info) for name, info in PhasePolicy.model_fields.items())


def texts_of_phase(phase: Phase) -> dict[str, str]:
    """Return what the fields of a phase show."""
    plain = {field.name: text_of(getattr(phase, field.name)) for field in PLAIN_FIELDS}
    return plain | texts_of_life(phase.life)


def texts_of_life(life: PhasePolicy) -> dict[str, str]:
    """Return what the fields of a phase's life show."""
    return {f"{_LIFE}{name}": text_of(getattr(life, name)) for name in PhasePolicy.model_fields}


def plain_changes(phase: Phase, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns that differ from the phase, with what they shall be."""
    wanted = {field.name: values[field.name] for field in PLAIN_FIELDS}
    return {key: value for key, value in wanted.items() if not _is_same(getattr(phase, key), value)}


def life_changes(life: PhasePolicy, values: Mapping[str, Any]) -> PhasePolicy | None:
    """Return the settings that differ, set explicitly and no others; None: none does.

    Raises:
        InvalidRecord: A value cannot be used.
    """
    wanted = {name: values[f"{_LIFE}{name}"] for name in PhasePolicy.model_fields}
    changed = {
        key: value for key, value in wanted.items() if not _is_same(getattr(life, key), value)
    }
    return _life(changed) if changed else None


def new_life(values: Mapping[str, Any]) -> PhasePolicy:
    """Return the life of a new phase.

    Raises:
        InvalidRecord: A value cannot be used.
    """
    return _life({name: values[f"{_LIFE}{name}"] for name in PhasePolicy.model_fields})


def _life(values: Mapping[str, Any]) -> PhasePolicy:
    try:
        return PhasePolicy.model_validate(values)
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=False)
        words = [f"{'.'.join(map(str, item['loc']))}: {item['msg']}." for item in found]
        raise InvalidRecord(" ".join(words)) from None


def _life_field(name: str, info: FieldInfo) -> Field:
    kind, options = _kind_of(info.annotation)
    return Field(
        name=f"{_LIFE}{name}",
        label=info.title or name.replace("_", " "),
        kind=kind,
        hint=info.description or "",
        is_required=kind == "choice",
        options=options,
    )


def _kind_of(annotation: Any) -> tuple[Kind, tuple[tuple[str, str], ...]]:
    if get_origin(annotation) is Literal:
        return "choice", tuple((value, value.replace("_", " ")) for value in get_args(annotation))
    inner = [part for part in _flat(annotation) if part is not NoneType]
    kinds: Mapping[Any, Kind] = {
        bool: "yes",
        int: "whole",
        datetime: "moment",
        AwareDatetime: "moment",
    }
    return next((kinds[part] for part in inner if part in kinds), "text"), ()


def _flat(annotation: Any) -> list[Any]:
    """Return the plain types inside unions and annotations."""
    parts = get_args(annotation)
    if not parts:
        return [annotation]
    return [
        found for part in parts if isinstance(part, type) or get_args(part) for found in _flat(part)
    ]


def _is_same(old: object, new: object) -> bool:
    """A form knows whole seconds alone: what it shows again is not a change."""
    if isinstance(old, datetime) and isinstance(new, datetime):
        return old.replace(microsecond=0) == new.replace(microsecond=0)
    return old == new
