"""The page `docs/phase-settings.md`: every setting of a phase, from the model that makes them all."""

from exceptiondrive_schemas.form_fields import FormField, fields_of
from exceptiondrive_schemas.phase_settings import PhaseSettings

HEAD = """# The settings of a phase

<!-- Written by `python -m exceptiondrive_schemas.publish`; do not edit. -->

For organizers: in the form of a phase under `/organize/phases`, in the body of
`POST /api/v1/organizer/phases` and `PATCH .../phases/ID`, and as options of
`exceptiondrive organizer phases create` and `update` (`closes_at` is `--closes-at`). Settings that
stand under `policy` in the API are marked so. What they do together: [phases](phases.md).

| setting | of `policy` | values | default | what it does |
|---|---|---|---|---|
"""


def settings_page() -> str:
    """Return the whole page."""
    return HEAD + "".join(map(_row, fields_of(PhaseSettings)))


def _row(field: FormField) -> str:
    cells = (
        f"`{field.name}`",
        "yes" if field.part == "policy" else "",
        _values(field) + (", or none" if field.may_be_none else ""),
        _default(field),
        field.hint,
    )
    return f"| {' | '.join(cells)} |\n"


def _values(field: FormField) -> str:
    words = {
        "text": f"text of at most {field.max_length:,} characters",
        "lines": f"text of at most {field.max_length:,} characters",
        "whole": f"{field.lowest} to {field.highest:,}",
        "moment": "a time, `2027-01-31T00:00:00Z`",
        "yes": "`true`, `false`",
        "choice": ", ".join(f"`{value}`" for value, _ in field.options),
    }
    return words[field.kind]


def _default(field: FormField) -> str:
    if field.default is None:
        return "none" if field.may_be_none else "must be given"
    if isinstance(field.default, bool):
        return f"`{str(field.default).lower()}`"
    return f"`{field.default}`" if field.default != "" else "empty"
