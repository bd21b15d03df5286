"""Starts from the data: torque against speed, then the loop's delays and gains by regression over a grid of delays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, sosfiltfilt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array

PASS_HZ = (1.0, 3.0)
"""Low-passes that derivatives are taken behind [Hz]: a slow one for noisy speeds, a fast one for short delays."""
EDGE_S = 2.0
"""What is left out at both ends of a record, where the low-pass has no neighbours [s]."""
LOOP_S = np.append(np.arange(0.0, 0.2, 0.02), np.arange(0.2, 0.41, 0.05))
"""Delays of the loop that are tried [s]."""
BANDS_S = ((0.0, 0.07), (0.07, 0.19), (0.19, 1.0))
"""Dead times in the loop of which each band gives a start: the data may tell only their sum with the set point's [s]."""
SET_POINT_S = np.append(np.arange(0.0, 0.5, 0.05), np.arange(0.5, 1.6, 0.1))
"""Delays of the set point beyond the loop's that are tried [s]."""
ROWS = 6000
"""Rows of the regression at most, all experiments together."""
LEAST_START_S = 0.01
"""Least dead time of the loop to start from [s]: on its bound a search has nowhere to go."""
G = -0.5
"""Slope of the engine's torque that stands in where the speed alone tells (p - g) / tau_n only."""


@dataclass(frozen=True)
class _Record:
    """One experiment's smoothed speed deviation, its slope, set point, torque, and both signals' integrals, (N,)."""

    step: float
    speed: Array
    slope: Array
    set_point: Array
    torque: Array | None
    load: Array
    """Deviation of a measured load; zero without one."""
    keep: npt.NDArray[np.intp]
    """Samples that the regressions use."""


LIGHTEST_ENGINE = 0.05
"""Least part of the inertia that is on the engine's end of a shaft that twists: one before less would swing too fast."""


def both_ended(structure: Structure, behind: float) -> Structure:
    """Return a structure whose shaft keeps some inertia on the engine's end beside what is behind the gauge."""
    whole, least = structure["tau_n"], behind / (1.0 - LIGHTEST_ENGINE)
    if whole.fixed or whole.tied is not None or not whole.lower < least < whole.upper:
        return structure
    return structure.with_bounds(tau_n=(least, max(1.2 * least, whole.start), whole.upper))


