"""What organizers do with teams, each deed on a page of its own, and messages with a preview."""

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import InvalidRecord, NotFound, RecordsError
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
from exceptiondrive_records.phases.allowances import allowance_of
from exceptiondrive_records.phases.phases import find_phase, list_phases
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team, list_teams
from exceptiondrive_schemas.form_fields import FormField
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import PostedForm
from exceptiondrive_server.web.forms import REASON, filled, read, text_of, typed
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    organizer_page,
    step_page,
    take_step,
)

router = APIRouter(prefix="/organize", include_in_schema=False)
Slug = Annotated[str, Path(max_length=64)]
SubmissionId = Annotated[str, Path(max_length=64)]
DisqualificationId = Annotated[int, Path(ge=1, le=2**31 - 1)]
TOLD_REASON = FormField(
    "reason",
    "Reason",
    "lines",
    "told to the team, and kept in the audit log with your name",
    is_required=True,
    max_length=1000,
)
PUBLIC_NOTE = FormField(
    "public_note",
    "Public note",
    "lines",
    "stands below the board; empty: readers are told nothing",
    max_length=MAX_NOTE,
)
NAMES = (
    FormField("name", "Name", hint="as new boards show it", is_required=True, max_length=80),
    FormField("affiliation", "Affiliation", hint="for organizers", max_length=MAX_AFFILIATION),
    REASON,
)
LIMITS = (
    FormField("closes_at", "Own deadline", "moment", "empty: as for all teams"),
    FormField("quota_per_day", "Submissions a day", "whole", "empty: as for all teams"),
    FormField("quota_total", "Submissions in all", "whole", "empty: as for all teams"),
    TOLD_REASON,
)
TABLE = (
    FormField("csv", "Table", "lines", f"columns {', '.join(COLUMNS)}; the last two may be left out",
          is_required=True, max_length=200_000),
)  # fmt: skip
SHOWN_RECIPIENTS = 40


# Many teams at once.


@router.get("/teams/import")
def show_import(request: Request, browser: OrganizerBrowser) -> Response:
    """Ask for a table of teams."""
    return _import_page(request, browser)


@router.post("/teams/import")
def post_import(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, form: PostedForm
) -> Response:
    """Make the teams of a table, and show their tokens this once."""
    try:
        text = read(TABLE, form)["csv"]
        with services.database.write() as session:
            made = import_teams(session, text, actor=browser.principal.actor)
    except RecordsError as refusal:
        return _import_page(request, browser, texts=typed(form), refusal=refusal)
    return _import_page(request, browser, issued=tokens_table(made), n_made=len(made))


def _import_page(
    request: Request,
    browser: OrganizerBrowser,
    *,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
    issued: str | None = None,
    n_made: int = 0,
) -> Response:
    template = "participation/organizer_import.html"
    return organizer_page(
        request,
        browser,
        template,
        "teams",
        refusal=refusal,
        fields=filled(TABLE, texts or {}),
        issued=issued,
        n_made=n_made,
    )


# Name and affiliation; a team that is part of another.


@router.get("/teams/{team_id}/change")
def show_change(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, team_id: Slug
) -> Response:
    """Ask for a new name or affiliation."""
    with services.database.read() as session:
        team = find_team(session, team_id)
    texts = {"name": team.name, "affiliation": team.affiliation}
    return step_page(request, browser, _change(team), texts=texts)


@router.post("/teams/{team_id}/change")
def post_change(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    team_id: Slug,
) -> Response:
    """Change name or affiliation."""

    def take(session: Session, values: Mapping[str, str]) -> None:
        change_team(session, team_id, **values, actor=browser.principal.actor)

    with services.database.read() as session:
        step = _change(find_team(session, team_id))
    return take_step(request, services, browser, step, form, take, "team_changed")


def _change(team: Team) -> Step:
    return _step(
        team,
        title=f"Rename {team.name}",
        meaning="New boards show the new name, and the team is told. Earlier boards, and those of "
        "archived phases, stay as they are.",
        button="Change",
        fields=NAMES,
        command=f'exceptiondrive organizer teams change {team.slug} --name "…" --reason "…"',
    )


@router.get("/teams/{team_id}/merge")
def show_merge(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, team_id: Slug
) -> Response:
    """Ask of which team this one becomes a part."""
    with services.database.read() as session:
        step = _merge(session, find_team(session, team_id))
    return step_page(request, browser, step)


