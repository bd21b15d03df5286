"""Subject of a design: a structure with expected values, the noise of its sensors, and the identifiable quantities."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from scipy.signal import lfilter

from shipfp_rs.assessment.closed_loop import structure_of
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.estimate import Status
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability
from shipfp_rs.identification.identifiability import NULL_PART, Sensitivity, gradient_of
from shipfp_rs.identification.identify import foresee
from shipfp_rs.identification.likelihood import ACCURACY
from shipfp_rs.signals import Excitation
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import COMBINATIONS, true_values
from shipfp_rs.support.arrays import Array
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.steady_state import steady_state
from shipfp_rs.vessel.vessel import Vessel

MOST_INACCURATE = 0.2
"""Largest accepted relative error of a calibration."""
LEAST_LEVEL = 1e-9
"""Least level of noise; smaller levels give weights out of the numerical range."""


@dataclass(frozen=True)
class Noise:
    """Stationary noise with a first-order spectrum.

    Its density is flat up to the corner frequency and falls with the square of the frequency above.

    Parameters
    ----------
    level
        Standard deviation relative to the signal's operating point [-].
    corner_hz
        Corner frequency [Hz]. None: white up to half the sample rate, with a density that depends on the sample rate.
    accuracy
        Standard deviation of the sensor's systematic relative error after calibration [-]. The error varies slowly with
        frequency, and does not decrease with the length of a trial.
    """

    level: float
    corner_hz: float | None = None
    accuracy: float = ACCURACY

    def __post_init__(self) -> None:
        if not LEAST_LEVEL <= self.level <= 1.0:
            raise InputError(
                f"noise level is {self.level}, expected a share of the operating point from {LEAST_LEVEL:g} to 1"
            )
        if self.corner_hz is not None and not self.corner_hz > 0.0:
            raise InputError(f"noise corner_hz is {self.corner_hz}, expected a positive frequency or None")

        if not 0.0 <= self.accuracy <= MOST_INACCURATE:
            raise InputError(f"noise accuracy is {self.accuracy}, expected 0 to {MOST_INACCURATE:g}")

    def correlation(self, rate_hz: float) -> float:
        """Correlation between successive samples [-]."""
        return 0.0 if self.corner_hz is None else math.exp(-2.0 * math.pi * self.corner_hz / rate_hz)

    def innovation(self, rate_hz: float) -> float:
        """Standard deviation of a sample given the previous one, relative to the operating point [-]."""
        return self.level * math.sqrt(1.0 - self.correlation(rate_hz) ** 2)

    def density(self, frequency_hz: Array, rate_hz: float) -> Array:
        """One-sided power spectral density of the samples at frequencies (F,) [1/Hz]."""
        turn = np.exp(-2j * math.pi * frequency_hz / rate_hz)
        whitened = np.abs(1.0 - self.correlation(rate_hz) * turn) ** 2
        return np.asarray(2.0 * self.innovation(rate_hz) ** 2 / rate_hz / whitened)

    def typical(self, turns: Array, samples: int, rate_hz: float) -> Array:
        """Samples (N,) over the operating point, with the given phases [turns] and the density as periodogram."""
        density = self.density(np.arange(len(turns), dtype=np.float64) * (rate_hz / samples), rate_hz)
        waves = np.sqrt(0.5 * samples * rate_hz * density) * np.exp(2j * math.pi * turns)
        return np.asarray(np.fft.irfft(waves, samples))

    def draw(self, samples: int, rate_hz: float, generator: np.random.Generator) -> Array:
        """Draw samples (N,), relative to the operating point; the first is from the stationary distribution."""
        correlation = self.correlation(rate_hz)
        shocks = self.level * generator.standard_normal(samples)
        shocks[1:] *= math.sqrt(1.0 - correlation**2)
        return np.asarray(lfilter([1.0], [1.0, -correlation], shocks))


USUAL: Mapping[str, Noise] = {
    "n_e": Noise(0.003, 10.0),
    "n_s": Noise(0.003, 10.0),
    "M_g": Noise(0.01, 10.0),
    "M_b": Noise(0.01, 10.0),
    "M_s": Noise(0.01, 10.0),
    "X_f": Noise(0.01, 10.0),
    "E_n": Noise(0.003, 10.0),
}
"""Default noise of a signal whose sensor is not given.

