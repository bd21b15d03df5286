"""Equations of the ship, computed by the Rust kernel: with a governor, or in open loop behind a command."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.experiments.experiment import Experiment, Hold
from shipfp_rs.structures.dual import varied
from shipfp_rs.structures.elements import QUANTITIES, chosen
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.parameter import BRAKE, Torque, require_outputs, signals_of
from shipfp_rs.structures.state_space import LinearEquations
from shipfp_rs.structures.transfer import Place, TransferFunctions, loop_parameters
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values
from shipfp_rs.support.derivatives import interpolated

SET_SCALE, TORQUE_SCALE, BRAKE_SCALE = "set point scale", "torque scale", "brake torque scale"
STATES = ("initial dn", "initial fuel", SET_SCALE, TORQUE_SCALE)
"""Unknowns of each experiment: initial deviations of speed and fuel torque from the operating point, and relative errors of
the set-point and torque readings, which include errors of the operating point."""

INDEX = {name: index for index, name in enumerate(_core.SHIP_PARAMETERS)}
"""Indices of the kernel's parameters."""
KERNEL = {
    "vK_p": "K_p",
    "vK_i": "K_i",
    "vK_d": "K_d",
    "rate": "rate_up",
    "k_L": "load_gain",
    "c_2": "curvature",
}
"""Names in the kernel of parameters that the kernel names differently."""
_KERNEL = KERNEL | {
    "initial dn": "initial_N",
    "initial fuel": "initial_F",
    SET_SCALE: "s_u",
    TORQUE_SCALE: "s_M",
}
"""`KERNEL`, extended by the unknowns of an experiment."""
_DEVIATIONS = ("initial dn", SET_SCALE, TORQUE_SCALE)
"""Unknowns without effect at the value 0; the corresponding kernel parameters have no effect at 1."""


RAMP_HZ = 400.0
"""Least rate at which a ramp is computed [Hz]: estimated gains depend on the instants at which it begins and ends."""
STEP = 1e-6
"""Relative step of a difference quotient."""
STIFF_HZ, LEAST_DAMPED = 200.0, 0.01
"""Natural frequency above which a shaft is simulated as stiff, since its flexibility then changes the response below 2 Hz by
only 1e-4; and least damping ratio of a shaft, without which it rings at the start of a simulation."""
OF_BOTH_SIGNS = {*STATES, BRAKE_SCALE, "g", "p", "damping", "c_2", "T_M", "T_n", "T_B"}
"""Parameters that may be negative."""


def observed(
    step: Callable[[Array], Array],
    parameters: Array,
    outputs: Sequence[str],
    late_s: float,
    scale: float,
    dt: float,
) -> Array:
    """Return the simulated outputs (O, N) with the delays of their sensors, every `dt` [s]."""
    known = parameters.copy()
    delays = {"dn": known[INDEX["T_n"]], "dM": known[INDEX["T_M"]], BRAKE: late_s}
    late = [INDEX["T_n"], INDEX["T_M"]]
    known[late] = np.maximum(known[late], 0.0)
    rows = step(known)
    # The kernel has one torque channel: another simulation gives the brake's torque in addition to a gauge's.
    if BRAKE in outputs:
        known[[INDEX["T_M"], INDEX["s_M"]]] = max(late_s, 0.0), scale
        place = list(outputs).index(BRAKE)
        rows[place] = step(known)[place]
    # The kernel has no channel that leads: such channels are interpolated.
    at = dt * np.arange(rows.shape[1])
    for row, output in zip(rows, outputs, strict=True):
        if delays.get(output, 0.0) < 0.0:
            row[:] = CubicSpline(at, row)(np.minimum(at - delays[output], at[-1]))
    return rows


def rate_limited(signal: Array, rate: float, rate_hz: float) -> Array:
    """Return a signal (N,) that follows another at `rate` per second at most, computed at a finer rate than the samples'."""
    finer = max(math.ceil(RAMP_HZ / rate_hz), 1)
    fine = interpolated(np.ascontiguousarray(signal), finer)
    # In the kernel the engine stands still, and its rack follows the error alone.
    known = {"vK_p": 1.0, "rate": rate, "rate_down": rate, "M_max": np.inf, "s_M": 1.0}
    parameters = np.array([known.get(name, 0.0) for name in _core.ENGINE_SIDE_PARAMETERS])
    still = np.zeros(len(fine))
    removed = _core.taken_by_limits(parameters, fine, still, still, 1.0 / (rate_hz * finer))[1]
    return np.asarray((fine + removed)[::finer][: len(signal)])


