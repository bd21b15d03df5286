"""Normal equations of a ship's two equations beside NumPy and Numba: `python -m benches.bench_equations`, release build.

A call is what a step of a search costs for a record: residuals of speed and torque at 2,000 frequencies, their derivatives
by 17 parameters, whitened, multiplied by each other and by the smooth errors. The rivals get made-up polynomials in s as
tables, and no delays; ours works both out in the call.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit
from tests.kernels import test_two_equations_kernel as known

from benches.timing import asked, in_turn, median_time, print_table
from shipfp_rs import _core

WRT = [
    known.INDEX[name]
    for name in (
        *("tau_n", "g", "vK_p", "vK_i", "p", "tau_prop", "damping", "c_2", "k_L"),
        *("T_d", "T_set", "tau_act", "T_M", "T_n", "u_0", "s_M", "x_0"),
    )
]
OUTPUTS, ORDERS, KNOTS = [0, 1], 4, 8
POWERS = np.array([3, 3, 5, 1, 2, 2, 5, 5, 5])
"""Powers of s on speed, torque, load, squares and cubes, ones, late speed and late set point."""
TERMS = 10
"""Coefficients of a derivative, a mean over the 17."""


def tables(count: int) -> tuple[np.ndarray, ...]:
    """Signals (9, ORDERS, F), coefficients (1 + W, O, powers), inverses and roots (O, O, F), shapes, hats."""
    rng = np.random.default_rng(3)

    def numbers(*shape: int) -> np.ndarray:
        return rng.normal(size=(*shape, 2)).view(complex)[..., 0]

    columns, size = 1 + len(WRT), int(POWERS.sum())
    coefficients = np.zeros((columns, 2, size))
    for row in coefficients:
        row.ravel()[rng.choice(2 * size, TERMS, replace=False)] = rng.normal(size=TERMS)
    lower = np.tril(np.ones((2, 2)))[:, :, None]
    hats = np.maximum(0.0, 1.0 - np.abs(np.linspace(0, KNOTS - 1, count) - np.arange(KNOTS)[:, None]))
    turns = numbers(2, 2, count)
    return numbers(9, ORDERS, count), coefficients, turns, numbers(2, 2, count) * lower, turns * lower, hats


def by_numpy(data: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Whole arrays at a time."""
    signals, coefficients, inverse, root, shapes, hats = data
    s = 0.01j * np.arange(signals.shape[2])
    raised = []
    for orders, powers in zip(signals, POWERS, strict=True):
        found = orders
        raised.append(found[0])
        for _ in range(powers - 1):
            found = s * found + np.vstack([found[1:], np.zeros_like(found[:1])])
            raised.append(found[0])
    change = coefficients.reshape(-1, coefficients.shape[2]) @ np.array(raised)
    change = change.reshape(len(coefficients), 2, -1)
    weights = np.einsum("abf,bcf->acf", root, inverse)
    white = np.einsum("abf,cbf->caf", weights, change)
    flat = white.reshape(len(white), -1).view(float)
    along = np.einsum("abf,caf->cbf", shapes.conj(), white)
    return flat @ flat.T, along.view(float).reshape(len(white), 2, -1, 2).transpose(0, 1, 3, 2) @ hats.T


