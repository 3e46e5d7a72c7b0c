"""Rank: entries by the protocol's order; equal entries share a rank, 1, 2, 2, 4."""

from collections.abc import Mapping, Sequence

from exceptiondrive_schemas.challenges import RankKey


def ranks(
    values: Mapping[str, Sequence[float | None]],
    coverage_suffices: Sequence[bool],
    order: Sequence[RankKey],
) -> list[int | None]:
    """Rank entries (docs/protocol.md section 4).

    Args:
        values: Metric key to the value of each of K entries, rounded to the published precision.
        coverage_suffices: Whether each entry answers enough samples to rank.
        order: Keys, the first one decides.

    Returns:
        K ranks; None where a value is undefined or coverage is too low.
    """
    keys = [_sort_key(values, order, index) for index in range(len(coverage_suffices))]
    ranked = sorted(
        key for key, suffices in zip(keys, coverage_suffices, strict=True) if suffices and key
    )
    first: dict[tuple[float, ...], int] = {}
    for position, key in enumerate(ranked, start=1):
        first.setdefault(key, position)
    return [
        first[key] if suffices and key else None
        for key, suffices in zip(keys, coverage_suffices, strict=True)
    ]


def _sort_key(
    values: Mapping[str, Sequence[float | None]], order: Sequence[RankKey], index: int
) -> tuple[float, ...] | None:
    """Smaller is better; None where a value is undefined."""
    parts: list[float] = []
    for key in order:
        value = values[key.metric][index]
        if value is None:
            return None
        parts.append(-value if key.order == "descending" else value)
    return tuple(parts)
