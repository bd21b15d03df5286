"""Compiled kernels.

All arrays are C-contiguous float64 unless said otherwise. A result is fresh memory, every value of which its kernel
writes once. Row k of an output holds sample k, time k dt; the set point of sample k is already applied in it
(right-hand limit at a step).

`SHIP_PARAMETERS` are those of `rust/src/stepper/parameters.rs`, `SHIP_OFF` their values without effect (NaN: always
acting); `SHIP_OUTPUTS` = ("dn", "dM_b", "dM_g", "dX", "dE", "dn_prop"). The set point u is over the operating point's,
load[N] a load's deviation or empty. A `substeps` of 0 leaves the step to the kernel.
- `simulate_ship(parameters[37], u[N], load[N], dt, substeps, hold, outputs, envelope[2, K] = None) -> [O, N]`;
  envelope: speeds and the highest torques at them, over the operating point, in place of `M_max`
- `simulate_detailed_ship(parameters[37], detail[D], strength[C], quadrants[3, Q], u[N], dt, substeps, hold, outputs,
  envelope[2, K] = None) -> [O, N]`: with what only a whole drive train has, `SHIP_DETAIL` of
  `rust/src/stepper/detail.rs`; from steady state at the operating point, where the set point was 1 before; strength: each
  cylinder's torque over the mean; quadrants: angle [rad] from -pi to pi, torque and thrust over bollard pull, or none
- `simulate_ship_by(parameters[37], u[N], dt, substeps, method, hold, initial[2], outputs, envelope[2, K] = None) -> [O,
  N]`: a ship of speed and sum alone; method "rk4" | "heun" | "euler", initial (speed over the operating point's, sum)

`run_recursion(system[1 + W, n + O, n + R], start[1 + W, n], signal[N], shifts: list[int] of R, dt) -> ([O, N], [W, O,
N])`: x[k+1] = F x[k] + G w[k], y[k] = C x[k] + D w[k] with system[0] = [F, G; C, D] and w_j[k] = signal[k + shifts[j]],
which stands still outside the record; system[1:] and start[1:] are derivatives, whose rows come back behind the
outputs.

`EQUATION_PARAMETERS` are those of `rust/src/two_equations/equations.rs`, `EQUATION_SIGNALS` = ("N", "M", "X", "load",
"N2", "N3", "one", "M_b"), `EQUATION_OUTPUTS` = ("dn", "dM", "dX", "dM_b"), the last beside a gauge's "dM" only. Spectra
stand at F frequencies from 0 on, `spacing` [rad/s] apart, F a multiple of `EQUATION_BLOCK`, real and imaginary parts
apart; order k of `EQUATION_ORDERS` is the spectrum with (-1)^k times the taper's k-th derivative. A late signal is
delayed by a time of a grid; its `rest` is what the delay has beyond that time [s]. outputs hold 0 and any of 1, 2, 3.
- `equation_residuals(parameters[28], signals[8, 4, 2, F], spacing, late, outputs, gauge, open_loop, wrt) ->
  [1 + W, O, 2, F]`: data less the model's output, then the model's derivatives; `late`: ([4, 2, F], rest) of the speed, late
  by `T_d`, of the set point, late by `T_d` + `T_set`, and, where the speed is the propeller's, of the torque, late by
  `T_d`; `gauge`: the torque is measured between the inertias
- `equation_products(...the same, root[O, O, 2, F], shapes[O, O, 2, F] or empty, hats[K, F]) -> ([1 + W, 1 + W], [2 O K,
  1 + W])`: products of these rows times the lower triangles `root`, and of the systematic errors (`shapes` times hats, real
  and imaginary size) with them; a loop that is unstable raises `SimulationError`. Instruction sets differ by rounding;
  one gives the same bits in any thread
- `taken_by_limits(parameters[20], set_point[N], speed[N], torque[N], every) -> ([N], [N])`: torque that
  limits remove from the engine's, and from the rack's part of it, for measured deviations `every` seconds apart;
  `ENGINE_SIDE_PARAMETERS` are those of `rust/src/engine_side.rs`
- `loop_is_stable(parameters, open_loop) -> bool`: of a ship's loop about its operating point, by Nyquist's turns

`PulseTracker(threshold, hysteresis)`: `look(window)` finds the levels of a window,
`cross(window)` takes the crossings of the oldest one looked at, so that levels are known ahead of them: times, heights
of the train (0 where no turning point tells), standard deviations from sampling and from noise, all in samples; levels
used, [K, 3]; of each window number of crossings, height that noise does not reach, least and median height.
`follow(samples, window)` does so with all windows of a record. Levels of a window that goes on as the one before (parts
of 1024 samples with the same extremes, even pulses, nothing missing) are not found anew: one pass compares it and takes
its crossings. Least and greatest of blocks of 32 give turning points, medians of nine pulses' turning points give
levels, between which the middle goes along lines; noise from differences of short stretches. `interval_speeds(edges[N +
1], count[N], fractions[P], relative[P], noise[1 or N + 1], grid[1 or N + 1], sample) -> [6, sum of count]`: middles,
mean speeds, their standard deviations, lengths, angles, deviations of independent ends. `pulses_are_even(times, least,
most)`: no median of periods is needed. `pulse_levels(samples) -> (low, high)`: robust state levels; NaN where no sample
is finite.
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
