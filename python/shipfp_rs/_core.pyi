"""Compiled kernels; the interface is described in ARCHITECTURE.md."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__version__: str

LINEAR_PARAMETERS: tuple[str, ...]
LINEAR_OUTPUTS: tuple[str, ...]

def linear_response(
    parameters: NDArray[np.float64], frequency_hz: NDArray[np.float64], outputs: Sequence[int]
) -> NDArray[np.complex128]: ...
def linear_response_sensitivities(
    parameters: NDArray[np.float64],
    frequency_hz: NDArray[np.float64],
    outputs: Sequence[int],
    wrt: Sequence[int],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]: ...
