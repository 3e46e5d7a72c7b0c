"""Version 1 of the API: one noun a module, each route thin."""

from fastapi import APIRouter

from exceptiondrive_server.api import (
    boards,
    documents,
    entries,
    events,
    me,
    notifications,
    organizer,
    phases,
    protocols,
    receipts,
    registrations,
    rescoring,
    splits,
    submissions,
    tokens,
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
    tokens,
    registrations,
    notifications,
    rescoring,
    organizer,
):
    router.include_router(module.router)
