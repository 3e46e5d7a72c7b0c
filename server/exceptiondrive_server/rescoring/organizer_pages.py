"""Rescoring runs: list, draft, progress, preview, and every step; verifications of sheets."""

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response

from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.db.errors import Conflict, NotFound, RecordsError
from exceptiondrive_records.phases.phases import find_phase, list_phases, titles_of_phases
from exceptiondrive_records.protocols.protocols import find_protocol, list_protocols
from exceptiondrive_records.rescoring import changes
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.verification import list_verifications, verification_view
from exceptiondrive_records.rescoring.views import preview_of, run_view, run_views
from exceptiondrive_records.splits.splits import list_splits, words_of_revision
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_schemas.api.rescoring import RunKind
from exceptiondrive_server.audit.queries import history
from exceptiondrive_server.rescoring.exports import comparison_csv
from exceptiondrive_server.rescoring.preview import compared
from exceptiondrive_server.rescoring.steps import (
    RUN_STEPS,
    offered,
    page_of_step,
    run_line,
)
from exceptiondrive_server.submissions.download import attachment
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import Elsewhere, SignedIn
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.numbers import short_digest
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    go,
    organizer_page,
    step_at,
)

router = APIRouter(prefix="/organize", include_in_schema=False)
HERE = "/organize/rescoring"
RunId = Annotated[str, Path(max_length=64)]
StepKey = Annotated[str, Path(max_length=20)]
Choice = Annotated[str, Query(max_length=100)]
HISTORY = 100
SHOWN = 20
"""Each run asks the records a dozen times."""


@router.get("/rescoring")
def show_runs(browser: OrganizerBrowser, all_runs: bool = False) -> Response:
    """List runs and verifications, newest first: the newest of each, or all."""
    limit = None if all_runs else SHOWN + 1
    with browser.services.database.read() as session:
        runs = run_views(session, limit=limit)
        verifications = list_verifications(session, limit=limit)
        is_cut = not all_runs and max(len(runs), len(verifications)) > SHOWN
        shown = SHOWN if is_cut else None
        lines = [run_line(session, run) for run in runs[:shown]]
        titles = titles_of_phases(session)
    return organizer_page(
        browser,
        "rescoring/organizer_runs.html",
        "rescoring",
        lines=lines,
        verifications=verifications[:shown],
        is_cut=is_cut,
        titles=titles,
    )


@step_at(router, "/rescoring/new")
def draft(services: ServicesOf, phase: Choice = "", protocol: Choice = "") -> Step:
    """Draft a run."""
    with services.database.read() as session:
        found = list_phases(session, with_hidden=True)
        in_force: dict[tuple[str, str], list[str]] = {}
        for one in found:
            in_force.setdefault((one.split_name, one.split_revision), []).append(one.title)
        phases = [
            (one.id, f"{one.title}, now {find_protocol(session, one.protocol_digest).version}")
            for one in found
        ]
        versions = [(one.version, f"{one.version}: {one.title}") for one in list_protocols(session)]
        revisions = [
            (one.revision, _revision_words(one, in_force.get((one.name, one.revision), ())))
            for one in list_splits(session)
        ]
    return Step(
        section="rescoring",
        title="Draft a rescoring run",
        meaning="Nothing is scored yet, and readers see nothing. The next page says in words what would "
        "change and how much is recomputed.",
        button="Draft the run",
        back=HERE,
        back_words="Rescoring",
        fields=(
            FormField("phase", "Phase", "choice", is_required=True, options=tuple(phases)),
            FormField(
                "protocol",
                "New protocol",
                "choice",
                options=tuple(reversed(versions)),
                empty="the one in force",
            ),
            FormField(
                "split_revision",
                "New split revision",
                "choice",
                "only if the split itself was corrected",
                options=tuple(revisions),
                empty="the one in force",
            ),
            REASON,
        ),
        texts={"phase": phase, "protocol": protocol},
        command='exceptiondrive organizer rescore start --phase PHASE --protocol 1.1 --reason "…"',
        take=lambda session, phase, **given: changes.create_run(session, phase, **given),
        done="run_drafted",
        onward=lambda run: f"{HERE}/{run.id}",
    )


def _revision_words(split: SplitRow, phases: Sequence[str]) -> str:
    words = f"{split.name} of {words_of_revision(split)} ({short_digest(split.revision)})"
    return f"{words}; now in force in {', '.join(phases)}" if phases else words


@router.get("/rescoring/{run_id}")
def show_run(browser: OrganizerBrowser, run_id: RunId) -> Response:
    """Show state, progress, what stands in the way, and what may be done."""
    return _run_page(browser, run_id)


