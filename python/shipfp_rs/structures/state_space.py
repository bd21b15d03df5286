"""Linear state-space equations, exact between samples, with dead times and derivatives (eq. 3.14 to 3.54 generalised)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.dual import Parameters
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.transfer import TransferFunctions, commanded, driven
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values

STEP = 1e-30
"""Step of complex-step derivatives. The square of the step is lost in rounding, so the derivative of an analytic function
is exact.
"""
WHOLE = 1e-9
"""Distance from a whole number of samples below which a dead time is rounded: 0.3 s at 100 Hz is 30 samples."""
LATEST = 2.0**50
"""Longest dead time [samples] at which a float64 resolves fractions of a sample."""
DEGREE = 14
"""Degree of the exponential's Taylor polynomial: at a norm of 1/2 the first omitted term is below 2e-17."""


class Model(NamedTuple):
    """Matrices of x' = A x + B u, y = C x + D u and the initial x, each with a first axis of W parameters."""

    # Imaginary parts are derivatives by the parameter times `STEP`.
    A: npt.NDArray[Any]
    B: npt.NDArray[Any]
    C: npt.NDArray[Any]
    D: npt.NDArray[Any]
    start: npt.NDArray[Any]
    late: npt.NDArray[Any]  # delays (W, J) [s]: the inputs u (J,) are one signal with these delays


class StateSpaceEquations(Equations):
    """Equations given by a model that depends on the parameters."""

    @abstractmethod
    def model(self, values: Values, names: Names) -> Model:
        """Return the model with its derivatives by `names`; without names, along a first axis of length 1."""

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        return self.sensitivities(values, experiment, ())[0]

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""
        model = _finite(self.model(values, names), values)
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
        A, B, C, D = (_parted(part, len(names)) for part in _finite(self.model(values, names), values)[:4])
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


def _finite(model: Model, values: Values) -> Model:
    for name, part in zip(Model._fields, model, strict=True):
        if not np.isfinite(part).all():
            raise SimulationError(f"matrices: {name} is not finite with {listed(values)}")
    return model


def listed(values: Values) -> str:
    """Format values by name for a message."""
    return ", ".join(f"{name} {value:.6g}" for name, value in values.items())


def _parted(values: npt.NDArray[Any], count: int) -> Array:
    """Split arrays with complex steps into the value and the W derivatives, shape (1 + W, ...)."""
    return np.ascontiguousarray(np.concatenate([values[:1].real, values[:count].imag / STEP]))


def _sampled(model: Model, dt: float, hold: str) -> tuple[npt.NDArray[Any], list[int]]:
    """Return the sampled system [F, G; C, D], shape (W, n + O, n + R), and its inputs as shifts of the signal."""
    A, B, C, D, _, late = model
    (n, inputs), outputs, count = B.shape[1:], C.shape[1], len(A)
    whole, fraction = _split(late, dt)
    # Between samples the signal is a polynomial, whose derivatives are additional states (Van Loan 1978, DOI
    # 10.1109/TAC.1978.1101743).
    rates = np.zeros((count, n + 2 * inputs, n + 2 * inputs), dtype=np.complex128)
    rates[:, :n, :n], rates[:, :n, n : n + inputs] = A * dt, B * dt
    rates[:, n : n + inputs, n + inputs :] = np.eye(inputs)
    step = _exponential(rates)
    # Responses after one sample to a step and a ramp of each input, which start at the sample or at the corner.
    held, ramp = step[:, :n, n : n + inputs], step[:, :n, n + inputs :]
    held_late, ramp_late = held.copy(), ramp.copy()
    # A delayed signal has a corner inside the sample interval (Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed.,
    # section 3.2).
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
    # Before the record the signal equals its first sample.
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


LEAST_S = 1e-8
"""Shorter time constants and dead times [s] count as zero: their poles would be too fast for double precision."""
STATES, INPUTS = 64, 3
Form = npt.NDArray[Any]
"""Signal as a linear combination: coefficients of `STATES` states, then of `INPUTS` inputs."""


