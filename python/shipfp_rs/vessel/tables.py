"""Tables of a vessel file, with plausible ranges of their values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, NamedTuple, Self, get_args

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from shipfp_rs.errors import InputError
from shipfp_rs.support import hints
from shipfp_rs.support.toml import Section, unexpected
from shipfp_rs.support.units import Calibration


class Size(NamedTuple):
    """Plausible range of a number in a vessel file, and units in which it is often given by mistake."""

    key: str
    low: float
    high: float
    slips: Sequence[hints.Slip]
    unit: str
    owner: str

    def require(self, value: float) -> None:
        """Raise an error for a value that is probably in a wrong unit, or more than a factor of ten outside its range."""
        hint = hints.likely(value, self.low, self.high, self.slips, self.unit)
        if hint or not 0.1 * self.low < value < 10.0 * self.high:
            expected = f"{self.low:.4g} to {self.high:.4g} {self.unit} as {self.owner} would have{hint}"
            raise unexpected(self.key, f"{value:g} {self.unit}", expected)


Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Wait = Annotated[float, Field(ge=0.0, le=60.0)]
"""Dead time or lag of a governor or actuator [s]."""
Numbers = Annotated[tuple[float, ...], Field(strict=False)]


def _no_percentage(value: object) -> object:
    if isinstance(value, int | float) and 2.0 <= value <= 100.0:
        share = f"{value / 100.0:g}"
        raise PydanticCustomError(
            "percent", "a fraction of at most 1; percent? that is {share}", {"share": share}
        )
    return value


Fraction = Annotated[float, BeforeValidator(_no_percentage), Field(ge=0.1, le=1.0)]
# A TOML array is read as a list, which is converted to a tuple; the numbers in it are not converted.
Table = Annotated[tuple[Positive, ...], Field(strict=False, min_length=2)]


class Firing(Section):
    """Torque pulses of the cylinders: a raised cosine over each working stroke, at equal intervals."""

    stroke_deg: Annotated[float, Field(ge=1.0)] = 180.0
    """Crankshaft angle during which a firing produces torque [deg]."""
    strength: Numbers | None = None
    """Each cylinder's torque relative to the mean, in the order of firing; None: all equal."""


class Actuator(Section):
    """Actuator, which moves the fuel rack to the governor's command."""

    dead_time_s: Wait = 0.0
    """Dead time between command and rack [s]."""
    lag_s: Wait = 0.0
    """Time constant of a first-order lag [s]."""
    rate_mm_s: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
    """Highest speed of the rack [mm/s]; None: no limit."""


class FourQuadrant(Section):
    """Torque and thrust coefficients C_Q*, C_T* over the flow angle at 0.7 of the radius, linear between the angles.

    The angle is atan2(V_a, 0.7 pi n D), which is 0 degrees ahead in bollard pull and 180 degrees astern. Only ratios to
    the values at `bollard_deg` are used; the absolute values follow from the operating point and K_T.
    """

    angle_deg: Annotated[Numbers, Field(min_length=2)]
    """Angles of the flow [deg], ascending, within one turn; the curve is periodic."""
    C_Q: Numbers
    """Torque coefficient at each angle."""
    C_T: Numbers
    """Thrust coefficient at each angle."""
    bollard_deg: float = 0.0
    """Flow angle at the ship's operating point [deg]. It is 180 for a trial astern, where speeds astern are positive."""

    @model_validator(mode="after")
    def _is_a_function_of_the_angle(self) -> Self:
        for name, row in (("C_Q", self.C_Q), ("C_T", self.C_T)):
            if len(row) != len(self.angle_deg):
                raise unexpected(name, f"{len(row)} values", f"{len(self.angle_deg)} as in angle_deg")
        for lower, upper in zip(self.angle_deg, self.angle_deg[1:], strict=False):
            if upper <= lower:
                raise unexpected("angle_deg", f"{upper:g} after {lower:g}", "ascending angles")
        if self.angle_deg[-1] - self.angle_deg[0] >= 360.0:
            raise unexpected("angle_deg", f"{self.angle_deg[-1]:g} at the end", "less than one turn in all")
        return self


