"""Metric values as text, rounded as the board is: per cent for fractions, metres for shifts."""

from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, ChallengeId, Metric
from exceptiondrive_schemas.protocol import PublicationSection

UNDEFINED = "-"


def challenge_of(challenge_id: str) -> Challenge:
    """Return the challenge with this id."""
    return CHALLENGES[ChallengeId(challenge_id)]


def metric_head(metric: Metric) -> str:
    """Column head: label, unit, and which way is better."""
    arrow = {"higher": " ^", "lower": " v", None: ""}[metric.better]
    unit = "%" if metric.unit == "fraction" else "m"
    return f"{metric.label} {unit}{arrow}"


def metric_text(
    metric: Metric, value: float | None, publication: PublicationSection | None = None
) -> str:
    """Return a value as the board shows it.

    Args:
        metric: Which metric.
        value: Fraction or metres; None where undefined.
        publication: Digits; two where not given.
    """
    if value is None:
        return UNDEFINED
    if metric.unit == "fraction":
        return f"{100 * value:.{publication.percent_decimals if publication else 2}f}"
    return f"{value:.{publication.metre_decimals if publication else 2}f}"