def _run_page(browser: SignedIn, run_id: str, refusal: RecordsError | None = None) -> Response:
    with browser.services.database.read() as session:
        run = find_run(session, run_id)
        if run.kind is RunKind.VERIFICATION:
            return go(f"/organize/verifications/{run_id}")
        seen = run_view(session, run)
        line = run_line(session, seen)
        lines = history(session, run_id, limit=HISTORY)
        names, titles = names_of_actors(session, [seen.actor]), titles_of_phases(session)
    return organizer_page(
        browser,
        "rescoring/organizer_run.html",
        "rescoring",
        refusal=refusal,
        line=line,
        steps=offered(seen),
        lines=lines,
        phase_title=titles[seen.phase],
        organizer_name=names.get(seen.actor, seen.actor),
    )


@router.get("/rescoring/{run_id}/preview")
def show_preview(
    browser: OrganizerBrowser, run_id: RunId, page: Annotated[int, Query(ge=1, le=100_000)] = 1
) -> Response:
    """Compare every entry before and after, worst movers first; the run's page says why not."""
    try:
        with browser.services.database.read() as session:
            seen = run_view(session, find_run(session, run_id))
            line = run_line(session, seen)
            preview = preview_of(session, run_id)
            comparison = preview.comparison
            protocol = find_protocol(session, comparison.to_protocol.digest)
            phase = find_phase(session, seen.phase)
    except Conflict as refusal:
        return _run_page(browser, run_id, refusal)
    steps = offered(seen)
    flips = [step.in_a_terminal(run_id, preview.digest) for step in steps if step.is_flip]
    return organizer_page(
        browser,
        "rescoring/organizer_preview.html",
        "rescoring",
        line=line,
        steps=steps,
        commands=(f"exceptiondrive organizer rescore preview {run_id} --csv new.csv", *flips),
        preview=preview,
        phase_title=phase.title,
        **compared(comparison, protocol, page, phase),
    )


@router.get("/rescoring/{run_id}/preview.csv")
def download_csv(browser: OrganizerBrowser, run_id: RunId) -> Response:
    """Download the comparison: a line per entry."""
    with browser.services.database.read() as session:
        preview = preview_of(session, run_id)
    text = comparison_csv(preview.comparison, preview.direction)
    headers = attachment(f"preview-{run_id}.csv")
    return Response(text, media_type="text/csv", headers=headers)


@router.get("/rescoring/{run_id}/preview.json")
def download_json(browser: OrganizerBrowser, run_id: RunId) -> Response:
    """Download the preview as the API gives it."""
    with browser.services.database.read() as session:
        text = preview_of(session, run_id).model_dump_json()
    headers = attachment(f"preview-{run_id}.json")
    return Response(text, media_type="application/json", headers=headers)


@step_at(router, "/rescoring/{run_id}/{step}")
def step_of(services: ServicesOf, run_id: RunId, step: StepKey, preview: Choice = "") -> Step:
    """Take a step of a run; what readers will see is looked at before it is applied."""
    if step not in RUN_STEPS:
        raise NotFound("step of a run", step)
    with services.database.read() as session:  # compares the boards, which a flip then finds
        page = page_of_step(session, RUN_STEPS[step], run_id, preview)
    if RUN_STEPS[step].needs_preview and not preview:
        raise Elsewhere(f"{HERE}/{run_id}/preview")
    return page


@step_at(router, "/verifications/new")
def verification(services: ServicesOf, phase: Choice = "") -> Step:
    """Start a verification."""
    with services.database.read() as session:
        phases = tuple((one.id, one.title) for one in list_phases(session, with_hidden=True))
    return Step(
        section="rescoring",
        title="Verify sheets",
        meaning="Workers recompute sheets from their uploads, with an empty store, and compare the "
        "digests of the unrounded sheets. Nothing is changed; sheets that differ are listed.",
        button="Verify",
        back=HERE,
        back_words="Rescoring",
        fields=(
            FormField("phase", "Phase", "choice", is_required=True, options=phases),
            FormField("sample", "How many sheets", "whole", "empty: all", highest=100_000),
            REASON,
        ),
        texts={"phase": phase},
        command='exceptiondrive organizer rescore verify --phase PHASE --sample all --reason "…"',
        take=lambda session, phase, **given: changes.start_verification(session, phase, **given),
        done="verification_started",
        onward=lambda run: f"/organize/verifications/{run.id}",
    )


@router.get("/verifications/{verification_id}")
def show_verification(
    browser: OrganizerBrowser, verification_id: Annotated[str, Path(max_length=64)]
) -> Response:
    """Show what a verification has come to."""
    with browser.services.database.read() as session:
        seen = verification_view(session, verification_id)
        names, titles = names_of_actors(session, [seen.actor]), titles_of_phases(session)
    return organizer_page(
        browser,
        "rescoring/organizer_verification.html",
        "rescoring",
        seen=seen,
        phase_title=titles[seen.phase],
        organizer_name=names.get(seen.actor, seen.actor),
    )
