"""Defer statements to the end of a write transaction: updates without a result, and a condition.

`Database.write` sends them together with the audit lines and the commit, on PostgreSQL in one round
trip. So no contended row stays locked during a round trip, however far away the database is.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from sqlalchemy import ColumnElement, Executable, case, literal, select
from sqlalchemy.orm import Session

WRITES = "exceptiondrive_writes"
"""Execution option of write transactions. On PostgreSQL the driver begins none by itself."""
_LAST = "exceptiondrive_last"


@dataclass(frozen=True)
class _Last:
    what: Executable
    given: dict[str, Any]
    is_shared: bool
    refusal: Exception | None = None
    """Set if the statement is a condition: if it does not hold, it divides by zero, which is an
    error in PostgreSQL and NULL in SQLite."""


def do_last(
    session: Session,
    what: Executable,
    given: Mapping[str, Any] | None = None,
    *,
    is_shared: bool = False,
) -> None:
    """Defer a statement to the end of this write transaction.

    Its result is not read. Statements that lock a contended row (`is_shared`) run after all others.
    """
    _last_of(session).append(_Last(what, dict(given or {}), is_shared))


def require_last(
    session: Session, holds: ColumnElement[bool], given: Mapping[str, Any], refusal: Exception
) -> None:
    """Commit this write transaction only if a condition holds at its end, with shared rows locked.

    Otherwise `refusal` is raised.
    """
    _last_of(session).append(
        _Last(_fail_unless(holds), dict(given), is_shared=True, refusal=refusal)
    )


@lru_cache
def _fail_unless(holds: ColumnElement[bool]) -> Executable:
    return select(literal(1) // case((holds, 1), else_=0))


def _last_of(session: Session) -> list[_Last]:
    kept: list[_Last] = session.info.setdefault(_LAST, [])
    return kept


def take_last(session: Session) -> list[_Last]:
    """Return and clear the deferred statements, contended rows last, by key to avoid deadlocks."""
    last: list[_Last] = session.info.pop(_LAST, [])
    return sorted(last, key=lambda each: (each.is_shared, each.given.get("key", "")))
