"""What the marks of controls hold against: over-caution names them, and a file may say nothing of some."""

from functools import cache

import numpy as np
from tests.leak.oracle import SAMPLE, FloatArray
from tests.support.cheats import File, always_brake

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import NEWEST_WITHHELD, packaged_protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_scoring.challenge import exact_sheet, scoring_of
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.splits.store import LoadedSplit, load_split, read_split

PROTOCOL = packaged_protocol(NEWEST_WITHHELD)
N_ASKED = 19
"""One less than a team has on a withheld split: the last file is the one that shall rank."""


@cache
def sample() -> LoadedSplit:
    return load_split(read_split(SAMPLE), PROTOCOL)


def recorded() -> FloatArray:
    assert sample().recorded_m is not None
    return np.asarray(sample().recorded_m, dtype=np.float64)


def braking() -> FloatArray:
    drives = recorded()
    return always_brake(File(drives, drives, np.zeros(len(drives), dtype=np.int64)), 5.0).edited


def published(source: FloatArray, edited: FloatArray) -> ScoreSheet:
    """The sheet of a file as the server publishes it of a withheld split."""
    split, scoring = sample(), scoring_of(PLANNING.id)
    assert split.rows is not None

    def of(rows: np.ndarray) -> dict[str, FloatArray]:
        return {"source": source[rows], "edited": edited[rows]}

    measured = scoring.measure(of(split.rows), split.arrays, PROTOCOL.geometry)
    said = scoring.of_controls(of(split.control_rows), PROTOCOL)
    ref = split.manifest.ref
    sheet = exact_sheet(scoring, measured, split.arrays, ref, PROTOCOL, said)
    return Rounding(PLANNING, PROTOCOL.publication).sheet(sheet)


def barring(sheet: ScoreSheet) -> set[str]:
    return {flag.code for flag in sheet.plausibility.flags} & set(PROTOCOL.ranking.unranked_flags)


def test_submissions_of_one_team_tell_enough_of_the_controls_to_rank_while_braking() -> None:
    """It brakes in half of the samples, drawn anew each time, and weighs who was there when many held back."""
    drives, brakes = recorded(), braking()
    draw, n = np.random.default_rng(1), len(drives)
    is_braking = np.array([draw.permutation(n) < n // 2 for _ in range(N_ASKED)])
    told = []
    for braked in is_braking:
        sheet = published(drives, np.where(braked[:, None, None], brakes, drives))
        over_caution = sheet.micro["over_caution"]
        assert over_caution is not None
        told.append(over_caution)
    weights = is_braking - is_braking.mean(axis=1, keepdims=True)
    excess = np.array(told) - is_braking.mean(axis=1)
    likely = np.argsort(-weights.T @ np.linalg.solve(weights @ weights.T, excess))
    spared = np.isin(np.arange(n), likely[: n // 4])
    last = published(drives, np.where(spared[:, None, None], drives, brakes))
    assert barring(last) == set()
    assert last.macro_family["hcc"] is not None
    assert last.macro_family["hcc"] > 0.6, "the best honest planner has 0.34"
    assert barring(published(drives, brakes)) == {"over_cautious"}


def test_a_file_that_stands_in_both_inputs_of_some_controls_is_judged_by_the_others() -> None:
    """Its progress there is undefined; 20 controls are what the split has, whatever a file says."""
    drives, brakes = recorded(), braking()
    asleep = (np.arange(len(drives)) % 3 == 0)[:, None, None]
    sheet = published(np.where(asleep, 0.0, drives), np.where(asleep, 0.0, brakes))
    assert sheet.micro["over_caution"] == 1.0
    assert barring(sheet) == {"over_cautious"}


def test_braking_in_just_under_half_the_scenes_gains_and_is_not_flagged() -> None:
    drives, brakes = recorded(), braking()
    sometimes = (np.arange(len(drives)) % 20 < 9)[:, None, None]
    sheet = published(drives, np.where(sometimes, brakes, drives))
    assert barring(sheet) == set()
    assert round(sheet.macro_family["hcc"] or 0, 3) == 0.39
    assert sheet.micro["over_caution"] == 0.3333
    assert round(published(drives, drives).macro_family["hcc"] or 0, 3) == 0.026
