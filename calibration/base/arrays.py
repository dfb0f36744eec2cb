"""Array types for type annotations."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of float64; its docstring gives the shape."""

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ArrayLike = NDArray[Any] | list[Any] | tuple[Any, ...]
