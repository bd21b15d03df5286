"""Linear state-space equations, exact between samples, with input dead times and derivatives."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

STEP = 1e-30
"""Complex step of a derivative; its square vanishes, so any analytic computation propagates the derivative."""
WHOLE = 1e-9
"""Distance from a whole number of samples below which a dead time is rounded: 0.3 s at 100 Hz is 30 samples."""
LATEST = 2.0**50
"""Longest dead time [samples] at which a double resolves fractions of a sample."""
DEGREE = 14
"""Degree of the exponential's Taylor polynomial: at a norm of 1/2 the first omitted term is below 2e-17."""


class Model(NamedTuple):
    """x' = A x + B u, y = C x + D u from a start x: real, or with a derivative times `STEP` as imaginary part.

    The inputs u (J,) are the same signal with individual delays [s].
    """

    A: npt.NDArray[Any]
    B: npt.NDArray[Any]
    C: npt.NDArray[Any]
    D: npt.NDArray[Any]
    start: npt.NDArray[Any]
    late: npt.NDArray[Any]


class StateSpaceEquations(Equations):
    """Equations given by a model that depends on the parameters."""

    @abstractmethod
    def models(self, values: Values, names: Names) -> list[Model]:
        """Return the model with its derivative by each name, or without derivative if there are no names."""

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self.sensitivities(values, experiment, ())[0]

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""
        model = _together(self.models(values, names), values)
        dt = 1.0 / experiment.rate_hz
        # Overflow is detected here.
        with np.errstate(all="ignore"):
            system, shifts = _sampled(model, dt, experiment.hold)
        if not np.isfinite(system).all():
            raise SimulationError(f"matrices: not finite over a sample of {dt:g} s with {listed(values)}")
        count = len(names)
        return _core.run_recursion(
            _parted(system, count), _parted(model.start, count), experiment.dn_set, shifts, dt
        )

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives by `names`, shape (W, O, F)."""
        A, B, C, D = (_parted(part, len(names)) for part in _together(self.models(values, names), values)[:4])
        resolvent = 2j * np.pi * frequency_hz[:, None, None] * np.eye(len(A[0])) - A[0]
        try:
            states = np.linalg.solve(resolvent, B[0])[..., 0]
            moved = states @ A[1:].swapaxes(1, 2) + B[1:, None, :, 0]
            slopes = np.linalg.solve(resolvent, moved.transpose(1, 2, 0)).transpose(2, 0, 1)
        except np.linalg.LinAlgError as error:
            poles = np.linalg.eigvals(A[0])
            place = int(np.abs(2j * np.pi * frequency_hz[:, None] - poles).min(axis=1).argmin())
            raise InputError(
                f"frequency_hz[{place}]: the response is infinite at {frequency_hz[place]:g} Hz, a pole of A; leave it out"
            ) from error
        found = states @ C[0].T + D[0, :, 0]
        slopes = slopes @ C[0].T + states @ C[1:].swapaxes(1, 2) + D[1:, None, :, 0]
        return np.ascontiguousarray(found.T), np.ascontiguousarray(slopes.swapaxes(1, 2))


def _together(models: list[Model], values: Values) -> Model:
    """Stack models along a first axis of their arrays."""
    together = Model(*(np.array(parts) for parts in zip(*models, strict=True)))
    for name, part in zip(Model._fields, together, strict=True):
        if not np.isfinite(part).all():
            raise SimulationError(f"matrices: {name} is not finite with {listed(values)}")
    return together


def listed(values: Values) -> str:
    """Format values by name for a message."""
    return ", ".join(f"{name} {value:.6g}" for name, value in values.items())


def _parted(values: npt.NDArray[Any], count: int) -> Array:
    """Split complex steps into value and derivatives, shape (1 + W, ...)."""
    return np.ascontiguousarray(np.concatenate([values[:1].real, values[:count].imag / STEP]))


def _sampled(model: Model, dt: float, hold: str) -> tuple[npt.NDArray[Any], list[int]]:
    """Return the sampled system [F, G; C, D], shape (W, n + O, n + R), and its inputs as shifts of the signal.

    Between samples the signal is a polynomial, whose derivatives are additional states (Van Loan 1978,
    DOI 10.1109/TAC.1978.1101743). A delayed one has a corner inside the sample interval (Astrom and Wittenmark,
    Computer-Controlled Systems, 3rd ed., section 3.2). Before the record the signal equals its first sample.
    """
    A, B, C, D, _, late = model
    (n, inputs), outputs, count = B.shape[1:], C.shape[1], len(A)
    whole, fraction = _split(late, dt)
    rates = np.zeros((count, n + 2 * inputs, n + 2 * inputs), dtype=np.complex128)
    rates[:, :n, :n], rates[:, :n, n : n + inputs] = A * dt, B * dt
    rates[:, n : n + inputs, n + inputs :] = np.eye(inputs)
    step = _exponential(rates)
    # Response after one sample to a step and a ramp of each input, starting at the sample or at the corner.
    held, ramp = step[:, :n, n : n + inputs], step[:, :n, n + inputs :]
    held_late, ramp_late = held.copy(), ramp.copy()
    for j in range(inputs):
        if fraction[:, j].any():
            rest = _exponential(rates * (1.0 - fraction[:, j])[:, None, None])
            held_late[:, :, j], ramp_late[:, :, j] = rest[:, :n, n + j], rest[:, :n, n + inputs + j]
    f = fraction[:, None, :]
    if hold == "zero":
        fed = np.stack([held - held_late, held_late, 0.0 * held], axis=-1)
        # A step at the sample itself is included.
        seen = np.stack([f.real != 0.0, f.real == 0.0, 0.0 * f], axis=-1)
    else:
        fed = np.stack(
            [f * held - ramp + ramp_late, (1.0 - f) * held + ramp - 2.0 * ramp_late, ramp_late], axis=-1
        )
        seen = np.stack([f, 1.0 - f, 0.0 * f], axis=-1)
    system = np.zeros((count, n + outputs, n + 3 * inputs), dtype=np.complex128)
    system[:, :n, :n], system[:, n:, :n] = step[:, :n, :n], C
    system[:, :n, n:] = fed.reshape(count, n, -1)
    system[:, n:, n:] = (D[..., None] * seen).reshape(count, outputs, -1)
    used = np.any(system != 0.0, axis=(0, 1))
    used[:n] = True
    shifts = np.tile([-1, 0, 1], inputs) - whole.repeat(3)
    return system[:, :, used], shifts[used[n:]].tolist()


def _split(late: npt.NDArray[Any], dt: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[Any]]:
    """Split dead times (W, J) into whole samples (J,) and remainders (W, J)."""
    samples = np.minimum(late[0].real / dt, LATEST)
    nearest = np.round(samples)
    whole = np.where(np.abs(samples - nearest) < WHOLE, nearest, np.floor(samples))
    excess = samples - whole
    return whole.astype(np.int64), np.where(excess < WHOLE, 0.0, excess) + 1j * late.imag / dt


def _exponential(matrices: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Exponentials of matrices (W, n, n) with the same real part, by a Taylor polynomial, scaling and squaring."""
    moved = matrices.imag.any(axis=(1, 2))
    value, slopes = matrices[0].real, matrices.imag[moved]
    norm = np.abs(value).sum(axis=0).max()
    squarings = int(np.clip(np.nan_to_num(np.ceil(np.log2(2.0 * norm)), nan=0.0), 0, 100))
    value, slopes = value * 0.5**squarings, slopes * 0.5**squarings
    identity = np.eye(len(value))
    series, series_slopes = identity, np.zeros_like(slopes)
    for term in range(DEGREE, 1, -1):
        series_slopes = (slopes @ series + value @ series_slopes) / term
        series = identity + value @ series / term
    # exp - 1 is squared instead of exp, where slow modes would be lost in rounding.
    less_one, by = value @ series, slopes @ series + value @ series_slopes
    for _ in range(squarings):
        by = less_one @ by + by @ less_one + 2.0 * by
        less_one = less_one @ less_one + 2.0 * less_one
    found = np.tile(less_one + identity + 0j, (len(matrices), 1, 1))
    found[moved] += 1j * by
    return found
