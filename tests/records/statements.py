"""Which SQL a reading sends: some readings must not grow with what they do not show."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

from sqlalchemy import event
from sqlalchemy.orm import Session

from exceptiondrive_records.db.database import Database


@contextmanager
def statements(database: Database) -> Iterator[list[str]]:
    """Give a list that fills with the statements of this database's readers."""
    seen: list[str] = []

    def note(connection: Any, cursor: Any, statement: str, *_: Any) -> None:
        seen.append(statement)

    event.listen(database.engine, "before_cursor_execute", note)
    try:
        yield seen
    finally:
        event.remove(database.engine, "before_cursor_execute", note)


def steps_of(database: Database, read: Callable[[Session], object]) -> int:
    """Count the steps of SQLite's machine for a reading, in hundreds: they are the same each time."""
    hundreds = count(1)
    with database.read() as session:
        driver: Any = session.connection().connection.driver_connection
        driver.set_progress_handler(lambda: next(hundreds) < 0, 100)
        try:
            read(session)
        finally:
            driver.set_progress_handler(None, 100)
    return next(hundreds)


def loops_of(database: Database, read: Callable[[Session], object]) -> int:
    """Return how often PostgreSQL repeats the step of a reading that it repeats most."""
    asked: list[tuple[str, Any]] = []

    def note(connection: Any, cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        asked.append((statement, parameters))

    event.listen(database.engine, "before_cursor_execute", note)
    try:
        with database.read() as session:
            read(session)
    finally:
        event.remove(database.engine, "before_cursor_execute", note)
    with database.read() as session:
        driver: Any = session.connection().connection.driver_connection
        plans = [
            driver.execute(f"EXPLAIN (ANALYZE, FORMAT JSON) {statement}", parameters).fetchone()[0]
            for statement, parameters in asked
        ]
    return max(loops for plan in plans for loops in _loops(plan[0]["Plan"]))


def _loops(plan: dict[str, Any]) -> Iterator[int]:
    yield int(plan["Actual Loops"])
    for step in plan.get("Plans", ()):
        yield from _loops(step)


def of_board_texts(sent: Iterable[str]) -> list[str]:
    """Return the statements that read the text of a board, which may be as long as the board."""
    return [statement for statement in sent if re.search(r"boards\.body\b", statement)]
