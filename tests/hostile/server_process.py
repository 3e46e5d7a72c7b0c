"""A real server process, and raw connections to it: what no HTTP client would ever send."""

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

PROGRAM = """
import json, sys, uvicorn
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.limits import body_limit
from exceptiondrive_server.web.settings import ServerSettings
given = json.loads(sys.argv[1])
vars(body_limit).update(given["limits"])
uvicorn.run(create_app(ServerSettings(**given["settings"])), fd=given["fd"], http="httptools",
    ws="none", log_config=None, access_log=False, server_header=False)
"""
MEBIBYTE = 1024 * 1024


@dataclass
class ServerProcess:
    """A running server; `log` is all that it printed."""

    port: int
    pid: int
    log: Path

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=30)

    def exchange(self, request: bytes) -> bytes:
        """Send this, then read until the server closes."""
        with self.connect() as connection:
            connection.sendall(request)
            return read_all(connection)

    def health(self) -> bytes:
        return self.exchange(b"GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")

    @property
    def peak_bytes(self) -> int:
        """The most memory that the process ever had in use."""
        status = Path(f"/proc/{self.pid}/status").read_text()
        line = next(line for line in status.splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1024


def read_all(connection: socket.socket) -> bytes:
    """Read until the server closes, also when it does so at once."""
    parts = []
    try:
        while part := connection.recv(65_536):
            parts.append(part)
    except ConnectionResetError:
        pass
    return b"".join(parts)


@contextmanager
def running_server(
    folder: Path, settings: dict[str, object], limits: dict[str, float]
) -> Iterator[ServerProcess]:
    """Run a server with these settings and these limits (of `web.limits.body_limit`)."""
    log = folder / "server.log"
    with closing(socket.create_server(("127.0.0.1", 0), backlog=512)) as listener:
        given = {"settings": settings, "limits": limits, "fd": listener.fileno()}
        with log.open("wb") as stream:
            process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM, json.dumps(given)],
                pass_fds=[listener.fileno()],
                stdout=stream,
                stderr=stream,
            )
        server = ServerProcess(listener.getsockname()[1], process.pid, log)
    try:
        _wait_until_alive(server)
        yield server
    finally:
        process.kill()
        process.wait()


def _wait_until_alive(server: ServerProcess) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            if server.health().startswith(b"HTTP/1.1 200"):
                return
        except OSError:
            time.sleep(0.05)
    raise RuntimeError(f"the server did not start:\n{server.log.read_text()}")
