"""Boards: immutable snapshots, and one pointer that moves."""

import gc
from datetime import UTC, datetime, timedelta
from typing import Any
from weakref import ref

import pytest
from sqlalchemy import inspect, select, text, update
from sqlalchemy.exc import DatabaseError
from sqlalchemy.orm import Session
from tests.records.statements import of_board_texts, statements
from tests.support.work import claim_board_of

from exceptiondrive_records.audit.log import count_audit_lines
from exceptiondrive_records.boards import boards
from exceptiondrive_records.boards import standings as board_records
from exceptiondrive_records.boards.tables import BoardEntryRow, BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.db.memory import Memory
from exceptiondrive_records.operations.invariants import broken_boards
from exceptiondrive_records.phases.scoring_keys import ScoringKey, key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.views import board_history
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.board_requests import is_board_wanted, want_board
from exceptiondrive_records.work.tables import BoardRequest
from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.board import Board, BoardEntry, BoardNews
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef

World = Any
OTHER = "sha256:" + "0" * 64


def board(world: World, *submission_ids: str) -> Board:
    entries = tuple(
        BoardEntry(
            source="scored",
            rank=rank,
            rank_interval=(1, 2),
            submission_id=submission_id,
            method="method",
            team="Alpha",
            submitted_at=None,
            metrics={"hcc": 0.5},
            micro={"hcc": 0.5},
            macro_family={"hcc": 0.5},
            intervals={},
            families={},
        )
        for rank, submission_id in enumerate(submission_ids, start=1)
    )
    return Board(
        challenge=PLANNING.id,
        phase="dev",
        split=SplitRef(name="sample", revision="sha256:" + "5" * 64),
        protocol=ProtocolRef(version="1.0", digest=world.protocol_digest),
        headline="macro_family",
        board=0,
        published_at=datetime(2020, 1, 1, tzinfo=UTC),
        n_samples=3,
        confidence=0.95,
        families=(),
        entries=entries,
    )


def take(world: World) -> BoardRequest | None:
    with world.database.write() as session:
        return claim_board_of(session, "dev", world.protocol_digest)


def want(world: World) -> None:
    with world.database.write() as session:
        want_board(session, "dev", world.protocol_digest)


def test_a_board_knows_its_entries(world: World) -> None:
    want(world)
    first = publish(world, board(world, "a", "b"))
    want(world)
    second = publish(world, board(world, "b", "c"))
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


def test_entries_live_no_longer_than_their_board(world: World, monkeypatch: Any) -> None:
    monkeypatch.setattr(boards, "_PARSED", Memory(1))  # the newest board alone
    want(world)
    first = publish(world, board(world, "a", "b"))
    want(world)
    second = publish(world, board(world, "b", "c"))
    with world.database.read() as session:
        read = ref(boards.entries_on(session, first.id)["a"])
        assert read() is not None
        boards.entries_on(session, second.id)
    gc.collect()
    assert read() is None


def test_entries_in_the_table_are_those_of_the_body(world: World) -> None:
    want(world)
    row = publish(world, board(world, "a", "b"))
    with world.database.write() as session:
        session.add(BoardEntryRow(board_id=row.id, submission_id="x", rank=3))
        session.flush()
        assert "entries of a board altered" in {fault.rule for fault in broken_boards(session)}
    with pytest.raises(DatabaseError, match="append-only"), world.database.write() as session:
        session.execute(text("UPDATE board_entries SET rank = 1"))


def publish(world: World, what: Board) -> BoardRow:
    claim = take(world)
    assert claim is not None
    with world.database.write() as session:
        row = boards.publish_board(session, claim, what)
    assert row is not None
    return row


def shown_key(session: Session) -> ScoringKey:
    return key_of_phase(session.get_one(Phase, "dev"))


def test_a_new_phase_wants_its_first_board(world: World) -> None:
    with world.database.read() as session:
        assert is_board_wanted(session, "dev", *shown_key(session))
        assert boards.current_board(session, "dev") is None


def test_one_worker_at_a_time_builds_a_board(world: World) -> None:
    claim = take(world)
    assert claim is not None
    assert take(world) is None
    with world.database.write() as session:
        ended_at = database_now(session) - timedelta(seconds=1)
        session.execute(update(BoardRequest).values(lease_until=ended_at))
    assert take(world) is not None


