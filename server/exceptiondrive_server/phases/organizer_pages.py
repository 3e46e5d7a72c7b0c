"""Phases: list, create, change, and the actions of their life cycle."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import BOARD_LINES
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound, RecordsError
from exceptiondrive_records.news.questions import count_waiting
from exceptiondrive_records.operations.troubles import troubles_of
from exceptiondrive_records.phases.allowances import ended_by_reveal
from exceptiondrive_records.phases.changes import (
    delete_phase,
    feature_phase,
    freeze_phase,
    reveal_names,
)
from exceptiondrive_records.phases.phases import (
    create_phase,
    find_phase,
    list_phases,
    lock_phase,
    phase_view,
)
from exceptiondrive_records.phases.policy import has_closed
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol, list_protocols
from exceptiondrive_records.rescoring.reveal import LATE_FILES, reveal_split
from exceptiondrive_records.rescoring.runs import list_runs
from exceptiondrive_records.rescoring.showing import change_phase, reveal_board
from exceptiondrive_records.splits.splits import list_splits, whole_split, words_of_revision
from exceptiondrive_records.submissions.submissions import counts_by_phase
from exceptiondrive_schemas.api.form_fields import FormField, fields_of
from exceptiondrive_schemas.api.phase_settings import (
    WITHHELD_DEFAULTS,
    NewPhase,
    PhaseChange,
    PhaseNow,
    PhaseSettings,
)
from exceptiondrive_schemas.api.submission import PhaseView
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.protocol import NEWEST_WITHHELD
from exceptiondrive_server.audit.queries import history
from exceptiondrive_server.phases.export import export_phase
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import PostedForm, SignedIn
from exceptiondrive_server.web.forms import (
    NOTHING_KEPT,
    REASON,
    Filled,
    by_label,
    changed_values,
    filled_fields,
    made_document,
    posted_texts,
    read_form,
    text_of,
    texts_of,
)
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    go,
    organizer_page,
    step_at,
)
from exceptiondrive_server.web.organizer_rights import may_change, require_order_right
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.responses import origin_of
from exceptiondrive_server.web.templating import template_filter


@dataclass(frozen=True)
class PhaseStep:
    """An action on a phase, as data: a further one is one row more."""

    key: str
    title: str
    meaning: str
    take: Callable[..., Phase | None]
    is_offered: Callable[[PhaseView], bool]
    is_grave: bool = False
    is_end: bool = False
    """There is no page of the phase to go back to."""


def _phase_now(phase: PhaseView) -> PhaseNow:
    assert phase.now is not None
    return phase.now


PHASE_STEPS: Mapping[str, PhaseStep] = {
    step.key: step
    for step in (
        PhaseStep(
            "feature",
            "Put it on the front page",
            "The phase comes before all others: in every list, and on the front page.",
            feature_phase,
            lambda phase: phase.visibility == "shown",
        ),
        PhaseStep(
            "freeze",
            "Freeze the board",
            "The public board stays as it is from now on, until you reveal it. Scoring continues "
            "behind it.",
            freeze_phase,
            lambda phase: _phase_now(phase).frozen_since is None,
        ),
        PhaseStep(
            "reveal-board",
            "Reveal the board",
            "The freeze ends for good: readers see the newest board at once.",
            reveal_board,
            lambda phase: _phase_now(phase).frozen_since is not None,
            is_grave=True,
        ),
        PhaseStep(
            "reveal-names",
            "Reveal the names",
            "From the next board on, teams and methods appear under their names. This cannot "
            "be undone.",
            reveal_names,
            lambda phase: _phase_now(phase).is_anonymous,
            is_grave=True,
        ),
        PhaseStep(
            "reveal-split",
            "Reveal the other part",
            "Workers score the part of the split that the phase reveals; the board changes when "
            f"you apply the run that this starts. {LATE_FILES}",
            reveal_split,
            lambda phase: _phase_now(phase).part == "public",
            is_grave=True,
        ),
        PhaseStep(
            "delete",
            "Delete the phase",
            "The phase and its empty boards are removed. This works only while nothing was "
            "submitted or rescored in it; otherwise archive or hide it.",
            delete_phase,
            lambda phase: True,
            is_grave=True,
            is_end=True,
        ),
    )
}


router = APIRouter(prefix="/organize/phases", include_in_schema=False)
HERE = "/organize/phases"
StepKey = Annotated[str, Path(max_length=20)]
HISTORY = 50
SETTINGS = fields_of(PhaseSettings)
TITLES_OF_PARTS = {
    None: "Dates and limits",
    "page": "Public page",
    "policy": "What is shown when, and to whom",
}


@template_filter
def stage(phase: PhaseView, at: datetime) -> str:
    """Say whether a phase is `open`, `upcoming` or `closed` at a moment."""
    if phase.is_open:
        return "open"
    return "upcoming" if phase.opens_at is not None and at < phase.opens_at else "closed"


@router.get("")
def show_phases(browser: OrganizerBrowser) -> Response:
    """List the phases."""
    limit = browser.services.settings.max_upload_bytes
    with browser.services.database.read() as session:
        phases = [
            phase_view(session, one, max_upload_bytes=limit)
            for one in list_phases(session, with_hidden=True)
        ]
        splits = [one for one in list_splits(session) if one.part is None]
        counts = counts_by_phase(session)
        seen_at = database_now(session)
    return organizer_page(
        browser,
        "phases/organizer_phases.html",
        "phases",
        phases=phases,
        splits=splits,
        counts=counts,
        seen_at=seen_at,
    )


@router.get("/new")
def show_new(
    browser: OrganizerBrowser, like: Annotated[str | None, Query(max_length=64)] = None
) -> Response:
    """Show a form with what is usual, or with what another phase is made of and its settings."""
    if like is None:
        usual = {
            field.name: "" if field.name in WITHHELD_DEFAULTS else text_of(field.default)
            for field in SETTINGS
        }
        return _new_phase_page(browser, usual)
    with browser.services.database.read() as session:
        phase = find_phase(session, like)
        texts = texts_of(SETTINGS, phase)
        protocol = find_protocol(session, phase.protocol_digest).version
        whole = whole_split(session, phase.split_name, phase.split_revision)
    made_of = {"challenge": phase.challenge, "split": whole.name, "split_revision": whole.revision}
    made_of["protocol"] = protocol
    anew = dict.fromkeys((f.name for f in SETTINGS if f.kind == "moment"), "") | {"position": ""}
    if phase.visibility == "archived":
        anew["visibility"] = "shown"
    return _new_phase_page(browser, {**texts, **made_of, **anew})


@router.post("/new")
def post_new(browser: OrganizerBrowser, form: PostedForm) -> Response:
    """Make a phase."""
    with browser.services.database.read() as session:
        fields = (*_made_of(session), *_of_new())
    try:
        values = read_form(fields, form)
        told = {k: v for k, v in values.items() if v is not None or k not in WITHHELD_DEFAULTS}
        new = made_document(NewPhase, fields, told)
        with browser.services.database.write() as session:
            phase = create_phase(session, new, actor=browser.principal.actor)
            is_over = phase.closes_at is not None and phase.closes_at <= phase.created_at
    except RecordsError as refusal:
        return _new_phase_page(browser, posted_texts(form), refusal)
    return go(f"{HERE}/{new.id}", "phase_created_over" if is_over else "phase_created")


@router.get("/{phase_id}")
def show_phase(browser: OrganizerBrowser, phase_id: PhaseId) -> Response:
    """Show a phase: where it stands, its settings, its history."""
    return _phase_page(browser, phase_id)


@router.post("/{phase_id}")
def post_phase(browser: OrganizerBrowser, form: PostedForm, phase_id: PhaseId) -> Response:
    """Change what was changed on the page; what would take back a promise is refused."""
    try:
        with browser.services.database.write() as session:
            phase = lock_phase(session, phase_id)
            kept = texts_of(SETTINGS, phase)
            values = changed_values(read_form(SETTINGS, form, kept), kept)
            if not values:
                return go(f"{HERE}/{phase_id}", "nothing_changed")
            change = made_document(PhaseChange, SETTINGS, values)
            require_order_right(browser.principal, change)
            change_phase(session, phase_id, change, actor=browser.principal.actor)
    except RecordsError as refusal:
        return _phase_page(browser, phase_id, posted_texts(form), refusal)
    return go(f"{HERE}/{phase_id}", "phase_changed")


@router.get("/{phase_id}/export")
def get_export(browser: OrganizerBrowser, phase_id: PhaseId) -> Response:
    """Download what readers may see of a phase, as a tar for a paper or an archive."""
    return export_phase(browser.services, browser.principal, phase_id, origin_of(browser.request))


@step_at(router, "/{phase_id}/{step}")
def step_of(services: ServicesOf, phase_id: PhaseId, step: StepKey) -> Step:
    """Take an action on a phase."""
    with services.database.read() as session:
        phase = find_phase(session, phase_id)
        ending = ended_by_reveal(session, phase) if _ends_deadlines(session, phase, step) else ()
    if step not in PHASE_STEPS:
        raise NotFound("action on a phase", step)
    known = PHASE_STEPS[step]
    verb, _, revealed = step.partition("-")
    what = f" --what {revealed}" if revealed else ""
    return Step(
        section="phases",
        title=known.title,
        meaning=known.meaning,
        button=known.title,
        back=f"{HERE}/{phase_id}",
        back_words="The phase",
        fields=(REASON,),
        facts=(("Phase", phase.title), *([("Ends for good", ending)] if ending else [])),
        command=f'exceptiondrive organizer phases {verb} {phase_id}{what} --reason "…"',
        is_grave=known.is_grave,
        take=partial(known.take, phase_id=phase_id),
        done="phase_deleted" if known.is_end else "phase_changed",
        onward=(lambda _: HERE) if known.is_end else None,
    )


def _ends_deadlines(session: Session, phase: Phase, step: str) -> bool:
    """Whether an action shows scores that were kept back, after which no team's later deadline runs."""
    if step == "reveal-board":
        return phase.policy.frozen_scores == "hidden" and has_closed(phase, database_now(session))
    return step == "reveal-split"


