"""Further rows of a score sheet as tables."""

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.published import example_text
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_server.entries.sheet_tables import effect_table, sheet_tables
from exceptiondrive_server.web.numbers import Digits

PROTOCOL = packaged_protocol()
EXAMPLE = ScoreSheet.model_validate_json(example_text("score-sheet"))
ROWS = {
    "d_safe_x2": {"hcc_micro": 0.2, "hcc_macro_family": 0.25},
    "d_safe_x0.5": {"hcc_micro": 0.4, "hcc_macro_family": None},
}


def test_sensitivity_stands_around_the_row_that_ranks_from_less_to_more_clearance() -> None:
    sheet = EXAMPLE.model_copy(update={"extra": ROWS})
    (table,) = sheet_tables(sheet, PROTOCOL, Digits())
    assert table.heads == ("clearance", "HCC % over families", "HCC % over samples")
    assert table.lines == (
        ("half the required clearance", ("", "40.00")),
        ("the required clearance, as it ranks", ("33.33", "33.33")),
        ("twice the required clearance", ("25.00", "20.00")),
    )


def test_the_average_that_ranks_stands_first() -> None:
    grading = PROTOCOL.grading.model_copy(update={"headline": "micro"})
    protocol = PROTOCOL.model_copy(update={"grading": grading})
    sheet = EXAMPLE.model_copy(update={"extra": ROWS})
    (table,) = sheet_tables(sheet, protocol, Digits())
    assert table.heads[1] == "HCC % over samples"


def test_confusion_and_reminder_rows_have_tables_of_their_own() -> None:
    extra = {
        "confusion_CD": {"A": 2.0, "missing": 3.0},
        "reminder": {"n": 1.0, "presence_recall": 0.5},
    }
    sheet = EXAMPLE.model_copy(update={"extra": extra})
    confusion, reminder = sheet_tables(sheet, PROTOCOL, Digits())
    assert confusion.lines == (("C\u00a0D", ("2", "3")),)
    assert reminder.lines == (("hazard presence, recall", ("50.00",)),)
    assert (
        "over 1 sample with a record, where what a record leaves out counts as wrong"
        in reminder.note
    )


def test_a_sheet_without_further_rows_has_no_table() -> None:
    sheet = EXAMPLE.model_copy(update={"extra": {}})
    assert sheet_tables(sheet, PROTOCOL, Digits()) == ()


def test_of_a_withheld_split_the_share_of_changed_samples_is_not_told(
    strategy_board: Board,
) -> None:
    entry = strategy_board.entries[0]
    effect = entry.reminder_effect
    assert effect is not None
    kept_back = {
        key: found.model_copy(update={"discordant": None})
        for key, found in effect.differences.items()
    }
    withheld = entry.model_copy(
        update={"reminder_effect": effect.model_copy(update={"differences": kept_back})}
    )
    for each, share in ((entry, "40.00\u2009%"), (withheld, "not told")):
        (_, accuracy), *_ = effect_table(strategy_board, each, Digits()).lines
        assert accuracy == ("+16.25", "+10 to +23", share, "with is better")