class Ship(Section):
    """Motion of the ship under the thrust of its propellers, with a resistance proportional to the square of its speed."""

    mass_kg: Annotated[float, Field(ge=1.0, le=1e10)]
    """Mass of the ship, including the hydrodynamic added mass [kg]."""
    resistance_N_s2_m2: Annotated[float, Field(ge=1e-9, le=1e9)]
    """Resistance divided by the square of the ship's speed [N s2/m2]."""
    propellers: Annotated[int, Field(ge=1, le=20)] = 1
    """Number of equal propellers that push the ship."""
    wake_fraction: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Wake fraction w: the speed of the water at the propeller is 1 - w times the ship's speed."""


def later() -> Any:
    """Return the default of a key that may be omitted; only functions that use the key require it."""
    return Field(default=None)


class Sparse(Section):
    """Table whose keys may be omitted; a function that needs a missing key names it in an error."""

    table: ClassVar[str] = ""

    @model_validator(mode="after")
    def _drop_what_is_not_given(self) -> Self:
        for name in type(self).model_fields.keys() - self.model_fields_set:
            if self.__dict__.get(name, 0) is None and name in self._needed():
                del self.__dict__[name]
        return self

    @classmethod
    def _needed(cls) -> set[str]:
        """Keys that a vessel file may omit, but that can't have the value None."""
        return {
            name
            for name, field in cls.model_fields.items()
            if field.default is None and type(None) not in get_args(field.annotation)
        }

    def __getattr__(self, name: str) -> Any:
        if name in type(self).model_fields:
            key = f"{self.table}.{name}" if self.table else name
            raise InputError(
                f"vessel file: {key}: found nothing, but this function needs a value; add the key"
            )
        return super().__getattr__(name)  # type: ignore[misc]

    def given(self, *keys: str) -> bool:
        """Whether all given keys, such as "propeller.blades", have values."""
        for key in keys:
            content: Any = self
            for part in key.split("."):
                if part not in content.__dict__ or content.__dict__[part] is None:
                    return False
                content = content.__dict__[part]
        return True


class Water(Sparse):
    """The water in which the propeller works."""

    table: ClassVar[str] = "water"

    density_kg_m3: Positive = later()
    """Density of the water [kg/m3]."""


class Envelope(Section):
    """Highest brake torque over engine speed, linear between the points and constant beyond them (Fig. 3.3)."""

    speed_rpm: Table
    """Engine speeds [rpm], ascending."""
    torque_Nm: Table
    """Highest brake torque at each speed [Nm]."""

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


class Engine(Sparse):
    """Diesel engine: rating, torque limits, and what determines its torque ripple (cylinders, strokes, firing)."""

    table: ClassVar[str] = "engine"

    model: str = later()
    """Maker and type."""
    cylinders: Annotated[int, Field(ge=1, le=100)] = later()
    """Number of cylinders."""
    strokes: Annotated[int, Field(ge=2, le=4, multiple_of=2)] = later()
    """Strokes of a working cycle, 2 or 4."""
    rated_power_kW: Positive = later()
    """Rated power [kW]."""
    rated_speed_rpm: Positive = later()
    """Speed at the rated power [rpm]."""
    envelope: Envelope | None = None
    """None: no limit."""
    minimum_torque_Nm: float | None = None
    """Lowest brake torque [Nm], negative if the engine can be driven by the shaft; None: no lower limit."""
    torque_rate_Nm_s: Annotated[float, Field(ge=1e-3, le=1e12)] | None = None
    """Highest rate of the brake torque [Nm/s]; None: no limit."""
    smoke_margin_mm: Annotated[float, Field(ge=1e-6, le=1e6)] | None = None
    """Rack [mm] that the smoke limiter allows above the rack that matches the charge air; None: no smoke limiter."""
    turbocharger_lag_s: Annotated[float, Field(ge=1e-3, le=600.0)] = 1.0
    """Time constant with which the charge air follows the rack [s]; used only with a smoke limiter."""
    firing: Firing | None = None
    """Torque pulses of the cylinders; None: a torque without pulses."""

    @model_validator(mode="after")
    def _stays_within_its_rating(self) -> Self:
        if self.envelope is None or not self.given("rated_power_kW"):
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


