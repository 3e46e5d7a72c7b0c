"""Bodies are capped: early by Content-Length, while they stream in, and in memory."""

import gc
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]
FORM = {"Content-Type": "multipart/form-data; boundary=x"}
HEAD = (
    b'--x\r\nContent-Disposition: form-data; name="phase"\r\n\r\ndev\r\n'
    b'--x\r\nContent-Disposition: form-data; name="method"\r\n\r\nM\r\n'
    b'--x\r\nContent-Disposition: form-data; name="file"; filename="a"\r\n\r\n'
)
MEBIBYTE = 1024 * 1024


def endless(taken: list[int], chunk: bytes = b"0" * 65_536) -> Iterator[bytes]:
    """A form whose file does not end, and how many chunks of it were taken."""
    yield HEAD
    for number in range(10_000):
        taken.append(number)
        yield chunk


def test_a_file_at_the_limit_is_taken_and_one_byte_more_is_not(
    api: "Api", as_problem: Problem
) -> None:
    assert api.submit(b"0" * 64 * 1024).status_code == 202
    as_problem(api.submit(b"0" * (64 * 1024 + 1)), 413, "upload_too_large")


def test_a_large_content_length_is_refused_before_the_body(api: "Api", as_problem: Problem) -> None:
    response = api.post(
        "/submissions", "alpha", content=b"", headers={**FORM, "Content-Length": str(400 * 2**20)}
    )
    as_problem(response, 413, "upload_too_large")
    assert response.headers["connection"] == "close"


@pytest.mark.parametrize("length", ["-1", "1e9", "0x10", "\u0663", "9" * 5000])
def test_a_strange_content_length_is_refused(api: "Api", length: str) -> None:
    headers = {**FORM, "Content-Length": length.encode()}
    response = api.post("/submissions", "alpha", content=b"", headers=headers)
    assert response.status_code in (400, 413)


@pytest.mark.parametrize("declared", [{}, {"Content-Length": "100"}], ids=["chunked", "lying"])
def test_a_body_that_does_not_end_is_cut_while_it_comes(
    api: "Api", as_problem: Problem, declared: dict[str, str]
) -> None:
    taken: list[int] = []
    chunks = b"".join(chunk for chunk, _ in zip(endless(taken), range(60), strict=False))
    headers = {**FORM, **declared}
    response = api.post("/submissions", "alpha", content=iter([chunks]), headers=headers)
    as_problem(response, 413, "upload_too_large")


def test_without_a_token_no_body_is_read(api: "Api", as_problem: Problem) -> None:
    """A body beyond the limit would be 413 if it were read."""
    response = api.post("/submissions", content=iter([b"0" * MEBIBYTE]), headers=FORM)
    as_problem(response, 401, "not_signed_in")


def test_other_routes_take_small_bodies_only(api: "Api", as_problem: Problem) -> None:
    body = b"0" * (2 * MEBIBYTE)
    as_problem(api.post("/organizer/teams", "organizer", content=body), 413, "upload_too_large")


@pytest.mark.parametrize(
    ("kind", "encoding"),
    [
        ("application/json", None),
        ("application/octet-stream", None),
        ("application/x-www-form-urlencoded", None),
        ("text/plain", None),
        ("multipart/form-data; boundary=x", "gzip"),
        ("multipart/form-data; boundary=x", "zstd"),
    ],
)
def test_what_is_no_plain_form_is_415(
    api: "Api", as_problem: Problem, kind: str, encoding: str | None
) -> None:
    headers = {"Content-Type": kind, **({"Content-Encoding": encoding} if encoding else {})}
    response = api.post("/submissions", "alpha", content=b"{}", headers=headers)
    as_problem(response, 415, "unsupported_media_type")


@pytest.mark.filterwarnings(  # Starlette leaves the file of a form that is cut off to the collector
    "ignore::pytest.PytestUnraisableExceptionWarning"
)
@pytest.mark.parametrize(
    "body",
    [b"", b"--x", b"--x\r\n\r\n\r\n--x--", HEAD, HEAD + b"a", b"\x00" * 100, b"--y\r\n" + HEAD],
)
def test_a_broken_form_is_400(api: "Api", as_problem: Problem, body: bytes) -> None:
    gc.disable()  # what the form leaves stays young: it is found without looking at all that this process holds
    try:
        response = api.post("/submissions", "alpha", content=body, headers=FORM)
        as_problem(response, 400, "bad_request")
    finally:
        gc.collect(0)
        gc.enable()


