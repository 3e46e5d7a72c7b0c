"""Bearer tokens: `edk_<scope letter>_<8 id>_<32 random>_<6 checksum>`, kept as a digest only.

Prefix and checksum let leak scanners find tokens without false alarms (docs/trust.md).
No slow hash is needed: the random part has 190 bits.
"""

import hmac
import secrets
import string
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from enum import StrEnum
from typing import Any

from sqlalchemy import bindparam, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team, withdraw_invitations_of
from exceptiondrive_records.accounts.roles import OrganizerRole, checked_phases
from exceptiondrive_records.accounts.tables import Person, Token
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database, find_row
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotAllowed, NotFound
from exceptiondrive_records.db.identifiers import checked_text, random_id, secret_digest
from exceptiondrive_records.teams.tables import Team

_ALPHABET = string.ascii_letters + string.digits
_UNKNOWN = secret_digest("no such token")
_ACTOR = "token:"
_PERSON = "person:"
_TEAM = "team:"
_USE_IS_COARSE = timedelta(minutes=10)
_TOKEN_AND_TEAM = (
    select(Token, Team)
    .outerjoin(Team, Team.id == Token.team_id)
    .where(Token.id == bindparam("token"))
)


class Scope(StrEnum):
    """What a token may do."""

    SUBMIT = "submit"
    READ_OWN = "read:own"
    TOKENS = "tokens"
    """List, issue, rotate and revoke the tokens of its own team."""
    ORGANIZE = "organizer"
    """Everything that organizers do: the role `owner`."""
    ORGANIZE_HELP = "organizer:helper"
    ORGANIZE_READ = "organizer:read-only"


MEANING_OF_SCOPE: Mapping[Scope, str] = {
    Scope.SUBMIT: "submit, edit, publish and withdraw",
    Scope.READ_OWN: "see the team's submissions",
    Scope.TOKENS: "manage the team's tokens",
    Scope.ORGANIZE: "everything that organizers do",
    Scope.ORGANIZE_HELP: "help the organizers with teams and submissions",
    Scope.ORGANIZE_READ: "see what organizers see",
}
"""Descriptions of the scopes, as pages list them."""
PARTICIPANT_SCOPES = (Scope.SUBMIT, Scope.READ_OWN)
TEAM_SCOPES = (*PARTICIPANT_SCOPES, Scope.TOKENS)
"""The scopes that organizers hand to a team, so that it can manage its own tokens."""
ORGANIZER_SCOPES = (Scope.SUBMIT, Scope.READ_OWN, Scope.ORGANIZE)
SCOPES_OF_ROLE: Mapping[OrganizerRole, tuple[Scope, ...]] = {
    OrganizerRole.OWNER: ORGANIZER_SCOPES,
    OrganizerRole.HELPER: (Scope.READ_OWN, Scope.ORGANIZE_HELP),
    OrganizerRole.READ_ONLY: (Scope.READ_OWN, Scope.ORGANIZE_READ),
}


@dataclass(frozen=True)
class Principal:
    """The authenticated sender of a request: the holder of a token, or a signed-in person."""

    token_id: str
    token_name: str
    scopes: frozenset[str]
    expires_at: datetime | None
    team_id: int | None
    team_slug: str | None
    team_name: str | None
    team_is_pending: bool
    """Whether the team still waits for approval."""
    use_is_stale: bool = field(default=False, compare=False)
    person_id: str | None = None
    """The person who signed in through the provider, without a token."""
    person_name: str = ""
    phases: frozenset[str] = frozenset()
    """The phases that an organizer is confined to; empty if the role is for the whole site."""

    @property
    def role(self) -> OrganizerRole | None:
        """The organizer role of the principal; None if it has none."""
        held = (role for role, scopes in SCOPES_OF_ROLE.items() if scopes[-1] in self.scopes)
        return next(held, None)

    @property
    def is_organizer(self) -> bool:
        """Whether it may see what organizers of the whole site see."""
        return self.role is not None and not self.phases

    def organizes(self, phase_id: str | None) -> bool:
        """Whether its role applies to a phase; None stands for the whole site."""
        return self.is_organizer or (self.role is not None and phase_id in self.phases)

    @property
    def actor(self) -> str:
        """The name of the principal in audit lines."""
        return (
            f"{_ACTOR}{self.token_id}" if self.person_id is None else f"{_PERSON}{self.person_id}"
        )


