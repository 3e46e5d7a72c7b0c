"""Create the first tables, by noun, and triggers that keep immutable rows unchanged."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

IMMUTABLE = (
    "audit_lines",
    "boards",
    "board_entries",
    "board_flips",
    "protocols",
    "score_sheets",
    "split_openings",
    "submission_edits",
)
"""Triggers refuse every update of these tables, and deletions except for `_GO_WITH_PHASE` and
`_GO_UNUSED`."""
_GO_WITH_PHASE = ("boards", "board_flips")
"""Rows deleted after the row of their phase, which foreign keys allow only while nothing was
submitted or rescored in it."""
_GO_UNUSED = ("protocols",)
"""Rows that may be deleted while nothing refers to them: foreign keys protect the others."""

NEEDED_BY_KIND_OF_WORK = {
    "score": ("submission_id", "team_id", "protocol_digest", "split_revision", "is_first"),
    "board": ("phase_id", "protocol_digest", "split_revision"),
    "trial": ("run_id",),
    "profile": ("submission_id", "protocol_digest", "split_revision"),
    "recheck": ("run_id", "submission_id", "expected_digest"),
    "lead": ("holder",),
    "delivery": ("notification_id", "contact_id"),
}

TIME = sa.DateTime(timezone=True)
OF_LIVING = sa.text("status NOT IN ('withdrawn', 'failed')")


def goes_with(key: str) -> sa.ForeignKey:
    """Return a foreign key with ON DELETE CASCADE."""
    return sa.ForeignKey(key, ondelete="CASCADE")


def upgrade() -> None:
    """Apply."""
    create_teams()
    create_accounts()
    create_audit()
    create_protocols()
    create_splits()
    create_phases()
    create_submissions()
    create_participation()
    create_news()
    create_boards()
    create_rescoring()
    create_notifications()
    create_operations()
    create_work()
    for table in IMMUTABLE:
        protect(table)


def create_teams() -> None:
    """Teams."""
    op.create_table(
        "teams",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("slug", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("name_skeleton", sa.String(), nullable=False),
        sa.Column("affiliation", sa.String(), nullable=False),
        sa.Column("is_reference", sa.Boolean(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("pending_since", TIME),
        sa.Column("registration_note", sa.String()),
        sa.Column("forgotten_at", TIME),
        sa.Column(
            "merged_into_id",
            sa.Integer(),
            sa.ForeignKey("teams.id", deferrable=True, initially="DEFERRED"),
        ),
        sa.Column("registered_from", sa.String()),
        sa.CheckConstraint("forgotten_at IS NULL OR name LIKE 'Former team ______'", "ck_former"),
        sa.UniqueConstraint("name"),
        sa.UniqueConstraint("name_skeleton"),
        sa.UniqueConstraint("slug"),
    )


def create_accounts() -> None:
    """Tokens of teams and organizers; people, the teams they act for, and signed-in browsers."""
    op.create_table(
        "tokens",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id")),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("scopes", sa.JSON(), nullable=False),
        sa.Column("phases", sa.JSON(), nullable=False),
        sa.Column("secret_digest", sa.String(), nullable=False),
        sa.Column("prefix", sa.String(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("expires_at", TIME),
        sa.Column("revoked_at", TIME),
        sa.Column("last_used_at", TIME),
    )
    op.create_index("ix_tokens_team_id", "tokens", ["team_id"])
    op.create_table(
        "sign_in_attempts",
        sa.Column("key", sa.String(), primary_key=True),
        sa.Column("n", sa.Integer(), nullable=False),
        sa.Column("since", TIME, nullable=False),
    )
    op.create_index("ix_sign_in_attempts_since", "sign_in_attempts", ["since"])
    op.create_table(
        "people",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("issuer", sa.String(), nullable=False),
        sa.Column("subject", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("email", sa.String()),
        sa.Column("organizer_role", sa.String()),
        sa.Column("organizer_phases", sa.JSON(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("signed_in_at", TIME, nullable=False),
        sa.UniqueConstraint("issuer", "subject"),
    )
    op.create_table(
        "memberships",
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), primary_key=True),
        sa.Column("person_id", sa.String(), sa.ForeignKey("people.id"), primary_key=True),
        sa.Column("joined_at", TIME, nullable=False),
    )
    op.create_index("ix_memberships_person_id", "memberships", ["person_id"])
    op.create_table(
        "invitations",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), nullable=False),
        sa.Column("secret_digest", sa.String(), nullable=False),
        sa.Column("invited_by", sa.String(), nullable=False),
        sa.Column("made_by", sa.String(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("expires_at", TIME, nullable=False),
        sa.Column("withdrawn_at", TIME),
        sa.Column("used_at", TIME),
        sa.Column("used_by", sa.String(), sa.ForeignKey("people.id")),
    )
    op.create_index("ix_invitations_team_id", "invitations", ["team_id"])
    op.create_table(
        "sessions",
        sa.Column("secret_digest", sa.String(), primary_key=True),
        sa.Column("token_id", sa.String(), sa.ForeignKey("tokens.id")),
        sa.Column("person_id", sa.String(), sa.ForeignKey("people.id")),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id")),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("expires_at", TIME, nullable=False),
        sa.CheckConstraint("(token_id IS NULL) <> (person_id IS NULL)"),
    )
    op.create_index("ix_sessions_expires_at", "sessions", ["expires_at"])
    op.create_index("ix_sessions_person_id", "sessions", ["person_id"])
    op.create_index("ix_sessions_token_id", "sessions", ["token_id"])


def create_audit() -> None:
    """The audit log."""
    op.create_table(
        "audit_lines",
        sa.Column("id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("at", TIME, nullable=False),
        sa.Column("actor", sa.String(), nullable=False),
        sa.Column("action", sa.String(), nullable=False),
        sa.Column("subject", sa.String(), nullable=False),
        sa.Column("detail", sa.JSON(), nullable=False),
        sa.Column("previous_hash", sa.String(), nullable=False),
        sa.Column("hash", sa.String(), nullable=False),
    )
    op.create_index("ix_audit_lines_subject", "audit_lines", ["subject"])


def create_protocols() -> None:
    """Protocols, and the drawing of an example sample under each."""
    op.create_table(
        "protocols",
        sa.Column("digest", sa.String(), primary_key=True),
        sa.Column("version", sa.String(), nullable=False),
        sa.Column("toml", sa.Text(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.UniqueConstraint("version"),
    )
    op.create_table(
        "protocol_drawings",
        sa.Column("pictured", sa.String(), primary_key=True),
        sa.Column("drawing", sa.Text(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
    )


def create_splits() -> None:
    """The public facts about split revisions, and their confirmations, openings and pictures."""
    op.create_table(
        "splits",
        sa.Column("name", sa.String(), primary_key=True),
        sa.Column("revision", sa.String(), primary_key=True),
        sa.Column("title", sa.String(), nullable=False),
        sa.Column("manifest", sa.Text(), nullable=False),
        sa.Column("family_counts", sa.JSON(), nullable=False),
        sa.Column("n_samples", sa.Integer(), nullable=False),
        sa.Column("public_file_digest", sa.String()),
        sa.Column("registered_at", TIME, nullable=False),
        sa.Column("part", sa.String()),
        sa.Column("public_revision", sa.String()),
        sa.Column("private_revision", sa.String()),
        sa.Column("warnings", sa.Text(), nullable=False),
        sa.Column("changes", sa.Text()),
        sa.Column("datasheet", sa.Text()),
        sa.CheckConstraint(
            "(public_revision IS NULL) = (private_revision IS NULL)", "ck_both_parts"
        ),
    )
    op.create_index(
        "uq_splits_public", "splits", ["name", "revision", "public_file_digest"], unique=True
    )
    op.create_table(
        "split_openings",
        sa.Column("split_name", sa.String(), primary_key=True),
        sa.Column(
            "protocol_digest", sa.String(), sa.ForeignKey("protocols.digest"), primary_key=True
        ),
        sa.Column("opened_at", TIME, nullable=False),
    )
    op.create_table(
        "sample_pictures",
        sa.Column("split_name", sa.String(), primary_key=True),
        sa.Column("split_revision", sa.String(), primary_key=True),
        sa.Column("sample_id", sa.String(), primary_key=True),
        sa.Column("shows", sa.String(), primary_key=True),
        sa.Column("public_file_digest", sa.String(), nullable=False),
        sa.Column("file_digest", sa.String(), nullable=False),
        sa.Column("width_px", sa.Integer(), nullable=False),
        sa.Column("height_px", sa.Integer(), nullable=False),
        sa.Column("licence", sa.String(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.ForeignKeyConstraint(
            ["split_name", "split_revision", "public_file_digest"],
            ["splits.name", "splits.revision", "splits.public_file_digest"],
        ),
    )
    op.create_index("ix_sample_pictures_file", "sample_pictures", ["file_digest"])
    op.create_table(
        "confirmations",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("split_name", sa.String(), nullable=False),
        sa.Column("split_revision", sa.String(), nullable=False),
        sa.Column("protocol_digest", sa.String(), nullable=False),
        sa.Column("confirmation", sa.Text(), nullable=False),
        sa.Column("confirmed_at", TIME, nullable=False),
        sa.Column("withdrawn_at", TIME),
        sa.ForeignKeyConstraint(
            ["split_name", "split_revision"], ["splits.name", "splits.revision"]
        ),
    )
    op.create_index(
        "ix_confirmations_asked",
        "confirmations",
        ["split_name", "split_revision", "protocol_digest"],
    )


def create_phases() -> None:
    """Stages of a challenge."""
    op.create_table(
        "phases",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("challenge", sa.String(), nullable=False),
        sa.Column("title", sa.String(), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("split_name", sa.String(), nullable=False),
        sa.Column("split_revision", sa.String(), nullable=False),
        sa.Column(
            "protocol_digest", sa.String(), sa.ForeignKey("protocols.digest"), nullable=False
        ),
        sa.Column("opens_at", TIME),
        sa.Column("closes_at", TIME),
        sa.Column("quota_per_day", sa.Integer(), nullable=False),
        sa.Column("quota_total", sa.Integer()),
        sa.Column("quota_concurrent", sa.Integer()),
        sa.Column("rejected_per_day", sa.Integer(), nullable=False),
        sa.Column("current_board_id", sa.Integer()),
        sa.Column("shows_reported", sa.Boolean(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("visibility", sa.String(), nullable=False),
        sa.Column("position", sa.Integer()),
        sa.Column("page", sa.Text(), nullable=False),
        sa.Column("policy", sa.Text(), nullable=False),
        sa.Column("unfrozen_at", TIME),
        sa.Column("names_revealed_at", TIME),
        sa.Column("pseudonym_salt", sa.String()),
        sa.Column("late_board_id", sa.Integer()),
        sa.ForeignKeyConstraint(
            ["split_name", "split_revision"], ["splits.name", "splits.revision"]
        ),
    )


def create_submissions() -> None:
    """Uploads, their edits, score sheets and drawings, and their similarities."""
    op.create_table(
        "submissions",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("phase_id", sa.String(), sa.ForeignKey("phases.id"), nullable=False),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), nullable=False),
        sa.Column("method", sa.String(), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("paper_url", sa.String()),
        sa.Column("code_url", sa.String()),
        sa.Column("file_digest", sa.String(), nullable=False),
        sa.Column("size_bytes", sa.Integer(), nullable=False),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("report", sa.Text()),
        sa.Column("failure_code", sa.String()),
        sa.Column("failure_message", sa.String()),
        sa.Column("received_at", TIME, nullable=False),
        sa.Column("status_at", TIME, nullable=False),
        sa.Column("withdrawn_at", TIME),
        sa.Column(
            "linked_to",
            sa.String(),
            sa.ForeignKey("submissions.id", deferrable=True, initially="DEFERRED"),
        ),
        sa.Column("arrived_at", TIME),
        sa.Column("granted_until", TIME),
        sa.Column("chosen_at", TIME),
        sa.Column("chosen_rule", sa.String(), nullable=False),
        sa.Column("idempotency_key", sa.String()),
        sa.Column("asks_first", sa.Boolean(), nullable=False),
        sa.Column("confirm_until", TIME),
        sa.Column("confirmed_as", sa.String()),
        sa.Column("published_at", TIME),
        sa.Column("facts", sa.Text()),
        sa.Column("edited_at", TIME),
    )
    op.create_index(
        "ix_submissions_edited",
        "submissions",
        ["phase_id", "edited_at"],
        sqlite_where=sa.text("edited_at IS NOT NULL"),
        postgresql_where=sa.text("edited_at IS NOT NULL"),
    )
    op.create_table(
        "submission_edits",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("submission_id", sa.String(), sa.ForeignKey("submissions.id"), nullable=False),
        sa.Column("edited_at", TIME, nullable=False),
        sa.Column("actor", sa.String(), nullable=False),
        sa.Column("changes", sa.Text(), nullable=False),
    )
    op.create_index("ix_submission_edits_submission_id", "submission_edits", ["submission_id"])
    op.create_index("ix_submissions_team", "submissions", ["team_id", "phase_id", "received_at"])
    op.create_index("ix_submissions_phase", "submissions", ["phase_id", "received_at"])
    op.create_index("ix_submissions_status", "submissions", ["status", "phase_id"])
    op.create_index(
        "uq_submissions_same_bytes",
        "submissions",
        ["phase_id", "team_id", "file_digest"],
        unique=True,
        sqlite_where=OF_LIVING,
        postgresql_where=OF_LIVING,
    )
    op.create_table(
        "score_sheets",
        sa.Column("submission_id", sa.String(), sa.ForeignKey("submissions.id"), primary_key=True),
        sa.Column(
            "protocol_digest", sa.String(), sa.ForeignKey("protocols.digest"), primary_key=True
        ),
        sa.Column("split_revision", sa.String(), primary_key=True),
        sa.Column("sheet", sa.Text(), nullable=False),
        sa.Column("exact_digest", sa.String(), nullable=False),
        sa.Column("measurement_key", sa.String(), nullable=False),
        sa.Column("scorer_version", sa.String(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
    )
    op.create_index(
        "ix_score_sheets_since", "score_sheets", ["split_revision", "created_at", "submission_id"]
    )
    op.create_index(
        "ix_score_sheets_protocol", "score_sheets", ["protocol_digest", "split_revision"]
    )
    op.create_table(
        "entry_drawings",
        sa.Column("submission_id", sa.String(), primary_key=True),
        sa.Column("protocol_digest", sa.String(), primary_key=True),
        sa.Column("split_revision", sa.String(), primary_key=True),
        sa.Column("split_name", sa.String(), nullable=False),
        sa.Column("public_file_digest", sa.String(), nullable=False),
        sa.Column("drawings", sa.Text(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.ForeignKeyConstraint(
            ["submission_id", "protocol_digest", "split_revision"],
            [
                "score_sheets.submission_id",
                "score_sheets.protocol_digest",
                "score_sheets.split_revision",
            ],
        ),
        sa.ForeignKeyConstraint(
            ["split_name", "split_revision", "public_file_digest"],
            ["splits.name", "splits.revision", "splits.public_file_digest"],
        ),
    )
    op.create_table(
        "similarities",
        sa.Column("submission_id", sa.String(), sa.ForeignKey("submissions.id"), primary_key=True),
        sa.Column("alike", sa.Text(), nullable=False),
    )


def create_news() -> None:
    """Announcements of organizers, and questions of teams."""
    op.create_table(
        "news",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("phase_id", sa.String(), goes_with("phases.id"), nullable=False),
        sa.Column("title", sa.String(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("published_at", TIME, nullable=False),
        sa.Column("withdrawn_at", TIME),
    )
    op.create_index("ix_news_phase_id", "news", ["phase_id"])
    op.create_table(
        "questions",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("phase_id", sa.String(), sa.ForeignKey("phases.id"), nullable=False),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("asked_at", TIME, nullable=False),
        sa.Column("answer", sa.Text()),
        sa.Column("answered_at", TIME),
        sa.Column("news_id", sa.String(), sa.ForeignKey("news.id")),
    )
    op.create_index("ix_questions_team_id", "questions", ["team_id"])


def create_participation() -> None:
    """Disqualifications, allowances and accepted terms of teams."""
    op.create_table(
        "disqualifications",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), nullable=False),
        sa.Column("phase_id", sa.String(), sa.ForeignKey("phases.id")),
        sa.Column("submission_id", sa.String(), sa.ForeignKey("submissions.id")),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("public_note", sa.Text()),
        sa.Column("disqualified_at", TIME, nullable=False),
        sa.Column("reinstated_at", TIME),
    )
    op.create_index("ix_disqualifications_team_id", "disqualifications", ["team_id"])
    op.create_table(
        "allowances",
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), primary_key=True),
        sa.Column("phase_id", sa.String(), sa.ForeignKey("phases.id"), primary_key=True),
        sa.Column("closes_at", TIME),
        sa.Column("quota_per_day", sa.Integer()),
        sa.Column("quota_total", sa.Integer()),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("granted_at", TIME, nullable=False),
    )
    op.create_table(
        "terms_acceptances",
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), primary_key=True),
        sa.Column("phase_id", sa.String(), sa.ForeignKey("phases.id"), primary_key=True),
        sa.Column("version", sa.String(), primary_key=True),
        sa.Column("accepted_at", TIME, nullable=False),
        sa.Column("actor", sa.String(), nullable=False),
    )


def create_boards() -> None:
    """Board snapshots with their entries, the history of the current board, and external boards."""
    op.create_table(
        "boards",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("phase_id", sa.String(), goes_with("phases.id"), nullable=False),
        sa.Column(
            "protocol_digest", sa.String(), sa.ForeignKey("protocols.digest"), nullable=False
        ),
        sa.Column("split_revision", sa.String(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("digest", sa.String(), nullable=False),
        sa.Column("body_digest", sa.String(), nullable=False),
        sa.Column("published_at", TIME, nullable=False),
        sa.Column("view", sa.String(), nullable=False),
        sa.Column("leader", sa.Text()),
        sa.Column("body", sa.Text(), nullable=False),
        sa.UniqueConstraint("phase_id", "number"),
    )
    op.create_table(
        "board_entries",
        sa.Column("board_id", sa.Integer(), sa.ForeignKey("boards.id"), primary_key=True),
        sa.Column("submission_id", sa.String(), primary_key=True),
        sa.Column("rank", sa.Integer()),
    )
    op.create_index("ix_board_entries_submission", "board_entries", ["submission_id", "board_id"])
    op.create_table(
        "board_flips",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("phase_id", sa.String(), goes_with("phases.id"), nullable=False),
        sa.Column("board_id", sa.Integer(), goes_with("boards.id"), nullable=False),
        sa.Column("at", TIME, nullable=False),
        sa.Column("news", sa.Text(), nullable=False),
    )
    op.create_index("ix_board_flips_phase", "board_flips", ["phase_id", "at"])
    op.create_index("ix_board_flips_board", "board_flips", ["board_id", "at"])
    op.create_table(
        "reported_boards",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("phase_id", sa.String(), goes_with("phases.id"), nullable=False),
        sa.Column("title", sa.String(), nullable=False),
        sa.Column("cite", sa.String(), nullable=False),
        sa.Column("rows", sa.Text(), nullable=False),
        sa.Column("imported_at", TIME, nullable=False),
        sa.Column("withdrawn_at", TIME),
    )
    op.create_index("ix_reported_boards_phase_id", "reported_boards", ["phase_id"])


def create_rescoring() -> None:
    """Rescoring runs: protocol updates and verifications of score sheets."""
    op.create_table(
        "rescoring_runs",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("kind", sa.String(16), nullable=False),
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
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("state_at", TIME, nullable=False),
        sa.Column("started_at", TIME),
        sa.Column("resumed_at", TIME),
        sa.Column("applied_at", TIME),
        sa.Column("ended_at", TIME),
        sa.Column("ended_with", sa.Text()),
        sa.Column("apply_flip_id", sa.Integer(), sa.ForeignKey("board_flips.id")),
        sa.Column("rollback_flip_id", sa.Integer(), sa.ForeignKey("board_flips.id")),
        sa.Column("comparison", sa.Text()),
    )
    op.create_index("ix_rescoring_runs_phase", "rescoring_runs", ["phase_id", "state"])


def create_notifications() -> None:
    """Inboxes, and external addresses of teams."""
    op.create_table(
        "contact_points",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), nullable=False),
        sa.Column("channel", sa.String(16), nullable=False),
        sa.Column("address", sa.String(), nullable=False),
        sa.Column("secret", sa.String()),
        sa.Column("wishes", sa.String(), nullable=False),
        sa.Column("confirmed_at", TIME),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("removed_at", TIME),
        sa.Column("mailbox_digest", sa.String()),
        sa.Column("unsubscribed_at", TIME),
    )
    op.create_index("ix_contact_points_team_id", "contact_points", ["team_id"])
    op.create_index("ix_contact_points_mailbox_digest", "contact_points", ["mailbox_digest"])
    op.create_table(
        "notifications",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id"), nullable=False),
        sa.Column("run_id", sa.String(), sa.ForeignKey("rescoring_runs.id")),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("subject", sa.String()),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("read_at", TIME),
        sa.UniqueConstraint("team_id", "run_id", "kind"),
        sa.UniqueConstraint("team_id", "kind", "subject"),
    )
    op.create_index("ix_notifications_team", "notifications", ["team_id", "created_at"])


def create_operations() -> None:
    """Running processes, receipt keys, and settings that organizers switch."""
    op.create_table(
        "worker_heartbeats",
        sa.Column("worker_id", sa.String(), primary_key=True),
        sa.Column("at", TIME, nullable=False),
        sa.Column("lives_until", TIME, nullable=False),
        sa.Column("lanes", sa.JSON(), nullable=False),
        sa.Column("scorer_version", sa.String()),
        sa.Column("missing_splits", sa.JSON(), nullable=False),
    )
    op.create_table(
        "receipt_keys",
        sa.Column("key_id", sa.String(), primary_key=True),
        sa.Column("public_key", sa.String(), nullable=False),
        sa.Column("first_used_at", TIME, nullable=False),
    )
    op.create_table(
        "site_settings",
        sa.Column("name", sa.String(), primary_key=True),
        sa.Column("value", sa.JSON(), nullable=False),
        sa.Column("changed_at", TIME, nullable=False),
    )


def create_work() -> None:
    """The work table: a row for each item of any kind, with its lease."""
    op.create_table(
        "work",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("key", sa.String(), nullable=False),
        sa.Column("lane", sa.String(16)),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("asked", sa.Integer(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("fence", sa.Integer(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("available_at", TIME, nullable=False),
        sa.Column("leased_at", TIME),
        sa.Column("lease_until", TIME),
        sa.Column("finished_at", TIME),
        sa.Column("took_s", sa.Double()),
        sa.Column("note", sa.String()),
        sa.Column("submission_id", sa.String(), sa.ForeignKey("submissions.id")),
        sa.Column("team_id", sa.Integer(), sa.ForeignKey("teams.id")),
        sa.Column("phase_id", sa.String(), goes_with("phases.id")),
        sa.Column("protocol_digest", sa.String(), sa.ForeignKey("protocols.digest")),
        sa.Column("split_revision", sa.String()),
        sa.Column("is_first", sa.Boolean()),
        sa.Column("holder", sa.String()),
        sa.Column("run_id", sa.String(), sa.ForeignKey("rescoring_runs.id")),
        sa.Column("expected_digest", sa.String()),
        sa.Column("found_digest", sa.String()),
        sa.Column("trial", sa.Text()),
        sa.Column("notification_id", sa.String(), sa.ForeignKey("notifications.id")),
        sa.Column("contact_id", sa.String(), sa.ForeignKey("contact_points.id")),
        sa.UniqueConstraint("kind", "key"),
        *(
            sa.CheckConstraint(
                f"kind <> '{kind}' OR ({' AND '.join(f'{name} IS NOT NULL' for name in names)})",
                name=f"needed_for_{kind}",
            )
            for kind, names in NEEDED_BY_KIND_OF_WORK.items()
        ),
    )
    op.create_index("ix_work_finished", "work", ["kind", "finished_at"])
    op.create_index("ix_work_queue", "work", ["state", "kind", "lane", "created_at"])
    op.create_index("ix_work_run", "work", ["run_id"])
    op.create_index("ix_work_share", "work", ["team_id", "lane", "leased_at"])
    op.create_index("ix_work_submission", "work", ["submission_id"])
    op.create_index(
        "ix_work_turn",
        "work",
        ["team_id", "lane", "created_at", "id"],
        sqlite_where=sa.text("state IN ('queued', 'leased')"),
        postgresql_where=sa.text("state IN ('queued', 'leased')"),
    )


def protect(table: str) -> None:
    """Make the database refuse updates and deletions of a table."""
    if op.get_bind().dialect.name == "sqlite":
        for act in ("UPDATE",) if table in _GO_UNUSED else ("UPDATE", "DELETE"):
            goes = act == "DELETE" and table in _GO_WITH_PHASE
            op.execute(
                f"CREATE TRIGGER {table}_no_{act.lower()} BEFORE {act} ON {table} "
                f"{'WHEN EXISTS (SELECT 1 FROM phases WHERE id = OLD.phase_id)' if goes else ''} "
                f"BEGIN SELECT RAISE(ABORT, '{table} is append-only'); END"
            )
        return
    op.execute(
        "CREATE OR REPLACE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS "
        "$$ BEGIN RAISE EXCEPTION '% is append-only', TG_TABLE_NAME; END $$"
    )
    if table in _GO_WITH_PHASE:
        op.execute(
            "CREATE OR REPLACE FUNCTION phase_is_there(phase varchar) RETURNS boolean LANGUAGE sql "
            "AS $$ SELECT EXISTS (SELECT 1 FROM phases WHERE id = phase) $$"
        )
        op.execute(
            f"CREATE TRIGGER {table}_go_with_phase BEFORE DELETE ON {table} "
            "FOR EACH ROW WHEN (phase_is_there(OLD.phase_id)) EXECUTE FUNCTION refuse_change()"
        )
    may_go = table in (*_GO_WITH_PHASE, *_GO_UNUSED)
    op.execute(
        f"CREATE TRIGGER {table}_append_only "
        f"BEFORE UPDATE OR {'' if may_go else 'DELETE OR '}TRUNCATE ON {table} "
        "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
    )
