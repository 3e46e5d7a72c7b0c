"""The changes from one protocol to another, in plain words, and the stages that must be repeated.

Pure: two documents in, sentences out. The stages are those of the protocol's own digests: geometry
is measured; grading, plausibility and taxonomy are graded; ranking is ranked; the publication
section affects digits alone.
"""

from collections.abc import Iterator
from typing import Any

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.datasheet import SplitChange
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.python310 import StrEnum
from exceptiondrive_schemas.split import Manifest


class Stage(StrEnum):
    """The work that a change repeats; each includes what stands below it."""

    MEASURE = "measure"
    GRADE = "grade"
    RANK = "rank"
    PUBLICATION = "publication"
    NONE = "none"


_HEAVIEST_FIRST = tuple(Stage)
_WORK = {
    Stage.MEASURE: "measure, grade and rank again",
    Stage.GRADE: "regrade only",
    Stage.RANK: "rank again only",
    Stage.PUBLICATION: "round again only",
    Stage.NONE: "nothing to recompute: every number stays",
}
_STAGE_OF_SECTION = {
    "geometry": Stage.MEASURE,
    "grading": Stage.GRADE,
    "plausibility": Stage.GRADE,
    "families": Stage.GRADE,
    "tasks": Stage.GRADE,
    "ranking": Stage.RANK,
    "publication": Stage.PUBLICATION,
}
_SELF_DESCRIPTION = ("schema", "version", "title", "changes")
_NAMES = {
    "d_safe_m": "required clearance",
    "d_safe_scale": "factor of every required clearance",
    "caution": "strategies from least to most cautious",
    "acceptable": "acceptable strategies",
    "under_warning": "under-warning strategies",
    "unranked_flags": "flags with which an entry is listed without a rank",
    "min_scenes": "fewest scenes for an interval",
}
"""Words for fields whose names do not read well."""
_STRATEGY_SETS = ("acceptable", "under_warning")
_UNITS = {
    "_m": "m",
    "_s": "s",
    "_deg": "degrees",
    "_mps": "m/s",
    "_mps2": "m/s²",
    "_m2": "m²",
}


class Change(Document):
    """One change: a sentence, and the heaviest stage it repeats."""

    sentence: str
    stage: Stage


class Difference(Document):
    """All changes between two protocols, and two split revisions."""

    changes: tuple[Change, ...]
    stage: Stage
    n_sheets: int
    sentence: str
    remark: str | None = Field(default=None, exclude_if=lambda it: it is None)
    """What is unusual and may be meant; left out where nothing is."""

    @property
    def sentences(self) -> tuple[str, ...]:
        """The changes in words."""
        return tuple(change.sentence for change in self.changes)


def protocol_difference(
    old: ProtocolDocument, new: ProtocolDocument, n_sheets: int, *, split: tuple[Change, ...] = ()
) -> Difference:
    """Return every change from `old` to `new` in plain words, those of the split revision first.

    `n_sheets` is the number of sheets to recompute, if any change requires it.
    """
    changes = (*split, *_protocol_changes(old, new))
    stages = {change.stage for change in changes} or {Stage.NONE}
    stage = next(stage for stage in _HEAVIEST_FIRST if stage in stages)
    n_repeated = 0 if stage is Stage.NONE else n_sheets
    work = "" if stage is Stage.NONE else f", {counted(n_repeated, 'sheet')}"
    return Difference(
        changes=changes,
        stage=stage,
        n_sheets=n_repeated,
        sentence=f"{_WORK[stage]}{work}",
        remark="; ".join(_author_remarks(old, new)) or None,
    )


def _author_remarks(old: ProtocolDocument, new: ProtocolDocument) -> Iterator[str]:
    if _numbers(new.version) < _numbers(old.version):
        yield f"{new.version} is an earlier version than {old.version}"
    if new.changes == old.changes and new.digest != old.digest:
        yield f"`changes` still says what it said in {old.version}"
    if new.title == old.title and old.version in old.title and new.version != old.version:
        yield f"the title is still {old.title}"
    files = old.geometry
    if (files.waypoints, files.time_step_s) != (new.geometry.waypoints, new.geometry.time_step_s):
        yield (
            f"accepted planners' files hold {files.waypoints} waypoints {files.time_step_s:g} s apart and "
            "cannot be scored under it: a run is refused, open a new phase instead"
        )


def _numbers(version: str) -> list[int]:
    """Return a version's sort key: 1.9 before 1.10; a suffix, as in 1.1-withheld, is ignored."""
    return [int(part) for part in version.partition("-")[0].split(".")]


def split_changes(
    old: Manifest,
    new: Manifest,
    n_counted: tuple[int, int] | None = None,
    steps: tuple[SplitChange, ...] = (),
) -> tuple[Change, ...]:
    """Return the changes between two revisions of a split, as far as they are public.

    `n_counted` is N of the earlier and of the later one; `steps` are the makers' notes on each step
    between them, oldest first. Changes of a step may be reverted by a later one.
    """
    if old.revision == new.revision:
        return ()
    before, after = set(old.sample_ids), set(new.sample_ids)
    sentences = []
    for step in steps:
        where = "" if step is steps[-1] else "in a revision between: "
        sentences += [step.words, *(f"{where}{told}" for told in step.counts)]
    if n_counted is not None and n_counted[0] != n_counted[1]:
        sentences.append(f"N goes from {n_counted[0]:,} to {n_counted[1]:,}")
    if after - before:
        sentences.append(f"the split gains {counted(len(after - before), 'sample')}")
    if before - after:
        sentences.append(f"the split loses {counted(len(before - after), 'sample')}")
    if not sentences:
        sentences.append(
            f"the split's {len(after):,} samples stay; their regions, tasks or scenes change"
        )
    return tuple(Change(sentence=text, stage=Stage.MEASURE) for text in sentences)


