"""The frame of every organizer page: access, shared content, and the forms of its actions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session
from starlette.datastructures import FormData

from exceptiondrive_records.accounts.tokens import Principal
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_server.web.browser_session import Browser, Elsewhere, PostedForm, SignedIn
from exceptiondrive_server.web.forms import changed_values, filled_fields, posted_texts, read_form
from exceptiondrive_server.web.organizer_rights import may_change, require_right, what_lacks
from exceptiondrive_server.web.responses import private_page

DONE: Mapping[str, str] = {
    "team_created": "The team is created. Issue its first token below, and hand it over.",
    "team_approved": "The team is approved: it may submit.",
    "team_refused": "The registration is refused. The team and its tokens are gone.",
    "team_changed": "The team is changed. New boards show the change; earlier ones stay as they are.",
    "teams_merged": "The two teams are merged. Boards with the new entries are being built.",
    "team_forgotten": "The team is forgotten: an alias replaces its name everywhere.",
    "allowance_set": "The allowance is set, and the team is told.",
    "disqualified": "Disqualified. The next board leaves it out, and the team is told.",
    "reinstated": "Reinstated, unless another disqualification still applies: the next board shows it.",
    "message_sent": "The message is in the inboxes and on its way to the confirmed addresses.",
    "token_revoked": "The token is revoked. It no longer works.",
    "phase_created": "The phase is created.",
    "phase_created_over": "The phase is created but accepts no files: its deadline has passed. Unless "
    'you intended that, set a later one under "Closes at".',
    "nothing_changed": "Nothing was changed.",
    "site_changed": "The links are changed: every page shows them from now on.",
    "phase_changed": "The phase is changed; the audit log has the old and new values.",
    "news_published": "The news is published, and the teams are told.",
    "news_withdrawn": "The news is withdrawn: readers no longer see it.",
    "reported_imported": "The rows are imported: they are on the page of external boards, unranked.",
    "reported_withdrawn": "The rows are withdrawn: readers no longer see them.",
    "question_answered": "The question is answered.",
    "role_set": "The role is set. It applies from the next request on.",
    "person_forgotten": "The person is forgotten: only their id is kept.",
    "phase_deleted": "The phase is deleted. The audit log keeps its name and your reason.",
    "submission_retried": "The submission is queued again, with all its attempts, and the team is told.",
    "submission_verified": "A worker recomputes it; the outcome will appear below.",
    "submission_restored": "The submission is restored, and the team is told.",
    "team_told": "Sent. The team finds it among its notices.",
    "protocol_added": "The protocol is added. No score changes until you rescore with it.",
    "protocol_deleted": "The protocol is deleted; its version may be used again.",
    "protocol_known": "This exact document is already there. Nothing was added.",
    "protocol_confirmed": "The confirmation is stored. Workers accept it if its key is one of the split's.",
    "confirmation_withdrawn": "The confirmation is withdrawn.",
    "run_drafted": "The run is drafted. Nothing is scored until you start it.",
    "run_started": "Scoring has begun, behind fresh submissions.",
    "run_paused": "The run is paused: no further sheet is started.",
    "run_resumed": "The run continues, and failed sheets are tried again.",
    "run_cancelled": "The run is cancelled. The public board never changed.",
    "run_applied": "Applied: readers see the new board from now on.",
    "run_rolled_back": "Rolled back: readers see the earlier protocol's board again.",
    "run_closed": "The run is closed: the new protocol stays.",
    "verification_started": "Workers recompute the sheets from their uploads.",
}
"""What was just done, in words: addresses carry a key, never a text of their own."""
SECTIONS = (
    ("overview", "Overview", "/organize"),
    ("teams", "Teams", "/organize/teams"),
    ("phases", "Phases", "/organize/phases"),
    ("submissions", "Submissions", "/organize/submissions"),
    ("protocols", "Protocols", "/organize/protocols"),
    ("rescoring", "Rescoring", "/organize/rescoring"),
    ("news", "News", "/organize/news"),
    ("people", "People", "/organize/people"),
    ("site", "Site", "/organize/site"),
    ("audit", "Audit log", "/organize/audit"),
)


def signed_in_organizer(browser: Browser) -> SignedIn:
    """Return the organizer who signed in, if this page is for the role that they have.

    Raises:
        SignInNeeded: Nobody did.
        Elsewhere: The overview of the site was asked for, with a role for single phases.
        ApiProblem: The session is not an organizer's, or the role is not enough: 403, as the API.
    """
    if browser.request.url.path == "/organize" and browser.principal.phases:
        raise Elsewhere(f"/organize/phases/{min(browser.principal.phases)}")
    require_right(browser.request, browser.services, browser.principal)
    return browser


OrganizerBrowser = Annotated[SignedIn, Depends(signed_in_organizer)]


def organizer_page(
    browser: SignedIn,
    template: str,
    section: str,
    *,
    refusal: RecordsError | None = None,
    **values: Any,
) -> Response:
    """Fill a template of the organizers; nothing may keep the answer.

    The section is one of `SECTIONS`; `values` is what else the template reads.
    """
    frame = {
        "section": section,
        "sections": _sections(browser.principal),
        "is_of_site": browser.principal.is_organizer,
        "organizer": browser.principal.person_name or browser.principal.token_name,
        "form_token": browser.form_token,
        "may": partial(may_change, browser.principal),
        "lacks": what_lacks(browser.request, browser.principal),
        "done": DONE.get(browser.request.query_params.get("done", "")),
    }
    return private_page(
        browser.request, template, "organize", refusal=refusal, frame=frame, **values
    )


def _sections(principal: Principal) -> tuple[tuple[str, str, str], ...]:
    """The sections of the menu; an organizer confined to phases sees only theirs."""
    if principal.is_organizer:
        return SECTIONS
    return tuple((each, each, f"/organize/phases/{each}") for each in sorted(principal.phases))


def go(path: str, done: str | None = None) -> Response:
    """Lead the browser on; `done` is a key of `DONE`, which the next page says in words."""
    address = path if done is None else f"{path}{'&' if '?' in path else '?'}done={done}"
    return RedirectResponse(address, status_code=303)


def has_text(find: str, *texts: str) -> bool:
    """Whether each searched word is in one of the texts; True without words."""
    text = " ".join(texts).casefold()
    return all(word in text for word in find.casefold().split())


@dataclass(frozen=True)
class Step:
    """The page of an action of an organizer: what it says and asks, and what does it."""

    section: str
    title: str
    meaning: str
    """What happens, in a sentence or two."""
    button: str
    back: str
    back_words: str
    take: Callable[..., object]
    """Does it in one transaction: called with a session, the fields by name, and `actor`."""
    done: str
    """Key of `DONE`."""
    onward: Callable[[Any], str] | None = None
    """Where to go on, told from what `take` returned; without it, back."""
    fields: tuple[FormField, ...] = ()
    texts: Mapping[str, str] = field(default_factory=dict)
    """What stands in the fields at first."""
    kept: Callable[[Session], Mapping[str, str]] | None = None
    """Where the fields show what is kept: locks it, and tells it as `texts` does."""
    facts: tuple[tuple[str, str | tuple[str, ...]], ...] = ()
    """Name and words; several lines where there are several."""
    command: str = ""
    """The same in a terminal."""
    is_grave: bool = False
    """Cannot be undone, or is seen by every reader."""
    hidden: tuple[tuple[str, str], ...] = ()
    blockers: tuple[str, ...] = ()
    """Why it would be refused now."""


def step_at(router: APIRouter, path: str) -> Callable[[Callable[..., Step]], Callable[..., Step]]:
    """Let a function that returns a step, from the parameters of a path, be its page and its POST."""

    def register(step_of: Callable[..., Step]) -> Callable[..., Step]:
        @router.get(path, name=f"show_{step_of.__name__}")
        def show(browser: OrganizerBrowser, step: Annotated[Step, Depends(step_of)]) -> Response:
            return step_page(browser, step)

        @router.post(path, name=f"post_{step_of.__name__}")
        def post(
            browser: OrganizerBrowser, form: PostedForm, step: Annotated[Step, Depends(step_of)]
        ) -> Response:
            return take_step(browser, step, form)

        return step_of

    return register


def step_page(
    browser: SignedIn,
    step: Step,
    *,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
) -> Response:
    """Show a step; after a refusal with its sentence, and with what was typed."""
    return organizer_page(
        browser,
        "web/organizer_step.html",
        step.section,
        refusal=refusal,
        step=step,
        fields=filled_fields(
            step.fields, step.texts if texts is None else texts, step.texts if step.kept else {}
        ),
    )


def take_step(browser: SignedIn, step: Step, form: FormData) -> Response:
    """Take a step in one transaction, and lead on; a refusal shows the step again."""
    try:
        with browser.services.database.write() as session:
            kept = {} if step.kept is None else step.kept(session)
            step = replace(step, texts=kept or step.texts)
            values = read_form(step.fields, form, kept)
            if kept and not changed_values(values, kept):
                return go(step.back, "nothing_changed")
            came = step.take(session, **values, actor=browser.principal.actor)
            address = step.back if step.onward is None else step.onward(came)
    except RecordsError as refusal:
        return step_page(browser, step, texts=posted_texts(form), refusal=refusal)
    return go(address, step.done)
