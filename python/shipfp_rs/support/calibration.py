"""Conversion of recorded volts to speed set points and torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import check_fields, checked
from shipfp_rs.support.arrays import Array, unmasked
from shipfp_rs.support.checks import positive


@dataclass(frozen=True)
class Calibration:
    """Linear calibration, value = scale * recorded + offset.

    Parameters
    ----------
    scale
        Unit of the value per unit recorded, for example rpm/V; not zero.
    offset
        Value at a recorded zero.
    unit
        Unit of the value.
    covariance
        Covariance of (scale, offset), shape (2, 2), if the line was fitted to more than two points.

    Examples
    --------
    >>> set_point = Calibration(-251.38, -85.29, "rpm")  # eq. 6.7
    >>> round(float(set_point(-5.0)), 2)
    1171.61
    """

    scale: float
    offset: float = 0.0
    unit: str = ""
    covariance: tuple[tuple[float, float], tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        check_fields(self, "calibration")
        if not (np.isfinite(self.scale) and np.isfinite(self.offset) and self.scale != 0.0):
            raise InputError(
                f"calibration: scale {self.scale}, offset {self.offset}; expected finite ones, scale not 0"
            )

    def __call__(self, recorded: npt.ArrayLike) -> Array:
        """Calibrated values of recorded samples, same shape."""
        return unmasked(recorded) * self.scale + self.offset

    def inverse(self, value: npt.ArrayLike) -> Array:
        """Recorded values for calibrated ones, same shape."""
        return (unmasked(value) - self.offset) / self.scale

    def standard_error(self, recorded: npt.ArrayLike) -> Array:
        """Standard error of the line at recorded samples, same shape; NaN without a covariance."""
        x = np.asarray(recorded, dtype=np.float64)
        if self.covariance is None:
            return np.full(x.shape, np.nan)
        (scale, both), (_, offset) = self.covariance
        # Where the line is exact, rounding may make the variance negative.
        return np.sqrt(np.maximum(scale * x**2 + 2.0 * both * x + offset, 0.0))

    @classmethod
    @checked
    def from_table(cls, recorded: npt.ArrayLike, values: npt.ArrayLike, unit: str = "") -> Calibration:
        """Fit the line to a table by least squares.

        Parameters
        ----------
        recorded, values
            Steady readings and their true values, shape (K,), K at least 2.
        unit
            Unit of the values.

        Raises
        ------
        InputError
            If the table is shorter or not finite, or all readings are equal.

        Notes
        -----
        Table 6.11 of the thesis gives -251.57 rpm/V and -85.69 rpm; eq. 6.7 prints -251.38 and -85.29.
        """
        x, y = np.asarray(recorded, dtype=np.float64), np.asarray(values, dtype=np.float64)
        if x.ndim != 1 or x.shape != y.shape or len(x) < 2:
            raise InputError(
                f"calibration table: shapes {x.shape} and {y.shape}, expected two columns of two rows or more"
            )
        if not (np.isfinite(x).all() and np.isfinite(y).all()) or np.ptp(x) == 0.0:
            raise InputError("calibration table: expected finite numbers and at least two different readings")
        middle = x.mean()
        spread = float(((x - middle) ** 2).sum())
        scale = float(((x - middle) * y).sum()) / spread
        offset = float(y.mean() - scale * middle)
        if len(x) == 2:
            return cls(scale, offset, unit)
        variance = float(((y - scale * x - offset) ** 2).sum()) / (len(x) - 2)
        of_scale, both = variance / spread, -variance * middle / spread
        of_offset = variance * (1.0 / len(x) + middle**2 / spread)
        return cls(scale, offset, unit, ((of_scale, both), (both, of_offset)))


@checked
def torque_factor(
    *,
    shear_modulus: float,
    outer_diameter: float,
    inner_diameter: float = 0.0,
    gauge_factor: float,
    gauge_resistance: float,
    shunt_resistance: float,
    shunt_voltage: float,
) -> float:
    """Torque per unit of signal of a full torsion bridge, calibrated with a shunt across one arm.

    A shunt R_c across one gauge R has the same effect as a strain eps = R / (4 K (R + R_c)) in all four gauges at
    45 degrees, the strain of a shaft under M = 2 eps G pi (D^4 - d^4) / (16 D).

    Parameters
    ----------
    shear_modulus
        G of the shaft [Pa].
    outer_diameter, inner_diameter
        D and d of the shaft [m].
    gauge_factor
        K [-].
    gauge_resistance, shunt_resistance
        R and R_c [ohm].
    shunt_voltage
        Difference between the signals with and without the shunt, in the unit of the log (V or mV).

    Returns
    -------
    float
        Torque [Nm] per unit of `shunt_voltage`.

    Raises
    ------
    InputError
        For a value that is not positive, or an inner diameter that is not less than the outer one.

    Notes
    -----
    With the values of the thesis's appendix D (350 ohm, 437.4 kohm, 2.08, 77 GPa, 90 mm, 2000 mV) the shunt corresponds to
    2118.3 Nm, or 1.0592 Nm/mV, printed as 1.059. The "Mv = 4229" printed there is not a torque but the signal [mV] at the
    rated 4.48 kNm.
    """
    given = {
        "shear_modulus": shear_modulus,
        "outer_diameter": outer_diameter,
        "gauge_factor": gauge_factor,
        "gauge_resistance": gauge_resistance,
        "shunt_resistance": shunt_resistance,
        "shunt_voltage": abs(shunt_voltage),
    }
    for name, value in given.items():
        positive(f"torque_factor: {name}", value)
    if not 0.0 <= inner_diameter < outer_diameter:
        raise InputError(
            f"torque_factor: inner_diameter is {inner_diameter}, expected 0 to less than {outer_diameter}"
        )
    strain = gauge_resistance / (4.0 * gauge_factor * (gauge_resistance + shunt_resistance))
    section_modulus = np.pi * (outer_diameter**4 - inner_diameter**4) / (16.0 * outer_diameter)
    return float(2.0 * strain * shear_modulus * section_modulus / shunt_voltage)
