"""The append-only journal: a JSON line for each question asked, under a header.

A line is written by one write call and synced before the next question starts, so a killed run
loses at most the answers in flight. A torn last line is skipped and its question asked again. One
run at a time writes a journal: its lock ends with the process, whatever ends it.
"""

import os
import sys
from pathlib import Path
from typing import IO, Generic, TypeVar

from pydantic import ValidationError

from exceptiondrive_endpoints.errors import JournalError
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.python310 import Self

Header = TypeVar("Header", bound=Document)
Line = TypeVar("Line", bound=Document)

if sys.platform == "win32":
    import msvcrt

    def _lock(file: IO[bytes]) -> None:
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(file: IO[bytes]) -> None:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)


def _hold_lock(journal: Path) -> IO[bytes]:
    """Hold `<journal>.lock` until it is closed. The file stays: only the lock on it counts."""
    file = journal.with_name(f"{journal.name}.lock").open("ab")
    try:
        _lock(file)
    except OSError:
        file.close()
        raise JournalError(
            f"{journal}: another run is writing this journal; wait for it or stop it"
        ) from None
    return file


def read_journal(
    path: Path, header: type[Header], line: type[Line]
) -> tuple[Header, tuple[Line, ...]]:
    """Return the header and the readable lines of a journal; those torn by a kill are passed over.

    Raises:
        JournalError: There is no such file, or it is no such journal.
    """
    try:
        first, *rest = path.read_bytes().split(b"\n")
    except OSError as error:
        raise JournalError(f"{path}: {error.strerror}") from None
    try:
        found = header.model_validate_json(first)
    except ValidationError:
        raise JournalError(f"{path}: not a journal of this kind") from None
    lines = (_line_or_none(text, line) for text in rest if text.strip())
    return found, tuple(each for each in lines if each is not None)


def _line_or_none(text: bytes, line: type[Line]) -> Line | None:
    try:
        return line.model_validate_json(text)
    except ValidationError:
        return None


class Journal(Generic[Header, Line]):
    """An open journal; use it as a context manager.

    Attributes:
        header: Its first line.
        lines: All others so far.
    """

    def __init__(self, path: Path, header: Header, line: type[Line]) -> None:
        """Open the journal, or create it under this header.

        Raises:
            JournalError: The file is no such journal, in use by another run, or cannot be written.
        """
        self.header = header
        self.lines: list[Line] = []
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = _hold_lock(path)
        except OSError as error:
            raise JournalError(f"{path}: {error.strerror}") from None
        try:
            self._open(path, line)
        except BaseException as error:
            self._lock.close()
            if isinstance(error, OSError):
                raise JournalError(f"{path}: {error.strerror}") from None
            raise

    def _open(self, path: Path, line: type[Line]) -> None:
        is_new = not path.exists() or path.stat().st_size == 0
        if not is_new:
            self.header, lines = read_journal(path, type(self.header), line)
            self.lines = list(lines)
        self._path = path
        self._file = path.open("ab", buffering=0)
        if is_new:
            self._write(self.header)
        elif not path.read_bytes().endswith(b"\n"):
            self._file.write(b"\n")

    def append(self, line: Line) -> None:
        """Write one line and wait until it is on the disk.

        Raises:
            JournalError: It cannot be written.
        """
        self._write(line)
        self.lines.append(line)

    def _write(self, document: Document) -> None:
        text = document.model_dump_json(by_alias=True, exclude_none=True)
        try:
            self._file.write(text.encode("utf-8") + b"\n")
            os.fsync(self._file.fileno())
        except OSError as error:
            advice = "What was written before is kept; make room and run the same command again."
            raise JournalError(f"{self._path}: {error.strerror}", advice) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._lock.close()
