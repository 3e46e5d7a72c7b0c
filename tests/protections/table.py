"""Each protection that can be taken away by one replacement, and the test that has to fail then.

Those of protocol updates stand in `rescoring.py`. Replacements come before the modules that import
the name, so they reach `from ... import` too.
"""

from collections.abc import Callable
from typing import Any

from tests.protections.protection import Protection
from tests.protections.protection import always as _always
from tests.protections.protection import nothing as _nothing
from tests.protections.protection import same as _same
from tests.protections.rescoring import RESCORING

from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus


def _every_scope(principal_of: Any) -> Callable[..., Any]:
    from dataclasses import replace

    from exceptiondrive_records.accounts.tokens import Scope

    return lambda *arguments: replace(principal_of(*arguments), scopes=frozenset(Scope))


def _each_follower_looks(_: Any) -> Callable[..., Any]:
    from fastapi.concurrency import run_in_threadpool

    return lambda looks, followed, look: run_in_threadpool(look)


def _unkeyed(_: Any) -> property:
    from exceptiondrive_schemas.base import content_digest

    return property(lambda scored: content_digest(scored.sheet))


def _any_team(find: Any) -> Callable[..., Any]:
    return lambda session, submission_id, *, team_id=None, lock=False: find(
        session, submission_id, lock=lock
    )


def _unlocked(_: Any) -> Callable[..., Any]:
    from exceptiondrive_records.teams.tables import Team

    return lambda session, team_id: session.get_one(Team, team_id)


def _any_number_of_places(_: Any) -> Callable[..., Any]:
    from contextlib import nullcontext

    return lambda places, team_id: nullcontext()


def _any_number_a_day(_: Any) -> Callable[..., int]:
    """It is counted twice: before anything is scored, and when it is recorded."""
    from exceptiondrive_records.submissions import sheets

    setattr(sheets, "require_room_last", _nothing(None))  # noqa: B010 - it is a replacement
    return lambda *arguments, **keywords: 0


def _unescaped(environment: Any) -> Callable[..., Any]:
    return lambda **keywords: environment(**{**keywords, "autoescape": False})


def _as_of_a_public_split(finding: Any) -> Callable[..., Any]:
    return lambda fault, is_public: finding(fault, is_public=True)


def _plain_text(_: Any) -> Callable[[str], str]:
    return lambda text: text


def _key_for_ever(open_: Any) -> Callable[..., Any]:
    return lambda doors, key: open_(doors, doors.new_key())


def _held_by_nobody(claim: Any) -> Callable[..., Any]:
    return lambda leases, queue, holder, count, offered: claim(
        leases, queue, holder, count, lambda held: offered({})
    )


def _one_in_a_hundred(_: Any) -> Callable[..., Any]:
    return lambda rule, found, slack=0.0: found.equal_share >= 0.99 - slack


def _as_sent(_: Any) -> Any:
    return property(lambda found: found.equal_share)


def _open_to_all(_: Any) -> Callable[..., Any]:
    return lambda request, proceed: proceed(request)


