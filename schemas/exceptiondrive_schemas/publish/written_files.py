"""All generated files: their paths and contents."""

import json
from typing import Any, Literal

from exceptiondrive_schemas.api.form_fields import FormField, fields_of
from exceptiondrive_schemas.api.phase_settings import PhaseSettings
from exceptiondrive_schemas.field_words import add_field_words, let_gain_fields
from exceptiondrive_schemas.publish.broken_files import errors_page
from exceptiondrive_schemas.publish.examples import MODELS, example_json

WRITTEN_BY_SERVER = frozenset({"score-sheet", "board", "submission", "check-report", "problem"})
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of a document, for writing or for reading."""
    mode: Literal["serialization", "validation"] = (
        "serialization" if name in WRITTEN_BY_SERVER else "validation"
    )
    model = MODELS[name]
    schema = model.model_json_schema(by_alias=True, mode=mode)
    parts = {model.__name__: schema, **schema.get("$defs", {})}
    add_field_words(parts)
    if name in WRITTEN_BY_SERVER:
        for part in parts.values():
            let_gain_fields(part)
    return {"$schema": DIALECT, **schema}


HEAD = """# The settings of a phase

<!-- Written by `python -m exceptiondrive_schemas.publish`; do not edit. -->

For organizers. You can set them in the form of a phase under `/organize/phases`, in the body of
`POST /api/v1/organizer/phases` and `PATCH .../phases/ID`, and as options of
`exceptiondrive organizer phases create` and `update` (`closes_at` is `--closes-at`). In the API some belong
to an object in the body: `{"title": "Final", "page": {"rules": "..."}, "policy": {"anonymous": true}}`.
[Phases](phases.md) describes how they work together.

| setting | in the API under | values | default | what it does |
|---|---|---|---|---|
"""


def settings_page() -> str:
    """Return the whole page."""
    return HEAD + "".join(map(_row, fields_of(PhaseSettings)))


def _row(field: FormField) -> str:
    cells = (
        f"`{field.name}`",
        "" if field.part is None else f"`{field.part}`",
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


PACKAGE_DATA = "schemas/exceptiondrive_schemas/published"


def written_files() -> dict[str, str]:
    """Return path, relative to the repository, and text of every generated file."""
    texts = {f"examples/{name}.json": example_json(name) for name in MODELS}
    for name in MODELS:
        schema = json.dumps(json_schema(name), indent=2, ensure_ascii=False)
        texts[f"schemas/{name}.json"] = schema + "\n"
    files = {f"{PACKAGE_DATA}/{path}": text for path, text in texts.items()}
    return files | {"docs/errors.md": errors_page(), "docs/phase-settings.md": settings_page()}