@router.post("/teams/{team_id}/merge")
def post_merge(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    team_id: Slug,
) -> Response:
    """Make two teams one."""

    def take(session: Session, values: Mapping[str, str]) -> str:
        merge_teams(session, team_id, **values, actor=browser.principal.actor)
        return f"/organize/teams/{values['into']}"

    with services.database.read() as session:
        step = _merge(session, find_team(session, team_id))
    return take_step(request, services, browser, step, form, take, "teams_merged")


def _merge(session: Session, team: Team) -> Step:
    others = [
        (one.slug, one.name)
        for one in list_teams(session)
        if one is not team and not one.is_reference and one.pending_since is None
    ]
    into = FormField("into", "Into", "choice", "the team that stays", True, options=tuple(others))
    return _step(
        team,
        title=f"Merge {team.name} into another team",
        meaning="Its submissions, people and addresses become the other team's, its tokens are "
        "revoked, and both quotas count together. This cannot be taken back.",
        button="Merge",
        fields=(into, REASON),
        command=f'exceptiondrive organizer teams merge {team.slug} --into TEAM --reason "…"',
        is_grave=True,
    )


@router.get("/teams/{team_id}/forget")
def show_forgetting(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, team_id: Slug
) -> Response:
    """Ask whether a team shall be forgotten."""
    with services.database.read() as session:
        step = _forgetting(find_team(session, team_id))
    return step_page(request, browser, step)


@router.post("/teams/{team_id}/forget")
def post_forgetting(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    team_id: Slug,
) -> Response:
    """Forget a team whose id was typed once more."""

    def take(session: Session, values: Mapping[str, str]) -> str:
        if values["again"] != team_id:
            raise InvalidRecord("Type the id of the team once more: this cannot be taken back.")
        team = forget_team(session, team_id, reason=values["reason"], actor=browser.principal.actor)
        return f"/organize/teams/{team.slug}"

    with services.database.read() as session:
        step = _forgetting(find_team(session, team_id))
    return take_step(request, services, browser, step, form, take, "team_forgotten")


def _forgetting(team: Team) -> Step:
    again = FormField("again", f"Type {team.slug}", is_required=True, max_length=64)
    return _step(
        team,
        title=f"Forget {team.name}",
        meaning="People, addresses, messages and what it says of its methods are taken out of the "
        "records, its tokens end, and an alias stands on every board, old ones too; scores and the "
        "digests of boards stay. Name nobody in the reason. This cannot be taken back.",
        button="Forget",
        fields=(again, REASON),
        command=f'exceptiondrive organizer teams forget {team.slug} --reason "…"',
        is_grave=True,
    )


# A deadline or quota of its own.


@router.get("/teams/{team_id}/limits/{phase_id}")
def show_limits(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, team_id: Slug, phase_id: Slug
) -> Response:
    """Ask for the limits of one team in a phase, filled with those it has."""
    with services.database.read() as session:
        team = find_team(session, team_id)
        step = _limits(session, team, phase_id)
        row = allowance_of(session, team.id, phase_id)
    texts = {field.name: text_of(getattr(row, field.name, None)) for field in LIMITS[:-1]}
    return step_page(request, browser, step, texts=texts)


@router.post("/teams/{team_id}/limits/{phase_id}")
def post_limits(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    team_id: Slug,
    phase_id: Slug,
) -> Response:
    """Set the limits of one team in a phase."""

    def take(session: Session, values: Mapping[str, Any]) -> None:
        set_allowance(session, team_id, phase_id, **values, actor=browser.principal.actor)

    with services.database.read() as session:
        step = _limits(session, find_team(session, team_id), phase_id)
    return take_step(request, services, browser, step, form, take, "allowance_set")


def _limits(session: Session, team: Team, phase_id: str) -> Step:
    phase = find_phase(session, phase_id)
    until = f"{phase.closes_at:%Y-%m-%d %H:%M} UTC" if phase.closes_at else "none"
    return _step(
        team,
        title=f"Limits of {team.name} in {phase.title}",
        meaning="A later deadline holds for what came before it was granted, too: within it an "
        "upload is not late. What stays empty is as for all teams. The team is told.",
        button="Set the limits",
        fields=LIMITS,
        facts=(
            ("Deadline for all", until),
            ("A day", str(phase.quota_per_day)),
            ("In all", str(phase.quota_total or "no limit")),
        ),
        command=f"exceptiondrive organizer teams limits {team.slug} --phase {phase.id} "
        '--closes-at TIME --reason "…"',
    )


