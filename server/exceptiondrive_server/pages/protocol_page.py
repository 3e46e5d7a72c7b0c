"""The page of a protocol: its rules in words, with the values of the document."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.drawing import ProtocolDrawing
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.taxonomy import Family, RegionKind, Strategy, Task
from exceptiondrive_server.pages.page_parts import MetricCard, metric_cards
from exceptiondrive_server.pages.protocol_diff import Change, protocol_changes
from exceptiondrive_server.pages.scene_drawing import SceneDrawing, scene_drawing

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
    rules: tuple[RankRule, ...]
    families: tuple[FamilyBlock, ...]
    strategies: tuple[Strategy, ...]
    previous: Protocol | None
    changes: tuple[Change, ...]


def protocol_page(
    protocol: Protocol, versions: Sequence[Protocol], drawing: ProtocolDrawing
) -> ProtocolPage:
    """Set a protocol; `versions` are all of them, oldest first."""
    cards, strategy_cards = (metric_cards(challenge) for challenge in CHALLENGES.values())
    previous = _previous(protocol, versions)
    return ProtocolPage(
        protocol=protocol,
        versions=tuple(versions),
        scene=scene_drawing(drawing, protocol),
        cards=cards,
        strategy_cards=strategy_cards,
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
