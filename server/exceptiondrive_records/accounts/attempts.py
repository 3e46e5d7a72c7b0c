"""Rate limit of sign-ins and registrations: a number per key and 15 minutes, exact under concurrency.

Attempts are counted in the database, as quotas are, so that every server process sees the same
count. The library `limits` would add a second store to replace one table of three columns.
"""

import hashlib
from collections.abc import Mapping
from datetime import datetime, timedelta

from sqlalchemy import delete, update
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tables import SignInAttempts
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Changes, upsert
from exceptiondrive_records.db.errors import TooManyAttempts

WINDOW = timedelta(minutes=15)
PER_ADDRESS = 30
PER_TOKEN_ID = 6
REGISTRATIONS_PER_ADDRESS = 5
STARTS_PER_ADDRESS = 300
"""Starts of sign-ins at a provider. They guess no secret, and any page can make browsers send them;
so their limit is separate, and only keeps the provider from being flooded."""

_AS_IT_IS: Changes = (("n", SignInAttempts.n),)


def keys_of(address: str, token_text: str) -> dict[str, int]:
    """Return the keys under which an attempt counts, each with its limit.

    Keys are digests, which hide an address from a glance, not from a brute-force search. The first
    sign-in that succeeds after their window of 15 minutes deletes them.
    """
    limits = {_key(f"address {address}"): PER_ADDRESS}
    parts = token_text.split("_")
    if len(parts) == 5 and parts[2]:
        limits[_key(f"token {parts[2][:16]}")] = PER_TOKEN_ID
    return limits


def start_keys_of(address: str) -> dict[str, int]:
    """Return the key under which starting a sign-in at a provider counts, with its limit."""
    return {_key(f"start {address}"): STARTS_PER_ADDRESS}


def registration_keys_of(address: str) -> dict[str, int]:
    """Return the key under which a registration counts, with its limit."""
    return {_key(f"registration {address}"): REGISTRATIONS_PER_ADDRESS}


def _key(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()


def count_attempt(session: Session, limits: Mapping[str, int]) -> None:
    """Count an attempt before it is evaluated.

    `limits` has the most attempts per window by key.

    Raises:
        TooManyAttempts: One of the keys has none left; nothing is counted.
    """
    now = database_now(session)
    for key, limit in sorted(limits.items()):
        row = _locked_row(session, key, now)
        if row.since <= now - WINDOW:
            row.n, row.since = 0, now
        if row.n >= limit:
            raise TooManyAttempts(row.since + WINDOW, now)
        row.n += 1


def give_attempt_back(session: Session, limits: Mapping[str, int]) -> None:
    """Undo `count_attempt` for an attempt that succeeded. Earlier failures stay counted."""
    now = database_now(session)
    session.execute(delete(SignInAttempts).where(SignInAttempts.since <= now - WINDOW))
    session.execute(
        update(SignInAttempts)
        .where(SignInAttempts.key.in_(list(limits)), SignInAttempts.n > 0)
        .values(n=SignInAttempts.n - 1)
    )


def _locked_row(session: Session, key: str, now: datetime) -> SignInAttempts:
    """Return the row of a key, created if missing, locked until the transaction ends."""
    locked = upsert(session, SignInAttempts, (), _AS_IT_IS, takes=(), keys=("key",))
    session.execute(locked, {"key": key, "n": 0, "since": now})
    return session.get_one(SignInAttempts, key, populate_existing=True)
