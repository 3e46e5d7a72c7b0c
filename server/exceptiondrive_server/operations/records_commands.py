"""Operator commands for tokens: create the first organizer, revoke a lost token.

Every other action is an organizer's: `exceptiondrive organizer ...`, over the API.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive_records.accounts import tokens
from exceptiondrive_records.accounts.makers import left_behind
from exceptiondrive_records.accounts.roles import OrganizerRole
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.settings import RecordsSettings, load_settings
from exceptiondrive_records.operations.setup import DATA_HELP, opened
from exceptiondrive_records.teams.teams import switch_self_registration
from exceptiondrive_server.launcher.child import LaunchError
from exceptiondrive_server.web.settings import ServerSettings

# How operator commands reach the records, and how they speak.


ACTOR = "operator"

DataOption = Annotated[Path | None, typer.Option("--data", help=DATA_HELP)]


def say(text: str) -> None:
    """Tell the operator something, on stderr: stdout is for results."""
    typer.echo(text, err=True)


RoleOption = Annotated[
    OrganizerRole, typer.Option("--role", help="What the organizer may do; see docs/organizing.md.")
]
PhasesOption = Annotated[
    list[str] | None,
    typer.Option("--phase", metavar="ID", help="Confine the role to a phase; may be repeated."),
]
records_app = typer.Typer()


@records_app.command("create-organizer")
def create_organizer(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Who the organizer is.")],
    days: Annotated[
        int | None,
        typer.Option(min=1, max=36_500, help="Days until the token expires; default never."),
    ] = None,
    role: RoleOption = OrganizerRole.OWNER,
    phase: PhasesOption = None,
    data: DataOption = None,
) -> None:
    """Issue a token for an organizer, by default one that may do everything, and print it once."""
    with opened(load_settings(RecordsSettings, data)) as database, database.write() as session:
        expires_at = None if days is None else database_now(session) + timedelta(days=days)
        text, _ = tokens.issue_token(
            session,
            None,
            name,
            tokens.SCOPES_OF_ROLE[role],
            expires_at,
            phases=phase or (),
            actor=ACTOR,
        )
    say("the token, shown only once (put it into EXCEPTIONDRIVE_TOKEN):")
    typer.echo(text)


@records_app.command("list-tokens")
def list_tokens(data: DataOption = None) -> None:
    """List all tokens, including those of organizers: id, name, scopes and phases, state."""
    with opened(load_settings(RecordsSettings, data)) as database, database.read() as session:
        now = database_now(session)
        for row in tokens.list_tokens(session):
            over = "revoked" if row.revoked_at else "expired"
            state = "live" if tokens.is_live(row, now) else over
            scopes = ":".join((",".join(row.scopes), *row.phases))
            typer.echo(f"{row.id}\t{row.name}\t{scopes}\t{state}")


@records_app.command("revoke-token")
def revoke_token(
    token_id: Annotated[str, typer.Argument(metavar="ID", help="The eight letters of its id.")],
    data: DataOption = None,
) -> None:
    """Revoke a token for good."""
    with opened(load_settings(RecordsSettings, data)) as database, database.write() as session:
        team_id = tokens.revoke_token(session, token_id, actor=ACTOR).team_id
        left = left_behind(session, f"token:{token_id}", team_id)
    say(f"token {token_id} revoked")
    if left:
        say("tokens made with it keep working; revoke these too, if they are not wanted:")
    for one in left:
        typer.echo(f"{one.id}\t{one.name}")


# The operator command on self-registration.


class Switch(StrEnum):
    """On or off."""

    ON = "on"
    OFF = "off"


@records_app.command("self-registration")
def self_registration_command(
    switch: Annotated[Switch, typer.Argument(help="on or off")], data: DataOption = None
) -> None:
    """Let teams register themselves, or stop that; they can submit once an organizer approves."""
    with opened(load_settings(RecordsSettings, data)) as database, database.write() as session:
        switch_self_registration(session, switch is Switch.ON, actor=ACTOR)
    say(
        f"self-registration is {switch} (EXCEPTIONDRIVE_SELF_REGISTRATION=false would force it off)"
    )


# The operator's commands about keys: the first secrets of a server, the key that signs receipts.


@records_app.command("new-receipt-key")
def new_receipt_key(data: DataOption = None) -> None:
    """Replace the key that signs receipts; restart the server to use it.

    Receipts of the former key stay valid: its public half stays published.
    """
    from exceptiondrive_server.submissions.receipts import write_new_key

    path = load_settings(ServerSettings, data).receipt_key_file
    with _explain_write_errors(path):
        write_new_key(path, replace=True)
    say(f"a new key is in {path}; restart the server to use it")


@records_app.command("init-secrets")
def init_secrets(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Created if it is missing.")],
    host: Annotated[
        str, typer.Option("--host", help="Name of the server, for its first TLS certificate.")
    ] = "localhost",
) -> None:
    """Write every secret that compose.yaml names into DIR, with passwords of its own.

    Run again, it adds what is missing and keeps what is there.
    """
    from exceptiondrive_server.operations.secrets import write_first_secrets

    with _explain_write_errors(folder):
        written = write_first_secrets(folder, host)
    names = [path.name for path in written]
    say(f"written into {folder}: {', '.join(names) or 'nothing, every file is there'}")
    say("keep a copy where backups are kept")
    if "tls.crt" in names:
        say(f"tls.crt is self-signed for {host}: put a real certificate into tls.crt and tls.key")


@records_app.command("init")
def init(
    bare: Annotated[
        Path, typer.Option("--bare", metavar="DIR", help="Holds data, secrets, settings and units.")
    ],
    host: Annotated[str, typer.Option("--host", help="Name of the server, as people type it.")],
    programs: Annotated[
        Path | None,
        typer.Option("--programs", help="Folder of our programs; by default that of this one."),
    ] = None,
) -> None:
    """Write everything that a production server without containers needs into DIR; run as root.

    Run again, it keeps secrets, data and your own settings, and rewrites everything else.
    """
    from exceptiondrive_server.operations.bare_install import BareServer, programs_of_this
    from exceptiondrive_server.operations.secrets import require_pair

    folder = bare.absolute()
    with _explain_write_errors(folder):
        made = BareServer(folder, (programs or programs_of_this()).absolute(), host).write()
    say(f"{folder} holds folders, secrets/, settings in etc/ and units in systemd/")
    if made:
        say(f"new secrets: {', '.join(path.name for path in made)}")
    end = require_pair(folder / "secrets")
    if end < datetime.now(UTC):
        say(
            f"tls.crt ended on {end:%Y-%m-%d}: nobody gets in; put a new one and its key into secrets/ and run this again"
        )
    else:
        say(f"tls.crt ends on {end:%Y-%m-%d}")
    say("next: accounts, database, units and splits, as in docs/operating-bare.md")


@contextmanager
def _explain_write_errors(path: Path) -> Iterator[None]:
    """Say in one sentence what cannot be written."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise LaunchError(
            f"{path} cannot be written: {reason}. A file that is mounted as a secret is replaced "
            "where it comes from: `rotate keys` in docs/operating.md."
        ) from None
