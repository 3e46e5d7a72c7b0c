"""Where the embedded default keeps what, under one folder."""

import fcntl
import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from exceptiondrive_server.launcher.broker import broker_url, is_short_enough
from exceptiondrive_server.launcher.errors import LaunchError


@dataclass(frozen=True)
class Layout:
    """The folders under DATA."""

    data: Path

    @property
    def logs(self) -> Path:
        """One log per process."""
        return self.data / "logs"

    @property
    def private(self) -> Path:
        """What only the worker may read."""
        return self.data / "private"

    @property
    def planners(self) -> Path:
        """Files of the synthetic planners."""
        return self.data / "sample" / "planners"

    def create(self) -> None:
        """Make the folders; those that others must not read are 0700."""
        try:
            self.data.mkdir(parents=True, exist_ok=True)
            self.logs.mkdir(exist_ok=True)
            (self.data / "uploads").mkdir(exist_ok=True, mode=0o700)
            self.private.mkdir(exist_ok=True, mode=0o700)
        except OSError as error:
            raise LaunchError(f"cannot use {self.data} as data folder: {error.strerror}") from None

    def environment(self, given: Mapping[str, str]) -> dict[str, str]:
        """Return the settings that follow from the layout; those given already go first."""
        data = self.data.resolve()
        defaults = {
            "EXCEPTIONDRIVE_DATABASE_URL": f"sqlite:///{data / 'records.sqlite3'}",
            "EXCEPTIONDRIVE_FILE_STORE_URL": (data / "uploads").as_uri(),
            "EXCEPTIONDRIVE_RECEIPT_KEY_FILE": str(data / "receipt-key.pem"),
        }
        return {key: given.get(key, value) for key, value in defaults.items()}


class DataLock:
    """Holds DATA for one launcher; released by the kernel, however the launcher ends."""

    def __init__(self, layout: Layout) -> None:
        self._path = layout.data / "launcher.lock"
        self._file: IO[str] | None = None

    def take(self) -> None:
        """Take the lock.

        Raises:
            LaunchError: Another launcher has it.
        """
        held = self._path.open("a+")
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            held.seek(0)
            owner = held.read().strip()
            held.close()
            by = f" (process {owner})" if owner else ""
            raise LaunchError(
                f"{self._path.parent} is in use by another `exceptiondrive-server run`{by}. "
                "Stop that one, or choose another folder with --data."
            ) from None
        held.truncate(0)
        held.write(str(os.getpid()))
        held.flush()
        self._file = held

    def release(self) -> None:
        """Give the folder back."""
        if self._file is not None:
            self._file.close()
            self._file = None


class BrokerFolder:
    """The 0700 folder of the private broker's socket: under DATA, or somewhere shorter."""

    def __init__(self, layout: Layout) -> None:
        wanted = layout.data.resolve() / "broker"
        self._is_temporary = not is_short_enough(wanted)
        self.path = Path(tempfile.mkdtemp(prefix="ed-")) if self._is_temporary else wanted
        self.path.mkdir(exist_ok=True)
        self.path.chmod(0o700)
        self.url = broker_url(self.path)

    def remove(self) -> None:
        """Remove a temporary folder."""
        if self._is_temporary:
            shutil.rmtree(self.path, ignore_errors=True)