@njit(fastmath=True)
def by_numba(data: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The loop that one would write, a frequency at a time."""
    signals, coefficients, inverse, root, shapes, hats = data
    columns, outputs, size = coefficients.shape
    knots = len(hats)
    gram, errors = np.zeros((columns, columns)), np.zeros((columns, outputs, 2, knots))
    raised, white = np.zeros(size, np.complex128), np.zeros((columns, outputs), np.complex128)
    orders, change = np.zeros(ORDERS + 1, np.complex128), np.zeros(2, np.complex128)
    places = np.zeros(coefficients.size, np.int64)
    factors, starts, count = np.zeros(coefficients.size), np.zeros(columns * outputs + 1, np.int64), 0
    for row in range(columns * outputs):
        for slot in range(size):
            value = coefficients[row // outputs, row % outputs, slot]
            if value != 0.0:
                places[count], factors[count] = slot, value
                count += 1
        starts[row + 1] = count
    for f in range(signals.shape[2]):
        s = 0.01j * f
        slot = 0
        for k in range(len(signals)):
            for order in range(ORDERS):
                orders[order] = signals[k, order, f]
            for _ in range(POWERS[k]):
                raised[slot] = orders[0]
                slot += 1
                for order in range(ORDERS):
                    orders[order] = s * orders[order] + orders[order + 1]
        for c in range(columns):
            for b in range(outputs):
                total = 0j
                for slot in range(starts[c * outputs + b], starts[c * outputs + b + 1]):
                    total += factors[slot] * raised[places[slot]]
                change[b] = total
            left, right = (
                inverse[0, 0, f] * change[0] + inverse[0, 1, f] * change[1],
                inverse[1, 0, f] * change[0] + inverse[1, 1, f] * change[1],
            )
            white[c, 0] = root[0, 0, f] * left
            white[c, 1] = root[1, 0, f] * left + root[1, 1, f] * right
            for b in range(outputs):
                along = 0j
                for a in range(b, outputs):
                    along += np.conj(shapes[a, b, f]) * white[c, a]
                for k in range(knots):
                    if hats[k, f] != 0.0:
                        errors[c, b, 0, k] += hats[k, f] * along.real
                        errors[c, b, 1, k] += hats[k, f] * along.imag
        for i in range(columns):
            for j in range(i + 1):
                for a in range(outputs):
                    gram[i, j] += (white[i, a] * np.conj(white[j, a])).real
    return gram, errors


def ours(count: int, wrt: list[int]) -> Callable[[], object]:
    arguments = known.arguments(known.SHIP, known.record(count=count, samples=2 * count), OUTPUTS)
    units = known.noise(2, count, KNOTS)
    return lambda: _core.equation_products(*arguments, wrt, *units)


def multiply_adds(columns: int) -> float:
    """Of a frequency, counted from the equations; a complex product is four."""
    outputs = len(OUTPUTS)
    delays = 4 * (6 * 2 + 4 * 4)
    powers = int(sum(2 * min(ORDERS, n - k) for n in POWERS for k in range(1, n)))
    matrix = 5 * 6 + 4 + 6 * 4
    weigh = (3 + 2) * 2 * 4
    change = columns * (2 * TERMS + 4 * outputs**2)
    pairs = columns * (columns + 1) // 2 * 2 * outputs
    errors = columns * (3 * 4 + 2 * 2 * outputs)
    return delays + powers + matrix + weigh + change + pairs + errors


def clock_mhz() -> str:
    """The processor's clock as the system tells it."""
    path = Path("/proc/cpuinfo")
    found = re.findall(r"cpu MHz\s*:\s*([\d.]+)", path.read_text()) if path.exists() else []
    return f"{float(found[0]):.0f} MHz" if found else "not told"


def main() -> None:
    options = asked(__doc__, {"frequencies": 320, "repeats": 3}, frequencies=2016, repeats=201)
    count = options.frequencies // _core.EQUATION_BLOCK * _core.EQUATION_BLOCK
    square = np.ones((400, 400))
    limit = 400**3 / median_time(lambda: square @ square, 9)
    print(f"clock: {clock_mhz()}; one core's limit: {limit / 1e9:.1f} G multiply-adds/s (dgemm)")
    print(f"{count} frequencies, {len(OUTPUTS)} outputs, {len(WRT)} derivatives")
    rows = []
    try:
        for name in _core._instruction_sets():
            _core._set_instruction_set(name)
            for wrt in (WRT, []):
                work = count * multiply_adds(1 + len(wrt))
                seconds = median_time(ours(count, wrt), options.repeats)
                cells = [f"{1e3 * seconds:.3f}", f"{1e-6 * work:.2f}", f"{100 * work / seconds / limit:.0f}"]
                rows.append([f"ours, {name}, {len(wrt)} derivatives", *cells])
    finally:
        _core._set_instruction_set(None)
    data = tables(count)
    expected = by_numpy(data)
    for mine, theirs in zip(by_numba(data), expected, strict=True):
        whole = np.tril(theirs) if theirs.ndim == 2 else theirs
        np.testing.assert_allclose(mine, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())
    calls = {"NumPy": lambda: by_numpy(data), "Numba": lambda: by_numba(data)}
    for name, times in in_turn(calls, max(options.repeats // 10, 3)).items():
        rows.append([f"{name}, {len(WRT)} derivatives", f"{1e3 * np.median(times):.3f}", "", ""])
    print_table(["call", "ms", "M multiply-adds", "% of the limit"], rows)


if __name__ == "__main__":
    main()