def issue_token(
    session: Session,
    team_id: int | None,
    name: str,
    scopes: tuple[str, ...] = PARTICIPANT_SCOPES,
    expires_at: datetime | None = None,
    *,
    phases: Iterable[str] = (),
    actor: str,
) -> tuple[str, Token]:
    """Issue a token; its text is returned only here.

    Raises:
        InvalidRecord: No scope, or an unknown one; the name cannot be used; the end is in the past.
        NotFound: It is confined to a phase that does not exist.
        Conflict: The team was refused or forgotten, or became part of another one.
    """
    if team_id is not None:
        hold_team(session, team_id).require_there()
    name = checked_text("token name", name, max_length=80)
    unknown = sorted(set(scopes) - set(Scope))
    known = ", ".join(Scope if team_id is None else TEAM_SCOPES)
    if not scopes:
        raise InvalidRecord(f"The token may do nothing yet: tick at least one of {known}.")
    if unknown:
        raise InvalidRecord(f"Unknown scopes: {', '.join(unknown)}. Known: {known}.")
    now = database_now(session)
    if expires_at is not None and expires_at <= now:
        raise InvalidRecord("The token would be expired already.")
    confined_to = checked_phases(session, phases)
    letter = "o" if any(scope.startswith(Scope.ORGANIZE) for scope in scopes) else "s"
    token_id = random_id(8)
    text = _token_text(letter, token_id)
    token = Token(
        id=token_id,
        team_id=team_id,
        name=name,
        scopes=sorted({str(scope) for scope in scopes}),
        phases=confined_to,
        secret_digest=secret_digest(text),
        prefix=f"edk_{letter}_{token_id}",
        created_at=now,
        expires_at=expires_at,
        revoked_at=None,
        last_used_at=None,
    )
    session.add(token)
    session.flush()
    detail: dict[str, Any] = {"name": name, "scopes": token.scopes, "team_id": team_id}
    if confined_to:
        detail["phases"] = confined_to
    audit(session, actor, "token issued", token_id, detail)
    return text, token


def verify_token(session: Session, text: str) -> Principal | None:
    """Return the principal of a token, or None; unknown ids take as long as wrong secrets."""
    parts = text.split("_")
    token_id = parts[2] if len(parts) == 5 and len(text) < 100 else ""
    row = session.execute(_TOKEN_AND_TEAM, {"token": token_id}).first()
    token, team = (row[0], row[1]) if row else (None, None)
    expected = token.secret_digest if token is not None else _UNKNOWN
    is_right = hmac.compare_digest(secret_digest(text), expected)
    now = database_now(session)
    if token is None or not is_right or not is_live(token, now):
        return None
    return _principal(token, team, now)


def principal_of(session: Session, token: Token) -> Principal | None:
    """Return the principal of a token whose secret was verified; None if it has ended."""
    now = database_now(session)
    team = None if token.team_id is None else session.get(Team, token.team_id)
    return _principal(token, team, now) if is_live(token, now) else None


def _principal(token: Token, team: Team | None, now: datetime) -> Principal:
    used_at = token.last_used_at
    return Principal(
        token_id=token.id,
        token_name=token.name,
        scopes=frozenset(token.scopes),
        expires_at=token.expires_at,
        team_id=team.id if team else None,
        team_slug=team.slug if team else None,
        team_name=team.name if team else None,
        team_is_pending=team is not None and team.pending_since is not None,
        phases=frozenset(token.phases),
        use_is_stale=used_at is None or now - used_at > _USE_IS_COARSE,
    )


