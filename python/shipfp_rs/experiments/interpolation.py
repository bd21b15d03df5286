"""How a set point runs between its samples: straight lines, or as a signal that a low-pass filter has passed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import firwin2

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.arrays import Array

TAPS = 41
GRID = 257


def band_limited(experiment: Experiment) -> Experiment:
    """Return the experiment with a set point whose straight lines have the spectrum that its samples stand for.

    Straight lines through the samples of a band-limited signal are that signal behind sinc(f / f_s)^2: at a twelfth of
    the sample rate 2 per cent are missing. The samples are filtered by the inverse, a symmetric FIR filter.

    Parameters
    ----------
    experiment
        With hold "first" and a set point that was low-pass filtered before it was sampled at this rate.

    Returns
    -------
    Experiment
        The same with another `n_set`; only its simulation differs.
    """
    part = np.linspace(0.0, 1.0, GRID)
    taps = firwin2(TAPS, part, 1.0 / np.sinc(0.5 * part) ** 2)
    samples: Array = np.asarray(experiment.signals["n_set"], dtype=float)
    level = float(samples[0])
    filtered = level + convolve1d(samples - level, taps / taps.sum(), mode="nearest")
    return replace(experiment, signals={**experiment.signals, "n_set": filtered})
