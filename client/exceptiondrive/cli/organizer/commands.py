"""Commands for organizers, all over the API with an organizer's token."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from exceptiondrive.checking import write_file
from exceptiondrive.cli import completion, news_commands, options
from exceptiondrive.cli.account_commands import TOKEN_COLUMNS, left_words, revoked
from exceptiondrive.cli.options import argument, flag, one_of, option
from exceptiondrive.cli.organizer import participation, phases, rescoring
from exceptiondrive.cli.output import (
    Answer,
    be_sure,
    cut_words,
    replacing,
    save_new,
    say,
    show_result,
    upload_name,
)
from exceptiondrive.cli.session import open_organizer, with_organizer
from exceptiondrive.cli.tables import listed, records_table
from exceptiondrive.confirmations import confirm, default_key_path, make_key
from exceptiondrive.errors import ExceptionDriveError, InvalidArgumentError, utc_text
from exceptiondrive.inputs import given_bytes, given_protocol, require_unread
from exceptiondrive.organizer import Organizer
from exceptiondrive_schemas.api.similarity import SubmissionOfTeam
from exceptiondrive_schemas.api.site import SiteLinks
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.protocol import ProtocolDocument, ProtocolError
from exceptiondrive_schemas.protocols.sense import nonsense
from exceptiondrive_schemas.split import SplitRef

ROLES = ("owner", "helper", "read-only")
_LEFT = "tokens that they made keep working"
FileArgument = Annotated[Path, argument("FILE", "Protocol document, TOML.")]


def _meant_protocol(file: Path) -> ProtocolDocument:
    """Return a document that a server takes: without what nobody can mean."""
    protocol = given_protocol(str(file))
    meaningless = nonsense(protocol)
    if meaningless:
        raise InvalidArgumentError("wrong_protocol", f"{file}: {ProtocolError(meaningless)}")
    return protocol


def check_protocol(file: FileArgument, json: options.Json = False) -> None:
    """Check a protocol document on this machine; every problem is listed."""
    protocol = _meant_protocol(file)
    facts = {"version": protocol.version, "digest": protocol.digest}
    show_result(facts, json, f"protocol {protocol.version} is valid, {protocol.digest}")


@with_organizer
def diff_protocol(
    organizer: Organizer,
    file: FileArgument,
    phase: Annotated[
        str | None, options.phase("Compare with the protocol that this phase shows.", "ID")
    ] = None,
) -> Answer:
    """Say in plain words what a document would change, and what would have to be redone."""
    _meant_protocol(file)
    toml = given_bytes(file).text()
    found = organizer.rescoring.check_protocol(toml, phase)
    changes = [f"- {change['sentence']} ({change['stage']})" for change in found["changes"]]
    lines = [*(changes or ["nothing that affects a score is changed"]), found["sentence"]]
    lines += [f"note: {found['remark']}"] if found.get("remark") else []
    return found, *lines


@with_organizer
def similar(organizer: Organizer, phase: options.PhaseId) -> Answer:
    """Show teams with equal or near-equal submissions, and teams that may be probing.

    These are reasons to ask a team, not proof: two planners that both stand still are alike too.
    """
    report = organizer.similar(phase)
    rows = [
        {
            "alike": pair.kind.replace("_", " "),
            "first": _submission_label(pair.first),
            "second": _submission_label(pair.second),
            "samples alike": f"{100 * pair.equal_share:.2f} %",
            "mean distance": f"{pair.mean_distance or 0:.2f}",
            "samples that differ": pair.n_different,
        }
        for pair in report.pairs
    ]
    probing = (
        f"{', '.join(found.teams)}: {found.n_submissions} submissions that share most samples "
        f"with an earlier one and change {found.fewest_changed} to {found.most_changed}, "
        f"{utc_text(found.first_at)} to {utc_text(found.last_at)}"
        for found in report.probing
    )
    pairs = (
        records_table(rows, tuple(rows[0])) if rows else "no submissions of two teams are similar"
    )
    compared = f"{report.n_compared} submissions compared"
    return report, pairs, *probing, f"{compared}, {report.n_waiting} more after the next board"


def _submission_label(submission: SubmissionOfTeam) -> str:
    return f"{submission.team}: {submission.method} ({submission.id})"


@with_organizer
def list_teams(organizer: Organizer) -> Answer:
    """List all teams."""
    columns = ("id", "name", "standing", "affiliation", "is_reference", "created_at")
    return listed(organizer.teams(), columns)


@with_organizer
def create_team(
    organizer: Organizer,
    team_id: Annotated[str, argument("ID", "Lower-case letters, digits, hyphens.")],
    name: Annotated[str, argument("NAME", "As the board shows it.")],
    affiliation: Annotated[str, option("--affiliation", "TEXT", "For organizers.")] = "",
    email: Annotated[
        str, option("--email", "ADDRESS", "For its notices, once its owner confirms it.")
    ] = "",
    reference: Annotated[
        bool, flag("--reference", "Its entries are shown but never ranked.")
    ] = False,
    with_token: Annotated[
        bool, flag("--with-token", "Issue its first token too; shown only once.")
    ] = False,
) -> Answer:
    """Create a team."""
    team = organizer.create_team(
        team_id, name, affiliation=affiliation, email=email, is_reference=reference
    )
    if with_token:
        team["token"] = organizer.issue_token(team_id, "first token")["token"]
        say(f"team {team['id']} created; its token, shown only once:")
    return team, team.get("token") or f"team {team['id']} created"


@with_organizer
def approve_team(organizer: Organizer, team_id: options.TeamId) -> Answer:
    """Approve a team that registered itself, so that it can submit."""
    team = organizer.approve_team(team_id)
    return team, f"team {team['id']} approved"


@with_organizer
def refuse_team(organizer: Organizer, team_id: options.TeamId, reason: options.Reason) -> Answer:
    """Refuse a team that registered itself: it is removed, with its tokens."""
    team = organizer.refuse_team(team_id, reason)
    return team, f"team {team['id']} refused"


@with_organizer
def retry_submission(
    organizer: Organizer, submission_id: options.SubmissionId, reason: options.Reason
) -> Answer:
    """Queue a failed submission again, with all its attempts."""
    submission = organizer.retry_submission(submission_id, reason)
    return submission, f"submission {submission['id']} queued again"


@with_organizer
def show_story(organizer: Organizer, submission_id: options.SubmissionId) -> Answer:
    """Show a submission and its whole history.

    Scores of all submissions are listed by `exceptiondrive submissions` with an organizer's token.
    """
    story = organizer.story(submission_id)
    one = story["submission"]
    recomputed = (
        f"recomputed {utc_text(item['asked_at'])}: {item['state']}" for item in story["recomputed"]
    )
    told = (f"told {utc_text(item['created_at'])}: {item['title']}" for item in story["notices"])
    head = (
        f"{one['id']}  {one['method']} of {one['team']}, {one['phase']}, {one['status']}, "
        f"rank {one['rank'] or '-'}"
    )
    audit = records_table(story["audit"], ("id", "at", "actor", "action"))
    return story, head, *recomputed, *told, audit


def verify_submission(
    submission_id: options.SubmissionId,
    reason: options.Reason,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Recompute its score from the upload and compare every bit; exit code 1 if it differs."""
    with open_organizer(server) as organizer:
        found = organizer.verify_submission(submission_id, reason)
        rescoring.follow_verification(organizer.rescoring, found, json)


