"""A logged set point without what the logger added to it.

A model is driven by the set point as it was logged, the ship by the set point as it was sent. Noise of the logger's own
goes through the model's governor and no other way, and a fit lowers the cost by answering it less: by less gain, more lag,
or a softer shaft than there is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import ShortTimeFFT
from scipy.signal.windows import hann

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.arrays import Array

WINDOW_S = 4.0
"""Length of the stretches whose spectra are looked at: a chirp stays in few of their frequencies, a step in few of them."""
ABOVE = 12.0
"""Power over that of noise from which on a frequency of a stretch is taken for signal: noise is so large once in 160,000."""


def without_noise(experiment: Experiment) -> Experiment:
    """Return the experiment with a set point of which only what stands out from broadband noise is left.

    The noise's power is the median over all stretches, at each frequency, and no more than the median over all
    frequencies: what excites at all times, at less than half of all frequencies, is no noise. What does not exceed it in a
    stretch is left out (spectral gating, S. F. Boll, 10.1109/TASSP.1979.1163209).

    Parameters
    ----------
    experiment
        At least four windows of 4 s long; a shorter one is returned as it is.

    Returns
    -------
    Experiment
        The same with another `n_set`.
    """
    values, rate_hz = experiment.signals["n_set"], experiment.rate_hz
    width = round(WINDOW_S * rate_hz) // 4 * 4
    if width < 8 or len(values) < 4 * width:
        return experiment
    signals = {**experiment.signals, "n_set": _gated(values, rate_hz, width)}
    return replace(experiment, signals=signals)


def _gated(values: Array, rate_hz: float, width: int) -> Array:
    level = np.linspace(values[0], values[-1], len(values))
    padded = np.pad(values - level, width, mode="reflect", reflect_type="odd")
    transform = ShortTimeFFT(hann(width, sym=False), width // 4, rate_hz)
    cells = transform.stft(padded)
    power = np.abs(cells) ** 2
    # The power of noise is distributed exponentially; its median is ln 2 of its mean.
    noise = np.median(power, axis=1, keepdims=True) / np.log(2.0)
    noise = np.minimum(noise, np.median(noise))
    kept = transform.istft(np.where(power > ABOVE * noise, cells, 0.0), k1=len(padded))
    return np.asarray(level + kept[width:-width])
