"""Commands for organizers, all over the API with an organizer's token."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exceptiondrive.cli import options, phase_commands, protocol_commands, rescore_commands
from exceptiondrive.cli.output import show, show_json
from exceptiondrive.cli.records_table import show_records
from exceptiondrive.cli.similarity_commands import similar
from exceptiondrive.errors import ExceptionDriveError

if TYPE_CHECKING:
    from exceptiondrive.organizer import Organizer

TeamId = Annotated[str, typer.Argument(metavar="TEAM", help="Id of the team.")]


def list_teams(server: options.Server = None, json: options.Json = False) -> None:
    """List all teams."""
    with _organizer(server) as organizer:
        show_records(
            organizer.teams(), ("id", "name", "is_reference", "created_at", "pending_since"), json
        )


def create_team(
    team_id: Annotated[str, typer.Argument(metavar="ID", help="Small letters, digits, dashes.")],
    name: Annotated[str, typer.Argument(metavar="NAME", help="As the board shows it.")],
    reference: Annotated[
        bool, typer.Option("--reference", help="Its entries are shown and never ranked.")
    ] = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Make a team."""
    with _organizer(server) as organizer:
        team = organizer.create_team(team_id, name, is_reference=reference)
    _show_record(team, f"team {team['id']} made", json)


def approve_team(
    team_id: TeamId, server: options.Server = None, json: options.Json = False
) -> None:
    """Let a team that registered itself submit."""
    with _organizer(server) as organizer:
        team = organizer.approve_team(team_id)
    _show_record(team, f"team {team['id']} approved", json)


