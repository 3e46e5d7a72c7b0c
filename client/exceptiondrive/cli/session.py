"""Open a client for a command: token sent safely, retries said on stderr."""

from typing import TYPE_CHECKING, Any

from exceptiondrive.cli.output import has_terminal, say

if TYPE_CHECKING:
    from exceptiondrive.client import Client
    from exceptiondrive.organizer import Organizer


def open_client(server: str | None) -> "Client":
    """Return a client for the chosen server."""
    from exceptiondrive.client import Client

    return Client(prepare(server))


def open_organizer(server: str | None) -> "Organizer":
    """Return an organizer's client for the chosen server."""
    from exceptiondrive.organizer import Organizer

    return Organizer(prepare(server))


def prepare(server: str | None) -> str:
    """Return the address of the chosen server; from here on retries are said on a terminal."""
    import stamina.instrumentation

    from exceptiondrive.credentials import find_server, find_token, is_sent_in_clear

    stamina.instrumentation.set_on_retry_hooks([_say_retry] if has_terminal() else [])
    address = find_server(server)
    if is_sent_in_clear(address) and find_token(address):
        say(f"warning: {address} is not https: your token can be read on the way")
    return address


def _say_retry(details: Any) -> None:
    say(f"no answer; trying again in {details.wait_for:.0f} s ...")
