"""A small world: one protocol, one split, one phase, one team."""

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.records.world import World, build_world
from tests.support.snapshots import Snapshots

from exceptiondrive_records.db.database import Database


@pytest.fixture
def world(database: Database, database_url: str, tmp_path: Path, snapshots: Snapshots) -> World:
    def make() -> tuple[int, str]:
        made = build_world(database)
        return made.team_id, made.protocol_digest

    return World(database, *snapshots.fill("one team", database_url, tmp_path, make))


@pytest.fixture
def make_world(database: Database) -> Callable[..., World]:
    """Build the world with other limits."""
    return lambda **limits: build_world(database, **limits)
