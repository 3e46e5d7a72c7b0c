"""Organizers manage teams: disqualification, allowances, names, messages, imports."""

from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import BaseModel, Field

from exceptiondrive_records.participation.allowances import set_allowance
from exceptiondrive_records.participation.changes import MAX_AFFILIATION, change_team, merge_teams
from exceptiondrive_records.participation.disqualification import (
    MAX_NOTE,
    disqualify_submission,
    disqualify_team,
    list_disqualifications,
    reinstate,
)
from exceptiondrive_records.participation.forgetting import forget_team
from exceptiondrive_records.participation.importing import import_teams
from exceptiondrive_records.participation.messages import (
    MAX_TEXT,
    MAX_TITLE,
    checked_message,
    recipients,
    send_message,
)
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_schemas.datetimes import Time
from exceptiondrive_server.participation.queries import (
    AllowanceView,
    DisqualificationView,
    Participation,
    allowance_view,
    disqualification_view,
    participation_of,
)
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Action, Form
from exceptiondrive_server.web.path_ids import PhaseId, SubmissionId, TeamId

router = APIRouter()
Quota = Annotated[int, Field(ge=1, le=1_000_000)]
MAX_TABLE = 200_000


class TeamChange(Action):
    """What is changed of a team; what is left out stays."""

    name: Annotated[str | None, Field(max_length=400)] = None
    affiliation: Annotated[str | None, Field(max_length=MAX_AFFILIATION)] = None


class ChangedTeam(BaseModel):
    """A team after a change."""

    id: str
    name: str
    affiliation: str


class Merge(Action):
    """Of which team this one becomes a part."""

    into: Annotated[str, Field(max_length=64, description="id of a team")]


class Merged(BaseModel):
    """The team that is left, and how many submissions it was given."""

    id: str
    name: str
    n_submissions: int


class EntryDisqualification(Action):
    """Why an entry is disqualified."""

    public_note: Annotated[str | None, Field(max_length=MAX_NOTE)] = None
    """What readers of the board are told; without one, nothing."""


class TeamDisqualification(EntryDisqualification):
    """Why a team is disqualified, and where."""

    phase: Annotated[str | None, Field(max_length=64, description="null: in every phase")] = None


class NewAllowance(Action):
    """What a team has in a phase instead of what all have; null: as all, left out: as it is."""

    closes_at: Time | None = None
    quota_per_day: Quota | None = None
    quota_total: Quota | None = None


class TeamTable(Form):
    """Many teams, as CSV with the columns id, name, affiliation and email."""

    csv: Annotated[str, Field(max_length=MAX_TABLE)]


class ImportedView(BaseModel):
    """A team that was made; its token is answered here and never again."""

    id: str
    name: str
    token: str


class ImportedTeams(BaseModel):
    """The teams that were made."""

    teams: list[ImportedView]


class NewMessage(Form):
    """What is written, and to whom."""

    title: Annotated[str, Field(max_length=MAX_TITLE)]
    text: Annotated[str, Field(max_length=MAX_TEXT)]
    teams: Annotated[tuple[str, ...], Field(max_length=500)] = ()
    """Ids; without any, every team that is approved."""
    phase: Annotated[str | None, Field(max_length=64)] = None
    """Of every team: those that submitted to this phase."""
    is_preview: bool = False
    """Answer whom it would reach, and send nothing."""


class RecipientView(BaseModel):
    """A team that is told in its inbox, and at how many addresses besides: never which ones."""

    team: str
    name: str
    n_emails: int
    n_webhooks: int


class MessageView(BaseModel):
    """A message as teams read it, and whom it reaches."""

    title: str
    paragraphs: tuple[str, ...]
    is_sent: bool
    recipients: list[RecipientView]


@router.get("/teams/{team_id}/participation", operation_id="showParticipation")
def get_participation(services: ServicesOf, team_id: TeamId) -> Participation:
    """Show people, addresses, allowances, disqualifications and accepted terms of a team."""
    with services.database.read() as session:
        return participation_of(session, find_team(session, team_id))


@router.patch("/teams/{team_id}", operation_id="changeTeam")
def patch_team(
    services: ServicesOf, organizer: Organizer, team_id: TeamId, change: TeamChange
) -> ChangedTeam:
    """Change a team's name or affiliation; omitted fields stay.

    New boards show the new name, earlier ones stay as they are.
    """
    with services.database.write() as session:
        team = change_team(session, team_id, **change.model_dump(), actor=organizer.actor)
        return ChangedTeam(id=team.slug, name=team.name, affiliation=team.affiliation)


