"""Why an entry is not ranked, in words: shown before an upload, by `evaluate` and on the board."""

from collections.abc import Mapping

from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.printable import share_past
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import ScoreSheet


def unranked_flags(sheet: ScoreSheet, protocol: ProtocolDocument) -> tuple[str, ...]:
    """Return the codes of the flags that keep an entry from ranking, in the protocol's order."""
    raised = {flag.code for flag in sheet.plausibility.flags}
    return tuple(code for code in protocol.ranking.unranked_flags if code in raised)


def unranked_reasons(sheet: ScoreSheet, protocol: ProtocolDocument) -> tuple[str, ...]:
    """Return the flags and the missing answers that keep a sheet from ranking, as sentences."""
    reasons = []
    if codes := unranked_flags(sheet, protocol):
        *first, last = (FLAGS[code].label for code in codes)
        labels = f"{', '.join(first)} and {last}" if first else last
        reasons.append(f"flagged {labels}; protocol {protocol.version} ranks no such entry")
    uncovered = too_little_covered(
        CHALLENGES[sheet.challenge].words.covered,
        sheet.coverage.exact_shares(sheet.n),
        protocol.ranking.min_coverage,
    )
    if uncovered is not None:
        reasons.append(uncovered)
    return tuple(reasons)


def too_little_covered(
    covered: Mapping[str, str], shares: Mapping[str, float], least: float
) -> str | None:
    """Say which answers cover too few of the samples to be ranked; None if there are enough.

    `shares` are the shares of samples with an answer, by its key; `covered` describes each key.
    """
    parts = [
        f"{share_past(share, least, 2)} of the {covered[key]}"
        for key, share in shares.items()
        if share < least
    ]
    return f"{' and '.join(parts)} are answered; a rank needs {100 * least:g}%" if parts else None
