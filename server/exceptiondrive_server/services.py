"""What routes work with: made once per application, closed with it."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fastapi import Request

from exceptiondrive_records.database import Database
from exceptiondrive_records.file_store import FileStore
from exceptiondrive_records.work.dispatch import Dispatcher
from exceptiondrive_server.metrics import RequestMetrics
from exceptiondrive_server.receipts import ReceiptSigner
from exceptiondrive_server.settings import ServerSettings
from exceptiondrive_server.sign_in_provider import CALLBACK

if TYPE_CHECKING:
    from exceptiondrive_server.oidc import Provider


@dataclass(frozen=True)
class Services:
    """Records, uploads, dispatcher, settings and metrics."""

    database: Database
    files: FileStore
    dispatcher: Dispatcher
    settings: ServerSettings
    signer: ReceiptSigner
    provider: "Provider | None" = None
    """Through whom people sign in, where the settings name somebody."""
    metrics: RequestMetrics = field(default_factory=RequestMetrics)

    @classmethod
    def open(cls, settings: ServerSettings) -> "Services":
        """Connect to what the settings name."""
        database = Database(settings.database_url)
        return cls(
            database=database,
            files=FileStore(settings.file_store_url),
            dispatcher=Dispatcher(settings.broker_url),
            settings=settings,
            signer=ReceiptSigner(settings.receipt_key_file, database),
            provider=_provider(settings),
        )

    def close(self) -> None:
        """Let all connections go."""
        self.dispatcher.close()
        self.database.dispose()


def _provider(settings: ServerSettings) -> "Provider | None":
    if not settings.oidc_issuer:
        return None
    from exceptiondrive_server.oidc import Provider  # takes a third of a second

    return Provider(
        issuer=settings.oidc_issuer,
        client_id=settings.oidc_client_id,
        client_secret=settings.oidc_client_secret.get_secret_value(),
        redirect_uri=settings.public_url.rstrip("/") + CALLBACK,
        name=settings.oidc_name,
    )


def services_of(request: Request) -> Services:
    """Return the services of the application that answers."""
    services: Services = request.app.state.services
    return services