def _protocol_changes(old: ProtocolDocument, new: ProtocolDocument) -> Iterator[Change]:
    before, after = _document(old), _document(new)
    for section, stage in _STAGE_OF_SECTION.items():
        if section in ("families", "tasks"):
            yield from _item_changes(section, stage, before[section], after[section])
            continue
        for name in sorted(before[section] | after[section]):
            pair = before[section].get(name), after[section].get(name)
            if pair[0] == pair[1]:
                continue
            if name == "order":
                yield from _order_changes(stage, *pair)
            else:
                yield Change(sentence=_value_sentence(_field_title(name), name, *pair), stage=stage)


def _order_changes(stage: Stage, old: dict[str, Any], new: dict[str, Any]) -> Iterator[Change]:
    """Name the metrics by which each challenge ranks, if that changes."""
    for challenge in (key for key in new | old if old.get(key) != new.get(key)):
        before, after = (_order_words(side.get(challenge)) for side in (old, new))
        yield Change(
            sentence=f"entries of the {challenge} challenge are ranked by {before} -> {after}",
            stage=stage,
        )


def _order_words(keys: list[dict[str, str]] | None) -> str:
    if keys is None:
        return "its primary metrics in order of their columns"
    ends = {"descending": "highest first", "ascending": "lowest first"}
    return ", then ".join(f"{key['metric']} ({ends[key['order']]})" for key in keys)


def _item_changes(
    section: str, stage: Stage, before: dict[str, Any], after: dict[str, Any]
) -> Iterator[Change]:
    noun = {"families": "family", "tasks": "task"}[section]
    for key in (key for key in after if key not in before):
        yield Change(sentence=f"{noun} {key} is new", stage=stage)
    for key in (key for key in before if key not in after):
        yield Change(sentence=f"{noun} {key} is gone", stage=stage)
    for key in (key for key in before if key in after and before[key] != after[key]):
        old, new = before[key], after[key]
        for name in (name for name in new if old.get(name) != new.get(name)):
            title = new.get("name") or new.get("title") or key
            label = f"{_field_title(name)} of {noun} {key} ({str(title).replace('_', ' ')})"
            yield Change(
                sentence=_value_sentence(label, name, old.get(name), new.get(name)), stage=stage
            )
    common = [key for key in after if key in before]
    if common != [key for key in before if key in after]:
        yield Change(sentence=f"the order of the {section} changes", stage=stage)


def _document(protocol: ProtocolDocument) -> dict[str, Any]:
    document = protocol.model_dump(mode="json", by_alias=True)
    for name in _SELF_DESCRIPTION:
        del document[name]
    for name in ("families", "tasks"):
        document[name] = {item["id"]: item for item in document[name]}
    return document


def _field_title(name: str) -> str:
    if name in _NAMES:
        return _NAMES[name]
    suffix = _unit_suffix(name)
    return (name.removesuffix(suffix) if suffix else name).replace("_", " ")


def _unit_suffix(name: str) -> str | None:
    found = [suffix for suffix in _UNITS if name.endswith(suffix)]
    return max(found, key=len) if found else None


def _value_sentence(label: str, name: str, old: Any, new: Any) -> str:
    if name == "caution":
        return _caution_sentence(label, old, new)
    if name == "unranked_flags":
        before, after = (
            [FLAGS[code].label if code in FLAGS else code for code in side] for side in (old, new)
        )
        return f"{label}: {_strategy_letters(before)} -> {_strategy_letters(after)}"
    if name in _STRATEGY_SETS:
        return f"{label}: {_strategy_letters(old)} -> {_strategy_letters(new)}"
    suffix = _unit_suffix(name)
    unit = f" {_UNITS[suffix]}" if suffix else ""
    return f"{label} {_value_text(old)} -> {_value_text(new)}{unit}"


def _caution_sentence(label: str, old: dict[str, int], new: dict[str, int]) -> str:
    before, after = _by_caution(old), _by_caution(new)
    if before == after:
        return f"{label}: as before, with other numbers"
    return f"{label}: {before} -> {after}"


def _by_caution(ranks: dict[str, int]) -> str:
    """Return the strategies in order, those of equal rank side by side."""
    groups: dict[int, list[str]] = {}
    for strategy, rank in sorted(ranks.items()):
        groups.setdefault(rank, []).append(strategy)
    return " < ".join(" = ".join(groups[rank]) for rank in sorted(groups))


def _strategy_letters(strategies: list[str]) -> str:
    return ", ".join(strategies) or "none"


def _value_text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, list):
        return "[" + ", ".join(_value_text(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} {_value_text(item)}" for key, item in value.items()) + "}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)
