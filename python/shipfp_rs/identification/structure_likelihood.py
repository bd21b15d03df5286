"""The likelihood of a given structure: its equations on experiments, spectra and frequency responses.

Data in the form compared with a structure: samples, tapered spectra, or frequency responses.

Each kind has a spectrum (O, F), the residual of a model, and the model's derivatives. Samples are treated
as if each were a frequency: white noise has the same covariance at all samples, as at all frequencies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification import spectra
from shipfp_rs.identification.coordinates import Coordinates
from shipfp_rs.identification.fit_statistics import nrmse_pct
from shipfp_rs.identification.likelihood import (
    ACCURACY,
    Likelihood,
    noise_root,
    quantile_of,
    real_rows,
    spread_of,
    white_root,
)
from shipfp_rs.identification.sampling import SHORTEST_S
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.two_equations import TwoEquations
from shipfp_rs.support.arrays import DEVIATIONS_95, Array, Numbers

Data = Experiment | FrequencyResponse
Evaluated = tuple[Numbers, Numbers]
"""Residuals (O, F), and the model's derivatives (W, O, F)."""


class Measured:
    """Measured data, NaN where masked or missing, and their compared subset."""

    measured: Numbers

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
    """Samples of an experiment at which all outputs were measured.

    Parameters
    ----------
    data, structure, signals
        The experiment, the structure, and the signals of its outputs.
    unknowns
        Unknowns of the record: initial states, then offsets such as "offset dn".
    measured
        Normalised outputs (O, N), NaN where masked.
    """

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
    """Return data as a fit compares them with a structure: samples in time, their spectra, or a frequency response.

    Raises
    ------
    InputError
        If a signal or its standard deviations are missing, or all samples are masked.
    """
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
    ship = TwoEquations.of(structure, ())
    # The time domain is exact for simulated data from rest and for linear ships, and needs no taper, which would remove much
    # of a short record. Linear ships are as fast in it as by spectra.
    short = data.duration < SHORTEST_S
    if ship is None or ship.is_linear or at_rest or short or not samples.valid.any():
        return samples
    return banded(samples, white=True)


def banded(samples: Samples, *, white: bool = False) -> InBand:
    """Return the spectra of samples, for a ship in its loop's band, for a user's structure in the whole excited band.

    Raises
    ------
    InputError
        If the record is too short for a spectrum.
    """
    ship = TwoEquations.of(samples.structure, ())
    loaded = "load" in samples.structure.settings.get("elements", ())
    if ship is not None:
        loaded = getattr(ship.equations, "loaded", False)
    outputs = samples.structure.outputs
    record = spectra.Spectra.of(samples.data, outputs, samples.measured, load=loaded, wide=ship is None)
    record = replace(record, is_linear=ship is not None and ship.is_linear)
    own = samples.data, samples.structure, samples.signals, samples.unknowns, samples.measured
    return InBand(*own, record, white)


FIRST_NOISE = 0.1
"""Standard deviation of the noise before any estimate, over an output's spread."""


