"""Vessels: configurations of ships' drive trains, built in or from TOML files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import model_validator

from shipfp_rs.errors import InputError
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.tables import shown
from shipfp_rs.support.toml import Name, built_in, read_named, unexpected, validated
from shipfp_rs.vessel.tables import (
    Actuator,
    Engine,
    Gearbox,
    Governor,
    NominalPoint,
    Propeller,
    SetPointLine,
    Shaft,
    Ship,
    Size,
    Sparse,
    Water,
    later,
)

PLANT_KEYS = (
    "gearbox.efficiency",
    "shaft.inertia_kg_m2",
    "governor.K_p",
    "governor.K_i",
    "operating_point.n_e_rpm",
    "operating_point.X_0_mm",
    "operating_point.v",
    "operating_point.g",
    "engine",
    "propeller",
)
"""Keys required to simulate the plant; to process a log, the gear ratio suffices."""


class Vessel(Sparse):
    """A ship's drive train from governor to propeller, in bollard pull (eq. 3.1-3.11) unless it has a `ship`.

    Elements beyond the thesis's plant (dead times, limits, sampling, firing, a flexible shaft, the ship's motion) are off
    unless configured.

    To process a log, the gear ratio suffices. An error names any other key that is needed but missing.
    The propeller's torque coefficient follows from the operating point and is not a key.

    Examples
    --------
    >>> launch = Vessel.load("stan-launch-804")
    >>> round(launch.torque_coefficient, 3)
    12.181
    >>> heavier = launch.replace({"shaft.inertia_kg_m2": 30.0})
    """

    name: Name
    """Name of the ship in reports."""
    description: str = ""
    """Short description of the ship."""
    water: Water = later()
    engine: Engine = later()
    gearbox: Gearbox
    shaft: Shaft = later()
    propeller: Propeller = later()
    governor: Governor = later()
    operating_point: NominalPoint = later()
    set_point: SetPointLine | None = None
    """None: not known."""
    actuator: Actuator = Actuator()
    ship: Ship | None = None
    """None: held, bollard pull."""

    @model_validator(mode="after")
    def _can_run_at_its_operating_point(self) -> Self:
        self._require_sense()
        self._require_firing()
        if not self.given(*PLANT_KEYS) or not (
            self.given("operating_point.M_b_Nm") or self.given("operating_point.M_s_Nm")
        ):
            return self
        point, p = self.operating_point, self.propeller.torque_exponent
        if point.g >= p:
            raise unexpected(
                "operating_point.g", f"{point.g:g}", f"less than the propeller's torque exponent {p:g}"
            )
        self._require_run_up()
        speed, limit = self.envelope()
        if limit.size:
            available = float(np.interp(self.nominal_engine_speed, speed, limit))
            if self.nominal_brake_torque >= available:
                raise unexpected(
                    "engine.envelope.torque_Nm",
                    f"{available:.4g} Nm at {point.n_e_rpm:g} rpm",
                    f"more than the operating point's brake torque {self.nominal_brake_torque:.4g} Nm",
                )
        minimum = self.engine.minimum_torque_Nm
        if minimum is not None and minimum >= self.nominal_brake_torque:
            raise unexpected(
                "engine.minimum_torque_Nm",
                f"{minimum:g}",
                f"less than the operating point's brake torque {self.nominal_brake_torque:.4g} Nm",
            )
        return self

    def _require_run_up(self) -> None:
        shaft_torque = self.nominal_brake_torque * self.torque_ratio
        inertia = self.shaft.inertia_kg_m2
        tau_n = 2.0 * math.pi * inertia * self.nominal_shaft_speed / shaft_torque
        if not 1e-3 <= tau_n <= 1e3:
            found = f"{inertia:g}, with which the shaft would run up in {tau_n:.3g} s"
            raise unexpected("shaft.inertia_kg_m2", found, "0.001 to 1000 s")

    def _require_firing(self) -> None:
        """Raise an error if `engine.firing` does not match strokes, cylinders or governor."""
        if not self.given("engine"):
            return
        governed = self.given("governor") and self.governor.once_a_firing
        if self.engine.firing is None:
            if governed:
                raise unexpected("governor.once_a_firing", "true", "a table engine.firing beside it")
            return
        firing, cycle = self.engine.firing, 180.0 * self.engine.strokes
        if firing is not None and firing.stroke_deg > cycle:
            raise unexpected(
                "engine.firing.stroke_deg", f"{firing.stroke_deg:g}", f"at most a working cycle, {cycle:g}"
            )
        if firing is not None and len(firing.strength or ()) not in (0, self.engine.cylinders):
            found = f"{len(firing.strength or ())} values"
            raise unexpected("engine.firing.strength", found, f"{self.engine.cylinders} as engine.cylinders")

    def _require_sense(self) -> None:
        """Raise an error for an implausible value; it names a wrong unit as the possible cause."""

        def known(key: str) -> float | None:
            value: Any = self
            for part in key.split("."):
                if not self.given(key):
                    return None
                value = getattr(value, part)
            return float(value)

        speed, power = known("engine.rated_speed_rpm"), known("engine.rated_power_kW")
        # Without a rating, the engine's values can't be checked.
        rated = power * 30e3 / (math.pi * speed) if power and speed else math.nan
        shaft = self.torque_ratio
        checks = (
            Size("water.density_kg_m3", 900.0, 1100.0, hints.DENSITY, "kg/m3", "water"),
            Size("engine.rated_speed_rpm", 40.0, 2e4, hints.SPEED_RPM, "rpm", "engines"),
            Size("propeller.diameter_m", 0.05, 15.0, hints.LENGTH_M, "m", "propellers"),
            Size(
                "operating_point.n_e_rpm",
                0.1 * speed if speed else 1.0,
                1.5 * speed if speed else 3e4,
                hints.SPEED_RPM,
                "rpm",
                "this engine",
            ),
            Size("operating_point.M_b_Nm", 0.004 * rated, 2.0 * rated, hints.TORQUE, "Nm", "this engine"),
            Size(
                "operating_point.M_s_Nm",
                0.004 * rated * shaft,
                2.0 * rated * shaft,
                hints.TORQUE,
                "Nm",
                "this engine and gearbox",
            ),
        )
        for size in checks:
            value = known(size.key)
            if value is not None and not math.isnan(size.low):
                size.require(value)

    def require(self, *keys: str) -> None:
        """Raise an error for a ship that lacks any of the dotted keys, such as "propeller.blades".

        Raises
        ------
        InputError
            If keys are missing; the message lists them all.
        """
        lacking = [key for key in keys if not self.given(key)]
        if lacking:
            raise InputError(
                f"vessel {self.name!r}: lacks {', '.join(lacking)}, which are needed here; add them to its file"
            )

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the names of the built-in ships."""
        return tuple(built_in("vessels"))

    @classmethod
    @checked
    def load(cls, name_or_path: str | Path) -> Self:
        """Return a built-in ship by name, or read one from a TOML file.

        Raises
        ------
        InputError
            If there is no such ship or file, or its content is not valid.
        """
        return read_named(name_or_path, cls, "vessels", "vessel", "ship")

    @checked
    def replace(self, changes: Mapping[str, Any]) -> Self:
        """Return a ship with changed values, validated again.

        Parameters
        ----------
        changes
            Dotted key, as in the TOML file, to the new value: {"shaft.inertia_kg_m2": 30.0}.

        Raises
        ------
        InputError
            For an unknown key, or an invalid value.
        """
        content: dict[str, Any] = self.model_dump()
        for key, value in changes.items():
            *sections, last = key.split(".")
            section: Any = content
            for part in sections:
                if section.get(part) is None and (section is not content or part in type(self).model_fields):
                    section[part] = {}  # the file does not have this table
                section = section.get(part)
                if not isinstance(section, dict):
                    near = hints.nearest(part, list(type(self).model_fields))
                    raise InputError(f"vessel {self.name!r}: {key}: found no section {part!r}{near}")
            section[last] = value
        return validated(content, type(self), f"vessel {self.name!r}")

    def __repr__(self) -> str:
        told = [f"gear {self.gearbox.ratio:g}"]
        if self.given("engine.rated_power_kW", "engine.rated_speed_rpm"):
            told.insert(0, f"{self.engine.rated_power_kW:g} kW at {self.engine.rated_speed_rpm:g} rpm")
        if self.given("propeller.diameter_m"):
            told.append(f"propeller {self.propeller.diameter_m:g} m")
        return f"Vessel({self.name!r}, {', '.join(told)})"

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
        """Brake torque M_b0 at the operating point [Nm] (eq. 3.6).

        Raises
        ------
        InputError
            If the operating point has neither M_b_Nm nor M_s_Nm.
        """
        point = self.operating_point
        if point.M_b_Nm is not None:
            return point.M_b_Nm
        if point.M_s_Nm is None:
            raise InputError(
                f"vessel {self.name!r}: operating_point.M_b_Nm: found nothing, expected M_b_Nm or M_s_Nm; add one of them"
            )
        return (point.M_s_Nm + self.gearbox.drag_Nm) / self.torque_ratio

    @property
    def torque_ratio(self) -> float:
        """Shaft torque divided by brake torque; if the efficiency is not given, the gearbox has no losses."""
        return self.gearbox.ratio * (self.gearbox.efficiency if self.given("gearbox.efficiency") else 1.0)

    @property
    def inertia(self) -> float:
        """Moment of inertia of all rotating masses, referred to the propeller [kg m2] (eq. 3.12, 3.13)."""
        return self.shaft.inertia_kg_m2 + self._added_water()

    @property
    def propeller_side_inertia(self) -> float:
        """Share of `inertia` on the propeller's side of the torque gauge [kg m2]."""
        return self.shaft.propeller_side_inertia_kg_m2 + self._added_water()

    def _added_water(self) -> float:
        return self.entrained_water_inertia() if self.shaft.add_entrained_water else 0.0

    @property
    def firing_interval(self) -> float:
        """Crankshaft angle between two firings [rev]."""
        return self.engine.strokes / 2.0 / self.engine.cylinders

    def drag_torque(self, n_s: float) -> float:
        """Return the torque [Nm] lost at a shaft speed [rev/s], in addition to the loss by the gearbox's efficiency."""
        return float(self.gearbox.drag_Nm * (n_s / self.nominal_shaft_speed) ** self.gearbox.drag_exponent)

    @property
    def nominal_propeller_torque(self) -> float:
        """Propeller torque at the operating point [Nm]: the brake torque, referred to the shaft, minus the drag."""
        shaft_torque = self.nominal_brake_torque * self.gearbox.ratio * self.gearbox.efficiency
        return float(shaft_torque - self.gearbox.drag_Nm)

    @property
    def torque_coefficient(self) -> float:
        """Propeller torque divided by n_s^p [Nm/(rev/s)^p], from the torque balance at the operating point."""
        return float(self.nominal_propeller_torque / self.nominal_shaft_speed**self.propeller.torque_exponent)

    @property
    def K_Q_over_eta_r(self) -> float:
        """Torque coefficient divided by relative rotative efficiency at the operating point [-] (eq. 3.8, 3.10)."""
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
        """Return the mean delay [s] from speed to brake torque at an engine speed [rev/s], which is T_d for slow motions.

        A sampled command is held for half a period on average (Astrom, Wittenmark, "Computer-Controlled Systems", 1997,
        section 1.4). The torque of a firing is centred half a stroke after its fuel. A command computed at a firing acts
        at this firing, or at the next one if it is delayed.
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
        """Return the torque limit, engine speed [rev/s] and highest brake torque [Nm], each (K,); empty without a limit."""
        table = self.engine.envelope
        if table is None:
            return np.empty(0), np.empty(0)
        return np.array(table.speed_rpm) / 60.0, np.array(table.torque_Nm)

    def plant_parameters(self) -> Array:
        """Return the nonlinear plant's parameters in the order of `drive_train.PLANT_PARAMETERS`, shape (12,).

        The engine map (eq. 3.5) is the plane through the operating point with the relative slopes v and g.
        """
        self.require(*PLANT_KEYS)
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
