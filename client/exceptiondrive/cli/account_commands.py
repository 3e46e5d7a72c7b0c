"""Commands for accounts: login, logout, whoami, and the team's tokens."""

import sys
from getpass import getpass
from typing import Annotated

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.options import argument, one_of, require_one_of
from exceptiondrive.cli.output import Answer, can_ask, say, show, show_result
from exceptiondrive.cli.session import command_of, prepare, say_retry, with_client
from exceptiondrive.cli.tables import listed
from exceptiondrive.client import Client, TeamTokens
from exceptiondrive.credentials import find_server, forget_token, is_sent_in_clear, keep_token
from exceptiondrive.errors import NotSignedInError, utc_text
from exceptiondrive.transport import Record
from exceptiondrive_schemas.api.submission import Me

TokenId = Annotated[str, argument("ID", "Id of the token: see `tokens list`.")]
SCOPES = ("submit", "read:own", "tokens")
TOKEN_COLUMNS = (
    *("id", "name", "scopes", "created_at", "expires_at"),
    *("revoked_at", "last_used_at", "made_by"),
)


def login(server: options.Server = None) -> None:
    """Store a team token for a server.

    Only you can read the file. On a terminal the command asks for the token; elsewhere it reads one
    line of stdin. The token is tried before it is stored. It is never an option, because it would
    appear in the shell's history.
    """
    address = find_server(server)
    token = _read_token(address)
    if is_sent_in_clear(address):
        say(f"warning: {address} is not https: your token can be read on the way")
    with Client(address, token) as client:
        me = client.me()
    path = keep_token(address, token)
    show(f"{_describe_holder(me)} at {address}; the token is kept in {path}")


def logout(server: options.Server = None) -> None:
    """Forget the token of a server."""
    address = find_server(server)
    was_there = forget_token(address)
    show(f"token of {address} forgotten" if was_there else f"no token of {address} was kept")


@with_client
def whoami(client: Client) -> Answer:
    """Show whose token is in use."""
    me = client.me()
    address = client.server
    until = "" if me.expires_at is None else f", valid until {utc_text(me.expires_at)}"
    token = f"token {me.token_name!r}, scopes: {', '.join(me.scopes)}{until}"
    return me, f"{_describe_holder(me)} at {address}", token


def _read_token(server: str) -> str:
    """Ask a person, or read one line."""
    token = getpass(f"Token for {server}: ") if can_ask() else sys.stdin.readline()
    if not token.strip():
        raise NotSignedInError(
            "no_token",
            "No token was given.",
            'Pipe it in: printf %s "$TOKEN" | exceptiondrive login; or set EXCEPTIONDRIVE_TOKEN.',
        )
    return token.strip()


def _describe_holder(me: Me) -> str:
    """Return a team, or an organizer with its role and what it is for, where the server tells them."""
    if me.team is not None or me.role is None:
        return "organizer" if me.team is None else f"team {me.team}"
    confined = f"of {', '.join(me.phases)} alone" if me.phases else "of the whole site"
    return f"organizer ({me.role}, {confined})"


def _open_tokens(server: str | None) -> TeamTokens:
    return TeamTokens(prepare(server), on_retry=say_retry)


with_tokens = command_of(_open_tokens)


@with_tokens
def list_tokens(tokens: TeamTokens) -> Answer:
    """List the team's tokens, without their secrets."""
    return listed(tokens.all(), TOKEN_COLUMNS)


@with_tokens
def create_token(
    tokens: TeamTokens,
    name: Annotated[str, argument("NAME", "What it is for.")],
    scope: Annotated[
        list[str] | None,
        one_of("--scope", SCOPES, "submit, read:own or tokens; may be repeated.", "S"),
    ] = None,
    expires_at: options.ExpiresAt = None,
) -> Answer:
    """Issue a token for your team; it is shown only once."""
    for each in scope or ():
        require_one_of("--scope", each, SCOPES)
    issued = tokens.create(name, scope, expires_at)
    return issued, issued["token"]


def rotate_token(
    token_id: TokenId,
    keep_days: Annotated[
        int, typer.Option("--keep-days", min=0, max=90, help="How long the old one keeps working.")
    ] = 7,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Issue the successor of a token; it is shown only once."""
    with _open_tokens(server) as tokens:
        issued = tokens.rotate(token_id, keep_days=keep_days)
    show_result(issued, json, issued["token"])
    if not json:
        until = "ends now" if keep_days == 0 else f"works for {keep_days} more days at most"
        say(f"the old token {token_id} {until}")


@with_tokens
def revoke_token(tokens: TeamTokens, token_id: TokenId) -> Answer:
    """Revoke a token of your team for good."""
    return revoked(tokens.revoke(token_id))


def revoked(token: Record) -> Answer:
    """Return that a token is revoked, and which that were made with it work on."""
    left = left_words("tokens made with it keep working", token)
    return token, f"token {token['id']} revoked", *left


def left_words(what: str, told: Record) -> list[str]:
    """Return which tokens work on, of an answer of the API; nothing where there are none."""
    made = [
        f"  {one['id']}  {one['name']}  ({one['prefix']}, made by {one['made_by']})"
        for one in told.get("still_work", [])
    ]
    return [f"{what}; revoke these too, unless they are to stay:", *made] if made else []


tokens = {
    "list": list_tokens,
    "create": create_token,
    "rotate": rotate_token,
    "revoke": revoke_token,
}
