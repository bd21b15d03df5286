"""The likelihood of a ship without limits: residuals of its two equations in closed form, without simulation.

The kernel returns products of whitened residuals, derivatives and systematic errors (see `likelihood`), by the
kernel's parameters. This module transforms the products to search coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np
import numpy.typing as npt

from shipfp_rs import _core
from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Hold
from shipfp_rs.identification.coordinates import Coordinates, loop_of, wall_rows
from shipfp_rs.identification.likelihood import (
    OCTAVE,
    Likelihood,
    quantile_of,
    real_rows,
    white_root,
)
from shipfp_rs.identification.moving_water import BAND, Water, water_of
from shipfp_rs.identification.spectra import LATE, Spectra
from shipfp_rs.structures.dual import varied
from shipfp_rs.structures.elements import QUANTITIES
from shipfp_rs.structures.ship import BRAKE_SCALE, CommandedEquations, observed, stepper_parameters
from shipfp_rs.structures.ship import INDEX as SHIP_INDEX
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.transfer import SLOWEST, Place, TransferFunctions
from shipfp_rs.structures.two_equations import TwoEquations
from shipfp_rs.support.arrays import Array, ComplexArray, Numbers
from shipfp_rs.support.derivatives import interpolated

INDEX = {name: index for index, name in enumerate(_core.EQUATION_PARAMETERS)}
"""Indices of the kernel's parameters."""
OFF = np.array([float(name in ("v", "s_M", "s_B")) for name in INDEX])
"""Values of the kernel's parameters at which no parameter has an effect."""
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

