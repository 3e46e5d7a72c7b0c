"""The terms of a phase: shown, and accepted for the team."""

from typing import Annotated

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.output import show_result
from exceptiondrive.cli.session import open_client
from exceptiondrive.errors import InvalidArgumentError, utc_text
from exceptiondrive.settings import default_phase


def terms(
    phase: options.DefaultPhase = None,
    accept: Annotated[
        str | None,
        typer.Option("--accept", metavar="VERSION", help="Accept them, in the version you read."),
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show the terms of a phase, and accept them for the team."""
    phase = default_phase(phase)
    with open_client(server) as client:
        if accept is not None:
            accepted = client.accept_terms(phase, accept)
            line = f"terms of {phase}, version {accepted['version']}, accepted"
            show_result(accepted, json, line)
            return
        view = client.phase(phase)
    if view.terms_version is None:
        raise InvalidArgumentError("no_terms", f"The phase {phase} has no terms to accept.")
    how = f"accept them by: exceptiondrive terms --phase {phase} --accept {view.terms_version}"
    at = view.terms_accepted_at
    facts = {"phase": phase, "version": view.terms_version, "text": view.page.terms}
    state = how if at is None else f"accepted {utc_text(at)}"
    show_result(facts, json, view.page.terms, "", f"version {view.terms_version}; {state}")


def register(app: typer.Typer) -> None:
    """Add this command."""
    app.command()(terms)
