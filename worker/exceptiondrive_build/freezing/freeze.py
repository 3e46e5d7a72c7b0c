"""Freezing: from the records to a split, and to everything that is published beside it.

A pure function of workshop and previous revision: the same decisions give the same bytes, whenever
they were made and however often the work was interrupted. Only `split.json.gz` holds regions.
"""

import gzip
import json
from base64 import b64encode
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from exceptiondrive_build.agreement import agreement, orders, outcome
from exceptiondrive_build.candidates import Candidate
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.freezing.croissant import croissant
from exceptiondrive_build.freezing.datasheet_text import html_of, markdown_of
from exceptiondrive_build.inspection import to_inspect
from exceptiondrive_build.numbers import audit, cells, deciders, stages
from exceptiondrive_build.records import Kind, Record
from exceptiondrive_build.values import Corners, Edited
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.datasheet import (
    Cell,
    Datasheet,
    Example,
    SplitChange,
    WithdrawnSamples,
    Words,
)
from exceptiondrive_schemas.split import Manifest, Split, SplitSample
from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_worker.splits.faults import split_faults
from exceptiondrive_worker.splits.small_jpeg import LONGEST_SIDE_PX, PICTURES, small_jpeg
from exceptiondrive_worker.splits.store import parts_of
from exceptiondrive_worker.splits.warnings import split_warnings

EXAMPLE_WIDTH_PX = 640
_NAMED = 10


@dataclass(frozen=True)
class Frozen:
    """A split and what is published beside it; provenance lists its decisions sample by sample."""

    split: Split
    datasheet: Datasheet
    provenance: tuple[Record, ...]
    manifest: Manifest

    def files(self) -> dict[str, bytes]:
        """Return content by file name. `split.json.gz` and `provenance.jsonl` are withheld.

        Provenance holds digests of prompts, and so reveals which samples share a task.
        """
        manifest = canonical_json(self.manifest)
        sheet = canonical_json(self.datasheet)
        return {
            "split.json.gz": gzipped(self.split),
            "manifest.json": manifest,
            "datasheet.json": sheet,
            "datasheet.md": markdown_of(self.datasheet).encode(),
            "datasheet.html": html_of(self.datasheet).encode(),
            "croissant.json": croissant(
                self.datasheet, {"manifest.json": manifest, "datasheet.json": sheet}
            ),
            "provenance.jsonl": b"".join(map(_provenance_line, self.provenance)),
        }


def freeze(
    workshop: Workshop,
    candidates: Mapping[str, Candidate],
    previous: Split | None = None,
    words: str = "",
    sheet_before: Datasheet | None = None,
) -> Frozen:
    """Freeze all samples that are accepted and verified.

    All samples of a previous revision stay, each counted or withdrawn; new ones wait for the next
    split, since files for this one do not answer them. Readers see `words` about the change. If new
    candidates were added since, `sheet_before` describes how the split was made.

    Raises:
        BuildError: Nothing is verified, a sample of the previous revision is neither verified nor
            withdrawn, a control or an example does not exist, or the split cannot be scored.
    """
    split = _split(workshop, candidates, previous)
    settings = workshop.settings
    if (settings.datasheet.examples or settings.freeze.pictures) and not settings.licence:
        advice = "Say in workshop.toml under which `licence` they may be."
        raise BuildError("Pictures are to be shown, and there is no licence to.", advice)
    if previous is not None and not words.strip():
        raise BuildError("A revision says in words what changed.", "Add --words.")
    _refuse_faults(split, workshop)
    sheet = _datasheet(workshop, candidates, split, previous, words)
    in_split = {it.sample_id for it in split.samples}
    of_the_next = _regions(workshop, candidates).keys() - in_split - withdrawals(workshop).keys()
    return Frozen(
        split=split,
        datasheet=_as_counted_before(sheet, sheet_before, some_verified=bool(of_the_next)),
        provenance=tuple(
            record
            for key in sorted(it.sample_id for it in split.samples)
            for record in candidates[key].decisions
        ),
        manifest=Manifest.of(split, workshop.protocol.geometry),
    )


