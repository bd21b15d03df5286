"""The drive train's loop, for spectra and for state spaces, and its transfer functions (eq. 3.14 to 3.54)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from shipfp_rs.structures.dual import Dual, Parameters, value_and_slopes, value_of, varied
from shipfp_rs.support.arrays import Array, ComplexArray, Names

Place = Literal["engine", "propeller"]
Spectrum = npt.NDArray[Any]
Answer = tuple[Any, Any, Any]
"""The error's integral, the rack and the brake torque, each (F,) or a dual number."""
SPEED, ASKED = np.eye(2)[..., None]
"""Unit signals of speed and set point, as rows (2, F): responses to the two stay separate."""

DERIVATIVE_FILTER = 0.1
"""Time constant of the derivative's filter over the derivative time K_d / K_p, a customary value
(Astrom, Hagglund, "Advanced PID Control", 2006, section 3.3)."""
SLOWEST = 1e-6
"""Frequency [rad/s] used instead of zero, where an integrator has a pole."""


class Elements(Protocol):
    """Elements that act on signals, which may be spectra or the rows of a state space."""

    def integrated(self, signal: Any, fade: Any = 0.0) -> Any:
        """Return the integral of a signal; the integral fades at a rate [1/s]."""

    def lagged(self, signal: Any, time_constant: Any) -> Any:
        """Return a signal filtered by 1 / (1 + time_constant s)."""

    def delayed(self, signal: Any, dead_time: Any, period: Any) -> Any:
        """Return a signal that is delayed by `dead_time`, and sampled and held every `period`."""


def loop_parameters(values: Parameters, *, mean_sampling: bool) -> dict[str, Any]:
    """Return the loop's parameters: p includes the damping, T_d excludes half of the sampling period."""
    found = dict(values)
    found["p"] = found["p"] + found.pop("damping", 0.0)
    # In a model of the mean effect of sampling, T_d includes half of the period.
    if mean_sampling:
        found["T_d"] = found.get("T_d", 0.0) - 0.5 * found.get("T_s", 0.0)
    return found


def drooped(q: Parameters) -> tuple[Any, Any]:
    """Return the factor of a droop on the governor's gains, and the rate at which the integral then fades [1/s]."""
    if "droop" not in q:
        return 1.0, 0.0
    droop = q["droop"] * q.get("v", 1.0)
    K_p, K_i = (droop * q.get(f"v{gain}", q.get(gain, 0.0)) for gain in ("K_p", "K_i"))
    return 1.0 / (1.0 + K_p), K_i / (1.0 + K_p)


def commanded(q: Parameters, elements: Elements, speed: Any, set_point: Any) -> tuple[Any, Any]:
    """Return the integral of the governor's error, and its command; the derivative acts only on the speed."""
    K_p, K_i, K_d = (q.get(f"v{gain}", q.get(gain, 0.0)) for gain in ("K_p", "K_i", "K_d"))
    seen = elements.lagged(speed, q.get("T_f", 0.0))
    less, fade = drooped(q)
    # A droop lowers the set point in proportion to the command, so the command and the integrated error are smaller.
    error = less * (set_point - seen)
    integral = elements.integrated(error, fade)
    command = K_p * error + less * K_i * integral
    if K_d:
        # K_d s / (1 + T s) = K_d / T (1 - 1 / (1 + T s))
        command = command - less * K_p / DERIVATIVE_FILTER * (
            seen - elements.lagged(seen, DERIVATIVE_FILTER * K_d / K_p)
        )
    return integral, command


def driven(q: Parameters, elements: Elements, speed: Any, command: Any) -> tuple[Any, Any]:
    """Return the rack and the brake torque for a command and a speed of the engine."""
    rack = elements.delayed(command, q.get("T_d", 0.0), q.get("T_s", 0.0))
    rack = elements.lagged(rack, q.get("tau_act", 0.0))
    return rack, elements.lagged(q["g"] * speed + q.get("v", 1.0) * rack, q.get("tau_eng", 0.0))


class _Loop:
    """The loop in the frequency domain, with the elements that it consists of."""

    def __init__(self, q: Parameters, s: Any) -> None:
        self.q, self.s = q, s
        self.inertia = (q["tau_n"] - q.get("tau_prop", 0.0)) * s
        self.propeller = q["p"] + q.get("tau_prop", 0.0) * s
        twist = q.get("tau_twist", 0.0) * s
        self.slip = twist / (1.0 + q.get("zeta_twist", 0.0) * twist)
        """Speed difference across the shaft, divided by its torque."""

    def integrated(self, signal: Any, fade: Any = 0.0) -> Any:
        return signal / (self.s + fade)

    def lagged(self, signal: Any, time_constant: Any) -> Any:
        return signal / (1.0 + time_constant * self.s) if time_constant else signal

    def delayed(self, signal: Any, dead_time: Any, period: Any = 0.0) -> Any:
        if not value_of(period):
            return signal * np.exp(-self.s * (dead_time + 0.5 * period))
        turned = -self.s * period
        return signal * (np.exp(-self.s * dead_time) * np.expm1(turned) / turned)

    def answer(self, speed: Any, asked: Any, *, governed: bool = True) -> Answer:
        """Return the response to a speed, and to a set point or, if not `governed`, a command."""
        integral, command = commanded(self.q, self, speed, asked) if governed else (0.0 * asked, asked)
        return integral, *driven(self.q, self, speed, command)

    def closed(self, brake: Any) -> Any:
        """Return the ratio of external torque to speed n_s*, for a brake torque over the speed n_e*."""
        return (self.inertia - brake) * (1.0 + self.slip * self.propeller) + self.propeller


