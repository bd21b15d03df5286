"""The linear drive train with a governor that samples: exact, between its samples and beyond its Nyquist frequency."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import schur
from scipy.signal import lfilter

from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.linear_extended import DERIVATIVE_FILTER, STATES, Place
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.derivatives import Differences, by_part

Numbers = npt.NDArray[Any]
"""Real, or complex where a derivative is taken by complex step."""
Values = Mapping[str, Any]

SAME = 1e-9
"""Part of a period within which two times are one."""
TAYLOR = 14
"""Terms of an exponential's series; with arguments below a half the rest is 0.5^15 / 15!, below rounding."""


@dataclass(frozen=True)
class SampledGovernor(Equations):
    """Drive train and dead time in continuous time, governor in discrete time, outputs at the experiment's rate.

    The plant is tau_n dn*/dt = g n* + v X* - p n*, with the rack's lag and the shaft's twist as in `ExtendedLinear`. At
    t_k = T_0 + k T_s the governor reads the speed and the set point, adds to its integral by the trapezoidal rule, and
    orders c_k = K_p e_k + K_i I_k - K_d (n_k - f_k) / (T_f + T_s), which reaches the rack T_d later and is held there for
    T_s; f is the speed behind a filter of time constant T_f, so the derivative is the speed's alone. Between the times at
    which the rack is told something new the plant has a constant input, so that all is exact: from sample to sample
    s_{k+1} = F s_k + G w_{k+1}, and a time delta after a sample y = H(delta) s_k (Astrom, Wittenmark,
    "Computer-Controlled Systems", 1997, sections 2.3 and 3.2 for a dead time of any length).
    The state s holds the plant's, the commands still on their way, the integral, the last error and f.

    Before the record everything stands still at its first set point, but for the initial states.
    """

    outputs: tuple[str, ...]
    gauge: bool
    speed: Place
    states: tuple[str, ...] = STATES
    linear_in: tuple[str, ...] = STATES

    def stable(self, values: Values) -> bool:
        """Whether the sampled loop is stable, exactly."""
        F, *_ = self._model(values, np.zeros(1))
        return bool(np.abs(np.linalg.eigvals(F)).max() < 1.0)

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self.sensitivities(values, experiment, ())[0]

    def sensitivities(
        self, values: Values, experiment: Experiment, names: Sequence[str]
    ) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives with respect to `names`, shape (W, O, N).

        Raises
        ------
        SimulationError
            Where the simulation leaves the range of finite numbers.
        """
        period, dt = values["T_s"], 1.0 / experiment.rate_hz
        clock = _Clock.of(values.get("T_0", 0.0), period, dt, len(experiment))
        moved = [name for name in names if name not in STATES]
        (F, G, start, H, drift), slopes = self._slopes(values, clock.offsets, moved)

        level = experiment.dn_set[0]
        w, bend = _held(experiment, clock.times - values.get("T_set", 0.0))
        bend_by = {"T_set": -bend, "T_s": bend * clock.counts, "T_0": bend}
        initial = np.array([values.get(state, 0.0) for state in STATES])
        triangle, basis = schur(F, output="complex")

        s = _marched(triangle, basis, np.outer(G, w[1:] - level)[None], (start @ initial)[None])[0]
        rest = self._at_rest(values)
        simulated = clock.observed(H, s) + (rest * level)[:, None]
        if not np.isfinite(simulated).all():
            raise SimulationError("the simulation left the range of finite numbers; is the loop stable?")

        forcing = np.zeros((len(names), len(F), len(w) - 1))
        begun = np.zeros((len(names), len(F)))
        rows = np.zeros((len(names), *simulated.shape))
        for place, name in enumerate(names):
            if name in STATES:
                begun[place] = start[:, STATES.index(name)]
                continue
            dF, dG, dstart, dH, _ = slopes[name]
            forcing[place] = dF @ s[:, :-1] + np.outer(dG, w[1:] - level)
            begun[place] = dstart @ initial
            if name in bend_by:
                forcing[place] += np.outer(G, bend_by[name][1:])
            rows[place] = clock.observed(dH, s) + (self._at_rest(values, name) * level)[:, None]
            if name in ("T_s", "T_0"):
                # A sample of the record lies so much earlier after the governor's.
                rows[place] -= clock.observed(drift, s) * (clock.periods if name == "T_s" else 1.0)
        followed = _marched(triangle, basis, forcing, begun)
        for row, change in zip(rows, followed, strict=True):
            row += clock.observed(H, change)
        return simulated, rows

    def response(
        self, values: Values, frequency_hz: Array, names: Sequence[str]
    ) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.complex128]]:
        """Return the response (O, F) and its derivatives with respect to `names`, shape (W, O, F).

        It is the part of the outputs at the set point's own frequency; the governor's samples make others beside it, at
        a distance of its sample rate. What it reads of those is in the response.
        """

        def at(vector: Array) -> Numbers:
            found = self._fundamental({**values, **dict(zip(names, vector, strict=True))}, frequency_hz)
            return np.stack([found.real, found.imag])

        vector = np.array([values[name] for name in names])
        lower = np.where(vector > 0.0, 0.5 * vector, vector)
        value, slopes = Differences(complex_step=False)(at, vector, np.full(len(vector), 1e-2), lower)
        slopes = slopes.reshape(len(names), *value.shape)
        return value[0] + 1j * value[1], slopes[:, 0] + 1j * slopes[:, 1]

    def _fundamental(self, values: Values, frequency_hz: Array) -> Numbers:
        s = 1j * np.maximum(2.0 * np.pi * frequency_hz, 1e-6)
        period, late = values["T_s"], values.get("T_d", 0.0)
        F, G, *_ = self._model(values, np.zeros(1))
        A, B, C, D = self._plant(values)
        z = np.exp(s * period)[:, None, None]
        order = len(A)
        state = np.linalg.solve(z * np.eye(len(F)) - F, z * G[:, None])
        held = np.exp(-s * late) * -np.expm1(-s * period) / (s * period)
        rack = state[:, order, 0] * held * np.exp(-s * values.get("T_set", 0.0))
        plant = np.linalg.solve(s[:, None, None] * np.eye(order) - A, B[:, None])
        return np.asarray(((C @ plant)[..., 0] + D).T * rack)

    def _slopes(
        self, values: Values, offsets: Array, names: Sequence[str]
    ) -> tuple[tuple[Numbers, ...], dict[str, list[Numbers]]]:
        """Return the model and its derivatives by parameter, exact to rounding."""

        def at(vector: Numbers) -> tuple[Numbers, ...]:
            return self._model({**values, **dict(zip(names, vector, strict=True))}, offsets)

        vector = np.array([values[name] for name in names], dtype=np.float64)
        slopes = by_part(Differences(complex_step=True), at, vector, np.ones(len(vector)))
        return self._model(values, offsets), dict(zip(names, slopes, strict=True))

    def _model(self, values: Values, offsets: Array) -> tuple[Numbers, ...]:
        """Return F (m, m), G (m,), the state of one unit of each initial state (m, 2), H and dH/d(delta) (U, O, m)."""
        A, B, C, D = self._plant(values)
        n, period, dead_time = len(A), values["T_s"], values.get("T_d", 0.0)
        gains = [values.get(name, values.get(f"v{name}", 0.0)) for name in ("K_p", "K_i", "K_d")]
        proportional, integral, derivative = gains
        whole = math.floor(np.real(dead_time) / np.real(period) + SAME)
        late = dead_time - whole * period
        m = n + whole + 5
        unit = np.eye(m)
        # Places in the state: the plant, the commands from the newest to the oldest that still acts, memory.
        newer, older, total, miss, filtered = n + whole, n + whole + 1, m - 3, m - 2, m - 1
        plant = unit[:n]

        def after(h: Numbers, x: Numbers, u: Numbers) -> Numbers:
            """The plant's state (U, n, m) after times h (U,) with a held rack's command, as functions of the state."""
            through = _exponentials(A, B, h)
            return np.asarray(through[:, :n, :n] @ x + through[:, :n, n:] * u)

        behind = np.real(offsets) >= np.real(late) - SAME * np.real(period)
        first = after(np.where(behind, late, offsets), plant, unit[older])
        then = after(np.where(behind, offsets - late, 0.0), first, unit[newer])
        u = np.where(behind[:, None, None], unit[newer], unit[older])
        H = C @ then + D[:, None] * u
        drift = C @ (A @ then + B[:, None] * u)
        X = after(np.array([period - late]), after(np.array([late]), plant, unit[older]), unit[newer])[0]

        speed = X[0]
        F = np.zeros((m, m), dtype=np.result_type(X, proportional, integral, derivative, period))
        G = np.zeros(m, dtype=F.dtype)
        F[:n] = X
        F[n + 1 : older + 1] = unit[n:older]
        F[miss], G[miss] = -speed, 1.0
        F[total], G[total] = unit[total] + 0.5 * period * (unit[miss] - speed), 0.5 * period
        F[n], G[n] = proportional * F[miss] + integral * F[total], proportional + 0.5 * period * integral
        start = np.zeros((m, 2), dtype=F.dtype)
        start[:n, 0], start[miss, 0], start[total, 1], start[filtered, 0] = (
            self._moving(values),
            -1.0,
            1.0,
            1.0,
        )
        start[n] = -proportional, integral
        if "K_d" in values or "vK_d" in values:
            lead, filter_s = speed - unit[filtered], DERIVATIVE_FILTER * derivative / proportional + period
            F[n] = F[n] - derivative / filter_s * lead
            F[filtered] = unit[filtered] + period / filter_s * lead
        return F, G, start, H, drift

    def _plant(self, q: Values) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        """Return A, B, C, D from the rack's command to the outputs; the first state is the engine's speed."""
        twist, lag, prop = "tau_twist" in q, "tau_act" in q, q.get("tau_prop", 0.0)
        v, g, p, tau_n = q.get("v", 1.0), q["g"], q["p"], q["tau_n"]
        n = 1 + 2 * twist + lag
        A = np.zeros((n, n), dtype=np.result_type(*map(type, q.values()), np.float64))
        B, rack, kick = np.zeros(n, dtype=A.dtype), np.zeros(n, dtype=A.dtype), 1.0
        engine = tau_n - prop if twist else tau_n
        if lag:
            rack[-1], kick = 1.0, 0.0
            A[-1, -1], B[-1] = -1.0 / q["tau_act"], 1.0 / q["tau_act"]
        # tau dn*/dt = g n* + v X* less what the shaft takes.
        A[0] = v * rack / engine
        A[0, 0] += g / engine
        B[0] += v * kick / engine
        n_e = np.eye(n)[0]
        if twist:
            A[0, 2] -= 1.0 / engine
            A[1, 1], A[1, 2] = -p / prop, 1.0 / prop
            A[2, 0], A[2, 1] = 1.0 / q["tau_twist"], -1.0 / q["tau_twist"]
            n_s, gauge, jump = np.eye(n)[1], np.eye(n)[2], 0.0
        else:
            A[0, 0] -= p / engine
            n_s, gauge, jump = n_e, p * n_e + prop * A[0], prop * B[0]
        rows = {
            "dn": (n_e if self.speed == "engine" else n_s, 0.0),
            "dM": (gauge, jump) if self.gauge else (g * n_e + v * rack, v * kick),
            "dX": (rack, kick),
        }
        C, D = zip(*(rows[output] for output in self.outputs), strict=True)
        return A, B, np.array(C), np.array(D)

    def _moving(self, q: Values) -> Numbers:
        """The plant's state where all turns one unit faster and the rack stands still."""
        turning = [1.0, *([1.0, q["p"]] if "tau_twist" in q else []), *([0.0] if "tau_act" in q else [])]
        return np.array(turning)

    def _at_rest(self, q: Values, by: str | None = None) -> Array:
        """Outputs over a set point that stands still, shape (O,), or their derivatives by a parameter."""
        g, p, v = q["g"], q["p"], q.get("v", 1.0)
        rows: dict[str, dict[str | None, float]] = {
            "dn": {None: 1.0},
            "dM": {None: p, "p": 1.0},
            "dX": {None: (p - g) / v, "p": 1.0 / v, "g": -1.0 / v, "v": -(p - g) / v**2},
        }
        return np.array([rows[output].get(by, 0.0) for output in self.outputs])