def _split(
    workshop: Workshop, candidates: Mapping[str, Candidate], previous: Split | None
) -> Split:
    settings, withdrawn = workshop.settings, withdrawals(workshop)
    regions = _regions(workshop, candidates)
    before = () if previous is None else previous.samples
    earlier = {it.sample_id: it for it in before}
    wanted = earlier if earlier else {key: None for key in regions if key not in withdrawn}
    if previous is not None and previous.name != settings.name:
        raise BuildError(f"The previous revision is of {previous.name!r}, not {settings.name!r}.")
    named = {"Controls": settings.freeze.controls, "Public samples": settings.freeze.public_part}
    for what, sample_ids in named.items():
        _refuse_some(
            [key for key in sample_ids if key not in wanted and key not in withdrawn],
            f"{what} in workshop.toml that are not verified",
            "Take them out of [freeze], or verify them.",
        )
    _refuse_some(
        [key for key in wanted if key not in candidates],
        "Samples of the previous revision whose scene or task is not in the workshop any more",
        "Read their scenes in again: exceptiondrive-build scenes read SOURCE; and put their tasks "
        "back into workshop.toml.",
    )
    times_there = Counter(it.sample_id for it in before)
    _refuse_some(
        [
            key
            for key, it in earlier.items()
            if times_there[key] > 1 or it.task != candidates[key].task.id
        ],
        "Samples of the previous revision that stand there twice, or with another task",
        "Name its file as it was frozen.",
    )
    lacking = [key for key in wanted if key not in regions and key not in withdrawn]
    _refuse_some(
        _asked_otherwise(workshop, candidates, lacking),
        "Samples of the previous revision that were decided with other words, models or settings",
        "Put back what workshop.toml, tasks.toml and prompts/ said: the answers count again. Or run the "
        "stages again.",
    )
    _refuse_some(
        lacking,
        "Samples of the previous revision that are not accepted and verified any more",
        "Have them inspected and verified: exceptiondrive-build review; or withdraw them: "
        'exceptiondrive-build withdraw ID --reason "..." --by NAME',
    )
    if not wanted:
        raise BuildError(
            "Nothing is accepted and verified yet.", "See `exceptiondrive-build report`."
        )
    samples = [  # a withdrawn one keeps its region, which nothing reads: the file stays a split
        earlier[key].model_copy(update={"withdrawn": withdrawn[key]})
        if key in withdrawn
        else _sample(workshop, candidates[key], regions[key], wanted[key])
        for key in sorted(wanted)
    ]
    return Split(
        schema_="exceptiondrive.split/1",
        name=settings.name,
        title=settings.title,
        samples=tuple(_in_parts(samples, set(settings.freeze.public_part))),
        recorded_is_public=settings.freeze.recorded_is_public,
    )


def _in_parts(samples: list[SplitSample], public: set[str]) -> Iterator[SplitSample]:
    """Assign samples without a part to one, if the settings name public samples."""
    for it in samples:
        part = "public" if it.sample_id in public else "private"
        yield it.model_copy(update={"part": part}) if public and it.part is None else it


def parted_otherwise(workshop: Workshop, split: Split) -> int:
    """Return how many samples have another part than in the settings, if those name public ones."""
    public = set(workshop.settings.freeze.public_part)
    return sum((it.part == "public") != (it.sample_id in public) for it in split.samples if public)


def _asked_otherwise(
    workshop: Workshop, candidates: Mapping[str, Candidate], sample_ids: list[str]
) -> list[str]:
    """Return the samples that a model decided which would be asked differently now."""
    told = {kind: workshop.current(kind) for kind in (Kind.SCREEN, Kind.EDIT, Kind.REVIEW)}
    return [
        key
        for key in sample_ids
        if any(key in found and kind not in candidates[key].current for kind, found in told.items())
    ]


def withdrawals(workshop: Workshop) -> dict[str, str]:
    """Return the reason of each withdrawal by sample id."""
    standing = workshop.current(Kind.WITHDRAW)
    return {key: str((record.value or {})["reason"]) for key, record in standing.items()}


def _regions(workshop: Workshop, candidates: Mapping[str, Candidate]) -> dict[str, Corners]:
    """Return the corners of each candidate that is accepted and verified."""
    found = {}
    for sample_id, candidate in candidates.items():
        if candidate.is_accepted:
            corners = outcome(candidate.verifications, workshop.settings.verify).corners
            if corners is not None:
                found[sample_id] = corners
    return found


def undecided(workshop: Workshop, candidates: Mapping[str, Candidate]) -> int:
    """Return the number of accepted edits whose region waits for a reader."""
    limits, withdrawn = workshop.settings.verify, withdrawals(workshop)
    return sum(
        candidate.is_accepted
        and sample_id not in withdrawn
        and outcome(candidate.verifications, limits).state in ("open", "third")
        for sample_id, candidate in candidates.items()
    )


def not_inspected(workshop: Workshop, candidates: Mapping[str, Candidate], split: Split) -> int:
    """Return how many samples that a person should inspect nobody has inspected."""
    taken = {sample.sample_id for sample in split.samples if sample.withdrawn is None}
    wanted = to_inspect(candidates, workshop.settings.inspect)
    return sum(key in taken and candidates[key].inspected is None for key in wanted)


