"""Operator commands on people and self-registration."""

from enum import StrEnum
from typing import Annotated

import typer

from exceptiondrive_records.people import list_people, set_organizer
from exceptiondrive_records.site_settings import switch_self_registration
from exceptiondrive_server.operator_session import ACTOR, DataOption, opened, records_settings, say

people_app = typer.Typer()


class Switch(StrEnum):
    """On or off."""

    ON = "on"
    OFF = "off"


@people_app.command("list-people")
def list_people_command(data: DataOption = None) -> None:
    """List who signed in through the provider: id, name, email, whether an organizer."""
    with opened(records_settings(data)) as database, database.read() as session:
        for person in list_people(session):
            role = "organizer" if person.is_organizer else ""
            typer.echo("\t".join((person.id, person.name, person.email or "", role)))


@people_app.command("set-organizer")
def set_organizer_command(
    person: Annotated[str, typer.Argument(metavar="PERSON", help="Id; list-people shows it.")],
    switch: Annotated[Switch, typer.Argument(help="on or off")] = Switch.ON,
    data: DataOption = None,
) -> None:
    """Make a person an organizer, or no longer."""
    with opened(records_settings(data)) as database, database.write() as session:
        row = set_organizer(session, person, switch is Switch.ON, actor=ACTOR)
        name = row.name
    say(f"{name} is {'an organizer' if switch is Switch.ON else 'no organizer'} now")


@people_app.command("self-registration")
def self_registration_command(
    switch: Annotated[Switch, typer.Argument(help="on or off")], data: DataOption = None
) -> None:
    """Let teams register themselves, or no longer; they submit when an organizer approves."""
    with opened(records_settings(data)) as database, database.write() as session:
        switch_self_registration(session, switch is Switch.ON, actor=ACTOR)
    say(
        f"self-registration is {switch} (EXCEPTIONDRIVE_SELF_REGISTRATION=false would force it off)"
    )
