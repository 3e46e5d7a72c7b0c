"""Documents of the API as people read them in a terminal."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, Literal

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from exceptiondrive.cli.fitted_table import ByWidth, Column, FittedTable
from exceptiondrive.errors import utc_text
from exceptiondrive.outlook import Outlook
from exceptiondrive.words import challenge_of
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.faults import CheckReport, FaultGroup
from exceptiondrive_schemas.method_facts import SubmissionEditView, Told
from exceptiondrive_schemas.own_entries import HEADLINE, entry_words, metric_text, question_of
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.rescoring import NotificationView
from exceptiondrive_schemas.score_sheet import BreakdownRow, MetricRow, ProtocolRef, ScoreSheet
from exceptiondrive_schemas.standing_words import standing_words
from exceptiondrive_schemas.submission import QueuePlace, Quota, SubmissionStatus, SubmissionView

EXAMPLES_SHOWN = 5
FIRST_LEFT_OUT = 3
"""Of the columns of a board or sheet, metrics that do not rank are left out first."""
SENSITIVITY = "d_safe_x"
AGGREGATES = {"macro_family": "mean of families", "micro": "mean of samples"}
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
        table.add_row(*(_cell(name, record.get(name)) for name in columns))
    return table


def _kind_of(name: str) -> Literal["id", "words"]:
    return "id" if name in ("id", "phase", "at") or name.endswith(("_id", "_at")) else "words"


def _cell(name: str, value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str) and (name == "at" or name.endswith("_at")):
        with suppress(ValueError):
            return utc_text(value)
    return "" if value is None else str(value)


def metric_head(metric: Metric) -> str:
    """Column head: label, unit, and which way is better."""
    arrow = {"higher": " ^", "lower": " v", None: ""}[metric.better]
    unit = "%" if metric.unit == "fraction" else "m"
    return f"{metric.label} {unit}{arrow}"


def report_view(
    report: CheckReport, name: str = "The file", with_all: bool = False
) -> Iterator[RenderableType]:
    """Yield what to print for a report.

    Args:
        report: Outcome of a check.
        name: What to call the file.
        with_all: Whether every sample with a fault is named.
    """
    yield Text(_headline(report, name), style="bold red" if report.faults else "bold green")
    for group in report.faults:
        yield ""
        yield Text.assemble(
            (group.code.value, "bold"), f"  {group.extent(report.n_predictions)}  {group.message}"
        )
        yield _examples(group)
        if with_all and group.sample_ids:
            yield Text(f"  {' '.join(group.sample_ids)}", style="dim")
        elif group.n_samples > EXAMPLES_SHOWN:
            rest = counted(group.n_samples - EXAMPLES_SHOWN, "sample")
            yield Text(f"  ... and {rest} more; --all names every one", style="dim")
        elif not group.n_samples and group.count > EXAMPLES_SHOWN:
            yield Text(f"  ... and {group.count - EXAMPLES_SHOWN:,} more", style="dim")
    yield from file_view(report)


AS_FAR = (
    "as far as can be told here: what asks for hazards, controls or families is tried by scoring"
)


def outlook_view(outlook: Outlook) -> Iterator[RenderableType]:
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
    if outlook.report.unranked_because is None:
        yield f"outlook: it will be ranked, {AS_FAR}"
    if outlook.replaces is not None:
        yield f"outlook: it replaces {entry_words(outlook.replaces)}"
    elif outlook.report.is_valid:
        yield "outlook: it takes the place of no other entry"
    yield outlook.rule


def file_view(report: CheckReport) -> Iterator[RenderableType]:
    """Yield what a file looks like, what is probably wrong with it, and whether it would rank."""
    for note in report.notes:
        yield Text(f"note: {note}", style="yellow")
    if report.unranked_because is not None:
        unranked = f"it will be scored but not ranked: {report.unranked_because}"
        yield Text(f"warning: {unranked}", style="bold yellow")
    if report.profile is None:
        return
    table = Table(box=None, padding=(0, 1), show_header=False)
    for label, words in report.profile.lines:
        table.add_row(Text(label, style="dim"), words)
    yield table
    for warning in report.profile.warnings:
        yield Text(f"warning: {warning}", style="bold yellow")


def _headline(report: CheckReport, name: str) -> str:
    if not report.faults:
        facts = [report.challenge or "", f"{report.n_predictions} predictions"]
        facts += [f"split {report.split}"] if report.split else []
        return f"{name} is valid: {', '.join(fact for fact in facts if fact)}"
    total = sum(group.count for group in report.faults)
    kinds = len(report.faults)
    return (
        f"{name} is not valid: {total} fault{'s' * (total > 1)} of {kinds} kind{'s' * (kinds > 1)}"
    )


def _examples(group: FaultGroup) -> FittedTable:
    table = FittedTable.of(
        Column("where", "id", left_out=3),
        Column("sample", "id", left_out=2),
        "expected",
        "got",
        Column("hint", left_out=1),
    )
    for fault in group.examples[:EXAMPLES_SHOWN]:
        cells = fault.path, fault.sample_id, fault.expected, fault.got, fault.hint
        table.add_row(*(cell or "" for cell in cells))
    return table


def sheet_view(
    sheet: ScoreSheet,
    protocol: ProtocolDocument | None = None,
    with_tasks: bool = True,
    n_predictions: int | None = None,
) -> Iterator[RenderableType]:
    """Yield what to print for a score sheet.

    Args:
        sheet: Scores, exact or as published.
        protocol: Gives titles, digits and the headline; else the one that ships with the client
            if it is the sheet's, else ids and two digits are shown.
        with_tasks: Whether to show the rows of the tasks.
        n_predictions: How many samples the file answers, where that is known: more than are scored
            where there are controls or withdrawn samples.
    """
    n_scored = counted(sheet.n, "sample")
    if n_predictions not in (None, sheet.n):
        n_scored = f"{counted(n_predictions or 0, 'sample')}, {sheet.n:,} of them in the score"
    protocol = protocol or _shipped(sheet.protocol)
    yield Text(
        f"{challenge_of(sheet.challenge).title} · split {sheet.split.name} · "
        f"protocol {sheet.protocol.version} · {n_scored}",
        style="bold",
    )
    edited, source = sheet.coverage.edited, sheet.coverage.source
    answered = f"{edited:.2%}" if source is None else f"{edited:.2%} edited, {source:.2%} source"
    yield Text(f"answers given: {answered}", style="dim")
    yield _sheet_table(sheet, protocol, with_tasks)
    yield from _sensitivity(sheet, protocol)
    yield from _plausibility(sheet)
    yield from _extra(sheet)


def _shipped(wanted: ProtocolRef) -> ProtocolDocument | None:
    try:
        shipped = packaged_protocol(wanted.version)
    except FileNotFoundError:
        return None
    return shipped if shipped.digest == wanted.digest else None


def _sheet_table(
    sheet: ScoreSheet, protocol: ProtocolDocument | None, with_tasks: bool
) -> FittedTable:
    challenge = challenge_of(sheet.challenge)
    table = FittedTable.of("", Column("n", "number"), *metric_columns(challenge))
    headline = protocol.grading.headline if protocol else HEADLINE
    for key in sorted(AGGREGATES, key=lambda key: key != headline):
        row: MetricRow = getattr(sheet, key)
        style = "bold" if key == headline else ""
        table.add_row(AGGREGATES[key], str(sheet.n), *_cells(challenge, row, protocol), style=style)
    families = {family.id: family.title for family in protocol.families} if protocol else {}
    table.add_gap()
    _add_rows(table, challenge, sheet.families, families, protocol)
    if with_tasks:
        tasks = {task.id: f"{task.id} {task.name}" for task in protocol.tasks} if protocol else {}
        table.add_gap()
        _add_rows(table, challenge, sheet.tasks, tasks, protocol)
    return table


def metric_columns(challenge: Challenge) -> Iterator[Column]:
    """Yield the columns of the metrics; those that rank always stay, the last others leave first."""
    ranking = {each.metric for each in challenge.primary_order}
    for index, metric in enumerate(challenge.columns):
        left_out = 0 if metric.key in ranking else FIRST_LEFT_OUT + index
        yield Column(metric_head(metric), "number", left_out)


def _add_rows(
    table: FittedTable,
    challenge: Challenge,
    rows: Mapping[str, BreakdownRow],
    titles: Mapping[str, str],
    protocol: ProtocolDocument | None,
) -> None:
    in_order = [key for key in titles if key in rows]  # kept sheets come sorted by key
    for key in [*in_order, *(key for key in rows if key not in titles)]:
        row = rows[key]
        n = "" if row.n is None else str(row.n)
        table.add_row(titles.get(key, key), n, *_cells(challenge, row.metrics, protocol))


def _cells(challenge: Challenge, row: MetricRow, protocol: ProtocolDocument | None) -> list[str]:
    digits = protocol.publication if protocol else None
    return [metric_text(metric, row.get(metric.key), digits) for metric in challenge.columns]


def _sensitivity(sheet: ScoreSheet, protocol: ProtocolDocument | None) -> Iterator[Text]:
    """One line for each other required clearance that the protocol asks about."""
    hcc = next((m for m in challenge_of(sheet.challenge).metrics if m.key == "hcc"), None)
    digits = protocol.publication if protocol else None
    for name, row in sheet.extra.items():
        if hcc is not None and name.startswith(SENSITIVITY):
            averages = [(f"hcc_{key}", words) for key, words in AGGREGATES.items()]
            parts = [f"{title} {metric_text(hcc, row.get(k), digits)}" for k, title in averages]
            factor = name.removeprefix(SENSITIVITY)
            yield Text(f"HCC % at {factor} times d_safe: {', '.join(parts)}", style="dim")


def _plausibility(sheet: ScoreSheet) -> Iterator[RenderableType]:
    shares = {key: share for key, share in sheet.plausibility.shares.items() if share is not None}
    if shares:
        listed = ", ".join(f"{key.replace('_', ' ')} {share:.1%}" for key, share in shares.items())
        yield Text(f"plausibility: {listed}", style="dim")
    for flag in sheet.plausibility.flags:
        yield Text.assemble(("flag ", "yellow"), (flag.label, "bold yellow"), f": {flag.detail}")


def _extra(sheet: ScoreSheet) -> Iterator[RenderableType]:
    """Further named rows: counts as counts, anything else as the fraction that it is."""
    by_columns: dict[tuple[str, ...], FittedTable] = {}
    others = {key: row for key, row in sheet.extra.items() if not key.startswith(SENSITIVITY)}
    for name, row in others.items():
        table = by_columns.get(tuple(row))
        if table is None:
            titles = (Column(key.replace("_", " "), "number") for key in row)
            table = by_columns[tuple(row)] = FittedTable.of("", *titles)
        is_count = "n" in row
        table.add_row(name.replace("_", " "), *(_extra_cell(v, is_count) for v in row.values()))
    yield from by_columns.values()


def _extra_cell(value: float | None, is_count: bool) -> str:
    if value is None:
        return "none"
    return f"{value:.0f}" if is_count else f"{value:.2%}"


def status_line(view: SubmissionView) -> str:
    """Say where a submission stands, in one line."""
    return view.status.value if view.queue is None else f"{view.status}: {queue_text(view.queue)}"


def queue_text(queue: QueuePlace) -> str:
    """Say how long it will take."""
    place = f"{queue.position} before it" if queue.position else "next"
    if queue.workers_alive == 0:
        return f"{place}, no worker is alive: it waits until one is"
    wait = ""
    if queue.expected_wait_s is not None:
        wait = f", about {max(1, round(queue.expected_wait_s))} s"
    again = f", attempt {queue.attempts + 1}" if queue.attempts > 1 else ""
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
    if question := question_of(view):
        yield question
    if view.is_asked:
        yield f"To submit it all the same: send the file again, or confirm it on {page_url}"
    if view.confirmed_as is not None:
        yield f"Submission {view.confirmed_as} is in its place: the team confirmed it or sent it again."
    if view.sheet is not None:
        n_predictions = view.report.n_predictions if view.report else None
        yield from sheet_view(view.sheet, with_tasks=False, n_predictions=n_predictions)
    if view.status is SubmissionStatus.SCORED:
        rank = f"rank {view.rank}" if view.rank else "not ranked"
        why = f": {view.unranked_because}" if view.unranked_because else ""
        if view.awaits_board:
            rank, why = "rank awaited", ": the next board is being built"
        if view.replaced_by is not None:
            rank, why = "not on the board", f": replaced by {view.replaced_by}"
        yield Text(f"{rank} in phase {view.phase}{why}", style="bold")
        yield Text(page_url)
    elif not view.status.is_terminal:
        yield Text(f"follow it with: exceptiondrive status {view.id}")
        yield Text(f"or in the browser: {page_url}")


def submissions_view(views: Iterable[SubmissionView]) -> Iterator[RenderableType]:
    """Yield a table of submissions, with what ranks of those that are scored, and what replaced them."""
    views = list(views)
    heads = {head: None for view in views for head in _ranking_texts(view)}
    table = FittedTable.of(
        Column("id", "id"),
        Column("phase", "id", left_out=2),
        "method",
        "status",
        *(Column(head, "number", left_out=1) for head in heads),
        Column("rank", "number"),
        Column("received", "id", left_out=3),
    )
    for view in views:
        style = STYLES.get(view.status, "yellow")
        ranking = _ranking_texts(view)
        table.add_row(
            view.id,
            view.phase,
            view.method,
            Text("replaced" if view.replaced_by else status_line(view), style=style),
            *(ranking.get(head, "") for head in heads),
            str(view.rank or ""),
            utc_text(view.received_at),
        )
    yield table
    for view in views:
        if view.replaced_by:
            yield Text(f"{view.id} was replaced by {view.replaced_by}", style="dim")


def _ranking_texts(view: SubmissionView) -> dict[str, str]:
    """Return what ranks of a scored submission, by the heads of its columns."""
    if view.sheet is None:
        return {}
    challenge, row = challenge_of(view.challenge), getattr(view.sheet, HEADLINE)
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


def notices_view(notices: Iterable[NotificationView]) -> Iterator[RenderableType]:
    """Yield what to print for messages to the team."""
    for notice in notices:
        mark = "" if notice.read_at else "  new"
        yield Text.assemble((notice.title, "bold"), (mark, "green"))
        yield Text(f"{utc_text(notice.created_at)} · {notice.kind}", style="dim")
        yield from (Text(f"  {sentence}") for sentence in notice.what_changed)
        for entry in notice.entries:
            challenge = None if notice.challenge is None else challenge_of(notice.challenge)
            before, now = (standing_words(challenge, each) for each in (entry.old, entry.new))
            yield Text(f"  {entry.method}: {before} -> {now}")


def quota_table(quotas: Mapping[str, Quota]) -> FittedTable:
    """Return what a team may still submit in each phase."""
    table = FittedTable.of(
        Column("phase", "id"),
        "left today",
        Column("left in all", left_out=2),
        Column("may be refused today", left_out=3),
        Column("may wait at once", left_out=4),
        Column("resets at", "id"),
    )
    for phase, quota in quotas.items():
        table.add_row(
            phase,
            f"{quota.remaining_today} of {quota.per_day}",
            "" if quota.total is None else f"{quota.total - quota.used_total} of {quota.total}",
            f"{quota.rejected_per_day - quota.rejected_today} of {quota.rejected_per_day}",
            ""
            if quota.concurrent is None
            else f"{quota.concurrent - quota.waiting} of {quota.concurrent}",
            utc_text(quota.resets_at),
        )
    return table


def board_view(board: Board) -> Iterator[RenderableType]:
    """Yield what to print for a board."""
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


def _board_tables(board: Board, challenge: Challenge, width: int) -> Iterator[RenderableType]:
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


def _board_table(board: Board, challenge: Challenge, flag_marks: Mapping[str, str]) -> FittedTable:
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
