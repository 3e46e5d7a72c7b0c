"""Documents of the API as people read them in a terminal."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal

from rich.console import RenderableType
from rich.text import Text

from exceptiondrive.challenges import challenge_of
from exceptiondrive.cli.file_tables import (
    AGGREGATES,
    FIRST_LEFT_OUT,
    file_view,
    metric_columns,
    metric_head,
    report_view,
    sheet_view,
)
from exceptiondrive.cli.fitted_table import ByWidth, Column, FittedTable
from exceptiondrive.cli.output import Answer
from exceptiondrive.errors import utc_text
from exceptiondrive.outlook import REPLACES_UNKNOWN, Outlook
from exceptiondrive_schemas.api.own_entries import entry_words, link_words, question_of
from exceptiondrive_schemas.api.submission import (
    QueuePlace,
    Quota,
    SubmissionStatus,
    SubmissionView,
)
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.method_facts import SubmissionEditView, Told
from exceptiondrive_schemas.score_sheet import metric_text

if TYPE_CHECKING:
    from exceptiondrive.transport import Record
    from exceptiondrive_schemas.api.notifications import NotificationView
    from exceptiondrive_schemas.board import Board

STYLES = {
    SubmissionStatus.SCORED: "green",
    SubmissionStatus.REJECTED: "red",
    SubmissionStatus.FAILED: "red",
    SubmissionStatus.WITHDRAWN: "dim",
}


def records_table(records: Iterable[Mapping[str, Any]], columns: tuple[str, ...]) -> FittedTable:
    """Return records of the API as a table of these columns; the last ones are left out first."""
    table = FittedTable.of(
        *(
            Column(name.replace("_", " "), _kind_of(name), left_out=max(0, index - 1))
            for index, name in enumerate(columns)
        )
    )
    for record in records:
        table.add_row(*(_cell_text(name, record.get(name)) for name in columns))
    return table


def listed(records: "list[Record]", columns: tuple[str, ...]) -> Answer:
    """Return the answer of a command that shows records of the API as they are."""
    return records, records_table(records, columns)


def _kind_of(name: str) -> Literal["id", "words"]:
    ids = ("id", "phase", "at", "revision")
    return "id" if name in ids or name.endswith(("_id", "_at")) else "words"


def _cell_text(name: str, value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str) and (name == "at" or name.endswith("_at")):
        with suppress(ValueError):
            return utc_text(value)
    return "" if value is None else str(value)


AS_FAR = (
    "as far as can be told here: what asks for hazards, controls or families is tried by scoring"
)


def outlook_view(outlook: Outlook, phase: str | None = None) -> Iterator[RenderableType]:
    """Yield what an upload will do, as far as the file and the team's entries tell."""
    if outlook.disqualified_at is not None:
        who = (
            "your team is" if outlook.first is None else f"these bytes, as {outlook.first.id}, are"
        )
        yield (
            f"outlook: it will be refused: {who} disqualified in this phase since "
            f"{outlook.disqualified_at:%Y-%m-%d}; the reason stands in `exceptiondrive notices`"
        )
        return
    if outlook.first is not None:
        first = f"{outlook.first.id} ({outlook.first.method})"
        yield f"these bytes were submitted before, as {first}: that submission stands, no quota is spent"
        return
    if outlook.is_closed:
        yield "outlook: it will be refused: the phase takes none now; see `exceptiondrive phases`"
        return
    if outlook.quota_error is not None:
        yield f"outlook: it will be refused now. {outlook.quota_error}"
        return
    if outlook.owes_terms:
        see = f"see `exceptiondrive terms --phase {phase or 'PHASE'}`"
        yield f"outlook: it will be refused until your team accepts the terms: {see}"
    if outlook.is_late:
        yield "outlook: the deadline has passed: it will appear on the late view only"
    elif outlook.stays is not None:
        stays = entry_words(outlook.stays)
        yield f"outlook: it will be scored, but not appear on the board: {stays} does, as your team chose"
    elif outlook.report.unranked_because is None:
        then = "then it" if outlook.owes_terms else "it"
        once = " once your team publishes it" if outlook.is_private else ""
        yield f"outlook: {then} will be ranked{once}, {AS_FAR}"
    if outlook.replaces is not None:
        yield f"outlook: it replaces {entry_words(outlook.replaces)}"
    elif outlook.may_replace_unseen:
        yield f"outlook: {REPLACES_UNKNOWN}"
    elif outlook.report.is_valid and outlook.alike is not None:
        yield f"outlook: it replaces no other entry; {outlook.alike!r} is another method"
    elif outlook.report.is_valid and outlook.stays is None:
        yield "outlook: it replaces no other entry"
    yield outlook.rule