class Wiring:
    """Elements in state space: signals are linear combinations of states and inputs, and each element adds its states."""

    def __init__(self, order: int, start: Sequence[Any] = (), late: Any = None) -> None:
        # With a delay `late` of the input, all delays of the input are exact. The other dead times are Pade approximations
        # [order - 1 / order], without direct feedthrough, in the orthonormal states of the Legendre delay network (Voelker
        # and Eliasmith 2018, DOI 10.1162/neco_a_01046).
        self.exact, self.late = late is not None, [0.0 if late is None else late]
        self.start = [*start]  # of the first states
        self.rates: list[Form] = []
        self.unit = np.eye(STATES + INPUTS)
        self.input = self.unit[STATES]
        self.within, self.into, self.norm = _delay_network(order)

    def state(self, start: Any = 0.0) -> Form:
        """Return a new state; the caller sets its rate of change."""
        self.rates.append(self.input)
        self.start += [start] * (len(self.rates) > len(self.start))
        return np.asarray(self.unit[len(self.rates) - 1])

    def integrated(self, signal: Form, fade: Any = 0.0) -> Form:
        """Return the integral of a signal; the integral fades at a rate [1/s]."""
        state = self.state()
        self.rates[-1] = signal - fade * state
        return state

    def lagged(self, signal: Form, time_constant: Any) -> Form:
        """Return a signal filtered by 1 / (1 + time_constant s)."""
        if _none(time_constant):
            return signal
        state = self.state()
        self.rates[-1] = (signal - state) / time_constant
        return state

    def delayed(self, signal: Form, dead_time: Any, period: Any = 0.0) -> Form:
        """Return a signal delayed by `dead_time` and by half of the `period` at which it is sampled and held."""
        late = dead_time + 0.5 * period
        if _none(late):
            return signal
        direct = np.zeros_like(signal)
        if self.exact:
            direct[..., STATES + len(self.late)] = signal[..., STATES]
            self.late.append(self.late[0] + late)
            signal = np.where(np.arange(STATES + INPUTS) < STATES, signal, 0.0)
        late = late + max(LEAST_S - np.max(np.real(late)), 0.0)
        held = sum(signal[..., [place]] * one for place, one in enumerate(self.start))
        states = np.array([self.state(start) for start in (held, *[0.0] * (len(self.norm) - 1))])
        for place, rate in enumerate(self.within @ states, -len(states)):
            self.rates[place] = (rate + self.into[place] * signal) / late
        return np.asarray(direct + self.norm @ states)

    def model(self, outputs: Sequence[Form], count: int = 1) -> Model:
        """Return the state space with these outputs and a first axis of length `count`."""

        def stacked(rows: Sequence[Any]) -> npt.NDArray[Any]:
            return np.stack(np.broadcast_arrays(*rows, np.zeros((count, 1)))[:-1], axis=1)

        rates, seen = stacked(self.rates), stacked(outputs)
        states, inputs = slice(len(self.rates)), slice(STATES, STATES + len(self.late))
        A, B, C, D = (part[..., own] for part in (rates, seen) for own in (states, inputs))
        return Model(A, B, C, D, stacked(self.start)[..., 0], stacked(self.late)[..., 0])


def _none(time: Any) -> bool:
    if isinstance(time, np.ndarray):
        return bool(time.real.max() < LEAST_S and not time.imag.any())
    return bool(time < LEAST_S)


@cache
def _delay_network(order: int) -> tuple[Array, Array, Array]:
    """Matrices of the Legendre delay network: T x' = within x + into u, y = norm x."""
    orders = np.arange(order)
    norm = np.sqrt(2.0 * orders + 1.0)
    signs = np.where(orders[:, None] < orders, -1.0, (-1.0) ** (orders[:, None] - orders + 1))
    return np.outer(norm, norm) * signs, (-1.0) ** orders * norm, norm


