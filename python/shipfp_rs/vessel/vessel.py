"""Vessels: what a ship's drive train is, as configuration. Built-in ships and TOML files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from shipfp_rs.errors import InputError
from shipfp_rs.support import hints
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.calibration import Calibration
from shipfp_rs.support.html import shown
from shipfp_rs.support.toml import Section, built_in, read_named, unexpected, validated
from shipfp_rs.vessel.tables import Actuator, Firing, FourQuadrant, NotNegative, Positive, Ship


def _no_percentage(value: object) -> object:
    if isinstance(value, int | float) and 2.0 <= value <= 100.0:
        share = f"{value / 100.0:g}"
        raise PydanticCustomError(
            "percent", "a fraction of at most 1; percent? that is {share}", {"share": share}
        )
    return value


Fraction = Annotated[float, BeforeValidator(_no_percentage), Field(gt=0.0, le=1.0)]
# A TOML array is a list; only the container may change its type, the numbers in it stay strict.
Table = Annotated[tuple[Positive, ...], Field(strict=False, min_length=2)]


class Water(Section):
    """The water that the propeller works in."""

    density_kg_m3: Positive


class Envelope(Section):
    """Highest brake torque over engine speed, straight between the points, constant outside (Fig. 3.3)."""

    speed_rpm: Table
    torque_Nm: Table

    @model_validator(mode="after")
    def _is_a_function_of_speed(self) -> Self:
        if len(self.torque_Nm) != len(self.speed_rpm):
            raise unexpected(
                "torque_Nm", f"{len(self.torque_Nm)} values", f"{len(self.speed_rpm)} as in speed_rpm"
            )
        for lower, upper in zip(self.speed_rpm, self.speed_rpm[1:], strict=False):
            if upper <= lower:
                raise unexpected("speed_rpm", f"{upper:g} after {lower:g}", "ascending speeds")
        return self


class Engine(Section):
    """Diesel engine: rating, torque limit, and what sets its torque ripple (cylinders, strokes)."""

    model: str
    cylinders: Annotated[int, Field(ge=1)]
    strokes: Annotated[int, Field(ge=2, le=4, multiple_of=2)]
    rated_power_kW: Positive
    rated_speed_rpm: Positive
    envelope: Envelope | None = None
    """None: unlimited."""
    minimum_torque_Nm: float | None = None
    """Lowest brake torque, negative for a dragged engine; None: no lower limit."""
    torque_rate_Nm_s: Positive | None = None
    """How fast the brake torque can change; None: at once."""
    smoke_margin_mm: Positive | None = None
    """By how much the rack may exceed what the charge air is good for; None: no smoke limiter."""
    turbocharger_lag_s: Positive = 1.0
    """Time constant with which the charge air follows the rack; acts with a smoke limiter only."""
    firing: Firing | None = None
    """None: the cylinders' mean torque."""

    @model_validator(mode="after")
    def _stays_within_its_rating(self) -> Self:
        if self.envelope is None:
            return self
        for speed, torque in zip(self.envelope.speed_rpm, self.envelope.torque_Nm, strict=True):
            power_kW = torque * speed * 2e-3 * math.pi / 60.0
            if power_kW > 1.01 * self.rated_power_kW:
                raise unexpected(
                    "envelope.torque_Nm",
                    f"{torque:g} Nm at {speed:g} rpm, {power_kW:.1f} kW",
                    f"at most the rated {self.rated_power_kW:g} kW",
                )
        return self


class Gearbox(Section):
    """Reduction gear (eq. 3.6, 3.7)."""

    ratio: Positive
    efficiency: Fraction
    drag_Nm: NotNegative = 0.0
    """Torque lost beside the efficiency, at the shaft and the operating point."""
    drag_exponent: NotNegative = 1.0
    """With which power of the speed it grows."""


