"""The best entries of a board against each other, sample by sample.

Sample scores are withheld: they are compared here, and only rounded differences leave. A comparison
is kept under the hash of what made it, so a new entry on the board repeats none.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

from pydantic import ValidationError

from exceptiondrive_records.boards import EntryRecord
from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.board import BoardEntry, PairedComparison, PairedDifference
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_scoring.compare import Comparison, Difference, compare
from exceptiondrive_worker.private_store import PrivateStore, Shelf, content_key
from exceptiondrive_worker.rounding import Rounding
from exceptiondrive_worker.stages import Stages, Target

Standing = tuple[Target, EntryRecord]


def comparisons(
    private: PrivateStore,
    stages: Stages,
    standings: Sequence[Standing],
    entries: Sequence[BoardEntry],
    protocol: Protocol,
) -> tuple[PairedComparison, ...]:
    """Compare each of the best ranked entries with each, the better ranked first; rounded.

    Args:
        private: Keeps exact comparisons.
        stages: Gives the sample scores of the pairs that are not kept.
        standings: Target and record of every scored entry.
        entries: Rows of the board, ranked ones first and in order.
        protocol: Says how many entries are compared.
    """
    by_id = {record.submission_id: (target, record) for target, record in standings}
    ranked = [row.submission_id for row in entries if row.rank is not None and row.submission_id]
    best = [by_id[name] for name in ranked[: protocol.publication.compared_entries]]
    return tuple(
        published_comparison(
            _kept_or_made(private, stages, a, b), a[0].challenge, protocol, a[1].sheet
        )
        for a, b in combinations(best, 2)
    )


def exact_comparison(
    found: Comparison, a: EntryRecord, b: EntryRecord, first_metric: str
) -> PairedComparison:
    """Put a comparison in the words of a board; nothing is rounded."""
    words = {"A": a.method, "B": b.method}
    return PairedComparison(
        a=a.submission_id,
        b=b.submission_id,
        overall={key: _difference(each, words) for key, each in found.overall.items()},
        families={
            family: _difference(metrics[first_metric], words)
            for family, metrics in found.families.items()
        },
    )


def published_comparison(
    exact: PairedComparison, challenge: Challenge, protocol: Protocol, sheet: ScoreSheet
) -> PairedComparison:
    """Round a comparison, metrics in column order; only this may leave the worker.

    Families with fewer samples than the protocol publishes are left out.
    """
    rounding, first = Rounding(challenge, protocol.publication), challenge.metrics[0].key
    least = protocol.publication.min_samples_per_cell
    sizes = {family: row.n or 0 for family, row in sheet.families.items()}
    return exact.model_copy(
        update={
            "overall": {
                key: _rounded(exact.overall[key], key, rounding) for key in challenge.metric_keys
            },
            "families": {
                family.id: _rounded(exact.families[family.id], first, rounding)
                for family in protocol.families
                if family.id in exact.families and sizes.get(family.id, 0) >= least
            },
        }
    )


def _kept_or_made(
    private: PrivateStore, stages: Stages, a: Standing, b: Standing
) -> PairedComparison:
    target = a[0]
    key = content_key(
        "comparison",
        *(stages.sums_key(each, record.measurement_key) for each, record in (a, b)),
        target.protocol.ranking_digest,
        target.protocol.grading.headline,
        *(text for _, record in (a, b) for text in (record.submission_id, record.method)),
    )
    kept = _kept(private, key)
    if kept is not None:
        return kept
    of_a, of_b = (stages.sample_scores(each, record.measurement_key) for each, record in (a, b))
    found = compare(of_a, of_b, target.split.arrays, target.protocol, target.challenge)
    made = exact_comparison(found, a[1], b[1], target.challenge.metrics[0].key)
    private.write(Shelf.COMPARISONS, key, canonical_json(made))
    return made


def _kept(private: PrivateStore, key: str) -> PairedComparison | None:
    data = private.read(Shelf.COMPARISONS, key)
    if data is None:
        return None
    try:
        return PairedComparison.model_validate_json(data)
    except ValidationError:
        return None  # written by another version


def _difference(found: Difference, words: Mapping[str, str]) -> PairedDifference:
    """The verdict with the names of the methods in place of A and B."""
    who, _, what = found.verdict.partition(" is ")
    verdict = f"{words[who]} is {what}" if what and who in words else found.verdict
    return PairedDifference(
        difference=found.difference,
        interval=found.interval,
        discordant=found.discordant,
        verdict=verdict,
    )


def _rounded(exact: PairedDifference, key: str, rounding: Rounding) -> PairedDifference:
    return exact.model_copy(
        update={
            "difference": rounding.metric(key, exact.difference),
            "interval": rounding.interval(key, exact.interval),
            "discordant": rounding.fraction(exact.discordant),
        }
    )
