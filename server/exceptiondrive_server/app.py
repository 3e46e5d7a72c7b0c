"""The application: wiring and nothing else."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from exceptiondrive_records.settings import load_settings
from exceptiondrive_schemas.problems import Problem
from exceptiondrive_server import api, health, pages
from exceptiondrive_server.logs import set_up_logs
from exceptiondrive_server.middleware import RequestContext
from exceptiondrive_server.problems import install_problem_handlers
from exceptiondrive_server.services import Services
from exceptiondrive_server.settings import ServerSettings

API_VERSION = "1.0"
MULTIPART_OVERHEAD_BYTES = 64 * 1024
"""Form fields and boundaries around the file of an upload."""


def create_app(settings: ServerSettings) -> FastAPI:
    """Return the application over what the settings name."""
    app = FastAPI(
        title="ExceptionDrive leaderboard",
        version=API_VERSION,
        description="Submit trajectory files, follow their scoring, read the boards. "
        "Errors are RFC 9457 problems.",
        openapi_url="/api/v1/openapi.json",
        docs_url=None,
        redoc_url=None,
        lifespan=_lifespan,
        max_body_size=settings.max_upload_bytes + MULTIPART_OVERHEAD_BYTES,
    )
    app.state.services = Services.open(settings)
    app.add_middleware(RequestContext)
    install_problem_handlers(app)
    app.include_router(api.router)
    app.include_router(health.router)
    app.include_router(pages.router)
    pages.mount_static(app)
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


def app_from_environment() -> FastAPI:
    """Return the application that the environment describes, for `uvicorn --factory`."""
    set_up_logs()
    return create_app(load_settings(ServerSettings))


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    yield
    app.state.services.close()


def _openapi(app: FastAPI) -> dict[str, Any]:
    """Describe the API; every error response refers to the one problem document."""
    if app.openapi_schema is None:
        document = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description,
            routes=app.routes,
        )
        schemas = document["components"]["schemas"]
        problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas.update(problem.pop("$defs", {}))
        schemas["Problem"] = problem
        _drop_validation_errors(document)
        app.openapi_schema = document
    return app.openapi_schema


def _drop_validation_errors(document: dict[str, Any]) -> None:
    """Invalid requests are answered with problems of status 400, never with FastAPI's 422."""
    for operations in document["paths"].values():
        for operation in operations.values():
            operation["responses"].pop("422", None)
    for name in ("HTTPValidationError", "ValidationError"):
        document["components"]["schemas"].pop(name, None)
