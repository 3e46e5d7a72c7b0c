"""Operator commands on the records: teams, tokens, phases, protocols, submissions, audit."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy.orm import Session

from exceptiondrive_records import phases, protocols, splits, submissions, teams, tokens
from exceptiondrive_records.audit import verify_audit
from exceptiondrive_records.errors import RecordsError
from exceptiondrive_records.retries import retry_submission
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.phase_settings import NewPhase
from exceptiondrive_server.operator_session import ACTOR, DataOption, opened, records_settings, say

records_app = typer.Typer()

Team = Annotated[str, typer.Argument(metavar="TEAM", help="Id of the team.")]
Days = Annotated[
    int | None, typer.Option("--days", min=1, help="Days until the token expires; default never.")
]
TokenName = Annotated[str, typer.Option("--name", help="What the token is for.")]
Date = Annotated[datetime | None, typer.Option(help="UTC; default no limit.")]


@records_app.command("create-team")
def create_team(
    team: Team,
    name: Annotated[str, typer.Argument(metavar="NAME", help="As it stands on the board.")],
    reference: Annotated[
        bool, typer.Option("--reference", help="Its entries are references, never ranked.")
    ] = False,
    with_token: Annotated[bool, typer.Option("--with-token", help="Print a token too.")] = False,
    data: DataOption = None,
) -> None:
    """Create a team."""
    with opened(records_settings(data)) as database, database.write() as session:
        row = teams.create_team(session, team, name, is_reference=reference, actor=ACTOR)
        text = _token(session, row.id, "first token") if with_token else None
    say(f"team {team} created")
    if text is not None:
        _print_token(text)


@records_app.command("create-token")
def create_token(
    team: Team, name: TokenName = "token", days: Days = None, data: DataOption = None
) -> None:
    """Issue a token for a team and print it, once."""
    with opened(records_settings(data)) as database, database.write() as session:
        text = _token(session, teams.find_team(session, team).id, name, days)
    _print_token(text)


@records_app.command("create-organizer")
def create_organizer(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Who the organizer is.")],
    days: Days = None,
    data: DataOption = None,
) -> None:
    """Issue a token with which an organizer may do everything, and print it, once."""
    with opened(records_settings(data)) as database, database.write() as session:
        text = _token(session, None, name, days, tokens.ORGANIZER_SCOPES)
    _print_token(text)


@records_app.command("revoke-token")
def revoke_token(
    token_id: Annotated[str, typer.Argument(metavar="ID", help="The eight letters of its id.")],
    data: DataOption = None,
) -> None:
    """Revoke a token for good."""
    with opened(records_settings(data)) as database, database.write() as session:
        tokens.revoke_token(session, token_id, actor=ACTOR)
    say(f"token {token_id} revoked")


@records_app.command("create-phase")
def create_phase(
    phase: Annotated[str, typer.Argument(metavar="PHASE", help="Id; stands in addresses.")],
    split: Annotated[str, typer.Option("--split", help="Name of a registered split.")],
    title: Annotated[str | None, typer.Option("--title", help="Default: the id.")] = None,
    challenge: Annotated[str, typer.Option("--challenge", help="planning, strategy.")] = "planning",
    protocol: Annotated[str, typer.Option("--protocol", help="Version or digest.")] = "1.0",
    revision: Annotated[str | None, typer.Option("--revision", help="Default: newest.")] = None,
    description: Annotated[str, typer.Option("--description")] = "",
    opens_at: Date = None,
    closes_at: Date = None,
    per_day: Annotated[int, typer.Option("--per-day", help="Submissions of a team a day.")] = 3,
    total: Annotated[int | None, typer.Option("--total", help="Submissions of a team.")] = None,
    concurrent: Annotated[
        int | None, typer.Option("--concurrent", help="Waiting for a score at once.")
    ] = None,
    rejected_per_day: Annotated[
        int, typer.Option("--rejected-per-day", help="Wrong files of a team a day.")
    ] = 20,
    shows_reported: Annotated[
        bool, typer.Option("--shows-reported", help="Show the paper's rows beside the entries.")
    ] = False,
    data: DataOption = None,
) -> None:
    """Create a phase on a registered split."""
    with opened(records_settings(data)) as database, database.write() as session:
        new = NewPhase(
            id=phase,
            challenge=ChallengeId(challenge),
            title=title or phase,
            description=description,
            split=split,
            split_revision=revision,
            protocol=protocol,
            opens_at=_utc(opens_at),
            closes_at=_utc(closes_at),
            quota_per_day=per_day,
            quota_total=total,
            quota_concurrent=concurrent,
            rejected_per_day=rejected_per_day,
            shows_reported=shows_reported,
        )
        phases.create_phase(session, new, actor=ACTOR)
    say(f"phase {phase} created on split {split}")


@records_app.command("add-protocol")
def add_protocol(
    file: Annotated[Path, typer.Argument(metavar="FILE", exists=True, dir_okay=False)],
    data: DataOption = None,
) -> None:
    """Add a protocol document (TOML)."""
    with opened(records_settings(data)) as database, database.write() as session:
        protocol = protocols.add_protocol(session, file.read_text(encoding="utf-8"), ACTOR)
    say(f"protocol {protocol.version} is on the records: {protocol.digest}")


@records_app.command("retry")
def retry(
    submission: Annotated[str, typer.Argument(metavar="SUBMISSION", help="Id.")],
    data: DataOption = None,
) -> None:
    """Queue a failed submission again, with all its attempts."""
    with opened(records_settings(data)) as database, database.write() as session:
        retry_submission(session, submission, actor=ACTOR)
    say(f"submission {submission} is queued again")


@records_app.command("list-teams")
def list_teams(data: DataOption = None) -> None:
    """List teams: id, name."""
    with opened(records_settings(data)) as database, database.read() as session:
        _table([(team.slug, team.name) for team in teams.list_teams(session)])


@records_app.command("list-tokens")
def list_tokens(data: DataOption = None) -> None:
    """List tokens: id, name, scopes, state."""
    with opened(records_settings(data)) as database, database.read() as session:
        _table(
            [
                (row.id, row.name, ",".join(row.scopes), "revoked" if row.revoked_at else "live")
                for row in tokens.list_tokens(session)
            ]
        )


@records_app.command("list-phases")
def list_phases(data: DataOption = None) -> None:
    """List phases: id, challenge, split, title."""
    with opened(records_settings(data)) as database, database.read() as session:
        rows = phases.list_phases(session)
        _table([(row.id, row.challenge, row.split_name, row.title) for row in rows])


@records_app.command("list-splits")
def list_splits(data: DataOption = None) -> None:
    """List splits: name, samples, revision, whether published."""
    with opened(records_settings(data)) as database, database.read() as session:
        _table(
            [
                (row.name, str(row.n_samples), row.revision, _publicity(row.public_file_digest))
                for row in splits.list_splits(session)
            ]
        )


@records_app.command("list-protocols")
def list_protocols(data: DataOption = None) -> None:
    """List protocols: version, digest, title."""
    with opened(records_settings(data)) as database, database.read() as session:
        rows = protocols.list_protocols(session)
        _table([(row.version, row.digest, row.title) for row in rows])


@records_app.command("list-submissions")
def list_submissions(
    limit: Annotated[int, typer.Option("--limit", min=1)] = 50, data: DataOption = None
) -> None:
    """List submissions, newest first: id, time, phase, status, method."""
    with opened(records_settings(data)) as database, database.read() as session:
        _table(
            [
                (row.id, f"{row.received_at:%Y-%m-%d %H:%M}", row.phase_id, row.status, row.method)
                for row in submissions.list_submissions(session, limit=limit)
            ]
        )


@records_app.command("verify-audit")
def verify(data: DataOption = None) -> None:
    """Recompute the hash chain of the audit lines."""
    with opened(records_settings(data)) as database, database.read() as session:
        verdict = verify_audit(session)
    if not verdict.is_whole:
        raise RecordsError(f"the audit chain breaks at line {verdict.broken_at}")
    typer.echo(f"{verdict.n_lines} lines, whole; head {verdict.head}")


def _token(
    session: Session,
    team_id: int | None,
    name: str,
    days: int | None = None,
    scopes: tuple[str, ...] = tokens.TEAM_SCOPES,
) -> str:
    expires_at = None if days is None else datetime.now(UTC) + timedelta(days=days)
    text, _ = tokens.issue_token(session, team_id, name, scopes, expires_at, actor=ACTOR)
    return text


def _print_token(text: str) -> None:
    say("the token, shown this once (put it into EXCEPTIONDRIVE_TOKEN):")
    typer.echo(text)


def _table(rows: list[tuple[str, ...]]) -> None:
    for row in rows:
        typer.echo("\t".join(row))


def _publicity(file_digest: str | None) -> str:
    return "withheld" if file_digest is None else "published"


def _utc(moment: datetime | None) -> datetime | None:
    return None if moment is None else moment.replace(tzinfo=UTC)
