"""The operator's commands about keys: the first secrets of a server, the key that signs receipts."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive_records.settings import PREFIX, load_settings
from exceptiondrive_server.launcher.errors import LaunchError
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
    with _writing(path):
        write_new_key(path, replace=True)
    say(f"a new key is in {path}; restart the server to use it")


@receipts_app.command("init-secrets")
def init_secrets(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Made where it is not there.")],
    host: Annotated[
        str, typer.Option("--host", help="Name of the server, for its first TLS certificate.")
    ] = "localhost",
) -> None:
    """Write every secret that compose.yaml names into DIR, with passwords of its own."""
    from exceptiondrive_server.first_secrets import write_first_secrets  # see above

    with _writing(folder):
        written = write_first_secrets(folder, host)
    say(f"{len(written)} files are in {folder}; keep a copy where backups are kept")
    say(f"tls.crt signs itself for {host}: put a real certificate into tls.crt and tls.key")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Say in one sentence what cannot be written."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise LaunchError(
            f"{path} cannot be written: {reason}. A file that is mounted as a secret is replaced "
            "where it comes from: `rotate keys` in docs/operating.md."
        ) from None