@router.post("/teams/{team_id}/merge", operation_id="mergeTeams")
def post_merge(services: ServicesOf, organizer: Organizer, team_id: TeamId, merge: Merge) -> Merged:
    """Merge a team into another one, with submissions, people and addresses; this cannot be undone."""
    with services.database.write() as session:
        team, n_moved = merge_teams(session, team_id, **merge.model_dump(), actor=organizer.actor)
        return Merged(id=team.slug, name=team.name, n_submissions=n_moved)


@router.post("/teams/{team_id}/forget", operation_id="forgetTeam")
def post_forgetting(
    services: ServicesOf, organizer: Organizer, team_id: TeamId, action: Action
) -> ChangedTeam:
    """Delete all personal data of a team; boards show an alias instead of its name.

    The reason stays in the audit log, so name nobody in it.
    """
    with services.database.write() as session:
        team = forget_team(session, team_id, reason=action.reason, actor=organizer.actor)
        return ChangedTeam(id=team.slug, name=team.name, affiliation=team.affiliation)


@router.post("/teams/{team_id}/disqualify", operation_id="disqualifyTeam", status_code=201)
def post_team_disqualification(
    services: ServicesOf, organizer: Organizer, team_id: TeamId, wanted: TeamDisqualification
) -> DisqualificationView:
    """Disqualify a team from a phase, or from all: it leaves the boards and cannot submit."""
    with services.database.write() as session:
        row = disqualify_team(
            session,
            team_id,
            reason=wanted.reason,
            public_note=wanted.public_note,
            phase_id=wanted.phase,
            actor=organizer.actor,
        )
        return disqualification_view(session, row)


@router.post(
    "/submissions/{submission_id}/disqualify", operation_id="disqualifySubmission", status_code=201
)
def post_entry_disqualification(
    services: ServicesOf,
    organizer: Organizer,
    submission_id: SubmissionId,
    wanted: EntryDisqualification,
) -> DisqualificationView:
    """Disqualify one submission: it leaves the boards, and the same bytes are refused from then on."""
    with services.database.write() as session:
        row = disqualify_submission(
            session, submission_id, **wanted.model_dump(), actor=organizer.actor
        )
        return disqualification_view(session, row)


@router.get("/disqualifications", operation_id="listDisqualifications")
def get_disqualifications(services: ServicesOf) -> list[DisqualificationView]:
    """List disqualifications, newest first, including ended ones."""
    with services.database.read() as session:
        return [disqualification_view(session, row) for row in list_disqualifications(session)]


@router.post("/disqualifications/{disqualification_id}/reinstate", operation_id="reinstate")
def post_reinstatement(
    services: ServicesOf,
    organizer: Organizer,
    disqualification_id: Annotated[int, Path(ge=1, le=2**31 - 1)],
    action: Action,
) -> DisqualificationView:
    """End a disqualification: the next board shows all entries that no other one excludes."""
    with services.database.write() as session:
        row = reinstate(session, disqualification_id, reason=action.reason, actor=organizer.actor)
        return disqualification_view(session, row)


@router.patch("/teams/{team_id}/allowances/{phase_id}", operation_id="setAllowance")
def patch_allowance(
    services: ServicesOf,
    organizer: Organizer,
    team_id: TeamId,
    phase_id: PhaseId,
    wanted: NewAllowance,
) -> AllowanceView:
    """Set a later deadline or another quota for one team; omitted fields stay."""
    with services.database.write() as session:
        row = set_allowance(
            session,
            team_id,
            phase_id,
            **wanted.model_dump(exclude_unset=True),
            actor=organizer.actor,
        )
        if row is None:
            return AllowanceView(phase=phase_id)
        return allowance_view(session, find_phase(session, phase_id), row)


@router.post("/team-imports", operation_id="importTeams", status_code=201)
def post_import(services: ServicesOf, organizer: Organizer, table: TeamTable) -> ImportedTeams:
    """Create the teams of a table, with a token each: all of them, or none."""
    with services.database.write() as session:
        made = import_teams(session, table.csv, actor=organizer.actor)
        teams = [ImportedView(id=one.slug, name=one.name, token=one.token) for one in made]
    return ImportedTeams(teams=teams)


@router.post("/messages", operation_id="sendMessage")
def post_message(services: ServicesOf, organizer: Organizer, message: NewMessage) -> MessageView:
    """Send a message to one, some or all teams (inbox, e-mail, webhooks), or preview its recipients."""
    title, paragraphs = checked_message(message.title, message.text)
    if message.is_preview:
        with services.database.read() as session:
            found = recipients(session, message.teams, message.phase)
    else:
        with services.database.write() as session:
            given = message.model_dump(exclude={"is_preview"})
            found = send_message(session, **given, actor=organizer.actor)
    return MessageView(
        title=title,
        paragraphs=paragraphs,
        is_sent=not message.is_preview,
        recipients=[RecipientView(**one._asdict()) for one in found],
    )