def _made_of(session: Session) -> tuple[FormField, ...]:
    """What a phase is made of, and keeps."""
    challenges = tuple((key, one.title) for key, one in CHALLENGES.items())
    wholes = [one for one in list_splits(session) if one.part is None]
    splits = {one.name: one.title for one in wholes}
    revisions = tuple((one.revision, f"{one.name} of {words_of_revision(one)}") for one in wholes)
    versions = tuple((one.version, one.version) for one in reversed(list_protocols(session)))
    return (
        FormField("id", "Id", hint="part of addresses; cannot be changed later", is_required=True,
              max_length=64),
        FormField("challenge", "Challenge", "choice", is_required=True, options=challenges),
        FormField("split", "Split", "choice", is_required=True,
              options=tuple((name, f"{name}: {title}") for name, title in splits.items())),
        FormField("split_revision", "Split revision", "choice", "must be one of this split",
              options=revisions, empty="the one registered last"),
        FormField("protocol", "Protocol", "choice",
              f"the default for a withheld split is {NEWEST_WITHHELD}, for a public one the newest that "
              "a phase has", options=versions, empty="the default"),
    )  # fmt: skip


def _of_new() -> tuple[FormField, ...]:
    """Settings of a phase to be made: what depends on the split may stay empty."""
    return tuple(
        replace(field, is_required=False, hint=f"{field.hint} If empty, the default for the split.")
        if field.name in WITHHELD_DEFAULTS
        else field
        for field in SETTINGS
    )