def refuse_team(
    team_id: TeamId,
    reason: phase_commands.ReasonOption,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Refuse a team that registered itself: it goes, with its tokens."""
    with _organizer(server) as organizer:
        team = organizer.refuse_team(team_id, reason)
    _show_record(team, f"team {team['id']} refused", json)


def retry_submission(
    submission_id: Annotated[str, typer.Argument(metavar="ID", help="Id of the submission.")],
    reason: phase_commands.ReasonOption,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Queue a failed submission again, with all its attempts."""
    with _organizer(server) as organizer:
        submission = organizer.retry_submission(submission_id, reason)
    _show_record(submission, f"submission {submission['id']} queued again", json)


def list_tokens(team_id: TeamId, server: options.Server = None, json: options.Json = False) -> None:
    """List a team's tokens, without their secrets."""
    columns = ("id", "name", "scopes", "created_at", "expires_at", "revoked_at", "last_used_at")
    with _organizer(server) as organizer:
        show_records(organizer.tokens(team_id), columns, json)


def issue_token(
    team_id: TeamId,
    name: Annotated[str, typer.Option("--name", metavar="NAME", help="What it is for.")],
    expires_at: Annotated[
        str | None, typer.Option("--expires-at", metavar="TIME", help="2027-01-31T00:00:00Z")
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Issue a token for a team; it is shown this once."""
    with _organizer(server) as organizer:
        issued = organizer.issue_token(team_id, name, expires_at)
    _show_record(issued, issued["token"], json)


def revoke_token(
    token_id: Annotated[str, typer.Argument(metavar="TOKEN_ID", help="Id of the token.")],
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Revoke a token for good."""
    with _organizer(server) as organizer:
        token = organizer.revoke_token(token_id)
    _show_record(token, f"token {token['id']} revoked", json)


def list_protocols(server: options.Server = None, json: options.Json = False) -> None:
    """List all protocols, oldest first."""
    with _organizer(server) as organizer:
        show_records(organizer.protocols(), ("version", "title", "digest"), json)


def add_protocol(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Protocol document, TOML.")],
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Add a protocol document; it is immutable from then on."""
    from exceptiondrive.checking import read_file
    from exceptiondrive.cli.protocol_choice import chosen_protocol

    chosen_protocol(str(file))
    toml = read_file(file).decode("utf-8-sig")
    with _organizer(server) as organizer:
        known = {one["digest"] for one in organizer.protocols()}
        added = organizer.add_protocol(toml)
    what = "is there already, nothing was added" if added["digest"] in known else "added"
    _show_record(added, f"protocol {added['version']} {what}, {added['digest']}", json)


def list_splits(server: options.Server = None, json: options.Json = False) -> None:
    """List the registered split revisions: what a phase may use."""
    with _organizer(server) as organizer:
        show_records(organizer.splits(), ("name", "n_samples", "is_public", "revision"), json)


def verify(
    head: Annotated[
        str | None,
        typer.Option(
            "--head", metavar="HASH", help="Kept from an earlier time: finds lines cut off since."
        ),
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Recompute the chain of the audit log; exit code 1 if it is broken or was cut off."""
    with _organizer(server) as organizer:
        verdict = organizer.verify_audit(head)
    is_cut = verdict.get("holds_kept_head") is False
    _show_record(verdict, _verdict_words(verdict, is_cut), json)
    if is_cut or not verdict["is_whole"]:
        raise typer.Exit(ExceptionDriveError.exit_code)


def _verdict_words(verdict: dict[str, Any], is_cut: bool) -> str:
    if not verdict["is_whole"]:
        return (
            f"the audit log is BROKEN at line {verdict['broken_at']}: that line, or the one before "
            "it, was altered, removed or moved; compare with a backup"
        )
    whole = f"{verdict['n_lines']} lines, head {verdict['head']}"
    if is_cut:
        return (
            "the audit log was CUT OFF or written anew: no line has the head that you kept; "
            f"it is a chain of {whole}"
        )
    return f"the audit log is whole: {whole}"


def read_audit(
    limit: Annotated[
        int, typer.Option("--limit", metavar="N", min=1, max=500, help="At most so many.")
    ] = 50,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show the newest lines of the audit log."""
    with _organizer(server) as organizer:
        show_records(organizer.audit(limit), ("id", "at", "actor", "action", "subject"), json)


def _organizer(server: str | None) -> "Organizer":
    from exceptiondrive.cli.session import prepare
    from exceptiondrive.organizer import Organizer

    return Organizer(prepare(server))


def _show_record(record: dict[str, Any], words: str, json: bool) -> None:
    if json:
        show_json(record)
    else:
        show(words)


GROUPS: dict[str, tuple[str, dict[str, Callable[..., None]]]] = {
    "teams": (
        "Teams and their tokens.",
        {
            "list": list_teams,
            "create": create_team,
            "approve": approve_team,
            "refuse": refuse_team,
            "tokens": list_tokens,
            "issue-token": issue_token,
            "revoke-token": revoke_token,
        },
    ),
    "phases": (
        "Phases; everyone lists them with `exceptiondrive phases`.",
        phase_commands.COMMANDS,
    ),
    "protocols": (
        "Protocol documents.",
        {"list": list_protocols, "add": add_protocol, **protocol_commands.COMMANDS},
    ),
    "rescore": (
        "Protocol updates: score in the background, compare, apply.",
        rescore_commands.COMMANDS,
    ),
    "submissions": ("Submissions of all teams.", {"retry": retry_submission}),
    "splits": ("Registered splits.", {"list": list_splits}),
    "audit": ("The append-only, hash-chained log.", {"list": read_audit, "verify": verify}),
}


def register(app: typer.Typer) -> None:
    """Add these commands."""
    organizer = typer.Typer(
        help="For organizers, with an organizer's token.",
        no_args_is_help=True,
        rich_markup_mode=None,
    )
    for name, (help_text, commands) in GROUPS.items():
        group = typer.Typer(help=help_text, no_args_is_help=True, rich_markup_mode=None)
        for command_name, command in commands.items():
            group.command(command_name)(command)
        organizer.add_typer(group, name=name)
    organizer.command("similar")(similar)
    app.add_typer(organizer, name="organizer")
