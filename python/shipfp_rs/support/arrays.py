"""Types of arrays that all modules share."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Mask = npt.NDArray[np.bool_]
