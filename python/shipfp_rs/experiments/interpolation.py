"""Set points and loads between their samples: straight lines, or a band-limited signal as a low-pass filter leaves it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import firwin2

from shipfp_rs.experiments.experiment import DRIVES, Experiment

TAPS = 41
GRID = 257


def band_limited(experiment: Experiment) -> Experiment:
    """Return the experiment with set point and load prefiltered, so that straight lines have the band-limited spectrum.

    Straight lines through the samples of a band-limited signal act as a filter sinc(f / f_s)^2, which takes 2 per cent at
    a twelfth of the sample rate. The samples are filtered by the inverse, a symmetric FIR filter.

    Parameters
    ----------
    experiment
        With hold "first" and signals that were low-pass filtered before they were sampled at this rate.

    Returns
    -------
    Experiment
        The same with another `n_set` and `M_load`; only its simulation differs.
    """
    part = np.linspace(0.0, 1.0, GRID)
    taps = firwin2(TAPS, part, 1.0 / np.sinc(0.5 * part) ** 2)
    signals = dict(experiment.signals)
    for name in DRIVES.keys() & signals.keys():
        # At its ends a signal goes on as it went.
        reach = min(TAPS // 2, len(signals[name]) - 1)
        wide = np.pad(signals[name], reach, mode="reflect", reflect_type="odd")
        filtered = convolve1d(wide, taps / taps.sum(), mode="nearest")
        signals[name] = filtered[reach : reach + len(signals[name])]
    return replace(experiment, signals=signals)
