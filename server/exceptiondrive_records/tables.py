"""Imports every table: foreign keys are resolved by name, so all tables must be loaded together."""

from exceptiondrive_records.accounts import tables as accounts
from exceptiondrive_records.audit import tables as audit
from exceptiondrive_records.boards import tables as boards
from exceptiondrive_records.news import tables as news
from exceptiondrive_records.notifications import tables as notifications
from exceptiondrive_records.participation import tables as participation
from exceptiondrive_records.phases import tables as phases
from exceptiondrive_records.protocols import tables as protocols
from exceptiondrive_records.rescoring import tables as rescoring
from exceptiondrive_records.splits import tables as splits
from exceptiondrive_records.submissions import tables as submissions
from exceptiondrive_records.teams import tables as teams
from exceptiondrive_records.work import tables as work

__all__ = [
    "accounts",
    "audit",
    "boards",
    "news",
    "notifications",
    "participation",
    "phases",
    "protocols",
    "rescoring",
    "splits",
    "submissions",
    "teams",
    "work",
]
