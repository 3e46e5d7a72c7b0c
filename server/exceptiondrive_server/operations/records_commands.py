"""Operator commands on the records: teams, tokens, phases, protocols, submissions, audit."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy import make_url
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts import tokens
from exceptiondrive_records.accounts.people import list_people, set_organizer
from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.db.database import Database, sentence_of
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_records.db.settings import PREFIX, RecordsSettings, SettingsError, load_settings
from exceptiondrive_records.migrations import is_usable
from exceptiondrive_records.phases import phases
from exceptiondrive_records.protocols import protocols
from exceptiondrive_records.splits import splits
from exceptiondrive_records.submissions import submissions
from exceptiondrive_records.submissions.retry import retry_submission
from exceptiondrive_records.teams import teams
from exceptiondrive_records.teams.teams import switch_self_registration
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.phase_settings import NewPhase
from exceptiondrive_server.launcher.errors import LaunchError
from exceptiondrive_server.launcher.layout import Layout
from exceptiondrive_server.web.settings import ServerSettings

# How operator commands reach the records, and how they speak.


ACTOR = "operator"

DataOption = Annotated[
    Path | None,
    typer.Option(
        "--data",
        help="Folder of `exceptiondrive-server run`; needed unless it is ./data or "
        "EXCEPTIONDRIVE_DATABASE_URL is set.",
    ),
]


def say(text: str) -> None:
    """Tell the operator something, on stderr: stdout is for results."""
    typer.echo(text, err=True)


def records_settings(data: Path | None) -> RecordsSettings:
    """Return the settings; with `data`, those of the embedded default in that folder."""
    if data is None:
        return load_settings(RecordsSettings)
    chosen = Layout(data).environment(os.environ)
    return load_settings(
        RecordsSettings,
        **{name.removeprefix(PREFIX).lower(): value for name, value in chosen.items()},
    )


@contextmanager
def opened(settings: RecordsSettings) -> Iterator[Database]:
    """Open records that exist and have the newest schema.

    Raises:
        SettingsError: They do not; the text says what to do.
    """
    url = make_url(settings.database_url)
    if url.get_backend_name() == "sqlite" and not Path(url.database or "").is_file():
        raise SettingsError(
            f"there are no records at {url.database}. Name the folder of the running server with "
            "--data, set EXCEPTIONDRIVE_DATABASE_URL, or make them: exceptiondrive-server migrate"
        )
    database = Database(settings.database_url)
    try:
        if not is_usable(database):
            raise SettingsError("the records are not up to date: run exceptiondrive-server migrate")
        yield database
    except DBAPIError as error:
        raise SettingsError(sentence_of(error)) from None
    finally:
        database.dispose()


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


# Operator commands on people and self-registration.


people_app = typer.Typer()


class Switch(StrEnum):
    """On or off."""

    ON = "on"
    OFF = "off"


@people_app.command("list-people")
def list_people_command(data: DataOption = None) -> None:
    """List who signed in through the provider: id, name, email, whether an organizer."""
    with opened(records_settings(data)) as database, database.read() as session:
        for person in list_people(session):
            role = "organizer" if person.is_organizer else ""
            typer.echo("\t".join((person.id, person.name, person.email or "", role)))


@people_app.command("set-organizer")
def set_organizer_command(
    person: Annotated[str, typer.Argument(metavar="PERSON", help="Id; list-people shows it.")],
    switch: Annotated[Switch, typer.Argument(help="on or off")] = Switch.ON,
    data: DataOption = None,
) -> None:
    """Make a person an organizer, or no longer."""
    with opened(records_settings(data)) as database, database.write() as session:
        row = set_organizer(session, person, switch is Switch.ON, actor=ACTOR)
        name = row.name
    say(f"{name} is {'an organizer' if switch is Switch.ON else 'no organizer'} now")


@people_app.command("self-registration")
def self_registration_command(
    switch: Annotated[Switch, typer.Argument(help="on or off")], data: DataOption = None
) -> None:
    """Let teams register themselves, or no longer; they submit when an organizer approves."""
    with opened(records_settings(data)) as database, database.write() as session:
        switch_self_registration(session, switch is Switch.ON, actor=ACTOR)
    say(
        f"self-registration is {switch} (EXCEPTIONDRIVE_SELF_REGISTRATION=false would force it off)"
    )


# The operator's commands about keys: the first secrets of a server, the key that signs receipts.


receipts_app = typer.Typer()


@receipts_app.command("new-receipt-key")
def new_receipt_key(data: DataOption = None) -> None:
    """Replace the key that signs receipts; restart the server to use it.

    Receipts of the former key stay valid: its public half stays published.
    """
    from exceptiondrive_server.submissions.receipts import write_new_key

    chosen = {} if data is None else Layout(data).environment(os.environ)
    given = {name.removeprefix(PREFIX).lower(): value for name, value in chosen.items()}
    path = load_settings(ServerSettings, **given).receipt_key_file
    with _writing(path):
        write_new_key(path, replace=True)
    say(f"a new key is in {path}; restart the server to use it")


@receipts_app.command("init-secrets")
def init_secrets(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Made where it is not there.")],
    host: Annotated[
        str, typer.Option("--host", help="Name of the server, for its first TLS certificate.")
    ] = "localhost",
) -> None:
    """Write every secret that compose.yaml names into DIR, with passwords of its own."""
    from exceptiondrive_server.operations.secrets import write_first_secrets

    with _writing(folder):
        written = write_first_secrets(folder, host)
    say(f"{len(written)} files are in {folder}; keep a copy where backups are kept")
    say(f"tls.crt signs itself for {host}: put a real certificate into tls.crt and tls.key")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Say in one sentence what cannot be written."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise LaunchError(
            f"{path} cannot be written: {reason}. A file that is mounted as a secret is replaced "
            "where it comes from: `rotate keys` in docs/operating.md."
        ) from None