@dataclass(frozen=True)
class ShipEquations(Equations):
    """Equations of `Structure.ship`; the frequency response is that of their linearisation."""

    outputs: tuple[str, ...]
    gauge: bool
    propeller_speed: bool = False
    loaded: bool = False
    """Whether the experiment's load torque is a second input of the model."""
    mean_sampling: bool = False
    """Whether a sampling governor is modelled by its mean effect: T_d then includes half of the period T_s."""
    envelope: tuple[tuple[float, float], ...] = ()
    """Pairs (speed, highest torque), each relative to the operating point; empty: only M_max limits the torque."""
    substeps: int = 0
    """Steps per sample; 0: chosen by the kernel."""
    states: tuple[str, ...] = STATES
    linear_in: tuple[str, ...] = ()
    own_offsets: bool = True
    """The states include errors of the operating point; `identify` adds no offsets to the outputs."""

    @property
    def _kernel_outputs(self) -> list[int]:
        names = {
            "dn": "dn_prop" if self.propeller_speed else "dn",
            "dM": "dM_g" if self.gauge else "dM_b",
        }
        return [_core.SHIP_OUTPUTS.index(names.get(output, output)) for output in self.outputs]

    def vector(self, values: Values) -> Array:
        """Return the kernel's parameters, shape (40,), for values by name; elements without a value are off."""
        vector = np.array(_core.SHIP_OFF)
        vector[INDEX["v"]] = 1.0
        for name, value in values.items():
            if name in STATES or name in INDEX or name in _KERNEL:
                vector[INDEX[_KERNEL.get(name, name)]] = value + (name in _DEVIATIONS)
        if self.mean_sampling:
            period, dead = vector[[INDEX["T_s"], INDEX["T_d"]]]
            vector[INDEX["hold"]] = min(0.5 * period / dead, 1.0) if dead > 0.0 else 0.0
            vector[INDEX["T_s"]] = 0.0
        if twist := values.get("tau_twist", 0.0):
            swings = swings_at(values)
            vector[INDEX["tau_twist"]] = twist if swings < 2.0 * np.pi * STIFF_HZ else 0.0
            place = INDEX["zeta_twist"]
            vector[place] = max(vector[place], 2.0 * LEAST_DAMPED / (swings * twist))
        if "rate" in values:
            vector[INDEX["rate_down"]] = values["rate"]
        return vector

    def _inputs(self, experiment: Experiment, values: Values) -> tuple[Array, Array, float, int, Hold]:
        load = experiment.normalised("M_load") if self.loaded else np.empty(0)
        set_point = experiment.dn_set
        if "set_rate" in values:
            set_point = rate_limited(set_point, values["set_rate"], experiment.rate_hz)
        return 1.0 + set_point, load, 1.0 / experiment.rate_hz, self.substeps, experiment.hold

    @property
    def limit(self) -> Array | None:
        """The envelope (2, E) in the kernel's layout; None without one."""
        return np.ascontiguousarray(np.array(self.envelope).T) if self.envelope else None

    def stable(self, values: Values) -> bool:
        """Whether the loop is stable about the operating point; actuator lag and sampling are neglected."""
        known = {
            name: values[name]
            for name in ("tau_n", "g", "v", "K_p", "K_i", "vK_p", "vK_i", "p", "T_d")
            if name in values
        }
        return LinearEquations(self.outputs, gauge=self.gauge).stable(known)

    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""
        inputs = self._inputs(experiment, values)
        return observed(
            lambda vector: _core.simulate_ship(vector, *inputs, self._kernel_outputs, self.limit),
            self.vector(values),
            self.outputs,
            values.get("T_B", 0.0),
            1.0 + values.get(BRAKE_SCALE, 0.0),
            1.0 / experiment.rate_hz,
        )

    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, by difference quotients, shape (W, O, N)."""
        found = self.simulate(values, experiment)
        slopes = np.empty((len(names), *found.shape))
        for slope, name in zip(slopes, names, strict=True):
            value = values.get(name, 0.0)
            step = STEP * max(abs(value), 1.0)
            # At zero, a parameter that can't be negative has a one-sided difference.
            least = value if name in OF_BOTH_SIGNS or value >= step else value + step
            ends = (self.simulate({**values, name: one}, experiment) for one in (value + step, least - step))
            slope[:] = (next(ends) - next(ends)) / (value + 2.0 * step - least)
        return found, slopes

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) of the linearisation and its derivatives by `names`, shape (W, O, F)."""
        place: Place = "propeller" if self.propeller_speed else "engine"
        q = loop_parameters(varied(values, names), mean_sampling=self.mean_sampling)
        return TransferFunctions(self.outputs, self.gauge, place).response(q, frequency_hz, names)


KIND = "commanded"
"""Kind of an open-loop structure, as stored in its settings."""
ELEMENTS = ("dead_time_loop", "actuator_lag", "damping", "curvature", "late_torque", "load")
"""Elements of the ship that do not need a governor."""
STEPPED_HZ = 50.0
"""Natural frequency above which a fit simulates a shaft as stiff; each flexible shaft would need its own time step."""
MOST_TWISTED = 0.98
"""Largest share of the inertia on a flexible shaft's propeller side: a simulation needs inertia on both sides."""
FEEDBACK = 1e-9
"""Gain of the kernel's governor in open loop. The set point is scaled by the inverse of this gain: the command passes
unchanged, and the speed feedback is negligible.
"""