@dataclass(frozen=True, eq=False)
class StructureLikelihood(Likelihood):
    """Likelihood of a structure for given records."""

    records: tuple[Seen, ...]
    coordinates: Coordinates

    @classmethod
    def of(cls, records: Sequence[Seen], structure: Structure, *, accurate: bool = False) -> Self:
        """Return a likelihood before any noise estimate; `accurate`: for simulated data, without systematic errors."""
        accuracy = np.zeros(len(structure.outputs))
        for record in records if not accurate else ():
            if isinstance(record, InBand):
                said = [record.data.gauge_accuracy.get(signal, ACCURACY) for signal in record.signals]
                accuracy = np.maximum(accuracy, said)
        return cls(
            records=tuple(records),
            coordinates=Coordinates.of(structure, [record.unknowns for record in records]),
            accuracy=accuracy,
            priors={one.name: one.prior for one in structure.free if one.prior is not None},
        )

    def known(self, vector: Array, record: int) -> dict[str, float]:
        """Parameters and a record's unknowns by name."""
        c = self.coordinates
        own = vector[c.states(record)]
        return c.values(vector) | dict(zip(self.records[record].unknowns, map(float, own), strict=True))

    def spectra(self, vector: Array, record: int) -> tuple[Numbers, Numbers]:
        """Residuals (O, F) of a record, and the model's derivatives by the whole search vector (P, O, F)."""
        c, count = self.coordinates, len(self.coordinates.free)
        values = self.known(vector, record)
        residual, slopes = self._evaluate(vector, record, c.names)
        jacobian = np.zeros((c.size, *residual.shape), dtype=slopes.dtype)
        jacobian[:count] = slopes[:count]
        for name in c.logarithms:
            jacobian[c.place(name)] *= values[name]
        jacobian[c.states(record)] = slopes[count:]
        return residual, jacobian

    def residuals(self, vector: Array) -> list[Numbers]:
        """Residuals (O, F) of each record."""
        return [self._evaluate(vector, record, ())[0] for record in range(len(self.records))]

    def _evaluate(self, vector: Array, record: int, names: Sequence[str]) -> Evaluated:
        if not self.records[record].structure.equations.stable(self.coordinates.values(vector)):
            raise SimulationError("the loop is unstable")
        return self.records[record].evaluate(self.known(vector, record), names)

    def root(self, record: int) -> Numbers:
        """Root of the inverse spectral matrix of a record's noise; before any estimate, a share of the data's spread."""
        own = self.records[record]
        if self.roots is not None:
            return self.roots[record]
        if isinstance(own, Response) and own.weighed:
            return np.eye(len(self.accuracy))
        spread = own.spectrum.std(axis=1)
        return np.diag(1.0 / (FIRST_NOISE * np.maximum(spread, 1e-6 * max(spread.max(), 1e-6))))

    @cached_property
    def _white_rows(self) -> int:
        """Number of real values of each output in records with white noise."""
        white = (one for one in self.records if _is_white(one))
        return sum(one.used * (2 if isinstance(one, Response) else 1) for one in white)

    def of_structure(self, structure: Structure) -> Self:
        """Return the likelihood of a structure with the same parameters, but other free ones."""
        return replace(self, coordinates=Coordinates.of(structure, self.coordinates.unknowns))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of white noise: real numbers in the data minus unknowns."""
        return len(self.accuracy) * self._white_rows - self.coordinates.size

    @property
    def quantile(self) -> float:
        """Half width of a 95 % interval, in standard deviations; larger where the noise is estimated from few numbers."""
        if not all(map(_is_white, self.records)):
            return DEVIATIONS_95
        return quantile_of(self.freedom)

    @property
    def untold(self) -> bool:
        """Whether there are too few samples to estimate any noise."""
        return all(map(_is_white, self.records)) and self.freedom <= 0

    def _noise(self, residuals: Sequence[Numbers], unsure: Sequence[Numbers | float]) -> tuple[Numbers, ...]:
        """Root of the inverse spectral matrix of each record's residuals; all frequency responses share one."""
        share = max(self.freedom, 1) / max(len(self.accuracy) * self._white_rows, 1)
        responses = [index for index, one in enumerate(self.records) if isinstance(one, Response)]
        found = {}
        for index, (record, residual, own) in enumerate(zip(self.records, residuals, unsure, strict=True)):
            if isinstance(record, InBand):
                found[index] = noise_root(residual, own)
            elif not _is_white(record):
                found[index] = np.eye(len(residual))
            else:
                pooled = [place for place in responses if _is_white(self.records[place])]
                places = pooled if index in pooled else [index]
                found[index] = self._white_root(residuals, places, share)
        return tuple(found[index] for index in range(len(self.records)))

    def _white_root(self, residuals: Sequence[Numbers], places: Sequence[int], share: float) -> Numbers:
        """Root of the inverse joint covariance of records; `share` is the degrees of freedom over the number of values."""
        left = np.concatenate([real_rows(residuals[place]) for place in places], axis=1)
        said = np.concatenate([real_rows(self.records[place].spectrum) for place in places], axis=1)
        return white_root(left, said, share, self.quantile)

    def spread(self) -> float:
        """Log determinants of the noise, as part of the deviance."""
        assert self.roots is not None
        found = 0.0
        for record, root in zip(self.records, self.roots, strict=True):
            if isinstance(record, InBand):
                found += spread_of(root)
            elif _is_white(record):
                rows = record.used * (2 if isinstance(record, Response) else 1)
                found -= 2.0 * rows * float(np.log(np.abs(np.linalg.det(root))))
        return found


def _is_white(record: Seen) -> bool:
    """Whether a record's noise has one covariance."""
    return not record.weighed if isinstance(record, Response) else not isinstance(record, InBand)
