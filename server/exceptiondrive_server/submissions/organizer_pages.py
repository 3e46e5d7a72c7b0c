"""Submissions of all teams: filter, show, recompute, restore, answer. Shows no value of a sample."""

from dataclasses import replace
from functools import partial
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from fastapi.responses import HTMLResponse, Response

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.participation.disqualification import disqualification_of
from exceptiondrive_records.participation.messages import write_about
from exceptiondrive_records.phases.phases import find_phase, list_phases
from exceptiondrive_records.phases.policy import can_change
from exceptiondrive_records.rescoring.changes import verify_submission
from exceptiondrive_records.rescoring.retry import restore_submission, retry_submission
from exceptiondrive_records.submissions.similarity import similarity_report
from exceptiondrive_records.submissions.submissions import find_submission, submission_page
from exceptiondrive_records.submissions.views import views
from exceptiondrive_records.teams.teams import find_team, list_teams
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_schemas.api.similarity import ALIKE_WORDS
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_server.audit.queries import history
from exceptiondrive_server.submissions.download import any_upload, archive
from exceptiondrive_server.submissions.queries import phase_rules, score_tables
from exceptiondrive_server.submissions.runs import run_lines
from exceptiondrive_server.submissions.story import story_folder, story_of, story_page
from exceptiondrive_server.submissions.view import policy_sentences, status_of, steps_of
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.numbers import minute
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    organizer_page,
    step_at,
)
from exceptiondrive_server.web.path_ids import PhaseId, SubmissionId

router = APIRouter(prefix="/organize", include_in_schema=False)
SHOWN = 50
HISTORY = 200
SHOWN_PAIRS = 100
"""Pairs on the page, the most alike; the command lists them all."""
SHOWN_OF_A_TEAM = 10
Choice = Annotated[str, Query(max_length=64)]

Action = Literal["retry", "verify", "restore", "note"]
WORDS = FormField(
    "words",
    "Message to the team",
    "lines",
    "for its inbox and every confirmed address; a blank line separates paragraphs",
    is_required=True,
    max_length=4000,
)


@router.get("/submissions")
def show_submissions(
    browser: OrganizerBrowser,
    team: Choice = "",
    phase: Choice = "",
    status: Choice = "",
    after: Annotated[str | None, Query(max_length=64)] = None,
) -> Response:
    """List submissions, newest first, narrowed to a team, a phase and a status."""
    known = SubmissionStatus(status) if status in list(SubmissionStatus) else None
    who = browser.principal
    with browser.services.database.read() as session:
        found, following = submission_page(
            session,
            team_id=find_team(session, team).id if team else None,
            phase_id=find_phase(session, phase).id if phase else None,
            status=known,
            after=after,
            limit=SHOWN,
        )
        seen = views(session, found)
        phases = [one for one in list_phases(session, with_hidden=True) if who.organizes(one.id)]
        lines = run_lines(seen, phase_rules(session, phases), can_decide=False)
        teams = {one.id: one for one in list_teams(session)}
    chosen = {"team": team, "phase": phase, "status": known or ""}
    older = {**chosen, "after": following} if following else {}
    return organizer_page(
        browser,
        "submissions/organizer_submissions.html",
        "submissions",
        lines=lines,
        labels=list(dict.fromkeys(cell.label for line in lines for cell in line.cells)),
        slugs={one.id: teams[one.team_id].slug for one in found},
        teams=sorted(((one.slug, one.name) for one in teams.values()), key=lambda team: team[1]),
        titles={one.id: one.title for one in phases},
        statuses=[(status, status) for status in SubmissionStatus],
        chosen=chosen,
        query=urlencode({key: value for key, value in chosen.items() if value}),
        older=urlencode({key: value for key, value in older.items() if value}),
    )


@router.get("/submissions/archive")
def get_archive(
    browser: OrganizerBrowser, team: Choice = "", phase: Choice = "", status: Choice = ""
) -> Response:
    """Download the uploads of the list as a tar with a manifest."""
    known = SubmissionStatus(status) if status in list(SubmissionStatus) else None
    return archive(
        browser.services, browser.principal, team=team or None, phase=phase or None, status=known
    )