class Gearbox(Sparse):
    """Reduction gear (eq. 3.6, 3.7)."""

    table: ClassVar[str] = "gearbox"

    ratio: Annotated[float, Field(ge=0.01, le=1000.0)]
    """Turns of the engine per turn of the shaft; below 1 for a step-up gear."""
    efficiency: Fraction = later()
    """Shaft power divided by brake power, without the loss by `drag_Nm`."""
    drag_Nm: NotNegative = 0.0
    """Torque lost at the shaft at the operating point, in addition to the loss by `efficiency` [Nm]."""
    drag_exponent: Annotated[float, Field(ge=0.0, le=4.0)] = 1.0
    """Exponent e of the drag, which is proportional to n_s^e."""


class Shaft(Sparse):
    """Moments of inertia, seen from the propeller (eq. 3.12, 3.13)."""

    table: ClassVar[str] = "shaft"

    inertia_kg_m2: Positive = later()
    """Moment of inertia of all rotating parts [kg m2]."""
    propeller_side_inertia_kg_m2: Positive = later()
    """Part of the inertia on the propeller's side of the torque gauge [kg m2]."""
    add_entrained_water: bool = False
    """Whether to add the inertia of the water entrained by the propeller to both inertias; if false, they include it."""
    stiffness_Nm_rad: Annotated[float, Field(ge=1e-3)] | None = None
    """Torsional stiffness between the two inertias [Nm/rad]; None: rigid."""
    damping_Nms_rad: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    """Torsional damping between the two inertias [Nm s/rad]."""

    @model_validator(mode="after")
    def _parts_do_not_exceed_the_whole(self) -> Self:
        if self.given("propeller_side_inertia_kg_m2", "inertia_kg_m2") and (
            self.propeller_side_inertia_kg_m2 > self.inertia_kg_m2
        ):
            raise unexpected(
                "propeller_side_inertia_kg_m2",
                f"{self.propeller_side_inertia_kg_m2:g}",
                f"at most inertia_kg_m2, {self.inertia_kg_m2:g}",
            )
        return self


