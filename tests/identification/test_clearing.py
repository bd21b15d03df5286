"""What is taken off records is refused where it has left the range of a drive train."""

import numpy as np
import pytest

from shipfp_rs.errors import SimulationError
from shipfp_rs.identification.clearing import require_small


def test_a_simulation_that_grew_without_end_is_refused_and_masked_samples_are_not():
    require_small(np.array([[0.1, np.nan, -2.0]]))
    for lost in (1e194, -np.inf, 11.0):
        with pytest.raises(SimulationError, match="left the range of a drive train"):
            require_small(np.array([[0.1, np.nan, lost]]))
