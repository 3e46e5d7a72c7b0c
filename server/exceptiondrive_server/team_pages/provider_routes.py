"""Sign in through the OpenID provider: off to it, and back from it."""

from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_records.page_sessions import open_person_session
from exceptiondrive_records.people import Identity, welcome_person
from exceptiondrive_records.sign_in_limits import count_attempt, give_attempt_back, keys_of
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.browser_session import require_private_channel
from exceptiondrive_server.pages.site import safe_back
from exceptiondrive_server.problem_vocabulary import ApiProblem
from exceptiondrive_server.services import Services
from exceptiondrive_server.sign_in_provider import CALLBACK, ProviderAway, SignInRefused
from exceptiondrive_server.team_pages.sign_in_routes import HERE, enter, show_form

if TYPE_CHECKING:
    from exceptiondrive_server.oidc import Provider

router = APIRouter(include_in_schema=False)
Text = Annotated[str, Query(max_length=4000)]
AWAY = "{} does not answer. Try again in a minute, or sign in with your team's token."
REFUSED = "{} did not sign you in. Begin again; if that does not help, tell an organizer."
CANCELLED = "You were not signed in: the sign-in at {} was called off."
STALE = "This sign-in was not begun in this browser, or is too old. Begin again."


@router.get("/sign-in/provider")
async def send_to_provider(request: Request, services: ServicesOf, back: Text = HERE) -> Response:
    """Send the browser to the provider. A link, no form: our own CSP binds forms to this site."""
    require_private_channel(request)
    provider = _provider(services)
    await run_in_threadpool(_count, services, request)
    try:
        url = await provider.begin(request, safe_back(back))
    except ProviderAway:
        return show_form(request, back, status=503, fault=AWAY.format(provider.name))
    return RedirectResponse(url, status_code=303, headers={"Cache-Control": "no-store"})


@router.get(CALLBACK)
async def come_back(
    request: Request, services: ServicesOf, state: Text = "", code: Text = "", error: Text = ""
) -> Response:
    """Open a session for whom the provider vouches for; every failure ends the flow."""
    require_private_channel(request)
    provider = _provider(services)
    back = await provider.way_back(request)
    if back is None:
        return show_form(request, HERE, status=400, fault=STALE)
    if error:
        request.session.clear()
        return show_form(request, back, status=403, fault=CANCELLED.format(provider.name))
    try:
        identity = await provider.identity(request)
        opened = await run_in_threadpool(_session_for, services, identity, request)
    except ProviderAway:
        return show_form(request, back, status=503, fault=AWAY.format(provider.name))
    except (SignInRefused, InvalidRecord):
        return show_form(request, back, status=401, fault=REFUSED.format(provider.name))
    return enter(request, back, *opened)


def _session_for(services: Services, identity: Identity, request: Request) -> tuple[str, bool]:
    """Return the secret of a new session, and whether an organizer signed in."""
    with services.database.write() as session:
        give_attempt_back(session, _limits(request))
        person = welcome_person(session, identity)
        return open_person_session(session, person), person.is_organizer


def _count(services: Services, request: Request) -> None:
    with services.database.write() as session:
        count_attempt(session, _limits(request))


def _limits(request: Request) -> dict[str, int]:
    return keys_of(request.client.host if request.client else "unknown", "")


def _provider(services: Services) -> "Provider":
    if services.provider is None:
        detail = "People do not sign in through a provider here; use your team's token."
        raise ApiProblem(ProblemCode.NOT_FOUND, detail)
    return services.provider
