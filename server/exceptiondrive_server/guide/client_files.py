"""Downloads for participants: the client's wheel, `recorder.py`, and their digests.

`/client/` serves as `pip --find-links`: on a closed network the folder also holds the wheels of the
dependencies (`make wheelhouse`).
"""

import hashlib
import re
import zipfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, NamedTuple

from fastapi import APIRouter, Request
from fastapi import Path as PathParameter
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.etag import conditional
from exceptiondrive_server.web.responses import SECURITY_HEADERS, origin_of, page
from exceptiondrive_server.web.services import Services

router = APIRouter(include_in_schema=False)
CLIENT = "exceptiondrive"
RECORDER = "exceptiondrive/recorder.py"
_WHEEL = re.compile(r"(?P<project>\w+(?:\.\w+)*)-[\w.+!]+(-\w+)?-[\w.]+-[\w.]+-[\w.]+\.whl")
FileName = Annotated[str, PathParameter(max_length=200)]


class Wheel(NamedTuple):
    """A wheel of the folder; digests are hexadecimal SHA-256."""

    path: Path
    project: str
    """In small letters, with hyphens."""
    size_bytes: int
    digest: str
    requires_python: str

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    @property
    def address(self) -> str:
        """Path and digest, as pip checks it."""
        return f"/client/{self.name}#sha256={self.digest}"


def wheels_of(services: Services) -> Mapping[str, Wheel]:
    """Return the wheels of the client's folder by file name; none where no folder is set."""
    folder = services.settings.client_dir
    if folder is None or not folder.is_dir():
        return {}
    found = {}
    for path in sorted(folder.glob("*.whl")):
        if _WHEEL.fullmatch(path.name):
            status = path.stat()
            found[path.name] = _wheel(path, status.st_size, status.st_mtime_ns)
    return found


def client_wheel(services: Services) -> Wheel | None:
    """Return the wheel of the client; the newest file where there are several."""
    own = [wheel for wheel in wheels_of(services).values() if wheel.project == CLIENT]
    return max(own, key=lambda wheel: wheel.path.stat().st_mtime_ns, default=None)


@lru_cache(maxsize=256)
def _wheel(path: Path, size_bytes: int, changed_ns: int) -> Wheel:
    named = _WHEEL.fullmatch(path.name)
    assert named is not None
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    with zipfile.ZipFile(path) as archive:
        name = next(n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        metadata = archive.read(name)
    needs = re.search(rb"^Requires-Python: *(.+)$", metadata, re.MULTILINE)
    return Wheel(
        path,
        _normal_name(named["project"]),
        size_bytes,
        digest,
        needs[1].decode().strip() if needs else "",
    )


def _normal_name(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@router.get("/client")
def lead_to_client() -> Response:
    """Lead to the page, whose addresses are relative to it."""
    return RedirectResponse("/client/", status_code=307)


@router.get("/client/")
def show_client(request: Request, services: ServicesOf) -> Response:
    """Show how to get the client, with digests; every wheel is linked, as `--find-links` wants."""
    wheels, own = wheels_of(services), client_wheel(services)
    source = None if own is None else _recorder_of(own)
    return page(
        request,
        "guide/client.html",
        "api",
        server=origin_of(request),
        own=own,
        others=[wheel for wheel in wheels.values() if wheel is not own],
        recorder_digest=None if source is None else hashlib.sha256(source).hexdigest(),
        recorder_size_bytes=0 if source is None else len(source),
    )


@router.get("/recorder.py")
def lead_to_recorder() -> Response:
    """Lead to the recorder."""
    return RedirectResponse("/client/recorder.py", status_code=307)


@router.get("/client/recorder.py")
def give_recorder(request: Request, services: ServicesOf) -> Response:
    """Give the recorder out of the wheel: one file, standard library alone."""
    own = client_wheel(services)
    if own is None:
        raise NotFound("file", "recorder.py")
    return conditional(request, _recorder_of(own), "text/x-python", headers=SECURITY_HEADERS)


@lru_cache(maxsize=4)
def _recorder_of(wheel: Wheel) -> bytes:
    with zipfile.ZipFile(wheel.path) as archive:
        return archive.read(RECORDER)


@router.get("/client/{name}")
def give_wheel(request: Request, services: ServicesOf, name: FileName) -> Response:
    """Give a wheel."""
    wheel = wheels_of(services).get(name)
    if wheel is None:
        raise NotFound("file", name)
    return conditional(
        request,
        wheel.path.read_bytes,
        "application/zip",
        etag=wheel.digest,
        headers=SECURITY_HEADERS,
    )
