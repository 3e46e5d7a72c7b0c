"""Sign-ins that are under way at the provider: each ends once, in the browser that began it."""

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy import delete
from sqlalchemy.orm import Session

from exceptiondrive_records.clock import database_now
from exceptiondrive_records.tables_people import SignInFlow

LIFETIME = timedelta(minutes=10)


@dataclass(frozen=True)
class Flow:
    """What the provider is asked with (state, nonce), and what only we know (the verifier)."""

    state: str
    nonce: str
    code_verifier: str
    back: str


def begin_flow(session: Session, visitor: str, back: str) -> Flow:
    """Note that a browser is sent to the provider; flows that ran out are removed on the way.

    Args:
        session: Of a write transaction.
        visitor: The secret of the browser.
        back: The page to go to afterwards.
    """
    now = database_now(session)
    session.execute(delete(SignInFlow).where(SignInFlow.expires_at <= now))
    state, nonce, code_verifier = (secrets.token_urlsafe(32) for _ in range(3))
    flow = Flow(state, nonce, code_verifier, back)
    session.add(
        SignInFlow(
            state_digest=_digest(flow.state),
            visitor_digest=_digest(visitor),
            nonce=flow.nonce,
            code_verifier=flow.code_verifier,
            back=back,
            expires_at=now + LIFETIME,
        )
    )
    return flow


def end_flow(session: Session, state: str, visitor: str) -> Flow | None:
    """Return the flow of a state, once; None if there is none, or another browser began it."""
    digest = _digest(state)
    ended = session.scalars(
        delete(SignInFlow).where(SignInFlow.state_digest == digest).returning(SignInFlow)
    ).one_or_none()
    if ended is None or ended.expires_at <= database_now(session):
        return None
    if not hmac.compare_digest(ended.visitor_digest, _digest(visitor)):
        return None
    return Flow(state, ended.nonce, ended.code_verifier, ended.back)


def _digest(secret: str) -> str:
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()