def test_a_published_board_is_current_and_its_body_is_served_as_it_is(world: World) -> None:
    row = publish(world, board(world, "a"))
    with world.database.read() as session:
        current = boards.current_board(session, "dev")
        assert current is not None
        assert current.id == row.id
        served = Board.model_validate_json(current.body)
        assert (served.board, served.published_at) == (1, current.published_at)
        assert current.digest == board(world, "a").content_digest
        assert current.body_digest == content_digest(served)
        assert not is_board_wanted(session, "dev", *shown_key(session))
    assert take(world) is None


def test_a_board_that_says_the_same_is_not_appended(world: World) -> None:
    first = publish(world, board(world, "a"))
    want(world)
    assert publish(world, board(world, "a")).id == first.id
    with world.database.read() as session:
        assert session.query(BoardRow).count() == 1
        assert count_audit_lines(session, "board published") == 1


def test_what_came_while_a_board_was_built_is_built_next(world: World) -> None:
    claim = take(world)
    assert claim is not None
    want(world)
    with world.database.write() as session:
        boards.publish_board(session, claim, board(world, "a"))
    with world.database.read() as session:
        assert is_board_wanted(session, "dev", *shown_key(session))


def test_what_was_built_before_is_no_attempt_of_the_next_build(world: World) -> None:
    """Organizers are told of a board that was begun again and again and not finished."""
    for name in ("a", "b", "c"):
        want(world)
        claim = take(world)
        assert claim is not None
        assert claim.attempts == 1
        with world.database.write() as session:
            assert boards.publish_board(session, claim, board(world, name)) is not None


def test_a_late_builder_publishes_nothing(world: World) -> None:
    late = take(world)
    assert late is not None
    assert late.leased_at is not None
    with world.database.write() as session:
        session.execute(update(BoardRequest).values(lease_until=late.leased_at.replace(year=2020)))
    publish(world, board(world, "new"))
    with world.database.write() as session:
        assert boards.publish_board(session, late, board(world, "old")) is None
    with world.database.read() as session:
        current = boards.current_board(session, "dev")
        assert current is not None
        assert '"new"' in current.body
        assert count_audit_lines(session, "stale fence rejected") == 1


def test_every_earlier_board_keeps_its_address(world: World) -> None:
    first = publish(world, board(world, "a"))
    want(world)
    second = publish(world, board(world, "b"))
    with world.database.read() as session:
        assert boards.find_board(session, "dev", 1).body == first.body
        assert boards.find_board(session, "dev", 2).body == second.body
        with pytest.raises(NotFound):
            boards.find_board(session, "dev", 3)
        before = boards.board_at(session, "dev", second.published_at)
        assert before is not None
        at_first = boards.board_at(session, "dev", first.published_at.replace(year=2020))
        assert at_first is None


def test_a_board_under_another_protocol_is_kept_but_not_shown(world: World) -> None:
    first = publish(world, board(world, "a"))
    with world.database.write() as session:  # a draft protocol is scored in the background
        session.execute(
            text("INSERT INTO protocols VALUES (:digest, '9.9', '', CURRENT_TIMESTAMP)"),
            {"digest": OTHER},
        )
        want_board(session, "dev", OTHER)
    with world.database.write() as session:
        claim = claim_board_of(session, "dev", OTHER)
        assert claim is not None
        draft = boards.publish_board(session, claim, board(world, "b"))
    with world.database.read() as session:
        current = boards.current_board(session, "dev")
        assert current is not None
        assert draft is not None
        assert current.id == first.id
        assert boards.latest_board(session, "dev", OTHER).id == draft.id  # type: ignore[union-attr]


@pytest.mark.parametrize("statement", ["UPDATE boards SET body = ''", "DELETE FROM boards"])
def test_the_database_refuses_to_change_a_board(world: World, statement: str) -> None:
    publish(world, board(world, "a"))
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
        world.score(world.submit(content, method, team_id).job_id, hcc)
    world.submit("waiting", "c")
    with world.database.read() as session:
        found = board_records.entries_for_board(session, "dev", world.protocol_digest)
    assert [(e.team, e.method, e.sheet.micro["hcc"], e.is_reference) for e in found] == [
        ("Alpha", "a", 0.2, False),
        ("Alpha", "b", 0.3, False),
        ("Beta", "a", 0.4, True),
    ]


