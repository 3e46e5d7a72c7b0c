"""The page of a protocol: its rules in words, with the values of the document."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.drawing import ProtocolDrawing
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.taxonomy import Family, RegionKind, Strategy, Task
from exceptiondrive_server.entries.scene_drawing import SceneDrawing, scene_drawing
from exceptiondrive_server.web.page_parts import MetricCard, metric_cards

# What changed from one protocol to the next, value by value.


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


_FIRST = {"descending": "highest", "ascending": "lowest"}
REGION_WORDS = {RegionKind.PHYSICAL: "occupied", RegionKind.CONFLICT: "no-go"}


@dataclass(frozen=True)
class TaskLine:
    """One task of the taxonomy table."""

    task: Task
    title: str
    region: str
    d_safe_m: float
    d_safe_share: float
    strategies: tuple[Strategy, ...]


@dataclass(frozen=True)
class FamilyBlock:
    """One family with its tasks."""

    family: Family
    tasks: tuple[TaskLine, ...]


@dataclass(frozen=True)
class RankRule:
    """How one challenge ranks."""

    title: str
    words: str


@dataclass(frozen=True)
class ProtocolPage:
    """Everything that `protocol.html` needs."""

    protocol: Protocol
    versions: tuple[Protocol, ...]
    scene: SceneDrawing
    cards: tuple[MetricCard, ...]
    strategy_cards: tuple[MetricCard, ...]
    further_cards: tuple[tuple[str, tuple[MetricCard, ...]], ...]
    """Title and metrics of each further challenge."""
    rules: tuple[RankRule, ...]
    families: tuple[FamilyBlock, ...]
    strategies: tuple[Strategy, ...]
    previous: Protocol | None
    changes: tuple[Change, ...]


def protocol_page(
    protocol: Protocol, versions: Sequence[Protocol], drawing: ProtocolDrawing
) -> ProtocolPage:
    """Set a protocol; `versions` are all of them, oldest first."""
    (_, cards), (_, strategy_cards), *further = (
        (each.title, metric_cards(each)) for each in CHALLENGES.values()
    )
    previous = _previous(protocol, versions)
    return ProtocolPage(
        protocol=protocol,
        versions=tuple(versions),
        scene=scene_drawing(drawing, protocol),
        cards=cards,
        strategy_cards=strategy_cards,
        further_cards=tuple(further),
        rules=_rank_rules(protocol),
        families=_families(protocol),
        strategies=_by_caution(protocol),
        previous=previous,
        changes=protocol_changes(previous, protocol) if previous else (),
    )


def _previous(protocol: Protocol, versions: Sequence[Protocol]) -> Protocol | None:
    digests = [version.digest for version in versions]
    place = digests.index(protocol.digest) if protocol.digest in digests else 0
    return versions[place - 1] if place else None


def _rank_rules(protocol: Protocol) -> tuple[RankRule, ...]:
    rules = []
    for challenge in CHALLENGES.values():
        keys = protocol.ranking.order_of(challenge)
        words = [f"{challenge.metric(key.metric).label}, {_FIRST[key.order]} first" for key in keys]
        rules.append(RankRule(challenge.title, ", then ".join(words)))
    return tuple(rules)


def _families(protocol: Protocol) -> tuple[FamilyBlock, ...]:
    scale = protocol.grading.d_safe_scale
    top = max(task.d_safe_m for task in protocol.tasks) * scale
    return tuple(
        FamilyBlock(
            family,
            tuple(
                TaskLine(
                    task=task,
                    title=task.name.replace("_", " ").capitalize(),
                    region=REGION_WORDS[task.region],
                    d_safe_m=task.d_safe_m * scale,
                    d_safe_share=100 * task.d_safe_m * scale / top,
                    strategies=task.acceptable,
                )
                for task in protocol.taxonomy.tasks_of(family.id)
            ),
        )
        for family in protocol.families
    )


def _by_caution(protocol: Protocol) -> tuple[Strategy, ...]:
    return tuple(sorted(Strategy, key=lambda strategy: protocol.grading.caution[strategy.value]))
