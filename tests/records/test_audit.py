"""The audit chain: whole under parallel writers, and broken by any change."""

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import text
from sqlalchemy.orm import Session
from tests.support.databases import POSTGRES_ALONE
from tests.support.records import next_moment

from exceptiondrive_records.audit.log import GENESIS, ISO_AT, audit, audit_page, verify_audit
from exceptiondrive_records.db.database import Database


def write_line(database: Database, number: int) -> None:
    with database.write() as session:
        audit(session, "test", "counted", f"subject {number}", {"number": number, "nested": [1.5]})


def test_an_empty_chain_is_whole(database: Database) -> None:
    with database.read() as session:
        verdict = verify_audit(session)
    assert verdict.is_whole
    assert (verdict.n_lines, verdict.head) == (0, GENESIS)


def test_parallel_writers_make_one_chain_without_a_gap(database: Database) -> None:
    with ThreadPoolExecutor(16) as pool:
        list(pool.map(lambda number: write_line(database, number), range(64)))
    with database.read() as session:
        verdict = verify_audit(session)
        assert verdict.is_whole
        assert verdict.n_lines == 64
        assert {line.detail["number"] for line in audit_page(session)} == set(range(64))


ODD: list[dict[str, Any]] = [
    {},
    {"b": [1e-7, 1e22, 0.1, -0.0, 3, None, True], "a": {"z": {}, "y": [[]]}},
    {"words": "q\" \\ \n\t \u2028 \x7f ü € \U0001f600 %s %(x)s 'x' $1", 'k"é': "\x00"},
    {"number": 2**70, "empty": "", "dates": "2026-01-01T00:00:00+00:00"},
]


def test_whatever_a_line_says_the_database_and_python_hash_it_alike(database: Database) -> None:
    """Where PostgreSQL chains, several lines of one transaction as well as those of several."""
    for details in (ODD, ODD[1:], ODD[:1]):
        with database.write() as session:
            for detail in details:
                audit(session, "o'brien \\ü", 'said "so"', "sübject\n", detail)
    with database.read() as session:
        assert verify_audit(session).is_whole
        lines = audit_page(session)
    assert [line.detail for line in reversed(lines)] == [*ODD, *ODD[1:], *ODD[:1]]
    assert [line.at for line in lines] == sorted((line.at for line in lines), reverse=True)


@POSTGRES_ALONE
@pytest.mark.parametrize("microsecond", [0, 1, 120000, 999999])
def test_the_database_writes_a_time_as_python_does(database: Database, microsecond: int) -> None:
    at = datetime(2026, 1, 31, 23, 5, 9, microsecond, tzinfo=UTC)
    with database.read() as session:
        said = session.scalar(text(f"SELECT {ISO_AT} FROM (SELECT :at AS at) AS one"), {"at": at})
    assert said == at.isoformat()


def test_a_transaction_that_fails_leaves_no_line(database: Database) -> None:
    def fail() -> None:
        with database.write() as session:
            audit(session, "test", "tried", "x")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    with database.read() as session:
        assert verify_audit(session).n_lines == 0


def test_pages_go_backwards_from_the_newest_line(database: Database) -> None:
    for number in range(5):
        write_line(database, number)
    with database.read() as session:
        first = audit_page(session, limit=3)
        rest = audit_page(session, before=first[-1].id, limit=3)
    assert [line.id for line in (*first, *rest)] == [5, 4, 3, 2, 1]


def test_lines_since_a_time_are_those_of_it_and_later(database: Database) -> None:
    for number in range(4):
        write_line(database, number)
        next_moment(database)
    with database.read() as session:
        third = audit_page(session)[1]
        assert [line.id for line in audit_page(session, since=third.at)] == [4, 3]
        assert audit_page(session, since=third.at + timedelta(days=1)) == []


def test_lines_cut_off_at_the_end_are_found_by_the_head_that_was_kept(database: Database) -> None:
    heads = []
    for number in range(4):
        write_line(database, number)
        with database.read() as session:
            heads.append(verify_audit(session).head)
    with database.write() as session:  # someone with all rights on the database
        disarm(session)
        session.execute(text("DELETE FROM audit_lines WHERE id >= 3"))
    write_line(database, 7)  # the chain goes on, and is whole
    with database.read() as session:
        found = [verify_audit(session, head) for head in (GENESIS, *heads)]
    assert [verdict.is_whole for verdict in found] == [True] * 5
    assert [verdict.holds_kept_head for verdict in found] == [True, True, True, False, False]


def disarm(session: Session) -> None:
    if session.get_bind().dialect.name == "sqlite":
        session.execute(text("DROP TRIGGER audit_lines_no_update"))
        session.execute(text("DROP TRIGGER audit_lines_no_delete"))
    else:
        session.execute(text("ALTER TABLE audit_lines DISABLE TRIGGER ALL"))


SWAPPED = """UPDATE audit_lines SET id = CASE id WHEN 3 THEN -4 ELSE -3 END WHERE id IN (3, 4);
UPDATE audit_lines SET id = -id WHERE id < 0"""
FORGED = """INSERT INTO audit_lines (id, at, actor, action, subject, detail, previous_hash, hash)
SELECT 6, at, 'organizer', action, subject, detail, hash, hash FROM audit_lines WHERE id = 5"""
TAMPERING = [
    "UPDATE audit_lines SET actor = 'someone else' WHERE id = 3",
    "UPDATE audit_lines SET detail = '{\"number\": 7}' WHERE id = 3",
    "UPDATE audit_lines SET at = (SELECT MIN(created_at) FROM old_times) WHERE id = 3",
    "DELETE FROM audit_lines WHERE id = 3",
    "UPDATE audit_lines SET hash = previous_hash WHERE id = 3",
    SWAPPED,
    FORGED,
]
BROKEN_AT = {"DELETE FROM audit_lines WHERE id = 3": 4, FORGED: 6}


@pytest.mark.parametrize("statement", TAMPERING)
def test_whoever_changes_a_line_breaks_the_chain(database: Database, statement: str) -> None:
    for number in range(5):
        write_line(database, number)
    with database.write() as session:  # someone with all rights on the database
        disarm(session)
        session.execute(text("CREATE TABLE old_times (created_at TIMESTAMP WITH TIME ZONE)"))
        session.execute(text("INSERT INTO old_times VALUES ('2020-01-01 00:00:00.000000')"))
        for one in statement.split(";"):
            session.execute(text(one))
    with database.read() as session:
        verdict = verify_audit(session)
    assert verdict.broken_at == BROKEN_AT.get(statement, 3)
