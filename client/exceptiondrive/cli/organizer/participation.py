"""Commands for teams in a season: disqualification, allowances, names, messages, imports."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from exceptiondrive.cli import completion, options
from exceptiondrive.cli.options import argument, flag, option
from exceptiondrive.cli.organizer.phases import setting_value
from exceptiondrive.cli.output import Answer, be_sure, say
from exceptiondrive.cli.session import with_organizer
from exceptiondrive.cli.tables import records_table
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.organizer import Organizer
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_schemas.api.participation import AFTER_A_MERGE
from exceptiondrive_schemas.printable import counted

ToldReason = Annotated[
    str, option("--reason", "TEXT", "Why; shown to the team and in the audit log.")
]
PublicNote = Annotated[
    str | None, option("--public-note", "TEXT", "Shown to readers; without it they see nothing.")
]
LIMITS = (
    FormField("closes_at", "Own deadline", "moment", may_be_none=True),
    FormField("quota_per_day", "Submissions per day", "whole", may_be_none=True),
    FormField("quota_total", "Submissions in total", "whole", may_be_none=True),
)


@with_organizer
def show_team(organizer: Organizer, team_id: options.TeamId) -> Answer:
    """Show name, standing, people, addresses, allowances, disqualifications and accepted terms of a team."""
    found = organizer.participation(team_id)
    tables = {
        "members": ("name", "email", "joined_at"),
        "addresses": ("address", "channel", "is_confirmed", "last_message"),
        "allowances": (
            *("phase", "closes_at", "is_ended_by_reveal"),
            *("quota_per_day", "quota_total", "reason"),
        ),
        "disqualifications": ("id", "phase", "submission", "reason", "reinstated_at"),
        "terms": ("phase", "version", "accepted_at"),
    }
    name = f"{found['name']}, {found['affiliation']}" if found["affiliation"] else found["name"]
    lines: list[Any] = [name, *([found["standing"]] if found["standing"] else [])]
    for name, columns in tables.items():
        rows = found[name]
        lines += [f"{name}:", records_table(rows, columns)] if rows else [f"{name}: none"]
    return found, *lines


@with_organizer
def change_team(
    organizer: Organizer,
    team_id: options.TeamId,
    reason: options.Reason,
    name: Annotated[str | None, option("--name", "NAME", "As new boards show it.")] = None,
    affiliation: Annotated[str | None, option("--affiliation", "TEXT", "For organizers.")] = None,
) -> Answer:
    """Change name or affiliation of a team; earlier boards stay as they are."""
    given = {"name": name, "affiliation": affiliation}
    changes = {key: value for key, value in given.items() if value is not None}
    if not changes:
        raise InvalidArgumentError("nothing_to_set", "Give --name or --affiliation.")
    team = organizer.change_team(team_id, reason, **changes)
    return team, f"team {team['id']} is called {team['name']}"


@with_organizer
def merge_teams(
    organizer: Organizer,
    team_id: options.TeamId,
    into: Annotated[
        str, option("--into", "TEAM", "The team that remains.", offer=completion.teams)
    ],
    reason: options.Reason,
    yes: options.Yes = False,
) -> Answer:
    """Merge a team into another one, with submissions, people and addresses; needs --yes without a terminal."""
    be_sure(
        f"Merge {team_id} into {into} for good? Its tokens are revoked, and its allowances are not passed "
        f"on. {AFTER_A_MERGE}",
        yes,
    )
    merged = organizer.merge_teams(team_id, into, reason)
    n_moved = merged["n_submissions"]
    moved = counted(n_moved, "submission") if n_moved else "no submissions"
    return merged, f"team {team_id} is now part of {merged['id']}, and brought {moved}"


@with_organizer
def forget_team(
    organizer: Organizer, team_id: options.TeamId, reason: options.Reason, yes: options.Yes = False
) -> Answer:
    """Remove everything personal about a team from the records; needs --yes without a terminal."""
    be_sure(f"Forget {team_id} for good? Boards will show an alias.", yes)
    team = organizer.forget_team(team_id, reason)
    return team, f"the team is forgotten; boards show it as {team['name']} ({team['id']})"


@with_organizer
def import_teams(
    organizer: Organizer,
    file: Annotated[Path, argument("FILE", "CSV: id, name, affiliation, email; - is stdin.")],
) -> Answer:
    """Create many teams, each with a token that is shown only once; all of them, or none."""
    text = options.given_file(file).text()
    made = organizer.import_teams(text)
    teams = made["teams"]
    say(f"{counted(len(teams), 'team')} created, with tokens that are shown only once:")
    return made, *(f"{team['id']},{team['token']}" for team in teams)


@with_organizer
def set_allowance(
    organizer: Organizer,
    team_id: options.TeamId,
    phase: options.PhaseId,
    reason: ToldReason,
    closes_at: Annotated[
        str | None, option("--closes-at", "TIME|none", "2027-01-31T00:00:00Z")
    ] = None,
    quota_per_day: Annotated[
        str | None, option("--quota-per-day", "N|none", "Submissions per day.")
    ] = None,
    quota_total: Annotated[
        str | None, option("--quota-total", "N|none", "Submissions in total.")
    ] = None,
) -> Answer:
    """Set a team's own deadline and quota in a phase; `none` restores what all teams have."""
    given = {"closes_at": closes_at, "quota_per_day": quota_per_day, "quota_total": quota_total}
    allowance = {
        field.name: setting_value(field, value)
        for field in LIMITS
        if (value := given[field.name]) is not None
    }
    if not allowance:
        raise InvalidArgumentError(
            "nothing_to_set", "Give --closes-at, --quota-per-day or --quota-total."
        )
    row = organizer.set_allowance(team_id, phase, reason, allowance)
    words = (f"{one.name} {row[one.name] or 'as for all teams'}" for one in LIMITS)
    return row, f"team {team_id} in {phase}: {', '.join(words)}"


