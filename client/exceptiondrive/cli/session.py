"""Open a client for a command: token sent safely, retries said on stderr."""

from typing import TYPE_CHECKING

from exceptiondrive.cli.output import has_terminal, say

if TYPE_CHECKING:
    from exceptiondrive.client import Client
    from exceptiondrive.organizer import Organizer


def open_client(server: str | None) -> "Client":
    """Return a client for the chosen server."""
    from exceptiondrive.client import Client

    return Client(prepare(server), on_retry=say_retry)


def open_organizer(server: str | None) -> "Organizer":
    """Return an organizer's client for the chosen server."""
    from exceptiondrive.organizer import Organizer

    return Organizer(prepare(server), on_retry=say_retry)


def prepare(server: str | None) -> str:
    """Return the address of the chosen server; a warning where a token would be sent in clear."""
    from exceptiondrive.credentials import find_server, find_token, is_sent_in_clear

    address = find_server(server)
    if is_sent_in_clear(address) and find_token(address):
        say(f"warning: {address} is not https: your token can be read on the way")
    return address


def say_retry(pause_s: float) -> None:
    """Say on a terminal that a request is sent again."""
    if has_terminal():
        say(f"no answer; trying again in {pause_s:.1f} s ...")
