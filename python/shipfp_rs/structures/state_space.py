"""Linear state-space equations, exact between samples, with dead times and derivatives (eq. 3.14 to 3.54 generalised)."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.transfer import SLOWEST
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

STEP = 1e-30
"""Complex step for derivatives. Its square vanishes in rounding, so an analytic computation propagates the derivative
exactly.
"""
WHOLE = 1e-9
"""Distance from a whole number of samples below which a dead time is rounded: 0.3 s at 100 Hz is 30 samples."""
LATEST = 2.0**50
"""Longest dead time [samples] at which a float64 resolves fractions of a sample."""
DEGREE = 14
"""Degree of the exponential's Taylor polynomial: at a norm of 1/2 the first omitted term is below 2e-17."""


class Model(NamedTuple):
    """Matrices of x' = A x + B u, y = C x + D u and the initial x; imaginary parts are derivatives times `STEP`.

    The inputs u (J,) are one signal with the delays `late` (J,) [s].
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
        """Return one model for each name, with its derivative by this parameter.

        Without names, one model without derivative.
        """

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
                f"frequency_hz[{place}]: the response is infinite at {frequency_hz[place]:g} Hz, "
                "a pole of A; leave this frequency out"
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
    """Split arrays with complex steps into the value and the W derivatives, shape (1 + W, ...)."""
    return np.ascontiguousarray(np.concatenate([values[:1].real, values[:count].imag / STEP]))


def _sampled(model: Model, dt: float, hold: str) -> tuple[npt.NDArray[Any], list[int]]:
    """Return the sampled system [F, G; C, D], shape (W, n + O, n + R), and its inputs as shifts of the signal.

    Between samples the signal is a polynomial, whose derivatives are additional states (Van Loan 1978,
    DOI 10.1109/TAC.1978.1101743). A delayed signal has a corner inside the sample interval (Astrom and Wittenmark,
    Computer-Controlled Systems, 3rd ed., section 3.2). Before the record the signal equals its first sample.
    """
    A, B, C, D, _, late = model
    (n, inputs), outputs, count = B.shape[1:], C.shape[1], len(A)
    whole, fraction = _split(late, dt)
    rates = np.zeros((count, n + 2 * inputs, n + 2 * inputs), dtype=np.complex128)
    rates[:, :n, :n], rates[:, :n, n : n + inputs] = A * dt, B * dt
    rates[:, n : n + inputs, n + inputs :] = np.eye(inputs)
    step = _exponential(rates)
    # Response after one sample to a step and a ramp of each input, which start at the sample or at the corner.
    held, ramp = step[:, :n, n : n + inputs], step[:, :n, n + inputs :]
    held_late, ramp_late = held.copy(), ramp.copy()
    for j in range(inputs):
        if fraction[:, j].any():
            rest = _exponential(rates * (1.0 - fraction[:, j])[:, None, None])
            held_late[:, :, j], ramp_late[:, :, j] = rest[:, :n, n + j], rest[:, :n, n + inputs + j]
    f = fraction[:, None, :]
    if hold == "zero":
        fed = np.stack([held - held_late, held_late, 0.0 * held], axis=-1)
        # An output at a sample includes a step of the input at this sample.
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
    # Squaring exp - 1 instead of exp avoids rounding errors of slow modes.
    less_one, by = value @ series, slopes @ series + value @ series_slopes
    for _ in range(squarings):
        by = less_one @ by + by @ less_one + 2.0 * by
        less_one = less_one @ less_one + 2.0 * less_one
    found = np.tile(less_one + identity + 0j, (len(matrices), 1, 1))
    found[moved] += 1j * by
    return found


ORDER = 6
"""States of the loop's delay, a [5/6] Pade approximation with an error of 2.4e-6 at omega T_d = 3."""
SHORTEST = 1e-8
"""Dead time of the loop [s] up to which a first-order expansion is used, with an error below 1e-12."""
# Orthonormal states of the delay (Legendre delay network, Voelker and Eliasmith 2018, DOI 10.1162/neco_a_01046).
_ORDERS = np.arange(ORDER)
_NORM = np.sqrt(2.0 * _ORDERS + 1.0)
_INTO = (-1.0) ** _ORDERS * _NORM
_WITHIN = np.outer(_NORM, _NORM) * np.where(
    _ORDERS[:, None] < _ORDERS, -1.0, (-1.0) ** (_ORDERS[:, None] - _ORDERS + 1)
)


