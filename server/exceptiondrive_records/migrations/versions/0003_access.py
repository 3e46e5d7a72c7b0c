"""Tables of access."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

_TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Make the tables."""
    op.add_column("teams", sa.Column("pending_since", _TIME, nullable=True))
    op.add_column("teams", sa.Column("registration_note", sa.String(), nullable=True))
    op.create_table(
        "page_sessions",
        sa.Column("secret_digest", sa.String(), primary_key=True),
        sa.Column("token_id", sa.String(), sa.ForeignKey("tokens.id"), nullable=False),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("expires_at", _TIME, nullable=False),
    )
    op.create_index("ix_page_sessions_token_id", "page_sessions", ["token_id"])
    op.create_index("ix_page_sessions_expires_at", "page_sessions", ["expires_at"])
    op.create_table(
        "sign_in_attempts",
        sa.Column("key", sa.String(), primary_key=True),
        sa.Column("n", sa.Integer(), nullable=False),
        sa.Column("since", _TIME, nullable=False),
    )
    op.create_index("ix_sign_in_attempts_since", "sign_in_attempts", ["since"])


def downgrade() -> None:
    """Drop the tables."""
    op.drop_table("sign_in_attempts")
    op.drop_table("page_sessions")
    op.drop_column("teams", "registration_note")
    op.drop_column("teams", "pending_since")
