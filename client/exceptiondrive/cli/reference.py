"""Writes the command reference into docs/client.md: `python -m exceptiondrive.cli.reference FILE`.

The text is the commands' own help; a test holds the file to it.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import typer
from typer.core import TyperGroup

from exceptiondrive.cli import app

BEGIN = "<!-- commands: begin; written by `python -m exceptiondrive.cli.reference` -->"
END = "<!-- commands: end -->"
WIDTH = 96


def command_reference() -> str:
    """Return the help of every command as Markdown."""
    parts = [BEGIN]
    root = typer.main.get_command(app)
    context = typer.Context(root, info_name="exceptiondrive", **root.context_settings)
    for name, text in _helps_of(context):
        parts += [f"### `{name}`", "```text\n" + text.strip() + "\n```"]
    return "\n\n".join([*parts, END])


def with_reference(document: str) -> str:
    """Return a document whose part between the marks is the current reference.

    Raises:
        ValueError: The marks are missing.
    """
    before, begin, rest = document.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError("the document has no place for the commands: the marks are missing")
    return before + command_reference() + after


def _helps_of(context: typer.Context) -> Iterator[tuple[str, str]]:
    group = context.command
    if not isinstance(group, TyperGroup):
        context.terminal_width = WIDTH
        yield context.command_path, group.get_help(context)
        return
    for name in group.list_commands(context):
        if command := group.get_command(context, name):
            yield from _helps_of(typer.Context(command, parent=context, info_name=name))


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_reference(path.read_text(encoding="utf-8")), encoding="utf-8")