@router.get("/submissions/{submission_id}")
def show_submission(browser: OrganizerBrowser, submission_id: SubmissionId) -> Response:
    """Show where a submission stands, and everything that ever happened to it."""
    with browser.services.database.read() as session:
        story = story_of(session, submission_id)
        seen = story.submission
        sheet = score_tables(session, seen)
        lines = history(session, submission_id, limit=HISTORY)
        phase = find_phase(session, seen.phase)
        found = find_submission(session, submission_id)
        ended = not can_change(phase, found, database_now(session))
        disqualified = disqualification_of(session, seen.id)
    return organizer_page(
        browser,
        "submissions/organizer_submission.html",
        "submissions",
        one=seen,
        story=story,
        sheet=sheet,
        phase_title=phase.title,
        disqualified=disqualified,
        sentences=list(policy_sentences(seen, phase.policy, has_closed=ended)),
        now=status_of(seen),
        steps=steps_of(seen),
        lines=lines,
    )


@router.get("/submissions/{submission_id}/file")
def get_file(browser: OrganizerBrowser, submission_id: SubmissionId) -> Response:
    """Give the bytes that the team sent."""
    return any_upload(browser.request, browser.services, browser.principal, submission_id)


@router.get("/submissions/{submission_id}/folder")
def get_folder(browser: OrganizerBrowser, submission_id: SubmissionId) -> Response:
    """Download the whole story for a committee."""
    return story_folder(browser.services, browser.principal, submission_id)


@router.get("/submissions/{submission_id}/story")
def show_story(browser: OrganizerBrowser, submission_id: SubmissionId) -> Response:
    """Show the whole story on one page, to be printed or kept as a PDF."""
    text = story_page(browser.services, submission_id)
    return HTMLResponse(text, headers={"Cache-Control": "no-store"})


@step_at(router, "/submissions/{submission_id}/{action}")
def action_on(services: ServicesOf, submission_id: SubmissionId, action: Action) -> Step:
    """Try a submission again, recompute it, restore it, or write to its team."""
    with services.database.read() as session:
        submission = find_submission(session, submission_id)
    method, of = submission.method, f"exceptiondrive organizer submissions {action} {submission.id}"
    step = Step(
        section="submissions",
        title=f"Try {method} again",
        meaning="It is queued again with all its attempts, at its original time, and counts towards the "
        "quota of that day, which a failed one does not; if that is used up, this is refused.",
        button="Try again",
        back=f"/organize/submissions/{submission.id}",
        back_words="The submission",
        fields=(REASON,),
        command=f'{of} --reason "…"',
        take=partial(retry_submission, submission_id=submission_id),
        done="submission_retried",
    )
    match action:
        case "retry":
            why = f"{submission.failure_code}: {submission.failure_message}"
            return replace(step, facts=(("Failed with", why),) if submission.failure_code else ())
        case "verify":
            return replace(
                step,
                title=f"Recompute {method}",
                meaning="A worker scores the upload again under the protocol and split revision that "
                "the phase shows, and compares every bit with the sheet. Nothing is changed.",
                button="Recompute",
                take=partial(verify_submission, submission_id=submission_id),
                done="submission_verified",
            )
        case "restore":
            at = submission.withdrawn_at
            return replace(
                step,
                title=f"Restore {method}",
                meaning="It returns at its original time, with the score that was kept; if none was kept "
                "under the present protocol, it is scored. No quota is used. Once hidden scores are "
                "revealed, what was withdrawn before the deadline can no longer be restored.",
                button="Restore",
                facts=(("Withdrawn", minute(at)),) if at is not None else (),
                take=partial(restore_submission, submission_id=submission_id),
                done="submission_restored",
            )
        case "note":
            return replace(
                step,
                title=f"Write to the team about {method}",
                meaning="The team reads it among its notices, with a link to the submission. No address "
                "is shown to you; the audit log records that you wrote, and a digest of the text.",
                button="Send",
                fields=(WORDS,),
                command=f'{of} --words "…"',
                take=partial(write_about, submission_id=submission_id),
                done="team_told",
            )


@router.get("/similar/{phase_id}")
def show_similar(browser: OrganizerBrowser, phase_id: PhaseId) -> Response:
    """Show teams whose submissions are alike, and those that probe: reasons to ask, not proof."""
    with browser.services.database.read() as session:
        phase = find_phase(session, phase_id)
        report = similarity_report(session, phase_id)
    return organizer_page(
        browser,
        "submissions/organizer_similar.html",
        "phases",
        title=phase.title,
        words=CHALLENGES[phase.challenge].words,
        report=report,
        pairs=report.pairs[:SHOWN_PAIRS],
        most_of_a_team=SHOWN_OF_A_TEAM,
        kinds=ALIKE_WORDS,
    )
