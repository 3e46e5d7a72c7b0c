"""The application: wiring and nothing else."""

import gc
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from exceptiondrive_records.db.settings import load_settings
from exceptiondrive_records.operations.logs import set_up_logs
from exceptiondrive_server.routes import ROUTES, WEBHOOKS
from exceptiondrive_server.web.browser_session import lead_browsers
from exceptiondrive_server.web.compression import PublicCompression
from exceptiondrive_server.web.limits.body_limit import RequestLimits
from exceptiondrive_server.web.limits.page_places import PagePlaces
from exceptiondrive_server.web.middleware import HeadRequests, RequestContext
from exceptiondrive_server.web.openapi import describe
from exceptiondrive_server.web.problems import install_problem_handlers
from exceptiondrive_server.web.services import Services
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_server.web.static_files import mount_static

API_VERSION = "1.0"
MULTIPART_OVERHEAD_BYTES = 64 * 1024
"""Form fields and boundaries around the file of an upload."""


def create_app(settings: ServerSettings) -> FastAPI:
    """Return the application with these settings."""
    app = FastAPI(
        title="ExceptionDrive leaderboard",
        version=API_VERSION,
        description="Submit trajectory files, follow their scoring, read the boards. "
        "Errors are RFC 9457 problems; what is no request (400, 431) or comes too slowly (408) may be "
        "answered in plain text. Below /api a parameter or field of a body that is not named here is refused (400), so "
        "that a typing error asks for nothing else. Times are in UTC. Answers may gain fields, and an enum of an answer words: "
        "ignore what you do not know.",
        openapi_url="/api/v1/openapi.json",
        docs_url=None,
        redoc_url=None,
        lifespan=_lifespan,
        webhooks=WEBHOOKS,
        redirect_slashes=False,  # such a redirect repeats the Host header
    )
    services = Services.open(settings)
    app.state.services = services
    limit_bytes = settings.max_upload_bytes + MULTIPART_OVERHEAD_BYTES
    if services.provider is not None:
        services.provider.keep_flows(app)
    app.add_middleware(RequestLimits, upload_limit_bytes=limit_bytes)
    app.add_middleware(PagePlaces)
    app.add_middleware(RequestContext, metrics=services.metrics)
    app.add_middleware(PublicCompression)  # outside of what says who may keep an answer
    app.add_middleware(HeadRequests)  # added last: the outermost
    install_problem_handlers(app)
    mount_static(app)  # before all that has to be worked out
    app.router.routes.extend(ROUTES.routes)
    lead_browsers(app)
    app.openapi = lambda: describe(app)  # type: ignore[method-assign]
    return app


def app_from_environment() -> FastAPI:
    """Return the application that the environment describes, for `uvicorn --factory`."""
    set_up_logs(sys.stdout)
    application = create_app(load_settings(ServerSettings))
    gc.freeze()  # it stays to the end: the collector of cycles need not look at it
    return application


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    yield
    app.state.services.close()
