"""Download uploads unchanged: one for its team, one or many for organizers."""

import tarfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from tempfile import TemporaryFile
from typing import IO

from fastapi import Request
from fastapi.responses import Response, StreamingResponse
from pydantic import BaseModel

from exceptiondrive_records.accounts.tokens import Principal
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.errors import NotFound, StoreError, UploadTooLarge
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.submissions.submissions import find_submission, submission_page
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import views
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.check.inflate import GZIP_MAGIC
from exceptiondrive_server.web.auth import team_of
from exceptiondrive_server.web.etag import conditional
from exceptiondrive_server.web.responses import SECURITY_HEADERS
from exceptiondrive_server.web.services import Services

PIECE_BYTES = 1 << 20
BATCH = 50
"""Submissions of an archive that are read from the records at a time."""


class ArchivedFile(BaseModel):
    """A submission of an archive."""

    file: str | None
    """Its upload within the archive; None where it could not be read."""
    missing_because: str | None
    submission: SubmissionView


class ArchiveManifest(BaseModel):
    """What an archive of uploads holds: `manifest.json`, its last member."""

    made_at: datetime
    files: tuple[ArchivedFile, ...]


def own_upload(
    request: Request, services: Services, principal: Principal, submission_id: str
) -> Response:
    """Return the very bytes that the team sent; the file is named by the submission alone.

    Raises:
        NotFound: There is no such submission, it is another team's, or its file is kept no longer.
        ApiProblem: The token belongs to no team.
        StoreError: The file store did not answer, or its bytes have changed.
    """
    with services.database.read() as session:
        found = find_submission(session, submission_id, team_id=team_of(principal))
    return _given(request, services, found)


def any_upload(
    request: Request, services: Services, principal: Principal, submission_id: str
) -> Response:
    """Return an upload of any team to an organizer; the audit log says who had it.

    Raises:
        NotFound: There is no such submission, or its file is kept no longer.
        StoreError: The file store did not answer, or its bytes have changed.
    """
    with services.database.read() as session:
        found = find_submission(session, submission_id)
    answer = _given(request, services, found)
    with services.database.write() as session:
        audit(session, principal.actor, "upload downloaded", submission_id)
    return answer


def _given(request: Request, services: Services, found: Submission) -> Response:
    data = services.files.read(found.file_digest, limit_bytes=found.size_bytes)
    return conditional(
        request,
        data,
        "application/octet-stream",
        etag=found.file_digest,
        headers=attachment(f"exceptiondrive-{found.id}{suffix_of(data)}"),
    )


def archive(
    services: Services,
    principal: Principal,
    *,
    team: str | None,
    phase: str | None,
    status: SubmissionStatus | None,
) -> Response:
    """Return a tar of the uploads that match, newest first, with a manifest at its end.

    The manifest is the last member: it says of each file whether it could be read.

    Raises:
        NotFound: There is no such team or phase.
    """
    with services.database.write() as session:
        team_id = None if team is None else find_team(session, team).id
        if phase is not None:
            find_phase(session, phase)
        chosen = {"team": team, "phase": phase, "status": status}
        detail = {name: value for name, value in chosen.items() if value is not None}
        audit(session, principal.actor, "uploads downloaded", phase or team or "all", detail)
    members = _archived(services, team_id, phase, status)
    return tar_answer(tar_stream(members), "exceptiondrive-submissions.tar")


def _archived(
    services: Services, team_id: int | None, phase: str | None, status: SubmissionStatus | None
) -> Iterator[tuple[str, bytes]]:
    files: list[ArchivedFile] = []
    after: str | None = None
    while True:
        with services.database.read() as session:
            found, after = submission_page(
                session, team_id=team_id, phase_id=phase, status=status, after=after, limit=BATCH
            )
            slugs = [session.get_one(Team, one.team_id).slug for one in found]
            batch = list(zip(views(session, found), slugs, strict=True))
        for one, slug in batch:
            data, missing = read_upload(services, one)
            path = None
            if data is not None:
                path = f"{one.phase}/{slug}/{one.id}{suffix_of(data)}"
                yield path, data
            files.append(ArchivedFile(file=path, missing_because=missing, submission=one))
        if after is None:
            break
    manifest = ArchiveManifest(made_at=datetime.now(UTC), files=tuple(files))
    yield "manifest.json", manifest.model_dump_json(indent=2, by_alias=True).encode()


def read_upload(services: Services, one: SubmissionView) -> tuple[bytes | None, str | None]:
    """Return the bytes of an upload, or why they cannot be had."""
    try:
        return services.files.read(one.file_digest, limit_bytes=one.size_bytes), None
    except NotFound:
        return None, "the file is kept no longer"
    except (StoreError, UploadTooLarge) as error:
        return None, str(error)


def tar_stream(members: Iterable[tuple[str, bytes]], at: datetime | None = None) -> Iterator[bytes]:
    """Yield a tar, member by member, each of the time `at`, else of now."""
    at_s = int((at or datetime.now(UTC)).timestamp())
    for name, data in members:
        info = tarfile.TarInfo(name)
        info.size, info.mtime = len(data), at_s
        yield info.tobuf()
        yield data
        yield bytes(-len(data) % tarfile.BLOCKSIZE)
    yield bytes(2 * tarfile.BLOCKSIZE)


def written_down(parts: Iterable[bytes]) -> Iterator[bytes]:
    """Write all parts into a temporary file, then yield it in chunks.

    So a slow reader holds no transaction open, and large data is not kept in memory.
    """
    with ExitStack() as until_whole:
        file = until_whole.enter_context(TemporaryFile())
        file.writelines(parts)
        file.seek(0)
        until_whole.pop_all()
    return _read_out(file)


def _read_out(file: IO[bytes]) -> Iterator[bytes]:
    with file:
        yield from iter(lambda: file.read(PIECE_BYTES), b"")


def tar_answer(parts: Iterable[bytes], name: str) -> Response:
    """Return a tar as a download that nobody keeps."""
    return StreamingResponse(parts, media_type="application/x-tar", headers=attachment(name))


def attachment(name: str) -> dict[str, str]:
    """Return the headers of a download that nobody keeps."""
    return {
        **SECURITY_HEADERS,
        "Cache-Control": "no-store",
        "Content-Disposition": f'attachment; filename="{name}"',
    }


def suffix_of(data: bytes) -> str:
    """Return how the name of a file with these bytes ends."""
    return ".json.gz" if data.startswith(GZIP_MAGIC) else ".json"