@dataclass(frozen=True)
class _Clock:
    """Which of the governor's samples is the last before each sample of the record, and how long before."""

    counts: Array
    """Number k of each of the governor's samples (K,), at T_0 + k T_s."""
    times: Array
    """When they are taken (K,) [s]."""
    offsets: Array
    """How long a record's sample may lie behind one of the governor's (U,) [s]."""
    which: npt.NDArray[np.intp]
    """Which offset, for each sample of the record (N,)."""
    sample: npt.NDArray[np.intp]
    """Which of the governor's samples (N,)."""

    @classmethod
    def of(cls, first: float, period: float, dt: float, samples: int) -> _Clock:
        time = dt * np.arange(samples)
        periods = np.floor((time - first) / period + SAME)
        counts = np.arange(periods[0], periods[-1] + 1.0)
        # Times are alike to rounding wherever the two rates have a common multiple.
        offsets, which = np.unique(np.round((time - first - periods * period) / dt, 9), return_inverse=True)
        return cls(
            counts,
            first + counts * period,
            np.maximum(dt * offsets, 0.0),
            which.astype(np.intp),
            (periods - periods[0]).astype(np.intp),
        )

    @property
    def periods(self) -> Array:
        """Number of the governor's sample before each sample of the record (N,)."""
        return np.asarray(self.counts[self.sample])

    def observed(self, H: Numbers, s: Array) -> Array:
        """Return the outputs (O, N) that rows H (U, O, m) make of the states (m, K)."""
        return np.asarray(np.einsum("nom,mn->on", H[self.which], s[:, self.sample]))


