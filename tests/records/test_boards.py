"""Boards: immutable snapshots, and one pointer that moves."""

import json
from datetime import timedelta
from typing import Any
from weakref import ref

import pytest
from sqlalchemy import inspect, select, text, update
from sqlalchemy.exc import DatabaseError
from sqlalchemy.orm import Session
from tests.records.statements import of_board_texts, statements
from tests.support.records import count_audit_lines
from tests.support.work import claim_board_of

from exceptiondrive_records.boards import boards
from exceptiondrive_records.boards import standings as board_records
from exceptiondrive_records.boards.tables import BoardEntryRow, BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.db.memory import Memory
from exceptiondrive_records.entries.selection import publish, unpublish
from exceptiondrive_records.operations.invariants import broken_boards
from exceptiondrive_records.participation.disqualification import disqualify_submission
from exceptiondrive_records.phases.scoring_keys import ScoringKey, key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.views import board_history
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.board_requests import is_board_wanted, want_board
from exceptiondrive_records.work.tables import BoardRequest
from exceptiondrive_schemas.base import bytes_digest, canonical_json, content_digest
from exceptiondrive_schemas.board import Board, BoardNews

World = Any
OTHER = "sha256:" + "0" * 64


def test_a_board_knows_its_entries(world: World) -> None:
    world.want_board()
    first = world.publish(world.board("a", "b"))
    world.want_board()
    second = world.publish(world.board("b", "c"))
    with world.database.read() as session:
        assert boards.entry_ids(session, first.id) == {"a", "b"}
        shown = boards.entries_on(session, second.id)
        assert {key: entry.rank for key, entry in shown.items()} == {"b": 1, "c": 2}
        assert boards.entries_on(session, None) == {}
        newest = [boards.newest_board_with(session, each) for each in ("a", "b", "x")]
        assert [row and row.number for row in newest] == [1, 2, None]
        ids = (second.id, None, first.id)
        assert [row.number for row in boards.boards_with(session, "b", ids)] == [2, 1]
        rules = {fault.rule for fault in broken_boards(session)}
    assert "entries of a board altered" not in rules


def test_a_board_is_altered_where_its_bytes_are_others_and_not_where_it_lacks_newer_fields(
    world: World,
) -> None:
    """So stands each older board once an entry has gained a field with a default."""
    world.want_board()
    row = world.publish(world.board("a", "b"))
    older = json.loads(row.body)
    for entry in older["entries"]:
        del entry["coverage"], entry["cite"]
    older["board"] = 2
    body = canonical_json(older)
    del older["board"], older["published_at"]
    second = {
        "phase_id": "dev",
        "protocol_digest": row.protocol_digest,
        "split_revision": row.split_revision,
        "published_at": row.published_at,
        "body_digest": bytes_digest(body),
        "digest": content_digest(older),
    }
    with world.database.write() as session:
        session.add(BoardRow(**second, number=2, body=body.decode()))
        session.add(BoardRow(**second, number=3, body=f"{body.decode()} "))
    with world.database.read() as session:
        altered = [one for one in broken_boards(session) if one.rule == "board altered"]
    assert [one.subject for one in altered] == ["dev/3"]


def test_entries_live_no_longer_than_their_board(world: World, monkeypatch: Any) -> None:
    monkeypatch.setattr(boards, "_PARSED", Memory(1))  # the newest board alone
    world.want_board()
    first = world.publish(world.board("a", "b"))
    world.want_board()
    second = world.publish(world.board("b", "c"))
    with world.database.read() as session:
        read = ref(boards.entries_on(session, first.id)["a"])
        assert read() is not None
        boards.entries_on(session, second.id)
    assert read() is None


def test_entries_in_the_table_are_those_of_the_body(world: World) -> None:
    world.want_board()
    row = world.publish(world.board("a", "b"))
    with world.database.write() as session:
        session.add(BoardEntryRow(board_id=row.id, submission_id="x", rank=3))
        session.flush()
        assert "entries of a board altered" in {fault.rule for fault in broken_boards(session)}
    with pytest.raises(DatabaseError, match="append-only"), world.database.write() as session:
        session.execute(text("UPDATE board_entries SET rank = 1"))


