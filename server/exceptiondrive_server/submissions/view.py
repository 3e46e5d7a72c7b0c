"""The state of a submission in words: its progress, score, its team's options, the remaining quota."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from markupsafe import Markup, escape

from exceptiondrive_schemas.api.own_entries import link_words, question_of
from exceptiondrive_schemas.api.phase_settings import PhasePolicy, RunRule
from exceptiondrive_schemas.api.submission import (
    QueuePlace,
    Quota,
    SubmissionStatus,
    SubmissionView,
)
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.web.numbers import minute
from exceptiondrive_server.web.templating import template_filter

_MEANING = {
    SubmissionStatus.RECEIVED: "Stored. It cannot be lost any more.",
    SubmissionStatus.QUEUED: "A worker has been called.",
    SubmissionStatus.SCORING: "A worker is scoring it.",
    SubmissionStatus.SCORED: "Every sample has been scored.",
    SubmissionStatus.REJECTED: "The file has faults, all listed below. It cost no quota.",
    SubmissionStatus.FAILED: "We could not score it. It cost no quota, but counts among the day's files without a score; "
    "organizers have been told.",
    SubmissionStatus.WITHDRAWN: "Withdrawn. It stands on no board.",
}
STEPS = (
    SubmissionStatus.RECEIVED,
    SubmissionStatus.QUEUED,
    SubmissionStatus.SCORING,
    SubmissionStatus.SCORED,
)


@dataclass(frozen=True)
class Status:
    """A status with its meaning and, while it waits, its place."""

    word: str
    meaning: str
    place: str | None


@dataclass(frozen=True)
class StatusStep:
    """A step on the way to a score; `state` is done, now, ahead, ended or withdrawn."""

    word: str
    state: str


def status_of(submission: SubmissionView) -> Status:
    """Return the status in words."""
    meaning = _MEANING[submission.status]
    question = question_of(submission, minute)
    if question:
        meaning = f"{question} No quota is spent."
    return Status(
        word="not confirmed" if question else submission.status.value,
        meaning=meaning,
        place=place_words(submission.queue) if submission.queue else None,
    )


def place_words(queue: QueuePlace) -> str:
    """Say how many jobs are ahead and the expected wait; for a running job, what happens if its worker is lost."""
    if queue.workers_alive == 0:
        return f"{_ahead_words(queue.position)}; no worker can score it right now, it starts when one can"
    if queue.lease_until is not None:
        return f"if its worker is lost, another begins again at {queue.lease_until:%H:%M:%S} UTC"
    if queue.expected_wait_s is None:
        return _ahead_words(queue.position)
    return f"{_ahead_words(queue.position)}, {_wait_words(queue.expected_wait_s)}"


def steps_of(submission: SubmissionView) -> tuple[StatusStep, ...]:
    """Return the steps of a submission's progress; one that was not scored ends with its outcome."""
    status = submission.status
    if status in STEPS:
        now = STEPS.index(status)
        states = ["done" if at < now else "ahead" for at in range(len(STEPS))]
        states[now] = "done" if status.is_terminal else "now"
        return tuple(StatusStep(s.value, state) for s, state in zip(STEPS, states, strict=True))
    word = status_of(submission).word
    state = "withdrawn" if word == SubmissionStatus.WITHDRAWN.value else "ended"
    state = "now" if submission.is_asked else state
    return StatusStep(SubmissionStatus.RECEIVED.value, "done"), StatusStep(word, state)


def _ahead_words(position: int) -> str:
    return "next in line" if position == 0 else f"{counted(position, 'submission')} ahead"


def _wait_words(seconds: float) -> str:
    if seconds < 1:
        return "no wait expected"
    if seconds < 90:
        return f"about {math.ceil(seconds)} s to wait"
    return f"about {counted(math.ceil(seconds / 60), 'minute')} to wait"


