"""Violations planted so that everything else fits: one rule of the checker sees each, and no other."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from datetime import timedelta
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import delete, select
from sqlalchemy.orm import Session
from tests.chaos.checker import check
from tests.chaos.history import Call, Sighting

from exceptiondrive_records.audit.log import GENESIS, audit, line_hash
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.boards import served_body
from exceptiondrive_records.boards.tables import BoardEntryRow, BoardFlip, BoardRow
from exceptiondrive_schemas.base import canonical_json, content_digest
from exceptiondrive_schemas.board import Board, BoardEntry

if TYPE_CHECKING:
    from tests.chaos.story import Story

Plant = Callable[["Story"], None]
_LATE_S = 40.0


def rules(story: Story) -> set[str]:
    return {found.rule for found in check(story.database, story.files, story.history)}


def _sql(statement: str) -> Plant:
    def plant(story: Story) -> None:
        best = story.scored[0]
        story.plant(lambda session: _run(session, statement.format(best=best)))

    return plant


def _run(session: Session, statement: str) -> None:
    session.connection().exec_driver_sql(statement)


def _called(status: int) -> Plant:
    call = Call("alpha", "sha256:sound", "m", _LATE_S, 0.1, status, None)
    return lambda story: story.history.note(call)


def _give_up(story: Story) -> None:
    call = Call("alpha", "sha256:sound", "m", _LATE_S, 20.0, None, None)
    story.history.note(call)
    story.history.given_up.append(call)


def _told(*statuses: str, of_failed: bool = False) -> Plant:
    def plant(story: Story) -> None:
        submission_id = story.failed if of_failed else story.scored[0]
        for step, status in enumerate(statuses):
            story.history.note(Sighting(_LATE_S + step, submission_id, status))

    return plant


def _sent_as_another(story: Story) -> None:
    calls = story.history.calls
    number = next(n for n, call in enumerate(calls) if call.submission_id == story.scored[0])
    calls[number] = dataclasses.replace(calls[number], method="other")


def _tell_another_diagnostic(story: Story) -> None:
    seen = next(seen for seen in story.history.sightings if seen.sheet is not None)
    assert seen.sheet is not None
    sheet: dict[str, Any] = {**seen.sheet, "micro": {**seen.sheet["micro"], "ur": 0.125}}
    story.history.note(dataclasses.replace(seen, at_s=_LATE_S, sheet=sheet))


def _republish(change: Callable[[list[BoardEntry]], list[BoardEntry]]) -> Plant:
    """Rewrite the board with every digest, and let readers have seen just that."""

    def plant(story: Story) -> None:
        with story.database.write() as session:
            row = session.scalars(select(BoardRow)).one()
            board = Board.model_validate_json(row.body)
            entries = tuple(change(list(board.entries)))
            _write(session, row, board.model_copy(update={"entries": entries}))
            seen = dataclasses.replace(
                story.history.boards[0], etag=row.body_digest, body=row.body.encode()
            )
        story.history.boards[0] = seen

    return plant


def _write(session: Session, row: BoardRow, board: Board) -> None:
    """Let a row and its table of entries say what a board says."""
    row.digest, row.body_digest = board.content_digest, content_digest(board)
    row.body = canonical_json(board).decode()
    session.add(row)
    session.flush()
    session.execute(delete(BoardEntryRow).where(BoardEntryRow.board_id == row.id))
    session.add_all(
        BoardEntryRow(board_id=row.id, submission_id=entry.submission_id, rank=entry.rank)
        for entry in board.entries
        if entry.submission_id is not None
    )


def _on_their_head(entries: list[BoardEntry]) -> list[BoardEntry]:
    best, second = entries
    return [second.model_copy(update={"rank": 1}), best.model_copy(update={"rank": 2})]


def _withdraw_but_show(story: Story) -> None:
    _sql("UPDATE submissions SET status='withdrawn', withdrawn_at=status_at WHERE id='{best}'")(
        story
    )
    with story.database.write() as session:
        audit(session, "team:alpha", "submission withdrawn", story.scored[0])


def _leave_the_pointer(story: Story) -> None:
    """A second board is published, and readers go on seeing the first."""
    with story.database.write() as session:
        first = session.scalars(select(BoardRow)).one()
        row = BoardRow(
            phase_id=first.phase_id,
            protocol_digest=first.protocol_digest,
            split_revision=first.split_revision,
            number=2,
            published_at=first.published_at,
        )
        _write(session, row, Board.model_validate_json(first.body).model_copy(update={"board": 2}))
        audit(session, "worker", "board published", first.phase_id)


def _show_a_draft_later(story: Story) -> None:
    """A minute passed until readers saw the board, as where a rescoring is applied by and by."""
    with story.database.write() as session:
        flip = session.scalars(select(BoardFlip)).one()
        flip.at += timedelta(minutes=1)


def _cut_the_tail(story: Story) -> None:
    _sql("DELETE FROM audit_lines WHERE id = (SELECT max(id) FROM audit_lines)")(story)


def _rewrite_the_chain(story: Story) -> None:
    """After the checker has looked once: another actor in the first line, every hash made anew."""
    assert rules(story) == set()
    with story.database.write() as session:
        head = GENESIS
        for line in session.scalars(select(AuditLine).order_by(AuditLine.id)):
            line.actor = "nobody" if line.id == 1 else line.actor
            line.previous_hash = head
            head = line.hash = line_hash(line)


PLANTED: dict[str, tuple[str, Plant]] = {
    "the table of entries says another rank": (
        "entries of a board altered",
        _sql("UPDATE board_entries SET rank = 9 WHERE submission_id = '{best}'"),
    ),
    "a submission got another's method": (
        "accepted as another",
        _sent_as_another,
    ),
    "a sound file was refused": ("sound file refused", _called(401)),
    "a quota was said to be used up": ("sound file refused", _called(429)),
    "a client waited in vain": ("never answered", _give_up),
    "a withdrawn submission came back": ("ending changed", _told("withdrawn", "scored")),
    "a withdrawal is not on the records": ("ending changed", _told("withdrawn")),
    "a failed one was said to be withdrawn": ("ending changed", _told("withdrawn", of_failed=True)),
    "another diagnostic was told": ("score changed", _tell_another_diagnostic),
    "a sheet changed where the board does not look": (
        "score changed",
        _sql("""UPDATE score_sheets SET sheet = replace(sheet, '"n":2', '"n":3')"""),
    ),
    "an entry is missing on the board": (
        "missing on the board",
        _republish(lambda entries: entries[:1]),
    ),
    "a withdrawn one stays on the board": ("must not stand on the board", _withdraw_but_show),
    "the board stands on its head": ("rank is not that of the values", _republish(_on_their_head)),
    "a newer board is not shown": ("not the newest board", _leave_the_pointer),
    "a draft was told with the date when it was built": (
        "board not on the records",
        _show_a_draft_later,
    ),
    "no board is shown": (
        "scores without a board",
        _sql("UPDATE phases SET current_board_id = NULL"),
    ),
    "the end of the audit chain was cut off": ("audit lines differ", _cut_the_tail),
    "the whole audit chain was rewritten": ("audit chain rewritten", _rewrite_the_chain),
    "a job was tried too often": (
        "too many attempts",
        _sql("UPDATE work SET attempts = 9 WHERE submission_id = '{best}'"),
    ),
}


@pytest.mark.parametrize("what", PLANTED)
def test_one_rule_alone_sees(what: str, embedded_story: Story) -> None:
    rule, plant = PLANTED[what]
    plant(embedded_story)
    assert rules(embedded_story) == {rule}


def test_a_draft_is_told_with_the_date_when_readers_first_saw_it(embedded_story: Story) -> None:
    _show_a_draft_later(embedded_story)
    first = embedded_story.history.boards[0]
    with embedded_story.database.read() as session:
        body = served_body(session.scalars(select(BoardRow)).one()).encode()
    assert body != first.body
    embedded_story.history.boards[0] = dataclasses.replace(first, etag="draft", body=body)
    assert rules(embedded_story) == set()