def shown_key(session: Session) -> ScoringKey:
    return key_of_phase(session.get_one(Phase, "dev"))


def test_a_new_phase_wants_its_first_board(world: World) -> None:
    with world.database.read() as session:
        assert is_board_wanted(session, "dev", *shown_key(session))
        assert boards.current_board(session, "dev") is None


def test_one_worker_at_a_time_builds_a_board(world: World) -> None:
    claim = world.claim_board()
    assert claim is not None
    assert world.claim_board() is None
    with world.database.write() as session:
        ended_at = database_now(session) - timedelta(seconds=1)
        session.execute(update(BoardRequest).values(lease_until=ended_at))
    assert world.claim_board() is not None


def test_a_published_board_is_current_and_its_body_is_served_as_it_is(world: World) -> None:
    row = world.publish(world.board("a"))
    with world.database.read() as session:
        current = boards.current_board(session, "dev")
        assert current is not None
        assert current.id == row.id
        served = Board.model_validate_json(current.body)
        assert (served.board, served.published_at) == (1, current.published_at)
        assert current.digest == world.board("a").content_digest
        assert current.body_digest == content_digest(served)
        assert not is_board_wanted(session, "dev", *shown_key(session))
    assert world.claim_board() is None


def test_a_board_that_says_the_same_is_not_appended(world: World) -> None:
    first = world.publish(world.board("a"))
    world.want_board()
    assert world.publish(world.board("a")).id == first.id
    with world.database.read() as session:
        assert session.query(BoardRow).count() == 1
        assert count_audit_lines(session, "board published") == 1


def test_what_came_while_a_board_was_built_is_built_next(world: World) -> None:
    claim = world.claim_board()
    assert claim is not None
    world.want_board()
    with world.database.write() as session:
        boards.publish_board(session, claim, world.board("a"))
    with world.database.read() as session:
        assert is_board_wanted(session, "dev", *shown_key(session))


@pytest.mark.parametrize("action", ["withdraw", "make private", "disqualify"])
def test_readers_see_no_entry_that_was_taken_back_while_the_board_was_built(
    world: World, action: str
) -> None:
    """What a board shows once, it shows for ever."""
    with world.database.write() as session:
        phase = session.get_one(Phase, "dev")
        phase.policy = phase.policy.model_copy(update={"entries_private": True})
    own = world.scored("one")
    with world.database.write() as session:
        publish(session, own, actor="test")
    claim = world.claim_board()
    assert claim is not None
    with world.database.write() as session:
        if action == "withdraw":
            withdraw(session, own, actor="test")
        elif action == "make private":
            unpublish(session, own, actor="test")
        else:
            disqualify_submission(session, own, reason="a copy", actor="test")
    with world.database.write() as session:
        row = boards.publish_board(session, claim, world.board(own))
    with world.database.read() as session:
        assert row is not None
        assert boards.is_draft(session, row)
        assert count_audit_lines(session, "board published") == 0
    shown = world.publish(world.board())
    with world.database.read() as session:
        assert session.get_one(Phase, "dev").current_board_id == shown.id


def test_what_was_built_before_is_no_attempt_of_the_next_build(world: World) -> None:
    """Organizers are told of a board that was begun again and again and not finished."""
    for name in ("a", "b", "c"):
        world.want_board()
        claim = world.claim_board()
        assert claim is not None
        assert claim.attempts == 1
        with world.database.write() as session:
            assert boards.publish_board(session, claim, world.board(name)) is not None


def test_a_late_builder_publishes_nothing(world: World) -> None:
    late = world.claim_board()
    assert late is not None
    assert late.leased_at is not None
    with world.database.write() as session:
        session.execute(update(BoardRequest).values(lease_until=late.leased_at.replace(year=2020)))
    world.publish(world.board("new"))
    with world.database.write() as session:
        assert boards.publish_board(session, late, world.board("old")) is None
    with world.database.read() as session:
        current = boards.current_board(session, "dev")
        assert current is not None
        assert '"new"' in current.body
        assert count_audit_lines(session, "stale fence rejected") == 1


