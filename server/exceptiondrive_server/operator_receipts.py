"""The operator's command about the key that signs receipts."""

import os

import typer

from exceptiondrive_records.settings import PREFIX, load_settings
from exceptiondrive_server.launcher.layout import Layout
from exceptiondrive_server.operator_session import DataOption, say
from exceptiondrive_server.settings import ServerSettings

receipts_app = typer.Typer()


@receipts_app.command("new-receipt-key")
def new_receipt_key(data: DataOption = None) -> None:
    """Replace the key that signs receipts; restart the server to use it.

    Receipts of the former key stay valid: its public half stays published.
    """
    from exceptiondrive_server.receipts import write_new_key  # the other commands need it not

    chosen = {} if data is None else Layout(data).environment(os.environ)
    given = {name.removeprefix(PREFIX).lower(): value for name, value in chosen.items()}
    path = load_settings(ServerSettings, **given).receipt_key_file
    write_new_key(path, replace=True)
    say(f"a new key is in {path}; restart the server to use it")