def status_line(view: SubmissionView) -> str:
    """Say where a submission stands, in one line."""
    return view.status.value if view.queue is None else f"{view.status}: {queue_text(view.queue)}"


def queue_text(queue: QueuePlace) -> str:
    """Say how long it will take."""
    place = f"{queue.position} ahead" if queue.position else "next"
    if queue.workers_alive == 0:
        return f"{place}, no worker can score it now: it waits until one can"
    if queue.lease_until is not None:
        attempt = f"attempt {queue.attempts}, " if queue.attempts > 1 else ""
        return f"{attempt}again from {queue.lease_until:%H:%M:%S} UTC if its worker is lost"
    wait = ""
    if queue.expected_wait_s is not None:
        wait = f", about {max(1, round(queue.expected_wait_s))} s"
    again = f", attempt {queue.attempts + 1}" if queue.attempts else ""
    return f"{place}{wait}{again}"


def submission_view(
    view: SubmissionView, page_url: str, *, with_file: bool = True
) -> Iterator[RenderableType]:
    """Yield what to print for one submission; what its file looks like may have been said before."""
    style = STYLES.get(view.status, "yellow")
    yield Text.assemble((f"{view.id}  ", "bold"), (status_line(view), f"bold {style}"))
    yield Text(
        f"{view.method} · team {view.team} · phase {view.phase} · {utc_text(view.received_at)}",
        style="dim",
    )
    if view.is_duplicate:
        yield "The same bytes were submitted before: that submission stands, no quota was spent."
    if view.failure is not None:
        yield Text(f"{view.failure.code}: {view.failure.message}")
    if view.report is not None and view.report.faults:
        yield from report_view(view.report)
    elif view.report is not None and with_file:
        yield from file_view(view.report)
    elif view.awaits_profile and with_file:
        yield "What the file looks like is being worked out: ask again in a moment."
    if question := question_of(view):
        yield question
    if view.is_asked:
        yield f"To submit it all the same: send the file again, or confirm it on {page_url}"
    if view.confirmed_as is not None:
        yield f"Submission {view.confirmed_as} is in its place: the team confirmed it or sent it again."
    if view.sheet is not None:
        n_predictions = view.report.n_predictions if view.report else None
        yield from sheet_view(
            view.sheet, with_tasks=False, n_predictions=n_predictions, headline=view.headline
        )
    if view.linked_to is not None:
        yield link_words(view)
    if view.status is SubmissionStatus.SCORED:
        rank, why = _rank_and_reason(view)
        because = f": {why}" if why else ""
        yield Text(f"{rank} in phase {view.phase}{because}", style="bold")
        yield Text(page_url)
    elif not view.status.is_terminal:
        yield Text(f"follow it with: exceptiondrive status {view.id}")
        yield Text(f"or in the browser: {page_url}")