def test_a_withdrawn_submission_gives_way_to_the_one_before_it(world: World) -> None:
    world.score(world.submit("1").job_id, 0.1)
    second = world.submit("2")
    world.score(second.job_id, 0.2)
    with world.database.write() as session:
        withdraw(session, second.submission.id, actor="test")
    with world.database.read() as session:
        found = board_records.entries_for_board(session, "dev", world.protocol_digest)
    assert [entry.sheet.micro["hcc"] for entry in found] == [0.1]


def test_a_board_never_mixes_protocols(world: World) -> None:
    world.score(world.submit("1").job_id)
    with world.database.read() as session:
        assert board_records.entries_for_board(session, "dev", OTHER) == []
        assert session.get_one(Phase, "dev").protocol_digest == world.protocol_digest


def test_the_history_of_boards_reads_none_of_them(world: World) -> None:
    for name in ("a", "b", "c"):
        publish(world, board(world, name))
        want(world)
    with statements(world.database) as three, world.database.read() as session:
        lines = board_history(session, "dev")
    assert [line.board for line in lines] == [3, 2, 1]
    assert lines[0].shown_until is None
    assert lines[1].shown_until == lines[0].shown_from
    assert not of_board_texts(three)
    publish(world, board(world, "d"))
    with statements(world.database) as four, world.database.read() as session:
        board_history(session, "dev")
    assert len(four) == len(three)


def test_the_history_says_whose_scores_changed_and_by_how_much(world: World) -> None:
    first = board(world, "a", "b", "c")
    publish(world, first)
    want(world)
    a, b, _ = first.entries
    better = a.model_copy(update={"metrics": {"hcc": 0.625}})
    new = b.model_copy(update={"submission_id": "d", "method": "Another", "rank": None})
    publish(world, first.model_copy(update={"entries": (better, b, new)}))
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
    first = board(world, "a", "b")
    publish(world, first)
    want(world)
    a, b = first.entries
    again = b.model_copy(update={"submission_id": "c", "metrics": {"hcc": 0.25}})
    publish(world, first.model_copy(update={"entries": (a, again)}))
    with world.database.read() as session:
        (told,) = board_history(session, "dev")[0].news.entries
    assert (told.submission_id, told.before, told.after) == ("c", 0.5, 0.25)
    assert (told.is_new_run, told.is_new, told.has_left) == (True, False, False)


def test_of_many_changes_some_are_named_and_all_are_counted(world: World) -> None:
    publish(world, board(world, "a"))
    want(world)
    publish(world, board(world, "a", *[f"b{i}" for i in range(30)]))
    with world.database.read() as session:
        news = board_history(session, "dev")[0].news
    assert (len(news.entries), news.n_more) == (boards.MAX_NEWS, 30 - boards.MAX_NEWS)
    assert [each.rank for each in news.entries] == list(range(2, 2 + boards.MAX_NEWS))


def test_between_protocols_and_split_revisions_no_value_is_compared(world: World) -> None:
    publish(world, board(world, "a"))
    with world.database.write() as session:
        phase = session.get_one(Phase, "dev")
        old = boards.current_board(session, "dev")
        assert old is not None
        other = BoardRow(
            phase_id="dev",
            protocol_digest=old.protocol_digest,
            split_revision=OTHER,
            number=old.number + 1,
            digest=OTHER,
            body_digest=OTHER,
            body=old.body,
            published_at=old.published_at,
        )
        session.add(other)
        session.flush()
        flip = boards.flip_board(session, phase, other)
        assert flip is not None
        assert flip.news == BoardNews()
    one, two = board(world, "a"), board(world, "b")
    later = SplitRef(name=two.split.name, revision=OTHER)
    assert boards.news_between(one, two) != BoardNews()
    assert boards.news_between(one, two.model_copy(update={"split": later})) == BoardNews()


def test_protocols_are_found_by_the_flips_and_not_by_asking_every_board(world: World) -> None:
    publish(world, board(world, "a"))
    with statements(world.database) as sent, world.database.read() as session:
        assert boards.public_protocols(session, "dev") == [world.protocol_digest]
    assert "EXISTS" not in sent[-1]


def test_nothing_stands_behind_the_text_of_a_board(world: World) -> None:
    columns = inspect(world.database.engine).get_columns("boards")
    assert columns[-1]["name"] == "body", "SQLite goes through all of it to reach what follows"


def test_names_of_the_forgotten_are_found_from_their_teams_and_not_from_every_entry() -> None:
    assert "JOIN board_entries" not in str(select(BoardRow.forgotten))