Asked = tuple[Array, Array, float, list[tuple[Array, float]], list[int], bool, bool]
"""Arguments that the kernel's functions share."""
STEP = 1e-4
"""Step of a search vector's entry for a difference quotient, over the width of its bounds if that is below 1."""
QUICK = 60_000
"""Size of a derivative matrix below which threads do not pay off, since a kernel call takes half a millisecond."""
FINE_HZ = 200.0
"""Sample rate above which linear interpolation of a band-limited set point is accurate enough [Hz]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EquationLikelihood(Likelihood):
    """Likelihood of a ship without limits for given records.

    Parameters
    ----------
    waters
        Information on each record's engine side from moving water, from the residuals that gave the noise.
    ahead
        Inertia ahead of the gauge where the noise was estimated, for each record; empty: not estimated yet. It determines
        the mixing of both equations, which only affects rounding.
    gauge
        Whether the torque is measured between the inertias.
    unknowns
        Names of the unknowns that each record has.
    ships
        Ship of a given structure for each record; empty: the parameters of the coordinates are the kernel's.
    white
        Whether each record's noise is white, with one covariance for all frequencies.
    propeller
        Whether the speed is measured on the propeller's side of the flexible shaft.
    about
        Point of the search at which the derivatives of the effects that `taken` subtracts from the residuals are computed;
        None: at the current point.
    """

    records: tuple[Spectra, ...]
    coordinates: Coordinates
    waters: tuple[Water | None, ...] = ()
    ahead: tuple[float, ...] = ()
    gauge: bool
    unknowns: tuple[str, ...]
    ships: tuple[TwoEquations, ...] = ()
    white: bool = False
    propeller: bool = False
    about: Array | None = None

    @cached_property
    def _outputs(self) -> list[int]:
        return [_core.EQUATION_OUTPUTS.index(name) for name in self.records[0].outputs]

    def of_structure(self, structure: Structure) -> Self:
        """Return the likelihood of a structure with the same parameters, but other free ones."""
        c = self.coordinates
        own = Coordinates.of(structure, c.unknowns, c.state_deviation)
        ships = tuple(replace(ship, names=own.names) for ship in self.ships)
        return replace(self, coordinates=own, ships=ships)

    @property
    def is_quick(self) -> bool:
        """Whether an evaluation is too short for threads to pay off."""
        return self.coordinates.size * sum(len(one.frequency_hz) for one in self.records) < QUICK

    @property
    def open_loop(self) -> bool:
        """Whether the drive follows a command, without a governor."""
        return bool(self.ships) and self.ships[0].open_loop

    @property
    def place(self) -> Place:
        """Side of the flexible shaft on which the speed is measured."""
        return "propeller" if self.behind_twist else "engine"

    @property
    def behind_twist(self) -> bool:
        """Whether the speed is measured on the propeller's side of a torsionally flexible shaft."""
        return self.ships[0].behind_twist if self.ships else self.propeller

    def values_of(self, vector: Array, record: int) -> dict[str, float]:
        """Return a record's parameters by the kernel's names."""
        return self._own(self.coordinates.values(vector), record)

    def _own(self, values: dict[str, float], record: int) -> dict[str, float]:
        return self.ships[record].values(values) if self.ships else values

    def _asked(self, values: dict[str, float], vector: Array, record: int) -> Asked:
        """Return the first arguments of the kernel's functions, up to the indices of varied parameters."""
        data, parameters = self.records[record], OFF.copy()
        own = self._own(values, record)
        for name, value in own.items():
            if name in INDEX:
                parameters[INDEX[name]] = value
        parameters[INDEX["t_1"]] = self.ahead[record] if self.ahead else 0.0
        parameters[self._unknowns] += vector[self.coordinates.states(record)]
        dead = own.get("T_d", 0.0)
        late = [data.delayed("speed", dead), data.delayed("set point", dead + own.get("T_set", 0.0))]
        if self.behind_twist:
            late.append(data.delayed("torque", dead))
        setup = self.gauge, self.open_loop
        return (parameters, data.signals, data.spacing, late, self._outputs, *setup)

    @cached_property
    def _unknowns(self) -> list[int]:
        """Indices of a record's unknowns among the kernel's parameters."""
        return [INDEX[UNKNOWNS[name]] for name in self.unknowns]

    @cached_property
    def _moving(self) -> list[list[int]]:
        """Indices of the kernel's parameters that depend on the search vector, for each record."""
        if not self.ships:
            own = [INDEX[name] for name in self.coordinates.names if name in INDEX]
            return [[*own, *self._unknowns]] * len(self.records)
        return [[*(INDEX[name] for name in ship.moved), *self._unknowns] for ship in self.ships]

    def _places(self, record: int) -> npt.NDArray[np.intp]:
        """Indices of the free parameters and a record's unknowns in a search vector."""
        own, states = len(self.coordinates.names), self.coordinates.states(record)
        return np.array([*range(own), *range(states.start, states.stop)])

    def _turn(self, values: Mapping[str, float], jacobian: Array, record: int) -> Array:
        """Return the matrix that transforms the columns that the kernel computes for a record.

        The kernel's columns are the residual and its derivatives by the kernel's parameters and by the record's unknowns.
        The results are the residual and its derivatives by the free parameters and by the unknowns.
        """
        own = jacobian[[name in INDEX for name in self.coordinates.names]] if not self.ships else jacobian
        by = self.ships[record].slopes(values) @ jacobian if self.ships else own
        (rows, columns), count = by.shape, len(self._unknowns)
        turn = np.zeros((1 + rows + count, 1 + columns + count))
        turn[0, 0] = 1.0
        turn[1 : 1 + rows, 1 : 1 + columns] = by
        turn[1 + rows :, 1 + columns :] = np.eye(count)
        return turn

    def _gram(self, vector: Array, *, derivatives: bool) -> Array:
        if self.takes:
            return super()._gram(vector, derivatives=derivatives)
        return self._gram_in_closed_form(vector, derivatives=derivatives)

    def _gram_in_closed_form(self, vector: Array, *, derivatives: bool) -> Array:
        size = 1 + self.coordinates.size if derivatives else 1
        values = self.coordinates.values(vector)
        jacobian = self.coordinates.jacobian(values)
        turn, found = np.eye(1), []
        for index, units in enumerate(self._laid_out):
            moving = self._moving[index] if derivatives else []
            if derivatives and (self.ships or not index):
                turn = self._turn(values, jacobian, index)
            products, crossed = _core.equation_products(*self._asked(values, vector, index), moving, *units)
            found.append((turn.T @ products @ turn, crossed @ turn))
        gram, errors = found[0] if len(found) == 1 else self._joined(found, size)
        return self._with_priors(vector, gram, errors.T)

    def _joined(self, found: Sequence[tuple[Array, Array]], size: int) -> tuple[Array, Array]:
        """Sum the products of all records over the columns of the whole search vector."""
        gram, errors = np.zeros((size, size)), np.zeros((len(found[0][1]), size))
        for index, (products, crossed) in enumerate(found):
            columns = np.append(0, 1 + self._places(index))[: len(products)]
            gram[columns[:, None], columns] += products
            errors[:, columns] += crossed
        return gram, errors

    @cached_property
    def _laid_out(self) -> list[tuple[Array, Array, Array]]:
        """For each record, as the kernel takes them: noise root, whitened systematic errors, their hat functions."""
        found = []
        for index, record in enumerate(self.records):
            root = self.root(index)
            if root.ndim == 2:
                root = np.broadcast_to(root, (len(record.frequency_hz), *root.shape))
            root = np.moveaxis(root, 0, -1).astype(complex)
            root[..., 0] = 0.0  # means determine only the offsets
            shapes, hats = np.zeros((0, 0, 2, 0)), np.zeros((0, record.padded))
            if self.bends:
                shapes = _parts(np.moveaxis(self._bent[index], 0, -1), record.padded)
                hats = np.zeros((len(self._hats[index]), record.padded))
                hats[:, : len(record.frequency_hz)] = self._hats[index]
            found.append((_parts(root, record.padded), shapes, hats))
        return found

    @property
    def freedom(self) -> int:
        """Degrees of freedom of white noise: real numbers in the data minus unknowns."""
        numbers = sum(2 * (len(record.frequency_hz) - 1) for record in self.records)
        return len(self.accuracy) * numbers - self.coordinates.size

    @property
    def quantile(self) -> float:
        """Half width of a 95 % interval, in standard deviations."""
        return quantile_of(self.freedom) if self.white else super().quantile

    def _noise(self, residuals: Sequence[Numbers], unsure: Sequence[Numbers | float]) -> tuple[Numbers, ...]:
        if self.white:
            share = max(self.freedom, 1) / max(self.freedom + self.coordinates.size, 1)
            found = tuple(
                white_root(real_rows(one[:, 1:]), real_rows(record.spectrum[:, 1:]), share, self.quantile)
                for one, record in zip(residuals, self.records, strict=True)
            )
        else:
            found = super()._noise(residuals, unsure)
        # Interpolated samples have almost no residual, and carry no information about the noise.
        told = (1.0 - record.masked.mean(axis=0) for record in self.records)
        return tuple(root * share for root, share in zip(found, told, strict=True))

    def spread(self) -> float:
        """Log determinants of the noise, as part of the deviance."""
        if not self.white:
            return super().spread()
        assert self.roots is not None
        numbers = [2 * (len(record.frequency_hz) - 1) for record in self.records]
        return sum(
            -2.0 * count * float(np.log(np.abs(np.diag(root))).sum())
            for count, root in zip(numbers, self.roots, strict=True)
        )

    def spectra(self, vector: Array, record: int) -> tuple[ComplexArray, ComplexArray]:
        """Residuals (O, F) of a record, and the model's derivatives by the whole search vector (P, O, F)."""
        values = self.coordinates.values(vector)
        turn = self._turn(values, self.coordinates.jacobian(values), record)
        rows = self._residuals(vector, record, self._moving[record])
        jacobian = np.zeros((self.coordinates.size, *rows.shape[1:]), complex)
        jacobian[self._places(record)] = np.tensordot(turn[1:, 1:].T, rows[1:], 1)
        if not self.takes:
            return rows[0], jacobian
        taken = self.taken(vector, record)
        moves = self._moves(vector, record, taken) if self.about is None else self._moves_about[record]
        return rows[0] - taken, jacobian + moves

    def _residuals(self, vector: Array, record: int, moving: list[int]) -> ComplexArray:
        asked = self._asked(self.coordinates.values(vector), vector, record)
        if not _core.loop_is_stable(asked[0], self.open_loop):
            raise SimulationError("the loop is unstable")
        found = _core.equation_residuals(*asked, moving)
        count = len(self.records[record].frequency_hz)
        rows = _whole(found, count)
        rows[..., 0] = 0.0  # means determine only the offsets
        return np.asarray(rows)

    def residual(self, vector: Array, record: int) -> ComplexArray:
        """Residuals (O, F) of a record."""
        found = self._residuals(vector, record, [])[0]
        return np.asarray(found - self.taken(vector, record) if self.takes else found)

    @cached_property
    def takes(self) -> bool:
        """Whether the closed form lacks an effect; this effect is then subtracted from the residuals."""
        return any(one.between == "held" for one in self.records)

    def taken(self, vector: Array, record: int) -> ComplexArray:
        """Spectra (O, F) of the effects that the closed form lacks, minus those that are already subtracted from the record.

        Without limits, these are the images of a held set point, in outputs sampled at the same rate.
        """
        data = self.records[record]
        if data.between != "held":
            return np.zeros_like(data.spectrum)
        stairs = data.stairs(self.values_of(vector, record), self._response)
        return stairs if data.shown is None else stairs - data.shown

    def _moves(self, vector: Array, record: int, taken: ComplexArray) -> ComplexArray:
        """Derivatives (P, O, F) of the subtracted effects, by difference quotients."""
        states, (low, high) = self.coordinates.states(record), self.coordinates.bounds
        places = [*range(len(self.coordinates.names)), *range(states.start, states.stop)]

        def move(place: int) -> ComplexArray:
            step = STEP * min(high[place] - low[place], 1.0)
            step = step if vector[place] + step <= high[place] else -step
            moved = vector.copy()
            moved[place] += step
            return np.asarray((self.taken(moved, record) - taken) / step)

        found = np.zeros((self.coordinates.size, *taken.shape), complex)
        found[places] = self.each([partial(move, place) for place in places])
        return found

    @cached_property
    def _moves_about(self) -> list[ComplexArray]:
        assert self.about is not None
        about = self.about
        return [self._moves(about, index, self.taken(about, index)) for index in range(len(self.records))]

    def residuals(self, vector: Array) -> list[Numbers]:
        """Residuals (O, F) of each record."""
        return [self.residual(vector, index) for index in range(len(self.records))]

    def modelled(self, vector: Array, record: int) -> Array:
        """Modelled outputs of a record, decimated (O, K); at the record's edges and above the band they equal the data."""
        data = self.records[record]
        answer = data.in_time(data.spectrum - self.residual(vector, record))
        return np.asarray(data.decimated * (1.0 - data.tapers[0]) + answer)

    def simulated(self, vector: Array, record: int, limits: Mapping[str, float]) -> Array:
        """Outputs of a record (O, N), simulated with limits of torque and rate, at the data's rate."""
        data, values = self.records[record], self.values_of(vector, record)
        values = {name: value for name, value in values.items() if name not in ("M_max", "M_soft", "rate")}
        if self.ships and self.ships[record].is_linear:
            # This c_2 cancels the second-order term of the law, which leaves a straight line.
            values["c_2"] = -0.5 * values["p"] * (values["p"] - 1.0)
        own = dict(zip(self.unknowns, vector[self.coordinates.states(record)], strict=True))
        parameters = stepper_parameters(values | dict(limits), open_loop=self.open_loop)
        parameters[SHIP_INDEX["u_0"]] += own.get("set point offset", 0.0)
        parameters[SHIP_INDEX["s_M"]] += own.get("torque scale", 0.0)
        speed = "dn_prop" if self.behind_twist else "dn"
        names = {"dn": speed, "dM": "dM_g" if self.gauge else "dM_b"}
        outputs = [_core.SHIP_OUTPUTS.index(names.get(name, name)) for name in data.outputs]
        fine = self._finer(data)
        set_point, load = self._driving[record]
        hold: Hold = "zero" if data.between == "held" else "first"
        dt = 1.0 / (data.data_hz * fine)
        return observed(
            lambda vector: _core.simulate_ship(vector, set_point, load, dt, 0, hold, outputs)[:, ::fine],
            parameters,
            data.outputs,
            values.get("T_B", 0.0),
            1.0 + own.get(BRAKE_SCALE, 0.0),
            1.0 / data.data_hz,
        )

    def _finer(self, record: Spectra) -> int:
        """Simulation steps per sample of the set point: enough for linear interpolation of a low-passed signal."""
        return max(1, round(FINE_HZ / record.data_hz)) if record.between == "band-limited" else 1

    @cached_property
    def _driving(self) -> list[tuple[Array, Array]]:
        """Set point and load of each record at the rate of its simulation."""
        return [
            (interpolated(1.0 + one.set_point, self._finer(one)), interpolated(one.load, self._finer(one)))
            for one in self.records
        ]

    def _response(self, values: Mapping[str, float], frequency_hz: Array) -> ComplexArray:
        """Response (O, F) of the outputs to the ship's input, delays of the sensors included, by kernel parameters."""
        outputs = self.records[0].outputs
        if self.open_loop:
            found, _ = CommandedEquations(outputs, self.gauge).response(values, frequency_hz, ())
        else:
            loop = TransferFunctions(outputs, self.gauge, self.place)
            found, _ = loop.response(loop_of(values), frequency_hz, ())
        late = np.array([values.get(LATE.get(name, ""), 0.0) for name in outputs])
        return np.asarray(found * np.exp(-2j * np.pi * late[:, None] * frequency_hz))

    @property
    def is_corrected_by_model(self) -> bool:
        """Whether the model corrects the records: gaps, images of a held set point, or speed behind a flexible shaft."""
        gaps = any(one.masked.any() for one in self.records)
        slips = "tau_twist" in self.coordinates.free and not self.behind_twist
        return gaps or slips or any(one.between == "held" for one in self.records)

    def corrected(self, vector: Array) -> Self:
        """Return the likelihood of the records corrected by the model at a point of the search; see `Spectra.corrected`."""
        records = []
        for index, record in enumerate(self.records):
            values, model = self.values_of(vector, index), self._whole(vector, index)
            slips = bool(values.get("tau_twist")) and not self.behind_twist
            records.append(record.corrected(values, self._response, model, slips=slips))
        return replace(self, records=tuple(records))

    def resettled_at(self, vector: Array) -> Self:
        """Return the likelihood settled at a new point of the search, without new images, since images hardly change."""
        return (self.corrected(vector) if self.is_corrected_by_model else self).with_noise(vector)

    def settled_at(self, vector: Array) -> Self:
        """Return the likelihood with records corrected, and noise estimated, by the model at a point of the search."""
        needs = self.is_corrected_by_model or any(one.between != "band-limited" for one in self.records)
        return (self.corrected(vector) if needs else self).with_noise(vector)

    def _whole(self, vector: Array, record: int) -> Array | None:
        """Modelled outputs (O, N) for a record with gaps; None without gaps, or if the simulation diverges."""
        if not self.records[record].masked.any():
            return None
        try:
            return self.simulated(vector, record, self._limits(vector))
        except SimulationError:
            return None

    def _limits(self, vector: Array) -> Mapping[str, float]:
        """Active limits at a point of the search, by the stepper's names."""
        del vector
        return {}

    def prior_rows(
        self, vector: Array, values: Mapping[str, float] | None = None, jacobian: Array | None = None
    ) -> Array:
        """Rows of the priors, and of active penalties."""
        values = self.coordinates.values(vector) if values is None else values
        jacobian = self.coordinates.jacobian(values) if jacobian is None else jacobian
        rows = super().prior_rows(vector, values, jacobian)
        water = self._water_rows(vector, values, jacobian) if any(self.waters) else []
        return np.vstack([rows, *wall_rows(self.coordinates, values, jacobian), *water])

    def _water_rows(self, vector: Array, values: Mapping[str, float], jacobian: Array) -> list[Array]:
        """Rows (2 B, 1 + P) of each record in moving water."""
        found = []
        for index, water in enumerate(self.waters):
            if water is None:
                continue
            names = [_core.EQUATION_PARAMETERS[place] for place in self._moving[index]]
            rows = water.rows(*self._torque_over_speed(vector, index, water.s, names))
            whole = np.zeros((rows.shape[1], 1 + self.coordinates.size))
            columns = np.append(0, 1 + self._places(index))
            whole[:, columns] = rows.T @ self._turn(values, jacobian, index)
            found.append(whole)
        return found

    def _torque_over_speed(
        self, vector: Array, record: int, s: ComplexArray, names: Sequence[str]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Torque over speed (F,) in moving water, as measured, and its derivatives by kernel parameters, (W, F)."""
        values = self.values_of(vector, record)
        own = dict(zip(self.unknowns, vector[self.coordinates.states(record)], strict=True))
        loop = TransferFunctions(self.records[record].outputs, self.gauge, self.place)
        ratio, slopes = loop.torque_over_speed(loop_of(varied(values, names)), s, names)
        late = np.exp(s * (values.get("T_n", 0.0) - values.get("T_M", 0.0)))
        late *= 1.0 + own.get("torque scale", 0.0)
        for name, by in (("T_M", -s * ratio), ("T_n", s * ratio), ("s_M", ratio)):
            if name in names:
                slopes[names.index(name)] = by
        return ratio * late, slopes * late

    def with_noise(self, vector: Array) -> Self:
        """Return the likelihood with the noise and the moving water's ratios of the residuals at a point of the search."""
        own = [self.values_of(vector, record) for record in range(len(self.records))]
        ahead = tuple(one.get("tau_n", 0.0) - one.get("tau_prop", 0.0) for one in own) if self.gauge else ()
        found = super(EquationLikelihood, replace(self, ahead=ahead)).with_noise(vector)
        outputs = self.records[0].outputs
        responses = map(self._dampened, self.records, found.responses, own)
        found = replace(found, responses=tuple(responses))
        # A torque at the brake and a set point determine the engine's side without moving water.
        if not self.gauge or self.open_loop or set(outputs) != {"dn", "dM"}:
            return found
        left, _ = found._left(found.residuals(vector))
        # Errors of gauge and calibration are alike in all bands of an octave.
        accuracy, waters = float(np.hypot(*self.accuracy)) * math.sqrt(OCTAVE / math.log2(BAND)), []
        late = QUANTITIES["T_M"].prior
        late_s = late[1] if late and "T_M" not in self.coordinates.free else 0.0
        for index, (record, one) in enumerate(zip(self.records, left, strict=True)):
            s = 1j * np.maximum(2.0 * np.pi * record.frequency_hz, SLOWEST)
            model, _ = self._torque_over_speed(vector, index, s, [])
            rows = one[outputs.index("dn")], one[outputs.index("dM")]
            load = own[index]["p"] + own[index]["tau_prop"] * s
            waters.append(water_of(record.frequency_hz, *rows, model, load, accuracy, late_s))
        return replace(found, waters=tuple(waters))

    def _dampened(self, record: Spectra, response: Numbers, values: Mapping[str, float]) -> Numbers:
        """Return the response to which systematic errors are relative, larger where late sensors may dampen the outputs.

        What delays a value dampens it: a hold by a sixth of the squared phase, a Bessel filter by about as much.
        """
        late = np.zeros((len(record.outputs), 1))
        for output, name in enumerate(LATE.get(one, "") for one in record.outputs):
            prior = QUANTITIES[name].prior if name in self.coordinates.free else None
            late[output] = np.hypot(values.get(name, 0.0), prior[1] if prior else 0.0)
        dampened = (2.0 * np.pi * record.frequency_hz * late) ** 2 / 6.0
        return response * np.hypot(1.0, dampened / np.maximum(self.accuracy[:, None], 1e-12))

    def own_total(self, vector: Array) -> float:
        """Deviance and log determinant under the likelihood's noise; the expected deviance of moving water is subtracted."""
        return super().own_total(vector) - sum(2 * len(water.s) for water in self.waters if water is not None)


def _parts(values: Numbers, padded: int) -> Array:
    """Split complex numbers (O, O, F) into real and imaginary parts, (O, O, 2, padded)."""
    found = np.zeros((*values.shape[:2], 2, padded))
    found[:, :, 0, : values.shape[2]], found[:, :, 1, : values.shape[2]] = values.real, values.imag
    return found


def _whole(parts: Array, count: int) -> ComplexArray:
    """Join real and imaginary parts (..., 2, padded) to complex numbers (..., F)."""
    return np.asarray(parts[..., 0, :count] + 1j * parts[..., 1, :count])