def test_every_earlier_board_keeps_its_address(world: World) -> None:
    first = world.publish(world.board("a"))
    world.want_board()
    second = world.publish(world.board("b"))
    with world.database.read() as session:
        assert boards.find_board(session, "dev", 1).body == first.body
        assert boards.find_board(session, "dev", 2).body == second.body
        with pytest.raises(NotFound):
            boards.find_board(session, "dev", 3)
        before = boards.board_at(session, "dev", second.published_at)
        assert before is not None
        at_first = boards.board_at(session, "dev", first.published_at.replace(year=2020))
        assert at_first is None


def add_other_protocol(world: World) -> None:
    with world.database.write() as session:
        session.execute(
            text("INSERT INTO protocols VALUES (:digest, '9.9', '', CURRENT_TIMESTAMP)"),
            {"digest": OTHER},
        )


def drafted(world: World, board: Board) -> BoardRow:
    """Build a board of a draft protocol, which is scored in the background."""
    with world.database.write() as session:
        want_board(session, "dev", OTHER)
    with world.database.write() as session:
        claim = claim_board_of(session, "dev", OTHER)
        assert claim is not None
        draft = boards.publish_board(session, claim, board)
    assert draft is not None
    return draft


def test_numbers_of_public_boards_do_not_tell_whether_a_draft_changed(world: World) -> None:
    add_other_protocol(world)
    numbers = [drafted(world, world.board(name)).number for name in ("a", "a", "b")]
    assert numbers == [1, 2, 3]
    assert world.publish(world.board("a")).number == 4


def test_nor_do_they_where_readers_saw_the_board_of_a_draft_before(world: World) -> None:
    """As after an update was applied, or rolled back: its other side is still scored."""
    add_other_protocol(world)
    seen = drafted(world, world.board("a"))
    with world.database.write() as session:
        boards.flip_board(
            session, session.get_one(Phase, "dev"), session.get_one(BoardRow, seen.id)
        )
    assert [drafted(world, world.board(name)).number for name in ("a", "b")] == [2, 3]


def test_a_board_under_another_protocol_is_kept_but_not_shown(world: World) -> None:
    first = world.publish(world.board("a"))
    add_other_protocol(world)
    draft = drafted(world, world.board("b"))
    with world.database.read() as session:
        current = boards.current_board(session, "dev")
        assert current is not None
        assert current.id == first.id
        newest = boards.latest_board(session, "dev", ScoringKey(OTHER, current.split_revision))
        assert newest is not None
        assert newest.id == draft.id


@pytest.mark.parametrize("statement", ["UPDATE boards SET body = ''", "DELETE FROM boards"])
def test_the_database_refuses_to_change_a_board(world: World, statement: str) -> None:
    world.publish(world.board("a"))
    with pytest.raises(DatabaseError, match="append-only"), world.database.write() as session:
        session.execute(text(statement))


def test_the_latest_scored_submission_of_each_method_is_an_entry(world: World) -> None:
    with world.database.write() as session:
        other = create_team(session, "beta", "Beta", is_reference=True, actor="test").id
    for content, method, team_id, hcc in [
        ("1", "a", None, 0.1),
        ("2", "a", None, 0.2),
        ("3", "b", None, 0.3),
        ("4", "a", other, 0.4),
    ]:
        world.scored(content, method, team_id, hcc=hcc)
    world.submit("waiting", "c")
    with world.database.read() as session:
        found = board_records.entries_for_board(session, "dev", world.protocol_digest)
    assert [(e.team, e.method, e.sheet.micro["hcc"], e.is_reference) for e in found] == [
        ("Alpha", "a", 0.2, False),
        ("Alpha", "b", 0.3, False),
        ("Beta", "a", 0.4, True),
    ]


def test_a_withdrawn_submission_gives_way_to_the_one_before_it(world: World) -> None:
    world.scored("1", hcc=0.1)
    second = world.submit("2")
    world.score(second.job_id, 0.2)
    with world.database.write() as session:
        withdraw(session, second.submission.id, actor="test")
    with world.database.read() as session:
        found = board_records.entries_for_board(session, "dev", world.protocol_digest)
    assert [entry.sheet.micro["hcc"] for entry in found] == [0.1]


def test_a_board_never_mixes_protocols(world: World) -> None:
    world.scored("1")
    with world.database.read() as session:
        assert board_records.entries_for_board(session, "dev", OTHER) == []
        assert session.get_one(Phase, "dev").protocol_digest == world.protocol_digest


