"""Types of arrays and pairs, named once for all modules."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
UInt16s = NDArray[np.uint16]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Pair = tuple[int, int]  # numbers of two scans
