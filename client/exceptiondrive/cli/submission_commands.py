"""Commands about the team's submissions: submit, status, submissions, quota, withdraw."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.completion import choices, submission_ids
from exceptiondrive.cli.file_tables import file_view
from exceptiondrive.cli.output import (
    be_sure,
    can_ask,
    say,
    say_view,
    show,
    show_document,
    show_json,
    show_result,
    show_saved,
    upload_name,
)
from exceptiondrive.cli.progress import TransferBar, WaitLine
from exceptiondrive.cli.session import open_client
from exceptiondrive.cli.tables import (
    edits_table,
    outlook_view,
    quota_table,
    submission_view,
    submissions_left,
    submissions_view,
)
from exceptiondrive.errors import IT_IS_SAFE, ExceptionDriveError, InvalidArgumentError
from exceptiondrive.facts import facts_of_pairs
from exceptiondrive.outlook import Outlook
from exceptiondrive.settings import default_phase
from exceptiondrive_schemas.api.own_entries import entry_words
from exceptiondrive_schemas.api.phase_settings import RunRule
from exceptiondrive_schemas.api.submission import SubmissionStatus

if TYPE_CHECKING:
    from exceptiondrive.client import Submission

INTERRUPTED = 130
"""The exit code of what Ctrl-C ended, as shells have it."""
UNANSWERED = (
    "Interrupted before the server has answered: `exceptiondrive submissions` lists the file if it "
    "arrived. Sent again, the same bytes count once."
)


def submit(
    context: typer.Context,
    file: options.File,
    method: Annotated[
        str,
        typer.Option("--method", metavar="NAME", help="Name of the method, as the board has it."),
    ],
    phase: options.DefaultPhase = None,
    description: Annotated[
        str, typer.Option("--description", metavar="TEXT", help="One or two sentences.")
    ] = "",
    paper: Annotated[
        str | None, typer.Option("--paper", metavar="URL", help="https link to the paper.")
    ] = None,
    code: Annotated[
        str | None, typer.Option("--code", metavar="URL", help="https link to the code.")
    ] = None,
    facts: options.FactsFile = None,
    fact: options.Fact = None,
    without_reminder: Annotated[
        str | None,
        typer.Option(
            "--without-reminder",
            metavar="SUBMISSION_ID",
            autocompletion=submission_ids,
            help="Strategy phases: your submission of the same agent without reminder.",
        ),
    ] = None,
    replace: Annotated[
        bool,
        typer.Option("--replace", help="Replace the entry of the method, without asking."),
    ] = False,
    allow_unranked: Annotated[
        bool,
        typer.Option(
            "--allow-unranked", help="Send what will be scored but not ranked, without asking."
        ),
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait for score and rank, and show them.")
    ] = False,
    timeout: Annotated[
        float | None,
        typer.Option("--timeout", metavar="S", min=0, help="With --wait: give up after S seconds."),
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Check a file, say what an upload will do, then upload it.

    Before anything is sent it is said what the file looks like, whether it replaces an entry of the
    team, and why it would not be ranked; on a terminal you are asked, elsewhere --replace and
    --allow-unranked say yes. With --wait it is followed until it is ranked. The same bytes again
    give the first submission back and cost no quota; to change what is said of them, use edit.

    Facts of the method, all optional: type, sensors, map, extra_data, open_code, open_weights,
    parameters_millions, hardware, time_per_sample_s. Those of its last run stay if none are given.
    """
    told = facts_of_pairs(fact or (), facts)

    def consent(outlook: Outlook) -> None:
        say_view(*file_view(outlook.report), *outlook_view(outlook))
        _require_consent(outlook, replace=replace, allow_unranked=allow_unranked)

    phase, given = default_phase(phase), options.given(file, context)
    with open_client(server) as client:
        try:
            with TransferBar("uploading", given.name) as bar:
                submission = client.submit(
                    given,
                    phase=phase,
                    method=method,
                    description=description,
                    paper=paper,
                    code=code,
                    facts=told,
                    without_reminder=without_reminder,
                    on_progress=bar,
                    before_upload=consent,
                )
        except KeyboardInterrupt:
            say(UNANSWERED)
            raise typer.Exit(INTERRUPTED) from None
        if wait:
            _wait(submission, timeout)
        if json:
            show_document(submission.view)
            return
        show(*submission_view(submission.view, submission.page_url, with_file=False))
        left = None
        with suppress(ExceptionDriveError):  # the upload was good, whatever comes of this question
            left = client.phase(phase).quota
        show(*(() if left is None else (submissions_left(left),)))


def _wait(submission: "Submission", timeout: float | None) -> None:
    """Wait for the end of a submission; who interrupts it reads that it goes on, and where."""
    try:
        with WaitLine(submission.view) as line:
            submission.wait(timeout, on_change=line)
    except KeyboardInterrupt:
        say(f"Submission {submission.id} is no longer waited for.")
        say(IT_IS_SAFE.format(submission.id))
        raise typer.Exit(INTERRUPTED) from None


def _require_consent(outlook: Outlook, *, replace: bool, allow_unranked: bool) -> None:
    """Ask before quota is spent on what replaces an entry or cannot be ranked.

    Raises:
        InvalidArgumentError: Nobody can be asked, or the answer is no; nothing was sent.
    """
    said = {"replace": replace, "allow_unranked": allow_unranked}
    for argument, sentence in outlook.to_confirm.items():
        option = f"--{argument.replace('_', '-')}"
        if said[argument]:
            continue
        if not can_ask():
            raise InvalidArgumentError(
                "not_confirmed", f"{sentence} Nothing was sent.", f"To send it, add {option}."
            )
        if not typer.confirm(f"{sentence} Submit it?", err=True):
            raise InvalidArgumentError("not_confirmed", "Nothing was sent.")


