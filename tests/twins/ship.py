"""The ship solved piece by piece between all breaks by a tight general solver: slow, and exact to 1e-11."""

import bisect
import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from shipfp_rs._core import SHIP_OUTPUTS, SHIP_PARAMETERS

Array = NDArray[np.float64]

OFF = {
    "tau_n": 1.5,
    "g": -0.583,
    "v": 1.0,
    "K_p": 6.33,
    "K_i": 1.583,
    "K_d": 0.0,
    "p": 2.17,
    "tau_prop": 1.0,
    "T_d": 0.0,
    "T_set": 0.0,
    "T_s": 0.0,
    "T_0": 0.0,
    "tau_act": 0.0,
    "M_max": math.inf,
    "M_max_slope": 0.0,
    "M_min": -math.inf,
    "rate_up": math.inf,
    "rate_down": math.inf,
    "X_max": math.inf,
    "X_min": -math.inf,
    "anti_windup": 0.0,
    "damping": 0.0,
    "load_gain": 0.0,
    "tau_twist": 0.0,
    "zeta_twist": 0.0,
    "T_n": 0.0,
    "T_M": 0.0,
    "s_u": 1.0,
    "s_M": 1.0,
    "initial_N": 1.0,
    "initial_F": 0.0,
    "update": 0.0,
}
"""A launch with every element off."""

SMOOTH = [
    name
    for name in SHIP_PARAMETERS
    if name
    in [
        "tau_n",
        "g",
        "v",
        "K_p",
        "K_i",
        "K_d",
        "p",
        "tau_prop",
        "T_d",
        "T_set",
        "tau_act",
        "damping",
        "load_gain",
        "T_n",
        "T_M",
        "s_u",
        "s_M",
        "initial_N",
        "initial_F",
    ]
]
"""What the smooth model depends on."""


def vector(**changes: float) -> Array:
    """Parameters of the launch, some of them changed."""
    assert set(changes) <= set(OFF)
    return np.array([float((OFF | changes)[name]) for name in SHIP_PARAMETERS])


class Held:
    """An input between its samples, constant or straight; its ends hold."""

    def __init__(self, samples: Array, dt: float, hold: str) -> None:
        self.samples, self.dt, self.hold = samples, dt, hold

    def piece(self, t: float) -> tuple[float, float, float]:
        """Start, value there and slope of the straight piece that holds a time."""
        k = math.floor(t / self.dt + 1e-7)
        if k < 0:
            return t, self.samples[0], 0.0
        k = min(k, len(self.samples) - 1)
        rise = self.samples[min(k + 1, len(self.samples) - 1)] - self.samples[k]
        return k * self.dt, self.samples[k], rise / self.dt if self.hold == "first" else 0.0


class Solution:
    """Pieces of a solution with their dense output."""

    def __init__(self) -> None:
        self.starts: list[float] = []
        self.pieces: list[object] = []

    def add(self, start: float, piece: object) -> None:
        self.starts.append(start)
        self.pieces.append(piece)

    def at(self, t: float, inside: float) -> object:
        """The piece that holds `inside`; evaluated at `t`."""
        piece = self.pieces[max(0, bisect.bisect_right(self.starts, inside) - 1)]
        return piece(t)


def breaks(q: dict[str, float], samples: int, dt: float, loaded: bool, levels: int) -> Array:
    """All times at which something breaks: those of the inputs' samples, and what dead times make of them."""
    end = (samples - 1) * dt
    grid = dt * np.arange(samples)
    late = [q["T_set"] + level * q["T_d"] for level in range(levels)]
    times = [grid + shift for shift in late]
    times += [np.array([level * q["T_d"] for level in range(levels)])]
    if loaded:
        times += [grid + level * q["T_d"] for level in range(levels)]
    found = np.sort(np.concatenate(times))
    found = found[(found > 1e-11) & (found < end - 1e-11)]
    found = np.concatenate([[0.0], found, [end]])
    return found[np.concatenate([[True], np.diff(found) > 1e-10])]


