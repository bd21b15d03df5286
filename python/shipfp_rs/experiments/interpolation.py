"""How what drives a model runs between its samples: straight lines, or as a signal that a low-pass filter has passed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import firwin2

from shipfp_rs.experiments.experiment import DRIVES, Experiment

TAPS = 41
GRID = 257


def band_limited(experiment: Experiment) -> Experiment:
    """Return the experiment with a set point, and a load, whose straight lines have the spectrum that its samples stand for.

    Straight lines through the samples of a band-limited signal are that signal behind sinc(f / f_s)^2: at a twelfth of
    the sample rate 2 per cent are missing. The samples are filtered by the inverse, a symmetric FIR filter.

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
        level = float(signals[name][0])
        signals[name] = level + convolve1d(signals[name] - level, taps / taps.sum(), mode="nearest")
    return replace(experiment, signals=signals)
