"""Open a client for a command: token sent safely, retries said on stderr."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import wraps
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any

from exceptiondrive.cli import options
from exceptiondrive.cli.output import Answer, has_terminal, say, show_result

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


def command_of(
    open_it: Callable[[str | None], AbstractContextManager[Any]],
) -> Callable[[Callable[..., Answer]], Callable[..., None]]:
    """Return what makes a command of a function that asks a server.

    The function gets what `open_it` opens, then its own options; the command has `--server` and
    `--json` besides, and shows the answer.
    """
    ours = (
        Parameter("server", Parameter.KEYWORD_ONLY, default=None, annotation=options.Server),
        Parameter("json", Parameter.KEYWORD_ONLY, default=False, annotation=options.Json),
    )

    def made_of(function: Callable[..., Answer]) -> Callable[..., None]:
        @wraps(function)
        def command(server: str | None, json: bool, **given: Any) -> None:
            with open_it(server) as client:
                result, *words = function(client, **given)
            show_result(result, json, *words)

        _, *own = signature(function).parameters.values()
        more = [own.pop()] if own and own[-1].kind is Parameter.VAR_KEYWORD else []
        return options.with_parameters(command, [*own, *ours, *more])

    return made_of


with_client = command_of(open_client)
with_organizer = command_of(open_organizer)
