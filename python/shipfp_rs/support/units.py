"""Units in the spellings of many loggers, factors to SI and rpm, and calibration of recorded volts."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.support.arguments import check_fields, checked, positive
from shipfp_rs.support.arrays import Array, unmasked
from shipfp_rs.support.files import words_of

WORDS = words_of("unit_words")
RPM = frozenset(WORDS["rpm"].split())
"""Spellings of turns per minute in the languages of loggers and yards, in lower case and without spaces."""
NAMED: Mapping[str, str] = {
    other: unit for unit, others in WORDS["others"].items() for other in others.split()
}
"""Other spellings of a unit, in lower case and without spaces."""

TO_RPM: Mapping[str, float] = {
    "rpm": 1.0,
    "rev/s": 60.0,
    "rad/s": 60.0 / 6.283185307179586,
    "Hz": 60.0,
    "1/s": 60.0,
    "deg/s": 1.0 / 6.0,
}
"""Factors from units of speed to turns per minute; for an electric frequency, those of one pair of poles."""
FREQUENCIES = ("Hz", "1/s")
"""Units of speed that may also be those of an electric frequency."""
TO_NM: Mapping[str, float] = {"mNm": 1e-3, "Nm": 1.0, "kNm": 1e3, "MNm": 1e6, "lbf ft": 1.3558179483314004}
TO_W: Mapping[str, float] = {"W": 1.0, "kW": 1e3, "MW": 1e6}
TO_REV: Mapping[str, float] = {
    "rev": 1.0,
    "deg": 1.0 / 360.0,
    "°": 1.0 / 360.0,
    "rad": 1.0 / 6.283185307179586,
}
"""Factors from units of angle to turns."""


class Quantity(NamedTuple):
    """A physical quantity: its unit (SI or rpm), factors from other units, and ranges of usual and possible values."""

    unit: str
    factors: Mapping[str, float]
    usual: tuple[float, float] = (0.0, math.inf)
    possible: tuple[float, float] = (0.0, math.inf)


QUANTITIES: Mapping[str, Quantity] = {
    "speed": Quantity("rpm", TO_RPM, (5.0, 20e3), (1e-3, 60e3)),
    "torque": Quantity("Nm", TO_NM, (1e-2, 2e7), (1e-6, 1e9)),
    "power": Quantity("W", TO_W, (1e3, 1e9), (1e-6, 1e12)),
    "angle": Quantity("rev", TO_REV),
}
"""Ranges from a laboratory motor to the largest propeller (90 rpm, 8 MNm, 80 MW); turbine shafts reach 20,000 rpm."""

ELECTRIC = frozenset(("", "V", "mV", "µV", "A", "mA", "mV/V", "counts", "bits"))
"""Electrical units of a measuring amplifier or converter, which need a calibration."""

LETTER = "[?�¿]"
"""Replacement of a degree or micro sign in text read with the wrong encoding."""
MENDED = (
    (re.compile(f"(?:{LETTER}|Â°|Ã‚Â°)([CFK])"), r"°\1"),
    (re.compile(f"(?:{LETTER}|Âµ|Î¼)(m/m|m|s|V|A|strain|e|eps|Pa|l|g)"), r"µ\1"),
    (re.compile("(m|mm|km|cm|dm)Â²"), r"\1²"),
)

TIME_FORMAT = re.compile(r"[dmyhst.fj:/\- ,;]*(?:yy|hh|mm|ss|dd|tt|jj|am/pm)[a-z0.:/\- ,;]*", re.IGNORECASE)
"""Format of a date or clock such as hh:mm:ss.000, in the position of the unit of such a column."""

PLAIN = re.compile(
    r"-|%|‰|°|°?[CFK]|deg[CF]?|[num kMGµμ]?(s|V|A|m|g|N|Nm|N m|N\*m|N·m|N\.m|Hz|W|Pa|bar|rad)"
    r"|[num kMGµμ]?(l|L|Ohm|Ω|eps|strain|mol|VA|var)"
    r"|rev|rev/s|[um]?sec|seconds?|millisec(?:onds?)?|min|minutes?|h|Std|Sek|sek|seg|1/s|rad/s|deg/s|rad/s2|rad/s²|kn|kts?|[µu]m/m"
    r"|[kcm]?m/(s|h|s2|s\^2|s²)|[kt]?g/(?:h|s|min)|g/kWh|l/h|L/h|m3/h|m³/h|m²|m³"
    r"|ticks?|counts?|cts|inc|mV/V|bits?|hPa|mbar|psi|ft|lbf?ft|ft-?lb|hp|PS|none|n/a|[a-z]?V AC"
)


def told(unit: str) -> str:
    """Standard spelling of a unit: wrongly decoded letters are repaired, and all spellings of rpm become "rpm".

    Examples
    --------
    >>> told("U/min"), told("?C"), told("kN·m"), told("V")
    ('rpm', '°C', 'kNm', 'V')
    """
    text = unit.strip()
    for damaged, whole in MENDED:
        if found := damaged.fullmatch(text):
            text = found.expand(whole)
            break
    plain = re.sub(r"\s+", "", text).lower()
    return "rpm" if plain in RPM else NAMED.get(plain, text)


def is_unit(text: str) -> bool:
    """Whether a word is a unit, a dash (no unit), or the format of a date or clock.

    Examples
    --------
    >>> [is_unit(word) for word in ("U/min", "hh:mm:ss", "kNm", "torque")]
    [True, True, True, False]
    """
    text = text.strip()
    known = told(text)
    return bool(
        PLAIN.fullmatch(known) or known == "rpm" or known in NAMED.values() or TIME_FORMAT.fullmatch(text)
    )


def unit_shown(unit: str) -> str:
    """Typographic form of a unit; empty for a ratio."""
    return "" if unit == "-" else unit.replace("kg m2", "kg m²").replace("1/s2", "1/s²").replace("deg", "°")


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
        Covariance of (scale, offset), shape (2, 2), if a line was fitted to more than two points.

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
        """Recorded values for calibrated values, same shape."""
        return (unmasked(value) - self.offset) / self.scale

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
