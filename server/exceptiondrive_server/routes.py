"""Every route of the server: the API of a noun, its pages, and who may come in."""

from fastapi import APIRouter, Depends
from starlette.routing import Match
from starlette.types import Scope

from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.accounts import api as accounts
from exceptiondrive_server.accounts import organizer_api as organizer_accounts
from exceptiondrive_server.accounts import organizer_pages as organizer_account_pages
from exceptiondrive_server.accounts import pages as account_pages
from exceptiondrive_server.accounts import token_pages
from exceptiondrive_server.audit import organizer_api as organizer_audit
from exceptiondrive_server.audit import organizer_pages as organizer_audit_pages
from exceptiondrive_server.boards import api as boards
from exceptiondrive_server.boards import organizer_api as organizer_boards
from exceptiondrive_server.boards import organizer_pages as organizer_board_pages
from exceptiondrive_server.boards import pages as board_pages
from exceptiondrive_server.boards import pictures
from exceptiondrive_server.entries import api as entries
from exceptiondrive_server.entries import pages as entry_pages
from exceptiondrive_server.guide import api as guide
from exceptiondrive_server.guide import client_files, machines
from exceptiondrive_server.guide import pages as guide_pages
from exceptiondrive_server.news import api as news
from exceptiondrive_server.news import organizer_api as organizer_news
from exceptiondrive_server.news import organizer_pages as organizer_news_pages
from exceptiondrive_server.news import pages as news_pages
from exceptiondrive_server.notifications import api as notifications
from exceptiondrive_server.notifications import pages as notification_pages
from exceptiondrive_server.operations import api as operations
from exceptiondrive_server.operations import organizer_api as organizer_operations
from exceptiondrive_server.operations import organizer_pages as organizer_operation_pages
from exceptiondrive_server.operations import pages as operation_pages
from exceptiondrive_server.participation import api as participation
from exceptiondrive_server.participation import organizer_api as organizer_participation
from exceptiondrive_server.participation import organizer_pages as organizer_participation_pages
from exceptiondrive_server.participation import pages as participation_pages
from exceptiondrive_server.phases import api as phases
from exceptiondrive_server.phases import organizer_api as organizer_phases
from exceptiondrive_server.phases import organizer_pages as organizer_phase_pages
from exceptiondrive_server.phases import pages as phase_pages
from exceptiondrive_server.protocols import api as protocols
from exceptiondrive_server.protocols import organizer_api as organizer_protocols
from exceptiondrive_server.protocols import organizer_pages as organizer_protocol_pages
from exceptiondrive_server.protocols import pages as protocol_pages
from exceptiondrive_server.rescoring import api as rescoring
from exceptiondrive_server.rescoring import organizer_api as organizer_rescoring
from exceptiondrive_server.rescoring import organizer_pages as organizer_rescoring_pages
from exceptiondrive_server.rescoring import pages as rescoring_pages
from exceptiondrive_server.splits import api as splits
from exceptiondrive_server.splits import organizer_api as organizer_splits
from exceptiondrive_server.splits import pages as split_pages
from exceptiondrive_server.submissions import api as submissions
from exceptiondrive_server.submissions import edit_pages, events, receipts_api
from exceptiondrive_server.submissions import organizer_api as organizer_submissions
from exceptiondrive_server.submissions import organizer_pages as organizer_submission_pages
from exceptiondrive_server.submissions import pages as submission_pages
from exceptiondrive_server.teams import api as teams
from exceptiondrive_server.teams import organizer_api as organizer_teams
from exceptiondrive_server.teams import organizer_pages as organizer_team_pages
from exceptiondrive_server.teams import pages as team_pages
from exceptiondrive_server.web import health, responses
from exceptiondrive_server.web.auth import organizer
from exceptiondrive_server.web.organizer_frame import signed_in_organizer
from exceptiondrive_server.web.parameters import known_parameters
from exceptiondrive_server.web.problems import problem_responses

API = "/api/v1"
_ORGANIZER_API = APIRouter(
    tags=["organizers"],
    dependencies=[Depends(organizer)],
    responses=problem_responses(
        ProblemCode.NOT_SIGNED_IN,
        ProblemCode.NOT_ALLOWED,
        ProblemCode.NOT_FOUND,
        ProblemCode.CONFLICT,
    ),
)
"""Every route demands a role (`web/organizer_rights.py`); every change leaves an audit line."""
for _part in (
    organizer_participation.router,
    organizer_news.router,
    organizer_boards.router,
    organizer_teams.router,
    organizer_accounts.router,
    organizer_splits.router,
    organizer_phases.router,
    organizer_protocols.router,
    organizer_rescoring.router,
    organizer_submissions.router,
    organizer_audit.router,
    organizer_operations.router,
):
    _ORGANIZER_API.include_router(_part)


class _Api(APIRouter):
    """The API: who asks for something else does not let FastAPI work out what its routes take."""

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Look at the routes where the path may be one of theirs."""
        return super().matches(scope) if f"{API}/" in scope["path"] else (Match.NONE, {})


_API = _Api(dependencies=[Depends(known_parameters)])
for _part in (
    phases.router,
    participation.router,
    news.router,
    splits.router,
    submissions.router,
    events.router,
    boards.router,
    entries.router,
    receipts_api.router,
    protocols.router,
    guide.router,
    accounts.me_router,
    accounts.router,
    teams.router,
    notifications.router,
    rescoring.router,
    operations.router,
):
    _API.include_router(_part)
_API.include_router(_ORGANIZER_API, prefix="/organizer")

PAGES = (
    board_pages.router,
    rescoring_pages.router,
    entry_pages.router,
    phase_pages.router,
    participation_pages.router,
    news_pages.router,
    protocol_pages.router,
    split_pages.router,
    guide_pages.router,
    machines.router,
    client_files.router,
    operation_pages.router,
    pictures.router,
    responses.router,
    account_pages.router,
    notification_pages.router,
    edit_pages.router,
    submission_pages.router,
    team_pages.router,
    token_pages.router,
)
_ORGANIZER_PAGES = (
    organizer_operation_pages.router,
    organizer_participation_pages.router,
    organizer_news_pages.router,
    organizer_board_pages.router,
    organizer_team_pages.router,
    organizer_account_pages.router,
    organizer_phase_pages.router,
    organizer_submission_pages.router,
    organizer_protocol_pages.router,
    organizer_rescoring_pages.router,
    organizer_audit_pages.router,
)

WEBHOOKS = notifications.webhooks
ROUTES = APIRouter()
"""All routes, the one that is asked for most first. FastAPI works out what a route takes and gives when one is asked for first: with one
router that is once per process, not once per application. Where a router that holds others is included without a prefix, FastAPI
works all of it out once more, for nothing: so the pages stand here one by one."""
ROUTES.include_router(board_pages.front)
ROUTES.include_router(_API, prefix=API)
ROUTES.include_router(health.router)
for _part in PAGES:
    ROUTES.include_router(_part, include_in_schema=False)
for _part in _ORGANIZER_PAGES:
    ROUTES.include_router(
        _part, include_in_schema=False, dependencies=[Depends(signed_in_organizer)]
    )
