"""A team's own upload, given back bit by bit."""

from fastapi.responses import Response

from exceptiondrive_records.accounts.tokens import Principal
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_server.web.auth import team_of
from exceptiondrive_server.web.responses import SECURITY_HEADERS
from exceptiondrive_server.web.services import Services

GZIP_MAGIC = b"\x1f\x8b"


def own_upload(services: Services, principal: Principal, submission_id: str) -> Response:
    """Return the very bytes that the team sent; the file is named by the submission alone.

    Raises:
        NotFound: There is no such submission, it is another team's, or its file is kept no longer.
        ApiProblem: The token belongs to no team.
        StoreError: The file store did not answer, or its bytes have changed.
    """
    with services.database.read() as session:
        found = find_submission(session, submission_id, team_id=team_of(principal))
        digest, size_bytes = found.file_digest, found.size_bytes
    data = services.files.read(digest, limit_bytes=size_bytes)
    suffix = ".json.gz" if data.startswith(GZIP_MAGIC) else ".json"
    headers = {
        **SECURITY_HEADERS,
        "Cache-Control": "no-store",
        "Content-Disposition": f'attachment; filename="exceptiondrive-{found.id}{suffix}"',
        "ETag": f'"{digest}"',
    }
    return Response(data, media_type="application/octet-stream", headers=headers)
