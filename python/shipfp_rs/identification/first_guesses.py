"""Starting values of a search: regressions of the loop's spectra over a grid of dead times and lags.

With both dead times and the lag known, the loop is linear in (p - g) / tau_n, vK_p / tau_n and vK_i / tau_n:

    jw N = -(p - g) / tau_n N + (vK_p + vK_i / jw) / tau_n E - k_L / tau_n W,
    E = (U exp(-jw T_set) - N) exp(-jw T_d) / (1 + jw tau_act)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from shipfp_rs.identification.spectra import Spectra
from shipfp_rs.structures.elements import QUANTITIES
from shipfp_rs.support.arrays import Array, ComplexArray

LOOP_DEAD_TIMES_S = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2, 0.25, 0.3, 0.4)
SET_POINT_DEAD_TIMES_S = (*np.arange(0.0, 0.5, 0.03), 0.6, 0.8, 1.0, 1.4)
LAGS_S = (0.0, 0.03, 0.08, 0.15, 0.3)
"""Grid of lags [s]; its spacing is the width of a minimum for a loop of 2 Hz."""
LOW_PASS_HZ = 3.0
"""Highest frequency of the regressions [Hz]: minima are wider at low frequencies (Ha and Welsh 2017)."""
STRONGEST = 400
"""Largest number of frequencies in a regression: those at which the inputs are strongest."""
CORNER = 3.0
"""Corner frequency [rad/s]. The equation is divided by jw + `CORNER`, so that noise at high frequencies weighs less."""
APART_S = 0.07
"""Least distance between two starts: the sum of their differences in delay [s]."""
KEPT = 8
"""Number of starts that are returned."""
LEAST_SLOPE = 0.02
"""Least (p - g) of a guess relative to vK_p; below it the drive train alone would have no steady speed."""
LEAST_INTEGRAL = 1e-4
"""Least vK_i / tau_n of a guess [1/s2]: a slower governor would not settle within a trial."""
BANDWIDTHS = (2.0, 5.0, 12.0)
"""Loop bandwidths of additional guesses [rad/s], since limits may mislead regressions."""
INERTIAS_S = QUANTITIES["tau_n"].lower, QUANTITIES["tau_n"].upper
SHARES = (0.3, 0.6)
"""Shares tau_prop / tau_n of the inertia behind a gauge that are tried."""


def first_guesses(
    records: Sequence[Spectra],
    outputs: Sequence[str],
    gauge: bool,
    law: Mapping[str, float] | None = None,
) -> list[dict[str, float]]:
    """Return distinct starting values, best first; `law` is p and the inertia "tau" behind the torque sensor."""
    return guesses_from([LoopSpectra.of(record, outputs) for record in records], gauge, law)


def guesses_from(
    parts: Sequence[LoopSpectra], gauge: bool, law: Mapping[str, float] | None = None
) -> list[dict[str, float]]:
    """Return distinct starting values from spectra of the loop."""
    law = _law(parts) if law is None else law
    ways = [(lag, dead) for lag in LAGS_S for dead in LOOP_DEAD_TIMES_S]
    gram, right, total = (sum(each) for each in zip(*[part.regressions(ways) for part in parts], strict=True))
    size = gram.shape[-1]
    ridge = 1e-9 * np.trace(gram, axis1=2, axis2=3)[..., None, None] * np.eye(size)
    found = np.linalg.solve(gram + ridge, right[..., None])[..., 0]
    left = total - np.sum(right * found, axis=2)
    rows = [
        (float(left[way, place]), lag, dead, float(late), found[way, place])
        for way, (lag, dead) in enumerate(ways)
        for place, late in enumerate(SET_POINT_DEAD_TIMES_S)
        if found[way, place, 1] > 0.0
    ]
    rows.sort(key=lambda row: row[0])
    kept: list[tuple[float, float, float, float, Array]] = []
    told = [row for row in rows if row[4][0] > LEAST_SLOPE * row[4][1] and row[4][2] > LEAST_INTEGRAL]
    # Loops with identifiable gain and integral come first, then loops in which only the ratio of both is identifiable.
    for row in (*told, *rows) if len(told) < KEPT else told:
        if all(
            sum(abs(a - b) for a, b in zip(row[1:4], other[1:4], strict=True)) > APART_S for other in kept
        ):
            kept.append(row)
        if len(kept) == KEPT:
            break
    guesses = []
    for _, lag, dead, late, (slope, gain, integral, *load) in kept:
        for tau in [law["tau"] / share for share in SHARES] if gauge else [law["tau"]]:
            tau = float(np.clip(tau, *INERTIAS_S))
            own, holding = float(slope), float(integral)
            if own < LEAST_SLOPE * gain or holding < LEAST_INTEGRAL:
                # The governor's zero cancels the plant's pole: only their combination is identifiable.
                own = (law["p"] + 0.5) / tau
                holding = own * gain
            guesses.append(
                {
                    "tau_n": tau,
                    "g": law["p"] - own * tau,
                    "vK_p": float(gain) * tau,
                    "vK_i": holding * tau,
                    "p": law["p"],
                    "tau_prop": float(np.clip(law["tau"], 0.01, 0.9 * tau)),
                    "T_d": max(dead, 3e-3),
                    "T_set": max(late, 3e-3),
                    "tau_act": max(lag, 3e-3),
                    **({"k_L": float(np.clip(load[0] * tau, 0.05, 5.0))} if load else {}),
                }
            )
    return guesses + guesses_by_bandwidth(law, gauge, kept[0][3] if kept else 0.1)


def guesses_by_bandwidth(law: Mapping[str, float], gauge: bool, late: float) -> list[dict[str, float]]:
    """Return guesses with fixed loop bandwidths, without regressions; `late`: dead time of the set point."""
    tau = float(np.clip(law["tau"] / (SHARES[0] if gauge else 1.0), *INERTIAS_S))
    behind = float(np.clip(law["tau"], 0.01, 0.9 * tau))
    common = {"tau_n": tau, "g": -0.5, "p": law["p"], "tau_prop": behind, "T_set": max(late, 3e-3)}
    return [
        {
            **common,
            "vK_p": max(1.4 * w * tau - law["p"] - 0.5, 0.3),
            "vK_i": w**2 * tau,
            "T_d": 0.03,
            "tau_act": 0.03,
        }
        for w in BANDWIDTHS
    ]


class LoopSpectra:
    """Spectra of a record's set point, speed, torque and load below `LOW_PASS_HZ`, divided by jw + `CORNER`."""

    def __init__(
        self,
        s: ComplexArray,
        set_point: ComplexArray,
        by_name: Mapping[str, ComplexArray],
        load: ComplexArray | None,
    ):
        self.s, self.set_point, self.by_name, self.load = s, set_point, by_name, load

    @classmethod
    def of(cls, record: Spectra, outputs: Sequence[str]) -> LoopSpectra:
        """Return the spectra of a record at the frequencies of the strongest inputs."""
        inputs = record.inputs()
        power = np.sum([np.abs(record.frequency_hz * row) for row in inputs if row is not None], axis=0)
        allowed = (record.frequency_hz > 0.0) & (record.frequency_hz <= LOW_PASS_HZ)
        kept = np.sort(np.argsort(np.where(allowed, -power, np.inf))[: min(STRONGEST, allowed.sum())])
        s = np.asarray(2j * np.pi * record.frequency_hz[kept])
        divided = 1.0 / (s + CORNER)
        data = {name: divided * row[kept] for name, row in zip(outputs, record.spectrum, strict=True)}
        set_point, load = (None if row is None else divided * row[kept] for row in inputs)
        assert set_point is not None
        return cls(s, set_point, data, load)

    @classmethod
    def of_response(cls, frequency_hz: Array, responses: Mapping[str, ComplexArray]) -> LoopSpectra:
        """Return the spectra for a unit set point, from the response (F,) of each output by name."""
        kept = (frequency_hz > 0.0) & (frequency_hz <= LOW_PASS_HZ)
        s = np.asarray(2j * np.pi * frequency_hz[kept])
        divided = 1.0 / (s + CORNER)
        return cls(
            s, np.asarray(divided), {name: divided * one[kept] for name, one in responses.items()}, None
        )

    def regressions(self, ways: Sequence[tuple[float, float]]) -> tuple[Array, Array, float]:
        """Normal equations, (W, T, 3, 3) and (W, T, 3), for (lag, dead time) pairs (W) and set-point dead times (T)."""
        s, speed = self.s, self.by_name["dn"]
        lag, dead = np.array(ways).T[:, :, None]
        way = np.exp(-s * dead) / (1.0 + s * lag)
        late = self.set_point * np.exp(-s * np.array(SET_POINT_DEAD_TIMES_S)[:, None]) - speed
        target = s * speed
        # Columns: speed, error, integral of the error, load. `way` (lag and dead time) multiplies both columns of the error.
        known = np.array([-speed, *([] if self.load is None else [-self.load])])
        power, strength = np.abs(way) ** 2, np.abs(late) ** 2
        size = 2 + len(known)
        gram, right = np.zeros((len(way), len(late), size, size)), np.zeros((len(way), len(late), size))
        beside = [0, *range(3, size)]
        for column, factor in ((1, np.ones_like(s)), (2, 1.0 / s)):
            gram[:, :, column, column] = (power * np.abs(factor) ** 2) @ strength.T
            for place, row in zip(beside, known, strict=True):
                products = ((way * factor * row.conj()) @ late.T).real
                gram[:, :, place, column] = gram[:, :, column, place] = products
            right[:, :, column] = ((way * factor * target.conj()) @ late.T).real
        # An error and its integral differ by 90 degrees at every frequency, so their product has no real part.
        gram[:, :, np.array(beside)[:, None], beside] = (known @ known.conj().T).real
        right[:, :, beside] = (known @ target.conj()).real
        return gram, right, float(np.vdot(target, target).real)


