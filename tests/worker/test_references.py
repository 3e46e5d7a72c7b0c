"""Reference rows: on every board by themselves, scored as an upload of the same answers would be."""

from typing import Any

import pytest
from tests.support import documents
from tests.support.work import claim_board_of

from exceptiondrive_records.boards.boards import publish_board
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.operations.invariants import broken_boards
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.references import REFERENCES
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.private_store import Shelf

World = Any
IDENTITY = {"source", "rank", "rank_interval", "unranked_because", "submission_id", "submitted_at"}
NAMES = {"method", "team", "description"}


def references_of(board: Board) -> dict[str, BoardEntry]:
    return {row.method: row for row in board.entries if row.source == "reference"}


def numbers(row: BoardEntry) -> dict[str, Any]:
    return row.model_dump(exclude=IDENTITY | NAMES)


def test_a_board_without_entries_has_the_references_of_its_challenge(
    world: World, tiny: Split
) -> None:
    world.add_phase(tiny)
    found = references_of(world.build_board())
    assert list(found) == ["FREEZE"]
    freeze = found["FREEZE"]
    assert (freeze.rank, freeze.submission_id, freeze.team) == (None, None, "Reference")
    assert freeze.metrics["ur"] == 0
    assert "source_stands_still" in [flag.code for flag in freeze.flags]
    assert freeze.description == (
        "Stands still in every sample. CONSTANT VELOCITY and SOURCE AS EDITED would need recorded "
        "paths, which the split does not have."
    )


def test_freeze_has_the_numbers_of_an_uploaded_file_of_zeros(world: World, tiny: Split) -> None:
    world.add_phase(tiny)
    still = dict.fromkeys("abcd", 0.0)
    world.score(documents.planning_file(still, source_mps=0.0), method="zeros")
    board = world.build_board()
    (zeros,) = [row for row in board.entries if row.method == "zeros"]
    assert numbers(references_of(board)["FREEZE"]) == numbers(zeros)


def test_always_stop_stands_on_a_strategy_board(world: World, tiny: Split) -> None:
    world.add_phase(tiny, challenge="strategy")
    world.score(documents.strategy_file(dict.fromkeys("abcd", "C")), method="all C")
    board = world.build_board()
    (stops,) = [row for row in board.entries if row.method == "all C"]
    assert list(references_of(board)) == ["ALWAYS STOP"]
    assert numbers(references_of(board)["ALWAYS STOP"]) == numbers(stops)
    assert stops.metrics["accuracy"] == 1.0, "C is acceptable in every task of protocol 1.0"


def test_references_come_again_when_the_private_store_is_lost(world: World, tiny: Split) -> None:
    world.add_phase(tiny)
    before = world.build_board()
    for shelf in Shelf:
        for path in (world.context.private.root / shelf).iterdir():
            path.unlink()
    assert world.build_board() == before


def test_a_reference_that_another_board_says_otherwise_of_is_found(
    world: World, tiny: Split
) -> None:
    world.add_phase(tiny)
    board = world.build_board()
    (freeze,) = board.entries
    with world.database.write() as session:
        assert list(broken_boards(session)) == []
        want_board(session, "dev", board.protocol.digest)
    with world.database.write() as session:
        claim = claim_board_of(session, "dev", board.protocol.digest)
        assert claim is not None
        lower = {"metrics": freeze.metrics | {"hcc": 0.5}}
        altered = board.model_copy(update={"entries": (freeze.model_copy(update=lower),)})
        publish_board(session, claim, altered)
        found = [violation.rule for violation in broken_boards(session)]
    assert "reference altered" in found


@pytest.mark.parametrize(
    "name", ["FREEZE", "freeze", "Fre\uff45ze", "F.R.E.E.Z.E", "Source as  edited", "reference"]
)
def test_nobody_takes_the_name_of_a_reference(world: World, tiny: Split, name: str) -> None:
    world.add_phase(tiny)
    with pytest.raises(InvalidRecord, match="reserved for the reference rows"):
        world.submit(documents.planning_file(dict.fromkeys("abcd", 1.0)), method=name)
    with (
        world.database.write() as session,
        pytest.raises(InvalidRecord, match="reserved for the reference rows"),
    ):
        create_team(session, "other", name, actor="test")


def test_each_challenge_names_its_references_once() -> None:
    methods = [each.method for references in REFERENCES.values() for each in references]
    assert len(set(methods)) == len(methods) == 4
