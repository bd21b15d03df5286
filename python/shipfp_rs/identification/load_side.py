"""Fit of the load alone: p and the inertia behind the torque sensor, from speed and torque without a model of the governor.

    M = N^p + c_2 (N - 1)^2 + tau dN/dt, delayed by T_M, relative to the operating point

Least squares are biased, since the speed has noise, and since moving water disturbs speed and torque together. One part of
the speed is free of noise and disturbance: the part that a few fixed lags of the set point, or of a measured load, explain.
It is the instrument of two-stage least squares (Söderström and Stoica 1983) with coloured noise, on spectra of speed and
torque. Since no governor, limit or actuator is modelled, errors of their models do not matter. Systematic errors of the
torque's response are unknowns with a prior (Kennedy and O'Hagan 2001, doi:10.1111/1467-9868.00294).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import DRIVES, Experiment
from shipfp_rs.identification.estimate import Estimate, rounded_rows, scaled, with_interval
from shipfp_rs.identification.input_checks import is_loaded, require_plausible
from shipfp_rs.identification.likelihood import ACCURACY
from shipfp_rs.identification.noise import noise_root
from shipfp_rs.identification.question import BOUNDS, PRIORS, SIGNALS, Question, within_reach
from shipfp_rs.identification.sampling import LEAST_SWING
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.structures.parameter import Torque
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.threads import with_one_blas_thread
from shipfp_rs.vessel.vessel import Vessel

SCALE_DEVIATION = 0.02
"""Prior standard deviation of the torque's scale. The scale is uncertain since the torque is relative to a mean over a
minute in moving water."""
SOFT_HZ, FROM_SHAFT = 5.5, 0.6
"""Prior of the shaft's torsional compliance: natural frequency [Hz] of the shaft whose compliance is one prior standard
deviation, and share of the inertia on the engine's side."""
BEHIND, BEHIND_DEVIATION, BEHIND_ENDS = 0.4, 0.12, (0.1, 0.8)
"""Share of the inertia behind a torsionally flexible shaft, for torque of the engine; its prior deviation and range."""
BANDWIDTHS, DEAD_TIMES_S = np.geomspace(0.2, 30.0, 16), np.arange(0.0, 1.2, 0.1)
"""Bandwidths [rad/s] and dead times [s] of the first-order loops that are compared with the speed's response."""
POLES, ORDER = (0.35, 1.0, 3.0), 4
"""Poles of the Laguerre filters, relative to the loop's bandwidth, and number of filters per pole."""
INERTIA = (0.05, 5.0)
"""Range of the inertia [s] that scales the prior of the shaft's compliance."""
FIXED = 1e-6
"""Prior standard deviation of a quantity that is held at a known value."""
EXPLAINED, LEAST_EXPLAINED = 0.995, 0.1
"""Share of the explained acceleration's power that is below the highest used frequency; least explained share of the
speed."""
MOST_HZ = 1.5
"""Highest used frequency [Hz]; above it the shaft's flexibility and the torque's delay matter more than load and inertia."""
SOFTEST, SOFT_BELOW = 0.6, 0.25
"""Bound of the torsional compliance, as squared ratio of the highest frequency to the inertia's resonance; share of that
bound allowed below zero."""
LONGEST = 0.5
"""Largest step of an unknown; for an inertia above 1 s, relative to its value."""
ROUNDS, PATIENCE, STILL, CLOSE = 40, 8, 0.02, 0.5
"""Most iterations; most iterations before the instrument is updated; largest step, in standard deviations, of the last
iteration, and of the last before the update."""
SHARED = ("p", "tau", "c_2", "T_M", "tau_twist", "behind", "k_L")
"""Unknowns that all records share; the torque scale of each record and the systematic errors follow them."""


