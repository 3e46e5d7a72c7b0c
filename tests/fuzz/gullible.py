"""Imported first, makes the fast reader trust that sample ids are those of the split."""

from typing import Any

from exceptiondrive_schemas.split import Manifest
from exceptiondrive_worker import fast_planning


def _first_ones(predictions: Any, manifest: Manifest) -> Any:
    import numpy as np

    return np.arange(len(manifest.sample_ids))


vars(fast_planning)["rows_of"] = _first_ones
