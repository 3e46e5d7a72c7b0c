"""Leases on work items: a worker claims an item, and may finish it only while it holds the lease.

Every step is one compare-and-set by the database's clock. Choosing and claiming is one statement,
so that concurrent workers take different items, and none waits for another.
"""

from collections.abc import Callable, Sequence
from datetime import datetime
from functools import cache, lru_cache
from typing import Any, TypeVar

from sqlalchemy import (
    ColumnElement,
    Double,
    Select,
    Update,
    and_,
    bindparam,
    case,
    delete,
    exists,
    or_,
    select,
    update,
)
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import (
    NOW,
    SET_BACK,
    Moment,
    database_now,
    seconds_from_now,
    seconds_since,
)
from exceptiondrive_records.db.columns import UtcDateTime
from exceptiondrive_records.db.database import insert_if_absent, upsert
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.db.last import do_last, require_last
from exceptiondrive_records.work.tables import OPEN_STATES, Leader, WorkItem, WorkState
from exceptiondrive_schemas.jobs import Lane

Item = TypeVar("Item", bound=WorkItem)
CLAIMED_FROM = (WorkState.QUEUED, WorkState.LEASED)
"""A redundant condition on these states lets queries use an index that skips all ended items."""
_IS_LEASED = WorkItem.state == WorkState.LEASED
_RESTED_AT = seconds_from_now(bindparam("rests_s", type_=Double()))
_RESTS_LONGER = and_(WorkItem.state == WorkState.DONE, WorkItem.available_at < _RESTED_AT)
_ASKED_AGAIN = (
    ("asked", WorkItem.asked + 1),
    ("state", case((_IS_LEASED, WorkItem.state), else_=WorkState.QUEUED.value)),
    ("attempts", case((_IS_LEASED, WorkItem.attempts), else_=0)),
    ("finished_at", None),
    ("available_at", case((_RESTS_LONGER, _RESTED_AT), else_=WorkItem.available_at)),
)
_NEW = (("created_at", NOW), ("available_at", NOW))
_IS_CLAIM = and_(WorkItem.id == bindparam("item"), WorkItem.fence == bindparam("held"))
_IS_LEFT = exists().where(_IS_CLAIM, ~_IS_LEASED)
_HELD_FOR_S = select(seconds_since(bindparam("claimed_at", type_=UtcDateTime()))).where(
    _IS_CLAIM, _IS_LEASED
)
_LEAVE = (
    update(WorkItem)
    .where(_IS_CLAIM, _IS_LEASED)
    .values(
        lease_until=None,
        available_at=seconds_from_now(bindparam("rests_s", type_=Double())),
        took_s=seconds_since(bindparam("claimed_at", type_=UtcDateTime())),
    )
    .execution_options(synchronize_session=False)
)
_IS_OVER = WorkItem.asked == bindparam("was_asked")
_FINISH = _LEAVE.values(
    state=case((_IS_OVER, bindparam("ends_as")), else_=WorkState.QUEUED.value),
    attempts=case((_IS_OVER, WorkItem.attempts), else_=0),
    finished_at=case((_IS_OVER, NOW), else_=None),
)

_FINISH_AFTER = _FINISH.values(took_s=bindparam("took_s"))


def new_item(
    kind: type[Item],
    key: str,
    now: datetime,
    *,
    lane: Lane | None = None,
    is_held: bool = False,
    **columns: object,
) -> Item:
    """Return a waiting item, not yet added to a session."""
    values = _new_values(kind, key, lane=lane, is_held=is_held)
    return kind(**values, created_at=now, available_at=now, **columns)


def ask(
    session: Session,
    kind: type[WorkItem],
    key: str,
    *,
    lane: Lane | None = None,
    rests_s: float = 0.0,
    **columns: object,
) -> None:
    """Request work at the end of this transaction, again if it was done before.

    If it is being done now, it is done once more afterwards. If it was done before, it waits for at
    least `rests_s` from now.
    """
    how = upsert(session, kind, _NEW, _ASKED_AGAIN, takes=("lane",), keys=("kind", "key"))
    values = _new_values(kind, key, lane=lane) | columns | {"rests_s": rests_s}
    do_last(session, how, values, is_shared=True)


