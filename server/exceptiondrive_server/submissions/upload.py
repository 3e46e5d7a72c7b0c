"""Take an upload from the API or the page's form: read it, store it, accept it, wake a worker.

The body is read only after its sender is authenticated; the file is stored and never parsed here.
"""

import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Annotated, Any, BinaryIO

import structlog
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from sqlalchemy.orm import Session
from starlette.datastructures import FormData, UploadFile

from exceptiondrive_records.accounts.sessions import require_unrevoked
from exceptiondrive_records.accounts.tokens import Principal, Scope
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotAllowed, RecordsError, StoreError, UploadEmpty
from exceptiondrive_records.operations.garbage import remove_orphan
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_records.phases.quotas import quota_of
from exceptiondrive_records.submissions.file_store import FileStore, is_kept, seems_unmounted
from exceptiondrive_records.submissions.submissions import accept, require_acceptable
from exceptiondrive_records.submissions.views import view
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import NOT_APPROVED
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.submission import Quota, SubmissionView
from exceptiondrive_schemas.base import faults_in, pieces_digest
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.method_facts import Links, MethodFacts
from exceptiondrive_server.submissions.facts_form import PREFIX, facts_of_form
from exceptiondrive_server.web.auth import team_of
from exceptiondrive_server.web.browser_session import FORM_TOKEN, require_form_token
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.problems import problem_of
from exceptiondrive_server.web.services import Services

_log = structlog.get_logger("exceptiondrive.uploads")

CHUNK_BYTES = 256 * 1024
MAX_FIELD_BYTES = 16 * 1024
MAX_FIELDS = 40
Link = Annotated[str, Field(max_length=500, description="an https:// address")]
NO_RESULTS: dict[str, Any] = {
    "sheet": None,
    "rank": None,
    "rank_interval": None,
    "intervals": {},
    "unranked_because": None,
    "reminder_effect": None,
    "no_effect_because": None,
    "replaced_by": None,
}
_ASKED_OF_READERS = ("What is asked may name scores: a token with the scope read:own is told it.",)


class UploadFields(BaseModel):
    """What travels beside the file."""

    model_config = ConfigDict(extra="forbid")

    phase: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,63}$", description="id of a phase")]
    method: Annotated[str, Field(min_length=1, max_length=80, description="shown on the board")]
    description: Annotated[str, Field(max_length=2000)] = ""
    paper_url: Link = ""
    code_url: Link = ""
    facts: Annotated[
        str, Field(max_length=4000, description="facts of the method: JSON of `MethodFacts`")
    ] = ""
    linked_to: Annotated[
        str, Field(max_length=64, description="your submission of the same agent without reminder")
    ] = ""
    asks_first: Annotated[
        bool,
        Field(
            description="if it replaces an entry or would not be ranked, count nothing and say so: "
            "its `report.to_confirm`"
        ),
    ] = False

    @field_validator("description", mode="before")
    @classmethod
    def _one_character_a_line(cls, description: object) -> object:
        """Count line ends as browsers do, which send two characters for each."""
        return description.replace("\r\n", "\n") if isinstance(description, str) else description

    @field_validator("facts")
    @classmethod
    def _are_facts(cls, facts: str) -> str:
        """Refuse what is not a document of facts."""
        try:
            _ = facts and MethodFacts.model_validate_json(facts)
        except ValidationError as error:
            raise ValueError("; ".join(faults_in(error))) from None
        return facts

    @property
    def method_facts(self) -> MethodFacts | None:
        """Facts of the method; None where none were sent."""
        return MethodFacts.model_validate_json(self.facts) if self.facts else None

    @property
    def links(self) -> Links:
        """Where the method is described."""
        return Links(paper=self.paper_url or None, code=self.code_url or None)


@dataclass(frozen=True)
class Upload:
    """Fields and bytes of one upload. The file's own name is never looked at."""

    fields: UploadFields
    file: BinaryIO


def upload_body() -> dict[str, Any]:
    """Describe the form in OpenAPI."""
    schema = UploadFields.model_json_schema()
    schema["properties"]["file"] = {
        "type": "string",
        "contentMediaType": "application/octet-stream",
        "format": "binary",
        "description": "the submission file, JSON or gzip; its part of the form needs a filename, whichever",
    }
    schema["required"].append("file")
    content = {"multipart/form-data": {"schema": schema}}
    return {"requestBody": {"required": True, "content": content}}


@asynccontextmanager
async def received_upload(
    request: Request, services: Services, principal: Principal, *, form_token: str | None = None
) -> AsyncIterator[Upload]:
    """Read the form; its file lies in memory up to 1 MiB, then in a temporary file.

    The form of a page carries `form_token` against forgery; the API takes none.

    Raises:
        ApiProblem: Not a form, or it is encoded, or not made for who sends it; who belongs to no team, or
            to one that is not approved; or too many uploads are under way.
        RequestValidationError: A field is missing, unknown, repeated or wrong.
    """
    _require_form(request)
    _require_sender(principal)
    with services.upload_places.held_by(team_of(principal)):
        form = request.form(max_files=1, max_fields=MAX_FIELDS, max_part_size=MAX_FIELD_BYTES)
        async with form as received:
            yield _upload_of(received, form_token)


def _require_sender(principal: Principal) -> None:
    """Let no team take a place that nobody approved: strangers may register as many as they like."""
    if principal.team_is_pending:
        raise problem_of(NotAllowed(NOT_APPROVED))


