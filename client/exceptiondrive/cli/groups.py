"""Groups of commands whose help says what each does in whole sentences."""

from typing import Any

from typer.core import TyperGroup


class Group(TyperGroup):
    """A group that cuts no summary short, however narrow the terminal."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write what each command does, in as many lines as that takes."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [
            (name, " ".join((each.help or "").partition("\n\n")[0].split()))
            for name, each in commands
            if each is not None and not each.hidden
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)