class Record:
    """Spectra of an experiment (F,), the component of the speed that its inputs explain, and weights of the frequencies."""

    def __init__(self, data: Spectra) -> None:
        speed, torque = (data.decimated[data.outputs.index(name)] for name in ("dn", "dM"))
        self.s = 2j * np.pi * data.frequency_hz[data.frequency_hz <= MOST_HZ]
        kept = slice(len(self.s))
        self.N, fading = data.tapered(speed, 2)[:, kept]
        self.slope = self.s * self.N - fading
        self.N2, self.N3, self.M, self.one = (
            data.tapered(row, 1)[0, kept] for row in (speed**2, speed**3, torque, np.ones_like(speed))
        )
        set_point, load = data.inputs()
        self.set_point, self.load = set_point[kept], None if load is None else load[kept]
        self.weight = np.ones(len(self.s))
        self.Z, self.count, self.share = self.N, len(self.s), 1.0
        self.left, self.answer, self.A = self.M, self.N, np.empty((0, len(self.s)), complex)

    @cached_property
    def _bandwidth(self) -> float:
        """Bandwidth [rad/s] of the first-order loop with dead time whose response explains most of the speed."""
        best = [np.zeros(len(BANDWIDTHS))]
        for driver, power in ((self.set_point, 1), (self.load, 2)):
            if driver is not None:
                # After a change of load the speed returns to its set point, hence the factor s.
                shapes = (
                    driver * (self.s if power == 2 else 1.0) / (1.0 + self.s / BANDWIDTHS[:, None]) ** power
                )
                along = ((shapes.conj() * self.N) @ self._early.T).real
                best.append((along**2).max(axis=1) / np.maximum(np.sum(np.abs(shapes) ** 2, axis=1), 1e-300))
        return float(BANDWIDTHS[np.argmax(np.sum(best, axis=0))])

    @cached_property
    def _early(self) -> ComplexArray:
        """Factors that compensate each dead time, (D, F)."""
        return np.asarray(np.exp(self.s * DEAD_TIMES_S[:, None]))

    @cached_property
    def _lags(self) -> tuple[ComplexArray, ComplexArray]:
        """Set point, and load if measured, each passed through the lag filters, (C, F)."""
        load = np.empty((0, len(self.s)), complex) if self.load is None else self._lagged(self.load)
        return self._lagged(self.set_point), load

    def _lagged(self, driver: ComplexArray) -> ComplexArray:
        columns = [driver]
        for pole in self._bandwidth * np.array(POLES):
            around = (1.0 - self.s / pole) / (1.0 + self.s / pole)
            columns.append(driver / (1.0 + self.s / pole))
            for _ in range(ORDER - 1):
                columns.append(columns[-1] * around)
        return np.array(columns)

    def explain(self, weight: Array) -> None:
        """Fit the speed by the filtered inputs, weighted by frequency (F,), with the best dead time of the set point."""
        first, rest = (columns * weight for columns in self._lags)
        target, best = self.N * weight, (-1.0, np.empty(0), rest)
        for early in self._early if len(rest) else self._early[:1]:
            columns = np.concatenate([first * early.conj(), rest])
            square = _along(columns, columns)
            sizes = np.sqrt(np.maximum(np.diag(square), 1e-300))
            values, vectors = np.linalg.eigh(square / np.outer(sizes, sizes))
            turn = vectors * np.where(
                values > 1e-12 * values[-1], 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0
            )
            # If only the set point drives the ship, one Gram matrix serves all dead times.
            tried = np.ones((1, len(weight))) if len(rest) else self._early
            along = ((columns.conj() * target) @ tried.T).real / sizes[:, None]
            scores = turn.T @ along
            place = int(np.argmax(np.sum(scores**2, axis=0)))
            told = float(np.sum(scores[:, place] ** 2))
            if told > best[0]:
                best = told, turn @ scores[:, place] / sizes, columns * tried[place].conj()
        told, x, columns = best
        self.Z = (x @ columns) / np.where(weight > 0.0, weight, 1.0)
        self.share = told / max(float(np.sum(np.abs(target) ** 2)), 1e-300)


