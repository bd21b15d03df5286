"""Compiled kernels.

All arrays are C-contiguous float64 unless stated otherwise. Results are newly allocated. Sample k of an output is at time
k dt; the set point of sample k already acts in it (right-hand limit at a step).

Ships. `SHIP_PARAMETERS` are described in `rust/src/stepper/parameters.rs`; `SHIP_OFF` are their values without effect
(NaN: none); `SHIP_OUTPUTS` = ("dn", "dM_b", "dM_g", "dX", "dE", "dn_prop"), selected by index. u is the set point over
that of the operating point, load[N] the deviation of a measured load, or empty. With `substeps` 0 the kernel chooses
the step. envelope: speeds, and the highest torque at each, over the operating point's, instead of `M_max`.
- `simulate_ship(parameters[37], u[N], load[N], dt, substeps, hold, outputs, envelope[2, K] = None) -> [O, N]`
- `simulate_detailed_ship(parameters[37], detail[D], strength[C], quadrants[3, Q], u[N], dt, substeps, hold, outputs,
  envelope[2, K] = None) -> [O, N]`: with the additional elements of a whole drive train, `SHIP_DETAIL` of
  `rust/src/stepper/detail.rs`. It starts in steady state at the operating point, where the set point was 1 before. strength:
  each cylinder's torque over the mean; quadrants: flow angle [rad] from -pi to pi, and the propeller's torque and thrust
  over bollard pull, or empty
- `simulate_ship_by(parameters[37], u[N], dt, substeps, method, hold, initial[2], outputs, envelope[2, K] = None) -> [O,
  N]`: a ship whose only states are speed and integral; method "rk4" | "heun" | "euler"; initial: speed over the operating
  point's, and integral

`run_recursion(system[1 + W, n + O, n + R], start[1 + W, n], signal[N], shifts: list[int] of R, dt) -> ([O, N], [W, O,
N])`: runs x[k+1] = F x[k] + G w[k], y[k] = C x[k] + D w[k] with system[0] = [F, G; C, D] and w_j[k] = signal[k + shifts[j]],
where the signal is constant outside the record. system[1:] and start[1:] are derivatives of system and start; the second
array returned are the derivatives of the outputs.

Equations of a ship. `EQUATION_PARAMETERS` are described in `rust/src/two_equations/equations.rs`; `EQUATION_SIGNALS` =
("N", "M", "X", "load", "N2", "N3", "one", "M_b"); `EQUATION_OUTPUTS` = ("dn", "dM", "dX", "dM_b"), the last one only in
addition to a gauge's "dM". Spectra have F frequencies from 0 on, `spacing` [rad/s] apart, with F a multiple of
`EQUATION_BLOCK`, and separate real and imaginary parts. Order k of `EQUATION_ORDERS` is the spectrum with (-1)^k times the
k-th derivative of the taper. A `late` signal is delayed by a multiple of a grid's interval; its `rest` is the remaining
delay [s]. outputs: 0, and any of 1, 2, 3.
- `equation_residuals(parameters[28], signals[8, 4, 2, F], spacing, late, outputs, gauge, open_loop, wrt) ->
  [1 + W, O, 2, F]`: measured minus modelled outputs, then the model's derivatives by the W parameters `wrt`. `late`:
  ([4, 2, F], rest) of the speed (delayed by `T_d`), of the set point (`T_d` + `T_set`), and, if the speed is the
  propeller's, of the torque (`T_d`); `gauge`: whether the torque is measured between the inertias
- `equation_products(...the same, root[O, O, 2, F], shapes[O, O, 2, F] or empty, hats[K, F]) -> ([1 + W, 1 + W], [2 O K,
  1 + W])`: the rows of `equation_residuals` are multiplied by the lower triangles `root`; returned are their products with
  each other, and those with the systematic errors, which are `shapes` times `hats` with real and imaginary amplitudes.
  `SimulationError` if the loop is unstable. Instruction sets differ by rounding; one set gives equal bits in any thread
- `loop_is_stable(parameters, open_loop) -> bool`: of the loop about the operating point, by Nyquist's criterion

`taken_by_limits(parameters[20], set_point[N], speed[N], torque[N], every) -> ([N], [N])`: torque that limits remove from
the engine, and the part that the rack's rate limit removes, for measured deviations at intervals of `every` [s].
`ENGINE_SIDE_PARAMETERS` are described in `rust/src/engine_side.rs`.

Pulses. `PulseTracker(threshold, hysteresis)`: `look(window)` estimates the levels of a window; `cross(window)` detects
the crossings of the oldest window for which `look` was called, so that the next window's levels are known. It returns
times, heights of the train (0 without turning points nearby), and standard deviations from sampling and from noise, the
times and deviations in samples; levels [K, 3]; and for each window the number of crossings, the height above which a
pulse can't be noise, and the least and median height. `follow(samples, window)` does this for all windows of a record.
- `interval_speeds(edges[N + 1], count[N], fractions[P], relative[P], noise[1 or N + 1], grid[1 or N + 1], sample) -> [6,
  sum of count]`: middles [s], mean speeds [rev/s], their standard deviations, lengths [s], angles [rev], and standard
  deviations for independent errors of the ends
- `pulses_are_even(times, least, most) -> bool`: whether each period is `least` to `most` times each of the ten before and
  after, so that no running median of periods is needed
- `pulse_levels(samples) -> (low, high)`: robust state levels; NaN if no sample is finite
"""