@with_organizer
def restore_submission(
    organizer: Organizer, submission_id: options.SubmissionId, reason: options.Reason
) -> Answer:
    """Restore a withdrawn submission, at its original time."""
    submission = organizer.restore_submission(submission_id, reason)
    return submission, f"submission {submission['id']} is {submission['status']}"


@with_organizer
def write_about(
    organizer: Organizer,
    submission_id: options.SubmissionId,
    words: Annotated[
        str, options.text("--words", "The message; the team's addresses are not shown.")
    ],
) -> Answer:
    """Send its team a message about it: to its inbox and every confirmed address."""
    notice = organizer.write_about(submission_id, words)
    return notice, f"sent to {notice['team']}: notice {notice['id']}"


@with_organizer
def download_upload(
    organizer: Organizer, submission_id: options.SubmissionId, output: options.Output = None
) -> Answer:
    """Download the bytes that a team sent; the audit log records who did."""
    data = organizer.download_upload(submission_id)
    return save_new(output or Path(upload_name(organizer.id_of(submission_id), data)), data)


@with_organizer
def download_story(
    organizer: Organizer, submission_id: options.SubmissionId, output: options.Output = None
) -> Answer:
    """Download the whole case for a committee, as a tar: upload, receipt, records and a README."""
    data = organizer.download_story(submission_id)
    return save_new(output or Path(f"submission-{organizer.id_of(submission_id)}.tar"), data)


