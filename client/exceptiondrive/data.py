"""The data of a phase: the organizer's list of files, downloaded, resumed and checked.

The list and the files may be hosted anywhere. No token is ever sent there, only https is used (or http
to this machine), and nothing is written outside the folder that was named.
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urljoin

from pydantic import ValidationError

from exceptiondrive.errors import InvalidArgumentError, NetworkError
from exceptiondrive.transport import Progress, is_here, open_link
from exceptiondrive_schemas.api.data_manifest import PARTIAL, DataFile, DataManifest
from exceptiondrive_schemas.base import faults_in

MAX_MANIFEST_BYTES = 32 * 1024 * 1024
ATTEMPTS = 5
"""Connections that one file may break off before the download is given up; what came is kept."""


def read_data_manifest(url: str) -> DataManifest:
    """Return the list of files at an address; addresses in it become whole ones.

    Raises:
        InvalidArgumentError: It is no such list, or it names what must not be written.
        NetworkError: It cannot be had.
    """
    content = bytearray()
    with open_link(url) as (chunks, _):
        for chunk in chunks:
            content += chunk
            if len(content) > MAX_MANIFEST_BYTES:
                raise InvalidArgumentError(
                    "wrong_manifest", f"{url} is too long for a list of files."
                )
    try:
        manifest = DataManifest.model_validate_json(bytes(content))
    except ValidationError as error:
        raise InvalidArgumentError(
            "wrong_manifest",
            f"{url} is not a list of files that can be downloaded ({faults_in(error)[0]}).",
            "Tell the organizers; nothing was written.",
        ) from None
    files = [file.model_copy(update={"url": urljoin(url, file.url)}) for file in manifest.files]
    for file in files:
        if is_here(file.url) and not is_here(url):
            raise InvalidArgumentError("wrong_link", f"{file.url} leads to this very machine.")
    return manifest.model_copy(update={"files": tuple(files)})


def download_file(file: DataFile, folder: Path, on_progress: Progress | None = None) -> Path:
    """Download one file, from where an earlier attempt broke off; one that is there is left.

    Args:
        file: Of a manifest.
        folder: Below which it is written, under its name.
        on_progress: Called with bytes that are there and bytes in all.

    Raises:
        InvalidArgumentError: What came is not what the list says, or it cannot be written there.
        NetworkError: The connection broke off again and again; the next call goes on from there.
    """
    try:
        return _download_once(file, folder, on_progress)
    except OSError as error:
        raise InvalidArgumentError(
            "unwritable_file", f"{folder / file.name} cannot be written: {error.strerror}."
        ) from None


def _download_once(file: DataFile, folder: Path, on_progress: Progress | None) -> Path:
    path = _place_of(file, folder)
    if path.exists():
        if _is_whole(path, file):
            return path
        raise InvalidArgumentError(
            "file_in_the_way",
            f"{path} is there, and is not the file of the list.",
            "Move it away, then run the command again.",
        )
    part = path.with_name(path.name + PARTIAL)
    if part.is_symlink():
        raise InvalidArgumentError("file_in_the_way", f"{part} is a link; remove it.")
    broken = NetworkError(
        "broken_download",
        f"{file.url} ends before the {file.bytes:,} bytes that the list says.",
        "Run the same command again: it goes on where it stopped.",
    )
    for _ in range(ATTEMPTS):
        if _has_all(part, file):
            break
        try:
            _go_on(file, part, on_progress)
        except NetworkError as error:
            broken = error
    if not _has_all(part, file):
        raise broken
    if not _is_whole(part, file):
        part.unlink()
        raise InvalidArgumentError(
            "wrong_checksum",
            f"What came from {file.url} is not what the list says of {file.name}; it was deleted.",
            "Run the command again; if it fails again, tell the organizers.",
        )
    part.replace(path)
    return path


def _place_of(file: DataFile, folder: Path) -> Path:
    """Return where a file belongs; no link on the way may lead out of the folder."""
    root = folder.resolve()
    path = root.joinpath(*file.name.split("/"))
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_symlink() or not path.parent.resolve().is_relative_to(root):
        raise InvalidArgumentError("file_in_the_way", f"{path} leads out of {root} by a link.")
    return path


def _go_on(file: DataFile, part: Path, on_progress: Progress | None) -> None:
    """Fetch what is missing; a server that knows no ranges gives all of it once more."""
    start = _size_of(part)
    with open_link(file.url, from_byte=start) as (chunks, starts_at):
        done = start if starts_at == start else 0
        with part.open("ab" if done else "wb") as stream:
            for chunk in _at_most(chunks, file.bytes - done):
                stream.write(chunk)
                done += len(chunk)
                if on_progress is not None:
                    on_progress(done, file.bytes)


def _at_most(chunks: Iterator[bytes], n_bytes: int) -> Iterator[bytes]:
    """Yield what comes, and one byte more than was promised at most: then it is the wrong file."""
    for chunk in chunks:
        yield chunk[: n_bytes + 1]
        n_bytes -= len(chunk)
        if n_bytes < 0:
            return


def _size_of(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _has_all(part: Path, file: DataFile) -> bool:
    return part.exists() and _size_of(part) >= file.bytes


def _is_whole(path: Path, file: DataFile) -> bool:
    if path.stat().st_size != file.bytes:
        return False
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        for chunk in iter(lambda: stream.read(1 << 20), b""):
            digest.update(chunk)
    return digest.hexdigest() == file.sha256