def test_a_form_without_a_boundary_is_400(api: "Api", as_problem: Problem) -> None:
    headers = {"Content-Type": "multipart/form-data"}
    response = api.post("/submissions", "alpha", content=HEAD, headers=headers)
    as_problem(response, 400, "bad_request")


def test_a_field_that_is_a_novel_is_400(api: "Api", as_problem: Problem) -> None:
    too_long = as_problem(api.submit("a", description="x" * 20_000), 400, "bad_request")
    assert "a field is too long" in too_long["detail"]


def test_many_fields_are_400(api: "Api", as_problem: Problem) -> None:
    many = {f"field{number}": "x" for number in range(50)}
    as_problem(api.submit("a", **many), 400, "bad_request")


SERVER = """
import sys, uvicorn
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings
app = create_app(ServerSettings(database_url=sys.argv[1], file_store_url=sys.argv[2],
    broker_url="redis+socket:///nobody.sock", max_upload_bytes=16 * 2**20))
uvicorn.run(app, fd=int(sys.argv[3]), log_config=None, access_log=False)
"""


@pytest.mark.row("I13")
@pytest.mark.slow
def test_hundreds_of_megabytes_do_not_fill_the_memory_of_the_server(
    api: "Api", sqlite_url: str, tmp_path: Path
) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        port = listener.getsockname()[1]
        command = [sys.executable, "-c", SERVER, sqlite_url, (tmp_path / "uploads").as_uri()]
        process = subprocess.Popen(
            [*command, str(listener.fileno())],
            pass_fds=[listener.fileno()],
            stdout=subprocess.DEVNULL,
        )
        try:
            _wait_until_alive(port)
            before = _peak_bytes(process.pid)
            token = api.tokens["alpha"]
            lying = [f"Content-Length: {15 * MEBIBYTE}"]  # more than it sends, then it leaves
            senders = [
                threading.Thread(target=_pour, args=(port, token, how))
                for how in (["Transfer-Encoding: chunked"], lying) * 3
            ]
            for sender in senders:
                sender.start()
            for sender in senders:
                sender.join()
            answer = _exchange(
                port, b"GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
            )
            assert answer.startswith(b"HTTP/1.1 200")
            assert _peak_bytes(process.pid) - before < 32 * MEBIBYTE
        finally:
            process.terminate()
            process.wait()
    assert api.get("/submissions", "alpha").json()["submissions"] == []


def _pour(port: int, token: str, headers: list[str]) -> None:
    """Send up to 64 MiB of a file, as long as the server lets us."""
    is_chunked = headers[0].startswith("Transfer")
    lines = ["POST /api/v1/submissions HTTP/1.1", "Host: x", f"Authorization: Bearer {token}"]
    lines += [f"Content-Type: {FORM['Content-Type']}", *headers]
    chunk = b"0" * MEBIBYTE
    with socket.create_connection(("127.0.0.1", port)) as connection:
        try:
            connection.sendall("\r\n".join([*lines, "", ""]).encode())
            for part in [HEAD] + [chunk] * (64 if is_chunked else 14):
                framed = f"{len(part):x}\r\n".encode() + part + b"\r\n" if is_chunked else part
                connection.sendall(framed)
        except OSError:
            return


def _exchange(port: int, request: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(request)
        return b"".join(iter(lambda: connection.recv(65_536), b""))


def _wait_until_alive(port: int) -> None:
    deadline = time.monotonic() + 60
    request = b"GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
    while time.monotonic() < deadline:
        if _exchange(port, request).startswith(b"HTTP/1.1 200"):
            return
    raise RuntimeError("the server did not start")


def _peak_bytes(pid: int) -> int:
    """The most memory that a process ever had in use."""
    path = Path(f"/proc/{pid}/status")
    if not path.exists():
        pytest.skip("peak memory is read from /proc, which this system does not have")
    line = next(line for line in path.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024
