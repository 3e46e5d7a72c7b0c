"""JSON Schemas: docstrings below fields as their descriptions, and answers that may gain fields."""

import ast
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel


def add_field_words(schemas: Mapping[str, dict[str, Any]]) -> None:
    """Add descriptions to the properties of schemas, by name, that have none yet.

    Pydantic would read the source of each class on its creation, at every start of every program.
    This code reads it only when descriptions are needed.
    """
    for model in _models(BaseModel):
        fields = {
            field.serialization_alias or field.alias or name: name
            for name, field in model.model_fields.items()
        }
        long_name = f"{model.__module__}.{model.__qualname__}".replace(".", "__")
        for name in (model.__name__, long_name):
            properties = schemas.get(name, {}).get("properties", {})
            if properties.keys() == fields.keys():
                for key, field_name in fields.items():
                    words = _words(model, field_name)
                    if words:
                        properties[key].setdefault("description", words)


def let_gain_fields(schema: dict[str, Any]) -> None:
    """Remove from the schema of an answer that no further field is allowed."""
    if schema.get("additionalProperties") is False:
        del schema["additionalProperties"]


def _models(base: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """Yield every document class of this project that is loaded."""
    for model in base.__subclasses__():
        if model.__module__.startswith("exceptiondrive"):
            yield model
        yield from _models(model)


def _words(model: type[BaseModel], name: str) -> str:
    """Return a field's docstring from the last class that defines it; for JSON, without `None`."""
    for each in model.__mro__:
        words = _sentences(each.__module__).get((each.__qualname__, name))
        if words is not None:
            return " ".join(words.split()).replace("None", "null")
    return ""


@cache
def _sentences(module: str) -> dict[tuple[str, str], str]:
    """Return the text below each field, by class and field."""
    path = getattr(sys.modules[module], "__file__", None)
    if not module.startswith("exceptiondrive") or path is None:
        return {}
    found = {}
    for node in ast.parse(Path(path).read_text("utf-8")).body:
        if isinstance(node, ast.ClassDef):
            for field, below in zip(node.body, node.body[1:]):  # noqa: B905 - the last has none
                if (
                    isinstance(field, ast.AnnAssign)
                    and isinstance(field.target, ast.Name)
                    and isinstance(below, ast.Expr)
                    and isinstance(below.value, ast.Constant)
                    and isinstance(below.value.value, str)
                ):
                    found[node.name, field.target.id] = below.value.value
    return found