def wired(
    q: Parameters, wiring: Wiring, *, gauge: bool = False, propeller_speed: bool = False
) -> dict[str, Form]:
    """Return the outputs of the drive train, delayed like their sensors, and the governor's command."""
    # With a stiff shaft tau_n dn/dt = M_b - p n and M_g = p n + tau_prop dn/dt. With a flexible shaft, the engine's side is
    # (tau_n - tau_prop) dn_e/dt = M_b - M_g, the shaft M_g = M_k + zeta_twist (n_e - n_s) with tau_twist dM_k/dt = n_e -
    # n_s, and the propeller's side tau_prop dn_s/dt = M_g - p n_s.
    n_e = propeller = wiring.state()  # the first state, whose rate is `wiring.rates[0]`
    set_point = wiring.input if wiring.exact else wiring.delayed(wiring.input, q.get("T_set", 0.0))
    integral, command = commanded(q, wiring, n_e, set_point)
    rack, brake = driven(q, wiring, n_e, command)
    tau_n, tau_prop = q["tau_n"], q.get("tau_prop", 0.0)
    if q.get("tau_twist"):
        propeller = wiring.state()
        slip = n_e - propeller
        shaft = wiring.integrated(slip / q["tau_twist"]) + q.get("zeta_twist", 0.0) * slip
        wiring.rates[-2] = (shaft - q["p"] * propeller) / tau_prop
        wiring.rates[0] = (brake - shaft) / (tau_n - tau_prop)
    else:
        wiring.rates[0] = (brake - q["p"] * n_e) / tau_n
        shaft = q["p"] * n_e + tau_prop * wiring.rates[0]
    return {
        "dn": wiring.delayed(propeller if propeller_speed else n_e, q.get("T_n", 0.0)),
        "dM": wiring.delayed(shaft if gauge else brake, q.get("T_M", 0.0)),
        "dM_b": wiring.delayed(brake, q.get("T_B", 0.0)),
        "dE": integral,
        "dX": rack,
        "command": command,
    }


ORDER = 6
"""States of the loop's delay, a [5/6] Pade approximation with an error of 2.4e-6 at omega T_d = 3."""


@dataclass(frozen=True)
class LinearEquations(StateSpaceEquations):
    """Linear structure with dead times, eq. 3.31, 3.35 and 3.38 generalised; see `Structure.linear`."""

    # The governor's command K_p (u1 - n) + K_i E is delayed by T_d, and u1 is the set point delayed by T_set:
    # tau_n n' = -(p - g) n + v command(t - T_d), E' = u1 - n. In the time domain the rack dX is the governor's command; in
    # the frequency response dX is the command delayed by T_d.

    outputs: tuple[str, ...]
    gauge: bool
    states: tuple[str, ...] = ("initial dn", "initial dE")
    linear_in: tuple[str, ...] = ("initial dn", "initial dE")

    def model(self, values: Values, names: Names) -> Model:
        """Return the model with its derivatives by `names`; without names, along a first axis of length 1."""
        q = {
            own: values.get(own, 0.0) + 1j * STEP * np.array([[name == own] for name in names or [""]])
            for own in {*values, *names}
        }
        wiring = Wiring(ORDER, [q.get(state, 0.0) for state in self.states], q.get("T_set", 0.0))
        rows = wired(q, wiring, gauge=self.gauge)
        rows["dX"] = rows["command"]
        return wiring.model([rows[output] for output in self.outputs], len(names) or 1)

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable: exact without T_d, else with the [5/6] Pade approximation of T_d."""
        return bool(np.linalg.eigvals(self.model(values, ()).A[0].real).real.max() < 0.0)

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives by `names`, shape (W, O, F), with exact dead times."""
        return TransferFunctions(self.outputs, self.gauge, "engine").response(values, frequency_hz, names)
