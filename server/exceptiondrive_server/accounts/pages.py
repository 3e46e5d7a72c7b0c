"""Sign in with a team token, sign out. The token is seen once and never kept by the browser.

`show_form` is the page of both ways to sign in; `provider_routes` holds the other one.
"""

from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Form, Query, Request
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.accounts.people import Identity, welcome_person
from exceptiondrive_records.accounts.sessions import (
    end_page_session,
    end_person_session,
    open_page_session,
    open_person_session,
)
from exceptiondrive_records.accounts.sign_in import (
    begin_flow,
    count_attempt,
    end_flow,
    give_attempt_back,
    keys_of,
)
from exceptiondrive_records.accounts.tokens import note_use, verify_token
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.accounts.browser_session import (
    Browser,
    MaybeSignedIn,
    PostedForm,
    forget_cookies,
    form_token,
    note_organizer,
    require_form_token,
    require_private_channel,
    require_same_origin,
    set_session_cookie,
    set_visitor_cookie,
    visitor_secret,
)
from exceptiondrive_server.accounts.oidc import CALLBACK, ProviderAway, SignInRefused
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.responses import private_page, safe_back
from exceptiondrive_server.web.services import Services, services_of

router = APIRouter(include_in_schema=False)
MAX_TOKEN_LENGTH = 200
REFUSED = "The token is not valid: unknown, expired or revoked."
HERE = "/my"
ORGANIZERS_HERE = "/organize"


@router.get("/sign-in")
def show_sign_in(
    request: Request,
    browser: MaybeSignedIn,
    back: Annotated[str, Query(max_length=2000)] = HERE,
) -> Response:
    """Show the form, or go on when somebody has signed in already."""
    require_private_channel(request)
    if browser is not None:
        return go(back)
    return show_form(request, back)


@router.post("/sign-in")
def sign_in(
    request: Request,
    services: ServicesOf,
    token: Annotated[str, Form(max_length=MAX_TOKEN_LENGTH)] = "",
    back: Annotated[str, Form(max_length=2000)] = HERE,
    given: Annotated[str, Form(alias="form_token", max_length=100)] = "",
) -> Response:
    """Open a session for the team of the token."""
    require_private_channel(request)
    require_same_origin(request)
    require_form_token(visitor_secret(request), given)
    address = request.client.host if request.client else "unknown"
    opened = _session_for(services, token.strip(), address)
    if opened is None:
        return show_form(request, back, status=401, fault=REFUSED)
    secret, is_organizer = opened
    answer = go(ORGANIZERS_HERE if is_organizer and back == HERE else back)
    set_session_cookie(request, answer, secret)
    note_organizer(request, answer, is_organizer=is_organizer)
    return answer


@router.post("/sign-out")
def sign_out(services: ServicesOf, browser: Browser, form: PostedForm) -> Response:
    """End the session here and in the browser."""
    with services.database.write() as session:
        end_page_session(session, browser.secret)
        end_person_session(session, browser.secret)
    answer = go("/")
    forget_cookies(answer)
    return answer


def _session_for(services: Services, token: str, address: str) -> tuple[str, bool] | None:
    """Count the attempt, then look at the token; a success is not counted.

    Returns the secret of the session, and whether it is an organizer's.
    """
    limits = keys_of(address, token)
    with services.database.write() as session:
        count_attempt(session, limits)
    with services.database.read() as session:
        principal = verify_token(session, token)
    if principal is None:
        return None
    note_use(services.database, principal)
    with services.database.write() as session:
        give_attempt_back(session, limits)
        return open_page_session(session, principal), principal.is_organizer


def show_form(request: Request, back: str, *, status: int = 200, fault: str = "") -> Response:
    """Answer with the sign-in page, bound to the secret of the visitor."""
    provider = services_of(request).provider
    secret = visitor_secret(request)
    answer = private_page(
        request,
        "accounts/sign_in.html",
        "my",
        status=status,
        back=safe_back(back),
        fault=fault,
        provider=None if provider is None else provider.name,
        form_token=form_token(secret),
    )
    set_visitor_cookie(request, answer, secret)
    return answer


def go(path: str) -> Response:
    """Lead to a page of this site, and nowhere else."""
    headers = {"Cache-Control": "no-store"}
    return RedirectResponse(safe_back(path), status_code=303, headers=headers)


# Sign in through the OpenID provider: off to it, and back from it.


if TYPE_CHECKING:
    from exceptiondrive_server.accounts.oidc import Provider
Text = Annotated[str, Query(max_length=4000)]
AWAY = "{} does not answer. Try again in a minute, or sign in with your team's token."
REFUSED_BY_PROVIDER = (
    "{} did not sign you in. Begin again; if that does not help, tell an organizer."
)
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
        opened = _session_for_person(services, provider.identity(code, flow), request)
    except ProviderAway:
        return show_form(request, flow.back, status=503, fault=AWAY.format(provider.name))
    except (SignInRefused, InvalidRecord):
        return show_form(
            request, flow.back, status=401, fault=REFUSED_BY_PROVIDER.format(provider.name)
        )
    secret, is_organizer = opened
    answer = go(ORGANIZERS_HERE if is_organizer and flow.back == HERE else flow.back)
    set_session_cookie(request, answer, secret)
    note_organizer(request, answer, is_organizer=is_organizer)
    return answer


def _session_for_person(
    services: Services, identity: Identity, request: Request
) -> tuple[str, bool]:
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