@with_organizer
def disqualify_team(
    organizer: Organizer,
    team_id: options.TeamId,
    reason: ToldReason,
    public_note: PublicNote = None,
    phase: Annotated[str | None, options.phase("Only in this phase; else everywhere.")] = None,
) -> Answer:
    """Take a team off the next boards; it cannot submit until it is reinstated."""
    row = organizer.disqualify_team(team_id, reason, public_note, phase)
    return row, f"team {team_id} disqualified, number {row['id']}"


@with_organizer
def disqualify_submission(
    organizer: Organizer,
    submission_id: options.SubmissionId,
    reason: ToldReason,
    public_note: PublicNote = None,
) -> Answer:
    """Take one submission off the next boards; the same bytes are not accepted again."""
    row = organizer.disqualify_submission(submission_id, reason, public_note)
    return row, f"submission {submission_id} disqualified, number {row['id']}"


@with_organizer
def list_disqualified(organizer: Organizer) -> Answer:
    """List disqualifications, newest first, including those that ended."""
    columns = ("id", "team", "phase", "submission", "reason", "disqualified_at", "reinstated_at")
    found = organizer.disqualifications()
    return found, records_table(found, columns) if found else "nobody was disqualified"


@with_organizer
def reinstate(
    organizer: Organizer,
    number: Annotated[int, argument("NUMBER", "From `teams disqualified`.", min=1)],
    reason: ToldReason,
) -> Answer:
    """End a disqualification: the entries return to the next board, unless another one keeps them off."""
    row = organizer.reinstate(number, reason)
    return row, f"{row['submission'] or row['team']} reinstated"


@with_organizer
def send_message(
    organizer: Organizer,
    title: Annotated[str, argument("TITLE", "Subject of mails.")],
    text: Annotated[
        Path,
        option(
            "--text",
            "FILE",
            "Plain text, no Markdown; a blank line separates paragraphs; - is stdin.",
        ),
    ],
    to: Annotated[
        list[str] | None,
        option("--to", "TEAM", "May be repeated; else every team.", offer=completion.teams),
    ] = None,
    phase: Annotated[
        str | None, options.phase("Without --to: only teams that submitted to this phase.")
    ] = None,
    preview: Annotated[bool, flag("--preview", "Show who would get it, and send nothing.")] = False,
    yes: options.Yes = False,
) -> Answer:
    """Write to one, some or all teams: inbox, e-mail and webhooks; needs --yes without a terminal."""
    words = options.given_file(text).text()
    if not (preview or yes):
        found = organizer.send_message(title, words, to or (), phase, is_preview=True)
        n_teams = counted(len(found["recipients"]), "team")
        be_sure(f"Send this to {n_teams}? It cannot be recalled.", yes, nothing="Nothing was sent.")
    sent = organizer.send_message(title, words, to or (), phase, is_preview=preview)
    columns = ("team", "name", "n_emails", "n_webhooks")
    what = "sent to" if sent["is_sent"] else "would reach"
    line = f"{what} {counted(len(sent['recipients']), 'team')}"
    message = (f"  {words}" for words in (sent["title"], *sent["paragraphs"]))
    return sent, records_table(sent["recipients"], columns), line, "as they read it:", *message


TEAM_COMMANDS: dict[str, Callable[..., None]] = {
    "show": show_team,
    "change": change_team,
    "merge": merge_teams,
    "forget": forget_team,
    "import": import_teams,
    "limits": set_allowance,
    "disqualify": disqualify_team,
    "disqualified": list_disqualified,
    "reinstate": reinstate,
}
