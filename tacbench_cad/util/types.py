"""Type aliases of NumPy arrays, named after the type of their elements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]
#: The vertex indices of a mesh.
Indices = NDArray[np.int32]
Bools = NDArray[np.bool_]
#: The pixels of an image, or the bytes of a text.
Bytes = NDArray[np.uint8]
Strings = NDArray[np.str_]
