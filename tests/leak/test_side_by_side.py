"""What reads many regions at once, one sample of each task: by usual settings told apart, not by advised."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from exceptiondrive_schemas.protocol import NEWEST_WITHHELD, packaged_protocol

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

METRICS = ("hcc", "hpr", "ur")


def test_21_samples_are_read_side_by_side_by_usual_settings_and_only_summed_by_advised(
    oracle: "Oracle",
) -> None:
    read = np.unique(oracle.split.arrays.task_index, return_index=True)[1]
    edited = np.full((oracle.split.arrays.n_samples, 6, 2), np.nan)
    edited[read] = 0.0
    told = {}
    for version in ("1.1", NEWEST_WITHHELD):
        sheet = replace(oracle, protocol=packaged_protocol(version)).ask(edited)
        cells = [*sheet.families.values(), *sheet.tasks.values()]
        told[version] = sum(
            any(cell.metrics[metric] is not None for metric in METRICS) for cell in cells
        )
    assert len(read) == 21
    assert told == {"1.1": 27, NEWEST_WITHHELD: 0}
