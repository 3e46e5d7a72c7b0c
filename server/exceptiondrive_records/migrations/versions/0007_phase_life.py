"""The life of a phase: parts of a split, late view, freeze, choice, pseudonyms, private entries."""

from typing import Any

import sqlalchemy as sa
from alembic import op

from exceptiondrive_records.columns import UtcDateTime

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def _columns() -> dict[str, tuple[sa.Column[Any], ...]]:
    return {
        "phases": (
            sa.Column("life", sa.Text(), nullable=False, server_default="{}"),
            sa.Column("unfrozen_at", UtcDateTime(), nullable=True),
            sa.Column("names_revealed_at", UtcDateTime(), nullable=True),
            sa.Column("pseudonym_salt", sa.String(), nullable=True),
            sa.Column("late_board_id", sa.Integer(), nullable=True),
        ),
        "splits": (
            sa.Column("part", sa.String(), nullable=True),
            sa.Column("whole_revision", sa.String(), nullable=True),
        ),
        "submissions": (
            sa.Column("arrived_at", UtcDateTime(), nullable=True),
            sa.Column("chosen_at", UtcDateTime(), nullable=True),
            sa.Column("published_at", UtcDateTime(), nullable=True),
        ),
        "boards": (sa.Column("view", sa.String(), nullable=False, server_default="main"),),
    }


def upgrade() -> None:
    """Add the columns; what is there keeps its meaning."""
    for table, columns in _columns().items():
        for column in columns:
            op.add_column(table, column)


def downgrade() -> None:
    """Drop them."""
    for table, columns in _columns().items():
        for column in reversed(columns):
            op.drop_column(table, column.name)
