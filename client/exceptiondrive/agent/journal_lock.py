"""One run at a time on a journal: a lock that ends with its process, whatever ends it."""

import sys
from pathlib import Path
from typing import IO

from exceptiondrive.agent.errors import AgentError


class JournalLock:
    """Holds `<journal>.lock` until it is closed. The file stays: only the lock on it counts."""

    def __init__(self, journal: Path) -> None:
        """Take the lock.

        Raises:
            AgentError: Another run holds it.
            OSError: The lock file cannot be written.
        """
        self._file = journal.with_name(f"{journal.name}.lock").open("ab")
        try:
            _lock(self._file)
        except OSError:
            self._file.close()
            raise AgentError(
                f"{journal}: another `exceptiondrive remind` or `decide` is writing this journal; "
                "wait for it or stop it, or name another file"
            ) from None

    def close(self) -> None:
        """Give the lock up."""
        self._file.close()


if sys.platform == "win32":
    import msvcrt

    def _lock(file: IO[bytes]) -> None:
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(file: IO[bytes]) -> None:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
