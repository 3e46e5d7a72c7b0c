"""A team's own entries: which of them an upload replaces, and how they are named."""

from collections.abc import Callable, Iterable, Mapping
from datetime import datetime

from exceptiondrive_schemas.api.phase_settings import PhasePolicy
from exceptiondrive_schemas.api.standing_words import effect_words
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.python310 import UTC
from exceptiondrive_schemas.score_sheet import metric_text


def replaced_entry(
    own: Iterable[SubmissionView], method: str | None, policy: PhasePolicy, *, is_open: bool
) -> SubmissionView | None:
    """Return the entry that another upload of a team replaces once it is scored.

    `own` are the team's submissions in the phase. Without `method` the upload is of a new one; it
    is late if the phase is not open.
    """
    if policy.entries_private:
        return None
    shows_one = policy.entries_shown == "chosen"
    standing = (
        each
        for each in own
        if each.status is SubmissionStatus.SCORED
        and each.replaced_by is None
        and each.is_late != is_open
        and (each.method == method or (shows_one and is_open))
        and not each.is_chosen
        and (shows_one or each.run_rule != "best")
    )
    return next(standing, None)


def to_confirm(unranked_because: str | None, replaces: SubmissionView | None) -> Mapping[str, str]:
    """Return sentences about surprising effects, by the argument of `submit` that accepts them."""
    found = {}
    if replaces is not None:
        found["replace"] = f"It replaces {entry_words(replaces)}."
    if unranked_because is not None:
        found["allow_unranked"] = f"It will be scored but not ranked: {unranked_because}."
    return found


def _minute(moment: datetime) -> str:
    return f"{moment.astimezone(UTC):%Y-%m-%d %H:%M} UTC"


def question_of(view: SubmissionView, minute: Callable[[datetime], str] = _minute) -> str:
    """Say what a team is asked before an upload counts, and until when; empty if nothing.

    `minute` formats the date.
    """
    asked = view.report.to_confirm if view.report is not None else ()
    if view.status is not SubmissionStatus.REJECTED or not asked:
        return ""
    if view.confirm_until is None:
        if view.disqualified_at is not None:
            return "It was not confirmed: it counts for nothing."
        return (
            "It was not confirmed in time: it counts for nothing, and its file is not kept. Send it again "
            "while the phase takes files."
        )
    until = f"Confirm it until {minute(view.confirm_until)}, or its file is deleted."
    return " ".join(("Nothing is counted yet.", *asked, until))


def link_words(view: SubmissionView) -> str:
    """Name a submission's link and what the board shows of the two; empty if it has no link."""
    if view.linked_to is None:
        return ""
    told = f"no effect is told: {view.no_effect_because}"
    if view.reminder_effect is not None and view.challenge in CHALLENGES:
        challenge, differences = CHALLENGES[view.challenge], view.reminder_effect.differences
        told = ", ".join(
            f"{words} ({differences[each.metric].verdict})"
            for each in challenge.primary_order
            if each.metric in differences
            for words in effect_words(challenge, {each.metric: differences[each.metric].difference})
        )
    elif view.no_effect_because is None:
        told = "the effect is told while both are entries of the board"
    return f"Without the reminder it is {view.linked_to}; {told}."


def entry_words(view: SubmissionView) -> str:
    """Name an entry of the team with its score and rank: "ID (HCC 55.13, rank 4) of "Method"."""
    facts = []
    if view.sheet is not None and view.challenge in CHALLENGES:
        challenge = CHALLENGES[view.challenge]
        metric = challenge.metric(challenge.primary_order[0].metric)
        value = view.sheet.average(view.headline).get(metric.key)
        facts.append(f"{metric.label} {metric_text(metric, value)}")
    if view.rank is not None or view.unranked_because is not None:
        facts.append(f"rank {view.rank}" if view.rank else "not ranked")
    told = f" ({', '.join(facts)})" if facts else ""
    return f'{view.id}{told} of "{view.method}"'
