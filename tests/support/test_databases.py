"""A database that is used again is like a new one, or it is not used again."""

from collections.abc import Iterator

import psycopg
import pytest
from tests.support.databases import TEMPLATE, Postgres

pytestmark = [pytest.mark.postgres]
ADD_TEAM = (
    "INSERT INTO teams (slug, name, affiliation, name_skeleton, is_reference, created_at)"
    " VALUES ('x', 'X', '', 'x', false, now()) RETURNING id"
)


@pytest.fixture
def used(postgres: Postgres) -> Iterator[str]:
    """The name of a database with a team; whatever a test does to it, it goes back."""
    name = postgres.create(TEMPLATE)
    with psycopg.connect(postgres.address(name)) as connection:
        connection.execute(ADD_TEAM)
    yield name
    postgres.drop(name)


def test_it_comes_back_empty_and_under_another_name(postgres: Postgres, used: str) -> None:
    left_open = psycopg.connect(postgres.address(used))
    postgres.drop(used)
    with pytest.raises(psycopg.OperationalError):
        left_open.execute("SELECT 1")
    with pytest.raises(psycopg.OperationalError):
        psycopg.connect(postgres.address(used))
    again = postgres.create(TEMPLATE)
    with psycopg.connect(postgres.address(again)) as connection:
        assert connection.execute("SELECT * FROM teams").fetchall() == []
        assert connection.execute(ADD_TEAM).fetchone() == (1,)
    postgres.drop(again)


@pytest.mark.parametrize(
    "change",
    [
        "ALTER TABLE teams ADD COLUMN added_later VARCHAR",
        "ALTER TABLE teams ALTER COLUMN name DROP NOT NULL",
        "ALTER TABLE teams RENAME TO crews",
        "DROP TABLE alembic_version",
        "UPDATE alembic_version SET version_num = '9999'",
        "ALTER TABLE audit_lines DISABLE TRIGGER ALL",
        "GRANT SELECT ON audit_lines TO PUBLIC",
        "CREATE TABLE made_later (id INTEGER)",
    ],
)
def test_one_whose_schema_was_changed_is_not_used_again(
    postgres: Postgres, used: str, change: str
) -> None:
    with psycopg.connect(postgres.address(used)) as connection:
        connection.execute(change)
        oid = connection.execute("SELECT oid FROM pg_database WHERE datname = %s", (used,))
        (changed,) = oid.fetchone() or (None,)
    postgres.drop(used)
    with psycopg.connect(postgres.uri) as connection:
        kept = connection.execute("SELECT oid FROM pg_database").fetchall()
    assert (changed,) not in kept
