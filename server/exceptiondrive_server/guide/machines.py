"""Files that machines request from every site: robots.txt, sitemap, icons."""

import struct
from functools import cache
from urllib.parse import quote, urlencode
from xml.sax.saxutils import escape

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse, Response
from resvg_py import svg_to_bytes

from exceptiondrive_records.boards.boards import entry_ids
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.protocols.shown import shown_protocols
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.etag import conditional
from exceptiondrive_server.web.responses import origin_of
from exceptiondrive_server.web.static_files import STATIC

router = APIRouter(include_in_schema=False)
PRIVATE = ("/my", "/organize", "/sign-in", "/submissions")
"""What a visitor is led away from."""
DAY_S = 86_400


@router.get("/robots.txt")
def robots(request: Request) -> Response:
    """Say what is worth no look, and where the list of the rest is."""
    lines = ["User-agent: *", *(f"Disallow: {path}" for path in PRIVATE)]
    return PlainTextResponse("\n".join([*lines, f"Sitemap: {origin_of(request)}/sitemap.xml", ""]))


@router.get("/sitemap.xml")
def sitemap(request: Request, services: ServicesOf) -> Response:
    """List the pages of what is shown now: phases, their entries, protocols."""
    paths = ["/", "/compare", "/submit", "/api", "/problems", "/status", "/privacy"]
    with services.database.read() as session:
        for phase in list_phases(session):
            query = urlencode({"phase": phase.id})
            paths += [f"/?{query}", f"/phases/{quote(phase.id)}", f"/history?{query}"]
            if phase.current_board_id is not None:
                entries = entry_ids(session, phase.current_board_id)
                paths += [f"/entries/{entry}" for entry in sorted(entries)]
        paths += [f"/protocols/{quote(row.version)}" for row in shown_protocols(session)]
    listed = "".join(f"<url><loc>{escape(origin_of(request) + path)}</loc></url>" for path in paths)
    text = (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        f'<urlset xmlns="http://www.sitemaps.org/schemas/sitemap/0.9">{listed}</urlset>\n'
    )
    return Response(text, media_type="application/xml")


@router.get("/favicon.ico")
def favicon(request: Request) -> Response:
    """Give the icon to who knows no SVG."""
    return conditional(request, _ico(), "image/vnd.microsoft.icon", max_age_s=DAY_S)


@router.get("/apple-touch-icon.png")
def touch_icon(request: Request) -> Response:
    """Give the icon of a home screen."""
    return conditional(request, _icon(180), "image/png", max_age_s=DAY_S)


@cache
def _icon(side_px: int) -> bytes:
    """Paint the icon as PNG."""
    svg = (STATIC / "icon.svg").read_text("utf-8")
    return bytes(svg_to_bytes(svg_string=svg, width=side_px, height=side_px))


@cache
def _ico() -> bytes:
    """The icon as an ICO file that holds one PNG."""
    png, side_px = _icon(32), 32
    head = struct.pack("<HHH", 0, 1, 1)
    entry = struct.pack("<BBBBHHII", side_px, side_px, 0, 0, 1, 32, len(png), 22)
    return head + entry + png
