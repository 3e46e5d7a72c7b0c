"""Numbers of entries in the text of a message: with units and ranges, as the board shows them."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.printable import MINUS, one_line
from exceptiondrive_schemas.protocol import PublicationSection
from exceptiondrive_schemas.score_sheet import Interval, MetricRow, metric_text, text_with_unit

if TYPE_CHECKING:
    from exceptiondrive_schemas.api.rescoring import Standing


def ranked_words(
    challenge: Challenge,
    values: Mapping[str, float | None],
    intervals: Mapping[str, Interval | None],
    publication: PublicationSection | None = None,
) -> Iterator[str]:
    """Yield the metrics that rank: `HCC 65.47 % (63.00 to 68.00)`; unknown ones are left out."""
    for key in challenge.primary_order:
        metric, value = challenge.metric(key.metric), values.get(key.metric)
        if value is not None:
            told = text_with_unit(metric, value, publication)
            yield f"{metric.label} {told}{_range_text(metric, intervals.get(key.metric), publication)}"


def standing_words(
    challenge: Challenge | None, standing: "Standing | None", *, before: "Standing | None" = None
) -> str:
    """Describe an entry's standing on a board: rank and its range, then the metrics that rank.

    If that equals the description of `before`, other changed numbers follow. A message of an older
    release names no challenge, and gives the rank only.
    """
    words = _standing_words(challenge, standing)
    if challenge and standing and before and words == _standing_words(challenge, before):
        words += other_changes(challenge, before, standing)
    return ", ".join(words)


def other_changes(
    challenge: Challenge,
    old: "Standing",
    new: "Standing",
    publication: PublicationSection | None = None,
) -> Iterator[str]:
    """Name the other changes of one with equal ranking metrics: `HPR 18.13 % (was 18.24 %)`."""
    is_named = False
    for metric in challenge.metrics:
        if metric.key in old.metrics.keys() & new.metrics.keys():
            was, now = (
                "none" if value is None else text_with_unit(metric, value, publication)
                for value in (old.metrics[metric.key], new.metrics[metric.key])
            )
            if was != now:
                yield f"{metric.label} {now} (was {was})"
                is_named = True
    if not is_named:
        yield "a number that is not shown here changes"


def _standing_words(challenge: Challenge | None, standing: "Standing | None") -> list[str]:
    if standing is None:
        return ["not on the board"]
    words = [one_line(standing.place)]
    if standing.rank_interval is not None and len(set(standing.rank_interval)) > 1:
        low, high = standing.rank_interval
        words = [f"{words[0]} ({low} to {high})"]
    if challenge is not None:
        words += ranked_words(challenge, standing.metrics, standing.intervals)
        if standing.reminder_effect is not None:
            words += effect_words(challenge, standing.reminder_effect.by_metric)
    return words


def effect_words(challenge: Challenge, changes: MetricRow) -> Iterator[str]:
    """Yield the effect of a reminder, shares in points: `by the reminder Accuracy +7.50 points`."""
    for key, value in changes.items():
        if value is not None:
            metric = challenge.metric(key)
            text = f"{'+' if value >= 0 else MINUS}{metric_text(metric, abs(value))}"
            unit = "points" if metric.unit == "fraction" else "m"
            yield f"by the reminder {metric.label} {text} {unit}"


def _range_text(
    metric: Metric, interval: Interval | None, publication: PublicationSection | None
) -> str:
    """Write a range; one in whole per cents, as on withheld splits, gets no decimals."""
    if interval is None:
        return ""
    low, high = interval
    if metric.unit == "fraction" and low == round(low, 2) and high == round(high, 2):
        return f" ({low * 100:.0f} to {high * 100:.0f})"
    ends = [metric_text(metric, end, publication) for end in interval]
    return f" ({' to '.join(ends)})"
