"""NumPy reference of the plant with its elements: complex numbers pass through, so a complex step differentiates it."""

import math

import numpy as np
from numpy.typing import NDArray

from shipfp_rs._core import DRIVE_TRAIN_PARAMETERS, GREY_BOX_OUTPUTS

from . import drive_train

Array = NDArray[np.float64]

DEFAULTS = drive_train.DEFAULTS | {"propeller_inertia": 8.0}


def vector(**changes):
    """Parameters of the launch with its elements off, some of them changed."""
    assert set(changes) <= set(DEFAULTS)
    values = DEFAULTS | changes
    return np.array([values[name] for name in DRIVE_TRAIN_PARAMETERS])


def least(a, b):
    """The one with the least real part."""
    return a if a.real < b.real else b


def simulate(parameters, limit_speed, limit_torque, n_set, dt, substeps, hold, outputs):
    """Rows of the outputs, by their places in GREY_BOX_OUTPUTS; complex ones if a parameter is."""
    q = dict(zip(DRIVE_TRAIN_PARAMETERS, parameters.tolist(), strict=True))
    ramps = {"rack": None, "torque": None}

    def ramped(name, demand, elapsed):
        rate = q[f"{name}_rate"]
        if math.isinf(rate.real) or ramps[name] is None:
            return demand
        return -least(-least(demand, ramps[name] + rate * elapsed), -(ramps[name] - rate * elapsed))

    def limit(n_e):
        if not limit_speed.size:
            return math.inf
        at = int(
            np.clip(np.searchsorted(limit_speed, n_e.real, side="right"), 1, max(1, limit_speed.size - 1))
        )
        if limit_speed.size == 1 or n_e.real < limit_speed[0] or n_e.real >= limit_speed[-1]:
            return float(np.interp(n_e.real, limit_speed, limit_torque)) * q["limit_factor"]
        rise = (limit_torque[at] - limit_torque[at - 1]) / (limit_speed[at] - limit_speed[at - 1])
        return (limit_torque[at - 1] + rise * (n_e - limit_speed[at - 1])) * q["limit_factor"]

    def signals(set_speed, elapsed, state):
        n_s, E_n = state
        n_e = q["gear_ratio"] * n_s
        ordered = q["X_0"] + q["Kp_abs"] * (set_speed - n_e) + q["Ki_abs"] * E_n
        X_f = ramped("rack", ordered, elapsed)
        wanted = least(q["A1"] * X_f + q["A2"] * n_e + q["A3"], limit(n_e))
        wanted = -least(-wanted, -q["minimum_torque"])
        M_b = ramped("torque", wanted, elapsed)
        M_s = M_b * q["gear_ratio"] * q["transmission_efficiency"]
        M_p = (
            q["torque_coefficient"] * n_s * ((n_s if n_s.real > 0 else -n_s) ** (q["torque_exponent"] - 1.0))
        )
        M_g = M_p + q["propeller_inertia"] / q["inertia"] * (M_s - M_p)
        rate = np.array([(M_s - M_p) / (2 * np.pi * q["inertia"]), set_speed - n_e])
        shown = dict(zip(GREY_BOX_OUTPUTS, (n_e, n_s, M_b, M_g, X_f, E_n), strict=True))
        return rate, shown, ordered, wanted

    late = math.floor(q["set_dead_time"].real / dt)
    part = q["set_dead_time"] - late * dt

    before = q["set_point_before"].real

    def sample(k):
        return n_set[min(k, n_set.size - 1)] if k >= 0 else before

    def piece(k, start, duration):
        """Value at `start` after sample `k`, slope, duration."""
        slope = (sample(k + 1) - sample(k)) / dt if hold == "first" and k >= 0 else 0.0
        return sample(k) + slope * start, slope, duration

    state = np.array([q["initial_speed"], q["initial_error"]])
    _, _, rack, _ = signals(before, 0.0, state)
    ramps = {"rack": rack, "torque": q["A1"] * rack + q["A2"] * q["gear_ratio"] * state[0] + q["A3"]}
    rows = []
    for k in range(n_set.size):
        pieces = [piece(k - late - 1, dt - part, part), piece(k - late, 0.0, dt - part)]
        if part == 0.0:
            pieces = pieces[1:]
        _, shown, _, _ = signals(pieces[0][0], 0.0, state)
        rows.append([shown[GREY_BOX_OUTPUTS[output]] for output in outputs])
        for begin, slope, duration in pieces:
            h = duration / substeps
            for j in range(substeps):
                at = begin + slope * h * j
                k1 = signals(at, 0.0, state)[0]
                k2 = signals(at + slope * h / 2, h / 2, state + h / 2 * k1)[0]
                k3 = signals(at + slope * h / 2, h / 2, state + h / 2 * k2)[0]
                k4 = signals(at + slope * h, h, state + h * k3)[0]
                state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                _, _, ordered, wanted = signals(at + slope * h, h, state)
                ramps = {"rack": ramped("rack", ordered, h), "torque": ramped("torque", wanted, h)}
    return np.array(rows).T


def sensitivities(parameters, *run, directions):
    """Rows (O, N) and their derivatives (W, O, N) in the directions, by complex step."""
    step = 1e-30
    moved = [simulate(parameters + 1j * step * direction, *run).imag / step for direction in directions]
    values = simulate(parameters, *run)
    return values, np.array(moved).reshape(len(directions), *values.shape)
