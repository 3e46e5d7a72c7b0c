"""Health checks: liveness, readiness, and their metrics."""

from contextlib import suppress

import structlog
from fastapi import APIRouter
from fastapi.responses import JSONResponse, Response
from kombu import Connection
from kombu.exceptions import KombuError
from pydantic import BaseModel
from sqlalchemy import text
from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.migrations import is_usable
from exceptiondrive_records.submissions.file_store import seems_unmounted
from exceptiondrive_records.work.dispatch import transport_options
from exceptiondrive_records.work.heartbeats import live_workers
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.metrics import exposition
from exceptiondrive_server.web.services import Services

_log = structlog.get_logger("exceptiondrive.server")
router = APIRouter(tags=["health"])
PROBE_TIMEOUT_S = 1


class Health(BaseModel):
    """The process answers."""

    status: str = "alive"


class Readiness(BaseModel):
    """What the server needs, part by part, and whether workers are alive."""

    is_ready: bool
    database: bool
    file_store: bool
    broker: bool
    live_workers: int | None
    """None: records that are away or read only do not tell."""
    note: str


@router.get("/healthz", operation_id="health")
async def healthz() -> Health:
    """Tell that the process answers; it waits for no thread."""
    return Health()


@router.get(
    "/readyz",
    operation_id="readiness",
    response_model=Readiness,
    responses={503: {"model": Readiness, "description": "Uploads cannot be accepted."}},
)
def readyz(services: ServicesOf) -> Response:
    """Tell whether uploads can be accepted; 503 if not.

    A broker or worker that is away delays scoring but loses nothing: uploads are still accepted.
    """
    workers = _workers(services)
    database, store = workers is not None, _takes_files(services)
    broker = _broker_answers(services.settings.broker_url)
    notes = {
        "Uploads are refused: the records are away, read-only or of an older release.": not database,
        "Uploads are refused: the file store is away, full or read-only.": not store,
        "Scoring is delayed: no broker or no worker is alive.": not broker or workers == 0,
    }
    readiness = Readiness(
        is_ready=database and store,
        database=database,
        file_store=store,
        broker=broker,
        live_workers=workers,
        note=" ".join(note for note, is_so in notes.items() if is_so),
    )
    if not readiness.is_ready:
        _log.warning("not ready", note=readiness.note)
    return JSONResponse(readiness.model_dump(), status_code=200 if readiness.is_ready else 503)


@router.get(
    "/metrics",
    operation_id="metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def metrics(services: ServicesOf) -> Response:
    """Metrics for Prometheus; a reverse proxy keeps them inside."""
    services.metrics.ready.set(_workers(services) is not None and _takes_files(services))
    return Response(
        exposition(services.metrics, services.database), media_type="text/plain; version=0.0.4"
    )


def _workers(services: Services) -> int | None:
    """Live workers, or None when the records do not answer, are read only or have an older schema."""
    try:
        if not is_usable(services.database) or not services.database.takes_writes():
            return None
        with services.database.read() as session:
            session.execute(text("SELECT 1"))
            return live_workers(session, Lane.LIVE)
    except SQLAlchemyError:
        return None


def _takes_files(services: Services) -> bool:
    with suppress(SQLAlchemyError), services.database.read() as session:
        if seems_unmounted(session, services.files):
            return False
    return services.files.takes_files()


def _broker_answers(broker_url: str) -> bool:
    options = transport_options(socket_timeout_s=PROBE_TIMEOUT_S)
    with Connection(broker_url, transport_options=options) as connection:
        try:
            connection.ensure_connection(max_retries=1, interval_start=0, timeout=PROBE_TIMEOUT_S)
        except (KombuError, OSError, ConnectionError):
            return False
    return True