def _new_phase_page(
    browser: SignedIn, texts: Mapping[str, str], refusal: RecordsError | None = None
) -> Response:
    with browser.services.database.read() as session:
        made_of = filled_fields(_made_of(session), texts)
    may_make = may_change(browser.principal, f"{HERE}/new")
    return _page(
        browser,
        texts,
        refusal,
        phase=None,
        made_of=made_of,
        troubles=(),
        may_change=may_make,
    )


def _phase_page(
    browser: SignedIn,
    phase_id: str,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
) -> Response:
    with browser.services.database.read() as session:
        phase = find_phase(session, phase_id)
        kept, has_board = texts_of(SETTINGS, phase), phase.current_board_id is not None
        seen = phase_view(
            session, phase, max_upload_bytes=browser.services.settings.max_upload_bytes
        )
        seen_at = database_now(session)
        lines = history(session, phase_id, limit=HISTORY)
        n_questions = count_waiting(session, phase_id)
        runs = list_runs(session, phase_id)
        is_used = bool(counts_by_phase(session).get(phase_id) or runs)
        found = troubles_of(session, phase)
    return _page(
        browser,
        kept if texts is None else texts,
        refusal,
        kept,
        phase=seen,
        has_board=has_board,
        n_questions=n_questions,
        newest_run=next(iter(runs), None),
        now=seen.now,
        seen_at=seen_at,
        steps=[
            step
            for step in PHASE_STEPS.values()
            if step.is_offered(seen)
            and not (step.is_end and is_used)
            and may_change(browser.principal, f"{HERE}/{{phase_id}}/{step.key}", phase_id)
        ],
        may_change=may_change(browser.principal, f"{HERE}/{{phase_id}}", phase_id),
        may_make=may_change(browser.principal, f"{HERE}/new"),
        lines=[one for one in lines if one.line.action not in BOARD_LINES],
        troubles=found,
    )


def _page(
    browser: SignedIn,
    texts: Mapping[str, str],
    refusal: RecordsError | None,
    kept: Mapping[str, str] = NOTHING_KEPT,
    made_of: tuple[Filled, ...] = (),
    **values: Any,
) -> Response:
    settings = _of_new() if values["phase"] is None else SETTINGS
    parts = [
        (title, filled_fields([field for field in settings if field.part == part], texts, kept))
        for part, title in TITLES_OF_PARTS.items()
    ]
    return organizer_page(
        browser,
        "phases/organizer_phase.html",
        "phases",
        refusal=by_label(refusal, settings),
        parts=[("Challenge, split and protocol", made_of), *parts],
        **values,
    )
