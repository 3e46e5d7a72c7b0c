"""I13, I16 and I28 against a real server process, by raw connections."""

import shutil
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.hostile.server_process import MEBIBYTE, ServerProcess, read_all, running_server
from tests.support.records import add_phase, add_sample_split, found

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.split import Manifest

HEAD = (
    b'--x\r\nContent-Disposition: form-data; name="phase"\r\n\r\ndev\r\n'
    b'--x\r\nContent-Disposition: form-data; name="method"\r\n\r\nM\r\n'
    b'--x\r\nContent-Disposition: form-data; name="file"; filename="a"\r\n\r\n'
)
HOST = b"Host: x\r\n"
SLOW = {"BODY_S": 1.0, "BODY_BYTES_PER_S": 1_000_000.0}


@dataclass
class Target:
    """A server that waits for no body for long, and a team's token."""

    server: ServerProcess
    database: Database
    token: str

    def upload_head(self, *headers: str) -> bytes:
        lines = ["POST /api/v1/submissions HTTP/1.1", "Host: x", *headers]
        lines += [f"Authorization: Bearer {self.token}"]
        lines += ["Content-Type: multipart/form-data; boundary=x", "", ""]
        return "\r\n".join(lines).encode()

    @property
    def n_submissions(self) -> int:
        with self.database.read() as session:
            return session.query(Submission).count()


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory, migrated_sqlite: Path) -> Iterator[Target]:
    folder = tmp_path_factory.mktemp("connections")
    shutil.copy(migrated_sqlite, folder / "records.sqlite3")
    database = Database(f"sqlite:///{folder}/records.sqlite3")
    manifest = Manifest(
        schema_="exceptiondrive.manifest/1",
        name="tiny",
        title="Tiny",
        revision="sha256:0",
        waypoints=6,
        time_step_s=0.5,
        sample_ids=("s0",),
    )
    with database.write() as session:
        token = found(session, ("mallory",)).tokens["mallory"]
        add_sample_split(session, manifest)
        add_phase(session, split="tiny", quota_per_day=100, rejected_per_day=100)
    settings: dict[str, object] = {
        "database_url": f"sqlite:///{folder}/records.sqlite3",
        "file_store_url": (folder / "uploads").as_uri(),
        "broker_url": f"redis+socket://{folder}/nobody.sock",
        "receipt_key_file": str(folder / "receipt-key.pem"),
    }
    with running_server(folder, settings, SLOW) as server:
        yield Target(server, database, token)
    database.dispose()


def answered(connection: socket.socket) -> bytes:
    """All that the server says, until it is the server who closes."""
    return read_all(connection)


@pytest.mark.row("I16")
@pytest.mark.parametrize("token", ["wrong", ""], ids=["unread", "read"])
def test_a_body_that_stops_coming_is_ended(target: Target, token: str) -> None:
    """Also one that nobody reads, since its sender was refused at its head."""
    before = target.n_submissions
    head = target.upload_head(f"Content-Length: {MEBIBYTE}")
    if token:
        head = head.replace(target.token.encode(), token.encode())
    with target.server.connect() as connection:
        connection.sendall(head + HEAD + b"0" * 1000)
        answer = answered(connection)
    assert answer.startswith(b"HTTP/1.1 401" if token else b"HTTP/1.1 408")
    kind = b"application/problem+json" if token else b"text/plain"
    assert b"content-type: " + kind in answer.lower()
    assert target.n_submissions == before
    assert b"Traceback" not in target.server.log.read_bytes()


@pytest.mark.row("I16")
def test_dripping_a_body_buys_no_more_time_than_its_bytes_are_worth(target: Target) -> None:
    with target.server.connect() as connection:
        connection.sendall(target.upload_head("Content-Length: 100000") + HEAD)
        connection.settimeout(0.1)
        n_drips, answer = 0, b""
        while not answer:
            try:
                connection.sendall(b"0")
                n_drips += 1
                answer = connection.recv(65_536)
            except TimeoutError:
                assert n_drips < 600, "the server still waits"
    assert answer.startswith(b"HTTP/1.1 408")


