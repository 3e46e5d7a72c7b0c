"""An upload that stays under way until the test lets it go on."""

import json
import socket
from typing import Any
from urllib.parse import urlsplit

import httpx
from tests.chaos.topology import PHASE, Topology

_CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"


class HeldUpload:
    """An upload of which the last bytes are kept back; the server has begun to read it."""

    def __init__(self, topology: Topology, data: bytes, method: str, team: str = "alpha") -> None:
        request = httpx.Request(
            "POST",
            f"{topology.url}/api/v1/submissions",
            data={"phase": PHASE, "method": method},
            files={"file": ("f.json", data)},
            headers={
                "Authorization": f"Bearer {topology.tokens[team]}",
                "Connection": "close",
                "Expect": "100-continue",
            },
        )
        body = request.read()
        head = "".join(f"{name}: {value}\r\n" for name, value in request.headers.items())
        address = urlsplit(topology.url)
        self._rest = body[-100:]
        self._socket = socket.create_connection((address.hostname, address.port), timeout=60)
        self._socket.sendall(f"POST /api/v1/submissions HTTP/1.1\r\n{head}\r\n".encode())
        said = self._socket.recv(len(_CONTINUE), socket.MSG_WAITALL)
        assert said == _CONTINUE, said
        self._socket.sendall(body[:-100])

    def finish(self) -> tuple[int, dict[str, Any]]:
        """Send the rest; return status and document of the answer."""
        self._socket.sendall(self._rest)
        answer = b"".join(iter(lambda: self._socket.recv(65536), b""))
        self._socket.close()
        head, _, body = answer.partition(b"\r\n\r\n")
        return int(head.split()[1]), json.loads(body)