from collections.abc import Sequence
from typing import Literal, Self, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ENGINE_SIDE_PARAMETERS",
    "EQUATION_BLOCK",
    "EQUATION_ORDERS",
    "EQUATION_OUTPUTS",
    "EQUATION_PARAMETERS",
    "EQUATION_SIGNALS",
    "SHIP_DETAIL",
    "SHIP_OFF",
    "SHIP_OUTPUTS",
    "SHIP_PARAMETERS",
    "PulseTracker",
    "__version__",
    "_instruction_sets",
    "_panic_for_test",
    "_set_instruction_set",
    "_spin_for_test",
    "equation_products",
    "equation_residuals",
    "interval_speeds",
    "loop_is_stable",
    "pulse_levels",
    "pulses_are_even",
    "run_recursion",
    "simulate_detailed_ship",
    "simulate_ship",
    "simulate_ship_by",
    "taken_by_limits",
]

__version__: str

def _instruction_sets() -> tuple[str, ...]: ...
def _set_instruction_set(name: str | None) -> None: ...
def _panic_for_test(message: str) -> None: ...
def _spin_for_test() -> None: ...

SHIP_PARAMETERS: tuple[str, ...]
SHIP_OUTPUTS: tuple[str, ...]
SHIP_OFF: tuple[float, ...]
SHIP_DETAIL: tuple[str, ...]

ENGINE_SIDE_PARAMETERS: tuple[str, ...]
EQUATION_PARAMETERS: tuple[str, ...]
EQUATION_SIGNALS: tuple[str, ...]
EQUATION_OUTPUTS: tuple[str, ...]
EQUATION_ORDERS: int
EQUATION_BLOCK: int

def equation_residuals(
    parameters: NDArray[np.float64],
    signals: NDArray[np.float64],
    spacing: float,
    late: Sequence[tuple[NDArray[np.float64], float]],
    outputs: Sequence[int],
    gauge: bool,
    open_loop: bool,
    wrt: Sequence[int],
) -> NDArray[np.float64]: ...
def equation_products(
    parameters: NDArray[np.float64],
    signals: NDArray[np.float64],
    spacing: float,
    late: Sequence[tuple[NDArray[np.float64], float]],
    outputs: Sequence[int],
    gauge: bool,
    open_loop: bool,
    wrt: Sequence[int],
    root: NDArray[np.float64],
    shapes: NDArray[np.float64],
    hats: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def loop_is_stable(parameters: NDArray[np.float64], open_loop: bool) -> bool: ...
def taken_by_limits(
    parameters: NDArray[np.float64],
    set_point: NDArray[np.float64],
    speed: NDArray[np.float64],
    torque: NDArray[np.float64],
    every: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def simulate_ship(
    parameters: NDArray[np.float64],
    u: NDArray[np.float64],
    load: NDArray[np.float64],
    dt: float,
    substeps: int,
    hold: Literal["zero", "first"],
    outputs: Sequence[int],
    envelope: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]: ...
def simulate_ship_by(
    parameters: NDArray[np.float64],
    u: NDArray[np.float64],
    dt: float,
    substeps: int,
    method: Literal["rk4", "heun", "euler"],
    hold: Literal["zero", "first"],
    initial: NDArray[np.float64],
    outputs: Sequence[int],
    envelope: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]: ...
def simulate_detailed_ship(
    parameters: NDArray[np.float64],
    detail: NDArray[np.float64],
    strength: NDArray[np.float64],
    quadrants: NDArray[np.float64],
    u: NDArray[np.float64],
    dt: float,
    substeps: int,
    hold: Literal["zero", "first"],
    outputs: Sequence[int],
    envelope: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]: ...

_Samples = NDArray[np.float32] | NDArray[np.float64] | NDArray[np.int16]
_Crossed = tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]

@final
class PulseTracker:
    def __new__(cls, threshold: float | None = None, hysteresis: float | None = None) -> Self: ...
    def look(self, samples: _Samples) -> None: ...
    def cross(self, samples: _Samples) -> _Crossed: ...
    def follow(self, samples: _Samples, window: int) -> _Crossed: ...
    @property
    def gaps(self) -> NDArray[np.int64]: ...

def interval_speeds(
    edges: NDArray[np.float64],
    count: NDArray[np.int64],
    fractions: NDArray[np.float64],
    relative: NDArray[np.float64],
    noise: NDArray[np.float64],
    grid: NDArray[np.float64],
    sample: float,
) -> NDArray[np.float64]: ...
def pulse_levels(samples: _Samples) -> tuple[float, float]: ...
def pulses_are_even(times: NDArray[np.float64], least: float, most: float) -> bool: ...
def run_recursion(
    system: NDArray[np.float64],
    start: NDArray[np.float64],
    signal: NDArray[np.float64],
    shifts: Sequence[int],
    dt: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
