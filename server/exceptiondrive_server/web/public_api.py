"""Version 1 of the API: one noun a module, each route thin."""

from fastapi import APIRouter

from exceptiondrive_server.accounts import api as me
from exceptiondrive_server.accounts import api as tokens
from exceptiondrive_server.boards import api as boards
from exceptiondrive_server.entries import api as entries
from exceptiondrive_server.notifications import api as notifications
from exceptiondrive_server.phases import api as phases
from exceptiondrive_server.protocols import api as protocols
from exceptiondrive_server.rescoring import api as rescoring
from exceptiondrive_server.splits import api as splits
from exceptiondrive_server.submissions import api as submissions
from exceptiondrive_server.submissions import events
from exceptiondrive_server.submissions import receipts_api as receipts
from exceptiondrive_server.teams import api as registrations
from exceptiondrive_server.web import documents
from exceptiondrive_server.web import organizer_api as organizer

router = APIRouter(prefix="/api/v1")
for module in (
    phases,
    splits,
    submissions,
    events,
    boards,
    entries,
    receipts,
    protocols,
    documents,
    me,
    tokens,
    registrations,
    notifications,
    rescoring,
    organizer,
):
    router.include_router(module.router)