class Shaft(Section):
    """Moments of inertia, seen from the propeller (eq. 3.12, 3.13)."""

    inertia_kg_m2: Positive
    propeller_side_inertia_kg_m2: Positive
    """Share on the propeller's side of the torque gauge."""
    add_entrained_water: bool = False
    """Whether the water that turns with the propeller is to be added to both; else they contain it."""
    stiffness_Nm_rad: Positive | None = None
    """Between the two inertias; None: rigid."""
    damping_Nms_rad: NotNegative = 0.0

    @model_validator(mode="after")
    def _parts_do_not_exceed_the_whole(self) -> Self:
        if self.propeller_side_inertia_kg_m2 > self.inertia_kg_m2:
            raise unexpected(
                "propeller_side_inertia_kg_m2",
                f"{self.propeller_side_inertia_kg_m2:g}",
                f"at most inertia_kg_m2, {self.inertia_kg_m2:g}",
            )
        return self


class Propeller(Section):
    """Fixed-pitch propeller at zero speed of advance (eq. 3.8-3.11)."""

    diameter_m: Positive
    pitch_ratio: Positive
    area_ratio: Positive
    blades: Annotated[int, Field(ge=2)]
    nozzle: str = ""
    torque_exponent: Annotated[float, Field(gt=0.0, le=4.0)] = 2.0
    """p in M_p proportional to n_s |n_s|^(p-1); eq. 3.8 has 2."""
    thrust_deduction: Annotated[float, BeforeValidator(_no_percentage), Field(ge=0.0, lt=1.0)] = 0.0
    K_T: Positive
    shaft_ripple: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Amplitude of the torque at once a turn of the shaft, over the mean."""
    blade_ripple: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Amplitude of the torque at blade passage, over the mean."""
    four_quadrant: FourQuadrant | None = None
    """None: bollard pull, the torque odd in the speed."""


class Governor(Section):
    """PI or PID governor, gains normalised with the operating point: K = K_abs n_e0 / X_0; K_i in 1/s, K_d in s."""

    K_p: Positive
    K_i: Positive
    K_d: NotNegative = 0.0
    """Of the filtered speed alone: a step of the set point gives no kick."""
    derivative_filter_s: Positive = 0.05
    sample_rate_hz: Positive | None = None
    """How often the governor computes; None: always."""
    once_a_firing: bool = False
    """Whether it computes at each firing instead."""
    computation_delay_s: NotNegative = 0.0
    set_point_dead_time_s: NotNegative = 0.0
    """Of the set point's way to the governor, T_set."""
    minimum_rack_mm: float | None = None
    maximum_rack_mm: Positive | None = None
    anti_windup: bool = False
    """Whether the integral stands still while a limit of the rack or of the torque holds the command."""

    @model_validator(mode="after")
    def _computes_at_one_kind_of_time(self) -> Self:
        if self.once_a_firing and self.sample_rate_hz is not None:
            raise unexpected(
                "sample_rate_hz", f"{self.sample_rate_hz:g}", "nothing beside once_a_firing = true"
            )
        return self


class NominalPoint(Section):
    """A known steady state, and the slopes of the engine map there (eq. 3.24, 3.25)."""

    n_e_rpm: Positive
    X_0_mm: Positive
    M_b_Nm: Positive | None = None
    M_s_Nm: Positive | None = None
    """Give either the brake torque or the shaft torque."""
    v: Positive
    """Relative slope of brake torque over fuel rack at constant speed."""
    g: float
    """Relative slope of brake torque over speed at constant fuel rack."""

    @model_validator(mode="after")
    def _has_one_torque(self) -> Self:
        if (self.M_b_Nm is None) == (self.M_s_Nm is None):
            found = "neither M_b_Nm nor M_s_Nm" if self.M_b_Nm is None else "both M_b_Nm and M_s_Nm"
            raise unexpected("M_b_Nm", found, "one of the two")
        return self


class SetPointLine(Section):
    """What a voltage on the set-point line makes of the engine speed: n_set = rpm_per_V U + rpm_at_0_V (eq. 6.7)."""

    rpm_per_V: float
    rpm_at_0_V: float

    @model_validator(mode="after")
    def _can_be_inverted(self) -> Self:
        if self.rpm_per_V == 0.0:
            raise unexpected("rpm_per_V", "0", "a slope not zero")
        return self

    @property
    def calibration(self) -> Calibration:
        """The line, from volts to rpm."""
        return Calibration(self.rpm_per_V, self.rpm_at_0_V, "rpm")


