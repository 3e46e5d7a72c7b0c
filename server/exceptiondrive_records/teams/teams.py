"""Create, register, refuse and find teams, which own submissions."""

import hashlib
from collections.abc import Iterator
from datetime import timedelta
from ipaddress import IPv6Address, ip_address, ip_network

from sqlalchemy import ColumnElement, ForeignKey, delete, exists, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import REGISTRATION_REFUSED, members_of
from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.accounts.tokens import TEAM_SCOPES, issue_token
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import flush_or_refuse, hold_words
from exceptiondrive_records.db.errors import Conflict, NotAllowed, NotFound
from exceptiondrive_records.db.identifiers import (
    checked_reason,
    checked_team,
    checked_text,
    skeleton,
)
from exceptiondrive_records.db.roles import Role, rights_of
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import SiteSetting, Team


def teams_that_read(session: Session, phase_id: str | None = None) -> list[Team]:
    """Return teams whose notices somebody reads, by id; for a phase, those that submitted to it."""
    query = select(Team).where(
        Team.pending_since.is_(None),
        Team.is_reference.is_(False),
        Team.forgotten_at.is_(None),
        Team.merged_into_id.is_(None),
    )
    if phase_id is not None:
        submitted = exists().where(Submission.team_id == Team.id, Submission.phase_id == phase_id)
        query = query.where(submitted)
    return list(session.scalars(query.order_by(Team.slug)))


def create_team(
    session: Session, slug: str, name: str, *, is_reference: bool = False, actor: str
) -> Team:
    """Create a team.

    Raises:
        InvalidRecord: The slug or the name cannot be used.
        Conflict: One of them is taken.
    """
    name = checked_team(slug, name)
    is_taken = (Team.slug == slug) | (Team.name_skeleton == skeleton(name))
    taken = session.scalars(select(Team).where(is_taken)).first()
    if taken is not None and taken.slug != slug and taken.name != name:
        raise Conflict(f"There is a team with a name that looks like {name!r} already.")
    if taken is not None:
        what = f"id {slug!r}" if taken.slug == slug else f"name {name!r}"
        raise Conflict(f"There is a team with the {what} already.")
    team = Team(slug=slug, name=name, is_reference=is_reference, created_at=database_now(session))
    session.add(team)
    flush_or_refuse(
        session, f"There is a team with the id {slug!r} or a name like {name!r} already."
    )
    audit(session, actor, "team created", slug, {"name": name, "is_reference": is_reference})
    return team


def require_free_name(session: Session, team: Team) -> None:
    """Refuse a new name of a team that equals, or looks like, that of another team.

    Raises:
        Conflict: There is one.
    """
    same = (Team.name_skeleton == skeleton(team.name)) & (Team.id != team.id)
    with session.no_autoflush:
        if session.scalar(select(exists().where(same))):
            raise Conflict(f"There is a team with a name that looks like {team.name!r} already.")


def names_that_look_alike(session: Session) -> list[tuple[str, ...]]:
    """Return groups of names of existing teams that look alike; new teams could not take them."""
    alike: dict[str, list[str]] = {}
    for name in session.scalars(select(Team.name).order_by(Team.id)):
        alike.setdefault(skeleton(name), []).append(name)
    return [tuple(names) for names in alike.values() if len(names) > 1]


def find_team(session: Session, slug: str, *, lock: bool = False) -> Team:
    """Return the team with this slug; locked, as by `hold_team`.

    Raises:
        NotFound: There is none.
    """
    query = select(Team).where(Team.slug == slug)
    if lock:
        query = query.with_for_update(key_share=True).execution_options(populate_existing=True)
    team = session.scalars(query).first()
    if team is None:
        raise NotFound("team", slug)
    return team


def list_teams(session: Session) -> list[Team]:
    """Return all teams by slug."""
    return list(session.scalars(select(Team).order_by(Team.slug)))


# Refused registrations: a team that never submitted is deleted, with all rows that refer to it.


def refuse_team(session: Session, slug: str, *, reason: str, actor: str) -> None:
    """Refuse and delete a team that waits for approval: its id and name are free again.

    Only audit lines stay: its own, and one for each member, who is notified by it. Foreign keys
    name the rows to delete, in every table, directly or indirectly of the team. Rows in tables in
    which the server may not delete prevent the refusal.

    Raises:
        NotFound: There is no such team.
        InvalidRecord: The reason cannot be stored.
        Conflict: It was approved, has submitted, or was disqualified.
    """
    team = find_team(session, slug, lock=True)
    if team.pending_since is None:
        raise Conflict("The team is approved; only a team that waits for approval can be refused.")
    for person, _ in members_of(session, team.id):
        audit(session, actor, REGISTRATION_REFUSED, person.id, {"name": team.name})
    detail = {"reason": checked_reason(reason), "name": team.name}
    audit(session, actor, "team refused", slug, detail)
    deletable = rights_of(Role.API)
    for table in reversed(Base.metadata.sorted_tables):
        if "DELETE" not in deletable[table.name]:
            continue
        for key in table.foreign_keys:
            for of_team in _of_team(key, team.id):
                session.execute(delete(table).where(of_team))
    session.delete(team)
    flush_or_refuse(session, "The team has submissions or was disqualified: the records keep it.")