def ask_once(
    session: Session, kind: type[WorkItem], key: str, *, lane: Lane | None = None, **columns: object
) -> None:
    """Request work, unless it was ever requested before."""
    insert_if_absent(session, kind, _NEW, **_new_values(kind, key, lane=lane), **columns)


def is_free(kind: type[WorkItem], now: Moment) -> ColumnElement[bool]:
    """Condition: an item is free, because it waits or its lease has expired."""
    is_over = or_(kind.lease_until < now, kind.leased_at > SET_BACK)
    is_expired = and_(kind.state == WorkState.LEASED, is_over)
    return and_(kind.state.in_(CLAIMED_FROM), or_(kind.state == WorkState.QUEUED, is_expired))


def is_claimable(kind: type[WorkItem], now: Moment) -> ColumnElement[bool]:
    """Condition: an item is free and due."""
    return and_(is_free(kind, now), kind.available_at <= now)


def claim(session: Session, kind: type[Item], first: Select[str], lease_s: float) -> Item | None:
    """Choose and claim an item in one statement; None if none is free.

    `first` selects ids of free items at `NOW` in the order of work; if it is a cached object, the
    whole statement is built only once. The lease is longer than the work may take. The item is
    returned as claimed, and its fence proves the lease.
    """
    given = {"lease_s": lease_s}
    taken: Item | None = session.scalars(_claim_statement(kind, first), given).first()
    if taken is not None:
        session.expunge(taken)
    return taken


@lru_cache
def _claim_statement(kind: type[WorkItem], first: Select[str]) -> Any:
    """Wrap the update in a select: the session would compile a bare update at each execution."""
    chosen = first.limit(1).with_for_update(of=kind, skip_locked=True)
    change = (
        update(kind)
        .where(kind.id == chosen.scalar_subquery(), is_free(kind, NOW))
        .values(
            state=WorkState.LEASED,
            attempts=kind.attempts + 1,
            fence=kind.fence + 1,
            leased_at=NOW,
            lease_until=seconds_from_now(bindparam("lease_s", type_=Double())),
        )
        .returning(kind)
    )
    return select(kind).from_statement(change).execution_options(populate_existing=True)


def claim_oldest(
    session: Session, kind: type[Item], lease_s: float, max_attempts: int
) -> Item | None:
    """Claim the oldest item of a kind that has had fewer than `max_attempts`."""
    return claim(session, kind, _oldest_first(kind, max_attempts), lease_s)


@cache
def _oldest_first(kind: type[WorkItem], max_attempts: int) -> Select[str]:
    return (
        select(kind.id)
        .where(is_claimable(kind, NOW), kind.attempts < max_attempts)
        .order_by(kind.created_at, kind.id)
    )


def finish(
    session: Session, item: WorkItem, state: WorkState = WorkState.DONE, *, note: str | None = None
) -> bool:
    """End an item; if it was requested again meanwhile, it waits again. `note` says why it failed.

    It returns whether the lease was still held; if not, only an audit line was written.
    """
    how = {"was_asked": item.asked, "ends_as": state.value, "note": note}
    return _leave_lease(session, item, _FINISH, rests_s=0.0, **how)


class LeaseLost(Exception):  # noqa: N818 - no error: another worker does it now
    """Another worker claimed the item before its end could be recorded, so nothing was recorded."""


def finish_last(session: Session, item: WorkItem, pause_after: Callable[[float], float]) -> bool:
    """Defer `finish` to the end of this transaction, which is committed only if the lease is held.

    `pause_after` maps the seconds that the work took to the pause before it may be done again.

    Raises:
        LeaseLost: At the end of the transaction, if the lease was lost meanwhile.
    """
    claim = _claim_of(item)
    took_s = session.scalar(_HELD_FOR_S, claim)
    if took_s is None:
        _tell_stale(session, item)
        return False
    how = {"was_asked": item.asked, "ends_as": WorkState.DONE.value, "note": None}
    how |= {"took_s": took_s, "rests_s": pause_after(took_s)}
    do_last(session, _FINISH_AFTER, claim | how, is_shared=True)
    require_last(session, _IS_LEFT, claim, LeaseLost(item.subject))
    return True