def _rank_and_reason(view: SubmissionView) -> tuple[str, str]:
    """Return the rank of a scored submission, or what stands in its place, and why."""
    if view.disqualified_at is not None:
        since = utc_text(view.disqualified_at)
        return "disqualified", f"since {since}; the reason stands in `exceptiondrive notices`"
    if view.replaced_by is not None and view.rank is None:
        return "not on the board", f"replaced by {view.replaced_by}"
    if view.score_kept_back_since is not None:
        since = utc_text(view.score_kept_back_since)
        return (
            "score and rank kept back",
            f"its board is frozen since {since}, until the organizers reveal it",
        )
    if view.is_late:
        return "not ranked", "it came after the deadline, so it holds no rank and moves none"
    if because := view.no_rank_to_come:
        return "not ranked", because
    if view.awaits_board:
        return "rank awaited", "the next board is being built"
    if not view.is_published and view.unranked_because is None:
        return "not ranked", f"it is private: exceptiondrive publish {view.id} shows it"
    if view.is_duplicate and view.sheet is None and view.rank is None:
        return "score and rank not told", "they are to a token with the scope read:own"
    return f"rank {view.rank}" if view.rank else "not ranked", view.unranked_because or ""


def submissions_view(views: Iterable[SubmissionView]) -> Iterator[RenderableType]:
    """Yield a table of submissions, with what ranks of those that are scored, and what replaced them.

    Whose they are stands in it where they are of several teams, as organizers see them.
    """
    views = list(views)
    teams = ("team",) * (len({view.team for view in views}) > 1)
    heads = {head: None for view in views for head in _ranking_texts(view)}
    table = FittedTable.of(
        Column("id", "id"),
        Column("phase", "id", left_out=2),
        *teams,
        "method",
        "status",
        *(Column(head, "number", left_out=1) for head in heads),
        Column("rank", "number"),
        Column("received", "id", left_out=3),
    )
    for view in views:
        style = STYLES.get(view.status, "yellow")
        ranking = _ranking_texts(view)
        line = "confirmed" if view.confirmed_as else status_line(view)
        table.add_row(
            view.id,
            view.phase,
            *(view.team for _ in teams),
            view.method,
            Text("replaced" if view.replaced_by else line, style=style),
            *(ranking.get(head, "") for head in heads),
            str(view.rank or ""),
            utc_text(view.received_at),
        )
    yield table
    for view in views:
        if view.replaced_by:
            yield Text(f"{view.id} was replaced by {view.replaced_by}", style="dim")
        elif view.confirmed_as:
            yield Text(f"{view.id} was confirmed or sent again as {view.confirmed_as}", style="dim")


def _ranking_texts(view: SubmissionView) -> dict[str, str]:
    """Return what ranks of a scored submission, by the heads of its columns."""
    if view.sheet is None:
        return {}
    challenge, row = challenge_of(view.challenge), view.sheet.average(view.headline)
    metrics = (challenge.metric(each.metric) for each in challenge.primary_order)
    return {metric_head(metric): metric_text(metric, row.get(metric.key)) for metric in metrics}


def edits_table(edits: Iterable[SubmissionEditView]) -> FittedTable:
    """Return what was changed of a submission, newest first."""
    table = FittedTable.of(
        Column("when", "id"), "what", "before", "since then", Column("who", left_out=1)
    )
    for edit in edits:
        for name, (before, after) in edit.changed.items():
            row = name.removeprefix("facts."), _told_words(before), _told_words(after)
            table.add_row(utc_text(edit.edited_at), *row, edit.by)
    return table


def _told_words(value: Told) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(value) or "-"
    return f"{value:.15g}" if isinstance(value, float) else value or "-"


def notices_view(notices: "Iterable[NotificationView]") -> Iterator[RenderableType]:
    """Yield what to print for messages to the team."""
    from exceptiondrive_schemas.api.standing_words import standing_words

    for notice in notices:
        mark = "" if notice.read_at else "  new"
        yield Text.assemble((notice.title, "bold"), (mark, "green"))
        yield Text(f"{utc_text(notice.created_at)} · {notice.kind}", style="dim")
        yield from (Text(f"  {sentence}") for sentence in notice.what_changed)
        for entry in notice.entries:
            challenge = None if notice.challenge is None else challenge_of(notice.challenge)
            before = standing_words(challenge, entry.old)
            now = standing_words(challenge, entry.new, before=entry.old)
            yield Text(f"  {entry.method}: {before} -> {now}")


