"""Tables of rescoring, and board requests by split revision."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

_TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Make the tables."""
    request_boards_by_revision()
    create_runs()
    create_verifications()
    create_messages()


def downgrade() -> None:
    """Drop the tables."""
    for table in (
        "deliveries",
        "notifications",
        "contact_points",
        "verification_items",
        "verifications",
        "rescoring_runs",
    ):
        op.drop_table(table)


def request_boards_by_revision() -> None:
    """Ask for boards by (phase, protocol, split revision), as sheets are kept."""
    op.create_table(
        "board_requests_by_revision",
        sa.Column("phase_id", sa.String(), sa.ForeignKey("phases.id"), nullable=False),
        sa.Column(
            "protocol_digest", sa.String(), sa.ForeignKey("protocols.digest"), nullable=False
        ),
        sa.Column("split_revision", sa.String(), nullable=False),
        sa.Column("wanted", sa.Integer(), nullable=False),
        sa.Column("built", sa.Integer(), nullable=False),
        sa.Column("fence", sa.Integer(), nullable=False),
        sa.Column("lease_until", _TIME, nullable=True),
        sa.Column("rung_at", _TIME, nullable=True),
        sa.PrimaryKeyConstraint("phase_id", "protocol_digest", "split_revision"),
    )
    op.execute(
        "INSERT INTO board_requests_by_revision SELECT r.phase_id, r.protocol_digest, "
        "p.split_revision, r.wanted, r.built, r.fence, r.lease_until, r.rung_at "
        "FROM board_requests r JOIN phases p ON p.id = r.phase_id"
    )
    op.drop_table("board_requests")
    op.rename_table("board_requests_by_revision", "board_requests")


def create_runs() -> None:
    """Rescoring runs."""
    op.create_table(
        "rescoring_runs",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("phase_id", sa.String(), sa.ForeignKey("phases.id"), nullable=False),
        sa.Column(
            "from_protocol_digest", sa.String(), sa.ForeignKey("protocols.digest"), nullable=False
        ),
        sa.Column("from_split_revision", sa.String(), nullable=False),
        sa.Column(
            "to_protocol_digest", sa.String(), sa.ForeignKey("protocols.digest"), nullable=False
        ),
        sa.Column("to_split_revision", sa.String(), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("actor", sa.String(), nullable=False),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("state_at", _TIME, nullable=False),
        sa.Column("started_at", _TIME, nullable=True),
        sa.Column("resumed_at", _TIME, nullable=True),
        sa.Column("applied_at", _TIME, nullable=True),
        sa.Column("ended_at", _TIME, nullable=True),
        sa.Column("from_board_id", sa.Integer(), sa.ForeignKey("boards.id"), nullable=True),
        sa.Column("to_board_id", sa.Integer(), sa.ForeignKey("boards.id"), nullable=True),
        sa.Column("apply_flip_id", sa.Integer(), sa.ForeignKey("board_flips.id"), nullable=True),
        sa.Column("rollback_flip_id", sa.Integer(), sa.ForeignKey("board_flips.id"), nullable=True),
        sa.Column("comparison", sa.Text(), nullable=True),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_rescoring_runs_phase", "rescoring_runs", ["phase_id", "state"])


def create_verifications() -> None:
    """Recomputations of sheets."""
    op.create_table(
        "verifications",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("phase_id", sa.String(), sa.ForeignKey("phases.id"), nullable=False),
        sa.Column(
            "protocol_digest", sa.String(), sa.ForeignKey("protocols.digest"), nullable=False
        ),
        sa.Column("split_revision", sa.String(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("actor", sa.String(), nullable=False),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("finished_at", _TIME, nullable=True),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_table(
        "verification_items",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column(
            "verification_id", sa.String(), sa.ForeignKey("verifications.id"), nullable=False
        ),
        sa.Column("submission_id", sa.String(), sa.ForeignKey("submissions.id"), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("expected_digest", sa.String(), nullable=False),
        sa.Column("found_digest", sa.String(), nullable=True),
        sa.Column("note", sa.String(), nullable=True),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("fence", sa.Integer(), nullable=False),
        sa.Column("lease_until", _TIME, nullable=True),
        sa.Column("rung_at", _TIME, nullable=True),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("verification_id", "submission_id"),
    )
    op.create_index("ix_verification_items_state", "verification_items", ["state"])


def create_messages() -> None:
    """Inbox, addresses outside, and the outbox."""
    op.create_table(
        "contact_points",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), nullable=False),
        sa.Column("channel", sa.String(16), nullable=False),
        sa.Column("address", sa.String(), nullable=False),
        sa.Column("secret", sa.String(), nullable=True),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("removed_at", _TIME, nullable=True),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_contact_points_team_id", "contact_points", ["team_id"])
    op.create_table(
        "notifications",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), nullable=False),
        sa.Column("run_id", sa.String(), sa.ForeignKey("rescoring_runs.id"), nullable=True),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("read_at", _TIME, nullable=True),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("team_id", "run_id", "kind"),
    )
    op.create_index("ix_notifications_team", "notifications", ["team_id", "created_at"])
    op.create_table(
        "deliveries",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column(
            "notification_id", sa.String(), sa.ForeignKey("notifications.id"), nullable=False
        ),
        sa.Column("contact_id", sa.String(), sa.ForeignKey("contact_points.id"), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("available_at", _TIME, nullable=False),
        sa.Column("last_error", sa.String(), nullable=True),
        sa.Column("sent_at", _TIME, nullable=True),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("notification_id", "contact_id"),
    )
    op.create_index("ix_deliveries_due", "deliveries", ["state", "available_at"])
