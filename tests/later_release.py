"""A later release, as far as its records go: one migration more, and one key more in each document."""

import shutil
from pathlib import Path

import pytest
from sqlalchemy import text

from exceptiondrive_records import migrations
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText
from exceptiondrive_records.db.database import Database

_ONE_MORE = '''"""What a later release adds."""

import sqlalchemy as sa
from alembic import op

revision = "{later}"
down_revision = "{newest}"


def upgrade() -> None:
    op.add_column("work", sa.Column("added_later", sa.String()))
    op.create_table("made_later", sa.Column("id", sa.Integer(), primary_key=True))
'''

_DOCUMENTS_BESIDES = {"boards.body", "notifications.body", "site_settings.value"}


def become_later_release(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let this process be the later release until `monkeypatch.undo()`."""
    later = Path(shutil.copytree(migrations.FOLDER, folder / "later_migrations"))
    newest = migrations.newest_revision()
    number = f"{int(newest) + 1:04}"
    script = later / "versions" / f"{number}_later.py"
    script.write_text(_ONE_MORE.format(newest=newest, later=number))
    monkeypatch.setattr(migrations, "FOLDER", later)


def write_as_later_release(database: Database) -> set[str]:
    """Add a key to each document of a SQLite database; return the columns that hold one."""
    found = set()
    with database.write() as session:
        for name in list(
            session.scalars(text("SELECT name FROM sqlite_master WHERE type='trigger'"))
        ):
            session.execute(text(f'DROP TRIGGER "{name}"'))  # boards and sheets are append-only
        for table in Base.metadata.sorted_tables:
            for column in table.columns:
                if isinstance(column.type, DocumentText) or str(column) in _DOCUMENTS_BESIDES:
                    longer = f"""'{{"added_later" : 1, ' || substr({column.name}, 2)"""
                    change = f"UPDATE {table.name} SET {column.name} = {longer}"
                    change += f""" WHERE {column.name} LIKE '{{"%' RETURNING 1"""
                    if session.execute(text(change)).all():
                        found.add(str(column))
    return found
