"""The model of a ship without limits: residuals of its two equations in closed form, without simulation.

The kernel returns residuals and their derivatives by its parameters, or the products of these rows for `likelihood`,
whitened and with systematic errors.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple, Self

import numpy as np

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Hold
from shipfp_rs.identification.coordinates import loop_of
from shipfp_rs.identification.model import Model, Units
from shipfp_rs.identification.moving_water import BAND, Water, water_of
from shipfp_rs.identification.spectra import LATE, Spectra
from shipfp_rs.structures.dual import varied
from shipfp_rs.structures.elements import QUANTITIES
from shipfp_rs.structures.parameter import BRAKE
from shipfp_rs.structures.ship import (
    BRAKE_SCALE,
    CommandedEquations,
    ShipEquations,
    observed,
    stepper_parameters,
)
from shipfp_rs.structures.ship import INDEX as SHIP_INDEX
from shipfp_rs.structures.state_space import LinearEquations
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import Behind, PartEquations
from shipfp_rs.structures.transfer import SLOWEST, Place, TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray, Numbers
from shipfp_rs.support.derivatives import interpolated

INDEX = {name: index for index, name in enumerate(_core.EQUATION_PARAMETERS)}
"""Indices of the kernel's parameters."""
OFF = np.array([float(name in ("v", "s_M", "s_B")) for name in INDEX])
"""Values at which the kernel's parameters have no effect: 1 for gain and scales, else 0."""
UNKNOWNS = {
    "set point offset": "u_0",
    "torque scale": "s_M",
    "torque offset": "m_0",
    BRAKE_SCALE: "s_B",
    "rack offset": "x_0",
}
"""Unknowns of a record and their names in the kernel. The operating point, a mean over a minute in moving water, is exact
only to parts in a thousand. Set point and speed therefore differ by an offset, and the torque is scaled by another mean
than the load's."""
GAINS = ("K_p", "K_i", "K_d")
"""Gains that a structure may declare beside v; the kernel has their products with v."""
WHITE = 1e-3
"""Standard deviation of the noise before any estimate, relative to the operating point."""
FINE_HZ = 200.0
"""Sample rate above which linear interpolation of a band-limited set point is accurate enough [Hz]."""

