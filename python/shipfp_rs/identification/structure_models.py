"""Models by a structure's own equations: of an experiment's samples, of their tapered spectra, and of a frequency response.

Samples are treated like frequencies: white noise has the same covariance at all samples, as it has at all frequencies.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification import spectra
from shipfp_rs.identification.coordinates import Coordinates
from shipfp_rs.identification.fit_statistics import nrmse_pct
from shipfp_rs.identification.likelihood import ACCURACY, Likelihood
from shipfp_rs.identification.model import Model
from shipfp_rs.identification.sampling import SHORTEST_S
from shipfp_rs.identification.ship_model import Ship
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array, Numbers

Data = Experiment | FrequencyResponse
Evaluated = tuple[Numbers, Numbers]
"""Residuals (O, F), and the model's derivatives (W, O, F)."""


FIRST_NOISE = 0.1
"""Standard deviation of the noise before any estimate, relative to an output's standard deviation."""


class Measured(Model):
    """Measured data, NaN where masked or missing, and their compared part, with a structure as their model."""

    structure: Structure
    measured: Numbers
    noise: Literal["coloured", "white", "known"] = "white"

    @abstractmethod
    def evaluate(self, values: Mapping[str, float], names: Sequence[str]) -> Evaluated:
        """Residuals (O, F) and the model's derivatives by `names` and the record's unknowns, (W, O, F)."""

    def rows(self, values: Mapping[str, float], own: Array, names: Sequence[str]) -> Numbers:
        """Residual and the model's derivatives by the parameters and the unknowns, (1 + W + U, O, F)."""
        if not self.structure.equations.stable(values):
            raise SimulationError("the loop is unstable")
        known = {**values, **dict(zip(self.unknowns, own.tolist(), strict=True))}
        residual, slopes = self.evaluate(known, names)
        return np.concatenate([residual[None], slopes]) if names else residual[None]

    @property
    def numbers(self) -> int:
        """Number of real values of each output."""
        return self.used

    @property
    def first_root(self) -> Numbers:
        """Root of the inverse covariance of the noise before any estimate: a share of the data's spread."""
        spread = self.spectrum.std(axis=1)
        return np.diag(1.0 / (FIRST_NOISE * np.maximum(spread, 1e-6 * max(spread.max(), 1e-6))))

    @cached_property
    def valid(self) -> npt.NDArray[np.bool_]:
        """True where all outputs were measured, shape (N,) or (F,)."""
        return np.asarray(np.isfinite(self.measured).all(axis=0))

    @property
    def used(self) -> int:
        """Number of samples, or points, at which all outputs were measured."""
        return int(np.count_nonzero(self.valid))

    @cached_property
    def spectrum(self) -> Numbers:
        """Compared spectrum or samples, shape (O, F)."""
        return self.measured[:, self.valid]


@dataclass(frozen=True, eq=False)
class Samples(Measured):
    """Samples of an experiment at which all outputs were measured."""

    data: Experiment
    structure: Structure
    signals: tuple[str, ...]
    unknowns: tuple[str, ...]
    measured: Array

    @property
    def offsets(self) -> tuple[str, ...]:
        """The record's unknowns that are output offsets."""
        return tuple(name for name in self.unknowns if name.startswith("offset "))

    def simulated(self, values: Mapping[str, float], names: Sequence[str]) -> tuple[Array, Array]:
        """Outputs (O, N), offsets included, and their derivatives by `names` and the record's unknowns, (W, O, N)."""
        states = self.unknowns[: len(self.unknowns) - len(self.offsets)]
        wanted = [*names, *states]
        known = {name: value for name, value in values.items() if name not in self.offsets}
        model, slopes = self.structure.equations.sensitivities(known, self.data, wanted)
        slopes = slopes.reshape(len(wanted), *model.shape)
        if self.offsets:
            model = model + np.array([[values.get(name, 0.0)] for name in self.offsets])
            ones = np.broadcast_to(np.eye(len(model))[:, :, None], (len(model), *model.shape))
            slopes = np.concatenate([slopes, ones])
        return model, slopes

    def evaluate(self, values: Mapping[str, float], names: Sequence[str]) -> Evaluated:
        """Residuals (O, F) and the model's derivatives by `names` and the record's unknowns, (W, O, F)."""
        model, slopes = self.simulated(values, names)
        if self.valid.all():
            return self.measured - model, slopes
        return (self.measured - model)[:, self.valid], slopes[..., self.valid]

    def fit_pct(self, values: Mapping[str, float]) -> list[float]:
        """Fit of each output's simulation, eq. 4.9 [%]."""
        residual, _ = Samples.evaluate(self, values, ())
        return [nrmse_pct(*pair) for pair in zip(self.measured[:, self.valid], residual, strict=True)]


