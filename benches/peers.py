"""This library against its peers on the same work in one run: ratios with their spread, and how far the machine still is.

`python -m benches.peers`, with a release build installed and OPENBLAS_NUM_THREADS=1; peers that are not installed are left
out with a line. docs/benchmarks.md explains every figure.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.signal
from tests.launch import TRUTH, noisy_record

from benches import bench_linear, bench_plant, bench_pulse, rivals
from benches.timing import in_turn, print_table, spread
from shipfp_rs import signals
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.question import Options
from shipfp_rs.identification.structure_fit import StructureQuestion, fit_structure
from shipfp_rs.structures.structure import Structure

Calls = dict[str, Callable[[], object] | None]
MULTIPLY_ADDS_OF_A_STEP = 44
"""Of one RK4 step of a member: four times the torque, the propeller's square, two rates; three mixtures of both states."""


def report(title: str, unit: str, work: float, calls: Calls, repeats: int) -> dict[str, float]:
    """Print medians per unit of work and ratios to the first call, which is ours; return the medians in seconds."""
    for name in [name for name, call in calls.items() if call is None]:
        print(f"{name}: not installed, left out")
    times = in_turn({name: call for name, call in calls.items() if call is not None}, repeats)
    ours = next(iter(times.values()))
    rows = [
        [
            name,
            f"{1e9 * statistics.median(own) / work:.3g}",
            spread([other / mine for other, mine in zip(own, ours, strict=True)]),
        ]
        for name, own in times.items()
    ]
    print()
    print_table([title, f"ns a {unit}", "times ours"], rows)
    return {name: statistics.median(own) for name, own in times.items()}


def limits(short: bool) -> tuple[float, float]:
    """Bytes a second that one core reads from memory, and multiply-adds a second that it computes."""
    large, square = np.ones(1_000_000 if short else 50_000_000, np.float32), np.ones((600, 600))
    times = in_turn({"read": large.max, "multiply": lambda: square @ square}, 9)
    read = large.nbytes / statistics.median(times["read"])
    adds = 600**3 / statistics.median(times["multiply"])
    print(
        f"\nThe machine, one core: reads {read / 1e9:.1f} GB/s (np.max), {adds / 1e9:.1f} G multiply-adds/s (dgemm)"
    )
    return read, adds


def plant(short: bool, repeats: int, adds: float) -> None:
    """One run."""
    none, samples = np.empty(0), 2_000 if short else 20_000
    n_set = 1300.0 / 60.0 * (1.0 + 0.05 * np.sin(np.arange(samples) * 0.01))
    parameters, out = bench_plant.PARAMETERS, np.empty((4, samples))

    def ours() -> np.ndarray:
        return bench_plant.by_the_ship(parameters, (none, none), n_set, 1)

    def numba() -> np.ndarray:
        bench_plant.simulate(parameters, none, none, n_set, 0.01, 1, bench_plant.INITIAL, out)
        return out

    np.testing.assert_allclose(ours(), numba(), rtol=1e-9, atol=1e-9)
    calls: Calls = {
        "shipfp_rs": ours,
        "Numba, scalar": numba,
        "JAX, scan": rivals.jax_plant(parameters[None], n_set, 0.01, 1),
        "diffrax, Tsit5": rivals.diffrax_plant(parameters, n_set, 0.01),
    }
    medians = report("plant, one run", "step", samples, calls, repeats)
    few = n_set[:200]
    start = time.process_time()
    rivals.solve_ivp_plant(parameters, few, 0.01)()
    seconds = (time.process_time() - start) / len(few)
    print(f"SciPy solve_ivp on {len(few)} samples: {seconds * samples / medians['shipfp_rs']:.0f} times ours")
    part = samples * MULTIPLY_ADDS_OF_A_STEP / medians["shipfp_rs"] / adds
    print(f"ours computes at {100 * part:.0f} % of the machine's multiply-adds")


def linear(short: bool, repeats: int) -> None:
    """Outputs of the linear structure, and derivatives by seven parameters, on a record of 1500 s at 100 Hz."""
    count, few = 3_000 if short else 150_000, 2_000
    dn_set = np.cumsum(np.random.default_rng(804).normal(size=count)) * 1e-3
    dn_set -= dn_set[0]
    A, B, C, D = bench_linear.state_space(bench_linear.LAUNCH)
    system = A, B.sum(axis=1, keepdims=True), C, D.sum(axis=1, keepdims=True)

    def of(simulate: Callable[..., object], samples: int = count) -> Callable[[], object]:
        return lambda: simulate(bench_linear.LAUNCH, dn_set[:samples])

    calls: Calls = {
        "shipfp_rs": of(bench_linear.outputs),
        "one lfilter call": lambda: scipy.signal.lfilter([0.0, 0.1, 0.05], [1.0, -1.5, 0.6], dn_set),
        "SciPy lfilter, both outputs": of(bench_linear.lfilter_outputs),
        "Numba": of(bench_linear.numba_outputs),
    }
    one = report("linear structure, two outputs", "sample", count, calls, repeats)
    slow: Calls = {
        "shipfp_rs": of(bench_linear.outputs, few),
        "SciPy lsim": of(bench_linear.lsim_outputs, few),
        "python-control": rivals.control_outputs(*system, dn_set[:few], bench_linear.DT),
    }
    report(f"linear structure, {few} samples", "sample", few, slow, 3)
    octave = rivals.octave_seconds(*system, count, bench_linear.DT)
    name = "GNU Octave, lsim of the control package"
    print(
        f"{name}: "
        + ("not installed, left out" if octave is None else f"{octave / one['shipfp_rs']:.0f} times ours")
    )
    for title, vector, wrt in (
        ("no dead time", bench_linear.LAUNCH, [0, 1, 2, 3, 4, 5, 6]),
        ("both dead times", bench_linear.DEAD_TIMES, bench_linear.SEVEN),
    ):
        own = partial(bench_linear.derivatives, vector, dn_set, wrt)
        other = partial(bench_linear.differences, bench_linear.numba_outputs, vector, dn_set, wrt)
        calls = {"shipfp_rs": own, "Numba, 8 simulations": other}
        report(f"outputs and derivatives by 7, {title}", "sample", count, calls, min(repeats, 5))