def test_the_history_of_boards_reads_none_of_them(world: World) -> None:
    for name in ("a", "b", "c"):
        world.publish(world.board(name))
        world.want_board()
    with statements(world.database) as three, world.database.read() as session:
        lines = board_history(session, "dev")
    assert [line.board for line in lines] == [3, 2, 1]
    assert lines[0].shown_until is None
    assert lines[1].shown_until == lines[0].shown_from
    assert not of_board_texts(three)
    world.publish(world.board("d"))
    with statements(world.database) as four, world.database.read() as session:
        board_history(session, "dev")
    assert len(four) == len(three)


def test_the_history_says_whose_scores_changed_and_by_how_much(world: World) -> None:
    first = world.board("a", "b", "c")
    world.publish(first)
    world.want_board()
    a, b, _ = first.entries
    better = a.model_copy(update={"metrics": {"hcc": 0.625}})
    new = b.model_copy(update={"submission_id": "d", "method": "Another", "rank": None})
    world.publish(first.model_copy(update={"entries": (better, b, new)}))
    with world.database.read() as session:
        lines = board_history(session, "dev")
    assert [
        (one.rank, one.before, one.after, one.is_new, one.has_left) for one in lines[0].news.entries
    ] == [
        (1, 0.5, 0.625, False, False),
        (None, None, 0.5, True, False),
        (3, 0.5, None, False, True),
    ]
    assert lines[1].news == BoardNews()


def test_a_new_run_of_a_method_is_one_piece_of_news_and_not_two(world: World) -> None:
    first = world.board("a", "b")
    world.publish(first)
    world.want_board()
    a, b = first.entries
    again = b.model_copy(update={"submission_id": "c", "metrics": {"hcc": 0.25}})
    world.publish(first.model_copy(update={"entries": (a, again)}))
    with world.database.read() as session:
        (told,) = board_history(session, "dev")[0].news.entries
    assert (told.submission_id, told.before, told.after) == ("c", 0.5, 0.25)
    assert (told.is_new_run, told.is_new, told.has_left) == (True, False, False)


def test_of_many_changes_some_are_named_and_all_are_counted(world: World) -> None:
    world.publish(world.board("a"))
    world.want_board()
    world.publish(world.board("a", *[f"b{i}" for i in range(30)]))
    with world.database.read() as session:
        news = board_history(session, "dev")[0].news
    assert (len(news.entries), news.n_more) == (boards.MAX_NEWS, 30 - boards.MAX_NEWS)
    assert [each.rank for each in news.entries] == list(range(2, 2 + boards.MAX_NEWS))


def test_between_protocols_and_split_revisions_no_value_is_compared(world: World) -> None:
    world.publish(world.board("a"))
    with world.database.write() as session:
        phase = session.get_one(Phase, "dev")
        old = boards.current_board(session, "dev")
        assert old is not None
        other = BoardRow(
            phase_id="dev",
            protocol_digest=old.protocol_digest,
            split_revision=old.split_revision,
            number=old.number + 1,
            digest=OTHER,
            body_digest=OTHER,
            body=canonical_json(world.board("a", "b")).decode(),
            published_at=old.published_at,
        )
        assert boards.news_between(phase.challenge, old, other) != BoardNews()
        other.split_revision = OTHER
        session.add(other)
        session.flush()
        flip = boards.flip_board(session, phase, other)
        assert flip is not None
        assert flip.news == BoardNews()


def test_protocols_are_found_by_the_flips_and_not_by_asking_every_board(world: World) -> None:
    world.publish(world.board("a"))
    with statements(world.database) as sent, world.database.read() as session:
        assert boards.public_protocols(session, "dev") == [world.protocol_digest]
    assert "EXISTS" not in sent[-1]


def test_nothing_stands_behind_the_text_of_a_board(world: World) -> None:
    columns = inspect(world.database.engine).get_columns("boards")
    assert columns[-1]["name"] == "body", "SQLite goes through all of it to reach what follows"


def test_names_of_the_forgotten_are_found_from_their_teams_and_not_from_every_entry() -> None:
    assert "JOIN board_entries" not in str(select(BoardRow.forgotten))