class Fit:
    """Two-stage least squares of records (R), weighted by the noise in their residuals."""

    def __init__(self, records: Sequence[Record], gauge: bool, accuracy: float = ACCURACY) -> None:
        self.records, self.accuracy = records, accuracy
        lowest = min(record.s[1].imag for record in records)
        octaves = [np.log2(np.maximum(record.s.imag, 0.5 * lowest) / lowest) for record in records]
        knots = np.arange(-1.0, max(row[-1] for row in octaves) + 1.0)
        self.hats = [np.maximum(1.0 - np.abs(row - knots[:, None]), 0.0) for row in octaves]
        self.main = len(SHARED) + len(records)
        deviations = np.full(self.main, SCALE_DEVIATION)
        own = np.array((PRIORS["c_2"][1], PRIORS["T_M"][1], np.inf, FIXED if gauge else BEHIND_DEVIATION))
        deviations[: len(SHARED)] = (np.inf, np.inf, *own, FIXED if records[0].load is None else np.inf)
        self.prior = np.concatenate([deviations**-2.0, np.ones(2 * len(knots))])
        self.start = np.zeros(self.main)
        self.start[: len(SHARED)] = (
            1.5,
            0.5,
            0.0,
            PRIORS["T_M"][0],
            0.0,
            1.0 if gauge else BEHIND,
            records[0].load is not None,
        )
        self.behind_ends = (1.0, 1.0) if gauge else BEHIND_ENDS

    def _columns(
        self, x: Array, record: Record, V: ComplexArray, slope: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Linear torque response to a speed (F,), and its derivatives by the shared unknowns and the scale (8, F)."""
        p, tau, _, late, twist, behind, k = x[: len(SHARED)]
        way = np.exp(-record.s * late)
        through = p + behind * tau * record.s
        soft = 1.0 / (1.0 + twist * record.s * through)
        bent = p * V + behind * tau * slope
        linear = (bent * soft + (1.0 - behind) * tau * slope) * way
        load = np.zeros_like(V) if record.load is None else record.load * way
        answer = linear + k * load
        rows = [
            V * soft**2 * way + (p - 0.5) * record.N2,
            slope * (behind * soft**2 + 1.0 - behind) * way,
            record.N2,
            -record.s * answer,
            -record.s * through * bent * soft**2 * way,
            tau * (slope * (soft - 1.0) - twist * record.s**2 * bent * soft**2) * way,
            load,
            answer + record.one,
        ]
        return answer, np.array(rows)

    def found(self) -> tuple[Array, Array]:
        """Return the unknowns (U,) without systematic errors, and their covariance (U, U)."""
        x = self._begun()
        self._instruments(x)
        again = False
        for turn in range(ROUNDS):
            normal, right = self._normal(x)
            inverse = np.linalg.inv(normal)
            found = self._step(x, normal, right, inverse @ right)
            deviations = np.sqrt(np.maximum(np.diag(inverse), 0.0))[: self.main]
            close = bool(np.all(np.abs(found[: self.main]) <= (STILL if again else CLOSE) * deviations))
            x = x + found[: self.main]
            if again and close:
                break
            self._weigh(found, 1.0 if turn < PATIENCE else 0.5)
            if not again and (close or turn == PATIENCE):
                self._instruments(x)
                again = True
        spread = inverse @ self._normal(x, instruments=True)[0] @ inverse.T
        return x, spread[: self.main, : self.main]

    def _begun(self) -> Array:
        """Starting values by least squares of torque on speed and acceleration, and weights from their residuals."""
        x, square, along = np.array(self.start), np.zeros((2, 2)), np.zeros(2)
        for record in self.records:
            rows = np.array([record.N, record.slope])
            load = 0.0 if record.load is None else record.load
            square += _along(rows, rows)
            along += _along(rows, (record.M - load)[None])[:, 0]
        x[:2] = np.linalg.lstsq(square, along, rcond=1e-12)[0]
        behind = x[5] * np.clip(x[1], *INERTIA)
        self.prior[4] = ((2.0 * np.pi * SOFT_HZ) ** 2 * FROM_SHAFT * behind) ** 2
        x[4] = self.prior[4] ** -0.5  # started from a stiff shaft, the delay would explain a soft one
        self._normal(x)
        self._weigh(np.zeros(len(self.prior)), 1.0)
        return x

    def _step(self, x: Array, normal: Array, right: Array, found: Array) -> Array:
        """Return a step that keeps delay and compliance within bounds, since fast unexplained motions mislead them."""
        fastest = max(abs(record.s[record.count - 1]) for record in self.records)
        most = SOFTEST / (x[5] * max(abs(x[1] + found[1]), 0.05) * fastest**2)
        bounds = {
            3: within_reach(BOUNDS["T_M"], PRIORS["T_M"]),
            4: (-SOFT_BELOW * most, most),
            5: self.behind_ends,
        }
        moved = {at: float(np.clip(x[at] + found[at], *ends) - x[at]) for at, ends in bounds.items()}
        held = np.array([at for at in bounds if moved[at] != found[at]], int)
        if len(held):
            free = np.setdiff1d(np.arange(len(found)), held)
            found = np.array(found)
            found[held] = [moved[int(at)] for at in held]
            rest = right[free] - normal[np.ix_(free, held)] @ found[held]
            found[free] = np.linalg.solve(normal[np.ix_(free, free)], rest)
        reach = np.full(self.main, LONGEST)
        reach[1] *= max(abs(x[1]), 1.0)
        found[: self.main] = np.clip(found[: self.main], -reach, reach)
        return found

    def _instruments(self, x: Array) -> None:
        for record in self.records:
            size = np.maximum(np.abs(x[0] + x[1] * record.s), 0.1)
            record.explain(record.weight / size)
            power = np.cumsum(np.abs(record.s * record.Z) ** 2)
            record.count = int(np.searchsorted(power, EXPLAINED * power[-1])) + 1
        if max(record.share for record in self.records) < LEAST_EXPLAINED:
            raise InputError(
                "load_side: set point and load explain next to nothing of the speed, expected some: nothing excites the ship"
            )

    def _normal(self, x: Array, *, instruments: bool = False) -> tuple[Array, Array]:
        """Normal matrix and right side, priors included; with `instruments`, the matrix of the instruments alone."""
        size = len(self.prior)
        normal, right = np.diag(self.prior), np.zeros(size)
        right[: self.main] = self.prior[: self.main] * (self.start - x)
        for index, (record, hats) in enumerate(zip(self.records, self.hats, strict=True)):
            kept = slice(record.count)
            own = [*range(len(SHARED)), len(SHARED) + index, *range(self.main, size)]
            told, B = self._columns(x, record, record.Z, record.s * record.Z)
            w = record.weight[kept]
            B, told, hats = B[:, kept] * w, self.accuracy * told[kept] * w, hats[:, kept]
            if instruments:
                normal[np.ix_(own, own)] += _products(B, told, B, told, hats)
                continue
            answer, A = self._columns(x, record, record.N, record.slope)
            left = record.M - self._torque(x, record, answer, x[len(SHARED) + index])
            record.A, record.answer, record.left = A, answer, left
            normal[np.ix_(own, own)] += _products(
                B, told, A[:, kept] * w, self.accuracy * answer[kept] * w, hats
            )
            smooth = told.conj() * (left[kept] * w)
            along = _along(B, left[None, kept] * w)[:, 0]
            right[own] += np.concatenate([along, hats @ smooth.real, hats @ smooth.imag])
        return normal, right

    def _torque(self, x: Array, record: Record, answer: ComplexArray, scale: float) -> ComplexArray:
        """Modelled spectrum of the torque, without systematic errors, (F,)."""
        p, c_2 = x[0], x[2]
        curved = (p * (p - 1.0) / 2.0 + c_2) * record.N2 + p * (p - 1.0) * (p - 2.0) / 6.0 * record.N3
        return np.asarray((1.0 + scale) * (answer + curved) + scale * record.one)

    def _weigh(self, found: Array, share: float) -> None:
        """Update the frequency weights from the residuals of a step; `share` is the weight of the new noise."""
        knots = len(self.hats[0])
        amplitude, phase = found[self.main :].reshape(2, knots)
        for index, (record, hats) in enumerate(zip(self.records, self.hats, strict=True)):
            own = found[[*range(len(SHARED)), len(SHARED) + index]]
            smooth = self.accuracy * record.answer * ((amplitude + 1j * phase) @ hats)
            noise = record.left - own @ record.A - smooth
            root = np.abs(noise_root(noise[None])[:, 0, 0])
            record.weight = root**share * record.weight ** (1.0 - share)


def _products(B: ComplexArray, told: ComplexArray, A: ComplexArray, bent: ComplexArray, hats: Array) -> Array:
    """Real inner products of columns (B, told * hats, i * told * hats) with (A, bent * hats, i * bent * hats)."""
    main, knots = len(B), len(hats)
    product = np.empty((main + 2 * knots,) * 2)
    product[:main, :main] = _along(B, A)
    for part, at in ((bent, main), (1j * bent, main + knots)):
        product[:main, at : at + knots] = (B.conj() * part).real @ hats.T
    for part, at in ((told, main), (1j * told, main + knots)):
        product[at : at + knots, :main] = hats @ (part.conj() * A).real.T
    both = told.conj() * bent
    real, imaginary = (hats * both.real) @ hats.T, (hats * both.imag) @ hats.T
    product[main:, main:] = np.block([[real, -imaginary], [imaginary, real]])
    return product


def _along(B: ComplexArray, A: ComplexArray) -> Array:
    """Real part of conj(B) times A, for each pair of rows."""
    return np.asarray(np.ascontiguousarray(B).view(float) @ np.ascontiguousarray(A).view(float).T)


QUANTITIES: Mapping[str, str] = {"tau_n": "inertia", "tau_prop": "propeller_inertia"}
"""Names of the inertias in SI units, as in `assessment.si`."""
QUANTILE = 1.959964
"""Quantile of the normal distribution for 95 % intervals."""


@dataclass(frozen=True)
class LoadRecord:
    """One experiment: its torque's scale, explained share of the speed, and highest frequency that counts [Hz]."""

    name: str
    torque_scale: Estimate
    explained: float
    band_hz: float


@dataclass(frozen=True, eq=False)
class LoadSide:
    """The load's law and the inertia behind the torque sensor; see `load_side`.

    `parameters` has p, c_2, T_M, "tau_prop" behind a gauge or "tau_n" at the brake, "k_L" with a measured load, and
    "torque scale" where there is one experiment. `covariance` (P, P) is in their order. `si` is the inertia in kg m2, with
    its reference shaft.
    """

    torque: Torque
    parameters: Mapping[str, Estimate]
    covariance: Array
    records: tuple[LoadRecord, ...]
    si: Mapping[str, Mapping[str, Any]]

    @property
    def law(self) -> dict[str, float]:
        """Exponent p [-] and inertia "tau" [s] behind the torque sensor, for starting values of a search."""
        p, tau = (
            self.parameters[name].value for name in ("p", "tau_prop" if self.torque == "gauge" else "tau_n")
        )
        assert p is not None
        assert tau is not None
        return {"p": p, "tau": max(tau, 0.01)}

    def __repr__(self) -> str:
        rows = [
            f"{row.name} {row.value} ± {row.std}{' s' if row.unit == 's' else ''}"
            for row in rounded_rows(self.parameters)
        ]
        return f"LoadSide({self.torque}: {'; '.join(rows)})"


@checked
@with_one_blas_thread
def load_side(
    experiments: Experiment | Sequence[Experiment],
    *,
    torque: Torque | None = None,
    vessel: Vessel | str | Path | None = None,
) -> LoadSide:
    """Identify the load from speed and torque, without a model of drive and governor.

    Parameters
    ----------
    experiments
        One experiment, or several experiments of one ship, which are fitted together. Each experiment has N samples of a set
        point (or command), a speed and a torque, over 20 s or more. A load that every experiment measured is an input, too.
    torque
        Location of the torque sensor: "gauge" between the inertias, or "brake" of the engine; None: by the signal, brake
        first.
    vessel
        Vessel as an object, name or file, whose gear ratio and efficiency give the inertia in kg m2. Without a vessel the
        inertia in kg m2 is known only for a torque M_b, referred to the engine.

    Returns
    -------
    LoadSide
        p [-], c_2 [-], delay T_M [s], torque scale [-] and tau_prop or tau_n [s] with 95 % intervals, normalised by the
        operating point, and the inertia J = tau M_0 / (2 pi n_0), n_0 in rev/s.

    Raises
    ------
    InputError
        If speed or torque was not measured, a channel does not fit its name, or nothing excites the ship.

    Notes
    -----
    Instruments: Söderström and Stoica 1983, "Instrumental Variable Methods for System Identification", Springer. Inertia:
    eq. 3.23 of the thesis. The model allows for torsional flexibility of the shaft and, as in `identify`, for systematic
    errors of the torque's response, which vary slowly with frequency. Where N^p is not the load's law, p is the law's slope
    at the operating point.
    """
    several = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    if not several:
        raise InputError("load_side: no experiment, expected one or more")
    speed, signal, side = _signals(several, torque)
    loaded = is_loaded(several)
    _require_excitation(several, loaded)
    require_plausible(several)
    spectra = [
        Spectra.of(one, ("dn", "dM"), np.array([_measured(one, speed), _measured(one, signal)]), load=loaded)
        for one in several
    ]
    return _told(several, spectra, speed, signal, side, vessel)


def _told(
    several: Sequence[Experiment],
    spectra: Sequence[Spectra],
    speed: str,
    signal: str,
    side: Torque,
    vessel: Vessel | str | Path | None = None,
) -> LoadSide:
    """Return the load identified from the records of experiments."""
    loaded = bool(len(spectra[0].load))
    accuracy = max(one.gauge_accuracy.get(signal, ACCURACY) for one in several)
    fit = Fit([Record(one) for one in spectra], side == "gauge", accuracy)
    x, covariance = fit.found()
    if x[1] + 3.0 * np.sqrt(covariance[1, 1]) < 0.0:
        raise InputError(
            f"load_side: {signal} falls while the shaft speeds up, expected it to rise; reverse the sign of its scale"
        )
    low, high = BOUNDS["p"]
    if not low < x[0] < high:
        raise InputError(
            f"load_side: {signal} varies as {speed} to the power {x[0]:.3g}, expected {low:g} to {high:g}; check both "
            "calibrations"
        )
    inertia = "tau_prop" if side == "gauge" else "tau_n"
    told = {"p": 0, "c_2": 2, inertia: 1, "T_M": 3} | ({"k_L": 6} if loaded else {})
    scales = [_estimate(x, covariance, len(SHARED) + index) for index in range(len(several))]
    parameters = {name: _estimate(x, covariance, at, name) for name, at in told.items()}
    if len(several) == 1:
        told["torque scale"], parameters["torque scale"] = len(SHARED), scales[0]
    places = list(told.values())
    records = tuple(
        LoadRecord(one.name, scale, record.share, float(one.frequency_hz[record.count - 1]))
        for one, record, scale in zip(spectra, fit.records, scales, strict=True)
    )
    si = _si(several, speed, signal, QUANTITIES[inertia], parameters[inertia], vessel)
    return LoadSide(side, parameters, covariance[np.ix_(places, places)], records, si)


def load_side_of(question: Question, records: Sequence[Spectra] | None = None) -> LoadSide | None:
    """Return the load from speed and torque of a question's experiments alone; None if these do not suffice."""
    # `records` are corrected by a model: images of the set point are removed, and gaps are filled.
    if "dM" not in question.outputs:
        return None
    side: Torque = "gauge" if question.gauge else "brake"
    try:
        if records is None:
            return load_side(question.experiments, torque=side)
        speed, signal = (question.signal_in(question.experiments[0], output) for output in ("dn", "dM"))
        return _told(question.experiments, records, speed, signal, side)
    except (InputError, np.linalg.LinAlgError):
        return None


def _signals(experiments: Sequence[Experiment], torque: Torque | None) -> tuple[str, str, Torque]:
    """Names of speed and torque, and location of the torque sensor."""
    common = set.intersection(*(set(one.signals) for one in experiments))
    speed = next((name for name in ("n_e", "n_s") if name in common), None)
    if speed is None:
        raise InputError("load_side: no experiment has a speed, expected the signal n_e or n_s in each")
    measured = [name for name in SIGNALS if name in common]
    signal = next((name for name in measured if torque in (None, SIGNALS[name])), next(iter(measured), None))
    if signal is None:
        raise InputError(f"load_side: no torque in every experiment, expected one of {', '.join(SIGNALS)}")
    return speed, signal, torque or SIGNALS[signal]


def _measured(experiment: Experiment, name: str) -> Array:
    values = experiment.normalised(name)
    if not np.isfinite(values).any():
        raise InputError(f"experiment {experiment.name!r}: every sample of {name} is masked, expected some")
    return values


def _require_excitation(experiments: Sequence[Experiment], loaded: bool) -> None:
    for one in experiments:
        swing = max(np.std(one.dn_set), np.std(one.normalised("M_load")) if loaded else 0.0)
        if not swing >= LEAST_SWING:
            raise InputError(
                f"experiment {one.name!r}: the {DRIVES[one.driver]} moves by {100 * swing:.2g} %, expected "
                f"{100 * LEAST_SWING:g} % or more, or a measured load that moves as much: nothing excites the ship"
            )


def _estimate(x: Array, covariance: Array, at: int, name: str = "") -> Estimate:
    value, std = float(x[at]), float(np.sqrt(covariance[at, at]))
    value += at >= len(SHARED)
    known = name in PRIORS or at >= len(SHARED)
    unit = "s" if name.startswith(("tau", "T_")) else "-"
    interval = (value - QUANTILE * std, value + QUANTILE * std)
    return with_interval(value, interval, unit, "prior" if known else "free", quantile=QUANTILE)


def _si(
    experiments: Sequence[Experiment],
    speed: str,
    signal: str,
    name: str,
    tau: Estimate,
    vessel: Vessel | str | Path | None,
) -> dict[str, dict[str, Any]]:
    """Inertia in kg m2, referred to the propeller shaft with a vessel, else to the engine if M_b is measured; else empty."""
    if vessel is None and signal != "M_b":
        return {}
    rpm, moment = (abs(np.mean([one.operating_point[key] for one in experiments])) for key in (speed, signal))
    seen_from = "engine"
    if vessel is not None:
        ship = vessel if isinstance(vessel, Vessel) else Vessel.load(vessel)
        rpm, seen_from = rpm / ship.gearbox.ratio, "propeller shaft"
        moment *= ship.torque_ratio if signal == "M_b" else 1.0
    factor = float(moment / (2.0 * math.pi * rpm / 60.0))
    return {name: scaled(tau, factor, "kg m2") | {"seen_from": seen_from}}
