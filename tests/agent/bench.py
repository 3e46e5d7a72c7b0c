"""What the agent is run on: scenes, pictures and an endpoint."""

import json
import struct
import zlib
from pathlib import Path
from typing import Any, cast

from tests.support.chat_endpoint import ChatEndpoint, Seen
from typer.testing import CliRunner, Result

from exceptiondrive.cli import app

KEY = "key-of-the-tests-0123456789"


def made_png(shade: int, text: bytes = b"") -> bytes:
    """One grey pixel; `text` goes into a tEXt chunk."""

    def chunk(name: bytes, data: bytes) -> bytes:
        body = name + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 1, 1, 16, 0, 0, 0, 0))
    pixels = chunk(b"IDAT", zlib.compress(b"\x00" + shade.to_bytes(2, "big")))
    note = chunk(b"tEXt", b"Comment\x00" + text) if text else b""
    return b"\x89PNG\r\n\x1a\n" + header + note + pixels + chunk(b"IEND", b"")


def made_jpeg(pixels: bytes, text: bytes = b"") -> bytes:
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
            (self.images / sample_id / "front.png").write_bytes(made_png(number))
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