def pulses(short: bool, repeats: int, read: float) -> None:
    """Crossings of 3.2 hours of a float32 pulse train at 2 kHz."""
    train = bench_pulse.pulse_train(1_000_000 if short else 23_000_000, 20.65)
    levels = bench_pulse.LOW, bench_pulse.HIGH, bench_pulse.MIDDLE
    calls: Calls = {
        "shipfp_rs": lambda: bench_pulse.ours(train),
        "np.max of the same": train.max,
        "Numba state machine": lambda: bench_pulse.state_machine(train, *levels),
    }
    medians = report("pulse train", "sample", train.size, calls, repeats)
    print(f"ours reads at {100 * train.nbytes / medians['shipfp_rs'] / read:.0f} % of the machine's speed")


def identification(short: bool, repeats: int) -> None:
    """One fit of a chirp of 1500 s at 200 Hz: two outputs, white noise, four parameters, states and offsets."""
    chirp = signals.chirp(0.0014, 20.0, 25.0 if short else 1500.0, 13.0, law="logarithmic", rate_hz=200.0)
    record = noisy_record(chirp, 0.05, 0.0, 1)
    measured = np.array([record.normalised("n_e"), record.normalised("M_b")])
    twin = rivals.SciPyFit(record.dn_set, measured, 1.0 / record.rate_hz)
    structure = Structure.linear(products=True)

    def ours() -> tuple[np.ndarray, np.ndarray]:
        """Search, and the covariance of all unknowns, as the twin does."""
        fit = fit_structure(StructureQuestion((record,), structure, Options("white")))
        values = fit.likelihood.coordinates.values(fit.best.vector)
        slopes = fit.likelihood.coordinates.jacobian(values).diagonal()
        matrix = fit.likelihood.products(fit.best.vector).matrix
        covariance = np.linalg.inv(matrix)[:4, :4] * np.outer(slopes, slopes)
        return np.array([values[name] for name in TRUTH]), covariance

    if not short:
        (found, covariance), (theirs, also) = ours(), twin()
        np.testing.assert_allclose(found[:4], theirs[:4], rtol=1e-5)
        np.testing.assert_allclose(np.diag(covariance)[:4], np.diag(also)[:4], rtol=1e-2)
    medians = report(
        "identification",
        "sample",
        len(record),
        {
            "shipfp_rs, search and covariance": ours,
            "SciPy least_squares over Numba": twin,
            "shipfp_rs, identify with all it tells": lambda: identify(record, structure, noise="white"),
            "shipfp_rs, identify with noise='coloured'": lambda: identify(
                record, structure, noise="coloured"
            ),
        },
        repeats,
    )
    tau_n, g, vK_p, vK_i = TRUTH.values()
    A, B, C, D = bench_linear.state_space(np.array([tau_n, g, 1.0, vK_p, vK_i, 2.0, 0.0, 0.0, 0.0]))
    few = 2_000
    call = rivals.control_outputs(
        A,
        B.sum(axis=1, keepdims=True),
        C,
        D.sum(axis=1, keepdims=True),
        record.dn_set[:few],
        0.005,
    )
    if call is None:
        print("python-control: not installed, left out")
        return
    one = statistics.median(in_turn({"control": call}, 3)["control"]) * len(record) / few
    whole = one * twin.simulations
    print(
        f"python-control: one simulation takes {one:.3g} s ({few} samples, scaled); the {twin.simulations} simulations of "
        f"the fit above would take {whole:.3g} s"
    )
    for name in ("search and covariance", "identify with all it tells"):
        own = medians[f"shipfp_rs, {name}"]
        print(
            f"{name}: {own:.3f} s; SciPy over Numba takes {medians['SciPy least_squares over Numba'] / own:.1f} times as "
            f"long, python-control {whole / own:.0f} times"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="short records, just to see that it runs")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--only", choices=("plant", "linear", "pulses", "identification"), help="one part")
    options = parser.parse_args()
    short, repeats = options.quick, 1 if options.quick else options.repeats
    read, adds = limits(short)
    parts: dict[str, Callable[[], None]] = {
        "plant": lambda: plant(short, repeats, adds),
        "linear": lambda: linear(short, repeats),
        "pulses": lambda: pulses(short, repeats, read),
        "identification": lambda: identification(short, min(repeats, 5)),
    }
    for name, part in parts.items():
        if options.only in (None, name):
            part()


if __name__ == "__main__":
    main()