def _require_form(request: Request) -> None:
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "multipart/form-data":
        detail = "Send a form (multipart/form-data) with the fields phase, method and file."
        raise ApiProblem(ProblemCode.UNSUPPORTED_MEDIA_TYPE, detail)
    if request.headers.get("content-encoding", "identity").strip().lower() != "identity":
        detail = "Send the form without Content-Encoding; the file in it may be gzip."
        raise ApiProblem(ProblemCode.UNSUPPORTED_MEDIA_TYPE, detail)


def _upload_of(form: FormData, form_token: str | None) -> Upload:
    if form_token is not None:
        require_form_token(form_token, str(form.get(FORM_TOKEN, "")))
        form = _as_the_api_takes_it(form)
    values, faults = dict(form.items()), list(_shape_faults(form))
    file = values.pop("file", None)
    try:
        fields = UploadFields.model_validate(values)
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=False, include_context=False)
        faults += [dict(fault) for fault in found]
    if faults or not isinstance(file, UploadFile):
        raise RequestValidationError(faults)
    return Upload(fields, file.file)


def _as_the_api_takes_it(form: FormData) -> FormData:
    """The form of a page without its token, its fields of facts as one document.

    Raises:
        InvalidRecord: A fact cannot be used.
    """
    facts = facts_of_form(form)
    rest = [
        (name, value)
        for name, value in form.multi_items()
        if not name.startswith(PREFIX) and name != FORM_TOKEN
    ]
    told = [("facts", facts.model_dump_json())] if facts != MethodFacts() else []
    return FormData([*rest, *told])


def _shape_faults(form: FormData) -> list[dict[str, Any]]:
    """What a model of the fields cannot see: no file, a field twice."""
    faults = []
    file = form.get("file")
    if not isinstance(file, UploadFile):
        words = "Send the file in this field" + (", with a filename." if file is not None else ".")
        faults.append({"type": "missing", "loc": ("file",), "msg": words})
    if len(form.multi_items()) != len(form):
        faults.append({"type": "repeated", "loc": ("form",), "msg": "Send each field once."})
    return faults


def take_upload(
    services: Services,
    principal: Principal,
    upload: Upload,
    began_s: float,
    idempotency_key: str | None = None,
) -> tuple[SubmissionView, Quota]:
    """Store the file, then accept it in one transaction, then call a worker.

    Deadlines are judged by `began_s`, when it began to come by `time.monotonic`. The sender may
    name an upload by a key.

    Raises:
        RecordsError: It is refused, and nothing of it is kept.
    """
    fields, team_id = upload.fields, team_of(principal)
    digest = _digest_of(upload.file)
    with services.database.read() as session:  # before a byte is stored
        phase = shown_phase(session, fields.phase)
        require_acceptable(
            session,
            session.get_one(Team, team_id),
            phase,
            digest,
            linked_to=fields.linked_to or None,
            arrived_at=_arrived_at(session, began_s),
            idempotency_key=idempotency_key,
            asks_first=fields.asks_first,
        )
        _require_store(session, services.files)
    size_bytes = _store(services, upload.file)
    try:
        with services.database.write() as session:
            require_unrevoked(session, principal)
            if not is_kept(session, services.files, digest):
                _store(services, upload.file)
            accepted = accept(
                session,
                team_id=team_id,
                phase_id=fields.phase,
                method=fields.method,
                description=fields.description,
                links=fields.links,
                facts=fields.method_facts,
                linked_to=fields.linked_to or None,
                file_digest=digest,
                size_bytes=size_bytes,
                arrived_at=_arrived_at(session, began_s),
                idempotency_key=idempotency_key,
                asks_first=fields.asks_first,
            )
    except RecordsError:
        with suppress(StoreError):  # then it is swept when it is old
            remove_orphan(services.database, services.files, digest)
        raise
    _log.info(
        "upload accepted",
        submission=accepted.submission.id,
        job=accepted.job_id,
        is_duplicate=accepted.is_duplicate,
    )
    if accepted.job_id is not None:
        # where the broker is away the reconciler does it soon, and shows as queued what still waits
        services.dispatcher.wake(Lane.LIVE)
    with services.database.read() as session:
        taken = view(session, accepted.submission, is_duplicate=accepted.is_duplicate)
        return told_to(principal, taken), quota_of(session, team_id, phase)


def _require_store(session: Session, files: FileStore) -> None:
    """Put nothing where the last room is needed by records, or where earlier files should lie and do not.

    Raises:
        StoreError: It is so.
    """
    if not files.has_room():
        raise StoreError("The server has no room for the file now; try again later.")
    if seems_unmounted(session, files):
        raise StoreError("The file store does not answer; try again later.")


def told_to(principal: Principal, seen: SubmissionView) -> SubmissionView:
    """Return what the sender may see: without `read:own` neither scores nor ranks."""
    if Scope.READ_OWN in principal.scopes:
        return seen
    report = seen.report
    if report is not None and report.to_confirm:  # names the replaced entry with its score
        report = report.model_copy(update={"to_confirm": _ASKED_OF_READERS})
    return seen.model_copy(update={**NO_RESULTS, "report": report})


def _arrived_at(session: Session, began_s: float) -> datetime:
    """When the first byte came, by the database's clock."""
    return database_now(session) - timedelta(seconds=time.monotonic() - began_s)


def _digest_of(stream: BinaryIO) -> str:
    stream.seek(0)
    return pieces_digest(iter(lambda: stream.read(CHUNK_BYTES), b""))


def _store(services: Services, stream: BinaryIO) -> int:
    """Store the whole file, from its beginning; return its size."""
    stream.seek(0)
    parts = iter(lambda: stream.read(CHUNK_BYTES), b"")
    limit = services.settings.max_upload_bytes
    _, size_bytes = services.files.put_stream(parts, limit_bytes=limit)
    if size_bytes == 0:
        raise UploadEmpty
    return size_bytes
