"""Fit of the plant with seven free parameters: `python -m benches.bench_grey_box`, with a release build installed.

A chirp of 500 s at 200 Hz, speed, torque and rack with 2 % noise, the search started 15 % away; then the same search on a
Numba plant and its finite differences, of a record a tenth as long. Processor seconds of one thread.
"""

import argparse
import time
from unittest.mock import patch

import numpy as np

from benches.bench_plant import simulate as numba_plant
from benches.timing import print_table
from shipfp_rs import Structure, Vessel, identify, signals, simulate
from shipfp_rs.structures.plant import PlantEquations

SEVEN = ["inertia", "A1", "A2", "Kp_abs", "Ki_abs", "torque_exponent", "propeller_torque"]
OUTPUTS = ("dn", "dM", "dX")
LAUNCH = Vessel.load("stan-launch-804")


def grey_box():
    """The launch with seven free parameters."""
    return Structure.grey_box(LAUNCH, SEVEN, outputs=OUTPUTS)


def by_differences(structure):
    """The same parameters, simulated by Numba and differentiated numerically."""
    names = (
        "inertia",
        "gear_ratio",
        "transmission_efficiency",
        "A1",
        "A2",
        "A3",
        None,
        "torque_exponent",
        "X_0",
    )
    none = np.empty(0)

    def rows(values, experiment):
        q = np.array([values[name] if name else 0.0 for name in (*names, "Kp_abs", "Ki_abs", None)])
        q[6], q[11] = values["propeller_torque"] / LAUNCH.nominal_shaft_speed ** q[7], -np.inf
        out = np.empty((4, len(experiment)))
        set_speed = experiment.signals["n_set"] / 60.0
        start = (LAUNCH.nominal_shaft_speed, 0.0)
        numba_plant(q, none, none, set_speed, 1.0 / experiment.rate_hz, 1, start, out)
        base = (LAUNCH.nominal_shaft_speed, LAUNCH.nominal_brake_torque, LAUNCH.operating_point.X_0_mm)
        return out[[0, 3, 2]] / np.array(base)[:, None] - 1.0

    return Structure.from_function(rows, structure.parameters, OUTPUTS, name="by differences")


def fit(structure, duration_s, rate_hz=200.0, **options):
    """Return processor seconds, passes over the record, largest error in deviations of the estimate, whether a minimum."""
    chirp = signals.chirp(0.002, 2.0, duration_s, 26.0, rate_hz=rate_hz)
    # Stairs, as the Numba plant takes them.
    chirp = type(chirp)(**{**chirp.__dict__, "hold": "zero"})
    log = simulate(LAUNCH, chirp, noise={"n_e": 0.02, "M_b": 0.02, "X_f": 0.02}, seed=1)
    start = {p.name: 1.15 * p.start for p in structure.free}
    products = PlantEquations.products
    with patch.object(PlantEquations, "products", autospec=True, side_effect=products) as passes:
        begin = time.process_time()
        found = identify(log, structure.with_start(**start), starts=1, **options)
        seconds = time.process_time() - begin
    off = max(abs(found[name].value - structure[name].start) / found[name].std for name in start)
    return seconds, passes.call_count, off, found.settings["converged"]


def of_all_elements(samples):
    """Return nanoseconds a sample with seven derivatives and without: the plant's short cut, and the whole drive train.

    A governor that waits at limits which are never met gives the same numbers, and takes the long way.
    """
    log = simulate(LAUNCH, signals.chirp(0.02, 2.0, samples / 200.0, 26.0, rate_hz=200.0))
    ways = {
        "short cut": LAUNCH,
        "whole drive train": LAUNCH.replace({"governor.anti_windup": True}),
    }
    for name, vessel in ways.items():
        structure = Structure.grey_box(vessel, SEVEN, outputs=OUTPUTS)
        values = {p.name: p.start for p in structure.parameters}
        seconds = []
        for names in (SEVEN, ()):
            times = []
            for _ in range(5):
                begin = time.process_time()
                structure.equations.sensitivities(values, log, names)
                times.append(time.process_time() - begin)
            seconds.append(float(np.median(times)) / len(log) * 1e9)
        yield [name, *(f"{each:.0f}" for each in seconds)]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description="Benchmark the fit of the plant")
    parser.add_argument("--quick", action="store_true", help="short records, just to see that it runs")
    duration = 20.0 if parser.parse_args().quick else 500.0
    cases = {
        "from rest": {"noise": "white", "initial_state": "zero"},
        "initial state estimated": {"noise": "white"},
        "and noise models": {"noise": "ar"},
    }
    print(f"Fit of {duration * 200:,.0f} samples, three outputs, seven parameters")
    rows = []
    for name, options in cases.items():
        seconds, passes, off, converged = fit(grey_box(), duration, **options)
        rows.append([name, f"{seconds:.2f}", f"{passes}", f"{off:.1f}", "yes" if converged else "no"])
    print_table(["", "seconds", "passes", "deviations off", "minimum"], rows)
    print(f"\nThe same search from rest, {duration * 20:,.0f} samples")
    options = cases["from rest"]
    fit(by_differences(grey_box()), 2.0, **options)
    ours, theirs = (fit(s, duration / 10.0, **options) for s in (grey_box(), by_differences(grey_box())))
    print_table(
        ["", "seconds", "times ours"],
        [
            ["derivatives in the integration", f"{ours[0]:.3f}", "1"],
            ["differences of a Numba plant", f"{theirs[0]:.3f}", f"{theirs[0] / ours[0]:.1f}"],
        ],
    )

    print("\nOne pass over the same plant, ns a sample")
    print_table(["", "seven derivatives", "values"], list(of_all_elements(round(100 * duration))))


if __name__ == "__main__":
    main()
