"""Interpolation of band-limited signals."""

from __future__ import annotations

import numpy as np
from scipy.signal import firwin, resample_poly

from shipfp_rs.support.arrays import Array

EITHER_SIDE, RIPPLE_1E_5 = 32, ("kaiser", 10.0)
"""Samples on either side of an interpolated one, and the window: flat to 1e-5 up to 0.45 of the rate. The torque follows
from a small difference of set point and speed: a ripple of 0.1 per cent moves a parameter outside its interval.
"""


def interpolated(values: Array, factor: int) -> Array:
    """Samples of a band-limited signal at `factor` times its rate, with its original ends."""
    if factor == 1 or not len(values):
        return values
    pad = 200
    wide = np.pad(values, pad, mode="edge")
    taps = firwin(2 * EITHER_SIDE * factor + 1, 1.0 / factor, window=RIPPLE_1E_5)
    fine = resample_poly(wide - wide[0], factor, 1, window=taps)
    return np.asarray(fine[pad * factor : (pad + len(values)) * factor] + wide[0])