def _of_team(key: ForeignKey, team_id: int) -> Iterator[ColumnElement[bool]]:
    """Yield conditions for the rows that refer to a team, directly or through other rows of it."""
    target = key.column.table
    if target is Team.__table__:
        yield key.parent == team_id
    elif target is not Submission.__table__:
        for own in target.foreign_keys:
            if own.column.table is Team.__table__:
                yield key.parent.in_(select(key.column).where(own.parent == team_id))


# Self-registration of teams: they get a token at once, and may submit once they are approved.


MAX_PENDING = 200
"""Maximum number of teams that wait for approval, beyond which registrations are refused."""
MAX_PENDING_OF_NETWORK = 20
PLACE_LASTS = timedelta(days=3)
"""A registration that has waited for so long stays, but no longer counts towards the limits."""
_NETWORK_BITS = {4: 16, 6: 32}
"""Prefix length by IP version: one provider has many addresses with the same prefix."""


def register_team(
    session: Session, slug: str, name: str, note: str, *, address: str = ""
) -> tuple[str, Token, Team]:
    """Create a team that waits for approval, and its first token, whose text is returned only here.

    Raises:
        InvalidRecord: A text cannot be used.
        Conflict: Id or name is taken, or too many teams wait for approval.
    """
    team = make_pending_team(session, slug, name, note, actor="registration", address=address)
    text, token = issue_token(session, team.id, "first token", TEAM_SCOPES, actor="registration")
    return text, token, team


def make_pending_team(
    session: Session, slug: str, name: str, note: str, *, actor: str, address: str = ""
) -> Team:
    """Create a team that waits for approval.

    The note tells organizers who they are and how to reach them. Only a digest of the network of
    the address is stored, until the team is approved.

    Raises:
        InvalidRecord: A text cannot be used.
        Conflict: Id or name is taken, or too many teams wait, in all or of the network.
    """
    network = _network_digest(address)
    hold_words(session, "places of teams that wait for approval")
    has_place = Team.pending_since > database_now(session) - PLACE_LASTS
    if _count(session, has_place) >= MAX_PENDING:
        raise Conflict("Too many teams wait for approval; ask an organizer.")
    is_near = Team.registered_from == network
    if network is not None and _count(session, has_place, is_near) >= MAX_PENDING_OF_NETWORK:
        raise Conflict("Too many teams of your network wait for approval; ask an organizer.")
    note = checked_text("note", note, max_length=500, may_have_lines=True)
    team = create_team(session, slug, name, actor=actor)
    team.pending_since = database_now(session)
    team.registration_note, team.registered_from = note, network
    return team


def _count(session: Session, *which: ColumnElement[bool]) -> int:
    return session.scalar(select(func.count()).select_from(Team).where(*which)) or 0


def _network_digest(address: str) -> str | None:
    """Return the digest of an address's network; None if it is not an IP address."""
    try:
        found = ip_address(address)
    except ValueError:
        return None
    mapped = found.ipv4_mapped if isinstance(found, IPv6Address) else None
    host = mapped or found
    network = ip_network((host, _NETWORK_BITS[host.version]), strict=False)
    return hashlib.sha256(f"network {network}".encode()).hexdigest()


NOT_APPROVED = "Your team is not approved yet; an organizer has to look at it first."


def require_approved(team: Team) -> None:
    """Refuse a submission of a team that waits for approval, or is gone."""
    if team.is_gone:
        raise NotAllowed("Your team was forgotten, or became part of another one, meanwhile.")
    if team.pending_since is not None:
        raise NotAllowed(NOT_APPROVED)


# Settings that operators switch while the server runs. Every change leaves an audit line.


_SELF_REGISTRATION = "self_registration"


def self_registration_is_on(session: Session, environment: bool | None) -> bool:
    """Whether teams may register themselves.

    An `environment` of False forces it off, whatever operators switched; True is the default until
    they switch it; None means off until they do.
    """
    if environment is False:
        return False
    switched = session.get(SiteSetting, _SELF_REGISTRATION)
    return bool(switched.value["is_on"]) if switched is not None else environment is True


def switch_self_registration(session: Session, is_on: bool, *, actor: str) -> None:
    """Switch self-registration of teams on or off."""
    row, value = session.get(SiteSetting, _SELF_REGISTRATION), {"is_on": is_on}
    if row is not None and row.value == value:
        return
    now = database_now(session)
    session.merge(SiteSetting(name=_SELF_REGISTRATION, value=value, changed_at=now))
    audit(session, actor, "self-registration switched", "on" if is_on else "off")