def _sample(
    workshop: Workshop, candidate: Candidate, region: Corners, earlier: SplitSample | None = None
) -> SplitSample:
    """Return a sample from the workshop; unknown values come from the earlier revision's file."""
    settings, drive = workshop.settings.freeze, candidate.keyframe.recorded
    sample = SplitSample(
        sample_id=candidate.sample_id,
        scene_id=candidate.keyframe.scene_id,
        task=candidate.task.id,
        region=region,
        recorded=drive if settings.recorded else None,
        control=candidate.sample_id in settings.controls,
    )
    if earlier is None:
        return sample
    kept = {name: getattr(earlier, name) for name in ("part", "d_safe_m", "acceptable")}
    if earlier.region in orders(region):
        kept["region"] = earlier.region  # another first corner is no change
    if drive is None:
        kept["recorded"] = earlier.recorded
    return sample.model_copy(update=kept)


def changed_alone(previous: Split, split: Split, taxonomy: Taxonomy) -> list[str]:
    """Return the families in which exactly one sample, or one of a part, counts differently now."""
    before, after = ({it.sample_id: it.region for it in each.counted} for each in (previous, split))
    changed = Counter(
        (taxonomy.task(it.task).family, it.part)
        for it in split.samples
        if before.get(it.sample_id) != after.get(it.sample_id)
    )
    return [
        f"{family.title} ({part} part)" if part else family.title
        for family in taxonomy.families
        for part in parts_of(split)
        if changed[family.id, part] == 1
    ]


def auxiliary(workshop: Workshop, candidates: Mapping[str, Candidate], split: Split) -> Split:
    """Return the edited pairs that are not in the benchmark, as a separate split.

    Their regions are verified, proposed, or a rectangle of the task's size at the target: they
    serve the study of failures, and no board. Those that cannot be scored are left out.

    Raises:
        BuildError: There is none.
    """
    name = f"{split.name}-auxiliary"
    taken = {sample.sample_id for sample in split.samples}
    rest = [
        _sample(workshop, candidate, region)
        for key, candidate in sorted(candidates.items())
        if key not in taken and (region := _likely_region(workshop, candidate)) is not None
    ]
    if not rest:
        raise BuildError("No edited pair is left beside the benchmark.")
    title = f"{workshop.settings.title}: auxiliary set, regions not verified"
    whole = Split(schema_="exceptiondrive.split/1", name=name, title=title, samples=tuple(rest))
    unsound = {
        sample_id
        for fault in split_faults(whole, workshop.protocol)
        for sample_id in fault.sample_ids
    }
    sound = tuple(sample for sample in rest if sample.sample_id not in unsound)
    return whole.model_copy(update={"samples": sound})


def _likely_region(workshop: Workshop, candidate: Candidate) -> Corners | None:
    if not isinstance(candidate.edited, Edited) or candidate.place is None:
        return None
    verified = outcome(candidate.verifications, workshop.settings.verify).corners
    if verified is not None:
        return verified
    if candidate.localized is not None:
        return candidate.localized.corners
    if candidate.place.target_m is None:
        return None
    ahead_m, left_m = candidate.place.target_m
    length_m, width_m, _ = workshop.task_texts[candidate.task.id].size_m
    near, far = ahead_m - length_m / 2, ahead_m + length_m / 2
    right, left = left_m - width_m / 2, left_m + width_m / 2
    return (near, right), (far, right), (far, left), (near, left)


def gzipped(split: Split) -> bytes:
    """Return the one file of a split: samples by id, without empty values."""
    document = split.model_dump(mode="json", by_alias=True, exclude_none=True)
    document["samples"].sort(key=lambda sample: sample["sample_id"])
    return gzip.compress(canonical_json(document), mtime=0)


def _refuse_faults(split: Split, workshop: Workshop) -> None:
    faults = split_faults(split, workshop.protocol)
    if faults:
        lines = [f"{it.what} ({len(it.sample_ids)}): {_some(it.sample_ids)}" for it in faults]
        is_of_regions = any("regions" in it.what for it in faults)
        raise BuildError(
            "The split cannot be scored: " + "; ".join(lines) + ".",
            "Verify these regions again, or reject the pairs." if is_of_regions else "",
        )


def _refuse_some(sample_ids: list[str], what: str, advice: str) -> None:
    if sample_ids:
        raise BuildError(f"{what} ({len(sample_ids):,}): {_some(sample_ids)}.", advice)


