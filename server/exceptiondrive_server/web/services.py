"""The services that routes use, created once per application and closed with it."""

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fastapi import Request
from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.site import in_preparation, site_links
from exceptiondrive_records.operations.status import scoring_delay
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.work.dispatch import Dispatcher
from exceptiondrive_schemas.api.site import SiteLinks
from exceptiondrive_server.submissions.receipts import ReceiptSigner
from exceptiondrive_server.web.kept_pages import KeptPages
from exceptiondrive_server.web.limits.upload_places import UploadPlaces
from exceptiondrive_server.web.metrics import RequestMetrics
from exceptiondrive_server.web.polls import Polls
from exceptiondrive_server.web.settings import ServerSettings

if TYPE_CHECKING:
    from exceptiondrive_server.accounts.oidc import Provider

MAX_AGE_S = 1.0
"""How old what every page says of the site may be."""


class SiteState:
    """Links, and whether scoring is delayed; while the records are away, what they said last."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._said = (SiteLinks(), "", "")
        self._read_at_s = -MAX_AGE_S

    def now(self) -> tuple[SiteLinks, str, str]:
        """Return the links; why scoring is delayed, or nothing; what is being made, or nothing."""
        if time.monotonic() - self._read_at_s >= MAX_AGE_S:
            try:
                with self._database.read() as session:
                    delay = scoring_delay(session)
                    self._said = site_links(session), delay, in_preparation(session)
            except SQLAlchemyError:  # pages that need no records are shown all the same
                pass
            self._read_at_s = time.monotonic()
        return self._said

    def forget(self) -> None:
        """Forget the cached value, so that the next page reads it again."""
        self._read_at_s = -MAX_AGE_S


@dataclass(frozen=True)
class Services:
    """Records, uploads, dispatcher, settings and metrics."""

    database: Database
    files: FileStore
    dispatcher: Dispatcher
    settings: ServerSettings
    signer: ReceiptSigner
    upload_places: UploadPlaces
    polls: Polls
    site_state: SiteState
    provider: "Provider | None" = None
    """Through whom people sign in, where the settings name somebody."""
    metrics: RequestMetrics = field(default_factory=RequestMetrics)
    kept_pages: KeptPages = field(default_factory=KeptPages)

    @classmethod
    def open(cls, settings: ServerSettings) -> "Services":
        """Connect to what the settings name."""
        database = Database(settings.database_url)
        files = FileStore(settings.file_store_url)
        places = UploadPlaces(settings.uploads_at_once, settings.uploads_at_once_per_team)
        metrics = RequestMetrics()
        metrics.watch(lambda: places.taken, files.free_bytes)
        return cls(
            database=database,
            files=files,
            dispatcher=Dispatcher(settings.broker_url),
            settings=settings,
            signer=ReceiptSigner(settings.receipt_key_file, database),
            upload_places=places,
            polls=Polls(settings.events_every_s),
            site_state=SiteState(database),
            provider=_provider(settings),
            metrics=metrics,
        )

    def close(self) -> None:
        """Let all connections go."""
        self.dispatcher.close()
        self.database.dispose()


def _provider(settings: ServerSettings) -> "Provider | None":
    if not settings.oidc_issuer:
        return None
    from exceptiondrive_server.accounts.oidc import Provider

    return Provider(settings)


def services_of(request: Request) -> Services:
    """Return the services of the application that answers."""
    services: Services = request.app.state.services
    return services


async def services_at_hand(request: Request) -> Services:
    """As `services_of`, for routes: what is no coroutine is called in a thread of its own."""
    return services_of(request)