def guesses_in_open_loop(parts: Sequence[LoopSpectra], gauge: bool) -> list[dict[str, float]]:
    """Return starting values of a drive in open loop, best first, by regressions over a grid of dead times and lags."""
    law, rows = _law(parts), []
    for lag in LAGS_S:
        for dead in LOOP_DEAD_TIMES_S:
            columns, targets = [], []
            for part in parts:
                speed, s = part.by_name["dn"], part.s
                loads = [] if part.load is None else [-part.load]
                way = np.exp(-s * dead) / (1.0 + s * lag)
                columns.append(np.stack([-speed, way * part.set_point, *loads], axis=1))
                targets.append(s * speed)
            both, target = np.concatenate(columns), np.concatenate(targets)
            both, target = np.concatenate([both.real, both.imag]), np.concatenate([target.real, target.imag])
            found = np.linalg.lstsq(both, target, rcond=None)[0]
            rows.append((float(np.linalg.norm(target - both @ found)), lag, dead, found))
    rows.sort(key=lambda row: row[0])
    guesses = []
    for _, lag, dead, (own, gain, *load) in rows[:KEPT]:
        measured = "dM" in parts[0].by_name
        tau = law["tau"] / (SHARES[0] if gauge else 1.0) if measured else 1.0 / max(float(gain), 1e-3)
        p = law["p"] if measured else float(own) * tau
        known = {
            "tau_n": tau,
            "p": p,
            "g": p - float(own) * tau,
            "v": float(gain) * tau,
            "T_d": dead,
            "tau_act": lag,
        }
        guesses.append({**known, "tau_prop": SHARES[0] * tau, "k_L": float(load[0]) * tau if load else 1.0})
    return guesses


def _law(parts: Sequence[LoopSpectra]) -> dict[str, float]:
    """Return exponent p and time constant tau by a regression of torque on speed, M = (p + tau s) N."""
    if any("dM" not in part.by_name for part in parts):
        return {"p": 2.0, "tau": 1.2}
    rows = np.concatenate(
        [np.stack([part.by_name["dn"], part.s * part.by_name["dn"]], axis=1) for part in parts]
    )
    if parts[0].load is not None:
        loads = np.concatenate([part.load for part in parts if part.load is not None])
        rows = np.column_stack([rows, loads])
    target = np.concatenate([part.by_name["dM"] for part in parts])
    both = np.concatenate([rows.real, rows.imag])
    found = np.linalg.lstsq(both, np.concatenate([target.real, target.imag]), rcond=None)[0]
    return {"p": float(np.clip(found[0], -0.5, 4.5)), "tau": float(np.clip(found[1], *INERTIAS_S))}
