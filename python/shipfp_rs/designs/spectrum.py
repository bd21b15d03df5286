"""Optimal spectra: the share of time, or of power, for each frequency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from shipfp_rs.designs.subject import Noise, Subject, quantities
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identifiability import Sensitivity
from shipfp_rs.signals import Law
from shipfp_rs.support.arrays import Array

Criterion = Literal["D", "A"]

SINE: Mapping[int, float] = {1: 1.0}
SQUARE: Mapping[int, float] = {order: 4.0 / (np.pi * order) for order in (1, 3, 5, 7, 9)}
"""Amplitude of each harmonic relative to the largest deviation; `Prediction` includes harmonics above the ninth, too."""
ITERATIONS = 20_000
TOLERANCE = 1e-3
"""A design is optimal when its efficiency exceeds 1 - `TOLERANCE`."""
SUPPORT = 1e-3
"""Smallest share of a line that is kept, relative to the largest share."""
NEIGHBOURS = 1.001
"""Largest ratio of neighbouring candidates, over the smallest ratio of successive candidates."""


@dataclass(frozen=True)
class Lines:
    """Candidate frequencies of a design, and the information on the parameters that each gives."""

    frequency_hz: Array
    """Frequencies [Hz], shape (F,)."""
    amplitude_rpm: Array
    """Largest amplitude of each line [rpm], shape (F,)."""
    information: Array
    """Information of each line at its largest amplitude, per second, in the r identifiable directions, shape (F, r, r)."""
    goal: Array
    """Matrix (r, r) with which trace(goal covariance) is the sum of relative variances of all identifiable quantities."""
    sensitivity: Sensitivity

    def total(self, shares: Array) -> Array:
        """Information per second of shares (F,) or (..., F), shape (..., r, r)."""
        return np.tensordot(shares, self.information, axes=1)

    def cost(self, shares: Array, criterion: Criterion) -> Array:
        """Cost of a design: det(information)^(-1/r) ("D") or the sum of the relative variances ("A")."""
        total = self.total(shares)
        if criterion == "D":
            sign, logarithm = np.linalg.slogdet(total)
            return np.where(sign > 0, np.exp(-logarithm / total.shape[-1]), np.inf)
        # The cost is infinite if a design does not excite some direction: an inverse would consist of rounding errors,
        # and a pseudo-inverse would give that direction zero variance.
        smallest = np.linalg.eigvalsh(total)
        solvable = smallest[..., 0] > 1e-14 * smallest[..., -1]
        safe = np.where(solvable[..., None, None], total, np.eye(total.shape[-1]))
        return np.where(solvable, np.trace(np.linalg.solve(safe, self.goal), axis1=-2, axis2=-1), np.inf)


def candidates(
    subject: Subject,
    sensors: Mapping[str, Noise],
    frequency_hz: Array,
    amplitude_rpm: Array,
    rate_hz: float,
    shape: Mapping[int, float] = SINE,
) -> Lines:
    """Information on the subject's parameters from a wave of each frequency at its largest amplitude.

    With S the derivatives of the responses with respect to the parameters, the information of T seconds is
    T a^2 Re(S^H G^-1 S) for a set point of relative amplitude a and noise of one-sided density G. `shape` has the
    relative amplitudes of the wave's harmonics.

    Raises
    ------
    InputError
        If the structure has no frequency response, or nothing is identifiable.
    """
    parts = []
    for order, height in shape.items():
        frequency = order * frequency_hz
        _, slopes = subject.structure.equations.response(subject.values, frequency, subject.free)
        density = np.array(
            [sensors[output].density(frequency, rate_hz) for output in subject.structure.outputs]
        )
        relative = np.where(frequency < 0.5 * rate_hz, height, 0.0) * amplitude_rpm
        whitened = slopes * relative / subject.operating_point["n_set"] / np.sqrt(density)
        parts += [whitened.real, whitened.imag]
    rows = np.concatenate(parts, axis=1)  # (W, 2 O harmonics, F)
    sensitivity = Sensitivity.of(rows.reshape(len(rows), -1).T, subject.free, subject.scale)
    if not sensitivity.rank:
        raise InputError(
            f"{subject.name}: the outputs do not depend on any free parameter; nothing to design for"
        )
    told = sensitivity.right[: sensitivity.rank]
    reduced = np.einsum("rw,wof->fro", told * subject.scale, rows)
    return Lines(
        frequency_hz,
        amplitude_rpm,
        np.einsum("fro,fso->frs", reduced, reduced),
        _goal(subject, sensitivity),
        sensitivity,
    )


def optimal_shares(lines: Lines, criterion: Criterion) -> tuple[Array, float]:
    """Shares (F,) of the optimal design, and a lower bound on their efficiency (1 at the optimum)."""
    # The multiplicative algorithm improves the criterion in every step (Yu, Annals of Statistics 38 (2010) 1593,
    # doi:10.1214/09-AOS761). The bound is that of the equivalence theorem (Kiefer and Wolfowitz,
    # doi:10.4153/CJM-1960-030-4).
    shares = np.full(len(lines.frequency_hz), 1.0 / len(lines.frequency_hz))
    efficiency = 0.0
    for _ in range(ITERATIONS):
        gain = _gain(lines, shares, criterion)
        efficiency = 1.0 / float(gain.max())
        if efficiency > 1.0 - TOLERANCE:
            break
        shares = shares * gain ** (1.0 if criterion == "D" else 0.5)
        shares /= shares.sum()
    return shares, efficiency


def support(lines: Lines, shares: Array) -> tuple[Array, Array]:
    """Frequencies [Hz] and shares of a design, with neighbouring candidates merged into one line."""
    # If the optimum is between two candidates, both have a share. The waveform of the merged line has a lower peak.
    runs: list[list[int]] = []
    frequency = lines.frequency_hz
    # Candidates on either side of an excluded band are not neighbours.
    beside = NEIGHBOURS * np.min(frequency[1:] / frequency[:-1])
    for index in np.flatnonzero(shares > SUPPORT * shares.max()):
        if runs and runs[-1][-1] == index - 1 and frequency[index] < beside * frequency[index - 1]:
            runs[-1].append(int(index))
        else:
            runs.append([int(index)])
    weight = np.array([shares[run].sum() for run in runs])
    middle = [np.average(np.log(frequency[run]), weights=shares[run]) for run in runs]
    return np.exp(middle), weight / weight.sum()


def best_sweep(lines: Lines, criterion: Criterion) -> tuple[float, float, Law]:
    """Start, stop [Hz] and law of the most informative chirp that starts and ends at candidates."""
    width = np.gradient(lines.frequency_hz)
    laws: tuple[tuple[Law, Array], ...] = (("logarithmic", width / lines.frequency_hz), ("linear", width))
    found: list[tuple[float, float, float, Law]] = []
    for law, dwell in laws:
        for stop in range(3, len(width) + 1):
            # The amplitude of a chirp is the largest permitted at its highest frequency; the information at the other
            # frequencies is rescaled to it.
            part = dwell[:stop] * (lines.amplitude_rpm[stop - 1] / lines.amplitude_rpm[:stop]) ** 2
            starts = np.triu(np.ones((stop, stop)))[: stop - 2]
            shares = np.zeros((len(starts), len(width)))
            shares[:, :stop] = starts * part / (starts * dwell[:stop]).sum(axis=1, keepdims=True)
            cost = lines.cost(shares, criterion)
            start = int(np.argmin(cost))
            ends = float(lines.frequency_hz[start]), float(lines.frequency_hz[stop - 1])
            found.append((float(cost[start]), *ends, law))
    return min(found)[1:]


def _gain(lines: Lines, shares: Array, criterion: Criterion) -> Array:
    """Gain of the criterion per share of each line, relative to the mean over the design; at most 1 at the optimum."""
    total = lines.total(shares)
    inverse = np.linalg.inv(total)
    weight = inverse if criterion == "D" else inverse @ lines.goal @ inverse
    gain = np.einsum("fij,ji->f", lines.information, weight)
    return np.asarray(gain / np.sum(total * weight))


def _goal(subject: Subject, sensitivity: Sensitivity) -> Array:
    """Sum of the outer products of the relative gradients of all identifiable parameters and combinations."""
    told = sensitivity.right[: sensitivity.rank]
    relative = [
        quantity.gradient * subject.scale / (quantity.value or 1.0)
        for quantity in quantities(subject, sensitivity).values()
    ]
    rows = np.array(relative).reshape(-1, len(subject.free)) @ told.T
    # A user's structure may have combinations without a name.
    return np.asarray(rows.T @ rows) if len(rows) >= sensitivity.rank else np.eye(sensitivity.rank)
