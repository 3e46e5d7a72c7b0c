"""Which token or person issued each token, according to the audit log.

A token outlives its issuer, as a rotated token must. So whoever revokes a token is shown the tokens
that it issued and that still work.
"""

from collections.abc import Collection, Iterable, Mapping

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import members_of
from exceptiondrive_records.accounts.tables import Person, Token
from exceptiondrive_records.accounts.tokens import is_live, list_tokens
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.teams.tables import Team


def makers_of_tokens(session: Session, team_id: int | None = None) -> dict[str, str]:
    """Return the issuing actor of each token, or of each token of one team."""
    query = (
        select(AuditLine.subject, AuditLine.actor)
        .join(Token, Token.id == AuditLine.subject)
        .where(AuditLine.action == "token issued")
    )
    if team_id is not None:
        query = query.where(Token.team_id == team_id)
    return {token_id: actor for token_id, actor in session.execute(query)}


def live_tokens_by_maker(
    session: Session, actors: Iterable[str], team_id: int | None = None
) -> dict[str, list[Token]]:
    """Return, for each actor, the live tokens that it issued, directly or through tokens that it issued.

    Of one team, or of all; newest first.
    """
    makers, now = makers_of_tokens(session, team_id), database_now(session)
    live = [token for token in list_tokens(session, team_id) if is_live(token, now)]
    return {actor: _tokens_made_by(actor, makers, live) for actor in actors}


def left_behind(session: Session, actor: str, team_id: int | None = None) -> list[Token]:
    """Return the live tokens that stay valid after their issuer loses its rights, newest first."""
    return live_tokens_by_maker(session, [actor], team_id)[actor]


def _tokens_made_by(actor: str, makers: Mapping[str, str], live: Iterable[Token]) -> list[Token]:
    reached, before = {actor}, 0
    while len(reached) > before:
        before = len(reached)
        reached |= {f"token:{made}" for made, maker in makers.items() if maker in reached}
    return [token for token in live if f"token:{token.id}" in reached - {actor}]


def makers_in_words(session: Session, team_id: int, makers: Mapping[str, str]) -> dict[str, str]:
    """Return the issuer of each token in words for its team, which names only its own tokens and people."""
    own = {f"token:{one.id}": f"{one.name} ({one.prefix})" for one in list_tokens(session, team_id)}
    own |= _people(session, team_id, set(makers.values()))
    return {
        token_id: own.get(actor) or _maker_outside_team(actor) for token_id, actor in makers.items()
    }


def _people(session: Session, team_id: int, actors: Collection[str]) -> dict[str, str]:
    """Return the names of a team's present and former members."""
    names = {f"person:{person.id}": person.name for person, _ in members_of(session, team_id)}
    if any(actor.startswith("person:") and actor not in names for actor in actors):
        removals = select(AuditLine.detail).where(
            AuditLine.subject == select(Team.slug).where(Team.id == team_id).scalar_subquery(),
            AuditLine.action == "member removed",
        )
        gone = {str(detail["person"]) for detail in session.scalars(removals)}
        for person in session.scalars(select(Person).where(Person.id.in_(gone))):
            names.setdefault(f"person:{person.id}", f"{person.name}, no member now")
    return names


def _maker_outside_team(actor: str) -> str:
    """Describe an issuer who never belonged to the team."""
    return actor if actor == "registration" else "organizers"
