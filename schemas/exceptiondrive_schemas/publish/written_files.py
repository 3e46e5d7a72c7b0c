"""All generated files: where each one belongs and what it says."""

import json

from exceptiondrive_schemas.publish.errors_page import errors_page
from exceptiondrive_schemas.publish.examples import EXAMPLES, example_json
from exceptiondrive_schemas.publish.json_schemas import MODELS, json_schema
from exceptiondrive_schemas.publish.settings_page import settings_page

PACKAGE_DATA = "schemas/exceptiondrive_schemas/published"
COPIES = "docs"


def written_files() -> dict[str, str]:
    """Return path, relative to the repository, and text of every generated file."""
    texts = {f"schemas/{name}.json": _schema_text(name) for name in MODELS}
    texts |= {f"examples/{name}.json": example_json(name) for name in EXAMPLES}
    files = {
        f"{folder}/{path}": text
        for folder in (PACKAGE_DATA, COPIES)
        for path, text in texts.items()
    }
    return files | {"docs/errors.md": errors_page(), "docs/phase-settings.md": settings_page()}


def _schema_text(name: str) -> str:
    return json.dumps(json_schema(name), indent=2, ensure_ascii=False) + "\n"