class Vessel(Section):
    """A ship's drive train from governor to propeller, in bollard pull (eq. 3.1-3.11) unless it has a `ship`.

    What the thesis's plant leaves out (dead times, limits, sampling, firing, a flexible shaft, the ship's own motion) is
    off unless it is configured.

    The propeller's torque coefficient is not configured: it follows from the operating point.

    Examples
    --------
    >>> launch = Vessel.load("stan-launch-804")
    >>> round(launch.torque_coefficient, 3)
    12.181
    >>> heavier = launch.replace({"shaft.inertia_kg_m2": 30.0})
    """

    name: str
    description: str = ""
    water: Water
    engine: Engine
    gearbox: Gearbox
    shaft: Shaft
    propeller: Propeller
    governor: Governor
    operating_point: NominalPoint
    set_point: SetPointLine | None = None
    """None: not known."""
    actuator: Actuator = Actuator()
    ship: Ship | None = None
    """None: held, bollard pull."""

    @model_validator(mode="after")
    def _can_run_at_its_operating_point(self) -> Self:
        self._require_sense()
        point, p = self.operating_point, self.propeller.torque_exponent
        if point.g >= p:
            raise unexpected(
                "operating_point.g", f"{point.g:g}", f"less than the propeller's torque exponent {p:g}"
            )
        speed, limit = self.envelope()
        if limit.size:
            available = float(np.interp(self.nominal_engine_speed, speed, limit))
            if self.nominal_brake_torque >= available:
                raise unexpected(
                    "engine.envelope.torque_Nm",
                    f"{available:.4g} Nm at {point.n_e_rpm:g} rpm",
                    f"more than the operating point's brake torque {self.nominal_brake_torque:.4g} Nm",
                )
        firing, cycle = self.engine.firing, 180.0 * self.engine.strokes
        if firing is None and self.governor.once_a_firing:
            raise unexpected("governor.once_a_firing", "true", "a table engine.firing beside it")
        if firing is not None and firing.stroke_deg > cycle:
            raise unexpected(
                "engine.firing.stroke_deg", f"{firing.stroke_deg:g}", f"at most a working cycle, {cycle:g}"
            )
        if firing is not None and len(firing.strength or ()) not in (0, self.engine.cylinders):
            found = f"{len(firing.strength or ())} values"
            raise unexpected("engine.firing.strength", found, f"{self.engine.cylinders} as engine.cylinders")
        minimum = self.engine.minimum_torque_Nm
        if minimum is not None and minimum >= self.nominal_brake_torque:
            raise unexpected(
                "engine.minimum_torque_Nm",
                f"{minimum:g}",
                f"less than the operating point's brake torque {self.nominal_brake_torque:.4g} Nm",
            )
        return self

    def _require_sense(self) -> None:
        """Refuse sizes that no ship has, and name the slip of unit that makes them."""
        point, engine = self.operating_point, self.engine
        speed = engine.rated_speed_rpm
        rated = engine.rated_power_kW * 30e3 / (math.pi * speed)
        shaft = self.gearbox.ratio * self.gearbox.efficiency
        checks: tuple[tuple[str, float | None, float, float, Sequence[hints.Slip], str, str], ...] = (
            ("water.density_kg_m3", self.water.density_kg_m3, 900.0, 1100.0, hints.DENSITY, "kg/m3", "water"),
            ("engine.rated_speed_rpm", speed, 40.0, 2e4, hints.SPEED_RPM, "rpm", "engines"),
            (
                "propeller.diameter_m",
                self.propeller.diameter_m,
                0.05,
                15.0,
                hints.LENGTH_M,
                "m",
                "propellers",
            ),
            (
                "operating_point.n_e_rpm",
                point.n_e_rpm,
                0.1 * speed,
                1.5 * speed,
                hints.SPEED_RPM,
                "rpm",
                "this engine",
            ),
            (
                "operating_point.M_b_Nm",
                point.M_b_Nm,
                0.004 * rated,
                2.0 * rated,
                hints.TORQUE,
                "Nm",
                "this engine",
            ),
            (
                "operating_point.M_s_Nm",
                point.M_s_Nm,
                0.004 * rated * shaft,
                2.0 * rated * shaft,
                hints.TORQUE,
                "Nm",
                "this engine and gearbox",
            ),
        )
        for key, value, low, high, known, unit, owner in checks:
            if value is not None and (hint := hints.likely(value, low, high, known, unit)):
                raise unexpected(
                    key, f"{value:g} {unit}", f"{low:.4g} to {high:.4g} {unit} as {owner} would have{hint}"
                )

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the names of the built-in ships."""
        return tuple(built_in("vessels"))

    @classmethod
    def load(cls, name_or_path: str | Path) -> Self:
        """Return a built-in ship by name, or read one from a TOML file.

        Raises
        ------
        InputError
            Where there is no such ship or file, or the file's content can't be a ship.
        """
        return read_named(name_or_path, cls, "vessels", "vessel", "ship")

    def replace(self, changes: Mapping[str, Any]) -> Self:
        """Return a ship with some values changed, checked anew.

        Parameters
        ----------
        changes
            Dotted key, as in the TOML file, to the new value: {"shaft.inertia_kg_m2": 30.0}.
        """
        content: dict[str, Any] = self.model_dump()
        for key, value in changes.items():
            *sections, last = key.split(".")
            section: Any = content
            for part in sections:
                section = section.get(part, {})
                if not isinstance(section, dict) or not section:
                    raise InputError(f"vessel {self.name!r}: {key}: found no section {part!r}")
            section[last] = value
        return validated(content, type(self), f"vessel {self.name!r}")

    def __repr__(self) -> str:
        engine = self.engine
        return (
            f"Vessel({self.name!r}, {engine.rated_power_kW:g} kW at {engine.rated_speed_rpm:g} rpm, gear "
            f"{self.gearbox.ratio:g}, propeller {self.propeller.diameter_m:g} m)"
        )

    def _repr_html_(self) -> str:
        rows = []
        for section, content in self.model_dump().items():
            if isinstance(content, dict):
                rows += [
                    [f"{section}.{key}", str(value)] for key, value in content.items() if value is not None
                ]
        return shown(f"Vessel {self.name}", ["key", "value"], rows, [self.description])

    @property
    def nominal_engine_speed(self) -> float:
        """Engine speed n_e0 at the operating point [rev/s]."""
        return self.operating_point.n_e_rpm / 60.0

    @property
    def nominal_shaft_speed(self) -> float:
        """Shaft speed n_s0 at the operating point [rev/s] (eq. 3.7)."""
        return self.nominal_engine_speed / self.gearbox.ratio

    @property
    def nominal_brake_torque(self) -> float:
        """Brake torque M_b0 at the operating point [Nm] (eq. 3.6)."""
        point = self.operating_point
        if point.M_b_Nm is not None:
            return point.M_b_Nm
        assert point.M_s_Nm is not None
        return (point.M_s_Nm + self.gearbox.drag_Nm) / (self.gearbox.ratio * self.gearbox.efficiency)

    @property
    def inertia(self) -> float:
        """Moment of inertia of all that turns, seen from the propeller [kg m2] (eq. 3.12, 3.13)."""
        return self.shaft.inertia_kg_m2 + self._added_water()

    @property
    def propeller_side_inertia(self) -> float:
        """Share of it on the propeller's side of the torque gauge [kg m2]."""
        return self.shaft.propeller_side_inertia_kg_m2 + self._added_water()

    def _added_water(self) -> float:
        return self.entrained_water_inertia() if self.shaft.add_entrained_water else 0.0

    @property
    def firing_interval(self) -> float:
        """Turns of the crankshaft between two firings [rev]."""
        return self.engine.strokes / 2.0 / self.engine.cylinders

    def drag_torque(self, n_s: float) -> float:
        """Return the torque lost at a shaft speed [rev/s] beside the gearbox's efficiency [Nm]."""
        return float(self.gearbox.drag_Nm * (n_s / self.nominal_shaft_speed) ** self.gearbox.drag_exponent)

    @property
    def nominal_propeller_torque(self) -> float:
        """Propeller torque at the operating point [Nm]: the brake torque's share at the shaft, less the drag."""
        shaft_torque = self.nominal_brake_torque * self.gearbox.ratio * self.gearbox.efficiency
        return float(shaft_torque - self.gearbox.drag_Nm)

    @property
    def torque_coefficient(self) -> float:
        """Propeller torque over n_s^p [Nm/(rev/s)^p], from the balance at the operating point."""
        return float(self.nominal_propeller_torque / self.nominal_shaft_speed**self.propeller.torque_exponent)

    @property
    def K_Q_over_eta_r(self) -> float:
        """Torque coefficient over relative rotative efficiency at the operating point [-] (eq. 3.8, 3.10)."""
        excess = self.nominal_shaft_speed ** (self.propeller.torque_exponent - 2.0)
        return float(
            self.torque_coefficient * excess / (self.water.density_kg_m3 * self.propeller.diameter_m**5)
        )

    def entrained_water_inertia(self) -> float:
        """Return the inertia of the water that turns with the propeller [kg m2].

        J = 0.0703 (P/D)^2 (A_E/A_0)^2 rho D^5 / (pi Z): H. Schwanecke, "Gedanken zur Frage der hydrodynamisch
        erregten Schwingungen des Propellers und der Wellenleitung", Jahrbuch der STG 57, 1963.
        """
        propeller = self.propeller
        return (
            0.0703
            * (propeller.pitch_ratio * propeller.area_ratio) ** 2
            * self.water.density_kg_m3
            * propeller.diameter_m**5
            / (math.pi * propeller.blades)
        )

    def loop_delay(self, n_e: float) -> float:
        """Return the mean delay from speed to brake torque at an engine speed [rev/s], T_d of slow motions [s].

        A sampled command is held for half a period in the mean (Astrom, Wittenmark, "Computer-Controlled Systems",
        1997, section 1.4); a firing gives its torque half a stroke after it was fuelled. A command that is computed
        once a firing waits for the next only where it is late for its own.
        """
        governor, actuator, firing = self.governor, self.actuator, self.engine.firing
        delay = actuator.dead_time_s + governor.computation_delay_s + actuator.lag_s
        if governor.sample_rate_hz is not None:
            delay += 0.5 / governor.sample_rate_hz
        if firing is not None:
            late = governor.once_a_firing and delay > 0.0
            delay += 0.5 * (firing.stroke_deg / 360.0 + (self.firing_interval if late else 0.0)) / n_e
        return delay

    def envelope(self) -> tuple[Array, Array]:
        """Return engine speed [rev/s] and highest brake torque [Nm], shape (K,); empty where unlimited."""
        table = self.engine.envelope
        if table is None:
            return np.empty(0), np.empty(0)
        return np.array(table.speed_rpm) / 60.0, np.array(table.torque_Nm)

    def plant_parameters(self) -> Array:
        """Return the nonlinear plant's parameters in the order of `_core.PLANT_PARAMETERS`, shape (12,).

        The engine map (eq. 3.5) is the plane through the operating point with the relative slopes v and g.
        """
        point, torque, speed = self.operating_point, self.nominal_brake_torque, self.nominal_engine_speed
        absolute_gain = point.X_0_mm / speed
        minimum = self.engine.minimum_torque_Nm
        return np.array(
            [
                self.inertia,
                self.gearbox.ratio,
                self.gearbox.efficiency,
                point.v * torque / point.X_0_mm,
                point.g * torque / speed,
                (1.0 - point.v - point.g) * torque,
                self.torque_coefficient,
                self.propeller.torque_exponent,
                point.X_0_mm,
                self.governor.K_p * absolute_gain,
                self.governor.K_i * absolute_gain,
                -np.inf if minimum is None else minimum,
            ]
        )
