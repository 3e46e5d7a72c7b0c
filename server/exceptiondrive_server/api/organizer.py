"""What organizers do: teams, tokens, phases, protocols, audit. Every change leaves an audit line."""

from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Body, Depends, Path, Query
from pydantic import BaseModel, ConfigDict, Field

from exceptiondrive_records.audit import audit_page, verify_audit
from exceptiondrive_records.phases import create_phase, phase_view
from exceptiondrive_records.protocols import add_protocol
from exceptiondrive_records.splits import list_splits
from exceptiondrive_records.tables import Team, Token
from exceptiondrive_records.teams import create_team, find_team, list_teams
from exceptiondrive_records.tokens import (
    PARTICIPANT_SCOPES,
    Scope,
    issue_token,
    list_tokens,
    revoke_token,
)
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.submission import PhaseView
from exceptiondrive_server.api.protocols import ProtocolHead
from exceptiondrive_server.auth import Organizer, ServicesOf, require
from exceptiondrive_server.problems import problem_responses

router = APIRouter(
    prefix="/organizer",
    tags=["organizers"],
    dependencies=[Depends(require(Scope.ORGANIZE))],
    responses=problem_responses(
        ProblemCode.NOT_SIGNED_IN,
        ProblemCode.NOT_ALLOWED,
        ProblemCode.NOT_FOUND,
        ProblemCode.CONFLICT,
    ),
)
Slug = Annotated[str, Path(max_length=64, description="id of a team")]
MAX_PROTOCOL_CHARACTERS = 200_000


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid")


class NewTeam(_Request):
    """A team to be made."""

    id: Annotated[str, Field(max_length=64)]
    name: Annotated[str, Field(max_length=400)]
    is_reference: bool = False


class TeamView(BaseModel):
    """A team as organizers see it."""

    id: str
    name: str
    is_reference: bool
    created_at: datetime


class NewToken(_Request):
    """A token to be issued."""

    name: Annotated[str, Field(max_length=400)]
    scopes: tuple[Scope, ...] = PARTICIPANT_SCOPES
    expires_at: datetime | None = None


class TokenView(BaseModel):
    """A token without its secret."""

    id: str
    name: str
    prefix: str
    scopes: tuple[str, ...]
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    last_used_at: datetime | None


class IssuedToken(BaseModel):
    """A new token: its text is shown here and never again."""

    token: str
    view: TokenView


class NewPhase(_Request):
    """A phase to be made."""

    id: Annotated[str, Field(max_length=64)]
    challenge: ChallengeId
    title: Annotated[str, Field(max_length=400)]
    description: Annotated[str, Field(max_length=8000)] = ""
    split: Annotated[str, Field(max_length=64)]
    protocol: Annotated[str, Field(max_length=100)]
    opens_at: datetime | None = None
    closes_at: datetime | None = None
    quota_per_day: Annotated[int, Field(ge=0, le=10_000)] = 3
    quota_total: Annotated[int, Field(ge=0, le=1_000_000)] | None = None
    rejected_per_day: Annotated[int, Field(ge=0, le=10_000)] = 20
    shows_reported: bool = False


class SplitView(BaseModel):
    """A registered split revision."""

    name: str
    revision: str
    title: str
    n_samples: int
    is_public: bool


class AuditLineView(BaseModel):
    """One line of the audit log."""

    id: int
    at: datetime
    actor: str
    action: str
    subject: str
    detail: dict[str, Any]
    hash: str


class AuditVerdictView(BaseModel):
    """Whether the chain of the audit log is whole."""

    is_whole: bool
    n_lines: int
    head: str
    broken_at: int | None


@router.get("/teams", operation_id="listTeams")
def get_teams(services: ServicesOf) -> list[TeamView]:
    """List all teams."""
    with services.database.read() as session:
        return [_team(team) for team in list_teams(session)]


@router.post("/teams", operation_id="createTeam", status_code=201)
def post_team(services: ServicesOf, organizer: Organizer, team: NewTeam) -> TeamView:
    """Make a team."""
    with services.database.write() as session:
        made = create_team(
            session, team.id, team.name, is_reference=team.is_reference, actor=organizer.actor
        )
        return _team(made)


