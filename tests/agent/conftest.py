"""A real HTTP server on the loopback that speaks the chat-completions protocol, and made images."""

import base64
import json
import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, cast

import pytest
from typer.testing import CliRunner, Result

from exceptiondrive_agent.__main__ import app

RECORDED = Path(__file__).parent / "recorded"
KEY = "key-of-the-tests-0123456789"


@dataclass(frozen=True)
class Reply:
    """What the server sends; `announced_bytes` larger than the body cuts the connection midway."""

    body: bytes
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)
    announced_bytes: int | None = None


@dataclass(frozen=True)
class Seen:
    """One HTTP request as it came in: all of it."""

    head: bytes
    body: bytes

    @property
    def document(self) -> dict[str, Any]:
        return cast(dict[str, Any], json.loads(self.body))

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
    """The server; set `answer` to script it, read `seen` for all that reached it."""

    def __init__(self) -> None:
        self.seen: list[Seen] = []
        self.answer: Callable[[Seen], Reply] = lambda seen: self.says("{}")
        self.most_in_flight = 0
        self._in_flight = 0
        self._lock = threading.Lock()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()

    @property
    def base_url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_address[1]}/v1"

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
    def recorded(name: str) -> Reply:
        return Reply((RECORDED / name).read_bytes())

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
                body = self.rfile.read(int(self.headers["Content-Length"]))
                head = f"{self.requestline}\n{self.headers}".encode()
                reply = endpoint.reply(Seen(head, body))
                self.send_response(reply.status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(reply.announced_bytes or len(reply.body)))
                for name, value in reply.headers.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(reply.body)
                self.close_connection = reply.announced_bytes is not None

            def handle(self) -> None:
                try:
                    super().handle()
                except (ConnectionError, BrokenPipeError):
                    self.close_connection = True  # the client has gone: killed, or timed out

            def log_message(self, *_: object) -> None:
                pass

        return Handler


def _png(shade: int, text: bytes = b"") -> bytes:
    """One grey pixel; `text` goes into a tEXt chunk."""

    def chunk(name: bytes, data: bytes) -> bytes:
        body = name + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 16, 0, 0, 0, 0))
    pixels = chunk(b"IDAT", zlib.compress(b"\x00" + shade.to_bytes(2, "big")))
    note = chunk(b"tEXt", b"Comment\x00" + text) if text else b""
    return b"\x89PNG\r\n\x1a\n" + header + note + pixels + chunk(b"IEND", b"")


def _jpeg(pixels: bytes, text: bytes = b"") -> bytes:
    """The segments of a JPEG; `text` goes into Exif, a comment and behind the end."""

    def segment(marker: int, data: bytes) -> bytes:
        return bytes((0xFF, marker)) + struct.pack(">H", len(data) + 2) + data

    notes = segment(0xE1, b"Exif\x00\x00" + text) + segment(0xFE, text) if text else b""
    return b"".join(
        (
            b"\xff\xd8",
            segment(0xE0, b"JFIF\x00\x01\x01\x00\x00\x01\x00\x01\x00\x00"),
            notes,
            segment(0xDB, bytes(65)),
            segment(0xC0, bytes((8, 0, 1, 0, 1, 1, 1, 0x11, 0))),
            segment(0xDA, bytes((1, 1, 0, 0, 63, 0))),
            pixels,
            b"\xff\xd9",
            text,
        )
    )


class Bench:
    """A folder to work in: images, a manifest, and the command line."""

    def __init__(self, folder: Path, endpoint: ChatEndpoint) -> None:
        self.folder = folder
        self.endpoint = endpoint
        self.images = folder / "images"
        self.manifest = folder / "manifest.json"
        self.reminders = folder / "reminders.jsonl"
        self.out = folder / "strategy.json"

    def add_samples(self, count: int) -> list[str]:
        """Write `count` samples of one image each; the shade of the image is its number."""
        sample_ids = [f"sample-{number:03d}" for number in range(count)]
        for number, sample_id in enumerate(sample_ids):
            (self.images / sample_id).mkdir(parents=True)
            (self.images / sample_id / "front.png").write_bytes(_png(number))
        self.write_manifest(sample_ids)
        return sample_ids

    def write_manifest(self, sample_ids: list[str]) -> None:
        document = {
            "schema": "exceptiondrive.manifest/1",
            "name": "sample-strategy",
            "title": "Made for the tests",
            "revision": "sha256:" + "0" * 64,
            "waypoints": 6,
            "time_step_s": 0.5,
            "sample_ids": sample_ids,
        }
        self.manifest.write_text(json.dumps(document), encoding="utf-8")

    def arguments(self, command: str, *more: str) -> list[str]:
        common = ["--base-url", self.endpoint.base_url, "--model", "tested-model"]
        if command == "remind":
            files = ["--out", str(self.reminders)]
        else:
            files = ["--out", str(self.out), "--manifest", str(self.manifest)]
        return [command, str(self.images), *files, *common, *more]

    def run(self, command: str, *more: str) -> Result:
        return invoke(self.arguments(command, *more))

    def report(self, command: str, *more: str, exit_code: int = 0) -> dict[str, Any]:
        result = self.run(command, "--json", *more)
        assert result.exit_code == exit_code, result.output
        return cast(dict[str, Any], json.loads(result.stdout))

    def journal(self, path: Path | None = None) -> dict[str, dict[str, Any]]:
        """The last line of every sample in a journal, by default the reminders."""
        lines = (path or self.reminders).read_text(encoding="utf-8").splitlines()[1:]
        documents = [json.loads(line) for line in lines]
        return {document["sample_id"]: document for document in documents}

    def submission(self) -> dict[str, Any]:
        return cast(dict[str, Any], json.loads(self.out.read_text(encoding="utf-8")))


def invoke(arguments: list[str]) -> Result:
    """Run the two commands as the main program does."""
    return CliRunner().invoke(app, arguments)


def shade_of(seen: Seen) -> int:
    """Which sample a request is about: its number is the shade of its only pixel."""
    image = seen.images[0]
    start = image.index(b"IDAT") + 4
    return int.from_bytes(zlib.decompress(image[start:-16])[1:3], "big")


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The key of the tests, and no proxy between us and the loopback."""
    for name in ("OPENAI_API_KEY", "OPENAI_BASE_URL", "OPENAI_ORG_ID", "OPENAI_PROJECT_ID"):
        monkeypatch.delenv(name, raising=False)
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    monkeypatch.setenv("EXCEPTIONDRIVE_AGENT_KEY", KEY)


@pytest.fixture
def endpoint() -> Iterator[ChatEndpoint]:
    server = ChatEndpoint()
    yield server
    server.close()


@pytest.fixture
def bench(tmp_path: Path, endpoint: ChatEndpoint) -> Bench:
    return Bench(tmp_path, endpoint)


@pytest.fixture
def png() -> Callable[..., bytes]:
    return _png


@pytest.fixture
def jpeg() -> Callable[..., bytes]:
    return _jpeg


@pytest.fixture
def shade() -> Callable[[Seen], int]:
    return shade_of


@pytest.fixture
def run_command() -> Callable[[list[str]], Result]:
    return invoke


@pytest.fixture
def record() -> dict[str, Any]:
    """A reminder record as a model would write it."""
    return {
        "hazard_present": True,
        "hazard_type": "LB1",
        "relative_location": "ahead, about 15 m, in the ego lane",
        "risk_level": "high",
        "evidence": "a truck with warning lights stands across the lane",
        "safety_constraint": "stop before the truck",
        "recommended_strategy": "C",
    }