def _held(experiment: Experiment, times: Array) -> tuple[Array, Array]:
    """Return the set point's deviation at times [s] and its slope there, as the experiment has it between samples."""
    u, rate = experiment.dn_set, experiment.rate_hz
    place = np.floor(times * rate + SAME)
    piece = np.clip(place, 0, len(u) - 1).astype(np.intp)
    slope = np.zeros(len(times))
    if experiment.hold == "first":
        inside = (place >= 0) & (place < len(u) - 1)
        slope = np.where(inside, np.append(np.diff(u), 0.0)[piece] * rate, 0.0)
    return u[piece] + slope * (times - piece / rate), slope


def _exponentials(A: Numbers, B: Numbers, h: Numbers) -> Numbers:
    """Return exp([[A, B], [0, 0]] h) for times h (U,), shape (U, n + 1, n + 1): side by side, and fit for complex steps."""
    n = len(A)
    system = np.zeros((n + 1, n + 1), dtype=np.result_type(A, B))
    system[:n, :n], system[:n, n] = A, B
    argument = system * h[:, None, None]
    largest = float(np.abs(argument).sum(axis=-1).max(initial=0.0))
    halvings = max(0, math.ceil(math.log2(2.0 * largest))) if largest > 0.5 else 0
    argument = argument * 0.5**halvings
    found = np.eye(n + 1) + argument / TAYLOR
    for term in range(TAYLOR - 1, 0, -1):
        found = np.eye(n + 1) + argument @ found / term
    for _ in range(halvings):
        found = found @ found
    return found


def _marched(triangle: Numbers, basis: Numbers, forcing: Array, start: Array) -> Array:
    """Solve s[k+1] = F s[k] + f[k] for forcings (W, m, K) and starts (W, m) by F's Schur form, shape (W, m, K + 1).

    A Schur form turns without stretching, so that nothing is lost where eigenvalues meet, as those of a dead time do.
    """
    if not len(forcing):
        return np.empty((0, forcing.shape[1], forcing.shape[2] + 1))
    turned = np.concatenate([start[..., None], forcing], axis=-1)
    state = basis.conj().T @ turned
    for row in reversed(range(len(triangle))):
        later = np.tensordot(triangle[row, row + 1 :], state[:, row + 1 :, :-1], axes=(0, 1))
        state[:, row, 1:] += later
        state[:, row] = lfilter([1.0], [1.0, -triangle[row, row]], state[:, row], axis=-1)
    return np.asarray((basis @ state).real)