@pytest.mark.row("I28")
@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        pytest.param(b"GET / HTTP/1.1\r\nHost: x\r\nX: " + b"a" * 65_536 + b"\r\n\r\n", 431,
                     id="64-kB-header"),
        pytest.param(b"GET / HTTP/1.1\r\nHost: x\r\n" + b"X: a\r\n" * 20_000 + b"\r\n", 431,
                     id="20000-headers"),
        pytest.param(b"GET /" + b"a" * 65_536 + b" HTTP/1.1\r\nHost: x\r\n\r\n", 400,
                     id="64-kB-address"),
        pytest.param(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\n"
                     b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\nGET /x HTTP/1.1\r\n\r\n", 400,
                     id="both-lengths"),
        pytest.param(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\nContent-Length: 6\r\n"
                     b"\r\n012345", 400, id="two-lengths"),
        pytest.param(b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked, identity\r\n\r\n"
                     b"0\r\n\r\n", 400, id="chunked-not-last"),
        pytest.param(b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding : chunked\r\n\r\n"
                     b"0\r\n\r\n", 400, id="blank-before-colon"),
        pytest.param(b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n"
                     b"-5\r\nabcde\r\n0\r\n\r\n", 400, id="negative-chunk"),
        pytest.param(b"GET / HTTP/1.1\r\nHost: x\r\nX: a\x00b\r\n\r\n", 400, id="NUL"),
        pytest.param(b"GET / HTTP/1.1\r\nHost: x\r\n folded: a\r\n\r\n", 400, id="folded"),
        pytest.param(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", 400, id="TLS"),
    ],
)  # fmt: skip
def test_what_is_no_honest_http_is_refused_and_its_connection_ended(
    target: Target, request_bytes: bytes, status: int
) -> None:
    answer = target.server.exchange(request_bytes)
    assert answer.startswith(f"HTTP/1.1 {status}".encode()), answer[:200]
    assert answer.count(b"HTTP/1.1 ") == 1, "a second request was smuggled in"
    assert b"content-type: text/plain" in answer.lower()
    assert b"uvicorn" not in answer.lower()
    assert b"server:" not in answer.lower()


@pytest.mark.row("I28")
def test_a_header_is_never_repeated_in_an_answer(target: Target) -> None:
    evil = b"X-Request-ID: a%0d%0aSet-Cookie: x=1\r\nOrigin: https://evil.test\r\n"
    answer = target.server.exchange(
        b"GET /healthz?a=%0d%0aSet-Cookie:x=1 HTTP/1.1\r\n" + HOST + evil
        + b"Connection: close\r\n\r\n"
    )  # fmt: skip
    assert answer.startswith(b"HTTP/1.1 200")
    assert b"set-cookie" not in answer.lower()
    assert b"evil.test" not in answer


BIG_BYTES = 400 * MEBIBYTE


def pour(target: Target, headers: list[str], *, is_chunked: bool) -> tuple[bytes, int]:
    """Send 400 MB of a file as long as the server takes it; return its answer and what it took."""
    chunk, taken = b"0" * MEBIBYTE, 0
    with target.server.connect() as connection:
        connection.settimeout(30)
        try:
            connection.sendall(target.upload_head(*headers))
            for part in [HEAD] + [chunk] * (BIG_BYTES // MEBIBYTE):
                framed = f"{len(part):x}\r\n".encode() + part + b"\r\n" if is_chunked else part
                connection.sendall(framed)
                taken += len(part)
        except OSError:
            pass
        try:
            return connection.recv(65_536), taken
        except OSError:
            return b"", taken


@pytest.mark.row("I13")
@pytest.mark.parametrize(
    ("headers", "answers"),
    [
        pytest.param([f"Content-Length: {BIG_BYTES}"], (b"HTTP/1.1 413",), id="honest-length"),
        pytest.param(["Content-Length: 100"], (b"HTTP/1.1 400",), id="lying-length"),
        pytest.param(["Transfer-Encoding: chunked"], (b"HTTP/1.1 413",), id="chunked"),
    ],
)
def test_400_megabytes_are_refused_early_and_fill_no_memory(
    target: Target, headers: list[str], answers: tuple[bytes, ...]
) -> None:
    before, n_before = target.server.peak_bytes, target.n_submissions
    answer, taken = pour(target, headers, is_chunked="chunked" in headers[0])
    assert answer.startswith(answers), answer[:200]
    assert taken < 64 * MEBIBYTE
    assert target.server.peak_bytes - before < 32 * MEBIBYTE
    assert target.server.health().startswith(b"HTTP/1.1 200")
    assert target.n_submissions == n_before


@pytest.mark.row("I13")
@pytest.mark.parametrize("framing", ["Content-Length: 5000000", "Transfer-Encoding: chunked"])
def test_an_upload_that_is_dropped_raises_no_alarm(target: Target, framing: str) -> None:
    n_before = target.n_submissions
    n_lines = target.server.log.read_text().count("/api/v1/submissions")
    part = HEAD + b"0" * 100_000
    for _ in range(4):
        with target.server.connect() as connection:
            connection.sendall(target.upload_head(framing))
            connection.sendall(f"{len(part):x}\r\n".encode() + part if "chunk" in framing else part)
    while target.server.log.read_text().count("/api/v1/submissions") < n_lines + 4:
        time.sleep(0.01)  # pytest's own time limit ends it
    log = target.server.log.read_text()
    assert "error" not in log.lower()
    assert "Traceback" not in log
    assert "status=500" not in log
    assert log.count("status=499") >= 4
    assert target.n_submissions == n_before
