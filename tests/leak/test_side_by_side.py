"""What reads many regions at once, one sample of each task: told apart by usual settings, and by advised in two sums."""

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from exceptiondrive_schemas.protocol import NEWEST_WITHHELD, packaged_protocol

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

METRICS = ("hcc", "hpr", "ur")


def test_21_samples_are_read_side_by_side_by_usual_settings_and_not_by_advised(
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


def test_advised_settings_sum_by_two_weights(oracle: "Oracle") -> None:
    """Which of two samples is hit: the one of a family of 80 or the one of 60. Of 64 such patterns of six families 16 differ."""
    advised = replace(oracle, protocol=packaged_protocol(NEWEST_WITHHELD))
    first = np.unique(oracle.split.arrays.family_index, return_index=True)[1]
    still = np.zeros((oracle.split.arrays.n_samples, 6, 2))
    assert not oracle.measured(still)["intrusion"][first].any()
    told = set()
    for misses in product((False, True), repeat=6):
        edited = np.full_like(still, np.nan)
        edited[first[list(misses)]] = 0.0
        sheet = advised.ask(edited)
        told.add((sheet.micro["ur"], sheet.macro_family["ur"]))
    assert len(told) == 16
    assert len({micro for micro, _ in told}) == 7
