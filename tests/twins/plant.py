"""NumPy reference of the nonlinear plant: eq. 3.1 to 3.11 as they stand, one step after the other."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from shipfp_rs.vessel.drive_train import PLANT_PARAMETERS


def vectors(usual: Mapping[str, float], names: Sequence[str]) -> Callable[..., NDArray[np.float64]]:
    """Return a function that makes the vector of these names, with some of the usual values changed."""

    def vector(**changes: float) -> NDArray[np.float64]:
        assert set(changes) <= set(usual)
        values = {**usual, **changes}
        return np.array([float(values[name]) for name in names])

    return vector


Array = NDArray[np.float64]

LAUNCH = {
    "inertia": 21.2,
    "gear_ratio": 3.0,
    "transmission_efficiency": 0.95,
    "A1": 27.00062662586075,
    "A2": -5.9985318461538455,
    "A3": 0.0,
    "torque_coefficient": 12.180684142011833,
    "torque_exponent": 2.0,
    "X_0": 13.07,
    "Kp_abs": 6.0323076923076915,
    "Ki_abs": 0.60323076923076915,
    "minimum_torque": -np.inf,
}
"""Stan Launch 804 at the operating point of Table 3.5."""
N_E = 1300.0 / 60.0
M_B = 222.93
UNLIMITED = (np.empty(0), np.empty(0))


vector = vectors(LAUNCH, PLANT_PARAMETERS)
"""Parameters of the launch, some of them changed."""


def simulate(
    parameters: Array,
    limit_speed: Array,
    limit_torque: Array,
    n_set: Array,
    dt: float,
    substeps: int,
    method: str,
    hold: str,
    initial: Array,
) -> Array:
    """Rows n_s, E_n, X_f, M_b."""
    q = dict(zip(PLANT_PARAMETERS, parameters, strict=True))

    def rack(set_speed: float, state: Array) -> float:
        n_s, E_n = state
        return q["X_0"] + q["Kp_abs"] * (set_speed - q["gear_ratio"] * n_s) + q["Ki_abs"] * E_n

    def brake_torque(set_speed: float, state: Array) -> float:
        n_e = q["gear_ratio"] * state[0]
        demand = q["A1"] * rack(set_speed, state) + q["A2"] * n_e + q["A3"]
        limit = np.interp(n_e, limit_speed, limit_torque) if limit_speed.size else np.inf
        return max(min(demand, limit), q["minimum_torque"])

    def rate(set_speed: float, state: Array) -> Array:
        n_s, _ = state
        M_s = brake_torque(set_speed, state) * q["gear_ratio"] * q["transmission_efficiency"]
        M_p = q["torque_coefficient"] * np.sign(n_s) * abs(n_s) ** q["torque_exponent"]
        return np.array([(M_s - M_p) / (2 * np.pi * q["inertia"]), set_speed - q["gear_ratio"] * n_s])

    step = {"euler": euler, "heun": heun, "rk4": rk4}[method]
    state, rows = np.array(initial), []
    for k, now in enumerate(n_set):
        rows.append([*state, rack(now, state), brake_torque(now, state)])
        after = n_set[min(k + 1, n_set.size - 1)] if hold == "first" else now
        for j in range(substeps):
            begin, end = (now + (after - now) * i / substeps for i in (j, j + 1))
            state = step(rate, begin, end, state, dt / substeps)
    return np.array(rows).T


Rate = Callable[[float, Array], Array]


def euler(rate: Rate, begin: float, end: float, x: Array, h: float) -> Array:
    """Forward Euler."""
    return x + h * rate(begin, x)


def heun(rate: Rate, begin: float, end: float, x: Array, h: float) -> Array:
    """Explicit trapezoid."""
    first = rate(begin, x)
    return x + h / 2 * (first + rate(end, x + h * first))


def rk4(rate: Rate, begin: float, end: float, x: Array, h: float) -> Array:
    """Classical fourth-order Runge-Kutta."""
    middle = (begin + end) / 2
    first = rate(begin, x)
    second = rate(middle, x + h / 2 * first)
    third = rate(middle, x + h / 2 * second)
    fourth = rate(end, x + h * third)
    return x + h / 6 * (first + 2 * second + 2 * third + fourth)
