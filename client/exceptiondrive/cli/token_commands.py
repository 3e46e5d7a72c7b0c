"""Commands on the tokens of one's own team."""

from typing import TYPE_CHECKING, Annotated

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import say, show, show_json
from exceptiondrive.cli.records_table import show_records

if TYPE_CHECKING:
    from exceptiondrive.team_tokens import Record, TeamTokens

TokenId = Annotated[str, typer.Argument(metavar="ID", help="Id of the token: see `tokens list`.")]
COLUMNS = ("id", "name", "scopes", "created_at", "expires_at", "revoked_at", "last_used_at")


def list_tokens(server: options.Server = None, json: options.Json = False) -> None:
    """List the team's tokens, without their secrets."""
    with _tokens(server) as tokens:
        show_records(tokens.all(), COLUMNS, json)


def create_token(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What it is for.")],
    scope: Annotated[
        list[str] | None,
        typer.Option("--scope", metavar="S", help="submit, read:own or tokens; may be repeated."),
    ] = None,
    expires_at: Annotated[
        str | None, typer.Option("--expires-at", metavar="TIME", help="2027-01-31T00:00:00Z")
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Issue a token of your team; it is shown this once."""
    with _tokens(server) as tokens:
        _show_issued(tokens.create(name, scope, expires_at), json)


def rotate_token(
    token_id: TokenId,
    keep_days: Annotated[
        int, typer.Option("--keep-days", min=0, max=90, help="The old one works on so long.")
    ] = 7,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Issue the successor of a token; it is shown this once."""
    with _tokens(server) as tokens:
        issued = tokens.rotate(token_id, keep_days=keep_days)
    _show_issued(issued, json)
    if not json:
        until = "ends now" if keep_days == 0 else f"works for {keep_days} more days at most"
        say(f"the old token {token_id} {until}")


def revoke_token(
    token_id: TokenId, server: options.Server = None, json: options.Json = False
) -> None:
    """Revoke a token of your team for good."""
    with _tokens(server) as tokens:
        token = tokens.revoke(token_id)
    if json:
        show_json(token)
    else:
        show(f"token {token['id']} revoked")


def _show_issued(issued: "Record", json: bool) -> None:
    if json:
        show_json(issued)
    else:
        show(issued["token"])


def _tokens(server: str | None) -> "TeamTokens":
    from exceptiondrive.cli.session import prepare
    from exceptiondrive.team_tokens import TeamTokens

    return TeamTokens(prepare(server))


def register(app: typer.Typer) -> None:
    """Add these commands as one group."""
    group = typer.Typer(
        help="Your team's tokens; needs a token with the scope `tokens`.",
        no_args_is_help=True,
        rich_markup_mode=None,
    )
    for name, command in (
        ("list", list_tokens),
        ("create", create_token),
        ("rotate", rotate_token),
        ("revoke", revoke_token),
    ):
        group.command(name)(command)
    app.add_typer(group, name="tokens")
