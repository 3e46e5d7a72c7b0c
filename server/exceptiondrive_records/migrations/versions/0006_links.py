"""Links between submissions: with and without reminder."""

from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column, in words that both databases take with its foreign key."""
    op.execute("ALTER TABLE submissions ADD COLUMN linked_to VARCHAR REFERENCES submissions (id)")


def downgrade() -> None:
    """Drop the column."""
    op.execute("ALTER TABLE submissions DROP COLUMN linked_to")