def starts(structure: Structure, experiments: Sequence[Experiment], count: int = 3) -> list[dict[str, float]]:
    """Return start values of a ship's parameters by name, the most promising first.

    The torque gives p and the inertia behind the gauge (or all of it, at the brake) from M = N^p + tau dN/dt + k_L w, w the
    deviation of a measured load. Then dN/dt = -a (N - 1) + b e + c int e dt - d w, with e = u(t - T_1) - N(t - T_d), is
    linear in a, b, c and d for each pair of delays: the best pair of each band of delays in the loop is a start.

    Parameters
    ----------
    structure
        A structure of kind "ship".
    experiments
        Measured signals that the structure asks for.
    count
        Starts at most.

    Raises
    ------
    InputError
        Where no experiment is long enough to smooth.
    """
    found: list[tuple[float, dict[str, float]]] = []
    for pass_hz in PASS_HZ:
        records = [
            record for one in experiments if (record := _smoothed(structure, one, pass_hz)) is not None
        ]
        if not records:
            continue
        torque = _torque(records) if "dM" in structure.outputs else {}
        found += _loops(records, torque, gauge="tau_prop" in structure.names, count=count)
    if not found and any(_smoothed(structure, one, PASS_HZ[0]) is not None for one in experiments):
        raise InputError(
            "identify: no governor and shaft turn this set point into this speed and torque; check that no two channels are "
            "swapped, and their signs"
        )
    if not found:
        raise InputError(
            f"identify: the experiments last {max(one.duration for one in experiments):.3g} s at most, expected more than "
            f"{3 * EDGE_S:g} s without gaps; widen the windows"
        )
    # Costs of different low-passes can't be compared, so each contributes in turn.
    ranks = sorted(range(len(found)), key=lambda place: (place % max(len(found) // len(PASS_HZ), 1), place))
    return [_within(structure, found[place][1]) for place in ranks][: len(PASS_HZ) * count]


def _smoothed(structure: Structure, experiment: Experiment, pass_hz: float) -> _Record | None:
    rows = dict(zip(structure.outputs, structure.measured(experiment), strict=True))
    speed, rate = rows["dn"], experiment.rate_hz
    edge = round(EDGE_S * rate)
    whole = np.isfinite(speed)
    if "dM" in rows:
        whole &= np.isfinite(rows["dM"])
    if len(speed) < 3 * edge or not whole.any():
        return None
    filt = butter(4, min(pass_hz / (0.5 * rate), 0.8), output="sos")
    index = np.arange(len(speed))

    def smooth(values: Array) -> Array:
        bridged = np.interp(index, index[whole], values[whole])
        return np.asarray(sosfiltfilt(filt, bridged))

    load = experiment.normalised("M_load") if "k_L" in structure.names else np.zeros(len(speed))
    smoothed = smooth(speed)
    # Samples within the low-pass's reach of a gap are left out.
    near_gap = np.convolve(~whole, np.ones(2 * round(0.5 * rate / pass_hz) + 1), mode="same") > 0.5
    near_gap[:edge] = near_gap[len(near_gap) - edge :] = True
    keep = np.flatnonzero(~near_gap)
    keep = keep[:: max(1, len(keep) // ROWS)]
    if len(keep) < 50:
        return None
    return _Record(
        1.0 / rate,
        smoothed,
        np.gradient(smoothed, 1.0 / rate),
        np.asarray(sosfiltfilt(filt, experiment.dn_set)),
        smooth(rows["dM"]) if "dM" in rows else None,
        np.asarray(sosfiltfilt(filt, load)),
        keep,
    )


def _torque(records: Sequence[_Record]) -> dict[str, float]:
    """Fit s (N^p + tau dN/dt + k w) to the torque by Gauss-Newton steps in s, p, tau and k."""
    speed = np.concatenate([1.0 + record.speed[record.keep] for record in records])
    slope = np.concatenate([record.slope[record.keep] for record in records])
    torque = np.concatenate(
        [1.0 + record.torque[record.keep] for record in records if record.torque is not None]
    )
    load = np.concatenate([record.load[record.keep] for record in records])
    logarithm = np.log(np.maximum(speed, 1e-3))
    scale, p, tau, gain = 1.0, 2.0, 0.3, 1.0
    for _ in range(20):
        power = np.exp(p * logarithm)
        whole = power + tau * slope + gain * load
        columns = np.column_stack([whole, scale * power * logarithm, scale * slope, scale * load])
        change = np.linalg.lstsq(columns, torque - scale * whole, rcond=None)[0]
        scale, p, tau = scale + change[0], float(np.clip(p + change[1], -1.0, 5.0)), tau + change[2]
        gain += change[3]
        if np.abs(change).max() < 1e-9:
            break
    return {"p": p, "tau": max(float(tau), 1e-3)} | ({"k_L": float(gain)} if load.any() else {})


def _loops(
    records: Sequence[_Record], torque: Mapping[str, float], *, gauge: bool, count: int
) -> list[tuple[float, dict[str, float]]]:
    # What ships have: an inertia of one to eight times the propeller's, an engine whose slope is between -3 and 1.
    p, tau = torque.get("p", 2.0), torque.get("tau", 1.0)
    shortest, longest = (tau, 8.0 * tau) if gauge else (tau, tau) if torque else (0.2, 5.0)
    limits = max(p - 1.0, 0.2) / longest, (p + 3.0) / shortest
    costs = np.full((len(LOOP_S), len(SET_POINT_S)), np.inf)
    rates = np.zeros((*costs.shape, 3))
    integrals = [(np.cumsum(one.set_point) * one.step, np.cumsum(one.speed) * one.step) for one in records]
    for i, loop in enumerate(LOOP_S):
        for j, late in enumerate(SET_POINT_S):
            costs[i, j], rates[i, j] = _regression(records, integrals, loop, loop + late, limits)
    # A loop that runs away, or with gains of the wrong sign, is no ship's.
    costs[(rates[..., 1] <= 0.0) | (rates[..., 2] <= 0.0)] = np.inf
    places = []
    for first, last in BANDS_S:
        band = costs[(first <= LOOP_S) & (last > LOOP_S)]
        if len(band) and np.isfinite(band).any():
            row, column = np.unravel_index(int(np.argmin(band)), band.shape)
            places.append((int(row) + int(np.argmax(first <= LOOP_S)), int(column)))
    places = sorted(places, key=lambda place: costs[place])[:count]
    return [
        (float(costs[i, j]), _values(rates[i, j], LOOP_S[i], SET_POINT_S[j], torque, gauge))
        for i, j in places
    ]


def _regression(
    records: Sequence[_Record],
    integrals: Sequence[tuple[Array, Array]],
    loop: float,
    late: float,
    limits: tuple[float, float],
) -> tuple[float, Array]:
    """Return the rest and a, b, c of dN/dt = -a n + b e + c int e dt, the speed late by `loop`, the set point by `late`."""
    gram = np.zeros((4, 4))
    for record, (asked, turned) in zip(records, integrals, strict=True):
        back, behind = (max(0, round(delay / record.step)) for delay in (loop, late))
        at = record.keep[record.keep >= behind]
        if len(at) < 20:
            continue
        error = record.set_point[at - behind] - record.speed[at - back]
        rows = np.column_stack(
            [record.speed[at], error, asked[at - behind] - turned[at - back], record.slope[at]]
        )
        # Constants, and a drift of the integral where the set point is read by some part wrong, belong to the record;
        # what a load does to the shaft is taken out beside.
        own = [np.ones(len(at)), np.linspace(-1.0, 1.0, len(at))]
        own += [record.load[at]] if record.load[at].any() else []
        basis = np.linalg.qr(np.column_stack(own))[0]
        rows -= basis @ (basis.T @ rows)
        gram += rows.T @ rows
    rates = _solved(gram)
    if not limits[0] <= -rates[0] <= limits[1]:
        # Speed and set point hardly tell the damping from the integral gain: it is held at what ships have.
        rates = _solved(gram, held=-float(np.clip(-rates[0], *limits)))
    rest = gram[3, 3] - 2.0 * gram[:3, 3] @ rates + rates @ gram[:3, :3] @ rates
    return float(rest), np.array([-rates[0], rates[1], rates[2]])


def _solved(gram: Array, held: float | None = None) -> Array:
    """Solve the normal equations (4, 4) for three coefficients, the first one held where it is given."""
    size = np.diag(gram)[:3] + 1e-300
    ridge = 1e-10 * np.diag(size)
    if held is None:
        return np.asarray(np.linalg.solve(gram[:3, :3] + ridge, gram[:3, 3]))
    rest = np.linalg.solve((gram[:3, :3] + ridge)[1:, 1:], gram[1:3, 3] - held * gram[1:3, 0])
    return np.asarray(np.append(held, rest))


def _values(
    rates: Array, loop: float, late: float, torque: Mapping[str, float], gauge: bool
) -> dict[str, float]:
    p = torque.get("p", 2.0)
    damping = float(rates[0])
    if torque and not gauge:
        tau_n, g = torque["tau"], float(np.clip(p - damping * torque["tau"], -3.0, 0.9))
    else:
        # The speed tells ratios only; c / a, its slow delay, best of all.
        tau_n, g = (p - G) / damping, G
        if gauge:
            tau_n = float(np.clip(tau_n, 1.5 * torque["tau"], 4.0 * torque["tau"]))
    values = {
        "tau_n": tau_n,
        "g": g,
        "vK_p": float(rates[1]) * tau_n,
        "vK_i": float(rates[2]) / damping * (p - g),
        "p": p,
        "T_d": float(loop),
        "T_set": float(late),
    }
    if gauge:
        values["tau_prop"] = torque["tau"]
    if "k_L" in torque:
        values["k_L"] = torque["k_L"]
    return values


def _within(structure: Structure, values: Mapping[str, float]) -> dict[str, float]:
    """Return the free parameters' values, a little inside their bounds; delays that the structure lacks are dropped."""
    split = dict(values)
    if "v" in structure.names:
        v = structure["v"].start
        split |= {"v": v, "K_p": values["vK_p"] / v, "K_i": values["vK_i"] / v}
    found = {}
    for parameter in structure.free:
        if parameter.name in split:
            found[parameter.name] = float(np.clip(split[parameter.name], parameter.lower, parameter.upper))
    if "T_d" in found:
        found["T_d"] = max(found["T_d"], LEAST_START_S)
    return found
