"""Everything that a board or a sheet says has been weighed: a new field has to be, too.

Each field names what it is made of. What is made of regions is bounded in docs/leakage.md; what is
made of answers and labels alone tells no region.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from pydantic import BaseModel
from tests.leak.channels import CHANNELS

from exceptiondrive_records.phases.policy import without_breakdown
from exceptiondrive_schemas.api.phase_report import PhaseReport, PlaceChange, ShakeUp
from exceptiondrive_schemas.board import Board, BoardEntry, FamilyCell, FamilyHead, PairedComparison
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY
from exceptiondrive_schemas.check import StrategyAnswer
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.protocol import NEWEST_WITHHELD, packaged_protocol
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    ClearanceCurve,
    Coverage,
    PairedDifference,
    Plausibility,
    ReminderEffect,
    ScoreSheet,
)
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.submission_files import ReminderRecord
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_scoring.challenge import exact_sheet, scoring_of
from exceptiondrive_scoring.strategy import strategy_answers
from exceptiondrive_worker.boards.rounding import Rounding

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

RECORDS = "who, when, under what: nothing of a split"
ANSWERS = "the upload alone"
LABELS = "the upload, and which samples are of which task and family, or count"
CONTROLS = "the upload, and which samples are controls"
DRIVES = "the upload and recorded paths: by cells only where these are public"
REGIONS = "regions, by cells of a least size, rounded: the bounds of docs/leakage.md"
BOARDS = "published boards alone, which are weighed here: nothing that they do not tell"
TOTALS = "regions, of withheld splits in the totals alone"
PUBLIC = "regions of public splits, unless a protocol says otherwise"
CELLS = "a row of metrics for each, weighed one by one below"
SOME = "answers to some samples, their tasks and acceptable sets: by rows of a least size that say their `n`"

METRICS = {
    **dict.fromkeys(("hcc", "ur", "hpr"), REGIONS),
    **dict.fromkeys(("cts", "cts_x", "cts_y", "progress"), LABELS),
    **dict.fromkeys(("clear", "close", "hit_reacting", "hit_unmoved"), TOTALS),
    **dict.fromkeys(("source_l2_m", "source_l2_1s_m", "source_l2_2s_m", "source_l2_3s_m"), DRIVES),
    "over_caution": CONTROLS,
}
FLAGGED = {
    **dict.fromkeys(("stands_still", "source_stands_still", "impossible_motion"), ANSWERS),
    **dict.fromkeys(("reverses", "blind_to_the_edit", "same_answer"), ANSWERS),
    "off_course": DRIVES,
    "hardly_moves": LABELS,
    "over_cautious": CONTROLS,
}
FURTHER_ROWS = {"d_safe_x": REGIONS, "confusion_": SOME, "reminder": SOME}
"""By what their names begin with."""
WEIGHED: dict[type[BaseModel], dict[str, str]] = {
    Board: {
        **dict.fromkeys(("challenge", "phase", "split", "protocol", "headline", "board"), RECORDS),
        **dict.fromkeys(("published_at", "confidence", "interval_method", "view", "part"), RECORDS),
        "min_scenes": RECORDS,
        **dict.fromkeys(("n_samples", "families"), LABELS),
        **dict.fromkeys(("entries", "comparisons"), CELLS),
    },
    BoardEntry: {
        **dict.fromkeys(("source", "submission_id", "method", "team", "description"), RECORDS),
        **dict.fromkeys(("links", "submitted_at", "cite", "is_late", "previous_rank"), RECORDS),
        **dict.fromkeys(("rank", "rank_interval", "unranked_because"), REGIONS),
        **dict.fromkeys(("metrics", "micro", "macro_family", "families", "intervals"), CELLS),
        "reminder_effect": REGIONS,
        "coverage": ANSWERS,
        **dict.fromkeys(("flags", "unranked_flags"), CELLS),
    },
    FamilyCell: {"n": LABELS, "intervals": CELLS},
    FamilyHead: {"id": RECORDS, "title": RECORDS, "n": LABELS, "n_scenes": LABELS},
    PairedComparison: {
        **dict.fromkeys(("a", "b"), RECORDS),
        **dict.fromkeys(("overall", "families", "tasks"), CELLS),
    },
    PairedDifference: {
        "discordant": PUBLIC,
        **dict.fromkeys(("difference", "interval", "verdict"), REGIONS),
    },
    ReminderEffect: {
        **dict.fromkeys(("without", "without_method"), RECORDS),
        "differences": CELLS,
    },
    BreakdownRow: {"n": LABELS},
    ScoreSheet: {
        **dict.fromkeys(("challenge", "protocol", "split", "scorer_version"), RECORDS),
        "n": LABELS,
        **dict.fromkeys(("micro", "macro_family", "families", "tasks"), CELLS),
        **dict.fromkeys(("coverage", "plausibility"), CELLS),
        "extra": CELLS,
        "clearance_curve": PUBLIC,
    },
    PhaseReport: {
        **dict.fromkeys(("phase", "title", "challenge", "opened_at", "closed_at"), RECORDS),
        **dict.fromkeys(("board", "board_digest", "published_at", "split", "part"), BOARDS),
        **dict.fromkeys(("protocol", "protocols", "n_samples", "n_boards", "n_teams"), BOARDS),
        **dict.fromkeys(("n_submissions", "n_ranked", "n_listed", "winners"), BOARDS),
        **dict.fromkeys(("may_be_first", "flags", "shake_up"), BOARDS),
    },
    ShakeUp: dict.fromkeys(("board", "part", "places"), BOARDS),
    PlaceChange: dict.fromkeys(
        ("submission_id", "method", "team", "before", "after", "is_another_run"), BOARDS
    ),
    Coverage: dict.fromkeys(("edited", "source", "n_edited", "n_source"), ANSWERS),
    Plausibility: {"shares": ANSWERS, "flags": CELLS},
    ClearanceCurve: dict.fromkeys(("step", "micro", "macro_family"), PUBLIC),
    Manifest: {
        **dict.fromkeys(("schema_", "name", "title", "revision"), RECORDS),
        **dict.fromkeys(("waypoints", "time_step_s", "sample_ids"), RECORDS),
        "recorded": "recorded paths, where the split says that they are public",
        "challenge": RECORDS,
    },
}


COUNTED_IN: dict[type[BaseModel], dict[str, str]] = {
    Board: {"entries": "means of the totals", "comparisons": "pair intervals"},
    BoardEntry: {
        **dict.fromkeys(("metrics", "micro", "macro_family"), "means of the totals"),
        "families": "means of families and tasks",
        "intervals": "intervals",
        **dict.fromkeys(("rank", "unranked_because"), "means of the totals"),
        "rank_interval": "rank intervals",
        "reminder_effect": "pair intervals",
        **dict.fromkeys(("flags", "unranked_flags"), "progress, CTS, Source L2, flags"),
    },
    FamilyCell: {"intervals": "intervals"},
    PairedComparison: dict.fromkeys(("overall", "families", "tasks"), "pair intervals"),
    PairedDifference: {
        "difference": "means of the totals",
        **dict.fromkeys(("interval", "verdict"), "pair intervals"),
        "discordant": "discordant shares",
    },
    ReminderEffect: {"differences": "pair intervals"},
    ScoreSheet: {
        **dict.fromkeys(("micro", "macro_family"), "means of the totals"),
        **dict.fromkeys(("families", "tasks"), "means of families and tasks"),
        "extra": "sensitivities",
        "clearance_curve": "clearance curve",
        **dict.fromkeys(("coverage", "plausibility"), "progress, CTS, Source L2, flags"),
    },
    Plausibility: {"flags": "progress, CTS, Source L2, flags"},
    ClearanceCurve: dict.fromkeys(("step", "micro", "macro_family"), "clearance curve"),
}
"""The channel of the audit that counts what a field tells of regions; equal ones are one reading."""


@pytest.mark.parametrize("document", WEIGHED, ids=lambda document: document.__name__)
def test_what_is_made_of_regions_is_counted_by_the_audit(document: type[Any]) -> None:
    of_regions = {REGIONS, TOTALS, PUBLIC, CELLS}
    fields = {name for name, made_of in WEIGHED[document].items() if made_of in of_regions}
    counted = COUNTED_IN.get(document, {})
    assert fields == set(counted), "count the field in a channel of tests/leak/channels.py"
    assert set(counted.values()) <= set(CHANNELS)


@pytest.mark.parametrize("document", WEIGHED, ids=lambda document: document.__name__)
def test_every_field_that_is_published_has_been_weighed(document: type[Any]) -> None:
    assert set(document.model_fields) == set(WEIGHED[document]), (
        "weigh the new field with tests/leak/test_audit.py, say in docs/leakage.md what it tells of a "
        "withheld split, and name it here"
    )


def test_every_metric_and_every_flag_has_been_weighed() -> None:
    assert {metric.key for metric in (*PLANNING.metrics, *PLANNING.of_controls)} == set(METRICS)
    assert set(FLAGS) == set(FLAGGED)


def test_every_further_row_has_been_weighed(oracle: "Oracle") -> None:
    """One answer and one record, about one sample: of it alone no row tells more than that it counts."""
    split, protocol = oracle.split, packaged_protocol(NEWEST_WITHHELD)
    record = ReminderRecord(hazard_present=True, hazard_type="SE1", recommended_strategy=Strategy.C)
    others = [StrategyAnswer(None, None)] * (split.arrays.n_samples - 1)
    answers = strategy_answers([StrategyAnswer(None, record), *others]).columns()
    still = oracle.measured(np.zeros((split.arrays.n_samples, 6, 2)))
    for challenge, measured in ((PLANNING, still), (STRATEGY, answers)):
        ref = split.manifest.ref
        exact = exact_sheet(scoring_of(challenge.id), measured, split.arrays, ref, protocol)
        told = Rounding(challenge, protocol.publication).sheet(exact)
        for name, row in told.extra.items():
            (made_of,) = (it for key, it in FURTHER_ROWS.items() if name.startswith(key))
            if made_of == SOME and (row["n"] or 0) < 100:
                assert set(row.values()) == {row["n"], None}, name
            assert made_of == SOME or "n" not in row, name
    assert told.extra["reminder"]["n"] == 1
    assert without_breakdown(exact).extra == {"reminder": {"n": 1}}


def test_a_metric_is_told_by_cells_as_it_was_weighed() -> None:
    due = {TOTALS: "of public regions", DRIVES: "of public drives"}
    for metric in PLANNING.metrics:
        assert metric.cells == due.get(METRICS[metric.key], "always"), metric.key