def submissions_left(quota: Quota) -> str:
    """Say how many submissions are left, when the count of the day resets, and how many in all."""
    text = quota.left_words(" submissions left")
    if quota.is_bound_in_all:
        return text
    in_all = "" if quota.total is None else f"; {quota.left_in_all} of {quota.total} left in all"
    return f"{text}; the count resets at {utc_text(quota.resets_at)}{in_all}"


def quota_table(quotas: Mapping[str, Quota]) -> FittedTable:
    """Return what a team may still submit in each phase."""
    table = FittedTable.of(
        Column("phase", "id"),
        "left today",
        Column("left in all", left_out=2),
        Column("may be rejected today", left_out=3),
        Column("may wait at once", left_out=4),
        Column("resets at", "id"),
    )
    for phase, quota in quotas.items():
        table.add_row(
            phase,
            f"{quota.remaining_today} of {quota.per_day}",
            "" if quota.total is None else f"{quota.left_in_all} of {quota.total}",
            f"{quota.left_of_rejected} of {quota.rejected_per_day}",
            "" if quota.concurrent is None else f"{quota.left_of_waiting} of {quota.concurrent}",
            utc_text(quota.resets_at),
        )
    return table


def board_view(board: "Board", frozen_since: datetime | None = None) -> Iterator[RenderableType]:
    """Yield what to print for a board, and since when it waits for the organizers."""
    challenge = challenge_of(board.challenge)
    yield Text(
        f"{challenge.title} · phase {board.phase} · split {board.split.name} "
        f"({board.n_samples} samples) · protocol {board.protocol.version}",
        style="bold",
    )
    yield Text(
        f"board {board.board} of {utc_text(board.published_at)}, metrics: "
        f"{AGGREGATES.get(board.headline, board.headline)}",
        style="dim",
    )
    if frozen_since is not None:
        yield Text(f"frozen since {utc_text(frozen_since)}, until the organizers reveal it")
    if board.view == "late":
        yield Text(
            "late view: with the entries that came after the deadline; no rank of the board moves"
        )
    if board.part is not None:
        yield Text(f"counts the {board.part} part of the split")
    yield ByWidth(lambda width: _board_tables(board, challenge, width))
    by_reason: dict[str, list[str]] = {}
    for entry in board.entries:
        if entry.unranked_because:
            by_reason.setdefault(entry.unranked_because, []).append(entry.method)
    for reason, methods in by_reason.items():
        yield Text(f"not ranked, {reason}: {', '.join(methods)}", style="dim")


def _board_tables(board: "Board", challenge: Challenge, width: int) -> Iterator[RenderableType]:
    """Yield the board with the words of the flags, or where that is too wide with letters."""
    labels = dict.fromkeys(flag.label for entry in board.entries for flag in entry.flags)
    with_words = _board_table(board, challenge, {label: label for label in labels})
    if with_words.whole_width <= width or not labels:
        yield with_words
        return
    letters = {label: chr(ord("a") + number) for number, label in enumerate(labels)}
    yield _board_table(board, challenge, letters)
    words = ", ".join(f"{letter} = {label}" for label, letter in letters.items())
    yield Text(f"flags: {words}", style="dim")


def _board_table(
    board: "Board", challenge: Challenge, flag_marks: Mapping[str, str]
) -> FittedTable:
    table = FittedTable.of(
        Column("rank", "number"),
        Column("range", "number", left_out=2),
        "method",
        Column("team", left_out=1),
        *metric_columns(challenge),
        Column("source", "id", left_out=FIRST_LEFT_OUT),
        Column("flags", left_out=0 if flag_marks else FIRST_LEFT_OUT),
    )
    for entry in board.entries:
        low, high = entry.rank_interval or ("", "")
        marks = [flag_marks[flag.label] for flag in entry.flags]
        table.add_row(
            str(entry.rank or "-"),
            f"{low}-{high}" if entry.rank_interval else "",
            entry.method,
            entry.team,
            *(metric_text(metric, entry.metrics.get(metric.key)) for metric in challenge.columns),
            entry.source,
            ", ".join([*(["late"] if entry.is_late else []), *marks]),
            style="" if entry.rank else "dim",
        )
    return table
