"""The load's equation by two-stage least squares: spectra of speed and torque, instruments from set point and load.

Lag filters of the inputs explain the speed. The explained speed is the instrument for the load's law, whose noise is
coloured. Smooth errors of the torque's response are unknowns with a prior (Kennedy and O'Hagan 2001,
doi:10.1111/1467-9868.00294).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from shipfp_rs.errors import InputError
from shipfp_rs.identification.likelihood import ACCURACY, noise_root
from shipfp_rs.identification.question import LAW_DEVIATION, PRIORS
from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.support.arrays import Array, ComplexArray

SCALE_DEVIATION, LATEST_S = 0.02, 0.02
"""Prior deviation of the torque's scale, and largest delay of a torque [s]. The scale is uncertain since the torque is
relative to a mean over a minute of moving water."""
SOFT_HZ, FROM_SHAFT = 5.5, 0.6
"""Prior of the twist: natural frequency [Hz] of the shaft whose compliance is one prior standard deviation, and share of
the inertia on the engine's side."""
BEHIND, BEHIND_DEVIATION, BEHIND_ENDS = 0.4, 0.12, (0.1, 0.8)
"""Share of the inertia behind a shaft that twists, for an engine torque; its prior deviation and range."""
BANDWIDTHS, DEAD_TIMES_S = np.geomspace(0.2, 30.0, 16), np.arange(0.0, 1.2, 0.1)
"""Bandwidths [rad/s] and dead times [s] of the first-order loops that are compared with the speed's response."""
POLES, ORDER = (0.35, 1.0, 3.0), 4
"""Poles of the Laguerre filters, relative to the loop's bandwidth, and number of filters per pole."""
INERTIA = (0.05, 5.0)
"""Range of the inertia [s] that scales the prior of the shaft's compliance."""
FIXED = 1e-6
"""Prior deviation of a known quantity."""
EXPLAINED, LEAST_EXPLAINED = 0.995, 0.1
"""Share of the explained acceleration's power that is below the highest used frequency; least explained share of the
speed."""
MOST_HZ = 1.5
"""Highest used frequency [Hz]; above it twist and delay of the torque matter more than load and inertia."""
SOFTEST, SOFT_BELOW = 0.6, 0.25
"""Bound of the twist, as squared ratio of the highest frequency to the inertia's resonance; share allowed below zero."""
ROUNDS, PATIENCE, STILL, CLOSE = 40, 8, 0.02, 0.5
"""Most iterations, and most of them before the instrument is updated; largest step of the last iteration, and of the last
before the update, in standard deviations."""
SHARED = ("p", "tau", "c_2", "T_M", "tau_twist", "behind", "k_L")
"""Unknowns that all records share; the torque scale of each record and the smooth errors follow them."""


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
        self.noise = self.M

    @cached_property
    def _bandwidth(self) -> float:
        """Bandwidth [rad/s] of the first-order loop with dead time whose response explains most of the speed."""
        best = [np.zeros(len(BANDWIDTHS))]
        for driver, power in ((self.set_point, 1), (self.load, 2)):
            if driver is not None:
                # The speed recovers after a change of load.
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
        """Explain the speed by the filtered inputs, weighted by frequency (F,), with the best dead time of the set point."""
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
        own = np.array((LAW_DEVIATION, PRIORS["T_M"][1], np.inf, FIXED if gauge else BEHIND_DEVIATION))
        deviations[: len(SHARED)] = (np.inf, np.inf, *own, FIXED if records[0].load is None else np.inf)
        self.prior = np.concatenate([deviations**-2.0, np.ones(2 * len(knots))])
        self.start = np.zeros(self.main)
        self.start[: len(SHARED)] = (
            1.5,
            0.5,
            0.0,
            0.0,
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
        """Return the unknowns (U,) without smooth errors, and their covariance (U, U).

        Raises
        ------
        InputError
            If set point and load explain almost nothing of the speed.
        """
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
        self.x, self.inverse = x, inverse
        return x, spread[: self.main, : self.main]

    def influence(self, unknown: int, index: int) -> ComplexArray:
        """Influence of an unmodelled torque on an estimated unknown, at each frequency of a record (F,)."""
        record, hats, x = self.records[index], self.hats[index], self.x
        told, B = self._columns(x, record, record.Z, record.s * record.Z)
        along = self.inverse[unknown]
        amplitude, phase = along[self.main :].reshape(2, -1)
        found = along[[*range(len(SHARED)), len(SHARED) + index]] @ B
        found += self.accuracy * told * ((amplitude + 1j * phase) @ hats)
        found[record.count :] = 0.0
        return np.asarray(found * record.weight**2)

    def answer_to(self, speed: ComplexArray, index: int) -> ComplexArray:
        """Response of the load's torque to a small deviation of the speed, (F,)."""
        return self._columns(self.x, self.records[index], speed, self.records[index].s * speed)[0]

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
        self._normal(x)
        self._weigh(np.zeros(len(self.prior)), 1.0)
        return x

    def _step(self, x: Array, normal: Array, right: Array, found: Array) -> Array:
        """Keep delay and twist of a step within their bounds, since fast motions that no set point explains mislead them."""
        fastest = max(abs(record.s[record.count - 1]) for record in self.records)
        most = SOFTEST / (x[5] * max(abs(x[1] + found[1]), 0.05) * fastest**2)
        bounds = {3: (-LATEST_S, LATEST_S), 4: (-SOFT_BELOW * most, most), 5: self.behind_ends}
        moved = {at: float(np.clip(x[at] + found[at], *ends) - x[at]) for at, ends in bounds.items()}
        held = np.array([at for at in bounds if moved[at] != found[at]], int)
        if len(held):
            free = np.setdiff1d(np.arange(len(found)), held)
            found = np.array(found)
            found[held] = [moved[int(at)] for at in held]
            rest = right[free] - normal[np.ix_(free, held)] @ found[held]
            found[free] = np.linalg.solve(normal[np.ix_(free, free)], rest)
        found[: self.main] = np.clip(found[: self.main], -0.5, 0.5)
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
        """Normal matrix and right side, priors included; with `instruments`, the matrix of the instruments by themselves."""
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
        """Modelled spectrum of the torque, without smooth errors, (F,)."""
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
            record.noise = record.left - own @ record.A - smooth
            root = np.abs(noise_root(record.noise[None])[:, 0, 0])
            record.weight = root**share * record.weight ** (1.0 - share)


def _products(B: ComplexArray, told: ComplexArray, A: ComplexArray, bent: ComplexArray, hats: Array) -> Array:
    """Real products of two sets of columns, each extended by smooth errors: hats times `told` or `bent`, also times i."""
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
