"""Sign in with a team token or through the OpenID provider; sign out.

A token is submitted once, and the browser never stores it.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Form, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.accounts.attempts import (
    count_attempt,
    give_attempt_back,
    keys_of,
    start_keys_of,
)
from exceptiondrive_records.accounts.people import Identity, welcome_person
from exceptiondrive_records.accounts.sessions import (
    end_session,
    open_person_session,
    open_token_session,
)
from exceptiondrive_records.accounts.tokens import note_use, verify_token
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.accounts.sign_in_provider import CALLBACK, ProviderAway, SignInRefused
from exceptiondrive_server.web.auth import ServicesOf, address_of
from exceptiondrive_server.web.browser_session import (
    MAX_BACK,
    MaybeSignedIn,
    forget_session,
    form_secret,
    form_token,
    keep_session,
    keep_visitor,
    posted_form,
    require_form_token,
    require_private_channel,
    require_same_origin,
)
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.responses import my_page, private_page, safe_back
from exceptiondrive_server.web.services import Services, services_of

if TYPE_CHECKING:
    from exceptiondrive_server.accounts.oidc import Provider

router = APIRouter(include_in_schema=False)
MAX_TOKEN_LENGTH = 200
REFUSED = "The token is not valid: unknown, expired or revoked."
HERE = "/my"
ORGANIZERS_HERE = "/organize"


@router.get("/sign-in")
def show_sign_in(
    request: Request,
    browser: MaybeSignedIn,
    back: Annotated[str, Query(max_length=MAX_BACK)] = HERE,
    unsaved: bool = False,
) -> Response:
    """Show the form; to who has signed in already, as whom, and the way out.

    `unsaved` says that a form was sent when nobody was signed in any more.
    """
    require_private_channel(request)
    if browser is not None:
        return my_page(browser, "accounts/signed_in.html", back=safe_back(back))
    return show_form(request, back, is_unsaved=unsaved)


@router.post("/sign-in")
def sign_in(
    request: Request,
    services: ServicesOf,
    token: Annotated[str, Form(max_length=MAX_TOKEN_LENGTH)] = "",
    back: Annotated[str, Form(max_length=MAX_BACK)] = HERE,
    given: Annotated[str, Form(alias="form_token", max_length=100)] = "",
) -> Response:
    """Open a session for the team of the token."""
    require_private_channel(request)
    require_same_origin(request)
    require_form_token(form_token(form_secret(request)), given)
    opened = _session_for(services, token.strip(), address_of(request))
    if opened is None:
        return show_form(request, back, status=401, fault=REFUSED)
    return enter(request, back, *opened)


@router.post("/sign-out")
async def sign_out(request: Request, services: ServicesOf, browser: MaybeSignedIn) -> Response:
    """End the session here and in the browser; where it had ended already, there is nothing to do."""
    require_same_origin(request)
    if browser is not None:
        await posted_form(browser)
        await run_in_threadpool(_end, services, browser.secret)
    answer = go("/")
    forget_session(answer)
    return answer


def _end(services: Services, secret: str) -> None:
    with services.database.write() as session:
        end_session(session, secret)


def _session_for(services: Services, token: str, address: str) -> tuple[str, bool] | None:
    """Count the attempt, then look at the token; a success is not counted.

    Returns the secret of the session, and whether it is an organizer's.
    """
    limits = keys_of(address, token)
    _count_attempt(services, limits)
    with services.database.read() as session:
        principal = verify_token(session, token)
    if principal is None:
        return None
    note_use(services.database, principal)
    with services.database.write() as session:
        give_attempt_back(session, limits)
        return open_token_session(session, principal), principal.role is not None


def show_form(
    request: Request, back: str, *, status: int = 200, fault: str = "", is_unsaved: bool = False
) -> Response:
    """Answer with the sign-in page, bound to the secret of the browser."""
    provider, secret = services_of(request).provider, form_secret(request)
    answer = private_page(
        request,
        "accounts/sign_in.html",
        "my",
        status=status,
        back=safe_back(back),
        fault=fault,
        is_token_refused=fault == REFUSED,
        is_unsaved=is_unsaved,
        provider=None if provider is None else provider.name,
        form_token=form_token(secret),
    )
    keep_visitor(request, answer, secret)
    return answer


def enter(request: Request, back: str, secret: str, is_organizer: bool) -> Response:
    """Set the session cookie and redirect; organizers start at their own pages."""
    answer = go(ORGANIZERS_HERE if is_organizer and back == HERE else back)
    keep_session(request, answer, secret, is_organizer=is_organizer)
    return answer


def go(path: str) -> Response:
    """Redirect to a page of this site, never elsewhere."""
    headers = {"Cache-Control": "no-store"}
    return RedirectResponse(safe_back(path), status_code=303, headers=headers)


# Sign in through the OpenID provider: off to it, and back from it.


Text = Annotated[str, Query(max_length=4000)]
AWAY = "{} does not answer. Try again in a minute, or sign in with your team's token."
REFUSED_BY_PROVIDER = (
    "{} did not sign you in. Begin again; if that does not help, tell an organizer."
)
CANCELLED = "You were not signed in: the sign-in at {} was called off."
STALE = "This sign-in was not begun in this browser, is too old, or another was begun after it. Begin again."


@router.get("/sign-in/provider")
async def send_to_provider(request: Request, services: ServicesOf, back: Text = HERE) -> Response:
    """Redirect to the provider. Reached by a link, as our CSP limits forms to this site."""
    require_private_channel(request)
    provider = _provider(services)
    await run_in_threadpool(_count_attempt, services, start_keys_of(address_of(request)))
    try:
        url = await provider.begin(request, safe_back(back))
    except ProviderAway:
        return show_form(request, back, status=503, fault=AWAY.format(provider.name))
    return RedirectResponse(url, status_code=303, headers={"Cache-Control": "no-store"})


@router.get(CALLBACK)
async def come_back(
    request: Request,
    services: ServicesOf,
    browser: MaybeSignedIn,
    state: Text = "",
    code: Text = "",
    error: Text = "",
) -> Response:
    """Open a session for the person that the provider identified; every failure ends the flow."""
    require_private_channel(request)
    provider = _provider(services)
    back = await provider.way_back(request)
    if back is None and browser is not None:  # a second click, or a second tab
        return go(HERE)
    if back is None:
        return show_form(request, HERE, status=400, fault=STALE)
    if error == "access_denied":
        request.session.clear()
        return show_form(request, back, status=403, fault=CANCELLED.format(provider.name))
    if not error:
        await run_in_threadpool(
            _count_attempt, services, _limits(request)
        )  # until it has succeeded
    try:
        identity = await provider.identity(request)
        opened = await run_in_threadpool(_session_for_person, services, identity, request)
    except ProviderAway:
        return show_form(request, back, status=503, fault=AWAY.format(provider.name))
    except (SignInRefused, InvalidRecord):
        return show_form(request, back, status=401, fault=REFUSED_BY_PROVIDER.format(provider.name))
    return enter(request, back, *opened)


def _session_for_person(
    services: Services, identity: Identity, request: Request
) -> tuple[str, bool]:
    """Return the secret of a new session, and whether an organizer signed in."""
    with services.database.write() as session:
        give_attempt_back(session, _limits(request))
        end_session(session, form_secret(request))  # an earlier one of this browser
        person = welcome_person(session, identity)
        return open_person_session(session, person), person.is_organizer


def _count_attempt(services: Services, limits: Mapping[str, int]) -> None:
    with services.database.write() as session:
        count_attempt(session, limits)


def _limits(request: Request) -> dict[str, int]:
    return keys_of(address_of(request), "")


def _provider(services: Services) -> "Provider":
    if services.provider is None:
        detail = "People do not sign in through a provider here; use your team's token."
        raise ApiProblem(ProblemCode.NOT_FOUND, detail)
    return services.provider
