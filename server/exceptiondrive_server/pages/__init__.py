"""The site: server-rendered pages, their drawings and static files."""

from fastapi import APIRouter

from exceptiondrive_server.pages.board_routes import router as _board
from exceptiondrive_server.pages.entry_routes import router as _entry
from exceptiondrive_server.pages.guide_routes import router as _guide
from exceptiondrive_server.pages.picture_routes import router as _pictures
from exceptiondrive_server.pages.responses import problem_page
from exceptiondrive_server.pages.static_files import mount_static
from exceptiondrive_server.pages.theme_routes import router as _theme

__all__ = ["mount_static", "problem_page", "router"]

router = APIRouter(include_in_schema=False)
for _part in (_board, _entry, _guide, _pictures, _theme):
    router.include_router(_part)