@with_organizer
def download_archive(
    organizer: Organizer,
    team: Annotated[
        str | None, option("--team", "TEAM", "Only of this team.", offer=completion.teams)
    ] = None,
    phase: options.Phase = None,
    status: Annotated[
        str | None, one_of("--status", SubmissionStatus, "Only in this status.", "STATUS")
    ] = None,
    output: options.Output = None,
) -> Answer:
    """Download the matching uploads as a tar; its last member, manifest.json, describes each."""
    data = organizer.download_archive(team, phase, status)
    return save_new(output or Path("submissions.tar"), data)


@with_organizer
def list_tokens(organizer: Organizer, team_id: options.TeamId) -> Answer:
    """List a team's tokens, without their secrets."""
    return listed(organizer.tokens(team_id), TOKEN_COLUMNS)


@with_organizer
def issue_token(
    organizer: Organizer,
    team_id: options.TeamId,
    name: Annotated[str, option("--name", "NAME", "What it is for.")],
    expires_at: options.ExpiresAt = None,
) -> Answer:
    """Issue a token for a team; it is shown only once."""
    issued = organizer.issue_token(team_id, name, expires_at)
    return issued, issued["token"]


@with_organizer
def revoke_token(
    organizer: Organizer, token_id: Annotated[str, argument("TOKEN_ID", "Id of the token.")]
) -> Answer:
    """Revoke a token for good."""
    return revoked(organizer.revoke_token(token_id))


@with_organizer
def list_protocols(organizer: Organizer) -> Answer:
    """List all protocols, including drafts, oldest first."""
    found = organizer.protocols()
    rows = [one | {"readers": "no, a draft" if one["is_draft"] else "yes"} for one in found]
    return found, records_table(rows, ("version", "title", "readers", "digest"))


@with_organizer
def add_protocol(organizer: Organizer, file: FileArgument) -> Answer:
    """Add a protocol document; it is immutable from then on."""
    given_protocol(str(file))
    toml = given_bytes(file).text()
    known = {one["digest"] for one in organizer.protocols()}
    added = organizer.add_protocol(toml)
    what = "is already there; nothing was added" if added["digest"] in known else "added"
    return added, f"protocol {added['version']} {what}, {added['digest']}"


KeyOption = Annotated[
    Path | None, option("--key", "FILE", "Your private key; it stays on this machine.")
]


def protocol_key(key: KeyOption = None, json: options.Json = False) -> None:
    """Show your public key, for `floors.toml` of a split; a key is created if you have none."""
    path = key or default_key_path()
    public_key = make_key(path)
    say(f"the private key is in {path}: keep it off every server")
    show_result({"public_key": public_key, "key": str(path)}, json, public_key)