@dataclass(frozen=True, eq=False)
class InBand(Samples):
    """Tapered spectra of an experiment in a band; `white`: the noise has one covariance at all frequencies."""

    record: spectra.Spectra
    white: bool = False
    noise = "coloured"
    _left: dict[tuple[float, ...], Array] = field(default_factory=dict, repr=False)

    @property
    def frequency_hz(self) -> Array:
        """Compared frequencies [Hz], shape (F,)."""
        return self.record.frequency_hz

    @cached_property
    def spectrum(self) -> Numbers:
        """Spectra of the data, shape (O, F)."""
        return self.seen(self.measured)

    def seen(self, signals: Array) -> Numbers:
        """Return spectra (..., O, F) of signals (..., O, N), interpolated linearly across the data's gaps."""
        gaps = ~np.isfinite(self.measured)
        if gaps.any():
            signals = signals.copy()
            samples = np.arange(signals.shape[-1])
            for output, masked in enumerate(gaps):
                kept = np.flatnonzero(~masked)
                after = np.clip(np.searchsorted(kept, samples[masked]), 1, max(len(kept) - 1, 1))
                first, last = kept[after - 1], kept[np.minimum(after, len(kept) - 1)]
                share = np.clip((samples[masked] - first) / np.maximum(last - first, 1), 0.0, 1.0)
                one = signals[..., output, :]
                one[..., masked] = (1.0 - share) * one[..., first] + share * one[..., last]
        return self.record.see(self.record.low_passed(signals))

    def evaluate(self, values: Mapping[str, float], names: Sequence[str]) -> Evaluated:
        """Residuals (O, F) and the model's derivatives by `names` and the record's unknowns, (W, O, F)."""
        model, slopes = self.simulated(values, names)
        seen = self.seen(np.concatenate([model[None], slopes]))
        return self.spectrum - seen[0], seen[1:]

    def left(self, values: Mapping[str, float]) -> Array:
        """Residual (O, N) of a simulation whose initial state and offsets are fitted to the samples."""
        known = {name: values[name] for name in self.structure.names}
        at = tuple(known.values())
        if at not in self._left:
            model = simulated_about(self.structure, known, self.data)
            self._left[at] = self.measured - np.array(list(model.values()))
        return self._left[at]

    def fit_pct(self, values: Mapping[str, float]) -> list[float]:
        """Fit of each output's simulation, eq. 4.9 [%]."""
        return [nrmse_pct(*pair) for pair in zip(self.measured, self.left(values), strict=True)]


@dataclass(frozen=True, eq=False)
class Response(Measured):
    """A frequency response; `weighed`: residuals are log amplitude and phase over their standard deviations."""

    data: FrequencyResponse
    structure: Structure
    signals: tuple[str, ...]
    measured: Numbers
    weighed: bool
    unknowns: tuple[str, ...] = ()
    is_pooled = True

    @property
    def noise(self) -> Literal["white", "known"]:  # type: ignore[override]
        """Kind of noise: known standard deviations, or a covariance that all responses share."""
        return "known" if self.weighed else "white"

    @property
    def numbers(self) -> int:
        """Number of real values of each output."""
        return 2 * self.used

    @property
    def first_root(self) -> Numbers:
        """Root of the inverse covariance of the noise before any estimate."""
        return np.eye(len(self.measured)) if self.weighed else super().first_root

    def evaluate(self, values: Mapping[str, float], names: Sequence[str]) -> Evaluated:
        """Residuals (O, F) and the model's derivatives by `names`, (W, O, F)."""
        frequency = np.ascontiguousarray(self.data.frequency_hz[self.valid])
        model, slopes = self.structure.equations.response(values, frequency, names)
        slopes = slopes.reshape(len(names), *model.shape)
        if not self.weighed:
            return self.spectrum - model, slopes
        # Log amplitude and phase are independent errors.
        amplitude, phase = (
            np.array([one[signal][self.valid] for signal in self.signals])
            for one in (self.data.amplitude_std, self.data.phase_std)
        )
        ratio, relative = self.spectrum / model, slopes / model
        residual = np.log(np.abs(ratio)) / amplitude + 1j * np.angle(ratio) / phase
        return residual, relative.real / amplitude + 1j * relative.imag / phase

    def fit_pct(self, values: Mapping[str, float]) -> list[float]:
        """Fit of each output's response, eq. 4.9 [%]."""
        frequency = np.ascontiguousarray(self.data.frequency_hz[self.valid])
        model, _ = self.structure.equations.response(values, frequency, ())
        return [nrmse_pct(*pair) for pair in zip(self.spectrum, self.spectrum - model, strict=True)]