def note_use(database: Database, principal: Principal) -> None:
    """Record the use of a token, at most every ten minutes."""
    if not principal.use_is_stale:
        return
    with database.write() as session:
        used = update(Token).where(Token.id == principal.token_id)
        session.execute(used.values(last_used_at=database_now(session)))


def revoke_token(session: Session, token_id: str, *, actor: str) -> Token:
    """Revoke a token permanently, and withdraw the invitations that it made.

    Raises:
        NotFound: There is none with this id.
        Conflict: It is revoked already.
    """
    token = find_row(session, Token, "token", token_id, lock={"key_share": True})
    if token.revoked_at is not None:
        raise Conflict(f"Token {token_id!r} is revoked already.")
    token.revoked_at = database_now(session)
    audit(session, actor, "token revoked", token_id)
    withdraw_invitations_of(session, f"{_ACTOR}{token_id}", actor=actor)
    return token


def find_token(session: Session, token_id: str) -> Token:
    """Return a token.

    Raises:
        NotFound: There is none with this id.
    """
    return find_row(session, Token, "token", token_id)


def list_tokens(session: Session, team_id: int | None = None) -> list[Token]:
    """Return tokens, newest first; of one team if given."""
    query = select(Token).order_by(Token.created_at.desc(), Token.id)
    if team_id is not None:
        query = query.where(Token.team_id == team_id)
    return list(session.scalars(query))


def live_tokens_by_team(session: Session) -> dict[int, int]:
    """Return the number of live tokens of each team."""
    now = database_now(session)
    tokens = (token for token in list_tokens(session) if is_live(token, now))
    return Counter(token.team_id for token in tokens if token.team_id is not None)


def names_of_actors(session: Session, actors: Iterable[str]) -> dict[str, str]:
    """Return the names behind the actors of audit lines: of tokens, people or teams."""
    given = list(actors)
    ids = {actor.removeprefix(_ACTOR) for actor in given if actor.startswith(_ACTOR)}
    query = select(Token.id, Token.name, Team.name).outerjoin(Team, Team.id == Token.team_id)
    names = {
        f"{_ACTOR}{token_id}": f"{name} ({team_name})" if team_name else name
        for token_id, name, team_name in session.execute(query.where(Token.id.in_(ids)))
    }
    people = {actor.removeprefix(_PERSON) for actor in given if actor.startswith(_PERSON)}
    found = session.execute(select(Person.id, Person.name).where(Person.id.in_(people)))
    names |= {f"{_PERSON}{person_id}": name for person_id, name in found}
    numbers = (actor.removeprefix(_TEAM) for actor in given if actor.startswith(_TEAM))
    teams = {int(number) for number in numbers if number.isdigit()}
    found = session.execute(select(Team.id, Team.name).where(Team.id.in_(teams)))
    return names | {f"{_TEAM}{team_id}": name for team_id, name in found}


def _token_text(letter: str, token_id: str) -> str:
    secret = "".join(secrets.choice(_ALPHABET) for _ in range(32))
    body = f"edk_{letter}_{token_id}_{secret}"
    return f"{body}_{_checksum(body)}"


def _checksum(body: str) -> str:
    number = zlib.crc32(body.encode())
    digits = ""
    for _ in range(6):
        number, digit = divmod(number, 62)
        digits += _ALPHABET[digit]
    return digits


def is_live(token: Token, now: datetime) -> bool:
    """Whether a token is neither revoked nor expired."""
    return token.revoked_at is None and (token.expires_at is None or token.expires_at > now)


# How a team manages its own tokens. No token gives a right that its issuer does not hold.


MAX_LIVE_TOKENS = 50
MAX_NEW_TOKENS_A_DAY = 100
"""Each leaves a row and an audit line forever, however soon it is revoked."""
DEFAULT_KEEP_DAYS = 7
MAX_KEEP_DAYS = 90


