"""The review page's command and application: loopback only, one-time addresses, reviewers."""

import re
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import urlsplit

import typer
import uvicorn
from fastapi import Body, FastAPI, Form, HTTPException, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import (
    FileResponse,
    HTMLResponse,
    JSONResponse,
    PlainTextResponse,
    RedirectResponse,
)
from fastapi.staticfiles import StaticFiles
from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import ValidationError

from exceptiondrive_build.agreement import agreement
from exceptiondrive_build.cli import WorkshopFolder
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.records import person_named
from exceptiondrive_build.review_page.cards import card
from exceptiondrive_build.review_page.desk import Desk, Queue, TakenError
from exceptiondrive_build.review_page.doors import Doors
from exceptiondrive_build.review_page.leases import Holder
from exceptiondrive_build.review_page.region import measured
from exceptiondrive_build.values import Checked, Inspected, Mark, Verified
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.base import Document, faults_in

Word = TypeVar("Word", Inspected, Verified)
STATIC = Path(__file__).parent / "static"
LOOPBACK = {"127.0.0.1", "localhost"}
COOKIE = "exceptiondrive_review"
PICTURE_NAME = re.compile(r"[0-9a-f]{64}\.[a-z]{1,8}")
HELD_AT_ONCE = 4
"""The card on the screen, and those whose pictures are prefetched."""
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # forms must send their origin
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
REASONS = (
    (Mark.HAZARD_CORRECTNESS, "wrong hazard, or none"),
    (Mark.PHYSICAL_PLAUSIBILITY, "not possible"),
    (Mark.VISIBILITY, "hardly seen"),
    (Mark.CROSS_VIEW_CONSISTENCY, "views disagree"),
    (Mark.SOURCE_PRESERVATION, "the rest changed, too"),
    (Mark.CONFLICT_CLARITY, "no clear conflict"),
)
"""Reasons to reject an edit, in the order of the digit keys."""
CHECKS: tuple[tuple[Checked, str], ...] = (
    ("location", "L"),
    ("views", "V"),
    ("calibration", "K"),
    ("task", "T"),
)
"""The checks of a verification, with their keys."""
TAKEN = (
    "This card has moved on while this browser was away: somebody else has it, or has decided, or "
    "its pictures are others now. "
    "Nothing is lost; here is the next."
)


class Decision(Document):
    """A request of a browser: a card, and the decision in the form of its kind."""

    card: str
    value: dict[str, Any]


class Which(Document):
    """A request about a card."""

    card: str


def review_app(folder: Path, announce: Callable[[str], None], *, lease_s: float = 60.0) -> FastAPI:
    """Build the application of one workshop; `announce` gets each one-time key that opens it."""

    @asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        with Workshop(folder) as workshop:
            app.state.desk = Desk(workshop, lease_s)
            yield
            app.state.desk.leases.close()

    app = FastAPI(lifespan=life, openapi_url=None, docs_url=None, redoc_url=None)
    app.state.doors = Doors(announce)
    app.mount("/static", StaticFiles(directory=STATIC))
    app.middleware("http")(_guard)
    app.add_exception_handler(BuildError, _told)
    app.add_exception_handler(TakenError, _taken)
    app.add_exception_handler(HTTPException, _refused)
    app.add_exception_handler(RequestValidationError, _not_read)
    _add_doors(app)
    _add_pages(app)
    _add_cards(app)
    return app


async def _guard(request: Request, proceed: Callable[[Request], Awaitable[Response]]) -> Response:
    """Serve browsers of this machine that opened the page, and requests from no other site."""
    host = request.headers.get("host", "")
    origin = request.headers.get("origin")
    is_ours = urlsplit(f"//{host}").hostname in LOOPBACK and (
        request.method in {"GET", "HEAD"} or origin == f"http://{host}"
    )
    answer = await proceed(request) if is_ours else Response("not from here", status_code=403)
    answer.headers.update(HEADERS)
    answer.headers.setdefault("Cache-Control", "no-store")
    return answer


