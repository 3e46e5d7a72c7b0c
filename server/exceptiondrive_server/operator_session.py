"""How operator commands reach the records, and how they speak."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy import make_url
from sqlalchemy.exc import DBAPIError

from exceptiondrive_records.database import Database, sentence_of
from exceptiondrive_records.migrations import is_usable
from exceptiondrive_records.settings import PREFIX, RecordsSettings, SettingsError, load_settings
from exceptiondrive_server.launcher.layout import Layout

ACTOR = "operator"

DataOption = Annotated[
    Path | None,
    typer.Option(
        "--data",
        help="Folder of `exceptiondrive-server run`; needed unless it is ./data or "
        "EXCEPTIONDRIVE_DATABASE_URL is set.",
    ),
]


def say(text: str) -> None:
    """Tell the operator something, on stderr: stdout is for results."""
    typer.echo(text, err=True)


def records_settings(data: Path | None) -> RecordsSettings:
    """Return the settings; with `data`, those of the embedded default in that folder."""
    if data is None:
        return load_settings(RecordsSettings)
    chosen = Layout(data).environment(os.environ)
    return load_settings(
        RecordsSettings,
        **{name.removeprefix(PREFIX).lower(): value for name, value in chosen.items()},
    )


@contextmanager
def opened(settings: RecordsSettings) -> Iterator[Database]:
    """Open records that exist and have the newest schema.

    Raises:
        SettingsError: They do not; the text says what to do.
    """
    url = make_url(settings.database_url)
    if url.get_backend_name() == "sqlite" and not Path(url.database or "").is_file():
        raise SettingsError(
            f"there are no records at {url.database}. Name the folder of the running server with "
            "--data, set EXCEPTIONDRIVE_DATABASE_URL, or make them: exceptiondrive-server migrate"
        )
    database = Database(settings.database_url)
    try:
        if not is_usable(database):
            raise SettingsError("the records are not up to date: run exceptiondrive-server migrate")
        yield database
    except DBAPIError as error:
        raise SettingsError(sentence_of(error)) from None
    finally:
        database.dispose()
