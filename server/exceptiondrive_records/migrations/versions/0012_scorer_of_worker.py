"""Which scorer a worker runs, so that an older one among newer ones is refused."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column."""
    op.add_column("worker_heartbeats", sa.Column("scorer_version", sa.String(), nullable=True))


def downgrade() -> None:
    """Drop it."""
    op.drop_column("worker_heartbeats", "scorer_version")
