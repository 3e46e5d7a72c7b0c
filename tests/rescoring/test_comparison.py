"""Two boards side by side: what becomes of an entry, and who is named among those that lose."""

import pytest
from tests.records.test_board_documents import board_of, entry

from exceptiondrive_records.rescoring.comparison import compare_boards
from exceptiondrive_schemas.board import BoardEntry


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
