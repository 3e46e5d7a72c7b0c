"""Two boards side by side: what becomes of an entry, and who is named among those that lose."""

from typing import Any

import pytest
from tests.records.test_board_documents import board_of, entry

from exceptiondrive_records.rescoring.comparison import compare_boards
from exceptiondrive_schemas.board import BoardEntry, FamilyCell
from exceptiondrive_schemas.score_sheet import PairedDifference, ReminderEffect

CELL = FamilyCell.model_validate({"n": 80, "hcc": 0.5, "intervals": {}})


def _effect(without: str, difference: float) -> ReminderEffect:
    found = PairedDifference(difference=difference, interval=None, discordant=None, verdict="")
    return ReminderEffect(without=without, without_method=without, differences={"hcc": found})


def test_whoever_loses_a_place_or_of_the_score_is_named_the_worst_first() -> None:
    """Of the first metric, of which more is better; `late` gains a place, though it loses of it too."""
    stood = {"failing": 1, "falling": 2, "late": 4, "worse": 3, "better": 5, "same": 6}
    stands = {"failing": None, "falling": 4, "late": 2, "worse": 3, "better": 5, "same": 6}
    shifts = {"falling": 0.1, "late": -0.3, "worse": -0.1, "better": 0.1}
    old = board_of(*(_entry(name, rank, 0.5) for name, rank in stood.items()))
    new = board_of(
        *(_entry(name, rank, 0.5 + shifts.get(name, 0.0)) for name, rank in stands.items())
    )
    assert compare_boards(old, new).worst_movers == ("failing", "falling", "worse", "late")


@pytest.mark.parametrize(
    ("stood", "stands", "change", "shift"),
    [
        ((1, 0.5), (1, 0.5), "none", 0.0),
        ((1, 0.5), (2, 0.5), "rank_only", 0.0),
        ((1, 0.5), (1, 0.7), "numbers", 0.2),
        (None, (1, 0.5), "appears", None),
        ((1, 0.5), None, "disappears", None),
    ],
)
def test_what_becomes_of_an_entry(
    stood: tuple[int, float] | None,
    stands: tuple[int, float] | None,
    change: str,
    shift: float | None,
) -> None:
    """Who stands on one of the boards alone keeps the metrics, without a difference."""
    old, new = (board_of(*([_entry("one", *at)] if at else [])) for at in (stood, stands))
    (found,) = compare_boards(old, new).entries
    assert (found.change, found.metric_shifts) == (change, {"hcc": shift})


def test_a_metric_without_a_value_on_one_of_the_boards_has_no_difference() -> None:
    one = _entry("one", 1, 0.5)
    without = one.model_copy(update={"metrics": {"hcc": None}})
    for boards in ((one, without), (without, one)):
        (found,) = compare_boards(*map(board_of, boards)).entries
        assert (found.change, found.metric_shifts) == ("numbers", {"hcc": None})


def test_the_preview_counts_every_rank_that_is_won_or_lost_and_who_newly_fails() -> None:
    old = board_of(_entry("fails", 1, 0.5), _entry("up", 2, 0.5), _entry("leaves", 3, 0.5))
    new = board_of(_entry("up", 1, 0.5), _entry("fails", None, 0.5), _entry("low", None, 0.1))
    found = compare_boards(old, new)
    assert (found.n_entries, found.n_ranks_changed, found.n_newly_failing) == (4, 3, 2)
    failing = [each.submission_id for each in found.entries if each.newly_failing]
    assert failing == ["fails", "leaves"], "`low` had no rank to lose"


def test_an_entry_is_named_as_the_new_board_names_it() -> None:
    old, new = (
        board_of(_entry("one", 1, 0.5).model_copy(update={"method": method}))
        for method in ("before", "after")
    )
    (found,) = compare_boards(old, new).entries
    assert found.method == "after"


@pytest.mark.parametrize(
    ("stood", "stands", "change"),
    [
        ({"families": {"a": CELL}}, {"families": {"a": CELL}}, "none"),
        ({"families": {"a": CELL}}, {"families": {"a": CELL, "b": CELL}}, "numbers"),
        ({"reminder_effect": _effect("x", 0.1)}, {"reminder_effect": _effect("y", 0.1)}, "none"),
        ({"reminder_effect": _effect("x", 0.1)}, {"reminder_effect": _effect("x", 0.2)}, "numbers"),
        ({"reminder_effect": None}, {"reminder_effect": _effect("x", 0.1)}, "numbers"),
    ],
)
def test_families_and_what_a_reminder_changes_are_numbers_whom_it_is_measured_against_is_none(
    stood: dict[str, Any], stands: dict[str, Any], change: str
) -> None:
    one = _entry("one", 1, 0.5).model_copy(update={"families": {}})
    old, new = (board_of(one.model_copy(update=said)) for said in (stood, stands))
    (found,) = compare_boards(old, new).entries
    assert found.change == change


def _entry(name: str, rank: int | None, hcc: float) -> BoardEntry:
    why = None if rank is not None else "it covers too little"
    interval = None if rank is None else (rank, rank)
    return entry(
        0,
        submission_id=name,
        rank=rank,
        rank_interval=interval,
        unranked_because=why,
        metrics={"hcc": hcc},
    )
