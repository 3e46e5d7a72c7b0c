"""Looks for the canary in everything that a test run lets out of the worker."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.canary.values import PATTERN, REACH_BYTES

WITHHELD_FOLDERS = {"splits", "private", "hidden_splits"}
"""What workers alone may read; the canary belongs there."""
AT_ONCE = 1024 * 1024


@dataclass
class Watch:
    """What was looked at, by channel, and where the canary was found."""

    looked_at: dict[str, int] = field(default_factory=dict)
    found: list[str] = field(default_factory=list)
    is_paused: bool = False
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def look(self, channel: str, data: bytes | str, where: str = "") -> bool:
        """Search one piece; return whether the canary is in it."""
        if isinstance(data, str):
            data = data.encode("utf-8", "surrogatepass")
        hit = PATTERN.search(data)
        with self._lock:
            self.looked_at[channel] = self.looked_at.get(channel, 0) + 1
            if hit and not self.is_paused:
                around = data[max(0, hit.start() - 40) : hit.end() + 20]
                test = os.environ.get("PYTEST_CURRENT_TEST", "between tests")
                self.found.append(f"{channel} {where}: {around!r} during {test}")
        return hit is not None

    def look_in_file(self, path: Path) -> bool:
        """Search a file, piece by piece."""
        kept, is_found = b"", False
        try:
            with path.open("rb") as file:
                while piece := file.read(AT_ONCE):
                    is_found |= self.look("file", kept + piece, str(path))
                    kept = piece[-REACH_BYTES:]
        except OSError:  # gone meanwhile, or a socket
            pass
        return is_found

    def look_in_folder(self, folder: Path) -> None:
        """Search all files of a folder but those that only workers read, and tests' own inputs."""
        for path in files_outside_workers(folder):
            self.look_in_file(path)

    @contextmanager
    def planted(self) -> Iterator[list[str]]:
        """What is found within is a test's own plant, and does not fail the run."""
        kept, self.found = self.found, []
        try:
            yield self.found
        finally:
            self.found = kept


def files_outside_workers(folder: Path) -> Iterator[Path]:
    """All files below a folder but those that only workers read, and tests' own inputs."""
    for root, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name not in WITHHELD_FOLDERS]
        for name in names:
            if not (name.endswith((".json", ".json.gz")) and "split" in name):
                yield Path(root) / name


WATCH = Watch()


def watched_asgi(call: Callable[..., Any], watch: Watch = WATCH) -> Callable[..., Any]:
    """Wrap an ASGI application's `__call__` so that every answer is looked at, headers and body."""

    async def called(self: Any, scope: Any, receive: Any, send: Any) -> None:
        kept = b""

        async def send_watched(message: Any) -> None:
            nonlocal kept
            where = str(scope.get("path", ""))
            if message["type"] == "http.response.start":
                head = b"\n".join(b": ".join(pair) for pair in message.get("headers", ()))
                watch.look("response", head, where)
            elif message["type"] == "http.response.body":
                body = kept + message.get("body", b"")
                kept = b"" if watch.look("response", body, where) else body[-REACH_BYTES:]
            await send(message)

        await call(self, scope, receive, send_watched)

    return called


def watched_client(send: Callable[..., Any], watch: Watch = WATCH) -> Callable[..., Any]:
    """Wrap `httpx.Client.send`: answers of servers in other processes are looked at, too."""

    def sent(self: Any, request: Any, **keywords: Any) -> Any:
        response = send(self, request, **keywords)
        if response.is_stream_consumed:
            watch.look("response", response.content, str(request.url))
        return response

    return sent


def watched_log(capture: Callable[..., Any], watch: Watch = WATCH) -> Callable[..., Any]:
    """Wrap `structlog.testing.LogCapture.__call__`: lines that a test keeps from the terminal."""

    def captured(self: Any, logger: Any, method: str, event: Any) -> Any:
        watch.look("log", repr(event))
        return capture(self, logger, method, event)

    return captured


class BrokerWatch:
    """Looks at every command that a broker is sent, in a thread, until the broker ends."""

    def __init__(self, connect: Callable[[], Any], watch: Watch = WATCH) -> None:
        self._socket = connect()
        self._watch = watch
        self._socket.sendall(b"MONITOR\r\n")
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        kept = b""
        try:
            while data := self._socket.recv(65_536):
                is_found = self._watch.look("broker", kept + data)
                kept = b"" if is_found else data[-REACH_BYTES:]
        except OSError:
            pass
        finally:
            self._socket.close()

    def stop(self) -> None:
        """Wait for the end: call it when the broker is gone."""
        self._thread.join(timeout=5)


def look_in_postgres(connection: Any, watch: Watch = WATCH) -> None:
    """Search all rows of all tables of a database, as the server's role could read them."""
    query = "SELECT tablename FROM pg_tables WHERE schemaname = 'public'"
    tables = [table for (table,) in connection.execute(query).fetchall()]
    rows = " UNION ALL ".join(f"SELECT '{table}', t::text FROM \"{table}\" t" for table in tables)
    for table, row in connection.execute(rows).fetchall() if tables else []:
        watch.look("database", row, table)
