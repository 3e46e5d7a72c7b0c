"""Reads new boards before anybody asks, so that the first visitor waits for no parsing.

A board of 1,000 entries takes about 0.1 s to validate. The worker publishes it; the server sees
that by one small query a second, and validates it away from any request.
"""

import threading

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError
from structlog import get_logger

from exceptiondrive_records.boards.boards import parsed_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.tables import Phase

INTERVAL_S = 1.0
_log = get_logger(__name__)


class BoardReader:
    """Keeps the current boards of all phases read; a thread of its own once started."""

    def __init__(self, database: Database, interval_s: float = INTERVAL_S) -> None:
        self._database = database
        self._interval_s = interval_s
        self._read: frozenset[int] = frozenset()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="board-reader", daemon=True)

    def start(self) -> None:
        """Begin; boards that are there already are read first."""
        self._thread.start()

    def stop(self) -> None:
        """End, within one interval."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def read_new(self) -> int:
        """Read the current boards that were not read yet; return how many."""
        with self._database.read() as session:
            query = select(Phase.current_board_id).where(Phase.current_board_id.is_not(None))
            current = frozenset(id for id in session.scalars(query) if id is not None)
            new = current - self._read
            rows = session.scalars(select(BoardRow).where(BoardRow.id.in_(new))).all()
            for row in rows:
                parsed_board(row)
        self._read = current
        return len(rows)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.read_new()
            except SQLAlchemyError as error:  # a page will read the board itself
                _log.warning("boards not read ahead", reason=type(error).__name__)
            self._stop.wait(self._interval_s)