Four reflectors resolve the shaft speed up to about 10 Hz. The speed from the times of their edges, sampled at 2 kHz,
scatters by some tenths of a per cent; the torque of a telemetry gauge scatters by about one per cent.
"""


def sensors_of(given: Mapping[str, Noise] | None, signals: Mapping[str, str]) -> dict[str, Noise]:
    """Sensor noise by output; `InputError` for a signal that the structure does not use, or one without noise."""
    for name in given or {}:
        if name not in signals.values():
            raise InputError(f"sensors: found {name!r}, expected some of {', '.join(signals.values())}")
    known = {**USUAL, **(given or {})}
    for signal in signals.values():
        if signal not in known:
            raise InputError(
                f"sensors: no noise of {signal!r}, expected one; give sensors={{{signal!r}: Noise(...)}}"
            )
    return {output: known[signal] for output, signal in signals.items()}


@dataclass(frozen=True)
class Quantity:
    """Expected value and unit of a quantity, and its derivatives by the free parameters, shape (P,)."""

    value: float
    unit: str
    gradient: Array
    status: Status = "free"


def quantities(subject: Subject, sensitivity: Sensitivity) -> dict[str, Quantity]:
    """Identifiable quantities: parameters first, then combinations of parameters that are not identifiable separately."""
    alone = dict(zip(sensitivity.names, np.linalg.norm(sensitivity.null, axis=0) <= NULL_PART, strict=True))
    found = {
        parameter.name: Quantity(
            subject.values[parameter.name],
            parameter.unit,
            row,
            "free" if parameter.prior is None else "prior",
        )
        for parameter, row in zip(subject.structure.free, np.eye(len(subject.free)), strict=True)
        if alone[parameter.name]
    }
    for name, (unit, function) in COMBINATIONS.items():
        try:
            value = function(subject.values)
            gradient = gradient_of(function, subject.values, subject.free, subject.structure.ties)
        except (KeyError, ZeroDivisionError):
            continue
        joined = any(
            slope and not alone[member] for member, slope in zip(subject.free, gradient, strict=True)
        )
        if joined and sensitivity.tells(gradient):
            found[name] = Quantity(value, unit, gradient)
    return found


MOST_DRAWN = 30
"""Largest number of drawn ships for which a plan predicts the accuracy; each ship takes tens of milliseconds."""
SEED = 1
"""Seed of the noise phases in the predicted record."""


@dataclass(frozen=True)
class Prediction:
    """Expected values with predicted standard deviations, undetermined parameters, and the noise-free record."""

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    identifiability: Identifiability
    experiment: Experiment

    @property
    def relative_pct(self) -> dict[str, float]:
        """Relative standard deviation of each determined quantity whose value is not zero [%]."""
        return {
            name: 100.0 * one.std / abs(one.value)
            for name, one in {**self.parameters, **self.derived}.items()
            if one.std is not None and one.value
        }


def predict(subject: Subject, excitation: Excitation, sensors: Mapping[str, Noise]) -> Prediction:
    """Predict the result of `identify` for a record of this excitation, by the same likelihood."""
    experiment = subject.respond(excitation)
    samples, signals = len(experiment), subject.signals
    # The noise has a smooth spectrum, since the prediction would scatter with randomly drawn noise. Different phases
    # keep the outputs uncorrelated.
    phases = np.random.default_rng(SEED).random(samples // 2 + 1)
    apart = np.arange(len(phases)) / len(signals)
    noisy = {
        name: experiment.signals[name]
        + experiment.operating_point[name]
        * sensors[output].typical(phases + place * apart, samples, excitation.rate_hz)
        for place, (output, name) in enumerate(signals.items())
    }
    accuracy = {name: sensors[output].accuracy for output, name in signals.items()}
    record = dataclasses.replace(
        experiment, signals={**experiment.signals, **noisy}, provenance={"gauge_accuracy": accuracy}
    )
    expected = foresee([record], subject.fitted, values=subject.values)
    return Prediction(expected.parameters, expected.derived, expected.identifiability, experiment)


def spread(
    subject: Subject, excitation: Excitation, sensors: Mapping[str, Noise], draws: Draws
) -> dict[str, tuple[float, float]]:
    """Median and 95 % quantile, over the first drawn ships, of each quantity's relative standard deviation [%]."""
    ships = [
        dataclasses.replace(subject, values=_expected(subject.structure, {**subject.values, **row}))
        for row in draws.sets[:MOST_DRAWN]
    ]
    found = [predict(ship, excitation, sensors).relative_pct for ship in ships]
    told = {name: [one.get(name, math.inf) for one in found] for name in found[0]}
    return {
        name: (
            float(np.quantile(row, 0.5, method="higher")),
            float(np.quantile(row, 0.95, method="higher")),
        )
        for name, row in told.items()
    }


