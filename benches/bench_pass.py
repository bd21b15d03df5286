"""One pass of a fit of the ship, `ship_observed`: outputs and derivatives, low-passed and decimated as the data are.

Build with `maturin develop --release`, then `python -m benches.bench_pass`.

All times are nanoseconds a step of 5 ms, four to a sample of a chirp at 50 Hz, outputs dn and dM_g, first-order hold, one
thread; derivatives are by twelve parameters, and every fourth sample is kept. The rival simulates in Numba, has derivatives
by forward differences, and filters by SciPy.
"""

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from benches.bench_ship import DT, NO_LOAD, OUTPUTS, SUBSTEPS, TWELVE, chirp, differences, numba_twin, vector
from benches.timing import in_turn, print_table, spread
from shipfp_rs import _core

Array = NDArray[np.float64]

DOWN = 4
TAPS = signal.firwin(20 * DOWN + 1, 0.8 / DOWN)


def ours(u: Array, wrt: list[int]) -> Array:
    """Outputs and derivatives, shape (2, 1 + W, K)."""
    masked = np.zeros((u.size, len(OUTPUTS)), dtype=np.bool_)
    return _core.ship_observed(
        vector(), u, NO_LOAD, DT, SUBSTEPS, "first", 1, OUTPUTS, wrt, masked, TAPS, DOWN
    )


def seen(rows: Array) -> Array:
    """Low-pass and decimate rows of samples."""
    return signal.resample_poly(rows, 1, DOWN, axis=-1, window=TAPS, padtype="edge")


def numba_outputs(u: Array) -> Array:
    return seen(numba_twin(vector()[TWELVE], u, DT / SUBSTEPS, SUBSTEPS))


def numba_derivatives(u: Array) -> Array:
    return seen(differences(vector()[TWELVE], u, DT / SUBSTEPS, SUBSTEPS))


def main() -> None:
    parser = argparse.ArgumentParser(description="Benchmark one pass of a fit")
    parser.add_argument("--quick", action="store_true", help="a short record, just to see that it runs")
    quick = parser.parse_args().quick
    samples, rounds = (2_000, 3) if quick else (25_000, 9)
    u, steps = chirp(samples), (samples - 1) * SUBSTEPS
    found, expected = ours(u, [])[:, 0], numba_outputs(u)
    np.testing.assert_allclose(found, expected, atol=1e-2 * np.abs(expected).max())
    ship, run = vector(), (u, NO_LOAD, DT, SUBSTEPS, "first", OUTPUTS)
    calls: dict[str, Callable[[], object]] = {
        "outputs": lambda: ours(u, []),
        "Numba and SciPy, outputs": lambda: numba_outputs(u),
        "outputs and derivatives": lambda: ours(u, TWELVE),
        "the same, neither low-passed nor decimated": lambda: _core.ship_sensitivities(ship, *run, TWELVE),
        "Numba and SciPy, forward differences": lambda: numba_derivatives(u),
    }
    times = {name: np.array(seconds) for name, seconds in in_turn(calls, rounds).items()}
    print_table(
        ["ns a step", "median [quartiles]", "least"],
        [
            [name, spread(list(seconds / steps * 1e9)), f"{seconds.min() / steps * 1e9:.1f}"]
            for name, seconds in times.items()
        ],
    )
    for own, other in (
        ("outputs", "Numba and SciPy, outputs"),
        ("outputs and derivatives", "Numba and SciPy, forward differences"),
    ):
        print(f"{other}: {spread(list(times[other] / times[own]))} times ours")


if __name__ == "__main__":
    main()
