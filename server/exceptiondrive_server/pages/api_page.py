"""The API in one table, from the application's own description."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

METHODS = ("get", "post", "put", "patch", "delete")


@dataclass(frozen=True)
class Operation:
    """One operation of the API."""

    method: str
    path: str
    words: str
    needs_token: bool


@dataclass(frozen=True)
class OperationGroup:
    """Operations of one subject."""

    title: str
    operations: tuple[Operation, ...]


def operation_groups(openapi: Mapping[str, Any]) -> tuple[OperationGroup, ...]:
    """Return the operations by tag, in the order of the description."""
    groups: dict[str, list[Operation]] = {}
    for path, item in openapi.get("paths", {}).items():
        for method in METHODS:
            if method not in item:
                continue
            operation = item[method]
            words = operation.get("description") or operation.get("summary", "")
            tag = (operation.get("tags") or ["other"])[0]
            groups.setdefault(tag, []).append(
                Operation(
                    method.upper(), path, words.split("\n")[0], bool(operation.get("security"))
                )
            )
    return tuple(
        OperationGroup(tag.replace("_", " ").capitalize(), tuple(operations))
        for tag, operations in groups.items()
    )
