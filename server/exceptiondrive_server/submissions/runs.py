"""A team's list of submissions: score with interval, change since the previous run, trend, place."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from exceptiondrive_schemas.api.own_entries import question_of
from exceptiondrive_schemas.api.phase_settings import PhasePolicy
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.challenges import CHALLENGES, Metric
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import Interval, MetricRow
from exceptiondrive_server.submissions.view import Status, actions_of, standing, status_of
from exceptiondrive_server.web.numbers import Digits, heading, minute

SPARK_PX = (76, 22)


@dataclass(frozen=True)
class PhaseRules:
    """What of a phase the list needs: its policy, its protocol, whether entries can be published."""

    policy: PhasePolicy
    protocol: ProtocolDocument
    can_publish: bool


@dataclass(frozen=True)
class ScoreCell:
    """One metric that ranks: as published, with its spread as on the board, and the change."""

    label: str
    text: str
    spread: str
    change: str
    is_better: bool | None
    """Whether the change is for the better; None without one."""


@dataclass(frozen=True)
class OwnRun:
    """One submission in the list."""

    one: SubmissionView
    status: Status
    cells: tuple[ScoreCell, ...]
    spark: str
    """Points of the method's runs up to this one, oldest first; empty for fewer than two."""
    trend: str
    """The same in words."""
    note: str
    """Why it has no rank, or what it replaced."""
    standing: str
    actions: tuple[tuple[str, str], ...]


def run_lines(
    seen: Sequence[SubmissionView],
    rules: Mapping[str, PhaseRules],
    *,
    ended: Collection[str] = (),
    can_decide: bool,
) -> tuple[OwnRun, ...]:
    """Return a line for each submission, in the order given: newest first.

    What a phase keeps back is not in them. `ended` are those whose deadline has passed, the team's
    own where it has a later one; `can_decide`: who looks may choose, publish or withdraw.
    """
    lines: list[OwnRun] = []
    runs: dict[tuple[str, str, str], list[SubmissionView]] = {}
    for one in reversed(seen):
        before = runs.setdefault((one.team, one.phase, one.method), [])
        rule = rules[one.phase]
        can_choose = can_decide and one.id not in ended
        lines.append(_line(one, before, rule, can_decide, can_choose))
        if one.sheet is not None:
            before.append(one)
    replaced = [one.replaced_by for one in seen]
    return tuple(_with_replaced(line, replaced.count(line.one.id)) for line in reversed(lines))


def _line(
    one: SubmissionView,
    before: Sequence[SubmissionView],
    rule: PhaseRules,
    can_decide: bool,
    can_choose: bool,
) -> OwnRun:
    digits = Digits.of(rule.protocol.publication)
    challenge = CHALLENGES[one.challenge]
    metrics = [challenge.metric(key.metric) for key in challenge.primary_order]
    values = headline_of(one, rule.protocol)
    last = headline_of(before[-1], rule.protocol) if before else {}
    trail = [headline_of(run, rule.protocol).get(metrics[0].key) for run in [*before, one]]
    known = [value for value in trail if value is not None] if one.sheet else []
    return OwnRun(
        one=one,
        status=status_of(one),
        cells=tuple(
            _cell(metric, values, last, one.intervals.get(metric.key), digits)
            for metric in metrics
            if one.sheet is not None
        ),
        spark=_spark(known),
        trend=f"{metrics[0].label} of the runs so far: "
        + ", ".join(digits.text(metrics[0], value) or "" for value in known),
        note=_note(one),
        standing=standing(one, rule.policy),
        actions=actions_of(
            one, rule.policy, has_closed=not can_choose, can_publish=rule.can_publish
        )
        if can_decide
        else (),
    )


def headline_of(one: SubmissionView, protocol: ProtocolDocument) -> MetricRow:
    """Return the values that rank, as the team may see them; empty without a sheet."""
    return {} if one.sheet is None else one.sheet.average(protocol.grading.headline)


def _cell(
    metric: Metric, values: MetricRow, last: MetricRow, interval: Interval | None, digits: Digits
) -> ScoreCell:
    value, earlier = values.get(metric.key), last.get(metric.key)
    difference = None if value is None or earlier is None else value - earlier
    is_better = None
    if difference:
        is_better = (difference > 0) == (metric.better == "higher")
    return ScoreCell(
        label=heading(metric),
        text=digits.text(metric, value) or "none",
        spread="" if interval is None or value is None else digits.spread(metric, value, interval),
        change=digits.signed(metric, difference),
        is_better=is_better,
    )


def _spark(values: Sequence[float]) -> str:
    if len(values) < 2:
        return ""
    width, height = SPARK_PX
    low, high = min(values), max(values)
    span = (high - low) or 1.0
    step = (width - 6) / (len(values) - 1)
    return " ".join(
        f"{3 + index * step:.1f},{height - 3 - (value - low) / span * (height - 6):.1f}"
        for index, value in enumerate(values)
    )


def _note(one: SubmissionView) -> str:
    """Say why it has no rank."""
    if question := question_of(one, minute):
        return question
    if one.status is SubmissionStatus.REJECTED and one.report is not None:
        return f"The file has {counted(one.report.n_faults, 'fault')}. No quota was spent."
    if one.failure is not None:
        return one.failure.message
    if because := one.no_rank_to_come or one.unranked_because:
        return f"Not ranked: {because}."
    if one.awaits_board:
        return "Rank awaited: the next board is being built."
    if one.score_kept_back_since is not None:
        return "The score is shown when the board is revealed."
    return ""


def _with_replaced(line: OwnRun, n_replaced: int) -> OwnRun:
    if n_replaced == 0 or line.note or line.one.disqualified_at is not None:
        return line
    return replace(line, note=f"Stands in place of {counted(n_replaced, 'other run')}.")
