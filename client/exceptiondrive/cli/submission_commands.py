"""Commands about the team's submissions: submit, status, submissions, quota, withdraw."""

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exceptiondrive.cli import options
from exceptiondrive.cli.completion import submission_ids
from exceptiondrive.cli.file_tables import file_view
from exceptiondrive.cli.options import flag, one_of, option
from exceptiondrive.cli.output import (
    Answer,
    be_sure,
    can_ask,
    cut_words,
    save_new,
    say,
    show,
    show_json,
    upload_name,
)
from exceptiondrive.cli.progress import step_line, transfer_bar
from exceptiondrive.cli.session import open_client, with_client
from exceptiondrive.cli.tables import (
    edits_table,
    outlook_view,
    quota_table,
    status_line,
    submission_view,
    submissions_left,
    submissions_view,
)
from exceptiondrive.errors import (
    IT_IS_SAFE,
    ExceptionDriveError,
    InvalidArgumentError,
    NotAllowedError,
    NotSignedInError,
)
from exceptiondrive.facts import facts_of_pairs
from exceptiondrive.outlook import Outlook
from exceptiondrive.settings import default_phase
from exceptiondrive_schemas.api.own_entries import entry_words
from exceptiondrive_schemas.api.phase_settings import RunRule
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView

if TYPE_CHECKING:
    from collections.abc import Callable

    from exceptiondrive.client import Client, Submission

Replace = Annotated[bool, flag("--replace", "Replace the entry of the method, without asking.")]
INTERRUPTED = 130
"""The exit code of what Ctrl-C ended, as shells have it."""
UNANSWERED = (
    "Interrupted before the server has answered: `exceptiondrive submissions` lists the file if it "
    "arrived. Sent again, the same bytes count once."
)


