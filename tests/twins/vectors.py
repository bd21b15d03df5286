"""Parameter vectors of the kernels from usual values by name."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray


def vectors(usual: Mapping[str, float], names: Sequence[str]) -> Callable[..., NDArray[np.float64]]:
    """Return a function that makes the vector of these names, with some of the usual values changed."""

    def vector(**changes: float) -> NDArray[np.float64]:
        assert set(changes) <= set(usual)
        values = {**usual, **changes}
        return np.array([float(values[name]) for name in names])

    return vector
