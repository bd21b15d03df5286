"""The whole drive train beside a scalar Numba twin: `python -m benches.bench_drive_train`, with a release build installed.

The launch with a governor that samples, a dead time, a lag and rate limits; then with single firings and a flexible
shaft too; then with what takes powers and cosines at every turn. The twin's delays and periods are whole numbers of
its steps, which saves it the events; ours may be any.
"""

import argparse
import math

import numpy as np
from numba import njit

from benches.bench_plant import DT, PARAMETERS, UNLIMITED
from benches.timing import in_turn, print_table, spread
from shipfp_rs import _core
from shipfp_rs.vessel.drive_train import OFF, PLANT_PARAMETERS

SUBSTEPS = 10
EVERY, LATE = 20, 50
"""Steps between samples of the governor, and of the dead time."""
H = DT / SUBSTEPS
N_E = 1300.0 / 60.0
START = {
    "initial_speed": N_E / 3.0,
    "initial_error": 0.0,
    "initial_ship_speed": 0.0,
    "set_point_before": N_E,
    "crank_angle": 0.0,
}
IDLE = {
    "drag_exponent": 1.0,
    "derivative_filter": 0.0,
    "turbocharger_lag": 0.0,
    "firing_width": 0.5,
    "blades": 3.0,
    "blade_path": 1.7,
    "inflow": 1.0,
    "thrust_coefficient": 144.0,
    "ship_resistance": 0.0,
}
SAMPLED = {
    "propeller_inertia": 2.81,
    "governor_period": EVERY * H,
    "fuel_dead_time": LATE * H,
    "fuel_lag": 0.03,
    "rack_rate": 40.0,
    "torque_rate": 600.0,
}
CASES = {
    "sampled, delayed, limited": SAMPLED,
    "and firing, flexible shaft": SAMPLED
    | {"firing_interval": 1.0 / 3.0, "shaft_stiffness": 2e4, "shaft_damping": 20.0},
}
CASES["and ripple, exponent 2.17, drag"] = CASES["and firing, flexible shaft"] | {
    "torque_exponent": 2.17,
    "torque_coefficient": 8.7,
    "shaft_ripple": 0.005,
    "blade_ripple": 0.01,
    "drag_coefficient": 1.0,
    "drag_exponent": 1.3,
}
"""All that a power or a cosine is taken of; the twin takes the library's."""


def vector(**changes: float) -> np.ndarray:
    """Parameters of the launch with some elements on."""
    plant = dict(zip(PLANT_PARAMETERS, PARAMETERS.tolist(), strict=True))
    values = plant | OFF | IDLE | START | changes
    return np.array([values[name] for name in _core.DRIVE_TRAIN_PARAMETERS])


@njit(inline="always")
def within(value, demand, reach):
    """What of a demand is reached."""
    return min(max(demand, value - reach), value + reach)


@njit(inline="always")
def flow(q, x, fuel, elapsed, rack_before, torque_before, fuelled, fired, k):
    """Rates of the state into `k`; the rack's and the torque's demand, M_b, M_g, as one would write it."""
    n_e = q[1] * x[0]
    k[4] = (within(rack_before, fuel, q[12] * elapsed) - x[4]) / q[13]
    demand = max(q[3] * x[4] + q[4] * n_e + q[5], q[11])
    M_b = within(torque_before, demand, q[14] * elapsed)
    if q[15] > 0.0:
        M_b = 0.0
        for back in range(6):
            age = x[3] - (fired - back) * q[15]
            if age >= q[16]:
                break
            M_b += q[15] / q[16] * (1.0 - math.cos(2.0 * math.pi * age / q[16])) * fuelled[(fired - back) % 6]
    M_s = M_b * q[1] * q[2]
    if q[22] > 0.0:
        M_s -= q[22] * x[0] * abs(x[0]) ** (q[23] - 1.0)
    M_p = q[6] * x[1] * (abs(x[1]) if q[7] == 2.0 else abs(x[1]) ** (q[7] - 1.0))
    if q[20] > 0.0 or q[21] > 0.0:
        turn = 2.0 * math.pi * x[5]
        M_p *= 1.0 + q[20] * math.cos(turn) + q[21] * math.cos(q[24] * turn)
    slip = x[0] - x[1]
    if q[17] < math.inf:
        M_g = 2.0 * math.pi * (q[17] * x[2] + q[18] * slip)
        k[0] = (M_s - M_g) / (2.0 * math.pi * (q[0] - q[19]))
        k[1] = (M_g - M_p) / (2.0 * math.pi * q[19])
    else:
        k[0] = (M_s - M_p) / (2.0 * math.pi * q[0])
        k[1] = k[0]
        M_g = M_p + q[19] / q[0] * (M_s - M_p)
    k[2], k[3], k[5] = slip, n_e, x[1]
    return demand, M_b, M_g


