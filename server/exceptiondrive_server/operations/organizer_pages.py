"""The first page of the organizers: what needs attention, the queue of each lane, the workers."""

from collections.abc import Iterator, Mapping, Sequence
from urllib.parse import quote

from fastapi import APIRouter
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.operations.overview import SLOW_S, Overview, overview
from exceptiondrive_records.operations.site import set_site_links, site_links
from exceptiondrive_records.operations.troubles import Trouble
from exceptiondrive_records.phases.phases import list_phases, titles_of_phases
from exceptiondrive_records.rescoring.views import run_view
from exceptiondrive_records.submissions.file_store import LOW_ON_ROOM_BYTES
from exceptiondrive_records.teams.teams import list_teams
from exceptiondrive_schemas.api.form_fields import fields_of
from exceptiondrive_schemas.api.site import SiteLinks
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.printable import counted, duration_words
from exceptiondrive_server.rescoring.steps import RunLine, run_line
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.forms import made_document, texts_of
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    organizer_page,
    step_at,
)

router = APIRouter(include_in_schema=False)
SITE_FIELDS = fields_of(SiteLinks)
LANE_TITLES = {Lane.LIVE: "Fresh submissions", Lane.RESCORE: "Rescoring"}
TROUBLE_LINKS = {
    "lane_without_worker": ("#workers", "See the workers"),
    "split_without_file": ("/organize/phases#splits", "See the splits"),
    "no_reconciler": ("#queue", "See the queue"),
    "board_not_built": ("/organize/phases/{}", "See the phase"),
    "no_recorded_drives": ("/organize/phases#splits", "See the splits"),
    "reported_beside_other_split": ("/organize/phases/{}#troubles", "What to do"),
    "mail_not_sent": ("/organize/teams", "See the teams"),
    "backup_failed": ("/organize/audit?subject={}", "See the audit log"),
    "files_without_record": ("/organize/audit?subject={}", "See the audit log"),
}
"""Where an organizer goes for each kind of trouble."""
LASTING = ("no_recorded_drives", "reported_beside_other_split")
"""Troubles of a split that nobody waits for: they may stand for a whole season."""
Task = tuple[str, str, str, str]
"""Words, address and words of the link, and `bad` or `warn`."""


@router.get("/organize")
def show_overview(browser: OrganizerBrowser) -> Response:
    """Show what waits for an organizer, the queue, and the workers."""
    with browser.services.database.read() as session:
        found = overview(session)
        runs = [run_line(session, run_view(session, run)) for run in found.open_runs]
        teams = list_teams(session)
        is_new = all(team.is_reference or team.is_gone for team in teams)
        first = list(_first_steps(session)) if is_new else []
        titles = titles_of_phases(session)
    tasks = _tasks(found, runs, titles, browser.services.files.free_bytes())
    return organizer_page(
        browser,
        "operations/organizer_overview.html",
        "overview",
        found=found,
        alive=[worker for worker in found.workers if worker.is_alive],
        tasks=[*sorted(tasks, key=lambda task: task[3] != "bad"), *first],
        runs=runs,
        titles=titles,
        lane_titles=LANE_TITLES,
        slow_s=SLOW_S,
        duration=duration_words,
    )


@step_at(router, "/organize/site")
def site(services: ServicesOf) -> Step:
    """Set the links of header and footer."""

    def kept(session: Session) -> dict[str, str]:
        return texts_of(SITE_FIELDS, site_links(session))

    def take(session: Session, actor: str, **values: str) -> None:
        set_site_links(session, made_document(SiteLinks, SITE_FIELDS, values), actor=actor)
        services.site_state.forget()

    with services.database.read() as session:
        texts = kept(session)
    return Step(
        section="site",
        title="The site",
        meaning="Links in the header and footer of every page. Empty ones are not shown.",
        button="Save the links",
        back="/organize",
        back_words="Overview",
        take=take,
        done="site_changed",
        fields=SITE_FIELDS,
        texts=texts,
        kept=kept,
        command="exceptiondrive organizer site set --help",
    )


def _first_steps(session: Session) -> Iterator[Task]:
    """Yield what a site without a team still needs."""
    words = "There is no team yet, so nobody can submit."
    yield words, "/organize/teams", "Create a team", "warn"
    for phase in list_phases(session):
        texts = (("description", phase.description), ("rules", phase.page.rules))
        missing = [name for name, text in texts if not text]
        missing += ["deadline"] if phase.closes_at is None else []
        if missing and phase.visibility == "shown":
            words = f"Phase {phase.title} is public but has no {', no '.join(missing)}."
            yield words, f"/organize/phases/{quote(phase.id)}", "Describe it", "warn"


def _tasks(
    found: Overview, runs: Sequence[RunLine], titles: Mapping[str, str], free_bytes: int | None
) -> Iterator[Task]:
    """Yield what to do: what nobody waits for comes last."""
    if free_bytes is not None and free_bytes < LOW_ON_ROOM_BYTES:
        words = f"The disk with the uploads is nearly full: {free_bytes >> 20} MiB are free."
        yield words, "#queue", "Free space, but keep uploads", "bad"
    yield from (_trouble_task(one) for one in found.troubles if one.code not in LASTING)
    if found.n_failed:
        words = f"{counted(found.n_failed, 'submission')} failed through our own fault."
        yield words, "/organize/submissions?status=failed", "View and retry", "bad"
    for held in found.floors_held:
        asked, phase = "; ".join(held.detail["asked"]), held.detail["phase"]
        phase = titles.get(phase, phase)
        words = f"The floors of split {held.subject} refused what phase {phase} asks for: {asked}."
        yield words, f"/organize/audit?subject={quote(held.subject)}", "See the audit log", "bad"
    for phase in dict.fromkeys(line.subject for line in found.probing):
        words = f"Phase {titles.get(phase, phase)} has submissions that change a few samples at a time, which may be probing."
        yield words, f"/organize/similar/{phase}", "See them", "warn"
    if found.pending:
        verb = "waits" if len(found.pending) == 1 else "wait"
        words = f"{counted(len(found.pending), 'team')} {verb} for your approval."
        yield words, "/organize/teams?show=pending", "Review them", "warn"
    if found.n_questions:
        verb = "waits" if found.n_questions == 1 else "wait"
        words = f"{counted(found.n_questions, 'question')} from teams {verb} for an answer."
        yield words, "/organize/news", "Answer", "warn"
    for queue in found.queue:
        if queue.lane is Lane.LIVE and (queue.oldest_s or 0) > SLOW_S:
            words = f"A fresh submission has waited for {duration_words(queue.oldest_s or 0)}."
            yield words, "#queue", "See the queue", "warn"
    for line in runs:
        words = f"Rescoring of {titles[line.run.phase]}: {line.next_words}"
        yield words, f"/organize/rescoring/{line.run.id}", "See the run", "warn"
    yield from (_trouble_task(one) for one in found.troubles if one.code in LASTING)


def _trouble_task(trouble: Trouble) -> Task:
    url, words = TROUBLE_LINKS[trouble.code]
    level = "bad" if trouble.stops_scoring else "warn"
    return trouble.what, url.format(quote(trouble.subject)), words, level
