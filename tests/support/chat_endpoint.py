"""A real HTTP server on the loopback that speaks the chat-completions protocol, by script."""

import base64
import json
import ssl
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, cast

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from exceptiondrive_schemas.python310 import UTC


@dataclass(frozen=True)
class Reply:
    """What the server sends; `announced_bytes` larger than the body cuts the connection midway.

    With `pause_s` the body comes byte by byte.
    """

    body: bytes
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)
    announced_bytes: int | None = None
    pause_s: float = 0.0


@dataclass(frozen=True)
class Seen:
    """One HTTP request as it came in: all of it."""

    head: bytes
    body: bytes

    @property
    def document(self) -> dict[str, Any]:
        return cast(dict[str, Any], json.loads(self.body))

    @property
    def path(self) -> str:
        return self.head.split(b" ", 2)[1].decode()

    @property
    def form(self) -> str:
        return str(self.document.get("response_format", {}).get("type", "words"))

    @property
    def parts(self) -> list[dict[str, Any]]:
        return cast(list[dict[str, Any]], self.document["messages"][1]["content"])

    @property
    def texts(self) -> list[str]:
        system = [self.document["messages"][0]["content"]]
        return system + [part["text"] for part in self.parts if part["type"] == "text"]

    @property
    def images(self) -> list[bytes]:
        urls = [part["image_url"]["url"] for part in self.parts if part["type"] == "image_url"]
        return [base64.b64decode(url.partition(";base64,")[2]) for url in urls]


class ChatEndpoint:
    """The server; set `answer` to script it, read `seen` for all that reached it.

    Args:
        port: Where it listens; by default at any free one.
    """

    def __init__(self, port: int = 0) -> None:
        self.seen: list[Seen] = []
        self.answer: Callable[[Seen], Reply] = lambda seen: self.says("{}")
        self.most_in_flight = 0
        self._scheme = "http"
        self._in_flight = 0
        self._lock = threading.Lock()
        self._server = ThreadingHTTPServer(("127.0.0.1", port), self._handler())
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()

    @property
    def base_url(self) -> str:
        return f"{self._scheme}://127.0.0.1:{self._server.server_address[1]}/v1"

    def speak_tls(self, folder: Path) -> None:
        """From now on under a certificate that nobody knows, kept in `folder`."""
        key, now = Ed25519PrivateKey.generate(), datetime.now(UTC)
        name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "localhost")])
        made = x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        made = made.not_valid_before(now).not_valid_after(now + timedelta(days=1))
        private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        (folder / "tls.pem").write_bytes(private + made.sign(key, None).public_bytes(Encoding.PEM))
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / "tls.pem")
        self._scheme = "https"
        self._server.socket = context.wrap_socket(
            self._server.socket, server_side=True, do_handshake_on_connect=False
        )

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    @staticmethod
    def says(text: str | None, **message: Any) -> Reply:
        """A chat completion with this text; `finish_reason` and `refusal` may be given."""
        choice = {
            "index": 0,
            "finish_reason": message.pop("finish_reason", "stop"),
            "message": {"role": "assistant", "content": text, **message},
        }
        body = {
            "id": "chatcmpl-1",
            "object": "chat.completion",
            "created": 1,
            "model": "tested-model-2025",
            "choices": [choice],
            "usage": {"prompt_tokens": 1000, "completion_tokens": 50, "total_tokens": 1050},
        }
        return Reply(json.dumps(body).encode())

    @staticmethod
    def fails(status: int, message: str = "no", **error: Any) -> Reply:
        """An error in OpenAI's form; `headers`, `param` and `code` may be given."""
        headers = error.pop("headers", {})
        body = {"error": {"message": message, "type": "error", **error}}
        return Reply(json.dumps(body).encode(), status, headers)

    @staticmethod
    def recorded(path: Path) -> Reply:
        return Reply(path.read_bytes())

    def reply(self, seen: Seen) -> Reply:
        with self._lock:
            self.seen.append(seen)
            self._in_flight += 1
            self.most_in_flight = max(self.most_in_flight, self._in_flight)
        try:
            return self.answer(seen)
        finally:
            with self._lock:
                self._in_flight -= 1

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        endpoint = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                length = int(self.headers["Content-Length"])
                body = self.rfile.read(length)
                if len(body) < length:
                    raise ConnectionError("the client was killed in mid-request")
                head = f"{self.requestline}\n{self.headers}".encode()
                reply = endpoint.reply(Seen(head, body))
                self.send_response(reply.status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(reply.announced_bytes or len(reply.body)))
                for name, value in reply.headers.items():
                    self.send_header(name, value)
                self.end_headers()
                if reply.pause_s:
                    for byte in reply.body:
                        self.wfile.write(bytes([byte]))
                        time.sleep(reply.pause_s)
                else:
                    self.wfile.write(reply.body)
                self.close_connection = reply.announced_bytes is not None

            def handle(self) -> None:
                try:
                    super().handle()
                except (ConnectionError, BrokenPipeError, ssl.SSLError):
                    self.close_connection = True  # the client has gone: killed, or timed out

            def log_message(self, *_: object) -> None:
                pass

        return Handler