def simulate(
    parameters: Array,
    u: Array,
    load: Array,
    dt: float,
    hold: str,
    outputs: list[int],
    levels: int = 8,
    tolerance: float = 1e-12,
) -> Array:
    """Outputs at the samples, shape (O, N)."""
    q = dict(zip(SHIP_PARAMETERS, parameters.tolist(), strict=True))
    set_point, torque = Held(u, dt, hold), Held(load if load.size else np.zeros(len(u)), dt, hold)
    sign = q["initial_N"] - 1.0
    N_0, F_0 = q["initial_N"], q["initial_F"]

    def drag(N: float, w: float) -> float:
        return N * abs(N) ** (q["p"] - 1.0) + q["damping"] * (N - 1.0) + q["load_gain"] * w

    rate_0 = (1.0 + q["g"] * sign + F_0 - drag(N_0, torque.samples[0])) / q["tau_n"]
    e_0 = q["s_u"] * u[0] - N_0
    raised = F_0 / q["v"] - q["K_p"] * e_0 + q["K_d"] * rate_0
    past, cuts = Solution(), breaks(q, len(u), dt, bool(load.size), levels if q["T_d"] else 1)

    def over(start: float, stop: float, state: Array) -> tuple[object, Array]:
        middle = 0.5 * (start + stop)
        s_0, s_value, s_slope = set_point.piece(middle - q["T_set"])
        w_0, w_value, w_slope = torque.piece(middle)
        at_once = q["T_d"] == 0.0 and q["tau_act"] == 0.0

        def error(t: float, N: float) -> float:
            return q["s_u"] * (s_value + s_slope * (t - q["T_set"] - s_0)) - N

        def signals(t: float, x: Array) -> tuple[float, ...]:
            N, total, lagged = x
            w = w_value + w_slope * (t - w_0)
            e = error(t, N)
            known = q["K_p"] * e + q["K_i"] * total + raised
            if at_once:
                outside = 1.0 + q["g"] * (N - 1.0) - drag(N, w)
                rate = (outside + q["v"] * known) / (q["tau_n"] + q["v"] * q["K_d"])
                A = X_d = known - q["K_d"] * rate
                X = A
            else:
                early = q["T_d"] > 0.0 and middle < q["T_d"]
                if early:
                    X_d = F_0 / q["v"]
                elif q["T_d"] > 0.0:
                    X_d = past.at(t - q["T_d"], middle - q["T_d"])[-1]
                else:
                    X_d = math.nan
                A = lagged if q["tau_act"] > 0.0 else X_d
                rate = (1.0 + q["g"] * (N - 1.0) + q["v"] * A - drag(N, w)) / q["tau_n"]
                X = known - q["K_d"] * rate
                if q["T_d"] == 0.0:
                    X_d = X
            lag = (X_d - A) / q["tau_act"] if q["tau_act"] > 0.0 else 0.0
            return rate, e, lag, A, drag(N, w), X

        solved = solve_ivp(
            lambda t, x: signals(t, x)[:3],
            (start, stop),
            state,
            method="DOP853",
            rtol=tolerance,
            atol=tolerance * 1e-2,
            dense_output=True,
            first_step=(stop - start) / 2,
        )
        assert solved.success

        def dense(t: float) -> tuple[float, ...]:
            x = solved.sol(t)
            rate, _, _, A, L, X = signals(t, x)
            return x[0], x[1], A, rate, L, X

        return dense, solved.y[:, -1]

    x = np.array([N_0, 0.0, F_0 / q["v"]])
    for start, stop in itertools.pairwise(cuts):
        piece, x = over(start, stop, x)
        past.add(start, piece)
    # The last sample lies behind its own break; the piece ends before the next one.
    piece, _ = over(cuts[-1], cuts[-1] + 1e-5 * dt, x)
    past.add(cuts[-1], piece)

    rows = []
    for output in outputs:
        name = SHIP_OUTPUTS[output]
        late = q["T_n"] if name in ("dn", "dn_prop") else q["T_M"] if name in ("dM_b", "dM_g") else 0.0
        row = []
        for k in range(len(u)):
            t = k * dt - late
            if t < -1e-10:
                A, N, rate, L, total = F_0 / q["v"], N_0, 0.0, drag(N_0, torque.samples[0]), 0.0
            else:
                N, total, A, rate, L, _ = past.at(max(t, 0.0), max(t, 0.0) + 1e-9)
            row.append(
                {
                    "dn": N - 1.0,
                    "dn_prop": N - 1.0,
                    "dM_b": q["s_M"] * (1.0 + q["g"] * (N - 1.0) + q["v"] * A) - 1.0,
                    "dM_g": q["s_M"] * (L + q["tau_prop"] * rate) - 1.0,
                    "dX": A,
                    "dE": total + (raised / q["K_i"] if q["K_i"] else 0.0),
                }[name]
            )
        rows.append(row)
    return np.array(rows)


def differences(
    parameters: Array, name: str, *arguments: object, step: float = 1e-4, **options: object
) -> Array:
    """Central differences of fourth order along a parameter, shape (O, N)."""
    at = SHIP_PARAMETERS.index(name)

    def moved(by: float) -> Array:
        changed = parameters.copy()
        changed[at] += by
        return simulate(changed, *arguments, **options)  # type: ignore[arg-type]

    near = moved(step) - moved(-step)
    far = moved(2 * step) - moved(-2 * step)
    return (8.0 * near - far) / (12.0 * step)
