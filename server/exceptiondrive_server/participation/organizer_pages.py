"""Organizers manage teams: each action is a page of its own, messages have a preview."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import InvalidRecord, RecordsError
from exceptiondrive_records.participation.allowances import set_allowance
from exceptiondrive_records.participation.changes import MAX_AFFILIATION, change_team, merge_teams
from exceptiondrive_records.participation.disqualification import (
    MAX_NOTE,
    disqualify_submission,
    disqualify_team,
    find_disqualification,
    reinstate,
)
from exceptiondrive_records.participation.forgetting import forget_team
from exceptiondrive_records.participation.importing import COLUMNS, import_teams, tokens_table
from exceptiondrive_records.participation.messages import (
    MAX_TEXT,
    MAX_TITLE,
    checked_message,
    recipients,
    send_message,
)
from exceptiondrive_records.participation.tables import Disqualification
from exceptiondrive_records.phases.allowances import allowance_of
from exceptiondrive_records.phases.phases import find_phase, list_phases, lock_phase
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team, list_teams
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_schemas.api.participation import AFTER_A_MERGE
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.participation.queries import allowance_view
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import PostedForm
from exceptiondrive_server.web.forms import REASON, filled_fields, posted_texts, read_form, text_of
from exceptiondrive_server.web.numbers import minute
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    organizer_page,
    step_at,
    step_page,
    take_step,
)
from exceptiondrive_server.web.path_ids import PhaseId, SubmissionId, TeamId

router = APIRouter(prefix="/organize", include_in_schema=False)
TOLD_REASON = replace(REASON, hint="shown to the team, and kept in the audit log with your name")
PUBLIC_NOTE = FormField(
    "public_note",
    "Public note",
    "lines",
    "shown below the board, with team and method; empty: readers are told nothing",
    max_length=MAX_NOTE,
)
NAMES = (
    FormField("name", "Name", hint="as new boards will show it", is_required=True, max_length=80),
    FormField("affiliation", "Affiliation", hint="for organizers", max_length=MAX_AFFILIATION),
    REASON,
)
ALLOWANCE = (
    FormField("closes_at", "Own deadline", "moment", "empty: as for all teams"),
    FormField("quota_per_day", "Submissions per day", "whole", "empty: as for all teams"),
    FormField("quota_total", "Submissions in total", "whole", "empty: as for all teams"),
    TOLD_REASON,
)
TABLE = (
    FormField("csv", "Table", "lines", f"columns {', '.join(COLUMNS)}; the last two may be left out",
          is_required=True, max_length=200_000),
)  # fmt: skip
SHOWN_RECIPIENTS = 40
_EVERY_PHASE = "*"
"""Is the id of no phase."""


# Many teams at once.


@router.get("/teams/import")
def show_import(browser: OrganizerBrowser) -> Response:
    """Ask for a table of teams."""
    return _import_page(browser)


@router.post("/teams/import")
def post_import(browser: OrganizerBrowser, form: PostedForm) -> Response:
    """Make the teams of a table, and show their tokens this once."""
    try:
        text = read_form(TABLE, form)["csv"]
        with browser.services.database.write() as session:
            made = import_teams(session, text, actor=browser.principal.actor)
    except RecordsError as refusal:
        return _import_page(browser, texts=posted_texts(form), refusal=refusal)
    return _import_page(browser, tokens=tokens_table(made), n_made=len(made))


def _import_page(
    browser: OrganizerBrowser,
    *,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
    tokens: str | None = None,
    n_made: int = 0,
) -> Response:
    return organizer_page(
        browser,
        "participation/organizer_import.html",
        "teams",
        refusal=refusal,
        fields=filled_fields(TABLE, texts or {}),
        tokens=tokens,
        n_made=n_made,
    )


# One team.


@step_at(router, "/teams/{team_id}/change")
def change(services: ServicesOf, team_id: TeamId) -> Step:
    """Change name or affiliation."""

    def kept(session: Session) -> dict[str, str]:
        return _kept_names(find_team(session, team_id, lock=True))

    with services.database.read() as session:
        team = find_team(session, team_id)
    return _step(
        team,
        title=f"Rename {team.name}",
        meaning="New boards show the new name, and the team is told. Earlier boards stay as they are, and "
        "an archived phase gets no new board for it.",
        button="Change",
        fields=NAMES,
        texts=_kept_names(team),
        kept=kept,
        command=f'exceptiondrive organizer teams change {team.slug} --name "…" --reason "…"',
        take=partial(change_team, slug=team_id),
        done="team_changed",
    )


def _by_name(session: Session) -> list[Team]:
    """All teams, in the order in which somebody looks for a name."""
    return sorted(list_teams(session), key=lambda team: team.name.casefold())


def _kept_names(team: Team) -> dict[str, str]:
    return {"name": team.name, "affiliation": team.affiliation}


@step_at(router, "/teams/{team_id}/merge")
def merge(services: ServicesOf, team_id: TeamId) -> Step:
    """Make two teams one."""
    with services.database.read() as session:
        team = find_team(session, team_id)
        others = [
            (one.slug, one.name)
            for one in _by_name(session)
            if one is not team
            and not (one.is_reference or one.is_gone)
            and one.pending_since is None
        ]
    into = FormField("into", "Into", "choice", "the team that remains", True, options=tuple(others))
    return _step(
        team,
        title=f"Merge {team.name} into another team",
        meaning="Its submissions, people, addresses and questions move to the other team, its tokens are "
        "revoked, and what both used of their quotas is added up. Its own allowance covers only what it "
        f"sent; the other team does not get it. {AFTER_A_MERGE} This cannot be undone.",
        button="Merge",
        fields=(into, _retype_field(team), REASON),
        command=f'exceptiondrive organizer teams merge {team.slug} --into TEAM --reason "…"',
        is_grave=True,
        take=_once_typed(team, merge_teams),
        done="teams_merged",
        onward=lambda merged: _address(merged[0]),
    )


@step_at(router, "/teams/{team_id}/forget")
def forget(services: ServicesOf, team_id: TeamId) -> Step:
    """Forget a team."""
    with services.database.read() as session:
        team = find_team(session, team_id)
    return _step(
        team,
        title=f"Forget {team.name}",
        meaning="Its people, addresses, messages and what it says about its methods are removed from "
        "the records, and its tokens stop working. An alias replaces its name on every board, old ones "
        "too; scores stay. Do not name anybody in the reason. This cannot be undone.",
        button="Forget",
        fields=(_retype_field(team), REASON),
        command=f'exceptiondrive organizer teams forget {team.slug} --reason "…"',
        is_grave=True,
        take=_once_typed(team, forget_team),
        done="team_forgotten",
        onward=_address,
    )


def _retype_field(team: Team) -> FormField:
    """What is typed before an action that cannot be undone."""
    return FormField("again", f"Type {team.slug} to confirm", is_required=True, max_length=64)


def _once_typed(team: Team, action: Callable[..., Any]) -> Callable[..., Any]:
    """Return an action on a team that is done only if its id was typed once more."""

    def take(session: Session, *, again: str, **given: str) -> Any:
        if again != team.slug:
            raise InvalidRecord("Type the id of the team to confirm: this cannot be undone.")
        return action(session, team.slug, **given)

    return take


@step_at(router, "/teams/{team_id}/allowances/{phase_id}")
def allowance(
    browser: OrganizerBrowser, services: ServicesOf, team_id: TeamId, phase_id: PhaseId
) -> Step:
    """Set what one team has in a phase instead of what all have."""

    def texts(session: Session) -> dict[str, str]:
        row = allowance_of(session, find_team(session, team_id).id, phase_id)
        own = None if row is None else allowance_view(session, find_phase(session, phase_id), row)
        return {field.name: text_of(getattr(own, field.name, None)) for field in ALLOWANCE[:-1]}

    def kept(session: Session) -> dict[str, str]:
        lock_phase(session, phase_id)
        find_team(session, team_id, lock=True)
        return texts(session)

    with services.database.read() as session:
        team, phase = find_team(session, team_id), find_phase(session, phase_id)
        shown = texts(session)
    until = minute(phase.closes_at) if phase.closes_at else "none"
    step = _step(
        team,
        title=f"Allowance for {team.name} in {phase.title}",
        meaning="A later deadline also covers what the team uploaded before you granted it: nothing "
        "within it is late. Empty fields are as for all teams. The team is told.",
        button="Set the allowance",
        fields=ALLOWANCE,
        texts=shown,
        kept=kept,
        facts=(
            ("Deadline for all", until),
            ("Per day for all", str(phase.quota_per_day)),
            ("In total for all", str(phase.quota_total or "no limit")),
        ),
        command=f"exceptiondrive organizer teams limits {team.slug} --phase {phase.id} "
        '--closes-at TIME --reason "…"',
        take=partial(set_allowance, slug=team_id, phase_id=phase_id),
        done="allowance_set",
    )
    if browser.principal.is_organizer:
        return step
    return replace(
        step, section="phases", back=f"/organize/phases/{phase.id}", back_words="The phase"
    )


# Conduct.


@step_at(router, "/teams/{team_id}/disqualify")
def team_disqualification(services: ServicesOf, team_id: TeamId) -> Step:
    """Disqualify a team."""
    with services.database.read() as session:
        team = find_team(session, team_id)
        phases = tuple((one.id, one.title) for one in list_phases(session, with_hidden=True))
    options = (*phases, (_EVERY_PHASE, "every phase"))
    where = FormField("phase_id", "Phase", "choice", is_required=True, options=options)

    def take(session: Session, *, phase_id: str, **given: Any) -> Disqualification:
        only = None if phase_id == _EVERY_PHASE else phase_id
        return disqualify_team(session, team_id, phase_id=only, **given)

    return _step(
        team,
        title=f"Disqualify {team.name}",
        meaning="The team is on no new board and cannot submit until you reinstate it. Earlier boards "
        "keep what they showed; a frozen board shows the change at its reveal. The team is told.",
        button="Disqualify",
        fields=(where, TOLD_REASON, PUBLIC_NOTE),
        command=f'exceptiondrive organizer teams disqualify {team.slug} --reason "…"',
        is_grave=True,
        take=take,
        done="disqualified",
    )


@step_at(router, "/submissions/{submission_id}/disqualify")
def entry_disqualification(services: ServicesOf, submission_id: SubmissionId) -> Step:
    """Disqualify an entry."""
    with services.database.read() as session:
        submission = find_submission(session, submission_id)
        team = session.get_one(Team, submission.team_id)
    return Step(
        section="submissions",
        title=f"Disqualify {submission.method} of {team.name}",
        meaning="The entry is on no new board until you reinstate it. The entry that it displaced does "
        "not return, and the same bytes are refused. Earlier boards keep what they showed; a frozen "
        "board shows the change at its reveal. The team is told.",
        button="Disqualify",
        back=f"/organize/submissions/{submission.id}",
        back_words="The submission",
        fields=(TOLD_REASON, PUBLIC_NOTE),
        facts=(("File", submission.file_digest),),
        command=f'exceptiondrive organizer submissions disqualify {submission.id} --reason "…"',
        is_grave=True,
        take=partial(disqualify_submission, submission_id=submission_id),
        done="disqualified",
    )


@step_at(router, "/disqualifications/{disqualification_id}/reinstate")
def reinstatement(
    services: ServicesOf, disqualification_id: Annotated[int, Path(ge=1, le=2**31 - 1)]
) -> Step:
    """End a disqualification."""
    with services.database.read() as session:
        row = find_disqualification(session, disqualification_id)
        team = session.get_one(Team, row.team_id)
        where = find_phase(session, row.phase_id).title if row.phase_id else "every phase"
        what = "all entries of the team"
        if row.submission_id:
            what = f"the entry {find_submission(session, row.submission_id).method}"
    step = _step(
        team,
        title=f"Reinstate {what} of {team.name}" if row.submission_id else f"Reinstate {team.name}",
        meaning="The next board shows it again, unless another disqualification still applies. The "
        "team is told.",
        button="Reinstate",
        fields=(TOLD_REASON,),
        facts=(("What", what), ("Phase", where), ("Reason", row.reason)),
        command=f'exceptiondrive organizer teams reinstate {row.id} --reason "…"',
        take=partial(reinstate, disqualification_id=row.id),
        done="reinstated",
    )
    if row.submission_id is None:
        return step
    back = f"/organize/submissions/{row.submission_id}"
    return replace(step, section="submissions", back=back, back_words="The submission")


# Messages.


@router.get("/messages")
def show_message(
    browser: OrganizerBrowser, team: Annotated[str, Query(max_length=64)] = ""
) -> Response:
    """Ask for a message, and to whom."""
    with browser.services.database.read() as session:
        step = _message(session)
    return step_page(browser, step, texts={"teams": team})


@router.post("/messages")
def post_message(browser: OrganizerBrowser, form: PostedForm) -> Response:
    """Show a message as teams read it, and whom it reaches; sent once that was seen."""
    with browser.services.database.read() as session:
        step = _message(session)
        try:
            seen = _preview(session, step, read_form(step.fields, form))
        except RecordsError as refusal:
            return step_page(browser, step, texts=posted_texts(form), refusal=refusal)
    if form.get("is_seen") != "yes":
        return step_page(browser, seen)
    return take_step(browser, seen, form)


def _message(session: Session) -> Step:
    teams = tuple((one.slug, one.name) for one in _by_name(session) if not one.is_gone)
    phases = tuple((one.id, one.title) for one in list_phases(session, with_hidden=True))
    return Step(
        section="teams",
        title="Write to teams",
        meaning="The message goes to each team's inbox and to every confirmed address. The next page "
        "shows it as teams will read it, and how many it reaches; no address is shown.",
        button="Preview",
        back="/organize/teams",
        back_words="Teams",
        fields=(
            FormField("title", "Title", is_required=True, max_length=MAX_TITLE),
            FormField("text", "Text", "lines", "plain text; a blank line separates paragraphs",
                  is_required=True, max_length=MAX_TEXT),
            FormField("teams", "To", "several", "none ticked: every approved team",
                  options=teams),
            FormField("phase", "If none is ticked, only teams that submitted to", "choice", options=phases,
                  empty="any phase or none"),
        ),
        command='exceptiondrive organizer message "TITLE" --text FILE --to TEAM --preview',
        take=send_message,
        done="message_sent",
    )  # fmt: skip


def _preview(session: Session, step: Step, values: Mapping[str, Any]) -> Step:
    """Return the step that sends what was written, as teams read it."""
    title, paragraphs = checked_message(values["title"], values["text"])
    found = recipients(session, values["teams"], values["phase"])
    names = [one.name for one in found[:SHOWN_RECIPIENTS]]
    if len(found) > SHOWN_RECIPIENTS:
        names.append(f"and {len(found) - SHOWN_RECIPIENTS} more")
    n_emails, n_webhooks = sum(one.n_emails for one in found), sum(one.n_webhooks for one in found)
    told = [("teams", " ".join(values["teams"])), ("phase", values["phase"] or "")]
    return replace(
        step,
        title=f"Send “{title}”",
        meaning="This is what teams will read, in their inbox and in mail. It cannot be recalled.",
        button=f"Send to {counted(len(found), 'team')}",
        back="/organize/messages",
        back_words="Start over",
        fields=(),
        facts=(
            ("Text", paragraphs),
            ("To", tuple(names) or "nobody"),
            ("Also sent", f"by e-mail: {n_emails}, by webhook: {n_webhooks}"),
        ),
        hidden=(
            ("title", values["title"]),
            ("text", values["text"]),
            *((name, value) for name, value in told if value),
            ("is_seen", "yes"),
        ),
        command='exceptiondrive organizer message "TITLE" --text FILE --preview',
        take=partial(send_message, **values),
        onward=lambda _: "/organize/teams",
    )


def _step(team: Team, **words: Any) -> Step:
    return Step(section="teams", back=_address(team), back_words="The team", **words)


def _address(team: Team) -> str:
    return f"/organize/teams/{team.slug}"