def status(
    submission_id: options.SubmissionId,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show one submission.

    Where it stands, and then its score or its faults.
    Exit code 0 whenever it could be shown, whatever its status.
    """
    with open_client(server) as client:
        view = client.status(submission_id, profile=True)
        if json:
            show_document(view)
        else:
            show(*submission_view(view, client.page_url(view.id)))


def submissions(
    phase: options.Phase = None,
    only: Annotated[
        str | None,
        typer.Option(
            "--status",
            metavar="STATUS",
            autocompletion=choices(*SubmissionStatus),
            help=f"Only {', '.join(SubmissionStatus)}.",
        ),
    ] = None,
    limit: Annotated[
        int, typer.Option("--limit", metavar="N", min=1, help="At most so many.")
    ] = 100,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """List the team's submissions, newest first."""
    with open_client(server) as client:
        views = client.submissions(phase=phase, status=_status(only), limit=limit)
    if json:
        show_json([view.model_dump(mode="json", by_alias=True) for view in views])
    elif views:
        show(*submissions_view(views))
    else:
        show("no submissions")


def quota(
    phase: options.Phase = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show what the team may still submit, and when the count resets."""
    with open_client(server) as client:
        found = client.quota(phase)
    as_json = {name: each.model_dump(mode="json", by_alias=True) for name, each in found.items()}
    show_result(as_json, json, quota_table(found))


def edit(
    submission_id: options.SubmissionId,
    method: Annotated[
        str | None,
        typer.Option("--method", metavar="NAME", help="New name, of all runs of the method."),
    ] = None,
    description: Annotated[
        str | None, typer.Option("--description", metavar="TEXT", help="One or two sentences.")
    ] = None,
    paper: Annotated[
        str | None, typer.Option("--paper", metavar="URL", help="https link; empty: none.")
    ] = None,
    code: Annotated[
        str | None, typer.Option("--code", metavar="URL", help="https link; empty: none.")
    ] = None,
    facts: options.FactsFile = None,
    fact: options.Fact = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Change name, links, description or facts of a submission; without options, list its changes.

    Score, time and quota stay as they are. Boards that were published keep the old name.
    """
    said = {"method": method, "description": description, "paper": paper, "code": code}
    said = {name: value for name, value in said.items() if value is not None}
    told = facts_of_pairs(fact or (), facts)
    with open_client(server) as client:
        if told is not None or said:
            client.edit(submission_id, **said, facts=told)
        view, edits = client.status(submission_id), client.edits(submission_id)
    if json:
        show_json([each.model_dump(mode="json") for each in edits])
        return
    show(f"{view.id}  {view.method}")
    show(edits_table(edits) if edits else "nothing was changed since it was submitted")


def download(
    submission_id: options.SubmissionId,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Else ID.json or ID.json.gz."),
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Get the team's own upload again, bit by bit."""
    with open_client(server) as client:
        data = client.download(submission_id)
    show_saved(output or Path(upload_name(submission_id, data)), data, json)


def withdraw(
    submission_id: options.SubmissionId,
    yes: options.Yes = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Take a submission off the board; on a terminal it asks first.

    It stays in the team's own list; until the deadline the run of the method that it had replaced
    stands again.
    """
    with open_client(server) as client:
        asked = client.status(submission_id)
        stands = asked.status is not SubmissionStatus.WITHDRAWN
        be_sure(f"Withdraw {entry_words(asked)}?", yes or not stands)
        own = client.submissions(phase=asked.phase, limit=None)
        view = client.withdraw(submission_id)
        before = next((each for each in own if each.replaced_by == view.id), None)
        again = None if before is None else client.status(before.id)
    words = "no other run takes its place on the board"
    if again is not None and again.replaced_by is None:
        words = f"with the next board there stands again {entry_words(again)}"
    if not stands:
        words = "it was so before, and nothing changed"
    show_result(view, json, f"{view.id} {view.status}: {words}")


def choose(
    submission_id: options.SubmissionId,
    best: Annotated[
        bool, typer.Option("--best", help="Let the best run of its method stand, not this one.")
    ] = False,
    newest: Annotated[
        bool, typer.Option("--newest", help="Let the newest run of its method stand again.")
    ] = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Say which run stands, in a phase that lets teams choose.

    The last word before the deadline counts; until then it is the newest scored one. In a phase that
    shows one entry of each team it stands for the team, else for its method.
    """
    if best and newest:
        raise InvalidArgumentError("wrong_option", "Choose one of --best and --newest.")
    rule: RunRule = "best" if best else "newest" if newest else "this"
    with open_client(server) as client:
        view = client.choose(submission_id, rule)
    stands = f"{view.id} stands" if rule == "this" else f"the {rule} run of {view.method} stands"
    show_result(view, json, stands)


def publish(
    submission_id: options.SubmissionId,
    undo: Annotated[
        bool, typer.Option("--undo", help="Make it private again; earlier boards keep it.")
    ] = False,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Put an entry on the board of a phase that keeps entries private."""
    with open_client(server) as client:
        view = client.unpublish(submission_id) if undo else client.publish(submission_id)
    show_result(view, json, f"{view.id} is {'public' if view.is_published else 'private'}")


def _status(name: str | None) -> SubmissionStatus | None:
    if name is None:
        return None
    try:
        return SubmissionStatus(name)
    except ValueError:
        raise InvalidArgumentError(
            "wrong_option", f"--status must be one of {', '.join(SubmissionStatus)}."
        ) from None


def register(app: typer.Typer) -> None:
    """Add these commands."""
    app.command(context_settings=options.ONE_FILE)(submit)
    for command in (status, submissions, quota, edit, download, withdraw, choose, publish):
        app.command()(command)