@dataclass(frozen=True)
class TransferFunctions:
    """Transfer functions from the set point to the outputs; an element acts if its parameters are given.

    The governor is C = (K_p + K_i/s + K_d s/(1 + 0.1 K_d/K_p s)) / (1 + T_f s); the set point passes through K_p + K_i/s
    only. With a droop C is divided by 1 + droop v (K_p + K_i/s). The path to the rack is A = exp(-s T_d) / (1 + tau_act s),
    times (1 - exp(-s T_s)) / (s T_s) for a governor that samples every T_s and holds. The brake torque is M_b* = (g n_e* + v
    X*) / (1 + tau_eng s), the propeller's M_g* = (p + tau_prop s) n_s*. The shaft twists by n_e* = n_s* + Y M_g*, with Y =
    tau_twist s / (1 + zeta_twist tau_twist s) and tau_twist = M_s0 / (2 pi n_s0 k) for a stiffness k [Nm/rad]. The governor
    acts on the engine's side, where (tau_n - tau_prop) s n_e* = M_b* - M_g*. Without optional elements these are eq. 3.31
    and 3.38.
    """

    outputs: tuple[str, ...]
    gauge: bool
    speed: Place
    """Side of the shaft on which the speed is measured."""
    governed: bool = True
    """Whether the input is the set point of a governor, or a command."""

    def response(
        self, values: Parameters, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) to the input, and its derivatives by `names`, shape (W, O, F)."""
        s = 1j * np.maximum(2.0 * np.pi * frequency_hz, SLOWEST)
        loop = _Loop(varied(values, names), s)
        late = loop.delayed(ASKED, loop.q.get("T_set", 0.0))
        back, asked = zip(*loop.answer(SPEED, late, governed=self.governed), strict=True)
        rows = self._outputs(loop, back, asked)
        found, slopes = zip(*(value_and_slopes(row, names) for row in rows), strict=True)
        return np.array(found), np.stack(slopes, axis=1)

    def answer_to_torque(self, values: Parameters, s: Spectrum) -> ComplexArray:
        """Return the response (O, F) of the outputs to an engine torque that the governor did not command."""
        loop = _Loop(values, s)
        return np.array(self._outputs(loop, loop.answer(1.0, 0.0), (0.0, 0.0, 1.0)))

    def torque_over_speed(
        self, values: Parameters, s: Spectrum, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the ratio (F,) of torque to speed that a load disturbance causes, and its derivatives by `names` (W, F)."""
        loop = _Loop(varied(values, names), s)
        # The engine's side alone determines this ratio.
        brake = loop.answer(1.0, 0.0)[-1]
        gauge = brake - loop.inertia
        ratio = gauge if self.gauge else brake
        if self.speed == "propeller":
            ratio = ratio / (1.0 - loop.slip * gauge)
        return value_and_slopes(ratio, names)

    def open_loop(self, values: Parameters, s: Spectrum) -> Spectrum:
        """Return the open loop's transfer function (F,): minus the ratio of returned to injected signal."""
        loop = _Loop(values, s)
        fixed, brake = (loop.answer(1.0, 0.0, governed=governed)[-1] for governed in (False, True))
        opened = loop.closed(fixed)
        return np.asarray((loop.closed(brake) - opened) / opened)

    def characteristic(self, values: Parameters, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the characteristic function (F,) at s, whose zeros are the closed loop's poles, and its slope."""
        # The function's pole is that of the actuator.
        loop = _Loop(values, Dual(s, {"s": 1.0}))
        value, slopes = value_and_slopes(
            (loop.s + drooped(values)[1]) * loop.closed(loop.answer(1.0, 0.0)[-1]), ["s"]
        )
        return value, slopes[0]

    def _outputs(self, loop: _Loop, back: Answer, asked: Answer) -> list[Any]:
        """Outputs (F,) of the closed loop, from the drive's responses `back` to the speed and `asked` to external inputs."""
        n_s = asked[-1] / loop.closed(back[-1])
        M_g = loop.propeller * n_s
        n_e = n_s + loop.slip * M_g
        M_b = M_g + loop.inertia * n_e
        rows = {
            "dn": n_e if self.speed == "engine" else n_s,
            "dM": M_g if self.gauge else M_b,
            "dM_b": M_b,
        }
        for output, outside, inside in zip(("dE", "dX"), asked, back, strict=False):
            if output in self.outputs:
                rows[output] = outside + inside * n_e
        return [rows[output] for output in self.outputs]
