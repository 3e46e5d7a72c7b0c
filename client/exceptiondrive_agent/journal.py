"""The append-only journal: a JSON line for each asked sample, under a header with the settings.

A line is written by one write call and synced before the next sample starts, so a killed run loses
at most the answers in flight. A torn last line is skipped and its sample asked again. One run at a
time writes a journal: its lock ends with the process, whatever ends it.
"""

import os
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Annotated, Literal, Self

from pydantic import Field, ValidationError

from exceptiondrive_agent.errors import AgentError, Reason
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.submission_files import ReminderRecord, SampleId
from exceptiondrive_schemas.taxonomy import Strategy

MAX_RAW_CHARACTERS = 2000


if sys.platform == "win32":
    import msvcrt

    def _lock(file: IO[bytes]) -> None:
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(file: IO[bytes]) -> None:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)


def _locked(journal: Path) -> IO[bytes]:
    """Hold `<journal>.lock` until it is closed. The file stays: only the lock on it counts."""
    file = journal.with_name(f"{journal.name}.lock").open("ab")
    try:
        _lock(file)
    except OSError:
        file.close()
        raise AgentError(
            f"{journal}: another `exceptiondrive remind` or `decide` is writing this journal; "
            "wait for it or stop it, or name another file"
        ) from None
    return file


class JournalHeader(Document):
    """First line: what was asked of which model. Lines of other settings never mix with these."""

    schema_: Literal["exceptiondrive_agent-journal/1"] = Field(
        default="exceptiondrive_agent-journal/1", alias="schema"
    )
    question: Literal["remind", "decide"]
    model: str
    settings_digest: str


class JournalLine(Document):
    """One asked sample: an answer, or the reason why there is none and the raw text, truncated."""

    sample_id: SampleId
    asked_at: str = Field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    reason: Reason | None = None
    detail: str | None = None
    raw: Annotated[str, Field(max_length=MAX_RAW_CHARACTERS)] | None = None
    reminder: ReminderRecord | None = None
    strategy: Strategy | None = None
    given_reminder_digest: str | None = Field(
        default=None, description="digest of the reminder in the request"
    )
    model: str | None = None
    form: str | None = None
    prompt_tokens: int | None = None
    completion_tokens: int | None = None

    @property
    def is_done(self) -> bool:
        """Whether the sample has an answer."""
        return self.reason is None


def latest(lines: Iterable[JournalLine]) -> dict[str, JournalLine]:
    """The last line of every sample."""
    return {line.sample_id: line for line in lines}


def read_journal(path: Path) -> tuple[JournalHeader, tuple[JournalLine, ...]]:
    """Return the header and the readable lines of a journal.

    Raises:
        AgentError: There is no such file, or it is no journal.
    """
    try:
        header, *rest = path.read_bytes().split(b"\n")
    except OSError as error:
        raise AgentError(f"{path}: {error.strerror}") from None
    try:
        parsed = JournalHeader.model_validate_json(header)
    except ValidationError:
        raise AgentError(f"{path}: not a journal of `exceptiondrive remind` or `decide`") from None
    lines = (_line_or_none(line) for line in rest if line.strip())
    return parsed, tuple(line for line in lines if line is not None)


def _line_or_none(line: bytes) -> JournalLine | None:
    try:
        return JournalLine.model_validate_json(line)
    except ValidationError:
        return None  # torn by a kill: as good as not asked


class Journal:
    """An open journal; use it as a context manager."""

    def __init__(self, path: Path, header: JournalHeader) -> None:
        """Open or create the journal.

        Raises:
            AgentError: The file is no journal, one of other settings, in use by another run, or
                cannot be written.
        """
        self.lines: list[JournalLine] = []
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(path)
        except OSError as error:
            raise AgentError(f"{path}: {error.strerror}") from None
        try:
            self._open(path, header)
        except BaseException as error:
            self._lock.close()
            if isinstance(error, OSError):
                raise AgentError(f"{path}: {error.strerror}") from None
            raise

    def _open(self, path: Path, header: JournalHeader) -> None:
        is_new = not path.exists() or path.stat().st_size == 0
        if not is_new:
            self.lines = _lines_of_same_settings(path, header)
        self._file = path.open("ab", buffering=0)
        if is_new:
            self._write(header)
        elif not path.read_bytes().endswith(b"\n"):
            self._file.write(b"\n")

    def append(self, line: JournalLine) -> None:
        """Write one line and wait until it is on the disk."""
        self._write(line)
        self.lines.append(line)

    def _write(self, document: Document) -> None:
        text = document.model_dump_json(by_alias=True, exclude_none=True)
        self._file.write(text.encode("utf-8") + b"\n")
        os.fsync(self._file.fileno())

    def __enter__(self) -> Self:
        """Return the journal."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file and give the lock up."""
        self._file.close()
        self._lock.close()


def _lines_of_same_settings(path: Path, header: JournalHeader) -> list[JournalLine]:
    found, lines = read_journal(path)
    if found != header:
        raise AgentError(
            f"{path}: made by `{found.question}` with model {found.model!r} and other settings "
            "(model, prompt, protocol, views or sampling); name another file"
        )
    return list(lines)