SERVER, RECORDS = "exceptiondrive_server", "exceptiondrive_records"
REVIEW, DESK = "exceptiondrive_build.review_page", "tests/build/test_review_desk.py::test_"
INJECTION = "tests/server/test_injection.py::test_"
PROTECTIONS = (
    Protection(
        "rounding",
        "exceptiondrive_worker.boards.rounding:_rounded",
        _same,
        "tests/leak/test_over_http.py::test_the_api_publishes_what_the_oracle_says_and_not_a_digit_more",
    ),
    Protection(
        "wrong-at-once",
        "exceptiondrive_records.phases.quotas:require_room_if_all_are_wrong",
        _nothing,
        "tests/records/test_quotas.py::test_wrong_files_sent_all_at_once_stay_within_their_cap",
    ),
    Protection(
        "places-of-network",
        "exceptiondrive_records.teams.teams:_network_digest",
        _always(None),
        "tests/server/test_registrations.py::"
        "test_one_network_takes_few_places_and_a_place_lasts_three_days",
    ),
    Protection(
        "split-floors",
        "exceptiondrive_worker.splits.floors:breaches",
        _always(()),
        "tests/worker/test_split_floors.py::test_the_same_protocol_reads_nothing_where_the_advised_floors_hold",
    ),
    Protection(
        "split-protocols",
        "exceptiondrive_worker.splits.floors_held:count_opening",
        _nothing,
        "tests/worker/test_split_floors.py::test_two_protocols_at_once_take_no_more_than_is_left",
    ),
    Protection(
        "trial-counts",
        "exceptiondrive_worker.trial_run:_finding",
        _as_of_a_public_split,
        "tests/phases/test_trials.py::test_samples_of_a_withheld_split_are_never_counted_out",
    ),
    Protection(
        "forgotten-alias",
        f"{RECORDS}.phases.policy:is_pseudonym",
        _always(False),
        "tests/server/test_participation.py::test_a_forgotten_team_keeps_its_pseudonyms_on_anonymous_boards",
    ),
    Protection(
        "names-of-unnamed",
        f"{RECORDS}.db.identifiers:checked_team",
        lambda _: lambda slug, name: name,
        "tests/records/test_names.py::test_no_team_calls_itself_like_one_that_is_not_named",
    ),
    Protection(
        "held-in-the-air",
        f"{RECORDS}.phases.policy:has_revealed",
        _always(False),
        "tests/phases/test_parts.py::test_an_upload_in_the_air_answers_nothing_that_was_revealed",
    ),
    Protection(
        "best-of-hidden",
        f"{RECORDS}.boards.standings:score_kept_back_since",
        _always(None),
        "tests/phases/test_showing.py::"
        "test_the_best_of_a_method_is_not_said_of_scores_that_are_kept_back",
    ),
    Protection(
        "own-deadline-ends",
        f"{RECORDS}.phases.allowances:end_own_deadlines",
        _nothing,
        "tests/phases/test_parts.py::test_a_later_deadline_of_a_team_ends_with_the_reveal",
    ),
    Protection(
        "late-after-reveal",
        f"{RECORDS}.submissions.submissions:is_revealed",
        _always(False),
        "tests/phases/test_parts.py::"
        "test_what_comes_within_a_later_deadline_that_a_reveal_ended_is_late",
    ),
    Protection(
        "taken-back",
        f"{RECORDS}.boards.boards:is_one_taken_back",
        _always(False),
        "tests/records/test_boards.py::"
        "test_readers_see_no_entry_that_was_taken_back_while_the_board_was_built",
    ),
    Protection(
        "order-of-phases",
        f"{SERVER}.web.organizer_rights:require_order_right",
        _nothing,
        "tests/access/test_roles.py::"
        "test_a_role_for_one_phase_moves_no_other_and_writes_to_no_team_of_another",
    ),
    Protection(
        "sheet-digest",
        "exceptiondrive_worker.stages:Scored.digest",
        _unkeyed,
        "tests/worker/test_stages.py::test_the_digest_tells_nothing_to_who_knows_the_sheet_but_not_the_regions",
    ),
    Protection(
        "second-organizer",
        "exceptiondrive_worker.splits.floors:unconfirmed",
        _always(()),
        "tests/worker/test_second_organizer.py::test_nothing_is_scored_until_two_organizers_have_signed",
    ),
    Protection(
        "confirmation-signature",
        f"{RECORDS}.splits.confirmations:is_signed",
        _always(True),
        "tests/worker/test_second_organizer.py::test_rows_that_a_taken_over_server_writes_confirm_nothing",
    ),
    Protection(
        "split-day",
        "exceptiondrive_records.submissions.sheets:scored_within_a_day",
        _any_number_a_day,
        "tests/worker/test_split_floors.py::test_only_so_many_submissions_a_day_are_scored_over_all_phases_and_teams",
    ),
    Protection(
        "split-day-at-once",
        "exceptiondrive_records.submissions.sheets:require_room_last",
        _nothing,
        "tests/worker/test_split_floors.py::test_two_submissions_at_once_take_no_more_than_is_left_of_a_day",
    ),
    Protection(
        "outcome-cells",
        "exceptiondrive_schemas.protocol:PublicationSection.shows_outcome_cells",
        _always(True),
        "tests/leak/test_audit.py::test_outcome_cells_would_tell_two_flips_a_cell_and_are_off",
    ),
    Protection(
        "clearance-curve",
        "exceptiondrive_schemas.protocol:PublicationSection.shows_curve",
        _always(True),
        "tests/leak/test_audit.py::test_a_clearance_curve_would_tell_more_than_the_totals_do",
    ),
    Protection(
        "unranked-flags",
        "exceptiondrive_schemas.coverage:unranked_flags",
        _always(()),
        "tests/rescoring/test_to_1_1.py::test_a_parked_car_leaves_rank_1_by_a_run_that_says_so",
    ),
    Protection(
        "scope",
        f"{RECORDS}.accounts.tokens:_principal",
        _every_scope,
        "tests/server/test_access.py::test_a_participant_who_calls_every_organizer_route_is_told_403",
        is_short=True,
    ),
    Protection(
        "answers-to-senders",
        f"{SERVER}.submissions.upload:told_to",
        lambda _: lambda principal, seen: seen,
        "tests/server/test_submissions.py::test_a_token_that_may_only_submit_is_told_neither_scores_nor_ranks",
    ),
    Protection(
        "no-is-kept",
        f"{RECORDS}.notifications.contacts:_require_may_be_asked",
        _nothing(None),
        "tests/server/test_notices.py::test_an_address_that_said_no_is_asked_by_no_team_again",
    ),
    Protection(
        "roles",
        f"{SERVER}.web.organizer_rights:require_right",
        _nothing,
        "tests/access/test_roles.py::test_no_route_of_the_organizers_lacks_the_guard",
    ),
    Protection(
        "csrf-token",
        f"{SERVER}.web.browser_session:require_form_token",
        _nothing,
        "tests/server/test_sign_in.py::test_no_form_of_a_session_is_taken_from_elsewhere",
    ),
    Protection(
        "csrf-origin",
        f"{SERVER}.web.browser_session:require_same_origin",
        _nothing,
        "tests/server/test_sign_in.py::test_a_form_from_elsewhere_is_refused",
    ),
    Protection(
        "throttling",
        f"{RECORDS}.accounts.attempts:count_attempt",
        _nothing,
        "tests/server/test_sign_in.py::test_guessing_is_slowed_down_with_a_time_to_wait",
    ),
    Protection(
        "revocation",
        f"{RECORDS}.accounts.tokens:is_live",
        _always(True),
        "tests/server/test_tokens.py::test_a_revoked_token_is_dead_at_once",
    ),
    Protection(
        "token-digest",
        f"{RECORDS}.accounts.tokens:secret_digest",
        _plain_text,
        "tests/records/test_tokens.py::test_no_table_holds_the_secret_of_a_token",
    ),
    Protection(
        "team-404",
        f"{RECORDS}.submissions.submissions:find_submission",
        _any_team,
        "tests/server/test_submissions.py::test_another_teams_submission_is_404_in_the_words_for_an_unknown_one",
    ),
    Protection(
        "quota",
        f"{RECORDS}.phases.quotas:require_quota",
        _nothing,
        "tests/records/test_quotas.py::test_the_refusal_says_when_the_quota_begins_anew",
    ),
    Protection(
        "quota-of-retries",
        f"{RECORDS}.rescoring.retry:_require_place",
        _nothing(None),
        "tests/records/test_quotas.py::test_what_failed_is_tried_again_only_within_the_quota",
    ),
    Protection(
        "quota-lock",
        f"{RECORDS}.submissions.submissions:hold_team",
        _unlocked,
        "tests/records/test_quotas.py::test_a_quota_admits_exactly_its_number_under_parallel_threads",
    ),
    Protection(
        "upload-places",
        f"{SERVER}.web.limits.upload_places:UploadPlaces.held_by",
        _any_number_of_places,
        "tests/server/test_overload.py::test_a_team_has_few_places_and_leaves_the_others_free",
    ),
    Protection(
        "large-objects",
        "exceptiondrive_records.db.roles:_NO_LARGE_OBJECTS",
        lambda _: "SELECT 1",
        "tests/deploy/test_roles.py::test_no_role_makes_large_objects",
    ),
    Protection(
        "upload-places-short",
        f"{SERVER}.web.limits.upload_places:UploadPlaces.taken",
        lambda _: property(lambda places: 0),
        "tests/server/test_overload.py::test_eight_teams_together_leave_places_for_others",
    ),
    Protection(
        "places-of-approved",
        f"{SERVER}.submissions.upload:_require_sender",
        _nothing,
        "tests/server/test_registrations.py::test_an_upload_of_a_team_that_waits_for_approval_is_refused_at_its_head",
    ),
    Protection(
        "polls-of-followers",
        f"{SERVER}.web.polls:Polls.now",
        _each_follower_looks,
        "tests/server/test_events.py::test_however_many_follow_a_submission_it_is_polled_once",
    ),
    Protection(
        "names-as-written",
        "exceptiondrive_records.db.identifiers:_as_latin",
        lambda _: lambda word: word[0],
        "tests/records/test_names.py::test_capitals_of_other_scripts_are_read_as_the_latin_ones",
    ),
    Protection(
        "refused-before-stored",
        f"{SERVER}.submissions.upload:require_acceptable",
        _nothing,
        "tests/server/test_submit.py::test_of_a_refused_upload_no_byte_is_stored",
    ),
    Protection(
        "refused-deleted",
        f"{SERVER}.submissions.upload:remove_orphan",
        _nothing,
        "tests/server/test_submit.py::test_what_is_refused_in_the_transaction_is_deleted_unless_somebody_else_sent_it",
    ),
    Protection(
        "body-limit",
        f"{SERVER}.web.limits.body_limit:_refusal",
        _nothing,
        "tests/server/test_body_limit.py::test_a_large_content_length_is_refused_before_the_body",
    ),
    Protection(
        "work-limit",
        "exceptiondrive_schemas.check.fault_list:MAX_FAULTS",
        lambda _: 10**9,
        "tests/hostile/test_huge_documents.py",
    ),
    Protection(
        "canary",
        "tests.canary.watch:Watch.look",
        _always(False),
        "tests/canary/test_watch.py::test_a_leak_in_a_log_line_is_found",
        is_short=True,
    ),
    Protection(
        "private-part",
        f"{RECORDS}.splits.splits:part_revision",
        _nothing,
        "tests/phases/test_parts.py::test_the_live_board_counts_the_public_part_of_files_that_answer_everything",
    ),
    Protection(
        "private-folder",
        "pathlib:Path.chmod",
        _nothing,
        "tests/worker/test_private_store.py::test_a_folder_that_stood_open_is_closed",
    ),
    Protection(
        "anonymity",
        f"{RECORDS}.phases.policy:is_anonymous",
        _always(False),
        "tests/phases/test_showing.py::test_names_stand_nowhere_until_they_are_revealed",
    ),
    Protection(
        "freeze",
        f"{RECORDS}.phases.policy:frozen_since",
        _nothing,
        "tests/phases/test_showing.py::test_a_frozen_board_stays_while_scoring_goes_on",
    ),
    Protection(
        "families-from",
        f"{RECORDS}.phases.policy:families_shown_from",
        _nothing,
        "tests/phases/test_showing.py::test_families_are_absent_everywhere_until_their_date",
    ),
    Protection(
        "flags",
        "exceptiondrive_scoring.plausibility:_flags_of_shares",
        _always(()),
        "tests/phases/test_gaming.py::test_every_board_of_planners_shows_references_and_flags",
    ),
    Protection(
        "unranked",
        "exceptiondrive_schemas.coverage:unranked_flags",
        _always(()),
        "tests/worker/test_unranked.py::"
        "test_under_1_1_flagged_entries_are_listed_below_in_the_order_that_they_would_have",
    ),
    Protection(
        "similarity",
        "exceptiondrive_scoring.similarity:AlikeRule.is_alike",
        _always(False),
        "tests/worker/test_similarity_run.py::test_equal_files_equal_answers_and_near_ones_are_told_apart",
    ),
    Protection(
        "probing",
        "exceptiondrive_scoring.similarity:AlikeRule.is_probe",
        _always(False),
        "tests/worker/test_similarity_run.py::test_a_team_that_changes_one_sample_30_times_is_found_and_audited",
    ),
    Protection(
        "probing-withdrawn",
        "exceptiondrive_records.submissions.similarity:_HAS_SCORE",
        lambda _: Submission.status == SubmissionStatus.SCORED,
        "tests/worker/test_similarity_run.py::test_probes_that_are_withdrawn_as_soon_as_they_are_scored_are_seen",
    ),
    Protection(
        "board-told-otherwise",
        "exceptiondrive_records.operations.invariants:unlogged_forgetting",
        _always(()),
        "tests/server/test_participation.py::test_verify_finds_a_team_that_nobody_forgot_and_one_that_came_back",
    ),
    Protection(
        "revoked-in-the-air",
        f"{RECORDS}.accounts.sessions:require_unrevoked",
        _nothing,
        "tests/server/test_submit.py::test_a_token_that_is_revoked_while_its_upload_is_in_the_air_brings_nothing_in",
    ),
    Protection(
        "revoked-stream",
        "exceptiondrive_server.submissions.events:require_unrevoked",
        _nothing,
        "tests/server/test_events.py::test_nothing_more_is_told_once_the_token_is_revoked",
    ),
    Protection(
        "invitations-end",
        f"{RECORDS}.accounts.people:withdraw_invitations_of",
        _nothing,
        "tests/access/test_teams_of_people.py::test_no_invitation_that_a_removed_member_made_leads_back_in",
    ),
    Protection(
        "rank-intervals",
        "exceptiondrive_worker.boards.entries:told_rank_intervals",
        lambda _: lambda intervals, order: [(each, each) for each in range(1, len(intervals) + 1)],
        "tests/worker/test_board_run.py::test_of_a_withheld_split_rank_intervals_tell_no_more_than_the_intervals_that_are_told",
    ),
    Protection(
        "unseen-changes",
        "exceptiondrive_records.operations.invariants:unlogged_submissions",
        _always(()),
        "tests/server/test_participation.py::test_verify_finds_entries_that_nobody_withdrew_or_moved",
    ),
    Protection(
        "unseen-reinstated",
        "exceptiondrive_records.operations.invariants:unlogged_disqualifications",
        _always(()),
        "tests/server/test_participation.py::test_verify_finds_what_decides_a_board_and_nobody_did",
    ),
    Protection(
        "unseen-settings",
        "exceptiondrive_records.operations.invariants:unlogged_settings",
        _always(()),
        "tests/server/test_participation.py::test_verify_finds_what_decides_a_board_and_nobody_did",
    ),
    Protection(
        "unseen-history",
        "exceptiondrive_records.operations.invariants:unlogged_flips",
        _always(()),
        "tests/server/test_participation.py::test_verify_finds_what_decides_a_board_and_nobody_did",
    ),
    Protection(
        "restored-after-reveal",
        "exceptiondrive_records.rescoring.retry:has_revealed",
        _always(False),
        "tests/phases/test_parts.py::test_no_run_is_restored_once_scores_were_revealed",
    ),
    Protection(
        "page-places",
        "exceptiondrive_server.web.limits.page_places:PagePlaces",
        lambda _: lambda app: app,
        "tests/server/test_page_places.py::test_an_api_call_and_health_answer_while_more_pages_are_asked_for_than_there_are_threads",
    ),
    Protection(
        "page-places-of-an-address",
        "exceptiondrive_server.web.limits.page_places:WeakValueDictionary",
        lambda _: type("Forgets", (), {"setdefault": lambda self, key, new: new}),
        "tests/server/test_page_places.py::test_who_asks_for_many_pages_waits_behind_none_but_its_own",
    ),
    Protection(
        "reveal-rolled-back",
        "exceptiondrive_records.phases.policy:was_split_revealed",
        _always(False),
        "tests/phases/test_parts.py::test_a_reveal_that_is_rolled_back_stays_known",
    ),
    Protection(
        "probing-share",
        "exceptiondrive_scoring.similarity:AlikeRule.is_probe",
        _one_in_a_hundred,
        "tests/worker/test_similarity_run.py::test_probes_of_many_cells_at_once_are_seen",
    ),
    Protection(
        "scaled-copies",
        "exceptiondrive_scoring.similarity:Alikeness.best_share",
        _as_sent,
        "tests/worker/test_similarity_run.py::test_a_copy_made_a_little_slower_is_seen_across_teams",
    ),
    Protection(
        "receipt-signature",
        "exceptiondrive.receipts:_is_signed",
        _always(True),
        "tests/client/test_receipts.py::test_digests_that_were_altered_too_do_not_fit_the_signature",
    ),
    Protection(
        "receipt-key-ids",
        "exceptiondrive.receipts:_has_true_id",
        _always(True),
        "tests/client/test_receipts.py::test_a_key_under_the_id_of_another_is_refused_wherever_keys_are_read",
    ),
    Protection(
        "receipt-fields",
        "exceptiondrive_schemas.receipt:altered_fields",
        _always(()),
        "tests/client/test_receipts.py::test_a_receipt_holds_and_every_tampered_field_is_named",
    ),
    Protection(
        "names-at-intake",
        f"{RECORDS}.db.identifiers:checked_text",
        lambda _: lambda kind, text, **keywords: text,
        INJECTION + "intake_refuses_what_cannot_be_shown",
    ),
    Protection(
        "links-at-intake",
        f"{RECORDS}.db.identifiers:checked_link",
        lambda _: lambda kind, url, **_options: url,
        INJECTION + "intake_refuses_links_that_are_not_plain_https",
    ),
    Protection(
        "escaping",
        "jinja2:Environment",
        _unescaped,
        INJECTION + "pages_of_readers_are_inert",
    ),
    Protection(
        "links-on-pages",
        f"{SERVER}.web.templating:https_only",
        lambda _: lambda url: url or "",
        INJECTION + "pages_of_readers_are_inert",
    ),
    Protection(
        "steering-on-pages",
        "exceptiondrive_schemas.printable:printable",
        _plain_text,
        INJECTION + "pages_of_readers_are_inert",
    ),
    Protection(
        "formulas",
        "exceptiondrive_schemas.printable:spreadsheet_text",
        _plain_text,
        INJECTION + "files_of_a_board_run_nothing",
    ),
    Protection(
        "latex",
        f"{SERVER}.boards.exports:_TEX",
        lambda _: {},
        INJECTION + "files_of_a_board_run_nothing",
    ),
    Protection(
        "mail-headers",
        "exceptiondrive_schemas.printable:one_line",
        _plain_text,
        INJECTION + "an_email_gets_no_header_and_no_line_from_a_name",
    ),
    Protection(
        "terminal",
        "exceptiondrive_schemas.printable:printable",
        _plain_text,
        "tests/client/test_terminal_safety.py",
        is_short=True,
    ),
    Protection(
        "review-address",
        f"{REVIEW}.doors:Doors.open",
        _key_for_ever,
        "tests/build/test_review_access.py"
        "::test_an_address_works_once_and_the_terminal_is_told_the_next",
    ),
    Protection(
        "review-origin",
        f"{REVIEW}.app:_guard",
        _open_to_all,
        "tests/build/test_review_access.py"
        "::test_a_page_of_another_site_and_another_name_of_this_machine_get_nothing",
    ),
    Protection(
        "review-leases",
        f"{REVIEW}.leases:Leases.claim",
        _held_by_nobody,
        DESK + "no_card_is_given_to_two_and_none_is_left",
    ),
    Protection(
        "review-blind",
        f"{REVIEW}.desk:Desk.is_third",
        _always(value=True),
        DESK + "a_reader_who_differs_is_not_told_and_a_third_decides",
    ),
    *RESCORING,
)
