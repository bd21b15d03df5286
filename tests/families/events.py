"""The drive train in relative numbers by solve_ivp: pieces between the governor's instants, the torque limit an event.

Written anew, not from `small_steps`: N, I, A, N_p and M_t over their operating values, in the names of a fingerprint. A dead
time of the loop is taken by the method of steps: pieces shorter than it, the command's continuous part interpolated by
cubics between output instants, its jumping part from the set point itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from tests.families.excitations import Excitation, asked
from tests.families.plant import LIMITS
from tests.families.water import Water, changed

RTOL, ATOL = 1e-8, 1e-10
LONGEST_S = 20.0


class Relative(NamedTuple):
    """Relative numbers, as `plant.normalised` names them."""

    tau_n: float
    tau_prop: float
    g: float
    vK_p: float
    vK_i: float
    p: float
    damping: float
    T_d: float
    T_set: float
    T_s: float
    T_0: float
    update: float
    tau_act: float
    M_max: float
    rate: float
    c_2: float
    tau_twist: float
    zeta_twist: float


class Relatively(NamedTuple):
    """What happened, over the operating point, at every output instant, shape (N,) each."""

    N_e: np.ndarray
    N_p: np.ndarray
    M_b: np.ndarray
    M_g: np.ndarray


@njit(cache=True)
def _cubic(values, at):
    """Four-point interpolation at a fractional index; before the record the first value."""
    if at <= 0.0:
        return values[0]
    i = int(at)
    x = at - i
    if i == 0 or x == 0.0:
        return values[i] + x * (values[i + 1] - values[i]) if x > 0.0 else values[i]
    a, b, c, d = values[i - 1], values[i], values[i + 1], values[i + 2]
    return (
        -x * (x - 1.0) * (x - 2.0) / 6.0 * a
        + (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0 * b
        - (x + 1.0) * x * (x - 2.0) / 2.0 * c
        + (x + 1.0) * x * (x - 1.0) / 6.0 * d
    )


@njit(cache=True)
def _command(t, N, summed, q, kind, start, table, held, fed_back, spacing):
    """vX that reaches the actuator at `t`."""
    if q.T_s > 0.0:
        return held
    u = asked(kind, start, table, t - q.T_set - q.T_d)
    if q.T_d == 0.0:
        return q.vK_p * (u - N) + q.vK_i * summed
    return q.vK_p * u + _cubic(fed_back, (t - q.T_d) / spacing)


@njit(cache=True)
def _demand(t, y, q, kind, start, table, held, fed_back, spacing):
    """Brake torque before the limit."""
    fuel = (
        y[2] if q.tau_act > 0.0 else _command(t, y[0], y[1], q, kind, start, table, held, fed_back, spacing)
    )
    return 1.0 + q.g * (y[0] - 1.0) + fuel


@njit(cache=True)
def _load(t, N, q, water):
    share = 1.0 + (changed(water, t) if water.shape[1] else 0.0)
    return share * N ** (q.p + q.c_2 * (N - 1.0)) + q.damping * (N - 1.0)


@njit(cache=True)
def _rates(t, y, q, kind, start, table, held, fed_back, spacing, limited, water):
    torque = q.M_max if limited else _demand(t, y, q, kind, start, table, held, fed_back, spacing)
    out = np.zeros(5)
    out[1] = asked(kind, start, table, t - q.T_set) - y[0]
    if q.tau_act > 0.0:
        command = _command(t, y[0], y[1], q, kind, start, table, held, fed_back, spacing)
        out[2] = min(max((command - y[2]) / q.tau_act, -q.rate), q.rate)
    if q.tau_twist == 0.0:
        out[0] = (torque - _load(t, y[0], q, water)) / q.tau_n
        out[3] = out[0]
        return out
    through = y[4] + q.zeta_twist * (y[0] - y[3])
    out[0] = (torque - through) / (q.tau_n - q.tau_prop)
    out[3] = (through - _load(t, y[3], q, water)) / q.tau_prop
    out[4] = (y[0] - y[3]) / q.tau_twist
    return out


@njit(cache=True)
def _outputs(times, states, q, kind, start, table, held, fed_back, spacing, water):
    """M_b and M_g at output instants; states (5, N)."""
    out = np.empty((2, len(times)))
    for k in range(len(times)):
        t, y = times[k], states[:, k].copy()
        out[0, k] = min(_demand(t, y, q, kind, start, table, held, fed_back, spacing), q.M_max)
        if q.tau_twist == 0.0:
            load = _load(t, y[0], q, water)
            out[1, k] = load + q.tau_prop / q.tau_n * (out[0, k] - load)
        else:
            out[1, k] = y[4] + q.zeta_twist * (y[0] - y[3])
    return out


def simulate(
    relative: dict[str, float], excitation: Excitation, *, step_s: float, water: Water | None = None
) -> Relatively:
    """Run a drive train from its operating point to the excitation's end, outputs every `step_s` seconds.

    Parameters
    ----------
    relative
        As `plant.normalised` returns them.
    excitation
        The set point.
    step_s
        Between outputs; a dead time of the loop must be longer than five of them. A limit of the rate needs a lag beside.
    water
        Changes the load's law.
    """
    q = Relative(
        **{name: float(relative.get(name, np.inf if name in LIMITS else 0.0)) for name in Relative._fields}
    )
    if np.isfinite(q.rate) and q.tau_act == 0.0:
        raise ValueError(f"rate {q.rate} 1/s without a lag, expected tau_act above zero")
    if 0.0 < q.T_d <= 5.0 * step_s:
        raise ValueError(f"dead time {q.T_d} s, expected more than five output steps of {step_s} s")
    return _Run(q, excitation, step_s, np.zeros((4, 0)) if water is None else water.coefficients).run()


class _Run:
    def __init__(self, q, excitation, step_s, water):
        self.q, self.step_s, self.water = q, step_s, water
        self.signal = (excitation.code, excitation.start_s, excitation.table)
        self.count = round(excitation.stop_s / step_s)
        self.stop_s = self.count * step_s
        self.states = np.empty((5, self.count))
        self.torques = np.empty((2, self.count))
        self.fed_back = np.full(self.count + 4, -q.vK_p)
        late = np.array([0.0, q.T_d]) + q.T_set
        self.breaks = np.append(np.unique(np.add.outer(excitation.breaks, np.unique([*late, 0.0]))), np.inf)
        self.held = 0.0
        self.done = 0

    def run(self):
        q = self.q
        y, t, limited = np.array([1.0, 0.0, 0.0, 1.0, 1.0]), 0.0, False
        taken, arrived, total, commands = 0, 0, 0.0, []
        while self.done < self.count:
            while q.T_s and t >= q.T_0 + taken * q.T_s - 1e-12:
                error = asked(*self.signal, t - q.T_set) - y[0]
                total += q.T_s * error if q.update else 0.0
                commands.append(q.vK_p * error + q.vK_i * total)
                total += 0.0 if q.update else q.T_s * error
                taken += 1
            while arrived < taken and t >= q.T_0 + arrived * q.T_s + q.T_d - 1e-12:
                self.held = commands[arrived]
                arrived += 1
            stop = min(t + LONGEST_S, self.stop_s, self.breaks[np.searchsorted(self.breaks, t + 1e-9)])
            if q.T_s:
                stop = min(stop, q.T_0 + taken * q.T_s)
                stop = min(stop, q.T_0 + arrived * q.T_s + q.T_d) if arrived < taken else stop
            elif q.T_d:
                stop = min(stop, t + q.T_d - 4.0 * self.step_s)
            t, y, limited = self._piece(t, stop, y, limited)
        relative = self.states
        return Relatively(relative[0], relative[3], self.torques[0], self.torques[1])

    def _piece(self, t, stop, y, limited):
        """Integrate up to `stop` or to where the torque limit begins or ends to hold."""
        q = self.q
        facts = (q, *self.signal, self.held, self.fed_back, self.step_s)
        events = None
        if np.isfinite(q.M_max):
            above = _demand(t + 1e-12, y, *facts) - q.M_max
            limited = above > 0.0 if abs(above) > 1e-9 else limited

            def reached(time, state):
                return _demand(time, state, *facts) - q.M_max

            reached.terminal, reached.direction = True, -1.0 if limited else 1.0
            events = [reached]
        last = min(int(np.ceil(stop / self.step_s - 1e-7)), self.count)
        wanted = np.arange(self.done, last) * self.step_s
        found = solve_ivp(
            lambda time, state: _rates(time, state, *facts, limited, self.water),
            (t, stop),
            y,
            method="DOP853",
            t_eval=np.append(np.clip(wanted, t, stop), stop),
            events=events,
            rtol=RTOL,
            atol=ATOL,
            max_step=0.1,
            # Saves the search for one; too long a first step is rejected.
            first_step=min(0.02, stop - t),
        )
        if not found.success:
            raise RuntimeError(f"solve_ivp at {t} s: {found.message}")
        hit = found.status == 1
        # Where it ends before the first wanted instant, solve_ivp returns an empty list.
        kept = np.reshape(found.y, (5, -1))[:, : len(wanted)]
        times = wanted[: kept.shape[1]]
        rows = slice(self.done, self.done + len(times))
        self.states[:, rows] = kept
        self.fed_back[rows] = q.vK_i * kept[1] - q.vK_p * kept[0]
        self.torques[:, rows] = _outputs(times, np.ascontiguousarray(kept), *facts, self.water)
        self.done = rows.stop
        if hit:
            return found.t_events[0][0], found.y_events[0][0], not limited
        return stop, found.y[:, -1], limited
