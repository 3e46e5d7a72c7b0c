"""Whether enough answers are given to be ranked, in words: told before an upload and on the board."""

from collections.abc import Mapping

from exceptiondrive_schemas.challenges import Challenge


def too_little_covered(
    challenge: Challenge, shares: Mapping[str, float], least: float
) -> str | None:
    """Say which answers cover too few of the samples to be ranked; None where enough are given.

    Args:
        challenge: Names the answers.
        shares: By key of an answer, the share of the samples that has one.
        least: Share that ranks.
    """
    parts = [
        f"{_below(share, least)} of the {challenge.words.covered[key]}"
        for key, share in shares.items()
        if share < least
    ]
    return f"{' and '.join(parts)} are answered; ranking takes {least:.0%}" if parts else None


def _below(share: float, least: float) -> str:
    """Per cent to as many digits as it takes to see that the share is below the least."""
    for decimals in range(2, 6):
        text = f"{share:.{decimals}%}"
        if float(text[:-1]) < round(100 * least, 9):
            return text
    return f"less than {least:.0%}"
