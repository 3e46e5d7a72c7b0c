"""`exceptiondrive data` against real HTTP servers, honest, broken and hostile ones."""

import hashlib
import json
import os
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from pydantic import ValidationError
from tests.client.servers import run

from exceptiondrive.data import download_file, read_data_manifest
from exceptiondrive.errors import InvalidArgumentError, NetworkError
from exceptiondrive.transport import is_here, require_private_link
from exceptiondrive_schemas.api.data_manifest import DataFile, DataManifest

if TYPE_CHECKING:
    from tests.client.servers import Running

CONTENT = bytes(range(256)) * 2000
HOSTILE_NAMES = (
    "../escaped", "a/../../escaped", "/etc/passwd", "..", ".", "", ".bashrc", "a/.ssh/keys", "a//b",
    "C:\\escaped", "a\\..\\b", "a\x00b", "a\nb", "a b", "~/escaped", "a/", "file.part", "x" * 201,
    "a\u202eb", "-rf",
)  # fmt: skip


class DataServer:
    """Files on this machine; knows ranges, and breaks off where a test says so."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.asked: list[tuple[str, dict[str, str]]] = []
        self.breaks_after: list[int] = []
        """Bytes after which the next answers end."""
        self.knows_ranges = True
        self.redirects: dict[str, str] = {}
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                outer.asked.append((self.path, {k.lower(): v for k, v in self.headers.items()}))
                if self.path in outer.redirects:
                    self.send_response(302)
                    self.send_header("Location", outer.redirects[self.path])
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                content, start = outer.files.get(self.path), 0
                if content is None:
                    self.send_error(404)
                    return
                given = self.headers.get("Range")
                if given and outer.knows_ranges:
                    start = int(given.removeprefix("bytes=").removesuffix("-"))
                self.send_response(206 if start else 200)
                if start:
                    self.send_header(
                        "Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}"
                    )
                self.send_header("Content-Length", str(len(content) - start))
                self.end_headers()
                body = content[start:]
                if outer.breaks_after:
                    body = body[: outer.breaks_after.pop(0)]
                    self.close_connection = True
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.02,), daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def offer(self, *names: str, **changes: Any) -> str:
        """Put files and their list there; return the address of the list."""
        rows = []
        for name in names:
            self.files[f"/{name}"] = CONTENT
            digest = hashlib.sha256(CONTENT).hexdigest()
            rows.append(
                {"name": name, "url": name, "bytes": len(CONTENT), "sha256": digest, **changes}
            )
        manifest = {"schema": "exceptiondrive.data/1", "licence": "CC0", "files": rows}
        self.files["/manifest.json"] = json.dumps(manifest).encode()
        return f"{self.url}/manifest.json"

    def ranges(self, path: str) -> list[str | None]:
        return [headers.get("range") for asked, headers in self.asked if asked == path]


@pytest.fixture
def server() -> Iterator[DataServer]:
    made = DataServer()
    yield made
    made.close()


def file_of(server: DataServer, *names: str, **changes: Any) -> DataFile:
    return read_data_manifest(server.offer(*(names or ("a.bin",)), **changes)).files[0]


def test_a_file_comes_whole_and_is_not_fetched_twice(server: DataServer, tmp_path: Path) -> None:
    file = file_of(server, "sub/folder/a.bin")
    told: list[tuple[int, int]] = []
    path = download_file(file, tmp_path, lambda *seen: told.append(seen))
    assert path == tmp_path.resolve() / "sub/folder/a.bin"
    assert path.read_bytes() == CONTENT
    assert told[-1] == (len(CONTENT), len(CONTENT))
    n_asked = len(server.asked)
    assert download_file(file, tmp_path) == path
    assert len(server.asked) == n_asked
    assert [each.name for each in path.parent.iterdir()] == ["a.bin"]


def test_a_download_that_broke_off_goes_on_where_it_stopped(
    server: DataServer, tmp_path: Path
) -> None:
    file = file_of(server)
    server.breaks_after = [100_000, 50_000]
    assert download_file(file, tmp_path).read_bytes() == CONTENT
    assert server.ranges("/a.bin") == [None, "bytes=100000-", "bytes=150000-"]


def test_what_broke_off_for_good_goes_on_in_the_next_run(
    server: DataServer, tmp_path: Path
) -> None:
    file = file_of(server)
    server.breaks_after = [1000] * 5
    with pytest.raises(NetworkError):
        download_file(file, tmp_path)
    assert (tmp_path / "a.bin.part").stat().st_size == 5000
    assert not (tmp_path / "a.bin").exists()
    assert download_file(file, tmp_path).read_bytes() == CONTENT
    assert server.ranges("/a.bin")[-1] == "bytes=5000-"


def test_a_server_without_ranges_is_asked_for_all_again(server: DataServer, tmp_path: Path) -> None:
    file = file_of(server)
    server.knows_ranges, server.breaks_after = False, [100_000]
    assert download_file(file, tmp_path).read_bytes() == CONTENT


@pytest.mark.parametrize("wrong", [{"sha256": "0" * 64}, {"bytes": 1000}])
def test_what_is_not_as_the_list_says_is_deleted(
    server: DataServer, tmp_path: Path, wrong: dict[str, Any]
) -> None:
    with pytest.raises(InvalidArgumentError, match="not what the list says"):
        download_file(file_of(server, **wrong), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_part_that_was_tampered_with_is_found_out(server: DataServer, tmp_path: Path) -> None:
    (tmp_path / "a.bin.part").write_bytes(b"x" * 1000)
    with pytest.raises(InvalidArgumentError, match="not what the list says"):
        download_file(file_of(server), tmp_path)
    assert download_file(file_of(server), tmp_path).read_bytes() == CONTENT


def test_another_file_in_the_way_is_left_alone(server: DataServer, tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_text("mine")
    with pytest.raises(InvalidArgumentError, match="is not the file of the list"):
        download_file(file_of(server), tmp_path)
    assert (tmp_path / "a.bin").read_text() == "mine"


def test_a_place_where_nothing_can_be_written_is_told_in_words(
    server: DataServer, tmp_path: Path
) -> None:
    file = file_of(server, "sub/a.bin")
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(
        InvalidArgumentError, match=r"taken/sub/a\.bin cannot be written: Not a dir"
    ):
        download_file(file, tmp_path / "taken")


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_a_list_that_names_a_place_elsewhere_is_refused(server: DataServer, name: str) -> None:
    with pytest.raises(InvalidArgumentError, match="not a list of files"):
        read_data_manifest(server.offer(name))
    row = {"name": name, "url": "x", "bytes": 1, "sha256": "0" * 64}
    manifest = {"schema": "exceptiondrive.data/1", "licence": "x", "files": [row]}
    with pytest.raises(ValidationError):
        DataManifest.model_validate(manifest, strict=False)


@pytest.mark.parametrize("what", ["folder", "file", "part"])
def test_no_link_leads_out_of_the_folder(server: DataServer, tmp_path: Path, what: str) -> None:
    inside, outside = tmp_path / "data", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    victim = outside / "a.bin"
    victim.write_text("mine")
    if what == "folder":
        (inside / "sub").symlink_to(outside)
    else:
        (inside / "sub").mkdir()
        (inside / "sub" / ("a.bin" if what == "file" else "a.bin.part")).symlink_to(victim)
    with pytest.raises(InvalidArgumentError, match="link"):
        download_file(file_of(server, "sub/a.bin"), inside)
    assert victim.read_text() == "mine"
    assert os.listdir(outside) == ["a.bin"]


@pytest.mark.parametrize(
    "url", ["http://data.example.org/x", "ftp://data.example.org/x", "file:///etc/passwd", "//x/y"]
)
def test_nothing_is_fetched_in_the_clear(server: DataServer, tmp_path: Path, url: str) -> None:
    file = file_of(server).model_copy(update={"url": url})
    with pytest.raises((InvalidArgumentError, NetworkError)):
        download_file(file, tmp_path)
    server.redirects["/b.bin"] = url
    with pytest.raises((InvalidArgumentError, NetworkError)):
        download_file(file.model_copy(update={"url": f"{server.url}/b.bin"}), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "url",
    ["http://127.0.0.1:8888/x", "https://127.8.8.8/x", "https://[::1]/x", "http://localhost./x"],
)
def test_a_list_of_elsewhere_reaches_no_service_of_this_machine(url: str) -> None:
    """A blind GET would reach notebooks and routers in the name of who downloads."""
    assert is_here(url)
    with pytest.raises(InvalidArgumentError, match="this very machine"):
        require_private_link(httpx.Request("GET", url), may_be_here=False)


def name_data(running: "Running", **page: str) -> None:
    """Name data that lie on this machine, without https, as no organizer may."""
    from exceptiondrive_records.phases.phases import find_phase

    with running.context.database.write() as session:
        phase = find_phase(session, "dev")
        phase.page = phase.page.model_copy(update=page)


def test_the_command_shows_the_licence_first_and_sends_no_token(
    running: "Running", server: DataServer, tmp_path: Path
) -> None:
    name_data(running, data_manifest_url=server.offer("a.bin", "sub/b.bin"))
    listed = run(running, "data", "dev", "--list")
    assert listed.exit_code == 0
    assert listed.stdout.startswith("licence: CC0")
    refused = run(running, "data", "dev", "-o", tmp_path / "data")
    assert refused.exit_code == 2
    assert "--accept-licence" in refused.stderr
    assert not (tmp_path / "data").exists()
    done = run(running, "data", "dev", "-o", tmp_path / "data", "--accept-licence")
    assert done.exit_code == 0, done.stderr
    assert done.stderr.index("licence: CC0") == 0
    assert (tmp_path / "data/sub/b.bin").read_bytes() == CONTENT
    assert {path for path, _ in server.asked} == {"/manifest.json", "/a.bin", "/sub/b.bin"}
    for _, headers in server.asked:
        assert not {"authorization", "cookie", "referer"} & set(headers)
        assert running.token not in str(headers)


def test_a_phase_with_a_page_alone_shows_it(running: "Running") -> None:
    assert run(running, "data", "dev").exit_code == 2
    name_data(running, data_url="https://data.example.org/", data_licence="CC BY 4.0")
    shown = run(running, "data", "dev")
    assert shown.exit_code == 0
    assert "licence: CC BY 4.0" in shown.stdout
    assert "https://data.example.org/" in shown.stdout