def policy_sentences(
    seen: SubmissionView, policy: PhasePolicy, *, has_closed: bool
) -> Iterator[str]:
    """Yield how it stands in the policy of its phase; `has_closed`: for this submission."""
    if seen.known_as is not None:
        yield f"On the board the team is {seen.known_as} until the organizers show names there."
    if seen.disqualified_at is not None:
        yield (
            f"It has been disqualified since {minute(seen.disqualified_at)} and is on no later board; "
            "the reason is in the team's notices."
        )
    if seen.is_late:
        yield "It came after the deadline, so it holds no rank and moves none."
    if seen.score_kept_back_since is not None:
        since = minute(seen.score_kept_back_since)
        yield (
            f"It is scored. The board has been frozen since {since}, and scores of later submissions are kept "
            "back: this one is shown here when the organizers reveal the board, for which there is no "
            "date."
        )
    elif seen.status is SubmissionStatus.SCORED and seen.sheet is None:
        yield (
            "Samples that were private count now; scores on them are shown only for entries that were "
            "on the board at the deadline."
        )
    if seen.confirmed_as is not None:
        yield f"Submission {seen.confirmed_as} is in its place: the team confirmed it or sent it again."
    elif seen.status is SubmissionStatus.WITHDRAWN and seen.disqualified_at is None:
        yield (
            "While the phase takes files, this file can be sent again, which costs quota again. An "
            "organizer can restore this submission, but once hidden scores are revealed only if it was "
            "withdrawn after the deadline."
        )
    if seen.replaced_by is not None:
        again = "" if has_closed else "; withdraw that one, and this one counts again"
        yield f"Submission {seen.replaced_by} takes its place{again}."
    if because := seen.no_rank_to_come:
        yield f"The next board is being built; it has no rank there: {because}."
    elif seen.awaits_board:
        yield "The next board is being built; the rank is awaited."
    if seen.unranked_because is not None:
        yield f"It has no rank: {seen.unranked_because}."
    if seen.linked_to is not None:
        yield link_words(seen)
    if seen.is_chosen:
        once = "" if seen.is_published else "once it is public, "
        yield f"The team chose it: {once}it is on the board."
    elif policy.run_choice == "team" and policy.entries_shown == "all":
        yield RUN_RULES[seen.run_rule]
    if not seen.is_published:
        yield "It is private: only the team sees it, and it does not rank."


def actions_of(
    seen: SubmissionView, policy: PhasePolicy, *, has_closed: bool, can_publish: bool
) -> tuple[tuple[str, str], ...]:
    """Return the team's present options for a submission: end of the URL, and label."""
    if seen.is_asked:
        return (("confirm", "Confirm it"),)
    may_stand = seen.status is SubmissionStatus.SCORED and seen.disqualified_at is None
    return tuple(_actions(seen, policy, has_closed, can_publish)) if may_stand else ()


def _actions(
    seen: SubmissionView, policy: PhasePolicy, has_closed: bool, can_publish: bool
) -> Iterator[tuple[str, str]]:
    if not has_closed and not seen.is_late:
        yield from _choices(seen, policy)
    if not can_publish:
        return
    if not seen.is_published and seen.unranked_because is None:
        yield "publish", "Publish it"
    if seen.is_published and (seen.is_late or not has_closed):
        yield "unpublish", "Make it private"


def _choices(seen: SubmissionView, policy: PhasePolicy) -> Iterator[tuple[str, str]]:
    if policy.entries_shown == "chosen":
        if not seen.is_chosen:
            yield "choose", "Choose it for the board"
    elif policy.run_choice == "team":
        if not seen.is_chosen:
            yield "choose", "Let this run count"
        for rule in ("best", "newest"):
            if seen.run_rule != rule:
                yield f"choose?rule={rule}", f"Let the {rule} run count"


RUN_RULES: Mapping[RunRule, str] = {
    "newest": "The newest run of this method counts.",
    "best": "The best run of this method counts, by the samples that counted before the deadline.",
    "this": "The run of this method that the team chose counts.",
}


def standing(seen: SubmissionView, policy: PhasePolicy) -> str:
    """Return its status in the policy of its phase in a word or two; empty if there is none."""
    if seen.status is not SubmissionStatus.SCORED:
        return ""
    words = (
        "disqualified" if seen.disqualified_at is not None else "",
        "chosen" if seen.is_chosen else "",
        ("published" if seen.is_published else "private") if policy.entries_private else "",
        "late" if seen.is_late else "",
    )
    return ", ".join(filter(None, words)).capitalize()


@template_filter
def linked(text: str) -> Markup:
    """Write a sentence to a team; the submission that it names is a link."""
    link = r'\1 <a href="/submissions/\2">\2</a>'
    return Markup(
        re.sub(r"\b(Submission|replaces|it is) ([0-9a-z]{16})\b", link, str(escape(text)))
    )


@template_filter
def left_words(quota: Quota) -> str:
    """Say what is left: `3 of 5 left today, 12 of 20 in all; up to 20 faulty files more today`.

    Where fewer are left in all than of the day, the day is not named.
    """
    words = quota.left_words(" left")
    if quota.total is not None and not quota.is_bound_in_all:
        words += f", {quota.left_in_all} of {quota.total} in all"
    left = quota.left_of_rejected
    if left == 0:
        n_files = quota.rejected_today
        return f"{words}; {n_files} files brought no score, which is the daily limit"
    return f"{words}; up to {left} faulty {'file' if left == 1 else 'files'} more today"
