"""The protections of protocol updates (docs/rescoring.md, "What proves it")."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tests.protections.protection import Protection, always, nothing


def _any_content(_: Any) -> Callable[..., Any]:
    from exceptiondrive_schemas.protocol import parse_protocol

    return lambda session, toml: parse_protocol(toml)


def _believed_text(_: Any) -> Callable[..., Any]:
    from exceptiondrive_records.protocols.protocols import find_protocol_row
    from exceptiondrive_schemas.protocol import parse_protocol

    return lambda session, version: parse_protocol(find_protocol_row(session, version).toml)


def _asks_though_a_job_waits(_: Any) -> Callable[..., Any]:
    from sqlalchemy import not_

    from exceptiondrive_records.rescoring import progress

    return lambda phase_id, key, limit: progress._scored_submissions(phase_id).where(
        not_(progress._has_sheet(key))
    )


def _asks_though_a_sheet_is_there(_: Any) -> Callable[..., Any]:
    from sqlalchemy import not_

    from exceptiondrive_records.rescoring import progress

    return lambda phase_id, key, limit: progress._scored_submissions(phase_id).where(
        not_(progress._jobs_of(key).exists())
    )


def _always_live(new_job: Any) -> Callable[..., Any]:
    from exceptiondrive_schemas.jobs import Lane

    return lambda submission, protocol, split, lane, *more, **named: new_job(
        submission, protocol, split, Lane.LIVE, *more, **named
    )


def _new_side_alone(_: Any) -> Callable[..., Any]:
    from exceptiondrive_records.phases.scoring_keys import new_key

    return lambda run: (new_key(run),)


def _any_board(_: Any) -> Callable[..., Any]:
    from exceptiondrive_records.boards.boards import latest_board

    return latest_board


def _always_newer(_: Any) -> Callable[..., Any]:
    from exceptiondrive_records.phases.scoring_keys import new_key

    return new_key


def _kept_by_halves(_: Any) -> Callable[..., Any]:
    """What a transaction did before it broke off stays."""
    from exceptiondrive_records.db.database import _end_transaction

    @contextmanager
    def write(database: Any) -> Iterator[Any]:
        with database._writes() as session:
            try:
                yield session
            finally:
                session.flush()
                _end_transaction(session)
                session.commit()

    return write


def _compared_each_time(_: Any) -> Callable[..., Any]:
    from exceptiondrive_records.rescoring.comparison import _compare_rows

    return _compare_rows


def _every_revision(_: Any) -> Callable[..., Any]:
    from exceptiondrive_records.splits.splits import list_splits

    return lambda session, name: [row for row in list_splits(session) if row.name == name]


def _was_always_shown(_: Any) -> Callable[..., Any]:
    from sqlalchemy import true

    return true


def _everyone(_: Any) -> Callable[..., Any]:
    return lambda comparison: list(comparison.entries)


def _hash_of_the_number(_: Any) -> Callable[..., Any]:
    import hashlib

    return lambda line: hashlib.sha256(str(line.id).encode()).hexdigest()


def _longest_due(_: Any) -> Callable[..., Any]:
    from sqlalchemy import select

    from exceptiondrive_records.db.clock import database_now
    from exceptiondrive_records.notifications.tables import Delivery
    from exceptiondrive_records.work.lease import is_claimable

    return lambda session: (
        select(Delivery.id)
        .where(is_claimable(Delivery, database_now(session)))
        .order_by(Delivery.available_at)
    )


def _over_the_kept_store(stages_over: Any) -> Callable[..., Any]:
    from exceptiondrive_worker.splits.private_store import PrivateStore

    return lambda files, private: stages_over(files, PrivateStore(private.root.parent))


def _equal(_: Any) -> Callable[..., Any]:
    return lambda *arguments: None


RECORDS, RUNS = "exceptiondrive_records", "exceptiondrive_records.rescoring"
HERE = "tests/rescoring"
BLOCKED = f"{HERE}/test_runs.py::test_apply_is_refused_while_a_sheet_is_failed_or_missing"
STALE = f"{HERE}/test_runs.py::test_a_preview_is_stale_once_a_submission_has_come"
CHAIN = "tests/records/test_audit.py::test_whoever_changes_a_line_breaks_the_chain"
RESCORING = (
    Protection(
        "version-taken",
        f"{RECORDS}.protocols.protocols:checked_protocol",
        _any_content,
        "tests/server/test_organizer.py::test_a_protocol_is_added_once",
    ),
    Protection(
        "protocol-edited",
        f"{RECORDS}.protocols.protocols:find_protocol",
        _believed_text,
        "tests/records/test_catalogue.py::test_a_protocol_that_was_edited_in_place_is_refused",
    ),
    Protection(
        "readable",
        f"{RUNS}.changes:require_readable",
        nothing,
        f"{HERE}/test_drafts.py::test_what_accepted_files_cannot_be_scored_under_is_refused",
    ),
    Protection("one-job", f"{RUNS}.progress:scored_left_out", _asks_though_a_job_waits, BLOCKED),
    Protection(
        "one-sheet",
        f"{RUNS}.progress:scored_left_out",
        _asks_though_a_sheet_is_there,
        f"{HERE}/test_flip.py::test_a_sheet_whose_job_is_gone_is_not_made_again",
    ),
    Protection(
        "lane",
        f"{RECORDS}.work.jobs:new_job",
        _always_live,
        f"{HERE}/test_flip.py::test_the_jobs_of_a_run_wait_in_the_lane_behind_the_live_one",
    ),
    Protection(
        "pause",
        f"{RUNS}.fan_out:hold_jobs",
        nothing,
        f"{HERE}/test_runs.py::test_a_paused_run_scores_nothing_until_it_is_resumed",
    ),
    Protection("stale-preview", f"{RUNS}.flip:_require_seen", nothing, STALE),
    Protection("fresh-draft", f"{RUNS}.progress:fresh_board", _any_board, STALE),
    Protection("missing-sheets", f"{RUNS}.flip:blockers_of", always(()), BLOCKED),
    Protection(
        "one-transaction",
        f"{RECORDS}.db.database:Database.write",
        _kept_by_halves,
        f"{HERE}/test_flip.py::test_a_flip_that_breaks_off_at_its_last_step_changes_nothing",
    ),
    Protection(
        "compared-before",
        f"{RUNS}.flip:work_out",
        nothing,
        f"{HERE}/test_flip.py::test_boards_are_compared_before_the_transaction_and_not_in_it",
    ),
    Protection(
        "compared-once",
        f"{RUNS}.comparison:compare_rows",
        _compared_each_time,
        f"{HERE}/test_flip.py::test_boards_are_compared_before_the_transaction_and_not_in_it",
    ),
    Protection(
        "rollback-side",
        f"{RECORDS}.phases.scoring_keys:shadow_key",
        _always_newer,
        f"{HERE}/test_runs.py::"
        "test_apply_shows_the_previewed_board_and_rollback_the_exact_earlier_bytes",
    ),
    Protection(
        "rollback-freeze",
        f"{RUNS}.reveal:_against_update",
        always(()),
        f"{HERE}/test_drafts.py::test_a_frozen_board_is_neither_applied_nor_rolled_back",
    ),
    Protection(
        "draft-address",
        f"{RECORDS}.boards.boards:was_shown",
        _was_always_shown,
        f"{HERE}/test_runs.py::"
        "test_every_board_that_was_public_keeps_its_address_and_drafts_have_none",
    ),
    Protection(
        "draft-split",
        f"{RECORDS}.splits.shown:shown_revisions",
        _every_revision,
        "tests/server/pages/test_split_page.py::"
        "test_a_revision_that_waits_for_its_run_is_nobodys_business",
    ),
    Protection(
        "both-at-once",
        f"{RECORDS}.submissions.submissions:_score_under_both",
        nothing,
        f"{HERE}/test_flip.py::test_the_jobs_of_a_run_wait_in_the_lane_behind_the_live_one",
    ),
    Protection(
        "both-again",
        f"{RUNS}.fan_out:_both_keys",
        _new_side_alone,
        f"{HERE}/test_flip.py::test_a_lost_job_of_the_earlier_protocol_is_made_again_after_apply",
    ),
    Protection(
        "who-is-told",
        f"{RECORDS}.notifications.inbox:_changed_entries",
        _everyone,
        f"{HERE}/test_runs.py::test_only_teams_whose_published_numbers_change_are_told_old_and_new",
    ),
    Protection(
        "reason",
        f"{RECORDS}.db.identifiers:checked_reason",
        lambda _: lambda reason: reason,
        f"{HERE}/test_runs.py::test_nothing_can_be_drafted_that_changes_nothing_or_gives_no_reason",
    ),
    Protection("chain-content", f"{RECORDS}.audit.log:line_hash", _hash_of_the_number, CHAIN),
    Protection("chain-order", f"{RECORDS}.audit.log:_follows", always(True), CHAIN),
    Protection(
        "verify-equal",
        "exceptiondrive_worker.verify_run:_difference",
        _equal,
        f"{HERE}/test_verification.py::test_a_sheet_that_differs_is_named",
    ),
    Protection(
        "verify-empty-store",
        "exceptiondrive_worker.context:stages_over",
        _over_the_kept_store,
        f"{HERE}/test_verification.py::test_the_private_store_is_not_looked_at",
    ),
    Protection(
        "webhook-signature",
        f"{RECORDS}.notifications.channels:signature",
        always("sha256=0"),
        f"{HERE}/test_notices.py::test_a_webhook_is_signed_over_time_and_body_and_sent_once",
    ),
    Protection(
        "webhook-private",
        f"{RECORDS}.notifications.channels:is_public",
        always(True),
        f"{HERE}/test_notices.py::test_no_webhook_reaches_our_own_network",
    ),
    Protection(
        "slow-webhook",
        f"{RECORDS}.notifications.outbox:_due",
        _longest_due,
        f"{HERE}/test_notices.py::test_a_team_whose_webhook_is_slow_keeps_no_other_team_waiting",
    ),
)
