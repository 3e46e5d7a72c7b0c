"""Which SQL a reading sends: some readings must not grow with what they do not show."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import event

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


def of_board_texts(sent: Iterable[str]) -> list[str]:
    """Return the statements that read the text of a board, which may be as long as the board."""
    return [statement for statement in sent if re.search(r"boards\.body\b", statement)]