# Conduct.


@router.get("/teams/{team_id}/disqualify")
def show_team_disqualification(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, team_id: Slug
) -> Response:
    """Ask why a team is disqualified, and where."""
    with services.database.read() as session:
        step = _team_disqualification(session, find_team(session, team_id))
    return step_page(request, browser, step)


@router.post("/teams/{team_id}/disqualify")
def post_team_disqualification(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    team_id: Slug,
) -> Response:
    """Disqualify a team."""

    def take(session: Session, values: Mapping[str, Any]) -> None:
        disqualify_team(session, team_id, **values, actor=browser.principal.actor)

    with services.database.read() as session:
        step = _team_disqualification(session, find_team(session, team_id))
    return take_step(request, services, browser, step, form, take, "disqualified")


def _team_disqualification(session: Session, team: Team) -> Step:
    phases = tuple((one.id, one.title) for one in list_phases(session, with_hidden=True))
    where = FormField("phase_id", "Where", "choice", options=phases, empty="in every phase")
    return _step(
        team,
        title=f"Disqualify {team.name}",
        meaning="It stands on no further board and submits nothing until it is reinstated; earlier "
        "boards keep what they showed. A frozen board shows that at its reveal. The team is told.",
        button="Disqualify",
        fields=(where, TOLD_REASON, PUBLIC_NOTE),
        command=f'exceptiondrive organizer teams disqualify {team.slug} --reason "…"',
        is_grave=True,
    )


@router.get("/submissions/{submission_id}/disqualify")
def show_entry_disqualification(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, submission_id: SubmissionId
) -> Response:
    """Ask why an entry is disqualified."""
    with services.database.read() as session:
        step = _entry_disqualification(session, submission_id)
    return step_page(request, browser, step)


@router.post("/submissions/{submission_id}/disqualify")
def post_entry_disqualification(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    submission_id: SubmissionId,
) -> Response:
    """Disqualify an entry."""

    def take(session: Session, values: Mapping[str, Any]) -> None:
        disqualify_submission(session, submission_id, **values, actor=browser.principal.actor)

    with services.database.read() as session:
        step = _entry_disqualification(session, submission_id)
    return take_step(request, services, browser, step, form, take, "disqualified")


def _entry_disqualification(session: Session, submission_id: str) -> Step:
    submission = find_submission(session, submission_id)
    team = session.get_one(Team, submission.team_id)
    return Step(
        section="submissions",
        title=f"Disqualify {submission.method} of {team.name}",
        meaning="It stands on no further board until it is reinstated, what it displaced does not "
        "come up, and its bytes are not taken again. Earlier boards keep what they showed; a frozen "
        "board shows that at its reveal. The team is told.",
        button="Disqualify",
        back=f"/organize/submissions/{submission.id}",
        back_words="The submission",
        fields=(TOLD_REASON, PUBLIC_NOTE),
        facts=(("File", submission.file_digest),),
        command=f'exceptiondrive organizer submissions disqualify {submission.id} --reason "…"',
        is_grave=True,
    )


@router.get("/disqualifications/{disqualification_id}/reinstate")
def show_reinstatement(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    disqualification_id: DisqualificationId,
) -> Response:
    """Ask why a disqualification ends."""
    with services.database.read() as session:
        step = _reinstatement(session, disqualification_id)
    return step_page(request, browser, step)


@router.post("/disqualifications/{disqualification_id}/reinstate")
def post_reinstatement(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    disqualification_id: DisqualificationId,
) -> Response:
    """End a disqualification."""

    def take(session: Session, values: Mapping[str, Any]) -> None:
        reinstate(session, disqualification_id, **values, actor=browser.principal.actor)

    with services.database.read() as session:
        step = _reinstatement(session, disqualification_id)
    return take_step(request, services, browser, step, form, take, "reinstated")


