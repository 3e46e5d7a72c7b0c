"""Files by content: written once, verified when read."""

import hashlib
import os
import stat
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from exceptiondrive_records.db.errors import NotFound, StoreError, UploadTooLarge
from exceptiondrive_records.submissions.file_store import FileDamaged, FileStore

DATA = b"trajectories" * 1000
DIGEST = "sha256:" + hashlib.sha256(DATA).hexdigest()


def chunks(data: bytes = DATA, size: int = 1000) -> list[bytes]:
    return [data[i : i + size] for i in range(0, len(data), size)]


@pytest.fixture(params=["file", "memory"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> FileStore:
    return FileStore(f"file://{tmp_path}/up loads" if request.param == "file" else "memory://")


def local(tmp_path: Path) -> tuple[FileStore, Path]:
    return FileStore(f"file://{tmp_path}"), tmp_path / DIGEST[7:9] / DIGEST[7:]


def test_a_stored_file_comes_back_under_its_digest(store: FileStore) -> None:
    assert store.put_stream(chunks(), limit_bytes=20_000) == (DIGEST, len(DATA))
    assert store.read(DIGEST, limit_bytes=20_000) == DATA
    assert store.holds(DIGEST)


def test_storing_the_same_bytes_again_changes_nothing(store: FileStore) -> None:
    first = store.put_stream(chunks(), limit_bytes=20_000)
    assert store.put_stream(chunks(size=7), limit_bytes=20_000) == first


def test_a_file_and_the_folders_above_it_are_synced_and_again_by_whoever_sends_it_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, path = local(tmp_path)
    synced = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.fstat(file).st_ino))
    for _ in range(2):
        store.put_stream(chunks(), limit_bytes=20_000)
    assert synced == [each.stat().st_ino for each in (path, path.parent, path.parent.parent)] * 2


@pytest.mark.parametrize("mode", [0o2770, 0o750, 0o700])
def test_a_new_subfolder_is_open_to_whom_the_store_is(tmp_path: Path, mode: int) -> None:
    """Else a worker's user could not publish a split into a store that it may write."""
    tmp_path.chmod(mode)
    store, path = local(tmp_path)
    store.put_stream(chunks(), limit_bytes=20_000)
    assert stat.S_IMODE(path.parent.stat().st_mode) == mode


def test_more_bytes_than_allowed_are_refused_and_not_kept(tmp_path: Path) -> None:
    store, path = local(tmp_path)
    with pytest.raises(UploadTooLarge, match="11999 bytes"):
        store.put_stream(chunks(), limit_bytes=11_999)
    assert not path.exists()


def test_a_file_larger_than_the_reader_allows_is_not_read(store: FileStore) -> None:
    store.put_stream(chunks(), limit_bytes=20_000)
    with pytest.raises(UploadTooLarge):
        store.read(DIGEST, limit_bytes=11_999)


@pytest.mark.parametrize(
    "digest", ["sha256:" + "0" * 64, "sha256:../../etc/passwd", "", DIGEST[7:]]
)
def test_what_is_not_there_is_not_found(store: FileStore, digest: str) -> None:
    store.put_stream([b"another"], limit_bytes=100)
    with pytest.raises(NotFound):
        store.read(digest, limit_bytes=10)


def test_a_folder_that_is_away_is_an_outage_and_its_files_are_not_missing(tmp_path: Path) -> None:
    folder = tmp_path / "files"
    store = FileStore(folder.as_uri())
    digest, _ = store.put_stream([b"bytes"], limit_bytes=100)
    folder.rename(tmp_path / "away")
    for ask in (store.holds, store.changed_at, partial(store.read, limit_bytes=100)):
        with pytest.raises(StoreError, match="does not answer"):
            ask(digest)
    assert not store.takes_files()
    folder.mkdir()  # as where nothing is mounted
    with pytest.raises(StoreError, match="does not answer"):
        store.read(digest, limit_bytes=100)
    assert store.takes_files(), "a new server's folder is empty, too"
    (tmp_path / "away").rename(folder)
    assert store.read(digest, limit_bytes=100) == b"bytes"


def test_a_folder_that_this_user_may_not_enter_is_away(tmp_path: Path) -> None:
    folder = tmp_path / "files"
    digest, _ = FileStore(folder.as_uri()).put_stream([b"bytes"], limit_bytes=100)
    command = [sys.executable, "-c", _AS_SOMEBODY_ELSE, folder.as_uri(), digest]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    folder.chmod(0o700)
    assert done.stdout.splitlines() == [
        "False",
        "False",
        "The file store does not answer; try again later.",
        "The file store does not take files now; try again later.",
    ], done.stderr


_AS_SOMEBODY_ELSE = """
import os, sys
from pathlib import Path
from exceptiondrive_records.db.errors import StoreError
from exceptiondrive_records.submissions.file_store import FileStore
url, digest = sys.argv[1:]
store = FileStore(url)
Path(url.removeprefix("file://")).chmod(0)
if os.geteuid() == 0:
    os.setgroups([]); os.setgid(10001); os.setuid(10001)
print(store.is_empty())
print(store.takes_files())
for ask in (lambda: store.read(digest, limit_bytes=100), lambda: store.put_stream([b"more"], limit_bytes=100)):
    try:
        ask()
    except StoreError as error:
        print(error)
"""


def test_a_flipped_bit_is_never_read(tmp_path: Path) -> None:
    store, path = local(tmp_path)
    store.put_stream(chunks(), limit_bytes=20_000)
    damaged = bytearray(path.read_bytes())
    damaged[5] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(FileDamaged, match=DIGEST):
        store.read(DIGEST, limit_bytes=20_000)


def test_uploading_the_right_bytes_again_heals_a_damaged_file(tmp_path: Path) -> None:
    store, path = local(tmp_path)
    store.put_stream(chunks(), limit_bytes=20_000)
    path.write_bytes(b"")
    store.put_stream(chunks(), limit_bytes=20_000)
    assert store.read(DIGEST, limit_bytes=20_000) == DATA


def test_a_store_that_cannot_write_says_so(tmp_path: Path) -> None:
    store = FileStore(f"file://{tmp_path}/uploads")
    (tmp_path / "uploads").rmdir()
    (tmp_path / "uploads").write_text("a file where the folder was")
    with pytest.raises(StoreError, match="try again later"):
        store.put_stream(chunks(), limit_bytes=20_000)


def test_a_store_that_cannot_heal_a_file_says_so(tmp_path: Path) -> None:
    store, path = local(tmp_path)
    path.mkdir(parents=True)
    with pytest.raises(StoreError, match="try again later"):
        store.put_stream(chunks(), limit_bytes=20_000)


def test_what_cannot_be_a_folder_is_told_with_the_setting_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(StoreError, match="EXCEPTIONDRIVE_FILE_STORE_URL") as refused:
            FileStore(path.as_uri())
        assert str(refused.value).startswith(f"{path} cannot be the folder of uploads: ")
