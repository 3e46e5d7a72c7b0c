"""The documents of these tests: protocols that differ in one place, a tiny split, files for it."""

import json

from tests.support import documents

from exceptiondrive_schemas.protocol import packaged_protocol, packaged_protocol_toml
from exceptiondrive_schemas.split import Split
from exceptiondrive_schemas.taxonomy import Strategy

TASKS = {"a": "SE1", "b": "SE1", "c": "LB1", "d": "RS1"}


def new_protocol(version: str = "1.1", old: str = "", new: str = "") -> str:
    """Protocol 1.0 under another version, with the first `old` replaced."""
    toml = packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"')
    assert old in toml
    return toml.replace(old, new, 1)


def split_document(ahead_m: float = 10.0) -> Split:
    region = documents.region_ahead(ahead_m)
    return documents.split_document(
        {
            key: {"scene_id": f"scene-{task}", "task": task, "region": region}
            for key, task in TASKS.items()
        }
    )


def even_split() -> Split:
    """The tiny split with each family in both scenes: the mean of families has an interval."""
    tasks, region = TASKS | {"e": "LB1", "f": "RS1"}, documents.region_ahead(10.0)
    return documents.split_document(
        {
            key: {"scene_id": f"scene-{key in 'bef'}", "task": task, "region": region}
            for key, task in tasks.items()
        }
    )


def caution_protocol(version: str, caution: dict[str, int]) -> str:
    """Protocol 1.0 with another order of caution, and the under-warning sets that follow."""
    ranks = ", ".join(f"{letter} = {rank}" for letter, rank in caution.items())
    grading = packaged_protocol().grading.model_copy(update={"caution": caution})
    lines = packaged_protocol_toml().replace('version = "1.0"', f'version = "{version}"')
    toml: list[str] = []
    under: tuple[Strategy, ...] = ()
    for line in lines.splitlines():
        name, _, value = line.partition(" = ")
        if name == "acceptable":
            under = grading.under_warning([Strategy(letter) for letter in json.loads(value)])
        if name == "under_warning":
            line = f"under_warning = {json.dumps(list(under))}"
        toml.append(f"caution = {{ {ranks} }}" if name == "caution" else line)
    return "\n".join(toml)


def strategy_file(chosen: str) -> bytes:
    """One letter per sample, in the order of the tasks."""
    return documents.strategy_file(dict(zip(TASKS, chosen, strict=True)))


def planning_file(speed_mps: float) -> bytes:
    return documents.planning_file(dict.fromkeys(TASKS, speed_mps))
