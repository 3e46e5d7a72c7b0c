"""Intervals of entries, computed once per entry and kept: a new entry costs only its own.

The draws come from the protocol's seed alone, so what was computed for one board serves the next.
"""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.bootstrap import Uncertainty, bootstrap
from exceptiondrive_worker.private_store import PrivateStore, Shelf, content_key
from exceptiondrive_worker.stages import Stages, Target

_FIELDS = fields(Uncertainty)


def entry_uncertainties(
    private: PrivateStore, stages: Stages, entries: Sequence[tuple[Target, str]]
) -> list[Uncertainty]:
    """Return the intervals of every entry, in order.

    Args:
        private: Keeps intervals.
        stages: Gives the scene sums of the entries whose intervals are not kept.
        entries: Of one board: target, and key of its measurements.
    """
    keys = [_key(stages, target, measurement_key) for target, measurement_key in entries]
    kept = {key: _kept(private, key) for key in keys}
    found = {key: uncertainty for key, uncertainty in kept.items() if uncertainty is not None}
    missing = {key: entry for key, entry in zip(keys, entries, strict=True) if kept[key] is None}
    if missing:
        protocol, challenge = entries[0][0].protocol, entries[0][0].challenge
        sums = (stages.scene_sums(*entry) for entry in missing.values())
        computed = bootstrap(sums, challenge, protocol.ranking, protocol.grading.headline)
        for key, uncertainty in zip(missing, computed, strict=True):
            private.write_columns(Shelf.INTERVALS, key, _columns(uncertainty))
            found[key] = uncertainty
    return [found[key] for key in keys]


def _key(stages: Stages, target: Target, measurement_key: str) -> str:
    protocol = target.protocol
    return content_key(
        "intervals",
        stages.sums_key(target, measurement_key),
        protocol.ranking_digest,
        protocol.grading.headline,
    )


def _columns(uncertainty: Uncertainty) -> Columns:
    """Every field as an array; a plain number has no axes."""
    return {field.name: np.asarray(getattr(uncertainty, field.name)) for field in _FIELDS}


def _kept(private: PrivateStore, key: str) -> Uncertainty | None:
    columns = private.read_columns(Shelf.INTERVALS, key)
    if columns is None or columns.keys() != {field.name for field in _FIELDS}:
        return None
    values: dict[str, Any] = {
        name: column if column.ndim else column.item() for name, column in columns.items()
    }
    return Uncertainty(**values)
