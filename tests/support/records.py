"""What stands in the records before a test begins: protocol, split, phases, teams and tokens."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session
from tests.support.documents import make_manifest

from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, TEAM_SCOPES, issue_token
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.splits import register_split
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import Manifest

ACTOR = "test"


@dataclass(frozen=True)
class Founded:
    """What was made; tokens by team, and that of `organizer`."""

    protocol: ProtocolRef
    team_ids: dict[str, int] = field(default_factory=dict)
    tokens: dict[str, str] = field(default_factory=dict)


def found(
    session: Session,
    teams: Mapping[str, str] | Iterable[str] = ("alpha",),
    *,
    scopes: tuple[str, ...] = TEAM_SCOPES,
    has_tokens: bool = True,
) -> Founded:
    """Make the packaged protocol and teams (names by slug); tokens for each and an organizer."""
    names = teams if isinstance(teams, Mapping) else {slug: slug.title() for slug in teams}
    row = add_protocol(session, packaged_protocol_toml(), ACTOR)
    founded = Founded(ProtocolRef(version=row.version, digest=row.digest))
    for slug, name in names.items():
        team = create_team(session, slug, name, actor=ACTOR)
        founded.team_ids[slug] = team.id
        if has_tokens:
            told, _ = issue_token(session, team.id, "laptop", scopes, actor=ACTOR)
            founded.tokens[slug] = told
    if has_tokens:
        told, _ = issue_token(session, None, "organizer", ORGANIZER_SCOPES, actor=ACTOR)
        founded.tokens["organizer"] = told
    return founded


def next_moment(database: Database) -> None:
    """Wait until what is written next has a later time than what was: SQLite tells milliseconds."""
    with database.read() as session:
        now = database_now(session)
        while database_now(session) == now:
            pass


def add_sample_split(session: Session, manifest: Manifest | None = None) -> None:
    """Register a split of which only the manifest exists."""
    made = manifest or make_manifest()
    register_split(session, made, {"sudden_emergence": len(made.sample_ids)}, ACTOR)


def add_phase(session: Session, phase_id: str = "dev", **settings: Any) -> None:
    """Open a planning phase on the sample split, unless told otherwise."""
    usual: dict[str, Any] = {"challenge": "planning", "title": phase_id, "split": "sample"}
    usual |= {"protocol": "1.0", "quota_per_day": 3, "quota_total": None}  # those of public splits
    create_phase(session, NewPhase(id=phase_id, **(usual | settings)), actor=ACTOR)


def count_audit_lines(session: Session, action: str) -> int:
    """Return how many lines of the audit log record this action."""
    query = select(func.count()).select_from(AuditLine).where(AuditLine.action == action)
    return session.scalar(query) or 0