def swings_at(values: Values) -> float:
    """Natural frequency of a flexible shaft between its two inertias [rad/s]."""
    whole, behind = values["tau_n"], values["tau_prop"]
    if behind >= 0.99 * whole:
        raise SimulationError("the engine's side of the flexible shaft has almost no inertia")
    return float(np.sqrt(whole / (behind * (whole - behind)) / values["tau_twist"]))


def stepper_parameters(values: Values, *, open_loop: bool = False) -> Array:
    """Return the stepper's parameters for a ship's values by name; `vK_p`, `vK_i` and `vK_d` are products of gain and v."""
    v = values.get("v", 1.0)
    own = {name: value / v if name in ("vK_p", "vK_i", "vK_d") else value for name, value in values.items()}
    if own.get("tau_twist"):
        own["tau_prop"] = min(own["tau_prop"], MOST_TWISTED * own["tau_n"])
        # Fits simulate only to fill gaps and to compute the effect of limits, for which such a shaft may be stiff.
        if swings_at(own) > 2.0 * np.pi * STEPPED_HZ:
            own["tau_twist"] = 0.0
    if open_loop:
        return CommandedEquations((), gauge=False).vector(own)
    # Without a first sampling instant T_0, the governor is modelled by the mean effect of sampling.
    return ShipEquations((), gauge=False, mean_sampling="T_0" not in own).vector(own)


@dataclass(frozen=True)
class CommandedEquations(ShipEquations):
    """The ship's equations with a command c instead of a governor: M_b = 1 + g (N - 1) + v c(t - T_d)."""

    states: tuple[str, ...] = ("initial dn", "initial fuel", TORQUE_SCALE)

    def vector(self, values: Values) -> Array:
        """Return the kernel's parameters for values by name; the dead time T_d becomes the kernel's set-point delay."""
        vector = super().vector({_COMMANDED_KERNEL.get(name, name): value for name, value in values.items()})
        vector[[INDEX["K_p"], INDEX["K_i"]]] = FEEDBACK, 0.0
        vector[[INDEX["s_u"], INDEX["u_0"]]] = 1.0 / FEEDBACK, 1.0 - 1.0 / FEEDBACK
        return vector

    def stable(self, values: Values) -> bool:
        """Whether the drive is stable without a governor: the accelerating torque falls with the speed."""
        return values["p"] + values.get("damping", 0.0) > values["g"]

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) to the command and its derivatives by `names`, shape (W, O, F)."""
        q = loop_parameters(varied(values, names), mean_sampling=False)
        linear = TransferFunctions(self.outputs, self.gauge, "engine", governed=False)
        found, slopes = linear.response(q, frequency_hz, names)
        if "dM" in self.outputs:
            s, place = 2j * np.pi * np.asarray(frequency_hz), self.outputs.index("dM")
            late = np.exp(-s * values.get("T_M", 0.0))
            found[place] *= late
            slopes[:, place] *= late
            slopes[[name == "T_M" for name in names], place] = -s * found[place]
        return found, slopes


_COMMANDED_KERNEL = {"T_d": "T_set"}
"""Names in the kernel of parameters that it names differently in open loop."""


def commanded(
    declare: Any,
    elements: Sequence[str] = ("dead_time_loop", "actuator_lag"),
    *,
    torque: Torque = "brake",
    outputs: Sequence[str] = ("dn", "dM"),
    name: str | None = None,
) -> Any:
    """Return the structure of a drive in open loop; `declare` is the class `Structure`, which imports this module."""
    require_outputs(outputs)
    acting = chosen(elements)
    for what, given, known in (("element", elements, ELEMENTS), ("output", outputs, ("dn", "dM"))):
        for one in given:
            if one not in known:
                raise InputError(
                    f"{what} {one!r} of a drive in open loop, expected some of {', '.join(known)}"
                )
    gauge = torque == "gauge" and "dM" in outputs
    return declare(
        name=name or "open loop",
        parameters=(
            QUANTITIES["tau_n"].parameter(),
            QUANTITIES["g"].parameter(lower=-300.0),
            *(QUANTITIES[one].parameter() for one in ("v", "p", *(["tau_prop"] if gauge else []))),
            *(one for element in acting for one in element.parameters),
        ),
        signals=signals_of(outputs, torque),
        equations=CommandedEquations(
            tuple(outputs), gauge, loaded=any(element.name == "load" for element in acting)
        ),
        settings={"kind": KIND, "elements": [element.name for element in acting], "torque": torque},
    )