def confirm_protocol(
    file: FileArgument,
    split: Annotated[str, option("--split", "NAME", "Name of the split.")],
    revision: Annotated[str, option("--revision", "REVISION", "As `register-splits` printed it.")],
    key: KeyOption = None,
    to_file: Annotated[Path | None, options.output("Write it here; send nothing.")] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Sign that a withheld split may be scored under a protocol, and send the signature.

    What is signed is the document on this machine: read it first.
    """
    protocol = given_protocol(str(file))
    key = key or default_key_path()
    if to_file is not None:
        require_unread(to_file, file, key)
    signed = confirm(SplitRef(name=split, revision=revision), protocol.digest, key)
    words = f"protocol {protocol.version} ({protocol.digest}) on {split} at {revision}"
    if to_file is not None:
        with replacing(to_file):
            write_file(to_file, signed.model_dump_json(by_alias=True) + "\n")
        show_result(signed, json, f"signed: {words}")
        return
    with open_organizer(server) as organizer:
        kept = organizer.confirm(signed.model_dump(mode="json", by_alias=True))
    show_result(kept, json, f"confirmed: {words}")


@with_organizer
def list_confirmations(organizer: Organizer) -> Answer:
    """List what organizers signed: which split may be scored under which protocol."""
    found = organizer.confirmations()
    rows = [
        {"id": one["id"], "protocol": said["protocol"], "key": said["public_key"], **said["split"]}
        for one in found
        for said in [one["confirmation"]]
    ]
    columns = ("id", "name", "revision", "protocol", "key")
    return found, records_table(rows, columns)


@with_organizer
def withdraw_confirmation(
    organizer: Organizer,
    confirmation_id: Annotated[str, argument("ID", "`confirmations` shows it.")],
    reason: options.Reason,
) -> Answer:
    """Withdraw a confirmation: workers score and publish nothing more that needs it."""
    left = organizer.withdraw_confirmation(confirmation_id, reason)
    return left, f"confirmation {confirmation_id} withdrawn"


@with_organizer
def delete_protocol(
    organizer: Organizer,
    version: Annotated[str, argument("VERSION", "Version or digest.")],
    reason: options.Reason,
) -> Answer:
    """Delete a protocol that nothing uses: no phase, run, board or sheet."""
    gone = organizer.delete_protocol(version, reason)
    return gone, f"protocol {gone['version']} deleted"


@with_organizer
def list_splits(organizer: Organizer) -> Answer:
    """List the registered split revisions: what a phase may use."""
    found = organizer.splits()
    rows = [one | {"warnings": _warning_counts(one.get("warnings", ()))} for one in found]
    columns = (
        "name", "revision", "part", "n_samples", "is_public", "registered_at", "words", "warnings"
    )  # fmt: skip
    return found, records_table(rows, columns)


def _warning_counts(warnings: Iterable[Mapping[str, Any]]) -> str:
    return ", ".join(f"{found['code']} {found['count']}" for found in warnings)


def verify_audit(
    head: Annotated[
        str | None,
        option("--head", "HASH", "Hash noted earlier: finds lines cut off since then."),
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Recompute the chain of the audit log; exit code 1 if it is broken or was cut off."""
    with open_organizer(server) as organizer:
        verdict = organizer.verify_audit(head)
    is_cut = verdict.get("holds_kept_head") is False
    show_result(verdict, json, _verdict_words(verdict, is_cut))
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
            "the audit log was CUT OFF or rewritten: no line has the head that you kept; "
            f"it is a chain of {whole}"
        )
    return f"the audit log is intact: {whole}"


@with_organizer
def read_audit(
    organizer: Organizer,
    limit: Annotated[int, option("--limit", "N", "Show at most N.", min=1, max=500)] = 50,
    actor: Annotated[str | None, option("--actor", "WHO", "Only actions by this actor.")] = None,
    subject: Annotated[str | None, option("--subject", "ID", "Only about this.")] = None,
    since: Annotated[
        str | None, option("--since", "TIME", "2027-01-31T00:00:00Z, or a day: from then on.")
    ] = None,
    action: Annotated[
        str | None, option("--action", "KIND", "Only of this kind, as 'phase changed'.")
    ] = None,
    before: Annotated[
        int | None, option("--before", "LINE", "Only older than the line of this id.", min=1)
    ] = None,
) -> Answer:
    """Show the newest lines of the audit log."""
    found = organizer.audit(
        limit,
        before=before,
        actor=actor,
        subject=subject,
        since=since,
        action=action,
    )
    lines = []
    for line in found:
        detail = line["detail"]  # why it was done, or what workers refused
        lines.append({**line, "reason": detail.get("reason") or detail.get("asked") or ""})
    columns = ("id", "at", "actor", "action", "subject", "reason")
    older = f"--before {found[-1]['id']} shows older ones" if found else ""
    return found, records_table(lines, columns), *cut_words(found, limit, older)


