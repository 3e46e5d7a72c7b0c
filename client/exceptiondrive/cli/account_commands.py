"""Commands about who one is: login, logout, whoami."""

import sys

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import can_ask, say, show, show_document


def login(server: options.Server = None) -> None:
    """Keep a team token for a server.

    The file is readable by you alone. Asks for the token on a terminal; elsewhere reads one line of stdin. It is tried before it is
    kept. A token is never an option: it would stand in the shell's history.
    """
    from exceptiondrive.credentials import find_server, is_sent_in_clear, keep_token

    address = find_server(server)
    token = _token(address)
    if is_sent_in_clear(address):
        say(f"warning: {address} is not https: your token can be read on the way")
    from exceptiondrive.client import Client

    with Client(address, token) as client:
        me = client.me()
    path = keep_token(address, token)
    show(f"{_name(me.team)} at {address}; the token is kept in {path}")


def logout(server: options.Server = None) -> None:
    """Forget the token of a server."""
    from exceptiondrive.credentials import find_server, forget_token

    address = find_server(server)
    was_there = forget_token(address)
    show(f"token of {address} forgotten" if was_there else f"no token of {address} was kept")


def whoami(server: options.Server = None, json: options.Json = False) -> None:
    """Show whose token is in use."""
    from exceptiondrive.cli.session import open_client
    from exceptiondrive.errors import utc_text

    with open_client(server) as client:
        me = client.me()
        address = client.server
    if json:
        show_document(me)
        return
    until = "" if me.expires_at is None else f", valid until {utc_text(me.expires_at)}"
    show(f"{_name(me.team)} at {address}")
    show(f"token {me.token_name!r}, scopes: {', '.join(me.scopes)}{until}")


def _token(server: str) -> str:
    """Ask a person, or read one line."""
    from getpass import getpass

    from exceptiondrive.errors import NotSignedInError

    token = getpass(f"Token for {server}: ") if can_ask() else sys.stdin.readline()
    if not token.strip():
        raise NotSignedInError(
            "no_token",
            "No token was given.",
            'Pipe it in: printf %s "$TOKEN" | exceptiondrive login; or set EXCEPTIONDRIVE_TOKEN.',
        )
    return token.strip()


def _name(team: str | None) -> str:
    return "organizer" if team is None else f"team {team}"


def register(app: typer.Typer) -> None:
    """Add these commands."""
    app.command()(login)
    app.command()(logout)
    app.command()(whoami)