def try_later(
    session: Session, item: WorkItem, wait_s: float, *, counts: bool = True, note: str | None = None
) -> bool:
    """Return an item for a later retry; `counts` says whether this was one of its attempts."""
    given = {"state": WorkState.QUEUED, "attempts": item.attempts - (not counts), "note": note}
    return _leave_lease(session, item, _LEAVE, rests_s=wait_s, **given)


def wait_before_next_s(item: WorkItem, first_s: float) -> float:
    """Return the backoff after a failed attempt: `first_s` after the first, doubling with each."""
    return first_s * 2.0 ** (item.attempts - 1)


def give_up(
    session: Session, kind: type[Item], max_attempts: int, *which: ColumnElement[bool]
) -> Sequence[Item]:
    """Give up items all of whose attempts ended without an answer; return them."""
    now = database_now(session)
    is_exhausted = and_(kind.attempts >= max_attempts, is_free(kind, now))
    given_up = _end_statement(kind, WorkState.DEAD, now).where(is_exhausted, *which).returning(kind)
    return session.scalars(given_up, execution_options={"populate_existing": True}).all()


def cancel(
    session: Session, kind: type[WorkItem], now: datetime, *which: ColumnElement[bool]
) -> None:
    """Cancel items that have not ended; their holders lose the lease."""
    is_open = kind.state.in_(OPEN_STATES)
    session.execute(_end_statement(kind, WorkState.CANCELLED, now).where(is_open, *which))


def _end_statement(kind: type[WorkItem], state: WorkState, now: datetime) -> Update:
    values = {"state": state, "fence": kind.fence + 1, "lease_until": None, "finished_at": now}
    return update(kind).values(values).execution_options(synchronize_session=False)


def _leave_lease(session: Session, item: WorkItem, how: Update, **given: object) -> bool:
    changed = session.connection().execute(how, _claim_of(item) | given)
    if changed.rowcount == 1:
        return True
    _tell_stale(session, item)
    return False


def _tell_stale(session: Session, item: WorkItem) -> None:
    """Write an audit line about a worker that tried to record a result after losing its lease."""
    detail = {"item": item.id, "fence": item.fence}
    audit(session, "worker", "stale fence rejected", item.subject, detail)


def _claim_of(item: WorkItem) -> dict[str, Any]:
    return {"item": item.id, "held": item.fence, "claimed_at": item.leased_at}


def take_lead(session: Session, name: str, holder: str, lease_s: float) -> bool:
    """Become or stay the leader; return False while another holder's lease is valid."""
    made = (*_NEW, ("lease_until", NOW))
    insert_if_absent(session, Leader, made, **_new_values(Leader, name), holder=holder)
    is_over = or_(Leader.lease_until <= NOW, Leader.leased_at > SET_BACK)
    lease = {"leased_at": NOW, "lease_until": seconds_from_now(lease_s)}
    taken = session.execute(
        update(Leader)
        .where(Leader.key == name, or_(Leader.holder == holder, is_over))
        .values(state=WorkState.LEASED, holder=holder, **lease)
        .returning(Leader.id)
        .execution_options(synchronize_session=False)
    ).first()
    return taken is not None


def give_up_lead(session: Session, name: str, holder: str) -> None:
    """Release leadership, so that another process can lead at once."""
    session.execute(delete(Leader).where(Leader.key == name, Leader.holder == holder))


def _new_values(
    kind: type[WorkItem], key: str, *, lane: Lane | None = None, is_held: bool = False
) -> dict[str, Any]:
    """Return the columns of a new item, except times and those specific to a kind."""
    return {
        "id": random_id(24),
        "kind": kind.__mapper__.polymorphic_identity,
        "key": key,
        "lane": lane,
        "state": WorkState.HELD if is_held else WorkState.QUEUED,
        "asked": 1,
        "attempts": 0,
        "fence": 0,
    }
