"""Operator commands on tokens: how an organizer comes in first, and how a lost token is ended.

Every other deed is an organizer's: `exceptiondrive organizer ...`, over the API.
"""

from datetime import UTC, datetime, timedelta
from typing import Annotated

import typer

from exceptiondrive_records import tokens
from exceptiondrive_server.operator_session import ACTOR, DataOption, opened, records_settings, say

records_app = typer.Typer()


@records_app.command("create-organizer")
def create_organizer(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Who the organizer is.")],
    days: Annotated[
        int | None, typer.Option(min=1, help="Days until the token expires; default never.")
    ] = None,
    data: DataOption = None,
) -> None:
    """Issue a token with which an organizer may do everything, and print it, once."""
    expires_at = None if days is None else datetime.now(UTC) + timedelta(days=days)
    with opened(records_settings(data)) as database, database.write() as session:
        text, _ = tokens.issue_token(
            session, None, name, tokens.ORGANIZER_SCOPES, expires_at, actor=ACTOR
        )
    say("the token, shown this once (put it into EXCEPTIONDRIVE_TOKEN):")
    typer.echo(text)


@records_app.command("list-tokens")
def list_tokens(data: DataOption = None) -> None:
    """List all tokens, those of organizers too: id, name, scopes, state."""
    with opened(records_settings(data)) as database, database.read() as session:
        for row in tokens.list_tokens(session):
            state = "revoked" if row.revoked_at else "live"
            typer.echo("\t".join((row.id, row.name, ",".join(row.scopes), state)))


@records_app.command("revoke-token")
def revoke_token(
    token_id: Annotated[str, typer.Argument(metavar="ID", help="The eight letters of its id.")],
    data: DataOption = None,
) -> None:
    """Revoke a token for good."""
    with opened(records_settings(data)) as database, database.write() as session:
        tokens.revoke_token(session, token_id, actor=ACTOR)
    say(f"token {token_id} revoked")