Seen = Samples | Response


def seen(data: Data, structure: Structure, noise: str | None = None, *, at_rest: bool = False) -> Seen:
    """Return data as a fit compares them with a structure: samples in time, their spectra, or a frequency response."""
    found: Seen
    if isinstance(data, FrequencyResponse):
        signals = tuple(
            structure.signal_for(output, data.response, data.name) for output in structure.outputs
        )
        measured = np.array([data.response[signal] for signal in signals])
        found = Response(data, structure, signals, measured, weighed=_weighed(data, signals, noise))
    else:
        found = _in_time(data, structure, noise, at_rest=at_rest)
    if not found.valid.any():
        raise InputError(
            f"{data.name!r}: every sample of {', '.join(found.signals)} is masked, nothing to fit"
        )
    return found


def _weighed(data: FrequencyResponse, signals: Sequence[str], noise: str | None) -> bool:
    if noise == "coloured":
        raise InputError(
            f"{data.name!r}: noise 'coloured' is for experiments; a response has few frequencies: 'white' or 'std'"
        )
    for signal in signals:
        if signal not in data.phase_std or signal not in data.amplitude_std:
            if noise != "std":
                return False
            raise InputError(
                f"{data.name!r}: noise 'std' needs the standard deviations of {signal!r}; give "
                "FrequencyResponse(amplitude_std=..., phase_std=...) or choose noise 'white'"
            )
    return noise != "white"


def _in_time(data: Experiment, structure: Structure, noise: str | None, *, at_rest: bool) -> Samples:
    if noise == "std":
        raise InputError(
            f"{data.name!r}: noise 'std' is for frequency responses, an experiment has no deviations"
        )
    signals = tuple(structure.signal_for(output, data.signals, data.name) for output in structure.outputs)
    equations = structure.equations
    offsets = () if equations.own_offsets else structure.outputs
    unknowns = () if at_rest else (*equations.states, *(f"offset {output}" for output in offsets))
    measured = structure.measured(data)
    samples = Samples(data, structure, signals, unknowns, measured)
    if noise != "white":
        return banded(samples) if samples.valid.any() else samples
    ship = Ship.of(structure)
    # The time domain is exact for simulated data from rest and for linear ships. Spectra need a taper, which removes much
    # of a short record. For linear ships the time domain is as fast.
    short = data.duration < SHORTEST_S
    if ship is None or ship.is_linear or at_rest or short or not samples.valid.any():
        return samples
    return banded(samples, white=True)


def banded(samples: Samples, *, white: bool = False) -> InBand:
    """Return the spectra of samples: for a ship in its loop's band, for a user's structure in the whole excited band."""
    ship = Ship.of(samples.structure)
    loaded = "load" in samples.structure.settings.get("elements", ())
    if ship is not None:
        loaded = getattr(ship.equations, "loaded", False)
    outputs = samples.structure.outputs
    record = spectra.Spectra.of(samples.data, outputs, samples.measured, load=loaded, wide=ship is None)
    record = replace(record, is_linear=ship is not None and ship.is_linear)
    own = samples.data, samples.structure, samples.signals, samples.unknowns, samples.measured
    return InBand(*own, record, white)


def structure_likelihood(
    models: Sequence[Seen], structure: Structure, *, accurate: bool = False
) -> Likelihood:
    """Return a likelihood before any noise estimate; `accurate`: for simulated data, without systematic errors."""
    accuracy = np.zeros(len(structure.outputs))
    for model in models if not accurate else ():
        if isinstance(model, InBand):
            said = [model.data.gauge_accuracy.get(signal, ACCURACY) for signal in model.signals]
            accuracy = np.maximum(accuracy, said)
    return Likelihood(
        models=tuple(models),
        coordinates=Coordinates.of(structure, [model.unknowns for model in models]),
        accuracy=accuracy,
        priors={one.name: one.prior for one in structure.free if one.prior is not None},
    )
