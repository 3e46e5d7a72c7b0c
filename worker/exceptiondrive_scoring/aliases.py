"""Names for array types. Shapes and units are in docstrings and in the names of values."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.integer[Any]]
Columns = Mapping[str, NDArray[Any]]
"""Named arrays whose first axis is the sample; stores keep them, and challenges exchange them."""
