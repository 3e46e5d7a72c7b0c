"""The real nginx on the very file of production; only addresses, ports and paths are its own.

Docker's name server is played by a small one that tells which addresses `server` has at the moment.
"""

import os
import shutil
import signal
import socket
import ssl
import struct
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import httpx
import pytest
from tests.chaos.users import as_user
from tests.support.processes import free_port

from exceptiondrive_server.operations.bare_install import (
    older_http2,
    replaced,
    speaks_http2_by_itself,
)
from exceptiondrive_server.operations.secrets import self_signed

CONF = Path(__file__).parents[2] / "deploy/nginx.conf"
_PLACES = f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin"
_QUESTION = b"\x06server\x00" + struct.pack("!HH", 1, 1)


def find_nginx() -> str:
    """Return where nginx is, once it has told its version; skip the test where it is not."""
    found = shutil.which("nginx", path=_PLACES)
    if found is None:
        pytest.skip("no nginx: as root, apt-get install nginx")
    _knows_http2(found)
    return found


@cache
def _knows_http2(nginx: str) -> bool:
    """Ask once, while no server of a test runs: `nginx -v` was seen to hang beside them, twice."""
    return speaks_http2_by_itself(Path(nginx))


class Names:
    """A name server that knows one name; like Docker's it lets answers be kept for ten minutes."""

    def __init__(self, *addresses: str) -> None:
        self.addresses = list(addresses)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._socket.sendto(b"", ("127.0.0.1", self.port))
        self._thread.join()
        self._socket.close()

    def _serve(self) -> None:
        while True:
            asked, sender = self._socket.recvfrom(512)
            if not asked:
                return
            self._socket.sendto(self._answer(asked), sender)

    def _answer(self, asked: bytes) -> bytes:
        found = [*self.addresses] if asked[12:] == _QUESTION else []
        flags = 0x8180 if found else 0x8183
        head = asked[:2] + struct.pack("!HHHHH", flags, 1, len(found), 0, 0)
        records = (
            struct.pack("!HHHIH", 0xC00C, 1, 1, 600, 4) + socket.inet_aton(address)
            for address in found
        )
        return head + asked[12:] + b"".join(records)


class Nginx:
    """One nginx before servers at one port of the addresses that `names` tells."""

    def __init__(
        self,
        names: Names,
        server_port: int,
        *,
        port: int | None = None,
        user: int | None = None,
        more: Mapping[str, str] | None = None,
    ) -> None:
        self.binary = find_nginx()
        self.folder = Path(tempfile.mkdtemp(prefix="ed-nginx-"))
        self.folder.chmod(0o755)
        self.port, self.plain_port = port or free_port(), free_port()
        self.url = f"https://127.0.0.1:{self.port}"
        self.certificate = self.folder / "tls.crt"
        self._user = user
        self.renew_certificate()
        changes = {**self._changes(names.port, server_port), **(more or {})}
        text = replaced(CONF.read_text("utf-8"), changes)
        (self.folder / "nginx.conf").write_text(
            text if _knows_http2(self.binary) else older_http2(text)
        )
        if user is not None:
            for path in (self.folder, *self.folder.iterdir()):
                os.chown(path, user, user)
        self._log = (self.folder / "nginx.log").open("wb")
        self._process = subprocess.Popen(
            self._command("-g", "daemon off;"), stdout=self._log, stderr=self._log
        )
        self._wait()

    def browser(self, source: str = "127.0.0.1") -> httpx.Client:
        """Return a client that connects from an address of this machine."""
        trust = ssl.create_default_context(cafile=str(self.certificate))
        transport = httpx.HTTPTransport(verify=trust, local_address=source)
        return httpx.Client(base_url=self.url, transport=transport, timeout=30)

    def renew_certificate(self) -> None:
        """Write a certificate of its own into the files, in place, as the runbook says."""
        certificate, key = self_signed("127.0.0.1")
        self.certificate.write_bytes(certificate)
        (self.folder / "tls.key").write_bytes(key)

    def reload(self) -> None:
        """What `nginx -s reload` says to the running one."""
        subprocess.run(self._command("-s", "reload"), check=True, capture_output=True)

    @property
    def log(self) -> str:
        return (self.folder / "nginx.log").read_text("utf-8", "replace")

    def close(self) -> None:
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(20)
        self._log.close()
        shutil.rmtree(self.folder)

    def _command(self, *more: str) -> list[str]:
        conf = str(self.folder / "nginx.conf")
        command = [self.binary, "-p", str(self.folder), "-e", "stderr", "-c", conf, *more]
        return command if self._user is None else as_user(self._user, self._user, command)

    def _changes(self, names_port: int, server_port: int) -> dict[str, str]:
        temporary = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
        return {
            "pid /run/nginx.pid;": f"pid {self.folder}/nginx.pid;",
            **{
                f"{name}_temp_path /tmp/{name};": f"{name}_temp_path {self.folder}/{name};"
                for name in temporary
            },
            "proxy_cache_path /tmp/cache ": f"proxy_cache_path {self.folder}/cache ",
            "resolver 127.0.0.11 ": f"resolver 127.0.0.1:{names_port} ",
            "set $application server:8000;": f"set $application server:{server_port};",
            "listen 8080;": f"listen 127.0.0.1:{self.plain_port};",
            "listen 8443 ssl;": f"listen 127.0.0.1:{self.port} ssl;",
            "/run/secrets/tls_certificate;": f"{self.folder}/tls.crt;",
            "/run/secrets/tls_key;": f"{self.folder}/tls.key;",
        }

    def _wait(self) -> None:
        deadline = time.monotonic() + 20
        while True:
            try:
                httpx.get(f"http://127.0.0.1:{self.plain_port}/proxy-health").raise_for_status()
                return
            except httpx.TransportError:
                if self._process.poll() is not None or time.monotonic() > deadline:
                    raise RuntimeError(f"nginx did not start: {self.log}") from None
                time.sleep(0.02)
