import math

import pytest

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    ClearanceCurve,
    Coverage,
    Flag,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring.bootstrap import GRID
from exceptiondrive_worker.boards.rounding import Rounding

EXACT = {
    "hcc": 0.123456,
    "ur": 0.99995001,
    "hpr": None,
    "cts": 1.005001,
    "cts_x": -0.0,
    "cts_y": 2 / 3,
}
ROUNDED = {"hcc": 0.1235, "ur": 1.0, "hpr": None, "cts": 1.01, "cts_x": 0.0, "cts_y": 0.67}


@pytest.fixture
def rounding(protocol: ProtocolDocument) -> Rounding:
    return Rounding(PLANNING, protocol.publication)


@pytest.fixture
def sheet() -> ScoreSheet:
    return ScoreSheet(
        challenge=PLANNING.id,
        protocol=ProtocolRef(version="1.0", digest="sha256:0"),
        split=SplitRef(name="tiny", revision="sha256:1"),
        scorer_version="0",
        n=3,
        coverage=Coverage(edited=1 / 3, source=2 / 3),
        micro=EXACT,
        macro_family=EXACT,
        families={"lane_blockage": BreakdownRow.of(2, EXACT)},
        tasks={"LB1": BreakdownRow.of(2, EXACT), "LB2": BreakdownRow.of(1, EXACT)},
        plausibility=Plausibility(
            shares={"blind": 1 / 3, "impossible": None},
            flags=(Flag(code="x", label="X", detail="x"),),
        ),
        extra={"confusion_C": {"A": 1 / 3}},
    )


def test_fractions_get_per_cent_decimals_and_metres_their_own(
    rounding: Rounding, sheet: ScoreSheet
) -> None:
    published = rounding.sheet(sheet)
    assert published.micro == ROUNDED
    assert published.macro_family == ROUNDED
    assert published.families["lane_blockage"].metrics == ROUNDED
    assert published.tasks["LB1"].metrics == ROUNDED
    assert published.families["lane_blockage"].n == 2
    assert published.coverage == Coverage(edited=0.3333, source=0.6667)
    assert published.plausibility.shares == {"blind": 0.3333, "impossible": None}
    assert published.plausibility.flags == sheet.plausibility.flags
    assert published.extra == {"confusion_C": {"A": 0.3333}}


def test_no_value_is_a_negative_zero(rounding: Rounding, sheet: ScoreSheet) -> None:
    value = rounding.sheet(sheet).micro["cts_x"]
    assert value is not None
    assert math.copysign(1, value) == 1
    tiny = rounding.metric("cts_x", -0.001)
    assert tiny is not None
    assert math.copysign(1, tiny) == 1


def test_fewer_decimals_publish_fewer_digits(protocol: ProtocolDocument, sheet: ScoreSheet) -> None:
    coarse = protocol.publication.model_copy(update={"percent_decimals": 0, "metre_decimals": 1})
    published = Rounding(PLANNING, coarse).sheet(sheet)
    assert published.micro["hcc"] == 0.12
    assert published.micro["cts"] == 1.0


def test_small_cells_are_withheld_and_still_counted(
    protocol: ProtocolDocument, sheet: ScoreSheet
) -> None:
    strict = protocol.publication.model_copy(update={"min_samples_per_cell": 2})
    published = Rounding(PLANNING, strict).sheet(sheet)
    assert published.tasks["LB2"].n == 1
    assert set(published.tasks["LB2"].metrics.values()) == {None}
    assert published.tasks["LB1"].metrics == ROUNDED


def test_rounding_twice_changes_nothing(rounding: Rounding, sheet: ScoreSheet) -> None:
    once = rounding.sheet(sheet)
    assert rounding.sheet(once) == once


def test_intervals_are_rounded_like_their_metric(
    rounding: Rounding, protocol: ProtocolDocument
) -> None:
    public = Rounding(PLANNING, protocol.publication, is_public=True)
    assert public.interval("hcc", (0.123456, 0.2)) == (0.1235, 0.2)
    assert rounding.interval("hcc", (0.123456, 0.2)) == (0.12, 0.2)
    assert rounding.interval("hcc", (0.2, 0.201)) == (0.2, 0.21)
    assert rounding.interval("hcc", (0.2, 0.2 + 2e-9)) == (0.2, 0.21)
    assert rounding.interval("cts", (-0.0, 1.239)) == (0.0, 1.24)
    assert rounding.interval("cts", None) is None


def test_an_end_off_a_whole_per_cent_by_the_grid_of_sums_alone_is_that_one(
    rounding: Rounding,
) -> None:
    below, above = (turn(0.3 / GRID) * GRID for turn in (math.floor, math.ceil))
    assert below < 0.3 < above
    assert rounding.interval("hcc", (below, above)) == (0.3, 0.3)
    assert rounding.coarse_interval((-above, -below)) == (-0.3, -0.3)
    zero = rounding.coarse_interval((-GRID / 2, GRID / 2))
    assert [math.copysign(1, end) for end in zero or ()] == [1, 1]
    assert zero == (0.0, 0.0)


def test_the_exact_sheet_is_left_as_it_was(rounding: Rounding, sheet: ScoreSheet) -> None:
    before = sheet.model_dump_json()
    rounding.sheet(sheet)
    assert sheet.model_dump_json() == before


def test_the_clearance_curve_leaves_only_where_it_may(
    rounding: Rounding, sheet: ScoreSheet, protocol: ProtocolDocument
) -> None:
    curve = ClearanceCurve(step=0.1, micro=(1.0, 2 / 3), macro_family=(0.5, 1 / 7))
    exact = sheet.model_copy(update={"clearance_curve": curve})
    assert rounding.sheet(exact).clearance_curve is None
    public = Rounding(PLANNING, protocol.publication, is_public=True)
    shown = public.sheet(exact).clearance_curve
    assert shown == ClearanceCurve(step=0.1, micro=(1.0, 0.6667), macro_family=(0.5, 0.1429))


@pytest.mark.parametrize(
    ("told_of", "public", "withheld"),
    [("public_splits", True, False), ("all_splits", True, True), ("never", False, False)],
)
def test_a_protocol_says_whose_curves_are_published(
    protocol: ProtocolDocument, told_of: str, public: bool, withheld: bool
) -> None:
    section = protocol.publication.model_copy(update={"clearance_curve": told_of})
    assert section.shows_curve(is_public_split=True) is public
    assert section.shows_curve(is_public_split=False) is withheld


def test_numbers_of_answers_are_not_rounded(rounding: Rounding, sheet: ScoreSheet) -> None:
    coverage = Coverage(edited=296 / 299, source=1.0, n_edited=296, n_source=299)
    published = rounding.sheet(sheet.model_copy(update={"coverage": coverage})).coverage
    assert published == Coverage(edited=0.99, source=1.0, n_edited=296, n_source=299)
