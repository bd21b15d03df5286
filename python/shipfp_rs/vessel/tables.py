"""Tables of a vessel file for what the thesis's plant leaves out; each is off unless it is there."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from shipfp_rs.support.toml import Section, unexpected

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Numbers = Annotated[tuple[float, ...], Field(strict=False)]


class Firing(Section):
    """Torque of single cylinders, equally spaced: a raised cosine over each working stroke."""

    stroke_deg: Positive = 180.0
    """Angle of the crankshaft over which a firing gives its torque."""
    strength: Numbers | None = None
    """Each cylinder's torque over the mean of all, in the order of firing; None: all alike."""


class Actuator(Section):
    """Way of the governor's command to the fuel rack."""

    dead_time_s: NotNegative = 0.0
    lag_s: NotNegative = 0.0
    """Time constant of the first order."""
    rate_mm_s: Positive | None = None
    """How fast the rack can move; None: at once."""


class FourQuadrant(Section):
    """Torque and thrust coefficients C_Q*, C_T* over the angle of the flow at 0.7 of the radius, straight between.

    The angle is atan2(V_a, 0.7 pi n D), so that ahead in bollard pull is at 0 and astern at 180 degrees. Only ratios
    to the values at `bollard_deg` act: the scale comes from the operating point and from K_T.
    """

    angle_deg: Annotated[Numbers, Field(min_length=2)]
    """Ascending within one turn, which closes on itself."""
    C_Q: Numbers
    C_T: Numbers
    bollard_deg: float = 0.0
    """Where the ship's operating point lies; 180 for a trial astern, whose speeds count positive astern."""

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
    """Motion of the ship under the thrust of its propellers, the resistance with the square of its speed."""

    mass_kg: Positive
    """With the water that moves along."""
    resistance_N_s2_m2: Positive
    propellers: Annotated[int, Field(ge=1)] = 1
    wake_fraction: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
