"""The engine's side alone, in plain NumPy: what limits of rate and torque take off it for measured signals."""

from __future__ import annotations

import numpy as np

from shipfp_rs._core import ENGINE_SIDE_PARAMETERS
from tests.twins.plant import vectors

OFF = dict.fromkeys(ENGINE_SIDE_PARAMETERS, 0.0) | {"s_M": 1.0, "leads": 1.0}
OFF |= dict.fromkeys(("rate", "rate_down", "M_max"), np.inf)
GOVERNOR = {"g": -0.6, "vK_p": 4.0, "vK_i": 5.0}
SUBSTEPS = 200


vector = vectors(OFF | GOVERNOR, ENGINE_SIDE_PARAMETERS)
"""Parameters of a governor, some of them changed."""


def late(row, delay):
    """A signal (N,) late by so many samples: Catmull and Rom's cubic through the four samples about."""
    at = np.arange(len(row)) - delay
    first = np.floor(at).astype(int)
    x = at - first
    a, b, c, d = (row[np.clip(first + place, 0, len(row) - 1)] for place in (-1, 0, 1, 2))
    return b + 0.5 * x * (c - a + x * (2.0 * a - 5.0 * b + 4.0 * c - d + x * (3.0 * (b - c) + d - a)))


def behind_filter(row, time):
    """A signal (N,) behind a first-order filter with a time constant in samples, by small steps."""
    if time == 0.0:
        return row
    found = row.copy()
    for k in range(1, len(row)):
        state = found[k - 1]
        for value in row[k - 1] + (row[k] - row[k - 1]) * (np.arange(SUBSTEPS) + 0.5) / SUBSTEPS:
            state += (value - state) / (time * SUBSTEPS + 0.5)
        found[k] = state
    return found


def taken_by_limits(q, set_point, speed, torque, every):
    """Return what limits take off the torque (N,) and the rack (N,); `q` has the parameters by name."""
    apart = q["T_s"] / np.sqrt(12.0)

    def governed(row, delay):
        return 0.5 * (late(row, (delay - apart) / every) + late(row, (delay + apart) / every))

    seen = governed(behind_filter(speed, q["T_f"] / every), q["T_d"] - q["T_n"])
    error = governed(set_point, q["T_d"] + q["T_set"]) + q["u_0"] - seen
    turning = np.gradient(np.pad(speed, 1, mode="edge"))[1:-1] / every
    engine = (1.0 + late(torque, -q["T_M"] / every)) / q["s_M"] - 1.0 + q["ahead"] * turning
    less = 1.0 / (1.0 + q["droop"] * q["vK_p"])
    own = less * q["vK_p"] * error
    total = engine[0] - q["g"] * speed[0] - own[0]
    free = rack = before = own[0] + total
    found, fed = np.empty((2, len(speed))), np.empty((2, len(speed)))
    whole = taken = 0.0
    for k in range(len(speed)):
        if k:
            total += less * q["vK_i"] * 0.5 * (error[k] + error[k - 1]) * every
            # The droop takes of the integral what the mean command asks for.
            half = 0.5 * every * q["droop"] * less * q["vK_i"]
            total = (total - half * (before + own[k])) / (1.0 + half)
            command, h = own[k] + total, every / SUBSTEPS
            for asked in before + (command - before) * (np.arange(SUBSTEPS) + 0.5) / SUBSTEPS:
                if q["tau_act"] > 0.0:
                    free += h * (asked - free) / q["tau_act"]
                    rack += h * np.clip((asked - rack) / q["tau_act"], -q["rate_down"], q["rate"])
                else:
                    free = asked
                    rack += np.clip(asked - rack, -q["rate_down"] * h, q["rate"] * h)
            free = command if q["tau_act"] == 0.0 else free
        before = own[k] + total
        fed[:, k] = q["g"] * speed[k] + rack, rack - free
        if not k or q["tau_eng"] == 0.0:
            whole, taken = 1.0 + fed[0, k], fed[1, k]
        else:
            for part in (np.arange(SUBSTEPS) + 0.5) / SUBSTEPS:
                asked = fed[:, k - 1] + part * (fed[:, k] - fed[:, k - 1])
                share = every / (q["tau_eng"] * SUBSTEPS + 0.5 * every)
                whole, taken = whole + share * (1.0 + asked[0] - whole), taken + share * (asked[1] - taken)
        given = min(whole, q["M_max"])
        if q["M_soft"] > 0.0:
            given = q["M_max"] - q["M_soft"] * np.logaddexp(0.0, (q["M_max"] - whole) / q["M_soft"])
        found[:, k] = given - whole + taken, rack - free
        beyond = (1.0 + engine[k] - given) * q["leads"] * every
        total, before, whole = total + beyond, before + beyond, whole + beyond
        fed[0, k] += beyond
        if np.isfinite(min(q["rate"], q["rate_down"])):
            rack, free = rack + beyond, free + beyond
    return found