def submit(
    context: typer.Context,
    file: options.File,
    method: Annotated[str, option("--method", "NAME", "Name of the method, as the board has it.")],
    phase: options.DefaultPhase = None,
    description: Annotated[str, option("--description", "TEXT", "One or two sentences.")] = "",
    paper: Annotated[str | None, option("--paper", "URL", "https link to the paper.")] = None,
    code: Annotated[str | None, option("--code", "URL", "https link to the code.")] = None,
    facts: options.FactsFile = None,
    fact: options.Fact = None,
    without_reminder: Annotated[
        str | None,
        option(
            "--without-reminder",
            "SUBMISSION_ID",
            "Strategy phases: your submission of the same agent without reminder.",
            offer=submission_ids,
        ),
    ] = None,
    replace: Replace = False,
    allow_unranked: Annotated[
        bool, flag("--allow-unranked", "Send what will be scored but not ranked, without asking.")
    ] = False,
    wait: Annotated[bool, flag("--wait", "Wait for score and rank, and show them.")] = False,
    timeout: Annotated[
        float | None, option("--timeout", "S", "With --wait: give up after S seconds.", min=0)
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Check a file, say what an upload will do, then upload it.

    Before anything is sent, the command says what the file looks like, whether it replaces an entry
    of the team, and why it would not be ranked. On a terminal it asks; elsewhere --replace and
    --allow-unranked say yes. With --wait it follows the submission to its rank. The same bytes again
    give the first submission back and cost no quota, unless it was withdrawn; to change its name,
    links or facts, use edit.

    Facts of the method, all optional: type, sensors, map, extra_data, open_code, open_weights,
    parameters_millions, hardware, time_per_sample_s. If you give none, those of its last run stay.
    """
    told = facts_of_pairs(fact or (), facts)

    def consent(outlook: Outlook) -> None:
        show(file_view(outlook.report), outlook_view(outlook, phase), stderr=True)
        if wait and not outlook.is_own_told:
            raise NotAllowedError(
                "not_allowed",
                "This token cannot read a score to wait for: it lacks the scope read:own. Nothing was sent.",
                "Leave out --wait, or make a token with --scope submit --scope read:own.",
            )
        _require_consent(outlook, replace=replace, allow_unranked=allow_unranked)

    phase, given = default_phase(phase), options.given_file(file, context)
    with open_client(server) as client:
        try:
            with transfer_bar("uploading", given.name) as bar:
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
            _wait_or_say_where(submission, timeout)
        if json:
            show_json(submission.view)
            return
        show(*submission_view(submission.view, submission.page_url, with_file=False))
        left = None
        with suppress(ExceptionDriveError):  # the upload was good, whatever comes of this question
            left = client.phase(phase).quota
        if left is not None:
            show(submissions_left(left))


def _wait_or_say_where(submission: "Submission", timeout: float | None) -> None:
    """Wait for the end of a submission; who interrupts it reads that it goes on, and where."""
    try:
        with step_line() as tell:

            def say_where(view: SubmissionView) -> None:
                tell(f"{view.id}  {status_line(view)}")

            say_where(submission.view)
            submission.wait(timeout, on_change=say_where)
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
    asked = {name: words for name, words in outlook.to_confirm.items() if not said[name]}
    needed = " and ".join(f"--{name.replace('_', '-')}" for name in asked)
    words = " ".join(asked.values())
    be_sure(words, not asked, needed, question="Submit it?", nothing="Nothing was sent.")


def _asking_first(
    change: "Callable[..., SubmissionView]", replace: bool, question: str
) -> SubmissionView:
    """Make a change; where it takes the place of an entry, ask before it does.

    Raises:
        InvalidArgumentError: Nobody can be asked, or the answer is no; nothing was changed.
    """
    try:
        return change(replace=replace)
    except InvalidArgumentError as error:
        if error.code != ProblemCode.NOT_CONFIRMED:
            raise
        be_sure(error.sentence, False, "--replace", question=question)
    return change(replace=True)


@with_client
def status(client: "Client", submission_id: options.SubmissionId) -> Answer:
    """Show one submission.

    The command shows its status, and then its score or its faults.
    The exit code is 0 whenever it could be shown, whatever its status.
    """
    view = client.status(submission_id, profile=True)
    return view, submission_view(view, client.page_url(view.id))


@with_client
def submissions(
    client: "Client",
    phase: options.Phase = None,
    only: Annotated[
        str | None,
        one_of("--status", SubmissionStatus, f"Only {', '.join(SubmissionStatus)}.", "STATUS"),
    ] = None,
    limit: Annotated[int, option("--limit", "N", "Show at most N.", min=1)] = 100,
) -> Answer:
    """List the team's submissions, newest first; those of all teams with an organizer's token."""
    options.require_one_of("--status", only, SubmissionStatus)
    views = client.submissions(phase=phase, status=only, limit=limit)
    return views, submissions_view(views) if views else "no submissions", *cut_words(views, limit)


@with_client
def quota(client: "Client", phase: options.Phase = None) -> Answer:
    """Show what the team may still submit, and when the count resets.

    Phases that take no files now are left out, unless --phase names one.
    """
    found = client.quota(phase)
    words = (quota_table(found),) if found else ()
    if not found or (phase is not None and not client.phase(phase).takes_files):
        words = (*words, "nothing can be sent now: see `exceptiondrive phases`")
    return found, *words


@with_client
def edit(
    client: "Client",
    submission_id: options.SubmissionId,
    method: Annotated[
        str | None, option("--method", "NAME", "New name, of all runs of the method.")
    ] = None,
    description: Annotated[
        str | None, option("--description", "TEXT", "One or two sentences.")
    ] = None,
    paper: Annotated[str | None, option("--paper", "URL", "https link; empty: none.")] = None,
    code: Annotated[str | None, option("--code", "URL", "https link; empty: none.")] = None,
    facts: options.FactsFile = None,
    fact: options.Fact = None,
    replace: Replace = False,
) -> Answer:
    """Change name, links, description or facts of a submission; without options, list its changes.

    Score, time and quota stay as they are. Published boards keep the old name. If you give the name
    of another of the team's methods, the two are merged, and one run counts: on a terminal it asks.
    """
    words = {"method": method, "description": description, "paper": paper, "code": code}
    said: dict[str, Any] = {name: value for name, value in words.items() if value is not None}
    told = facts_of_pairs(fact or (), facts)
    if told is not None or said:
        change = partial(client.edit, submission_id, **said, facts=told)
        _asking_first(change, replace, "A later new name does not part the two. Rename it?")
    view, edits = client.status(submission_id), client.edits(submission_id)
    changes = edits_table(edits) if edits else "nothing was changed since it was submitted"
    return edits, f"{view.id}  {view.method}", changes


@with_client
def download(
    client: "Client",
    submission_id: options.SubmissionId,
    output: Annotated[
        Path | None, options.output("Output file; else ID.json or ID.json.gz.")
    ] = None,
) -> Answer:
    """Download the team's own upload, exactly as it was sent."""
    data = client.download(submission_id)
    return save_new(output or Path(upload_name(client.id_of(submission_id), data)), data)


@with_client
def withdraw(
    client: "Client", submission_id: options.SubmissionId, yes: options.Yes = False
) -> Answer:
    """Take a submission off the board; on a terminal it asks first.

    It stays in the team's own list. Until the deadline, the run of the method that it had replaced
    counts again.
    """
    try:
        asked = client.status(submission_id)
    except NotSignedInError:
        raise
    except NotAllowedError:  # a token may withdraw what it cannot read
        asked = None
    stands = asked is None or asked.status is not SubmissionStatus.WITHDRAWN
    own = () if asked is None else client.submissions(phase=asked.phase, limit=None)
    linked = [] if asked is None else [each for each in own if each.linked_to == asked.id]
    against = [each.id for each in linked if each.reminder_effect is not None]
    lost = f"The board then shows no effect of the reminder in {', '.join(against)}."
    if stands and can_ask():  # a script goes on: the same bytes may be sent again
        name = submission_id if asked is None else entry_words(asked)
        be_sure(lost if against else "", yes, question=f"Withdraw {name}?")
    view = client.withdraw(submission_id)
    if asked is None:
        unknown = "without the scope read:own, the client cannot see what takes its place"
        return view, f"{view.id} {view.status}: {unknown}"
    before = next((each for each in own if each.replaced_by == view.id), None)
    again = None if before is None else client.status(before.id)
    words = "no other run takes its place on the board"
    if again is not None and again.replaced_by is None:
        words = f"the next board shows {entry_words(again)} again"
        if again.unranked_because is not None:
            why = again.unranked_because
            words = f"the previous run, {entry_words(again)}, is not ranked now: {why}"
    if view.score_kept_back_since is not None:
        words = "which run counts is shown when the board is revealed"
    if not stands:
        words = "it was withdrawn before, and nothing changed"
    return view, f"{view.id} {view.status}: {words}", *([lost] if against else ())


@with_client
def choose(
    client: "Client",
    submission_id: options.SubmissionId,
    best: Annotated[
        bool, flag("--best", "Let the best run of its method count, not this one.")
    ] = False,
    newest: Annotated[
        bool, flag("--newest", "Let the newest run of its method count again.")
    ] = False,
) -> Answer:
    """Choose which run counts, in a phase that lets teams choose.

    The last choice before the deadline is final; without one, the newest scored run counts. In a
    phase that shows one entry of each team the choice is for the team, else for the method.
    """
    if best and newest:
        raise InvalidArgumentError("wrong_option", "Choose one of --best and --newest.")
    rule: RunRule = "best" if best else "newest" if newest else "this"
    view = client.choose(submission_id, rule)
    stands = f"{view.id} stands" if rule == "this" else f"the {rule} run of {view.method} stands"
    return view, stands if view.is_published else f"{stands} once your team publishes it"


@with_client
def publish(
    client: "Client",
    submission_id: options.SubmissionId,
    undo: Annotated[
        bool, flag("--undo", "Make it private again, until the deadline; earlier boards keep it.")
    ] = False,
    replace: Replace = False,
) -> Answer:
    """Put an entry on the board of a phase that keeps entries private.

    If another run of its method is public, it asks on a terminal.
    """
    if undo:
        view = client.unpublish(submission_id)
    else:
        view = _asking_first(partial(client.publish, submission_id), replace, "Publish it?")
    return view, f"{view.id} is {'public' if view.is_published else 'private'}"
