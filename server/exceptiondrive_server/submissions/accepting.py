"""Take an upload: kept, accepted, and a worker called. The API and the page's form both do this."""

from collections.abc import Iterator
from datetime import datetime
from typing import BinaryIO

import structlog

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.submissions.file_store import keep_stored
from exceptiondrive_records.submissions.quotas import quota_of
from exceptiondrive_records.submissions.submissions import Accepted, accept, find_submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.work.dispatch import mark_queued, wake_lanes
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.submission import Quota, SubmissionView
from exceptiondrive_server.submissions.upload_form import Upload
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.services import Services

_log = structlog.get_logger("exceptiondrive.uploads")

CHUNK_BYTES = 256 * 1024


class EmptyUpload(ApiProblem):
    """The file has no byte."""

    def __init__(self) -> None:
        super().__init__(ProblemCode.UPLOAD_EMPTY, "The file holds nothing; choose another one.")


def arrival_now(services: Services) -> datetime:
    """Return the database's time: asked when an upload begins, since deadlines are judged by it."""
    with services.database.read() as session:
        return database_now(session)


def take_upload(
    services: Services, team_id: int, upload: Upload, arrived_at: datetime
) -> tuple[SubmissionView, Quota]:
    """Store the file, then accept it in one transaction, then call a worker.

    Args:
        services: Of the application.
        team_id: Who submits.
        upload: What was sent.
        arrived_at: When it began, from `arrival_now`.

    Raises:
        RecordsError: It is refused; nothing but the file's bytes was kept.
        ApiProblem: The file is empty.
    """
    fields = upload.fields
    _refuse_unknown_phase(services, fields.phase)
    file_digest, size_bytes = _store(services, upload.file)
    with services.database.write() as session:
        keep_stored(
            session, services.files, file_digest, lambda: _store_again(services, upload.file)
        )
        accepted = accept(
            session,
            team_id=team_id,
            phase_id=fields.phase,
            method=fields.method,
            description=fields.description,
            links=fields.links,
            linked_to=fields.linked_to or None,
            file_digest=file_digest,
            size_bytes=size_bytes,
            arrived_at=arrived_at,
        )
    _log.info(
        "upload accepted",
        submission=accepted.submission.id,
        job=accepted.job_id,
        is_duplicate=accepted.is_duplicate,
    )
    _wake(services, accepted)
    with services.database.read() as session:
        submission = find_submission(session, accepted.submission.id)
        taken = view(session, submission, is_duplicate=accepted.is_duplicate)
        return taken, quota_of(session, team_id, find_phase(session, fields.phase))


def _refuse_unknown_phase(services: Services, phase_id: str) -> None:
    """Before a byte is stored."""
    with services.database.read() as session:
        find_phase(session, phase_id)


def _store(services: Services, stream: BinaryIO) -> tuple[str, int]:
    limit = services.settings.max_upload_bytes
    file_digest, size_bytes = services.files.put_stream(_chunks(stream), limit_bytes=limit)
    if size_bytes == 0:
        raise EmptyUpload
    return file_digest, size_bytes


def _store_again(services: Services, stream: BinaryIO) -> None:
    stream.seek(0)
    _store(services, stream)


def _chunks(stream: BinaryIO) -> Iterator[bytes]:
    while chunk := stream.read(CHUNK_BYTES):
        yield chunk


def _wake(services: Services, accepted: Accepted) -> None:
    """Wake a worker; where the broker is away, the reconciler does it soon."""
    if accepted.is_duplicate:
        return
    live = (Lane.LIVE,)
    if wake_lanes(services.database, services.dispatcher, services.settings, live):
        with services.database.write() as session:
            mark_queued(session)
