"""The file store on S3: a real HTTP server that speaks it, reached as any other would be."""

import contextlib
import hashlib
import os
import socket
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import obstore
import pytest
from obstore.store import from_url

from exceptiondrive_records.db.errors import NotFound, StoreError, UploadTooLarge
from exceptiondrive_records.submissions.file_store import FileDamaged, FileStore

moto_server = pytest.importorskip("moto.server", reason="moto, a local S3 server, is not installed")


class Bucket:
    """A bucket on the local server, and another client of it."""

    def __init__(self, address: str) -> None:
        make = urllib.request.Request(f"{address}/uploads", method="PUT")
        with closing(urllib.request.urlopen(make, timeout=10)) as answer:
            assert answer.status == 200
        self._client = from_url("s3://uploads")

    def get(self, key: str) -> bytes:
        return bytes(obstore.get(self._client, key).bytes())

    def put(self, key: str, data: bytes) -> None:
        obstore.put(self._client, key, data)


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    started = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    started.start()
    host, port = started.get_host_and_port()
    for name, value in {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ALLOW_HTTP": "true",
    }.items():
        monkeypatch.setenv(name, value)
    yield started
    started.stop()


@pytest.fixture
def bucket(server: Any) -> Bucket:
    return Bucket(os.environ["AWS_ENDPOINT_URL"])


@pytest.fixture
def store(bucket: Bucket) -> FileStore:
    return FileStore("s3://uploads/prefix")


def key_of(digest: str) -> str:
    name = digest.removeprefix("sha256:")
    return f"prefix/{name[:2]}/{name}"


def test_a_file_is_stored_under_its_content_and_read_back(store: FileStore, bucket: Bucket) -> None:
    data = os.urandom(3 * 2**20)
    digest, size = store.put_stream([data[:1000], data[1000:]], limit_bytes=2**24)
    assert digest == "sha256:" + hashlib.sha256(data).hexdigest()
    assert size == len(data)
    assert store.read(digest, limit_bytes=2**24) == data
    assert bucket.get(key_of(digest)) == data
    assert store.holds(digest)


def test_storing_again_is_free_and_heals_damaged_bytes(store: FileStore, bucket: Bucket) -> None:
    digest, _ = store.put_stream([b"hello"], limit_bytes=99)
    assert store.put_stream([b"hello"], limit_bytes=99)[0] == digest
    bucket.put(key_of(digest), b"hullo")
    with pytest.raises(FileDamaged):
        store.read(digest, limit_bytes=99)
    store.put_stream([b"hello"], limit_bytes=99)
    assert store.read(digest, limit_bytes=99) == b"hello"


def test_what_is_not_there_is_not_found_and_what_is_too_large_is_not_read(store: FileStore) -> None:
    digest, _ = store.put_stream([b"x" * 50], limit_bytes=99)
    missing = "sha256:" + "0" * 64
    assert not store.holds(missing)
    with pytest.raises(NotFound):
        store.read(missing, limit_bytes=99)
    with pytest.raises(UploadTooLarge):
        store.read(digest, limit_bytes=10)


def test_a_bucket_that_is_not_there_is_an_outage(server: Any) -> None:
    """No upload is lost by it, and none is taken."""
    store = FileStore("s3://no-such-bucket/prefix")
    with pytest.raises(StoreError):
        store.put_stream([b"hello"], limit_bytes=99)
    with pytest.raises(StoreError):
        store.read("sha256:" + "0" * 64, limit_bytes=99)
    assert not store.takes_files()


def test_whether_a_bucket_is_there_is_asked_without_a_list_of_its_files(
    store: FileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Health checks ask it, and a list of a full bucket is 1,000 names long."""
    digest, _ = store.put_stream([b"hello"], limit_bytes=99)
    obstore_list = obstore.list
    listed: list[Any] = []

    def note(*given: Any) -> Iterator[Any]:
        for batch in obstore_list(*given):
            listed.extend(batch)
            yield batch

    monkeypatch.setattr(obstore, "list", note)
    assert store.takes_files()
    assert listed == []
    assert digest in [file.digest for file in store.stored()]
    assert listed != []


def test_a_store_that_nobody_reaches_is_told_after_few_attempts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    n_calls = 0

    def hang_up(listener: socket.socket) -> None:
        nonlocal n_calls
        with contextlib.suppress(OSError):  # the listener is closed at the end
            while True:
                listener.accept()[0].close()
                n_calls += 1

    with socket.create_server(("127.0.0.1", 0)) as listener:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{listener.getsockname()[1]}")
        monkeypatch.setenv("AWS_ALLOW_HTTP", "true")
        monkeypatch.setenv("AWS_ACCESS_KEY_ID", "key")
        monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
        threading.Thread(target=hang_up, args=[listener], daemon=True).start()
        with pytest.raises(StoreError):
            FileStore("s3://uploads/prefix").holds("sha256:" + "0" * 64)
        assert 1 <= n_calls <= 4
        assert not FileStore("s3://uploads/prefix").takes_files()
