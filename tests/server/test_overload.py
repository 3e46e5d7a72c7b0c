"""Overload: uploads beyond what one process takes at once are sent away politely."""

import asyncio

import httpx
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from exceptiondrive_server.web.body_limit import Overload

UPLOAD_PATH = "/api/v1/submissions"


def client_of(gate: asyncio.Event, at_once: int) -> httpx.AsyncClient:
    async def upload(request: Request) -> Response:
        await gate.wait()
        return PlainTextResponse("taken", 202)

    async def page(request: Request) -> Response:
        return PlainTextResponse("page")

    routes = [Route(UPLOAD_PATH, upload, methods=["POST"]), Route("/", page)]
    app = Overload(Starlette(routes=routes), at_once)
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://test")


async def test_one_upload_too_many_is_told_when_to_come_again_and_pages_are_served() -> None:
    gate = asyncio.Event()
    async with client_of(gate, at_once=2) as client:
        taken = [asyncio.create_task(client.post(UPLOAD_PATH)) for _ in range(2)]
        for _ in range(10):
            await asyncio.sleep(0)
        refused = await client.post(UPLOAD_PATH)
        assert refused.status_code == 503
        assert int(refused.headers["Retry-After"]) > 0
        assert refused.json()["code"] == "store_unavailable"
        assert (await client.get("/")).status_code == 200
        gate.set()
        assert [(await task).status_code for task in taken] == [202, 202]
        assert (await client.post(UPLOAD_PATH)).status_code == 202, "there is room again"


async def test_an_upload_that_breaks_off_leaves_its_place() -> None:
    gate = asyncio.Event()
    async with client_of(gate, at_once=1) as client:
        broken = asyncio.create_task(client.post(UPLOAD_PATH))
        for _ in range(10):
            await asyncio.sleep(0)
        assert (await client.post(UPLOAD_PATH)).status_code == 503
        broken.cancel()
        await asyncio.gather(broken, return_exceptions=True)
        gate.set()
        assert (await client.post(UPLOAD_PATH)).status_code == 202