@dataclass(frozen=True)
class LinearEquations(StateSpaceEquations):
    """Linear structure with dead times, eq. 3.31, 3.35 and 3.38 generalised; see `Structure.linear`.

    u1 is the set point delayed by T_set, u2 is u1 delayed by T_d, and y is z = vK_i E - vK_p n delayed by T_d:

        tau_n n' = -(p - g) n + vK_p u2 + y        E' = u1 - n
    """

    outputs: tuple[str, ...]
    gauge: bool
    states: tuple[str, ...] = ("initial dn", "initial dE")
    linear_in: tuple[str, ...] = ("initial dn", "initial dE")

    def models(self, values: Values, names: Names) -> list[Model]:
        """Return the model with its derivative by each name, or without derivative if there are no names."""
        order = 2 + ORDER * (values.get("T_d", 0.0) > SHORTEST)
        moved: list[Any] = [{**values, name: values.get(name, 0.0) + 1j * STEP} for name in names] or [values]
        return [self._model(one, order) for one in moved]

    @staticmethod
    def _parameters(q: Any) -> tuple[Any, ...]:
        """Return tau_n, p, v, K_p and K_i; without v, the last two are the products vK_p and vK_i, and v is 1."""
        gains = (q.get(name, q.get(f"v{name}", 0.0)) for name in ("K_p", "K_i"))
        return q["tau_n"], q["p"], q.get("v", 1.0), *gains

    def _model(self, q: Any, order: int) -> Model:
        tau_n, p, v, K_p, K_i = self._parameters(q)
        n, E = (q.get(state, 0.0) for state in self.states)
        T_d, T_set = q.get("T_d", 0.0), q.get("T_set", 0.0)
        a, b, c = (p - q["g"]) / tau_n, v * K_p / tau_n, v * K_i / tau_n
        rows, inputs = len(self.outputs), 2 + (order == 2 and "T_d" in q)
        A, B, C, D = (
            np.zeros(shape, dtype=np.complex128)
            for shape in ((order, order), (order, inputs), (rows, order), (rows, inputs))
        )
        start = np.zeros(order, dtype=np.complex128)
        A[1, 0], B[1, 0], start[:2] = -1.0, 1.0, (n, E)
        if order > 2:
            A[0, 0], A[0, 2:], B[0, 1] = -a, _NORM, b
            A[2:, 2:], A[2:, 0], A[2:, 1] = _WITHIN / T_d, -b / T_d * _INTO, c / T_d * _INTO
            start[2] = c * E - b * n
        else:
            A[0, :2], B[0, 1] = (-a - b, c), b
            if inputs > 2:
                # y = z - T_d z' to first order, with z' = c (u1 - n) - b n' just before a step.
                A[0], B[0, 2] = A[0] * (1.0 + T_d * b), T_d * (b * b - c)
                A[0, 0] += T_d * c
        for row, (output, of_states) in enumerate(zip(self.outputs, C, strict=True)):
            if output == "dM":
                inertia = q.get("tau_prop", 0.0) if self.gauge else tau_n
                of_states[:] = inertia * A[0]
                of_states[0] += p
                D[row] = inertia * B[0]
            elif output == "dX":
                of_states[:2], D[row, 0] = (-K_p, K_i), K_p
            else:
                of_states[("dn", "dE").index(output)] = 1.0
        return Model(A, B, C, D, start, np.array([T_set, T_set + T_d, T_set + SHORTEST][:inputs]))

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""
        found, slopes = super().sensitivities(values, experiment, names)
        if "T_d" in names and "dM" in self.outputs:
            # The record starts from rest, so its first sample does not depend on the dead time.
            slopes[names.index("T_d"), self.outputs.index("dM"), 0] = 0.0
        return found, slopes

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable: exact without T_d, else with the [5/6] Pade approximation of T_d."""
        (model,) = self.models(values, ())
        return bool(np.linalg.eigvals(model.A.real).real.max() < 0.0)

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives by `names`, shape (W, O, F), with exact dead times."""
        tau_n, p, v, K_p, K_i = self._parameters(values)
        s = 1j * np.maximum(2.0 * np.pi * frequency_hz, SLOWEST)
        inertia, inertia_name = (values.get("tau_prop", 0.0), "tau_prop") if self.gauge else (tau_n, "tau_n")
        delay, late = np.exp(-s * values.get("T_set", 0.0)), np.exp(-s * values.get("T_d", 0.0))
        governor = (K_p + K_i / s) * late
        closed = tau_n * s + p - values["g"] + v * governor
        speed = v * governor * delay / closed
        error = delay - speed
        load = p + inertia * s
        found = {"dn": speed, "dM": load * speed, "dE": error / s, "dX": governor * error}
        by_governor = {"K_p": late, "K_i": late / s, "T_d": -s * governor}
        by_closed: dict[str, Any] = {"tau_n": s, "p": 1.0, "g": -1.0}
        by_load: dict[str, Any] = {"p": 1.0, inertia_name: s}
        slopes = np.zeros((len(names), len(self.outputs), len(s)), dtype=np.complex128)
        for slope, name in zip(slopes, names, strict=True):
            dgovernor = by_governor.get(name.removeprefix("v"), 0.0)
            dspeed: Any = 0.0
            if name in by_closed:
                dspeed = -by_closed[name] / closed * speed
            elif name == "v":
                dspeed = governor / closed * error
            elif name == "T_set":
                dspeed = -s * speed
            elif name.removeprefix("v") in by_governor:
                dspeed = v * dgovernor / closed * error
            derror = -s * delay - dspeed if name == "T_set" else -dspeed
            for row, output in zip(slope, self.outputs, strict=True):
                if output == "dn":
                    row[:] = dspeed
                elif output == "dM":
                    row[:] = load * dspeed + by_load.get(name, 0.0) * speed
                else:
                    row[:] = derror / s if output == "dE" else dgovernor * error + governor * derror
        return np.array([found[output] for output in self.outputs]), slopes