def issue_team_token(
    session: Session,
    principal: Principal,
    name: str,
    scopes: tuple[str, ...],
    expires_at: datetime | None = None,
) -> tuple[str, Token]:
    """Issue a token for the sender's team; by default it expires with the sender's own.

    Raises:
        NotAllowed: The new token would have a scope that the sender does not hold, or a later end.
        Conflict: The team reached its limit of live or of daily new tokens; or as `issue_token`.
        InvalidRecord: As `issue_token` raises it.
    """
    more = sorted(set(scopes) - principal.scopes)
    if more:
        raise NotAllowed(f"Your own token does not have the scope {', '.join(more)}.")
    own_end = principal.expires_at
    if expires_at is not None and own_end is not None and expires_at > own_end:
        end = f"{own_end:%Y-%m-%dT%H:%M:%SZ}"
        raise NotAllowed(f"Your own token ends at {end}, and a token of it no later.")
    expires_at = own_end if expires_at is None else expires_at
    if principal.team_id is not None:
        hold_team(session, principal.team_id)
    now = database_now(session)
    known = team_tokens(session, principal)
    if sum(is_live(token, now) for token in known) >= MAX_LIVE_TOKENS:
        raise Conflict(f"The team has {MAX_LIVE_TOKENS} live tokens; revoke one first.")
    if sum(now - token.created_at < timedelta(days=1) for token in known) >= MAX_NEW_TOKENS_A_DAY:
        raise Conflict(f"A team may make {MAX_NEW_TOKENS_A_DAY} tokens in 24 hours; go on later.")
    return issue_token(session, principal.team_id, name, scopes, expires_at, actor=principal.actor)


def rotate_team_token(
    session: Session, principal: Principal, token_id: str, keep_days: int = DEFAULT_KEEP_DAYS
) -> tuple[str, Token]:
    """Issue the successor of a token; the old one stays valid for `keep_days` more.

    It has the same name, scopes and lifetime, and expires no later than the sender's own.

    Raises:
        NotFound: The team has no such token.
        NotAllowed: The token holds a scope that the sender does not hold.
        Conflict: The token is revoked or has expired.
        InvalidRecord: The number of days cannot be used.
    """
    if not 0 <= keep_days <= MAX_KEEP_DAYS:
        raise InvalidRecord(f"The old token may be kept for 0 to {MAX_KEEP_DAYS} days.")
    old = find_team_token(session, principal, token_id)
    now = database_now(session)
    if not is_live(old, now):
        raise Conflict(f"Token {token_id!r} is revoked or has expired; issue a new one.")
    expires_at = None if old.expires_at is None else now + (old.expires_at - old.created_at)
    if expires_at is not None and principal.expires_at is not None:
        expires_at = min(expires_at, principal.expires_at)
    text, new = issue_team_token(session, principal, old.name, tuple(old.scopes), expires_at)
    ends_at = now + timedelta(days=keep_days)
    old.expires_at = ends_at if old.expires_at is None else min(ends_at, old.expires_at)
    audit(session, principal.actor, "token rotated", token_id, {"successor": new.id})
    if keep_days == 0:
        withdraw_invitations_of(session, f"{_ACTOR}{token_id}", actor=principal.actor)
    return text, new


def revoke_team_token(session: Session, principal: Principal, token_id: str) -> Token:
    """Revoke a token of the sender's team permanently, even the sender's own.

    Raises:
        NotFound: The team has no such token.
        Conflict: It is revoked already.
    """
    find_team_token(session, principal, token_id)
    return revoke_token(session, token_id, actor=principal.actor)


def team_tokens(session: Session, principal: Principal) -> list[Token]:
    """Return the tokens of the sender's team, newest first."""
    return [] if principal.team_id is None else list_tokens(session, principal.team_id)


def find_team_token(session: Session, principal: Principal, token_id: str) -> Token:
    """Return a token of the sender's team.

    Raises:
        NotFound: There is none, or it is another team's: the answer is the same.
    """
    token = session.get(Token, token_id)
    if token is None or token.team_id is None or token.team_id != principal.team_id:
        raise NotFound("token", token_id)
    return token


def may_invite(principal: Principal) -> bool:
    """Whether it has all rights that a new member gets: every scope of a team, without expiry."""
    return set(TEAM_SCOPES) <= principal.scopes and principal.expires_at is None