class Propeller(Sparse):
    """Fixed-pitch propeller at zero speed of advance (eq. 3.8-3.11)."""

    table: ClassVar[str] = "propeller"

    diameter_m: Positive = later()
    """Diameter [m]."""
    pitch_ratio: Annotated[float, Field(ge=0.01, le=10.0)] = later()
    """Pitch over diameter."""
    area_ratio: Annotated[float, Field(ge=0.01, le=10.0)] = later()
    """Expanded blade area divided by the disc area."""
    blades: Annotated[int, Field(ge=2, le=20)] = later()
    """Number of blades."""
    nozzle: str = ""
    """Type of nozzle; empty: none."""
    torque_exponent: Annotated[float, Field(gt=0.0, le=4.0)] = 2.0
    """Exponent p of the propeller's torque, M_p proportional to n_s |n_s|^(p-1); 2 in eq. 3.8."""
    thrust_deduction: Annotated[float, BeforeValidator(_no_percentage), Field(ge=0.0, lt=1.0)] = 0.0
    """Thrust deduction fraction t: the share of the thrust that is lost to added resistance of the hull."""
    K_T: Annotated[float, Field(ge=1e-4, le=10.0)] = later()
    """Thrust coefficient at zero speed of advance."""
    shaft_ripple: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Amplitude of the torque at the shaft's rotation frequency, relative to the mean."""
    blade_ripple: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Amplitude of the torque at the blade passage frequency, relative to the mean."""
    four_quadrant: FourQuadrant | None = None
    """Four-quadrant diagram; None: bollard pull, with a torque that is an odd function of the speed."""


class Governor(Sparse):
    """PI or PID governor, whose gains are normalised with the operating point: K = K_abs n_e0 / X_0."""

    table: ClassVar[str] = "governor"

    K_p: Annotated[float, Field(ge=1e-4, le=1e4)] = later()
    """Proportional gain."""
    K_i: Annotated[float, Field(ge=1e-5, le=1e5)] = later()
    """Integral gain [1/s]."""
    K_d: Annotated[float, Field(ge=0.0, le=1e4)] = 0.0
    """Derivative gain [s]. It acts on the filtered speed and not on the set point, so a step causes no peak."""
    droop: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Fall of the set point, relative to the operating speed, while the fuel's torque rises by the operating torque."""
    derivative_filter_s: Annotated[float, Field(ge=1e-6, le=60.0)] = 0.05
    """Time constant of the derivative's filter [s]."""
    sample_rate_hz: Annotated[float, Field(ge=0.1, le=1e5)] | None = None
    """Rate at which the governor computes [Hz]; None: continuously."""
    once_a_firing: bool = False
    """Whether the governor computes at each firing instead of at a fixed rate."""
    computation_delay_s: Wait = 0.0
    """Time from a sample of the speed to the resulting command [s]."""
    set_point_dead_time_s: Wait = 0.0
    """Dead time of the set point on its way to the governor, T_set [s]."""
    minimum_rack_mm: float | None = None
    """Lowest rack that the governor commands [mm]; None: no limit."""
    maximum_rack_mm: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    """Highest rack that the governor commands [mm]; None: no limit."""
    anti_windup: bool = False
    """Whether the integral is held while a limit of rack or torque acts."""

    @model_validator(mode="after")
    def _computes_at_one_kind_of_time(self) -> Self:
        if self.once_a_firing and self.sample_rate_hz is not None:
            raise unexpected(
                "sample_rate_hz", f"{self.sample_rate_hz:g}", "nothing beside once_a_firing = true"
            )
        return self


class NominalPoint(Sparse):
    """A known steady state, and the slopes of the engine map at it (eq. 3.24, 3.25)."""

    table: ClassVar[str] = "operating_point"

    n_e_rpm: Positive = later()
    """Engine speed [rpm]."""
    X_0_mm: Annotated[float, Field(ge=1e-3, le=1e5)] = later()
    """Fuel rack [mm]."""
    M_b_Nm: Positive | None = None
    """Brake torque [Nm]."""
    M_s_Nm: Positive | None = None
    """Shaft torque [Nm]. Give either this or the brake torque."""
    v: Annotated[float, Field(ge=0.01, le=100.0)] = later()
    """Relative slope of brake torque over fuel rack at constant speed: d ln(M_b) / d ln(X)."""
    g: float = later()
    """Relative slope of brake torque over speed at constant fuel rack: d ln(M_b) / d ln(n_e)."""

    @model_validator(mode="after")
    def _has_one_torque(self) -> Self:
        if self.M_b_Nm is not None and self.M_s_Nm is not None:
            raise unexpected("M_b_Nm", "both M_b_Nm and M_s_Nm", "one of the two")
        return self


class SetPointLine(Section):
    """Engine-speed set point as a function of its voltage: n_set = rpm_per_V U + rpm_at_0_V (eq. 6.7)."""

    rpm_per_V: float
    """Slope of the line [rpm/V]."""
    rpm_at_0_V: float
    """Set point at 0 V [rpm]."""

    @model_validator(mode="after")
    def _can_be_inverted(self) -> Self:
        if self.rpm_per_V == 0.0:
            raise unexpected("rpm_per_V", "0", "a slope not zero")
        return self

    @property
    def calibration(self) -> Calibration:
        """The calibration from volts to rpm."""
        return Calibration(self.rpm_per_V, self.rpm_at_0_V, "rpm")
