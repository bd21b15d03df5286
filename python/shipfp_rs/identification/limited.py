"""What a torque limit does that the ship model does not show at the rate of a record: to moving water, between samples.

The load of a ship that lies still moves with the water. Without a limit that adds noise to speed and torque. A limit cuts
the noise off on one side, so that the mean torque near the limit is lower, and the speed falls further. A model without
the water then finds the limit too low, by 0.5 per cent at a load that moves by 0.8 per cent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import firwin, resample_poly, welch

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.ship import ShipEquations
from shipfp_rs.structures.ties import bare
from shipfp_rs.support.arrays import Array

FINER = 8
"""Steps of the simulation for one sample: a corner at a limit lies between samples, and the record was low-passed."""
EDGE = 0.44
"""Edge of that low-pass over the sample rate."""
REACH = 10
"""Samples that it reaches to either side."""
STRETCH_S = 16.0
"""Length of the stretches whose spectra tell water from noise."""
NOISE_HZ = (3.0, 8.0)
"""Band in which the load's estimate is noise; water moves more slowly."""


def beyond_limit(
    equations: Equations,
    values: Mapping[str, float],
    experiment: Experiment,
    measured: Mapping[str, Array],
    asked: Array,
    *,
    band_limited: bool,
) -> Array:
    """What outputs at a torque limit have beyond the model's and beyond noise that no limit cuts off, shape (O, N).

    Parameters
    ----------
    equations, values
        The ship and its parameters, the experiment's own unknowns among them.
    experiment
        Its set point is what the model is given.
    measured
        Deviation of each output as it was measured, shape (N,).
    asked
        Deviation of the set point as it was sampled, shape (N,).
    band_limited
        Whether the set point between its samples is a band-limited signal; otherwise straight lines.
    """
    model = bare(equations)
    if not isinstance(model, ShipEquations) or "M_max" not in values or experiment.hold != "first":
        return np.zeros((len(measured), len(asked)))
    load = values["k_L"] * experiment.normalised("M_load") if model.loaded else np.zeros(len(asked))
    water = _water(model, values, experiment.rate_hz, measured, load)
    model = replace(model, sharp=False, loaded=True)
    acting = {**values, "k_L": 1.0}
    # About the operating point and without a limit water is what it is in any other fit: noise.
    still = {**acting, **dict.fromkeys(model.states, 0.0)}
    del still["M_max"]
    finer = _finer(asked, smooth=band_limited)
    shown = model.simulate(acting, _driven(experiment, finer, _finer(load + water, smooth=True), FINER))
    plain = model.simulate(acting, _driven(experiment, experiment.dn_set, load))
    noise = model.simulate(still, _driven(experiment, np.zeros(len(asked)), water))
    return np.asarray(_low_passed(shown) - plain - noise)


def _water(
    model: ShipEquations,
    values: Mapping[str, float],
    rate_hz: float,
    measured: Mapping[str, Array],
    load: Array,
) -> Array:
    """Load beside its law that speed and torque show, over the operating one, shape (N,); zero without either of them."""
    if not {"dn", "dM"} <= measured.keys() or model.propeller_speed:
        return np.zeros(len(load))
    speed, torque = (np.nan_to_num(measured[name]) for name in ("dn", "dM"))
    time = np.arange(len(load)) / rate_hz
    torque = np.interp(time + values.get("T_M", 0.0), time, torque)
    inertia = values["tau_prop"] if model.gauge else values["tau_n"]
    law = (1.0 + speed) ** values["p"] + values.get("damping", 0.0) * speed + load
    rest = 1.0 + torque - law - inertia * np.gradient(speed) * rate_hz
    rest = np.where(np.isfinite(measured["dn"] + measured["dM"]), rest - np.nanmean(rest), 0.0)
    frequency, power = welch(rest, rate_hz, nperseg=min(round(STRETCH_S * rate_hz), len(rest)))
    above = (frequency >= NOISE_HZ[0]) & (frequency <= NOISE_HZ[1])
    if not above.any():
        return np.zeros(len(load))
    # Wiener's filter: of what stands out from the noise as large a part as that.
    part = np.clip(1.0 - np.median(power[above]) / np.maximum(power, 1e-300), 0.0, 1.0)
    part[frequency >= NOISE_HZ[0]] = 0.0
    at = np.fft.rfftfreq(len(rest), 1.0 / rate_hz)
    return np.asarray(np.fft.irfft(np.fft.rfft(rest) * np.interp(at, frequency, part), len(rest)))


def _finer(samples: Array, *, smooth: bool) -> Array:
    if smooth:
        return np.asarray(resample_poly(samples, FINER, 1, padtype="line"))
    places = np.arange(len(samples) * FINER) / FINER
    return np.interp(places, np.arange(len(samples)), samples)


def _driven(experiment: Experiment, asked: Array, load: Array, finer: int = 1) -> Experiment:
    """Return the experiment driven by other deviations of set point and load, so many times as many samples."""
    at = {"n_set": experiment.operating_point["n_set"], "M_load": 1.0}
    signals = {"n_set": at["n_set"] * (1.0 + asked), "M_load": 1.0 + load}
    return replace(experiment, rate_hz=experiment.rate_hz * finer, signals=signals, operating_point=at)


def _low_passed(outputs: Array) -> Array:
    taps = firwin(2 * REACH * FINER + 1, 2.0 * EDGE / FINER)
    return np.asarray(convolve1d(outputs, taps, axis=-1, mode="nearest")[:, ::FINER])
