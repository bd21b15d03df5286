"""Compiled kernels; the interface is described in ARCHITECTURE.md."""

from collections.abc import Sequence
from typing import Literal, Self, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "EQUATION_BLOCK",
    "EQUATION_ORDERS",
    "EQUATION_OUTPUTS",
    "EQUATION_PARAMETERS",
    "EQUATION_SIGNALS",
    "SHIP_DETAIL",
    "SHIP_OFF",
    "SHIP_OUTPUTS",
    "SHIP_PARAMETERS",
    "Decimator",
    "Extremes",
    "PulseCrossings",
    "PulseTracker",
    "RepeatScan",
    "__version__",
    "_instruction_sets",
    "_panic_for_test",
    "_set_instruction_set",
    "_spin_for_test",
    "coarser_extremes",
    "equation_products",
    "equation_residuals",
    "find_spikes",
    "interval_speeds",
    "loop_is_stable",
    "pulse_levels",
    "pulses_are_even",
    "run_recursion",
    "running_median",
    "simulate_detailed_ship",
    "simulate_ship",
    "simulate_ship_by",
    "slope_at_even_times",
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

EQUATION_PARAMETERS: tuple[str, ...]
EQUATION_SIGNALS: tuple[str, ...]
EQUATION_OUTPUTS: tuple[str, ...]
EQUATION_ORDERS: int
EQUATION_BLOCK: int

def equation_residuals(
    parameters: NDArray[np.float64],
    signals: NDArray[np.float64],
    spacing: float,
    late_speed: NDArray[np.float64],
    speed_rest: float,
    late_set_point: NDArray[np.float64],
    set_point_rest: float,
    outputs: Sequence[int],
    gauge: bool,
    open_loop: bool,
    wrt: Sequence[int],
) -> NDArray[np.float64]: ...
def equation_products(
    parameters: NDArray[np.float64],
    signals: NDArray[np.float64],
    spacing: float,
    late_speed: NDArray[np.float64],
    speed_rest: float,
    late_set_point: NDArray[np.float64],
    set_point_rest: float,
    outputs: Sequence[int],
    gauge: bool,
    open_loop: bool,
    wrt: Sequence[int],
    root: NDArray[np.float64],
    shapes: NDArray[np.float64],
    hats: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def loop_is_stable(parameters: NDArray[np.float64], open_loop: bool) -> bool: ...
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
class PulseCrossings:
    def __new__(cls, low: float, high: float, middle: float) -> Self: ...
    def set_levels(self, low: float, high: float, middle: float) -> None: ...
    def feed(self, samples: _Samples) -> NDArray[np.float64]: ...
    @property
    def seen(self) -> int: ...
    @property
    def gaps(self) -> NDArray[np.int64]: ...

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

@final
class Decimator:
    def __new__(cls, taps: NDArray[np.float64], up: int, down: int) -> Self: ...
    def feed(self, samples: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def finish(self, total: int) -> NDArray[np.float64]: ...

def find_spikes(
    samples: NDArray[np.float64],
    longest: int,
    stride: int,
    scale_window: int,
    threshold: float,
    least: float,
) -> NDArray[np.int64]: ...
def running_median(samples: NDArray[np.float64], window: int) -> NDArray[np.float64]: ...
def slope_at_even_times(
    edges: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    start: float,
    rate: float,
    count: int,
) -> tuple[int, NDArray[np.float64]]: ...

@final
class RepeatScan:
    def __new__(cls) -> Self: ...
    def feed(self, samples: NDArray[np.float32]) -> None: ...
    def candidates(self) -> NDArray[np.int64]: ...

@final
class Extremes:
    def __new__(cls, block: int) -> Self: ...
    def feed(self, samples: _Samples) -> NDArray[np.float64]: ...
    def finish(self) -> NDArray[np.float64]: ...
    @property
    def seen(self) -> int: ...
    @property
    def gaps(self) -> NDArray[np.int64]: ...
    @property
    def gap_count(self) -> int: ...

def coarser_extremes(pairs: NDArray[np.float64], factor: int) -> NDArray[np.float64]: ...