def _reinstatement(session: Session, disqualification_id: int) -> Step:
    row = find_disqualification(session, disqualification_id)
    team = session.get_one(Team, row.team_id)
    what = row.submission_id or "everything of the team"
    return _step(
        team,
        title=f"Reinstate {team.name}",
        meaning="What was taken off the boards stands on the next one. The team is told.",
        button="Reinstate",
        fields=(TOLD_REASON,),
        facts=(("What", what), ("Where", row.phase_id or "every phase"), ("Reason", row.reason)),
        command=f'exceptiondrive organizer teams reinstate {row.id} --reason "…"',
    )


# Messages.


@router.get("/messages")
def show_message(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    team: Annotated[str, Query(max_length=64)] = "",
) -> Response:
    """Ask for a message, and to whom."""
    with services.database.read() as session:
        fields = _message_fields(session)
    return _message_page(request, browser, fields, {"teams": team})


@router.post("/messages")
def post_message(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, form: PostedForm
) -> Response:
    """Show a message as teams read it, and whom it reaches; sent once that was seen."""
    with services.database.read() as session:
        fields = _message_fields(session)
    try:
        values = read(fields, form)
        with services.database.read() as session:
            step = _message(session, values)
    except RecordsError as refusal:
        if isinstance(refusal, NotFound):
            raise
        return _message_page(request, browser, fields, typed(form), refusal=refusal)
    if form.get("is_seen") != "yes":
        return step_page(request, browser, step)

    def take(session: Session, _: object) -> str:
        title, text, whom = values["title"], values["text"], values["teams"]
        who = browser.principal.actor
        send_message(session, title, text, slugs=whom, phase_id=values["phase"], actor=who)
        return "/organize/teams"

    return take_step(request, services, browser, step, form, take, "message_sent")


def _message_fields(session: Session) -> tuple[FormField, ...]:
    teams = tuple((one.slug, one.name) for one in list_teams(session))
    phases = tuple((one.id, one.title) for one in list_phases(session, with_hidden=True))
    return (
        FormField("title", "Title", is_required=True, max_length=MAX_TITLE),
        FormField("text", "Text", "lines", "plain words; a blank line parts paragraphs",
              is_required=True, max_length=MAX_TEXT),
        FormField("teams", "To", "several", "none ticked: every team that is approved",
              options=teams),
        FormField("phase", "Of every team, those that submitted to", "choice", options=phases,
              empty="any phase or none"),
    )  # fmt: skip


def _message(session: Session, values: Mapping[str, Any]) -> Step:
    title, paragraphs = checked_message(values["title"], values["text"])
    found = recipients(session, values["teams"], values["phase"])
    names = [one.name for one in found[:SHOWN_RECIPIENTS]]
    if len(found) > SHOWN_RECIPIENTS:
        names.append(f"and {len(found) - SHOWN_RECIPIENTS} more")
    n_emails, n_webhooks = sum(one.n_emails for one in found), sum(one.n_webhooks for one in found)
    told = [("teams", " ".join(values["teams"])), ("phase", values["phase"] or "")]
    return Step(
        section="teams",
        title=f"Send “{title}”",
        meaning="This is what teams read, in their inbox and in mails; it cannot be called back.",
        button=f"Send to {counted(len(found), 'team')}",
        back="/organize/messages",
        back_words="Write anew",
        facts=(
            ("Text", paragraphs),
            ("To", tuple(names) or "nobody"),
            ("Addresses told besides", f"by e-mail: {n_emails}, by webhook: {n_webhooks}"),
        ),
        hidden=(
            ("title", values["title"]),
            ("text", values["text"]),
            *((name, value) for name, value in told if value),
            ("is_seen", "yes"),
        ),
        command='exceptiondrive organizer message "TITLE" --text FILE --preview',
    )


def _message_page(
    request: Request,
    browser: OrganizerBrowser,
    fields: tuple[FormField, ...],
    texts: Mapping[str, str],
    refusal: RecordsError | None = None,
) -> Response:
    step = Step(
        section="teams",
        title="Write to teams",
        meaning="It stands in the inbox of each team and goes to every confirmed address. The next "
        "page shows it as teams read it, and how many it reaches; no address is shown.",
        button="Preview",
        back="/organize/teams",
        back_words="Teams",
        fields=fields,
        command='exceptiondrive organizer message "TITLE" --text FILE --to TEAM --preview',
    )
    return step_page(request, browser, step, texts=texts, refusal=refusal)


def _step(team: Team, **words: Any) -> Step:
    return Step(
        section="teams", back=f"/organize/teams/{team.slug}", back_words="The team", **words
    )