async def _told(request: Request, error: Exception) -> Response:
    sentence = f"{error.sentence} {error.advice}" if isinstance(error, BuildError) else str(error)
    if not request.url.path.startswith("/api/"):
        return PlainTextResponse(sentence.strip(), status_code=422)
    return JSONResponse({"sentence": sentence.strip()}, status_code=422)


async def _taken(_: Request, __: Exception) -> Response:
    return JSONResponse({"sentence": TAKEN}, status_code=409)


async def _refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"sentence": error.detail}, error.status_code)


async def _not_read(_: Request, __: Exception) -> Response:
    return JSONResponse({"sentence": "This is nothing that the page sends."}, status_code=422)


_TEMPLATES = Environment(
    loader=PackageLoader("exceptiondrive_build.review_page"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def _page(template: str, status_code: int = 200, **values: object) -> HTMLResponse:
    return HTMLResponse(_TEMPLATES.get_template(template).render(**values), status_code)


def _desk(request: Request) -> Desk:
    desk: Desk = request.app.state.desk
    return desk


def _doors(request: Request) -> Doors:
    doors: Doors = request.app.state.doors
    return doors


def _holder(request: Request) -> Holder:
    """Return the signed-in reviewer of a request.

    Raises:
        HTTPException: Nobody is signed in.
    """
    holder = _doors(request).holder(request.cookies.get(COOKIE))
    if holder is None or not holder.reviewer:
        raise HTTPException(403, "Open the address that the terminal shows, and sign in.")
    return Holder(holder.browser + request.headers.get("x-tab", "")[:32], holder.reviewer)


def _read(model: type[Word], value: dict[str, Any]) -> Word:
    try:
        return model.model_validate(value, strict=False)  # JSON has no tuples
    except ValidationError as error:
        raise BuildError(f"{faults_in(error)[0]}.") from None


def _add_doors(app: FastAPI) -> None:
    @app.get("/open/{key}")
    async def open_(request: Request, key: str) -> Response:
        session = _doors(request).open(key)
        if session is None:
            return _page("closed.html", 403, spent=True)
        answer = RedirectResponse("/", status_code=303)
        answer.set_cookie(COOKIE, session, httponly=True, samesite="strict")
        return answer

    @app.post("/sign-in")
    async def sign_in(request: Request, name: Annotated[str, Form()] = "") -> Response:
        session = request.cookies.get(COOKIE)
        if session is None or _doors(request).holder(session) is None:
            return _page("closed.html", 403, spent=False)
        try:
            reviewer = person_named(name)
        except BuildError as error:
            return _page("sign_in.html", 422, problem=error.sentence)
        _doors(request).sign_in(session, reviewer)
        return RedirectResponse("/", status_code=303)

    @app.post("/sign-out")
    async def sign_out(request: Request) -> Response:
        _holder(request)
        _doors(request).sign_out(request.cookies[COOKIE])
        answer = RedirectResponse("/", status_code=303)
        answer.delete_cookie(COOKIE)
        return answer

    @app.post("/api/address")
    async def address(request: Request) -> dict[str, str]:
        """An address for one more browser."""
        _holder(request)
        return {"address": f"http://{request.headers['host']}/open/{_doors(request).new_key()}"}


def _add_pages(app: FastAPI) -> None:
    @app.get("/")
    async def home(request: Request) -> Response:
        holder = _doors(request).holder(request.cookies.get(COOKIE))
        if holder is None:
            return _page("closed.html", 403, spent=False)
        if not holder.reviewer:
            return _page("sign_in.html", problem="")
        desk = _desk(request)
        desk.refresh()
        verifications = {card: desk.standing("verify", card) for card in desk.candidates}
        return _page(
            "home.html",
            reviewer=holder.reviewer,
            title=desk.workshop.settings.title,
            inspect=desk.progress("inspect", holder.reviewer),
            verify=desk.progress("verify", holder.reviewer),
            agreement=agreement(verifications, desk.workshop.settings.verify),
            limits=desk.workshop.settings.verify,
        )

    @app.get("/inspect")
    @app.get("/verify")
    async def cards(request: Request) -> Response:
        queue = request.url.path.removeprefix("/")
        holder = _doors(request).holder(request.cookies.get(COOKIE))
        if holder is None or not holder.reviewer:
            return RedirectResponse("/", status_code=303)
        return _page(
            f"{queue}.html",
            reviewer=holder.reviewer,
            queue=queue,
            tab=secrets.token_hex(8),
            lease_s=_desk(request).leases.lease_s,
            reasons=REASONS,
            checks=CHECKS,
        )

    @app.get("/pictures/{name}")
    async def picture(request: Request, name: str) -> Response:
        _holder(request)
        path = _desk(request).workshop.image_path(name)
        if not PICTURE_NAME.fullmatch(name) or not path.is_file():
            raise HTTPException(404, "No such picture.")
        return FileResponse(path, headers={"Cache-Control": "private, max-age=86400, immutable"})


def _add_cards(app: FastAPI) -> None:
    @app.post("/api/{queue}/claim")
    async def claim(
        request: Request, queue: Queue, have: Annotated[int, Body(embed=True, ge=0)]
    ) -> dict[str, Any]:
        """Cards for this browser, up to as many as it may hold, and how far the queue is."""
        holder, desk = _holder(request), _desk(request)
        taken = desk.claim(queue, holder, max(HELD_AT_ONCE - have, 0))
        return {
            "cards": [card(desk, queue, sample_id) for sample_id in taken],
            "progress": asdict(desk.progress(queue, holder.reviewer)),
        }

    @app.post("/api/{queue}/decide")
    async def decide(request: Request, queue: Queue, decision: Decision) -> dict[str, Any]:
        holder, desk = _holder(request), _desk(request)
        told = decision.value
        value = _read(Inspected, told) if queue == "inspect" else _read(Verified, told)
        desk.decide(queue, decision.card, holder, value)
        return {"kept": decision.card}

    @app.post("/api/{queue}/skip")
    async def skip(request: Request, queue: Queue, which: Which) -> dict[str, Any]:
        _desk(request).skip(queue, which.card, _holder(request))
        return {"skipped": which.card}

    @app.post("/api/{queue}/undo")
    async def undo(request: Request, queue: Queue) -> dict[str, Any]:
        """The newest decision of this person taken back, and its card as it was left."""
        holder, desk = _holder(request), _desk(request)
        found = desk.undo(queue, holder)
        if found is None:
            return {"card": None, "value": None}
        sample_id, record = found
        return {"card": card(desk, queue, sample_id), "value": record.value}

    @app.post("/api/verify/measure")
    async def measure(request: Request, decision: Decision) -> dict[str, Any]:
        _holder(request)
        desk, corners = _desk(request), _read(Verified, decision.value).corners
        if decision.card not in desk.candidates or corners is None:
            raise TakenError
        recorded = desk.candidates[decision.card].keyframe.recorded
        return measured(corners, recorded, desk.workshop.protocol)

    @app.post("/api/{what}")
    async def lease(request: Request, what: Literal["keep", "leave"]) -> dict[str, Any]:
        """A sign of life of a browser, or its good-bye."""
        holder, leases = _holder(request), _desk(request).leases
        if what == "keep":
            leases.renew(holder)
        else:
            leases.give_back(holder)
        return {}


def review(
    workshop: WorkshopFolder = Path(),
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: any free one.")] = 8400,
    lease_s: Annotated[
        float, typer.Option(min=1, help="How long a card waits for a browser that died.")
    ] = 60.0,
) -> None:
    """Serve the review page on this machine; each browser opens it by an address that works once."""
    Workshop(workshop).records.close()
    try:
        listening = socket.create_server(("127.0.0.1", port))
    except OSError as error:
        advice = "Give another --port, or 0 for any free one."
        raise BuildError(f"Port {port}: {error.strerror}.", advice) from None
    at = listening.getsockname()[1]

    def announce(key: str) -> None:
        typer.echo(f"for the next browser: http://127.0.0.1:{at}/open/{key}")

    with listening:
        app = review_app(workshop, announce, lease_s=lease_s)
        uvicorn.Server(uvicorn.Config(app, log_level="warning")).run(sockets=[listening])