def _some(sample_ids: list[str] | tuple[str, ...]) -> str:
    more = len(sample_ids) - _NAMED
    return ", ".join(sample_ids[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _datasheet(
    workshop: Workshop,
    candidates: Mapping[str, Candidate],
    split: Split,
    previous: Split | None,
    words: str,
) -> Datasheet:
    settings, taxonomy = workshop.settings, workshop.protocol.taxonomy
    counted = {sample.sample_id for sample in split.counted}
    reasons = Counter(it.withdrawn for it in split.samples if it.withdrawn is not None)
    agreed = agreement({key: it.verifications for key, it in candidates.items()}, settings.verify)
    return Datasheet(
        schema_="exceptiondrive.datasheet/1",
        name=split.name,
        title=split.title,
        revision=split.revision,
        protocol=workshop.protocol.version,
        n_samples=len(counted),
        n_scenes=len({sample.scene_id for sample in split.counted}),
        n_controls=len(split.controls),
        n_recorded=sum(it.recorded is not None for it in (*split.counted, *split.controls)),
        withdrawn=tuple(WithdrawnSamples(reason=why, n=n) for why, n in sorted(reasons.items())),
        changes=None if previous is None else SplitChange.between(previous, split, words),
        words=Words(**settings.datasheet.model_dump(exclude={"examples"})),
        stages=stages(
            candidates.values(),
            settings.verify,
            {it.sample_id for it in split.samples if it.withdrawn is None},
        ),
        families=cells(taxonomy.families, candidates.values(), counted),
        tasks=cells(workshop.tasks, candidates.values(), counted),
        audit=audit(candidates, settings.inspect),
        agreement=agreed if agreed.n else None,
        deciders=deciders(workshop, candidates.values()),
        warnings=tuple(found.told for found in split_warnings(split, workshop.protocol)),
        examples=tuple(_examples(workshop, candidates, split)),
        picture_licence=settings.licence if settings.datasheet.examples else "",
    )


def _as_counted_before(
    sheet: Datasheet, before: Datasheet | None, *, some_verified: bool
) -> Datasheet:
    """Leave out candidates of the next split: if some were added, the former counts are kept.

    New ones show in other numbers of suitable or edited candidates, or in verified ones.
    """
    if before is None or not before.stages:
        return sheet
    if before.stages[:2] == sheet.stages[:2] and not some_verified:
        return sheet
    n_of = {cell.id: cell.n for cell in (*sheet.families, *sheet.tasks)}

    def recounted(cells: tuple[Cell, ...]) -> tuple[Cell, ...]:
        return tuple(cell.model_copy(update={"n": n_of.get(cell.id, 0)}) for cell in cells)

    frozen = before.stages[-1].model_copy(update={"n": sheet.stages[-1].n})
    return sheet.model_copy(
        update={
            "stages": (*before.stages[:-1], frozen),
            "families": recounted(before.families),
            "tasks": recounted(before.tasks),
            "audit": before.audit,
            "agreement": before.agreement,
            "deciders": before.deciders,
        }
    )


def _examples(
    workshop: Workshop, candidates: Mapping[str, Candidate], split: Split
) -> Iterator[Example]:
    """Yield the pairs that the settings name; the family only if the pair is not in the split."""
    chosen = workshop.settings.datasheet.examples
    _refuse_some(
        [key for key in chosen if key not in candidates or not candidates[key].pictures],
        "Examples in workshop.toml that have no edited pictures",
        "Take them out of [datasheet] examples.",
    )
    taken = {sample.sample_id for sample in split.samples}
    titles = {family.id: family.title for family in workshop.protocol.families}
    for key in chosen:
        source, edited = _pictures(workshop, candidates[key])
        yield Example(
            caption="" if key in taken else titles[candidates[key].task.family],
            source=b64encode(small_jpeg(source, EXAMPLE_WIDTH_PX)[0]),
            edited=b64encode(small_jpeg(edited, EXAMPLE_WIDTH_PX)[0]),
        )


def pictures(
    workshop: Workshop, candidates: Mapping[str, Candidate], split: Split
) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of the pictures that the settings publish beside the split."""
    for sample in split.counted if workshop.settings.freeze.pictures else ():
        both = _pictures(workshop, candidates[sample.sample_id])
        for shows, data in zip(("source", "edited"), both, strict=True):
            jpeg, _, _ = small_jpeg(data, LONGEST_SIDE_PX)
            yield f"{PICTURES}/{sample.sample_id}.{shows}.jpg", jpeg


def _pictures(workshop: Workshop, candidate: Candidate) -> tuple[bytes, bytes]:
    """Return the first edited view: source and edit."""
    assert isinstance(candidate.edited, Edited)
    view, edited = next(iter(candidate.edited.images.items()))
    return workshop.image(candidate.keyframe.camera(view).image), workshop.image(edited)


def _provenance_line(record: Record) -> bytes:
    """Return who decided what, by digest of the record and of its inputs. No value."""
    line = {
        "candidate": record.candidate,
        "kind": record.kind.value,
        "decision": record.digest,
        "by": record.by.model_dump(exclude_none=True),
        "inputs": record.inputs,
    }
    return json.dumps(line, sort_keys=True, separators=(",", ":")).encode() + b"\n"