@router.get("/teams/{team_id}/tokens", operation_id="listTokens")
def get_tokens(services: ServicesOf, team_id: Slug) -> list[TokenView]:
    """List a team's tokens, without their secrets."""
    with services.database.read() as session:
        team = find_team(session, team_id)
        return [_token(token) for token in list_tokens(session, team.id)]


@router.post("/teams/{team_id}/tokens", operation_id="issueToken", status_code=201)
def post_token(
    services: ServicesOf, organizer: Organizer, team_id: Slug, token: NewToken
) -> IssuedToken:
    """Issue a token for a team; its text is answered once."""
    with services.database.write() as session:
        text, made = issue_token(
            session,
            find_team(session, team_id).id,
            token.name,
            tuple(token.scopes),
            token.expires_at,
            actor=organizer.actor,
        )
        return IssuedToken(token=text, view=_token(made))


@router.post("/tokens/{token_id}/revoke", operation_id="revokeToken")
def post_revocation(
    services: ServicesOf, organizer: Organizer, token_id: Annotated[str, Path(max_length=64)]
) -> TokenView:
    """Revoke a token for good."""
    with services.database.write() as session:
        return _token(revoke_token(session, token_id, actor=organizer.actor))


@router.get("/splits", operation_id="listSplits")
def get_splits(services: ServicesOf) -> list[SplitView]:
    """List the registered split revisions: what a phase may use."""
    with services.database.read() as session:
        return [
            SplitView(
                name=split.name,
                revision=split.revision,
                title=split.title,
                n_samples=split.n_samples,
                is_public=split.public_file_digest is not None,
            )
            for split in list_splits(session)
        ]


@router.post("/phases", operation_id="createPhase", status_code=201)
def post_phase(services: ServicesOf, organizer: Organizer, phase: NewPhase) -> PhaseView:
    """Make a phase."""
    with services.database.write() as session:
        made = create_phase(
            session,
            phase.id,
            challenge=phase.challenge.value,
            title=phase.title,
            description=phase.description,
            split_name=phase.split,
            protocol=phase.protocol,
            opens_at=phase.opens_at,
            closes_at=phase.closes_at,
            quota_per_day=phase.quota_per_day,
            quota_total=phase.quota_total,
            rejected_per_day=phase.rejected_per_day,
            shows_reported=phase.shows_reported,
            actor=organizer.actor,
        )
        limit = services.settings.max_upload_bytes
        return phase_view(session, made, max_upload_bytes=limit)


@router.post("/protocols", operation_id="addProtocol", status_code=201)
def post_protocol(
    services: ServicesOf,
    organizer: Organizer,
    toml: Annotated[str, Body(media_type="application/toml", max_length=MAX_PROTOCOL_CHARACTERS)],
) -> ProtocolHead:
    """Add a protocol document; it is immutable from then on."""
    with services.database.write() as session:
        added = add_protocol(session, toml, organizer.actor)
    return ProtocolHead(
        version=added.version, digest=added.digest, title=added.title, changes=added.changes
    )


@router.get("/audit", operation_id="readAudit")
def get_audit(
    services: ServicesOf,
    before: Annotated[int | None, Query(ge=1, lt=2**31)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> list[AuditLineView]:
    """Read the audit log, newest first."""
    with services.database.read() as session:
        return [
            AuditLineView(
                id=line.id,
                at=line.at,
                actor=line.actor,
                action=line.action,
                subject=line.subject,
                detail=line.detail,
                hash=line.hash,
            )
            for line in audit_page(session, before=before, limit=limit)
        ]


@router.get("/audit/verify", operation_id="verifyAudit")
def get_audit_verdict(services: ServicesOf) -> AuditVerdictView:
    """Recompute the chain: an altered, missing or reordered line is found."""
    with services.database.read() as session:
        verdict = verify_audit(session)
    return AuditVerdictView(
        is_whole=verdict.is_whole,
        n_lines=verdict.n_lines,
        head=verdict.head,
        broken_at=verdict.broken_at,
    )


def _team(team: Team) -> TeamView:
    return TeamView(
        id=team.slug, name=team.name, is_reference=team.is_reference, created_at=team.created_at
    )


def _token(token: Token) -> TokenView:
    return TokenView(
        id=token.id,
        name=token.name,
        prefix=token.prefix,
        scopes=tuple(token.scopes),
        created_at=token.created_at,
        expires_at=token.expires_at,
        revoked_at=token.revoked_at,
        last_used_at=token.last_used_at,
    )
