"""What changed from one protocol to the next, value by value."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from exceptiondrive_schemas.protocol import Protocol


@dataclass(frozen=True)
class Change:
    """One value that differs; None where the value is absent."""

    path: str
    before: str | None
    after: str | None


_SELF_DESCRIPTION = ("version", "title", "changes")


def protocol_changes(before: Protocol, after: Protocol) -> tuple[Change, ...]:
    """Return every value that differs, by its dotted path, in the order of the newer document."""
    old, new = dict(_values(_document(before))), dict(_values(_document(after)))
    paths = [*new, *(path for path in old if path not in new)]
    return tuple(
        Change(path, old.get(path), new.get(path))
        for path in paths
        if old.get(path) != new.get(path)
    )


def _document(protocol: Protocol) -> dict[str, Any]:
    document = protocol.model_dump(mode="json", by_alias=True)
    for name in _SELF_DESCRIPTION:
        document.pop(name)
    for name in ("families", "tasks"):
        document[name] = {item["id"]: item for item in document[name]}
    return document


def _values(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield dotted paths and values of a nested document."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _values(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list) and all(isinstance(item, str) for item in value):
        yield path, ", ".join(value)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _values(inner, f"{path}[{index}]")
    else:
        yield path, str(value)
