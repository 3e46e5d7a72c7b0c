"""Challenges, values and entries in the words that both the command line and the SDK use."""

from exceptiondrive.errors import ServerError
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, Metric, UnknownChallengeError
from exceptiondrive_schemas.protocol import PublicationSection
from exceptiondrive_schemas.submission import SubmissionView

HEADLINE = "macro_family"


def challenge_of(challenge_id: str) -> Challenge:
    """Return the challenge with this id.

    Raises:
        ServerError: It came after this client.
    """
    try:
        return CHALLENGES[challenge_id]
    except UnknownChallengeError as error:
        raise ServerError(
            "unknown_challenge",
            error.sentence,
            "Install the newest client: pip install --upgrade exceptiondrive",
        ) from None


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
        return "-"
    if metric.unit == "fraction":
        return f"{100 * value:.{publication.percent_decimals if publication else 2}f}"
    return f"{value:.{publication.metre_decimals if publication else 2}f}"


def entry_words(view: SubmissionView) -> str:
    """Name an entry of the team with its score and rank: "ID (HCC 55.13, rank 4) of "Method"."""
    facts = []
    if view.sheet is not None:
        key = challenge_of(view.challenge).primary_order[0].metric
        metric = challenge_of(view.challenge).metric(key)
        value = getattr(view.sheet, HEADLINE).get(key)
        facts.append(f"{metric.label} {metric_text(metric, value)}")
    facts += [f"rank {view.rank}"] if view.rank else ["not ranked"]
    return f'{view.id} ({", ".join(facts)}) of "{view.method}"'
