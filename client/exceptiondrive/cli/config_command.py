"""The command that shows and keeps the usual server and phase."""

from typing import Annotated

import typer

from exceptiondrive.cli import completion, options
from exceptiondrive.cli.completion import choices
from exceptiondrive.cli.fitted_table import FittedTable
from exceptiondrive.cli.options import argument, flag
from exceptiondrive.cli.output import show, show_result
from exceptiondrive.credentials import normal_server, server_setting
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.settings import (
    VARIABLES,
    config_path,
    find_setting,
    keep_setting,
    require_known,
)


def _complete_value(context: typer.Context, incomplete: str) -> list[completion.Completion]:
    is_phase = context.params.get("name") == "phase"
    return completion.phases(context, incomplete) if is_phase else []


def config(
    name: Annotated[
        str | None,
        argument(
            "[NAME]",
            f"{' or '.join(VARIABLES)}; without it both are shown.",
            offer=choices(*VARIABLES),
        ),
    ] = None,
    value: Annotated[
        str | None, argument("[VALUE]", "Set it as the usual one.", offer=_complete_value)
    ] = None,
    unset: Annotated[bool, flag("--unset", "Remove it from the file.")] = False,
    json: options.Json = False,
) -> None:
    """Show or set the usual server and phase.

    Options take precedence, then EXCEPTIONDRIVE_SERVER and EXCEPTIONDRIVE_PHASE, then config.toml,
    which this command writes, and for the server the one of the last `login`. The command shows
    each value in use and where it was found.
    """
    if name is None:
        _show_all(json)
        return
    require_known(name)
    if (value is None) != unset:
        raise InvalidArgumentError(
            "wrong_option", "Give a value, or --unset.", f"exceptiondrive config {name} VALUE"
        )
    if name == "server" and value is not None:
        value = normal_server(value)
    path = keep_setting(name, value)
    fact = {"name": name, "value": value, "path": str(path)}
    show_result(fact, json, f"{name} {'is unset' if unset else value} in {path}")
    if not json and (found := find_setting(name)).value not in (value, None):
        show(f"but {found.found_in} says {found.value}, and comes first")


def _show_all(json: bool) -> None:
    found = {"server": server_setting(), "phase": find_setting("phase")}
    table = FittedTable.of("setting", "value", "found in")
    for name, each in found.items():
        place = config_path().name if each.found_in == str(config_path()) else each.found_in
        table.add_row(name, each.value or "", place or "nowhere")
    facts = {
        "path": str(config_path()),
        "settings": {name: each._asdict() for name, each in found.items()},
    }
    show_result(facts, json, table, f"file: {config_path()}")
