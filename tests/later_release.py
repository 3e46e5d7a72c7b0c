"""A later release, as far as its schema goes: what this code has, and one migration more."""

import shutil
from pathlib import Path

import pytest

from exceptiondrive_records import migrations

_ONE_MORE = '''"""What a later release adds."""

import sqlalchemy as sa
from alembic import op

revision = "{later}"
down_revision = "{newest}"


def upgrade() -> None:
    op.add_column("work", sa.Column("added_later", sa.String()))
    op.create_table("made_later", sa.Column("id", sa.Integer(), primary_key=True))
'''


def become_later_release(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let this process be the later release until `monkeypatch.undo()`."""
    later = Path(shutil.copytree(migrations.FOLDER, folder / "later_migrations"))
    newest = migrations.newest_revision()
    number = f"{int(newest) + 1:04}"
    script = later / "versions" / f"{number}_later.py"
    script.write_text(_ONE_MORE.format(newest=newest, later=number))
    monkeypatch.setattr(migrations, "FOLDER", later)
