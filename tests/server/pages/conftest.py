"""Pages over real records: empty, lively, and with every kind of phase."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from benchmarks.page import big_board
from tests.server.pages.invented_board import (
    COUNTS,
    EFFECT,
    PAPER,
    PROTOCOL,
    board_of,
    lively_entries,
    reported,
)
from tests.server.pages.page_site import (
    Site,
    fill,
    open_site,
    publish_late_view,
    real_drawings,
    sheet_of,
)
from tests.support.serving import served
from tests.support.snapshots import Snapshots

from exceptiondrive_schemas.board import Board, FamilyCell, PairedComparison
from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_schemas.protocol import (
    ProtocolDocument,
)
from exceptiondrive_schemas.reported import reported_entries
from exceptiondrive_schemas.score_sheet import (
    PairedDifference,
    ScoreSheet,
)


@pytest.fixture(scope="session")
def protocol() -> ProtocolDocument:
    """The packaged protocol."""
    return PROTOCOL


@pytest.fixture(scope="session")
def lively_board() -> Board:
    """A board with entries of every source."""
    return board_of(lively_entries())


@pytest.fixture(scope="session")
def empty_board() -> Board:
    """A board on which nobody stands."""
    return board_of((), 1)


@pytest.fixture(scope="session")
def paper_board() -> Board:
    """A board with the paper's rows alone."""
    return board_of(tuple(reported(method) for method in PAPER), 1)


@pytest.fixture(scope="session", name="real_drawings")
def _real_drawings() -> EntryDrawings:
    """Real drawings of a synthetic planner."""
    return real_drawings()


@pytest.fixture
def site(tmp_path: Path, migrated_sqlite: Path) -> Iterator[Site]:
    """Pages over an empty system of record."""
    site = open_site(tmp_path, migrated_sqlite)
    yield site
    site.database.dispose()


@pytest.fixture
def lively_site(site: Site, lively_board: Board, tmp_path: Path, snapshots: Snapshots) -> Site:
    """Pages over a phase with a lively board."""
    url = str(site.database.engine.url)
    snapshots.fill("lively site", url, tmp_path, lambda: fill(site, lively_board))
    return site


@pytest.fixture(scope="session")
def shown_site(
    tmp_path_factory: pytest.TempPathFactory,
    migrated_sqlite: Path,
    lively_board: Board,
    paper_board: Board,
    empty_board: Board,
    strategy_board: Board,
) -> Iterator[Site]:
    """Pages over a lively, a paper-only, an empty and an unpublished phase; only read."""
    site = open_site(tmp_path_factory.mktemp("site"), migrated_sqlite)
    fill(site, lively_board)
    site.publish_split()
    for submission_id, planner in (("s0000000kq", 1), ("s0000003kq", 0), ("s0000005kq", 3)):
        site.keep_drawings(submission_id, planner)
    for phase in ("paper", "empty", "unpublished"):
        site.create_phase(phase)
    site.publish(paper_board.model_copy(update={"phase": "paper"}))
    site.publish(empty_board.model_copy(update={"phase": "empty"}))
    for phase, n_entries in (("long", 90), ("seventeen", 17)):
        site.create_phase(phase)
        entries = big_board(PROTOCOL, n_entries).entries
        site.publish(lively_board.model_copy(update={"phase": phase, "entries": entries}))
    site.create_phase("strategy", "strategy")
    site.publish(strategy_board)
    site.create_phase("pairs")
    found = PairedDifference(
        difference=0.04, interval=(-0.01, 0.07), discordant=0.3, verdict="open"
    )
    pair = PairedComparison(a="s0000000kq", b="s0000002kq", overall={"hcc": found}, families={})
    site.publish(lively_board.model_copy(update={"phase": "pairs", "comparisons": (pair,)}))
    publish_late_view(site, lively_board)
    yield site
    site.database.dispose()


@pytest.fixture(scope="module")
def address(shown_site: Site) -> Iterator[str]:
    """Where `shown_site` answers a browser."""
    with served(shown_site.app) as address:
        yield address


@pytest.fixture(scope="session")
def strategy_board(lively_board: Board) -> Board:
    """A board of the strategy challenge: one scored agent, and the paper's two rows."""
    metrics: dict[str, float | None] = {
        "accuracy": 0.6125,
        "under_warning": 0.2875,
        "over_warning": 0.1,
        "missing": 0.0,
    }
    agent = lively_board.entries[0].model_copy(
        update={
            "submission_id": "a0000000kq",
            "method": "Careful agent",
            "metrics": metrics,
            "micro": metrics,
            "macro_family": metrics,
            "intervals": {"accuracy": (0.55, 0.67), "under_warning": (0.23, 0.34)},
            "families": {
                family: FamilyCell.model_validate({"n": n, **metrics})
                for family, n in COUNTS.items()
            },
            "coverage": {"edited": 1.0, "source": None},
        }
    )
    without = agent.model_copy(
        update={
            "submission_id": "a0000001kq",
            "method": "Careful agent, no reminder",
            "rank": 2,
            "previous_rank": 1,
            "metrics": {**metrics, "accuracy": 0.45, "under_warning": 0.44, "over_warning": 0.11},
        }
    )
    agent = agent.model_copy(update={"reminder_effect": EFFECT})
    printed = reported_entries(STRATEGY.id, lively_board.headline)
    return lively_board.model_copy(
        update={"challenge": "strategy", "phase": "strategy", "entries": (agent, without, *printed)}
    )


@pytest.fixture(scope="session")
def sheets(lively_board: Board) -> tuple[ScoreSheet, ScoreSheet]:
    """Score sheets of the first and the third entry."""
    return sheet_of(lively_board.entries[0]), sheet_of(lively_board.entries[2])
