"""What a torque limit does that the ship model does not show at the rate of a record: to moving water, between samples.

The load of a ship that lies still moves with the water. Without a limit that adds noise to speed and torque. A limit cuts
the noise off on one side, so that the mean torque near the limit is lower, and the speed falls further. A model without
the water then finds the limit too low, by 0.5 per cent at a load that moves by 0.8 per cent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import firwin, resample_poly, welch

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.ship import ShipEquations
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import bare, tied
from shipfp_rs.support.arrays import Array, Names, Values

FINER = 8
"""Steps of the simulation for one sample: a corner at a limit lies between samples, and the record was low-passed."""
EDGE = 0.44
"""Edge of that low-pass over the sample rate."""
REACH = 10
"""Samples that it reaches to either side."""
STRETCH_S = 16.0
"""Length of the stretches whose spectra tell water from noise."""
LAW_ROUNDS = 4
"""Times that the load's own law is found anew."""
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
    model = replace(model, sharp=False)
    water = _water(model, values, experiment, measured)
    model = replace(model, loaded=True)
    acting = {**values, "k_L": 1.0}
    # About the operating point and without a limit water is what it is in any other fit: noise.
    still = {**acting, **dict.fromkeys(model.states, 0.0)}
    del still["M_max"]
    finer = _finer(asked, smooth=band_limited)
    shown = model.simulate(acting, _driven(experiment, finer, _finer(load + water, smooth=True), FINER))
    plain = model.simulate(acting, _driven(experiment, experiment.dn_set, load))
    noise = model.simulate(still, _driven(experiment, np.zeros(len(asked)), water))
    return np.asarray(_low_passed(shown) - plain - noise)


@dataclass(frozen=True)
class Afloat(ShipEquations):
    """A ship whose load moves by the water in `M_load`, less the noise that this makes without a limit."""

    has_products: bool = False

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        acting, still = self._acting(values)
        return self._ship.simulate(acting, experiment) - self._ship.simulate(still, _at_rest(experiment))

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N)."""
        acting, still = self._acting(values)
        outputs, slopes = self._ship.sensitivities(acting, experiment, names)
        own = [name for name in names if name in still and name not in self.states]
        noise, changes = self._ship.sensitivities(still, _at_rest(experiment), own)
        slopes = np.array(slopes).reshape(len(names), *outputs.shape)
        slopes[[list(names).index(name) for name in own]] -= changes.reshape(len(own), *outputs.shape)
        return outputs - noise, slopes

    @property
    def _ship(self) -> ShipEquations:
        return ShipEquations(
            self.outputs, self.gauge, loaded=True, sharp=False, mean_sampling=self.mean_sampling
        )

    def _acting(self, values: Values) -> tuple[dict[str, float], dict[str, float]]:
        acting = {**values, "k_L": 1.0}
        still = {**acting, **dict.fromkeys(self.states, 0.0)}
        del still["M_max"]
        return acting, still


def afloat(
    structure: Structure,
    values: Mapping[str, float],
    experiment: Experiment,
    measured: Mapping[str, Array],
    asked: Array,
    *,
    band_limited: bool,
) -> tuple[Structure, dict[str, Array]]:
    """Return a structure that knows the water, and what its experiment measures; arguments as for `beyond_limit`.

    The structure is linear in nothing and slow, and it is for the way to a minimum only: of water as noise the estimates'
    deviations are those of the ship itself. Signals are deviations; `M_load` is the water.
    """
    model = bare(structure.equations)
    assert isinstance(model, ShipEquations)
    model = replace(model, sharp=False)
    water = _water(model, values, experiment, measured)
    fine = _driven(experiment, _finer(asked, smooth=band_limited), _finer(water, smooth=True), FINER)
    model, acting = replace(model, loaded=True), {**values, "k_L": 1.0}
    corners = _low_passed(model.simulate(acting, fine)) - model.simulate(
        acting, _driven(experiment, experiment.dn_set, water)
    )
    changed = {name: measured[name] - change for name, change in zip(measured, corners, strict=True)}
    equations = Afloat(model.outputs, model.gauge, mean_sampling=model.mean_sampling)
    return replace(structure, equations=tied(equations, structure.ties)), {**changed, "M_load": water}


def _at_rest(experiment: Experiment) -> Experiment:
    return _driven(experiment, np.zeros(len(experiment)), experiment.normalised("M_load"))


def _water(
    model: ShipEquations, values: Mapping[str, float], experiment: Experiment, measured: Mapping[str, Array]
) -> Array:
    """Load beside its law that speed and torque show, over the operating one, shape (N,); zero without either of them.

    The law's exponent and the inertia are those with which the load is not correlated with what the set point does to the
    speed: with those of a fit that is not right yet, the load would hold a part of the trial's own swing.
    """
    if not {"dn", "dM"} <= measured.keys() or model.propeller_speed:
        return np.zeros(len(experiment))
    known = np.isfinite(measured["dn"] + measured["dM"])
    speed, torque = (np.nan_to_num(measured[name]) for name in ("dn", "dM"))
    time = np.arange(len(experiment)) / experiment.rate_hz
    torque = np.interp(time + values.get("T_M", 0.0), time, torque)
    torque = torque - (values["k_L"] * experiment.normalised("M_load") if model.loaded else 0.0)
    torque -= values.get("damping", 0.0) * speed
    driven = model.simulate(values, experiment)[model.outputs.index("dn")]
    exponent, inertia = values["p"], values["tau_prop"] if model.gauge else values["tau_n"]
    for _ in range(LAW_ROUNDS):
        rest = 1.0 + torque - (1.0 + speed) ** exponent - inertia * _slope(speed, experiment)
        water = _slow(np.where(known, rest - rest[known].mean(), 0.0), experiment.rate_hz)
        of_speed, of_driven = (
            np.stack([np.log1p(one) * (1.0 + one) ** exponent, _slope(one, experiment)])
            for one in (speed, driven)
        )
        of_driven -= of_driven.mean(axis=1, keepdims=True)
        change, *_ = np.linalg.lstsq(of_driven @ of_speed.T, of_driven @ water, rcond=1e-9)
        exponent, inertia = exponent + change[0], inertia + change[1]
    return water


def _slope(speed: Array, experiment: Experiment) -> Array:
    return np.asarray(np.gradient(speed) * experiment.rate_hz)


def _slow(rest: Array, rate_hz: float) -> Array:
    """Wiener's filter: of what stands out from the noise, as large a part as it does."""
    frequency, power = welch(rest, rate_hz, nperseg=min(round(STRETCH_S * rate_hz), len(rest)))
    above = (frequency >= NOISE_HZ[0]) & (frequency <= NOISE_HZ[1])
    if not above.any():
        return np.zeros(len(rest))
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
