"""The site: server-rendered pages, their drawings and static files."""

from fastapi import APIRouter

from exceptiondrive_server.boards.pages import router as _board
from exceptiondrive_server.boards.pictures import router as _pictures
from exceptiondrive_server.entries.pages import router as _entry
from exceptiondrive_server.web.guide_pages import router as _guide
from exceptiondrive_server.web.responses import mount_static, problem_page
from exceptiondrive_server.web.responses import router as _theme

__all__ = ["mount_static", "problem_page", "router"]

router = APIRouter(include_in_schema=False)
for _part in (_board, _entry, _guide, _pictures, _theme):
    router.include_router(_part)