@with_organizer
def list_people(organizer: Organizer) -> Answer:
    """List everyone who signed in through the provider, with their roles."""
    return listed(organizer.people(), ("id", "name", "role", "phases", "signed_in_at"))


@with_organizer
def set_role(
    organizer: Organizer,
    person: Annotated[str, argument("PERSON", "Id of the person.")],
    role: Annotated[
        str | None,
        one_of("--role", ROLES, "owner, helper or read-only; without it, no role.", "ROLE"),
    ] = None,
    phase_ids: Annotated[
        list[str] | None, options.phase("Limits the role to this phase; may be repeated.", "ID")
    ] = None,
) -> Answer:
    """Give a person an organizer's role, or take it away; it applies from their next request on."""
    told = organizer.set_role(person, role, phase_ids or ())
    left = [] if told["role"] else left_words(_LEFT, told)
    return told, f"{told['name']}: {told['role'] or 'not an organizer'}", *left


@with_organizer
def forget_person(
    organizer: Organizer,
    person: Annotated[str, argument("PERSON", "Id of the person.")],
    reason: options.Reason,
    yes: options.Yes = False,
) -> Answer:
    """Remove a person from their teams and from the records; needs --yes without a terminal."""
    be_sure(f"Forget {person} for good? Whoever signs in again is somebody new.", yes)
    told = organizer.forget_person(person, reason)
    return told, f"person {person} is forgotten", *left_words(_LEFT, told)


@with_organizer
def show_site(organizer: Organizer) -> Answer:
    """Show the links of the site."""
    return _link_lines(organizer.site())


@with_organizer
def set_site(organizer: Organizer, **links: Any) -> Answer:
    """Set links of the site; links that you leave out stay, and empty ones are not shown."""
    changes = phases.setting_document(SiteLinks, links)
    if not changes:
        raise InvalidArgumentError("nothing_to_set", "Say what to set: `--help` lists the links.")
    return _link_lines(organizer.set_site(changes))


def _link_lines(links: dict[str, Any]) -> Answer:
    return links, *(f"{name:<9}  {text or '-'}" for name, text in links.items())


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
            **participation.TEAM_COMMANDS,
        },
    ),
    "phases": ("Phases; everyone lists them with `exceptiondrive phases`.", phases.COMMANDS),
    "protocols": (
        "Protocol documents.",
        {
            "list": list_protocols,
            "add": add_protocol,
            "delete": delete_protocol,
            "check": check_protocol,
            "diff": diff_protocol,
            "key": protocol_key,
            "confirm": confirm_protocol,
            "confirmations": list_confirmations,
            "withdraw-confirmation": withdraw_confirmation,
        },
    ),
    "rescore": ("Protocol updates: score in the background, compare, apply.", rescoring.COMMANDS),
    "submissions": (
        "Submissions of all teams; `exceptiondrive submissions` lists them with their scores.",
        {
            "show": show_story,
            "retry": retry_submission,
            "verify": verify_submission,
            "restore": restore_submission,
            "note": write_about,
            "download": download_upload,
            "folder": download_story,
            "archive": download_archive,
            "disqualify": participation.disqualify_submission,
        },
    ),
    "news": ("News of phases: page, feed and inboxes.", news_commands.NEWS),
    "people": (
        "People and their organizer roles.",
        {"list": list_people, "set": set_role, "forget": forget_person},
    ),
    "questions": ("Questions of teams, and answers.", news_commands.QUESTIONS),
    "site": (
        "Links in the header and footer of every page.",
        {"show": show_site, "set": phases.with_settings(set_site, SiteLinks)},
    ),
    "splits": ("Registered splits.", {"list": list_splits}),
    "audit": ("The append-only, hash-chained log.", {"list": read_audit, "verify": verify_audit}),
}

organizer = {"similar": similar, "message": participation.send_message, **GROUPS}