Asked = tuple[Array, Array, float, list[tuple[Array, float]], list[int], bool, bool]
"""Arguments that the kernel's functions share."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ShipModel(Model):
    """The model of a record of a ship without limits."""

    record: Spectra
    unknowns: tuple[str, ...]  # names of the record's unknowns, see `UNKNOWNS`
    equations: LinearEquations | ShipEquations
    layers: tuple[Behind, ...] = ()  # ties and joint structures, outermost first
    gains: tuple[str, ...] = ()  # gains that the structure declares beside v
    noise: Literal["coloured", "white"] = "coloured"  # white: one covariance at all frequencies
    ahead: float = 0.0  # inertia ahead of the gauge at which the noise was estimated
    water: Water | None = None  # information on the engine's side from moving water, if there is any
    has_walls = True
    _links: dict[tuple[str, ...], tuple[list[str], Array]] = field(default_factory=dict, repr=False)

    @property
    def spectrum(self) -> Numbers:
        """Spectra of the outputs, (O, F)."""
        return self.record.spectrum

    @property
    def frequency_hz(self) -> Array:
        """Compared frequencies [Hz], (F,)."""
        return self.record.frequency_hz

    @property
    def gauge(self) -> bool:
        """Whether the torque is measured between the inertias."""
        return self.equations.gauge

    @property
    def open_loop(self) -> bool:
        """Whether the input is a command instead of a governor's set point."""
        return isinstance(self.equations, CommandedEquations)

    @property
    def behind_twist(self) -> bool:
        """Whether the speed is measured on the propeller's side of a torsionally flexible shaft."""
        return isinstance(self.equations, ShipEquations) and self.equations.propeller_speed

    @property
    def loop(self) -> TransferFunctions:
        """Transfer functions of the record's outputs."""
        place: Place = "propeller" if self.behind_twist else "engine"
        return TransferFunctions(self.record.outputs, self.gauge, place)

    def kernel_values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the kernel's parameters by name, computed from the searched ones."""
        found = dict(values)
        for layer in self.layers:
            found = layer.own_values(found)
        for gain in self.gains:
            found[f"v{gain}"] = found[gain] * found.get("v", 1.0)
        return found

    def _link(self, names: Sequence[str]) -> tuple[list[str], Array]:
        """The ship's parameters that depend on the searched ones, and their derivatives (W, dependent)."""
        key = tuple(names)
        if key not in self._links:
            own, chain = list(names), np.eye(len(names))
            for layer in self.layers:
                own, link = layer.chain(own)
                chain = chain @ link
            kept = [place for place, name in enumerate(own) if name in INDEX or name in self.gains]
            self._links[key] = [own[place] for place in kept], chain[:, kept]
        return self._links[key]

    def moved(self, names: Sequence[str]) -> tuple[str, ...]:
        """Names of the kernel's parameters that depend on the searched parameters, in the order of `link`."""
        own = [f"v{name}" if name in self.gains else name for name in self._link(names)[0]]
        return tuple(dict.fromkeys([*own, *(f"v{gain}" for gain in self.gains if names)]))

    def link(self, values: Mapping[str, float], names: Sequence[str]) -> Array:
        """Derivatives of the kernel's parameters `moved` by the searched parameters, (M, W)."""
        own, chain = self._link(names)
        if not self.gains:
            return chain.T
        known, place = self.kernel_values(values), {name: row for row, name in enumerate(self.moved(names))}
        link = np.zeros((len(place), len(own)))
        for column, name in enumerate(own):
            if name in self.gains:
                link[place[f"v{name}"], column] = known.get("v", 1.0)
                continue
            link[place[name], column] = 1.0
            if name == "v":
                for gain in self.gains:
                    link[place[f"v{gain}"], column] = known[gain]
        return np.asarray(link @ chain.T)

    def _asked(self, values: Mapping[str, float], own: Array) -> Asked:
        """Return the first arguments of the kernel's functions, up to the indices of varied parameters."""
        data, parameters = self.record, OFF.copy()
        known = self.kernel_values(values)
        for name, value in known.items():
            if name in INDEX:
                parameters[INDEX[name]] = value
        parameters[INDEX["t_1"]] = self.ahead
        parameters[self._places] += own
        dead = known.get("T_d", 0.0)
        late = [data.delayed("speed", dead), data.delayed("set point", dead + known.get("T_set", 0.0))]
        if self.behind_twist:
            late.append(data.delayed("torque", dead))
        outputs = [_core.EQUATION_OUTPUTS.index(name) for name in data.outputs]
        return (parameters, data.signals, data.spacing, late, outputs, self.gauge, self.open_loop)

    @cached_property
    def _places(self) -> list[int]:
        """Indices of the record's unknowns among the kernel's parameters."""
        return [INDEX[UNKNOWNS[name]] for name in self.unknowns]

    def rows(self, values: Mapping[str, float], own: Array, names: Sequence[str]) -> ComplexArray:
        """Residual and the model's derivatives by the kernel's parameters and the unknowns, (1 + M + U, O, F)."""
        asked = self._asked(values, own)
        if not _core.loop_is_stable(asked[0], self.open_loop):
            raise SimulationError("the loop is unstable")
        moving = [*(INDEX[name] for name in self.moved(names)), *self._places] if names else []
        parts = _core.equation_residuals(*asked, moving)
        count = len(self.record.frequency_hz)
        rows = parts[..., 0, :count] + 1j * parts[..., 1, :count]
        rows[..., 0] = 0.0  # means determine only the offsets
        return np.asarray(rows)

    def products(
        self, values: Mapping[str, float], own: Array, names: Sequence[str], units: Units
    ) -> tuple[Array, Array]:
        """Gram matrix of `rows` in units of the noise, and their products with the systematic errors, (E, 1 + M + U)."""
        moving = [*(INDEX[name] for name in self.moved(names)), *self._places] if names else []
        gram, errors = _core.equation_products(*self._asked(values, own), moving, *units)
        return gram, errors

    def units(self, root: Numbers, bent: tuple[Numbers, Array] | None) -> Units:
        """Return the noise's root and `bent`, the systematic errors with their hat functions, in the kernel's layout."""
        count, padded = len(self.record.frequency_hz), self.record.padded
        if root.ndim == 2:
            root = np.broadcast_to(root, (count, *root.shape))
        root = np.moveaxis(root, 0, -1).astype(complex)
        root[..., 0] = 0.0  # means determine only the offsets
        shapes, hats = np.zeros((0, 0, 2, 0)), np.zeros((0, padded))
        if bent is not None:
            shapes = _parts(np.moveaxis(bent[0], 0, -1), padded)
            hats = np.zeros((len(bent[1]), padded))
            hats[:, :count] = bent[1]
        return Units(_parts(root, padded), shapes, hats)

    @property
    def has_effect(self) -> bool:
        """Whether the closed form lacks an effect: the images of a held set point, in outputs sampled at the same rate."""
        return self.record.between == "held"

    def effect(self, values: Mapping[str, float], own: Array) -> ComplexArray:
        """Spectra (O, F) of the effects that the closed form lacks, minus those that are already subtracted."""
        del own
        data = self.record
        if data.between != "held":
            return np.zeros_like(data.spectrum)
        stairs = data.stairs(self.kernel_values(values), self._response)
        return stairs if data.shown is None else stairs - data.shown

    @property
    def numbers(self) -> int:
        """Number of real values of each output, the mean excepted."""
        return 2 * (len(self.record.frequency_hz) - 1)

    @property
    def first_root(self) -> Array:
        """Root of the inverse covariance of the noise before any estimate, (O, O)."""
        return np.eye(len(self.record.outputs)) / WHITE

    @property
    def told(self) -> Array:
        """Share of each output's samples that were measured, (O,)."""
        return np.asarray(1.0 - self.record.masked.mean(axis=0))

    def compared(self, spectra: Numbers) -> Numbers:
        """Return spectra without the mean."""
        return spectra[..., 1:]

    def modelled(self, residual: Numbers) -> Array:
        """Modelled outputs (O, K), decimated, for a residual; equal to the data at the record's edges and above the band."""
        data = self.record
        return np.asarray(data.decimated * (1.0 - data.tapers[0]) + data.in_time(data.spectrum - residual))

    def simulated(self, values: Mapping[str, float], own: Array, limits: Mapping[str, float]) -> Array:
        """Outputs (O, N), simulated with limits of torque and rate, at the data's rate."""
        data, known = self.record, self.kernel_values(values)
        known = {name: value for name, value in known.items() if name not in ("M_max", "M_soft", "rate")}
        if isinstance(self.equations, LinearEquations):
            # This c_2 cancels the second-order term of the law, which leaves a straight line.
            known["c_2"] = -0.5 * known["p"] * (known["p"] - 1.0)
        states = dict(zip(self.unknowns, own, strict=True))
        parameters = stepper_parameters(known | dict(limits), open_loop=self.open_loop)
        parameters[SHIP_INDEX["u_0"]] += states.get("set point offset", 0.0)
        parameters[SHIP_INDEX["s_M"]] += states.get("torque scale", 0.0)
        names = {"dn": "dn_prop" if self.behind_twist else "dn", "dM": "dM_g" if self.gauge else "dM_b"}
        outputs = [_core.SHIP_OUTPUTS.index(names.get(name, name)) for name in data.outputs]
        fine, (set_point, load) = self._finer, self._driving
        hold: Hold = "zero" if data.between == "held" else "first"
        dt = 1.0 / (data.data_hz * fine)
        return observed(
            lambda vector: _core.simulate_ship(vector, set_point, load, dt, 0, hold, outputs)[:, ::fine],
            parameters,
            data.outputs,
            known.get("T_B", 0.0),
            1.0 + states.get(BRAKE_SCALE, 0.0),
            1.0 / data.data_hz,
        )

    @property
    def _finer(self) -> int:
        """Simulation steps per sample of the set point: enough for linear interpolation of a low-passed signal."""
        return max(1, round(FINE_HZ / self.record.data_hz)) if self.record.between == "band-limited" else 1

    @cached_property
    def _driving(self) -> tuple[Array, Array]:
        """Set point and load at the rate of the simulation."""
        data = self.record
        return interpolated(1.0 + data.set_point, self._finer), interpolated(data.load, self._finer)

    def _response(self, values: Mapping[str, float], frequency_hz: Array) -> ComplexArray:
        """Response (O, F) of the outputs to the ship's input with sensor delays, for values of the kernel's parameters."""
        outputs = self.record.outputs
        if self.open_loop:
            found, _ = CommandedEquations(outputs, self.gauge).response(values, frequency_hz, ())
        else:
            found, _ = self.loop.response(loop_of(values), frequency_hz, ())
        late = np.array([values.get(LATE.get(name, ""), 0.0) for name in outputs])
        return np.asarray(found * np.exp(-2j * np.pi * late[:, None] * frequency_hz))

    def is_corrected(self, free: Container[str]) -> bool:
        """Whether the model corrects the record: gaps, images of a held set point, or speed behind a flexible shaft."""
        slips = "tau_twist" in free and not self.behind_twist
        return bool(self.record.masked.any()) or slips or self.record.between == "held"

    def corrected(self, values: Mapping[str, float], own: Array) -> Self:
        """Return the model with its record corrected at these parameters; see `Spectra.corrected`."""
        data, known = self.record, self.kernel_values(values)
        slips = bool(known.get("tau_twist")) and not self.behind_twist
        if data.between == "band-limited" and not (slips or data.slip is not None or data.masked.any()):
            return self
        whole = self._whole(values, own)
        return replace(self, record=data.corrected(known, self._response, whole, slips=slips))

    def _whole(self, values: Mapping[str, float], own: Array) -> Array | None:
        """Modelled outputs (O, N) for a record with gaps; None without gaps, or if the simulation diverges."""
        if not self.record.masked.any():
            return None
        try:
            return self.simulated(values, own, self._limits(values))
        except SimulationError:
            return None

    def _limits(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Active limits, by the stepper's names."""
        del values
        return {}

    def prepared(self, values: Mapping[str, float]) -> Self:
        """Return the model with the inertia ahead of the gauge at these parameters."""
        known = self.kernel_values(values)
        # The kernel mixes both equations so that the engine's has this inertia, which changes only rounding errors.
        ahead = known.get("tau_n", 0.0) - known.get("tau_prop", 0.0) if self.gauge else 0.0
        return replace(self, ahead=ahead)

    def bent(
        self, response: Numbers, values: Mapping[str, float], accuracy: Array, free: Container[str]
    ) -> Numbers:
        """Return the response to which systematic errors are relative, larger where a late sensor may dampen its output."""
        known, late = self.kernel_values(values), np.zeros((len(self.record.outputs), 1))
        for output, name in enumerate(LATE.get(one, "") for one in self.record.outputs):
            prior = QUANTITIES[name].prior if name in free else None
            late[output] = np.hypot(known.get(name, 0.0), prior[1] if prior else 0.0)
        # A delay dampens: a hold by a sixth of the squared phase, a Bessel filter by about as much.
        dampened = (2.0 * np.pi * self.record.frequency_hz * late) ** 2 / 6.0
        return response * np.hypot(1.0, dampened / np.maximum(accuracy[:, None], 1e-12))

    def informed(
        self, left: Numbers, values: Mapping[str, float], own: Array, accuracy: Array, free: Container[str]
    ) -> Self:
        """Return the model with the ratios of torque to speed in moving water, from the residuals `left`."""
        outputs = self.record.outputs
        # A torque at the brake and a set point determine the engine's side without moving water.
        if not self.gauge or self.open_loop or set(outputs) != {"dn", "dM"}:
            return self
        # Errors of gauge and calibration are the same in all bands of an octave.
        alike = float(np.hypot(*accuracy)) * math.sqrt(1.0 / math.log2(BAND))
        late = QUANTITIES["T_M"].prior
        late_s = late[1] if late and "T_M" not in free else 0.0
        s = 1j * np.maximum(2.0 * np.pi * self.record.frequency_hz, SLOWEST)
        model, _ = self._torque_over_speed(values, own, s, [])
        known = self.kernel_values(values)
        load = known["p"] + known["tau_prop"] * s
        rows = left[outputs.index("dn")], left[outputs.index("dM")]
        return replace(self, water=water_of(self.record.frequency_hz, *rows, model, load, alike, late_s))

    @property
    def expected(self) -> float:
        """Expected deviance of the ratios in moving water."""
        return 0.0 if self.water is None else 2.0 * len(self.water.s)

    def information(self, values: Mapping[str, float], own: Array, names: Sequence[str]) -> Array | None:
        """Rows (2 B, 1 + M + U) of the ratios of torque to speed in moving water."""
        if self.water is None:
            return None
        columns = [*self.moved(names), *(UNKNOWNS[name] for name in self.unknowns)]
        return self.water.rows(*self._torque_over_speed(values, own, self.water.s, columns)).T

    def _torque_over_speed(
        self, values: Mapping[str, float], own: Array, s: ComplexArray, names: Sequence[str]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Torque over speed (F,) in moving water, as measured, and its derivatives by kernel parameters, (W, F)."""
        known = self.kernel_values(values)
        states = dict(zip(self.unknowns, own, strict=True))
        ratio, slopes = self.loop.torque_over_speed(loop_of(varied(known, names)), s, names)
        late = np.exp(s * (known.get("T_n", 0.0) - known.get("T_M", 0.0)))
        late *= 1.0 + states.get("torque scale", 0.0)
        for name, by in (("T_M", -s * ratio), ("T_n", s * ratio), ("s_M", ratio)):
            if name in names:
                slopes[names.index(name)] = by
        return ratio * late, slopes * late


class Ship(NamedTuple):
    """Equations, layers and gains of a single trial's structure: arguments of `ShipModel`."""

    equations: LinearEquations | ShipEquations
    layers: tuple[Behind, ...]
    gains: tuple[str, ...]

    @classmethod
    def of(cls, structure: Structure) -> Self | None:
        """Return the ship of a single trial's structure; None if the two equations lack one of its elements."""
        equations, layers, own = structure.equations, list[Behind](), set(structure.names)
        while isinstance(equations, Behind):
            if isinstance(equations, PartEquations):
                own = set(equations.names.values())
            layers.append(equations)
            equations = equations.equations
        if not isinstance(equations, LinearEquations | ShipEquations):
            return None
        if isinstance(equations, ShipEquations):
            if equations.envelope or ("T_s" in own and not equations.mean_sampling):
                return None
            equations = replace(equations, propeller_speed=equations.propeller_speed and "tau_twist" in own)
        outputs, gains = set(equations.outputs), tuple(gain for gain in GAINS if gain in own)
        twists = "tau_twist" in own and "dM" not in outputs
        if twists or "dn" not in outputs or outputs - set(_core.EQUATION_OUTPUTS) or own - {*INDEX, *gains}:
            return None
        return cls(equations, tuple(layers), gains)

    @property
    def is_linear(self) -> bool:
        """Whether the load torque is a linear function of the speed."""
        return isinstance(self.equations, LinearEquations)


def unknowns_of(equations: LinearEquations | ShipEquations) -> tuple[str, ...]:
    """Return a record's unknowns: offset of rack or set point, and offset (of a linear ship) or scale of the torque."""
    outputs, is_linear = equations.outputs, isinstance(equations, LinearEquations)
    in_open_loop = isinstance(equations, CommandedEquations)
    found = [] if in_open_loop else ["set point offset"]
    if "dM" in outputs:
        found.append("torque offset" if is_linear else "torque scale")
    if BRAKE in outputs:
        found.append(BRAKE_SCALE)
    return (*found, *(["rack offset"] if "dX" in outputs or in_open_loop else []))


def _parts(values: Numbers, padded: int) -> Array:
    """Split complex numbers (O, O, F) into real and imaginary parts, (O, O, 2, padded)."""
    found = np.zeros((*values.shape[:2], 2, padded))
    found[:, :, 0, : values.shape[2]], found[:, :, 1, : values.shape[2]] = values.real, values.imag
    return found
