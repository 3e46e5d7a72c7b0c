"""Commands for organizers, all over the API with an organizer's token."""

import typer


def register(app: typer.Typer) -> None:
    """Add these commands."""
