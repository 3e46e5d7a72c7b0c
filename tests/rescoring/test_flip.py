"""What the transaction of a flip does, and what it leaves to others."""

from collections.abc import Callable
from typing import Any

import pytest

from exceptiondrive_records.board_requests import want_board
from exceptiondrive_records.board_rings import due_boards
from exceptiondrive_records.errors import Conflict
from exceptiondrive_records.rescoring import flip
from exceptiondrive_records.rescoring.compared import _compared
from exceptiondrive_records.tables import Phase
from exceptiondrive_schemas.jobs import Lane

Stage = Any
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 9.5")


def test_boards_are_compared_before_the_transaction_and_not_in_it(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    preview = stage.preview(run_id).digest
    _compared.cache_clear()
    flip.work_out(stage.database, run_id)
    stage.apply(run_id, preview)
    flip.work_out(stage.database, run_id)
    stage.rollback(run_id)
    assert _compared.cache_info().misses == 2  # one before each flip


def test_what_was_worked_out_does_not_hide_what_came_since(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    preview = stage.preview(run_id).digest
    flip.work_out(stage.database, run_id)
    stage.submit(3.0, "newcomer")
    stage.work()
    with pytest.raises(Conflict, match="stale"):
        stage.apply(run_id, preview)


def test_the_board_of_a_draft_is_built_behind_the_live_ones(
    stage: Stage, make_protocol: Callable[..., str]
) -> None:
    run_id = stage.ready(make_protocol("1.1", *D_SAFE))
    draft = stage.view(run_id).to_protocol.digest
    with stage.database.write() as session:
        shown = session.get_one(Phase, "dev").protocol_digest
        for digest in (shown, draft):
            want_board(session, "dev", digest)
        lanes = {board.protocol_digest: board.lane for board in due_boards(session, stage.settings)}
    assert lanes == {shown: Lane.LIVE, draft: Lane.RESCORE}