@njit
def simulate(q, n_set, every, late, dt, substeps, out):
    """RK4 with zero hold; the command of each step is kept for the dead time."""
    h = dt / substeps
    n = N_E / 3.0
    rack = q[8]
    twist = q[6] * n ** q[7] / (2.0 * math.pi * q[17])
    x, y, k = np.array([n, n, twist, 0.0, rack, 0.0]), np.empty(6), np.empty((4, 6))
    torque = q[3] * rack + q[4] * q[1] * n + q[5]
    fuelled, fired = np.full(6, torque), -1
    commands = np.full(late, rack)
    held, rack_ramp, integral, miss, step = rack, rack, 0.0, 0.0, 0
    for sample in range(n_set.size):
        for substep in range(substeps):
            if step % every == 0:
                now = n_set[sample] - q[1] * x[0]
                integral += (every * h if step else 0.0) * 0.5 * (now + miss)
                miss = now
                held = q[8] + q[9] * miss + q[10] * integral
            fuel = commands[step % late]
            commands[step % late] = held
            demand, M_b, M_g = flow(q, x, fuel, 0.0, rack_ramp, torque, fuelled, fired, k[0])
            if q[15] > 0.0 and x[3] >= (fired + 1) * q[15]:
                fired += 1
                fuelled[fired % 6] = within(torque, demand, 0.0)
                demand, M_b, M_g = flow(q, x, fuel, 0.0, rack_ramp, torque, fuelled, fired, k[0])
            if substep == 0:
                out[0, sample], out[1, sample] = q[1] * x[0], x[1]
                out[2, sample], out[3, sample], out[4, sample] = M_b, M_g, x[4]
            for stage, part in ((1, 0.5), (2, 0.5), (3, 1.0)):
                for i in range(6):
                    y[i] = x[i] + part * h * k[stage - 1, i]
                flow(q, y, fuel, part * h, rack_ramp, torque, fuelled, fired, k[stage])
            for i in range(6):
                x[i] += h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
            rack_ramp = within(rack_ramp, fuel, q[12] * h)
            demand = max(q[3] * x[4] + q[4] * q[1] * x[0] + q[5], q[11])
            torque = within(torque, demand, q[14] * h)
            step += 1


def main() -> None:
    """Print nanoseconds a step of both, and the ratio."""
    parser = argparse.ArgumentParser(description="Benchmark the kernel of the whole drive train")
    parser.add_argument("--quick", action="store_true", help="a short run, just to see that it runs")
    samples = 500 if parser.parse_args().quick else 10_000
    n_set = N_E * (1.0 + 0.05 * np.sin(np.arange(samples) * DT))
    rows = []
    for name, changes in CASES.items():
        values = vector(**changes)
        named = dict(zip(_core.DRIVE_TRAIN_PARAMETERS, values.tolist(), strict=True))
        own = ("rack_rate", "fuel_lag", "torque_rate", "firing_interval", "firing_width")
        own += ("shaft_stiffness", "shaft_damping", "propeller_inertia")
        own += ("shaft_ripple", "blade_ripple", "drag_coefficient", "drag_exponent", "blades")
        q = np.array([named[key] for key in (*PLANT_PARAMETERS, *own)])

        def twin(q=q):
            out = np.empty((5, samples))
            simulate(q, n_set, EVERY, LATE, DT, SUBSTEPS, out)
            return out

        def kernel(values=values):
            tables = (values, *UNLIMITED, np.ones(6), np.empty((3, 0)))
            return _core.simulate_drive_train(*tables, n_set, DT, SUBSTEPS, "zero")

        # The twin fires at the end of whatever step passes the angle, which beats with the steps; ours end there.
        close = 1e-2 if "firing_interval" in changes else 1e-6
        np.testing.assert_allclose(kernel()[:2], twin()[:2], rtol=close)
        times = in_turn({"numba": twin, "kernel": kernel})
        scale = 1e9 / (samples * SUBSTEPS)
        numba, ours = (float(np.median(times[key])) * scale for key in ("numba", "kernel"))
        ratios = [slow / fast for slow, fast in zip(times["numba"], times["kernel"], strict=True)]
        rows.append([name, f"{numba:.1f}", f"{ours:.1f}", spread(ratios)])
    print(f"One run of {samples:,} samples, {SUBSTEPS} steps each, ns a step")
    print_table(["", "numba", "kernel", "faster [quartiles]"], rows)


if __name__ == "__main__":
    main()
