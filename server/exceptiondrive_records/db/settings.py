"""Read settings from the environment; a malformed one stops the start with one clear sentence."""

import difflib
import os
import re
from pathlib import Path
from typing import Annotated, Self, TypeVar
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict
from pydantic_settings import SettingsError as UnreadableError
from sqlalchemy import make_url
from sqlalchemy.exc import ArgumentError

PREFIX = "EXCEPTIONDRIVE_"
SECRETS_VARIABLE = "EXCEPTIONDRIVE_SECRETS_DIR"
Seconds = Annotated[float, Field(gt=0, le=86_400)]
_UNREADABLE = (
    "cannot be read as user:password@host:port; signs like / # ? @ : in a password are written as %2F "
    "%23 %3F %40 %3A"
)
"""It does not quote the value, which could reveal parts of a password."""


def matching(pattern: str, words: str) -> AfterValidator:
    """Return a validator that refuses texts that do not match the pattern, with this message."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(words)
        return text

    return AfterValidator(check)


SiteUrl = Annotated[
    str,
    matching(
        r"(https?://[^/?#@\s]+/?)?",
        "must be http:// or https:// with a host and no path, as in https://board.example.org",
    ),
]


class SettingsError(Exception):
    """The environment cannot be used; the text says which variable and why."""


class RecordsSettings(BaseSettings):
    """Settings that server, reconciler and worker share.

    Every field is an environment variable with the prefix `EXCEPTIONDRIVE_`.
    """

    model_config = SettingsConfigDict(env_prefix=PREFIX, extra="ignore", frozen=True)

    database_url: str = "sqlite:///data/records.sqlite3"
    broker_url: str = "redis://127.0.0.1:6379/0"
    file_store_url: Annotated[
        str, matching("file:///.*|s3://[^/?#].*", "must start with file:/// or s3://BUCKET")
    ] = Field(default_factory=lambda: Path("data/uploads").absolute().as_uri())
    lease_s: Seconds = 120.0
    max_attempts: Annotated[int, Field(ge=1, le=100)] = 4
    retry_backoff_s: Seconds = 2.0
    reconcile_every_s: Seconds = 1.0
    leader_lease_s: Seconds = 10.0

    @field_validator("database_url")
    @classmethod
    def _database_is_supported(cls, url: str) -> str:
        if not url.startswith(("sqlite:///", "postgresql+psycopg://")):
            raise ValueError("must start with sqlite:/// or postgresql+psycopg://")
        try:
            make_url(url)
        except (ArgumentError, ValueError):
            raise ValueError(_UNREADABLE) from None
        return url

    @field_validator("broker_url")
    @classmethod
    def _broker_is_supported(cls, url: str) -> str:
        if not url.startswith(("redis://", "rediss://", "redis+socket://")):
            raise ValueError("must start with redis://, rediss:// or redis+socket://")
        try:
            urlsplit(url).port  # noqa: B018 - the access parses it
        except ValueError:
            raise ValueError(_UNREADABLE) from None
        return url

    @model_validator(mode="after")
    def _leader_is_heard_in_time(self) -> Self:
        if self.reconcile_every_s * 3 > self.leader_lease_s:
            raise ValueError(
                "EXCEPTIONDRIVE_RECONCILE_EVERY_S must be at most a third of "
                "EXCEPTIONDRIVE_LEADER_LEASE_S"
            )
        return self


Settings = TypeVar("Settings", bound=RecordsSettings)


def folder_settings(data: Path) -> dict[str, str]:
    """Return the paths in the data folder of `exceptiondrive-server run`, by setting."""
    folder = data.resolve()
    return {
        "database_url": f"sqlite:///{folder / 'records.sqlite3'}",
        "file_store_url": (folder / "uploads").as_uri(),
        "receipt_key_file": str(folder / "receipt-key.pem"),
        "private_dir": str(folder / "private"),
    }


def load_settings(kind: type[Settings], data: Path | None = None) -> Settings:
    """Read settings of this kind from the environment, else from a data folder, else from secrets.

    `data` is the folder of an `exceptiondrive-server run`. A secret is a file under /run/secrets
    (or the folder that EXCEPTIONDRIVE_SECRETS_DIR names) with the name of the variable in lower
    case.

    Raises:
        SettingsError: A value is malformed, its file cannot be read, or a variable looks misspelt.
    """
    _refuse_misspelt(set(kind.model_fields))
    folder = Path(os.environ.get(SECRETS_VARIABLE, "/run/secrets"))
    of_folder = {} if data is None else folder_settings(data)
    given = {
        name: os.environ.get(PREFIX + name.upper(), value)
        for name, value in of_folder.items()
        if name in kind.model_fields
    }
    try:
        if SECRETS_VARIABLE in os.environ and not folder.is_dir():
            raise SettingsError(f"{SECRETS_VARIABLE} names {folder}, and there is no such folder")
        secrets = {"_secrets_dir": folder} if folder.is_dir() else {}
        return kind(**given, **secrets)  # type: ignore[arg-type]
    except ValidationError as error:
        lines = [_line(item["loc"], item["msg"]) for item in error.errors(include_input=False)]
        raise SettingsError("the settings are not valid:\n" + "\n".join(lines)) from None
    except (OSError, UnreadableError) as error:
        reason = error.__cause__ if isinstance(error.__cause__, OSError) else error
        raise SettingsError(
            f"the secrets in {folder} cannot be read ({reason}); each is a text that the user of this "
            "process may read"
        ) from None


def _line(location: tuple[int | str, ...], message: str) -> str:
    """Name the variable and its problem; a message about several variables names them itself."""
    said = message.removeprefix("Value error, ")
    place = ".".join(str(part) for part in location).upper()
    return f"{PREFIX}{place}: {said}" if place else said


def _refuse_misspelt(names: set[str]) -> None:
    known = {SECRETS_VARIABLE, *(PREFIX + name.upper() for name in names)}
    for variable in sorted(os.environ):
        if not variable.startswith(PREFIX) or variable in known:
            continue
        near = difflib.get_close_matches(variable, known, n=1, cutoff=0.93)
        if near:
            raise SettingsError(f"unknown variable {variable}; did you mean {near[0]}?")
