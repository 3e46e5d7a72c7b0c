"""Sign in through the OpenID provider: off to it, and back from it."""

from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_records.people import Identity, welcome_person
from exceptiondrive_records.person_sessions import open_person_session
from exceptiondrive_records.sign_in_flows import begin_flow, end_flow
from exceptiondrive_records.sign_in_limits import count_attempt, give_attempt_back, keys_of
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.browser_session import (
    note_organizer,
    require_private_channel,
    set_session_cookie,
    set_visitor_cookie,
    visitor_secret,
)
from exceptiondrive_server.pages.site import safe_back
from exceptiondrive_server.problem_vocabulary import ApiProblem
from exceptiondrive_server.services import Services
from exceptiondrive_server.sign_in_provider import CALLBACK, ProviderAway, SignInRefused
from exceptiondrive_server.team_pages.sign_in_routes import (
    HERE,
    ORGANIZERS_HERE,
    go,
    show_form,
)

if TYPE_CHECKING:
    from exceptiondrive_server.oidc import Provider

router = APIRouter(include_in_schema=False)
Text = Annotated[str, Query(max_length=4000)]
AWAY = "{} does not answer. Try again in a minute, or sign in with your team's token."
REFUSED = "{} did not sign you in. Begin again; if that does not help, tell an organizer."
CANCELLED = "You were not signed in: the sign-in at {} was called off."
STALE = "This sign-in was not begun in this browser, or is too old. Begin again."


@router.get("/sign-in/provider")
def send_to_provider(request: Request, services: ServicesOf, back: Text = HERE) -> Response:
    """Send the browser to the provider. A link, no form: our own CSP binds forms to this site."""
    require_private_channel(request)
    provider = _provider(services)
    visitor = visitor_secret(request)
    with services.database.write() as session:
        count_attempt(session, _limits(request))
    with services.database.write() as session:
        flow = begin_flow(session, visitor, safe_back(back))
    try:
        url = provider.authorization_url(flow)
    except ProviderAway:
        return show_form(request, back, status=503, fault=AWAY.format(provider.name))
    answer = RedirectResponse(url, status_code=303, headers={"Cache-Control": "no-store"})
    set_visitor_cookie(request, answer, visitor)
    return answer


@router.get(CALLBACK)
def come_back(
    request: Request,
    services: ServicesOf,
    state: Text = "",
    code: Text = "",
    error: Text = "",
    iss: Text | None = None,
) -> Response:
    """Open a session for whom the provider vouches for; every failure ends the flow."""
    require_private_channel(request)
    provider = _provider(services)
    with services.database.write() as session:
        flow = end_flow(session, state, visitor_secret(request))
    if flow is None:
        return show_form(request, HERE, status=400, fault=STALE)
    if error:
        return show_form(request, flow.back, status=403, fault=CANCELLED.format(provider.name))
    try:
        if iss not in (None, provider.issuer):  # RFC 9207: an answer of another provider
            raise SignInRefused
        opened = _session_for(services, provider.identity(code, flow), request)
    except ProviderAway:
        return show_form(request, flow.back, status=503, fault=AWAY.format(provider.name))
    except (SignInRefused, InvalidRecord):
        return show_form(request, flow.back, status=401, fault=REFUSED.format(provider.name))
    secret, is_organizer = opened
    answer = go(ORGANIZERS_HERE if is_organizer and flow.back == HERE else flow.back)
    set_session_cookie(request, answer, secret)
    note_organizer(request, answer, is_organizer=is_organizer)
    return answer


def _session_for(services: Services, identity: Identity, request: Request) -> tuple[str, bool]:
    """Return the secret of a new session, and whether an organizer signed in."""
    with services.database.write() as session:
        give_attempt_back(session, _limits(request))
        person = welcome_person(session, identity)
        return open_person_session(session, person), person.is_organizer


def _limits(request: Request) -> dict[str, int]:
    return keys_of(request.client.host if request.client else "unknown", "")


def _provider(services: Services) -> "Provider":
    if services.provider is None:
        detail = "People do not sign in through a provider here; use your team's token."
        raise ApiProblem(ProblemCode.NOT_FOUND, detail)
    return services.provider
