"""The types of arrays, as signatures write them; units, shapes and signs are in the docstrings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MIB = 2**20  # bytes

Array = NDArray[Any]  # of any numbers, before a check or whatever their precision
Image = NDArray[np.uint8]  # (H, W, 3), RGB
Map = NDArray[np.float32]  # (H, W) or (H, W, channels), of pixels or of blocks of them
Slopes = NDArray[np.float32]  # (H, W, 2), dz/dx and dz/dy
Mask = NDArray[np.bool_]  # (H, W), or one of each marker, node, frame
Floats = NDArray[np.float32]  # of another shape, such as rows of markers
Numbers = NDArray[np.float64]  # of any shape: truth, fits and moments
