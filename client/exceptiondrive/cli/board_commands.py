"""Commands for boards and phases (public data), and for accepting terms."""

from collections.abc import Iterator
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, get_args

from exceptiondrive.challenges import challenge_of
from exceptiondrive.cli import options
from exceptiondrive.cli.fitted_table import Column, FittedTable
from exceptiondrive.cli.options import one_of, option
from exceptiondrive.cli.output import Answer, show_result
from exceptiondrive.cli.session import open_client, with_client
from exceptiondrive.cli.tables import board_view
from exceptiondrive.errors import InvalidArgumentError, utc_text
from exceptiondrive.settings import default_phase, find_setting
from exceptiondrive_schemas.api.phase_settings import BoardView
from exceptiondrive_schemas.api.submission import PhaseView
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.python310 import UTC
from exceptiondrive_schemas.score_sheet import metric_text

if TYPE_CHECKING:
    from exceptiondrive.client import Client
    from exceptiondrive_schemas.api.phase_report import PhaseReport

METRIC_KEYS = [key for each in CHALLENGES.values() for key in each.metric_keys]
VIEWS = get_args(BoardView)


def leaderboard(
    phase: options.DefaultPhase = None,
    challenge: Annotated[
        str | None,
        one_of("--challenge", CHALLENGES, "Its first phase, if no phase is given."),
    ] = None,
    protocol: Annotated[
        str | None, option("--protocol", "V", "Version; else the one in force.")
    ] = None,
    as_of: Annotated[
        str | None, option("--as-of", "TIME", "As it was at that time: 2026-11-21[T18:00:00Z].")
    ] = None,
    number: Annotated[
        int | None, option("--board", "N", "The board with this number, as in a citation.")
    ] = None,
    sort: Annotated[
        str | None,
        one_of(
            "--sort",
            METRIC_KEYS,
            "Order of rows: ur lowest first, -hcc highest; ranks stay.",
            "METRIC",
        ),
    ] = None,
    view: Annotated[
        str | None, one_of("--view", VIEWS, "late: with the entries that came after the deadline.")
    ] = None,
    server: options.Server = None,
    json: options.Json = False,
) -> None:
    """Show a ranked board."""
    options.require_one_of("--view", view, VIEWS)
    if challenge is None:
        phase = find_setting("phase", phase).value
    asked: dict[str, Any] = {
        "phase": phase,
        "challenge": challenge,
        "protocol": protocol,
        "as_of": as_of,
        "board": number,
        "sort": sort,
        "view": view,
    }
    with open_client(server) as client:
        board = client.leaderboard(**asked)
        now = None if json or as_of or number else client.phase(board.phase).now
    show_result(board, json, board_view(board, now.frozen_since if now else None))


@with_client
def phases(client: "Client") -> Answer:
    """List the phases.

    With their dates, split and protocol, and what your team may still submit.
    """
    views = client.phases()
    return views, phases_table(views, client._transport.said_at or datetime.now(UTC))


@with_client
def report(client: "Client", phase: options.PhaseArgument = None) -> Answer:
    """Show how a phase ended: the first places, and what a reveal changed."""
    found = client.report(default_phase(phase))
    return found, _report_view(found)


@with_client
def terms(
    client: "Client",
    phase: options.DefaultPhase = None,
    accept: Annotated[
        str | None, option("--accept", "VERSION", "Accept them, in the version you read.")
    ] = None,
) -> Answer:
    """Show the terms of a phase, and accept them for the team."""
    phase = default_phase(phase)
    if accept is not None:
        accepted = client.accept_terms(phase, accept)
        return accepted, f"terms of {phase}, version {accepted['version']}, accepted"
    view = client.phase(phase)
    if view.terms_version is None:
        raise InvalidArgumentError("no_terms", f"The phase {phase} has no terms to accept.")
    how = f"accept them by: exceptiondrive terms --phase {phase} --accept {view.terms_version}"
    at = view.terms_accepted_at
    facts = {"phase": phase, "version": view.terms_version, "text": view.page.terms}
    state = how if at is None else f"accepted {utc_text(at)}"
    return facts, view.page.terms, "", f"version {view.terms_version}; {state}"


def _report_view(found: "PhaseReport") -> Iterator[str | FittedTable]:
    columns = challenge_of(found.challenge).columns
    yield (
        f"{found.title}: closed {utc_text(found.closed_at)}, board {found.board}, protocol "
        f"{found.protocol.version}, {counted(found.n_samples, 'sample')}; "
        f"{counted(found.n_teams, 'team')}, "
        f"{found.n_ranked:,} ranked, {found.n_listed:,} without a rank"
    )
    winners = FittedTable.of(
        Column("rank", "number"),
        "method",
        "team",
        *(Column(one.label, "number") for one in columns),
    )
    for entry in found.winners:
        values = (metric_text(one, entry.metrics.get(one.key)) for one in columns)
        winners.add_row(str(entry.rank), entry.method, entry.team, *values)
    yield winners
    if found.shake_up is not None:
        moved = FittedTable.of(
            "method", "team", Column("before", "number"), Column("final", "number"), ""
        )
        for one in found.shake_up.places:
            ranks = (str(rank or "-") for rank in (one.before, one.after))
            moved.add_row(
                one.method, one.team, *ranks, "by another run" if one.is_another_run else ""
            )
        yield f"ranks on board {found.shake_up.board}, before the reveal, and on the final one"
        yield moved


def phases_table(views: tuple[PhaseView, ...], now: datetime) -> FittedTable:
    """Return the table of all phases, as they stand now."""
    table = FittedTable.of(
        Column("phase", "id"),
        Column("challenge", "id", left_out=1),
        "title",
        Column("split", "id", left_out=2),
        Column("samples", "number", left_out=3),
        Column("protocol", "id", left_out=4),
        Column("open"),
        Column("left"),
    )
    for view in views:
        window = _submission_window(view, now)
        table.add_row(
            view.id,
            view.challenge,
            view.title,
            view.split + (" (public)" if view.split_is_public else ""),
            f"{view.now.n_counted if view.now else view.n_samples:,}",
            view.protocol,
            window,
            _uploads_left(view, window),
        )
    return table


def _uploads_left(view: PhaseView, window: str) -> str:
    if view.disqualified_at is not None:
        return f"nothing: disqualified since {view.disqualified_at:%Y-%m-%d}"
    if window.startswith(("archived", "closed")) and not view.takes_late_entries:
        return "nothing"
    if window.startswith("opens"):
        return f"then {view.quota.per_day if view.quota else view.quota_per_day} a day"
    return f"{view.quota_per_day} a day" if view.quota is None else view.quota.left_words()


def _submission_window(view: PhaseView, now: datetime) -> str:
    if view.visibility == "archived":
        return "archived"
    opens, closes = view.opens_at, view.own_closes_at or view.closes_at
    if view.is_open:
        return "open" if closes is None else f"until {utc_text(closes)}"
    if opens is not None and opens > now:
        return f"opens {utc_text(opens)}"
    return "closed" if closes is None or closes > now else f"closed {utc_text(closes)}"
