"""People and their organizers' roles."""

from collections.abc import Callable
from typing import Annotated

import typer

from exceptiondrive.cli import completion, options
from exceptiondrive.cli.output import show_result
from exceptiondrive.cli.session import open_organizer
from exceptiondrive.cli.tables import records_table


def list_people(server: options.Server = None, json: options.Json = False) -> None:
    """List everybody who signed in through the provider, with their roles."""
    with open_organizer(server) as organizer:
        found = organizer.people()
    columns = ("id", "name", "role", "phases", "signed_in_at")
    show_result(found, json, records_table(found, columns))


def set_role(
    person: Annotated[str, typer.Argument(metavar="PERSON", help="Id of the person.")],
    role: Annotated[
        str | None,
        typer.Option(
            "--role",
            metavar="ROLE",
            autocompletion=completion.choices("owner", "helper", "read-only"),
            help="owner, helper or read-only; else none.",
        ),
    ] = None,
    phases: Annotated[
        list[str] | None,
        typer.Option(
            "--phase",
            metavar="ID",
            autocompletion=completion.phases,
            help="Confines the role to it; may stand again.",
        ),
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Give a person a role of organizers, or take it; it counts from their next request on."""
    with open_organizer(server) as organizer:
        told = organizer.set_role(person, role, phases or ())
    show_result(told, json, f"{told['name']}: {told['role'] or 'no organizer'}")


PEOPLE: dict[str, Callable[..., None]] = {"list": list_people, "set": set_role}
