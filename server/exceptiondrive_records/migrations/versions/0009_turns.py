"""Turns of teams, and how long boards take."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

_TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Make the table and add the columns."""
    op.create_table(
        "team_turns",
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), primary_key=True),
        sa.Column("served_at", _TIME, nullable=False),
    )
    op.add_column("board_requests", sa.Column("built_at", _TIME, nullable=True))
    op.add_column("board_requests", sa.Column("build_s", sa.Double(), nullable=True))


def downgrade() -> None:
    """Drop them."""
    op.drop_column("board_requests", "build_s")
    op.drop_column("board_requests", "built_at")
    op.drop_table("team_turns")