@dataclass(frozen=True)
class Subject:
    """Ship expected in the planned trial."""

    name: str
    structure: Structure
    """Structure that is linear about the operating point."""
    values: Mapping[str, float]
    operating_point: Mapping[str, float]
    vessel: Vessel | None = None
    fitted: Structure | None = None
    """Structure to fit; None: the full ship."""

    @classmethod
    def of(
        cls,
        source: Vessel | Fingerprint | str | Path,
        structure: Structure | None,
        n_e_rpm: float | None,
    ) -> Self:
        """Create the subject from a ship (or its name or file) or from an earlier fingerprint (or its file)."""
        if isinstance(source, str | Path):
            is_result = str(source).endswith(".json")
            source = Fingerprint.load(source) if is_result else Vessel.load(source)
        if isinstance(source, Fingerprint):
            if n_e_rpm is not None:
                raise InputError(
                    f"n_e_rpm is {n_e_rpm:g}, expected none with a fingerprint: it has its own point"
                )
            return cls._of_fingerprint(source, structure or structure_of(source))
        return cls._of_vessel(source, structure, n_e_rpm)

    @classmethod
    def _of_vessel(cls, vessel: Vessel, fitted: Structure | None, n_e_rpm: float | None) -> Self:
        structure = fitted or usual_structure()
        point = steady_state(vessel, n_e_rpm)
        known = true_values(dataclasses.asdict(linearise(vessel, n_e_rpm)))
        return cls(vessel.name, structure, _expected(structure, known), point.levels, vessel, fitted)

    @classmethod
    def _of_fingerprint(cls, fingerprint: Fingerprint, structure: Structure) -> Self:
        point = dict(fingerprint.data[0]["operating_point"]) if fingerprint.data else {}
        for signal in ("n_set", *(candidates[0] for candidates in structure.signals.values())):
            if signal not in point:
                found = ", ".join(point) or "none"
                raise InputError(
                    f"the fingerprint's data have no operating point of {signal!r} (found {found}); "
                    "expected one fitted to an experiment"
                )
        known = fingerprint.settings.get("optimum", {})
        name = f"fingerprint of {fingerprint.vessel or 'a drive train not named'}"
        return cls(name, structure, _expected(structure, known), point, fitted=structure)

    @property
    def signals(self) -> dict[str, str]:
        """Measured signal of each output."""
        return {output: candidates[0] for output, candidates in self.structure.signals.items()}

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(parameter.name for parameter in self.structure.free)

    @property
    def scale(self) -> np.typing.NDArray[np.float64]:
        """Magnitude of each free parameter, by which its deviations are normalised, shape (P,)."""
        return np.array(
            [abs(self.values[parameter.name]) or parameter.scale for parameter in self.structure.free]
        )

    def respond(self, excitation: Excitation) -> Experiment:
        """Response of the expected ship from steady state, without noise."""
        set_point = {"n_set": self.operating_point["n_set"] + excitation.samples}
        bare = Experiment(
            excitation.name,
            excitation.rate_hz,
            set_point,
            self.operating_point,
            hold=excitation.hold,
            kind=excitation.kind,
        )
        plant = self.structure if self.fitted else Structure.ship(torque="gauge")
        rows = plant.equations.simulate({**plant.complete({}), **self.values}, bare)
        measured = {
            signal: self.operating_point[signal] * (row if signal == "E_n" else 1.0 + row)
            for signal, row in zip(self.signals.values(), rows, strict=True)
        }
        return dataclasses.replace(bare, signals=set_point | measured)


def usual_structure() -> Structure:
    """Structure with free propeller exponent, identifiable from speed and a torque gauge between the inertias."""
    return Structure.linear(torque="gauge", products=True, free_exponent=True)


def _expected(structure: Structure, known: Mapping[str, float]) -> dict[str, float]:
    """Expected values: the known ones, or the start value of a parameter that is fixed, unknown or zero."""
    return structure.complete(
        {
            parameter.name: parameter.start
            if parameter.fixed
            else known.get(parameter.name, 0.0) or parameter.start
            for parameter in structure.parameters
        }
    )
