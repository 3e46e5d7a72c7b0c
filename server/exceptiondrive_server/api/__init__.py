"""Version 1 of the API: one noun a module, each route thin."""

from fastapi import APIRouter

from exceptiondrive_server.api import (
    boards,
    documents,
    entries,
    events,
    me,
    organizer,
    phases,
    protocols,
    receipts,
    splits,
    submissions,
)

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
    organizer,
):
    router.include_router(module.router)
