"""Lint of a split file: warnings for its maker before it becomes a benchmark.

Sample ids of a warning are for the operator's terminal and the workshop, never for the server.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.printable import first_of
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Split
from exceptiondrive_scoring.arrays import split_arrays
from exceptiondrive_scoring.split_lint import LintedSplit, LintWarning, lint
from exceptiondrive_worker.splits.faults import SplitFault
from exceptiondrive_worker.splits.floors import SplitFloors

ADVISED = SplitFloors().min_samples_per_cell
_PARTS: tuple[SplitPart, ...] = ("public", "private")
_OF_A_BOARD = frozenset(
    {"few_scenes", "one_task", "few_scenes_of_a_family", "small_cells", "standing_still_suffices"}
)
"""Warnings about all that a board counts, perhaps a part; others are about single samples."""


def split_warnings(
    split: Split, protocol: ProtocolDocument, min_samples_per_cell: int = ADVISED
) -> tuple[LintWarning, ...]:
    """Return every warning about a split that can be scored under this protocol.

    Warnings about a part alone, which has a board of its own, name the part. `min_samples_per_cell`
    is what floors allow: as advised, from the split's own file, or 1 for a public split.
    """
    whole = _lint(split, protocol, min_samples_per_cell)
    said = {found.what for found in whole}
    of_parts = (
        replace(found, what=f"in the {part} part: {found.what}")
        for part in (_PARTS if split.has_parts else ())
        for found in _lint(split.part(part), protocol, min_samples_per_cell)
        if found.code in _OF_A_BOARD and found.what not in said
    )
    return (*whole, *_in_both_parts(split), *of_parts)


def _in_both_parts(split: Split) -> Iterator[LintWarning]:
    left = [sample for sample in split.samples if sample.withdrawn is None]
    public, private = (
        {sample.scene_id for sample in left if sample.part == part} for part in _PARTS
    )
    both = public & private
    ids = tuple(sorted(it.sample_id for it in left if it.scene_id in both))
    if ids:
        what = (
            "the scene has samples in both parts: who tunes a planner by the public part has tuned it "
            "to the scene of a private sample"
        )
        yield LintWarning("scene_in_both_parts", what, len(ids), ids)


def _lint(
    split: Split, protocol: ProtocolDocument, min_samples_per_cell: int
) -> tuple[LintWarning, ...]:
    left = [sample for sample in split.samples if sample.withdrawn is None]
    samples = sorted(left, key=lambda sample: sample.sample_id)
    linted = LintedSplit(
        sample_ids=[sample.sample_id for sample in samples],
        arrays=split_arrays(samples, protocol.taxonomy),
        is_control=np.array([sample.control for sample in samples], dtype=np.bool_),
    )
    return lint(linted, protocol, min_samples_per_cell)


def warning_lines(warnings: Sequence[LintWarning], *, with_samples: bool) -> list[str]:
    """Return one line per warning, for a terminal."""
    return [
        f"warning {found.code} ({found.count:,}): {found.what}"
        + (f": {first_of(found.sample_ids)}" if with_samples and found.sample_ids else "")
        for found in warnings
    ]


def check_report(
    split: Split, faults: Sequence[SplitFault], warnings: Sequence[LintWarning]
) -> dict[str, Any]:
    """Return the output of `check-split --json`: faults refuse the split, warnings do not."""
    return {
        "split": split.name,
        "revision": split.revision,
        "n_samples": len(split.samples),
        "faults": [
            {"what": fault.what, "count": len(fault.sample_ids), "sample_ids": fault.sample_ids}
            for fault in faults
        ],
        "warnings": [asdict(found) for found in warnings],
    }
