import subprocess
import sys
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from exceptiondrive import Client, InvalidArgumentError, check_file, evaluate_file, to_dataframe
from exceptiondrive.client import Submission
from exceptiondrive_schemas.api.similarity import (
    AlikeKind,
    AlikePair,
    SimilarityReport,
    SubmissionOfTeam,
)
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.published import example_text

MakeFile = Callable[..., Path]


@pytest.fixture
def board() -> Board:
    return Board.read(example_text("board"))


@pytest.fixture
def submission() -> SubmissionView:
    return SubmissionView.read(example_text("submission"))


def test_a_board_is_a_row_an_entry_in_its_order(board: Board) -> None:
    table = to_dataframe(board)
    assert list(table["method"]) == [entry.method for entry in board.entries]
    assert table["rank"].dtype == "Int64"
    for entry, (_, row) in zip(board.entries, table.iterrows(), strict=True):
        assert {key: row[key] for key in entry.metrics} == entry.metrics
        assert pd.isna(row["rank"]) if entry.rank is None else row["rank"] == entry.rank
    assert isinstance(table["submitted_at"].dtype, pd.DatetimeTZDtype)


def test_a_board_by_family_is_a_row_an_entry_and_family(board: Board) -> None:
    table = to_dataframe(board, families=True)
    assert len(table) == sum(len(entry.families) for entry in board.entries)
    first = board.entries[0]
    family = next(iter(first.families))
    row = table[(table["method"] == first.method) & (table["family"] == family)].iloc[0]
    for key, value in first.families[family].metrics.items():
        assert pd.isna(row[key]) if value is None else row[key] == value


def test_a_table_of_a_board_says_which_board_it_is_and_whose_rows_are_whose(board: Board) -> None:
    for families in (False, True):
        table = to_dataframe(board, families=families)
        for key, value in (
            ("phase", board.phase),
            ("board", board.board),
            ("protocol", board.protocol.version),
        ):
            assert set(table[key]) == {value}
        of = [each for each in board.entries if each.families or not families]
        assert set(table["submission_id"].dropna()) == {e.submission_id for e in of} - {None}
        assert {*zip(table["method"], table["source"], strict=True)} == {
            (each.method, each.source) for each in of
        }


def test_what_a_board_tells_of_controls_stands_in_its_table(board: Board) -> None:
    first = board.entries[0]
    tried = first.model_copy(update={"micro": {**first.micro, "over_caution": 0.14}})
    table = to_dataframe(board.model_copy(update={"entries": (tried, *board.entries[1:])}))
    assert table.loc[0, "over_caution"] == 0.14
    assert {key: table.loc[0, key] for key in first.metrics} == first.metrics


@pytest.mark.parametrize("families", [False, True])
def test_a_board_without_entries_has_the_columns_of_every_board(
    board: Board, families: bool
) -> None:
    full = to_dataframe(board, families=families)
    empty = to_dataframe(board.model_copy(update={"entries": ()}), families=families)
    assert len(empty) == 0
    metrics_aside = [name for name in full.columns if name in empty.columns]
    assert list(empty.columns) == metrics_aside
    for name in {"rank", "n", "submitted_at"}.intersection(full.columns):
        assert empty[name].dtype.kind == full[name].dtype.kind
    assert {"method", "team"} <= set(empty.columns)


def test_a_list_of_what_is_no_table_says_of_what() -> None:
    wrong: Any = [3, "a"]
    with pytest.raises(InvalidArgumentError, match="list of int, str is nothing"):
        to_dataframe(wrong)


def test_a_score_sheet_has_its_totals_families_and_tasks(
    planning_file: MakeFile, split_file: Path
) -> None:
    sheet = evaluate_file(planning_file(), split=split_file)
    table = to_dataframe(sheet)
    assert table.loc[("all", "micro"), "hcc"] == sheet.micro["hcc"]
    assert list(table.loc["family"].index) == list(sheet.families)
    assert list(table.loc["task"].index) == list(sheet.tasks)
    assert table.loc[("all", "macro_family"), "n"] == sheet.n


def test_submissions_one_or_many_are_a_row_each(submission: SubmissionView) -> None:
    table = to_dataframe([submission, submission])
    assert list(table["id"]) == [submission.id] * 2
    assert submission.sheet is not None
    assert table.loc[0, "hcc_micro"] == submission.sheet.micro["hcc"]
    with Client("http://127.0.0.1:9", token="edk_t_1") as client:
        pd.testing.assert_frame_equal(to_dataframe(Submission(client, submission)), table[:1])
        followed: list[Submission | SubmissionView] = [Submission(client, submission), submission]
        pd.testing.assert_frame_equal(to_dataframe(followed), table)
    pd.testing.assert_frame_equal(to_dataframe(submission), table[:1])


def test_a_submission_without_a_rank_says_why_and_one_that_was_replaced_by_which(
    submission: SubmissionView,
) -> None:
    told = {"rank": None, "unranked_because": "flagged", "replaced_by": "later"}
    table = to_dataframe([submission, submission.model_copy(update=told)])
    assert list(table["unranked_because"].fillna("")) == ["", "flagged"]
    assert list(table["replaced_by"].fillna("")) == ["", "later"]


def test_a_report_of_similar_submissions_is_a_row_a_pair() -> None:
    at = datetime(2026, 11, 20, 12, tzinfo=timezone.utc)
    sent = [
        SubmissionOfTeam(id=name, team=name.title(), method="M", received_at=at)
        for name in ("alpha", "beta", "gamma")
    ]
    pairs = tuple(
        AlikePair(kind=kind, first=sent[0], second=other, equal_share=share, n_different=n)
        for kind, other, share, n in (
            (AlikeKind.EQUAL_ANSWERS, sent[1], 1.0, 0),
            (AlikeKind.NEAR, sent[2], 0.97, 12),
        )
    )
    report = SimilarityReport(phase="dev", n_compared=3, n_waiting=0, pairs=pairs)
    table = to_dataframe(report)
    assert list(table["kind"]) == ["equal_answers", "near"]
    assert list(table["first_team"]) == ["Alpha", "Alpha"]
    assert list(table["second_id"]) == ["beta", "gamma"]
    assert list(table["equal_share"]) == [1.0, 0.97]
    assert list(table["n_different"]) == [0, 12]
    assert list(table["first_received_at"]) == [at, at]
    assert to_dataframe(report.model_copy(update={"pairs": ()})).empty


def test_a_check_report_is_a_row_a_kind_of_fault_with_the_same_columns_where_there_is_none(
    planning_file: MakeFile,
) -> None:
    faulty = to_dataframe(check_file(planning_file(schema="exceptiondrive.planning/9")))
    assert list(faulty["code"]) == ["wrong_schema"]
    sound = to_dataframe(check_file(planning_file()))
    assert len(sound) == 0
    assert list(sound.columns) == list(faulty.columns)


def test_no_submissions_are_an_empty_table_with_the_columns_of_each(
    submission: SubmissionView,
) -> None:
    none, unscored = to_dataframe([]), to_dataframe(submission.model_copy(update={"sheet": None}))
    assert len(none) == 0
    assert list(none.columns) == list(unscored.columns)
    assert isinstance(none["received_at"].dtype, pd.DatetimeTZDtype)


def test_without_pandas_the_error_says_what_to_install() -> None:
    code = (
        "import sys; sys.modules['pandas'] = None\n"
        "from exceptiondrive import InvalidArgumentError, to_dataframe\n"
        "try:\n    to_dataframe([])\n"
        "except InvalidArgumentError as error:\n    print(error.code, error.advice)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == 'extra_missing Run: pip install "exceptiondrive[data]"\n'
