"""Uncertainty budget of a fingerprint in SI units: uncertainty from calibration, and from the fit to the data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from shipfp_rs.errors import InputError
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.inertias import ENGINE_SIDE
from shipfp_rs.support.arguments import NotNegative, checked
from shipfp_rs.support.files import finite

FIT = "fit"
"""Name of the contribution of noise, and of the response's systematic errors that the fit allows for."""
POWERS: Mapping[str, Mapping[str, float]] = {
    "kg m2": {"torque scale": 1.0, "speed scale": -1.0, "clock": 2.0, "gear ratio": 1.0},
    "Nm/rpm": {"torque scale": 1.0, "speed scale": -1.0, "clock": 1.0, "gear ratio": -1.0},
    "Nm/(rpm s)": {"torque scale": 1.0, "speed scale": -1.0, "gear ratio": -1.0},
    "Nm": {"torque scale": 1.0, "gear ratio": -1.0},
    "-": {"torque zero": -1.0},
    "s": {"clock": 1.0},
}
"""Exponent of each input in a quantity, by the quantity's unit, for a torque measured on the shaft.

The speed is a number of pulses over a time, so a clock that shows times 1 % too long shows the speed 1 % too
low. The torque's zero changes only the operating point. Quantities relative to the operating point, such as the
exponent, change with it; quantities in SI units do not.
"""
BEHIND_THE_GEAR = 1.0
"""Exponent of the gear ratio to be added if the torque is that of the engine."""


@dataclass(frozen=True)
class Contribution:
    """Contribution of an input to a quantity.

    `input_pct` is the input's standard uncertainty [%]; None for the fit. `u` is the standard uncertainty that
    the input causes in the quantity, in the quantity's unit, and `share` its share of the variance.
    """

    input: str
    input_pct: float | None
    u: float
    share: float


@dataclass(frozen=True)
class Budget:
    """Budget of one quantity: its value, combined standard uncertainty, and contributions (largest first).

    `halved` is the contribution whose halving reduces the uncertainty most, and `then_u` the combined
    uncertainty after that.
    """

    quantity: str
    value: float
    u: float
    unit: str
    contributions: tuple[Contribution, ...]
    halved: str
    then_u: float

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return dict(finite(asdict(self)))


@checked
def budget(
    fingerprint: Fingerprint,
    *,
    torque_pct: NotNegative = 1.0,
    zero_pct: NotNegative = 0.5,
    speed_pct: NotNegative = 0.01,
    clock_pct: NotNegative = 0.005,
    ratio_pct: NotNegative = 0.0,
) -> dict[str, Budget]:
    """Return the uncertainty budget of each quantity in SI units, after the GUM.

    Parameters
    ----------
    fingerprint
        Fingerprint with quantities in SI units (`fingerprint.si`). Inertias follow from the operating point alone;
        the other quantities need a vessel.
    torque_pct, zero_pct
        Standard uncertainty of the torque's scale [%], and of its zero [% of the operating torque].
    speed_pct, clock_pct, ratio_pct
        Standard uncertainty [%] of the speed's scale (such as the number of reflectors), of the logger's clock,
        and of the gear ratio.

    Returns
    -------
    dict
        Budget of each quantity that has a standard deviation.

    Raises
    ------
    InputError
        If the fingerprint has no quantity in SI units.

    Notes
    -----
    JCGM 100:2008, section 5.1: inputs are independent, and sensitivities are of first order.

    Examples
    --------
    >>> import shipfp_rs as fp
    >>> chirp = fp.signals.chirp(0.02, 1.0, 60.0, 40.0, rate_hz=20.0)
    >>> launch = fp.Vessel.load("stan-launch-804")
    >>> log = fp.simulate(launch, chirp, noise={"n_e": 0.2, "M_b": 0.4}, seed=1)
    >>> found = budget(fp.identify(log), torque_pct=2.0)
    >>> found["inertia"].halved
    'torque scale'
    """
    if not fingerprint.si:
        raise InputError(
            "fingerprint: found no quantity in SI units, expected some; give a vessel for the gear ratio"
        )
    inputs = {
        "torque scale": torque_pct,
        "torque zero": zero_pct,
        "speed scale": speed_pct,
        "clock": clock_pct,
        "gear ratio": ratio_pct,
    }
    signal = next((row["signals"].get("dM") for row in fingerprint.data if "dM" in row["signals"]), None)
    before_gear = BEHIND_THE_GEAR if signal in (None, ENGINE_SIDE) else 0.0
    limit = fingerprint.parameters.get("M_max")
    # A torque limit in Nm contains the torque's zero.
    by_zero = {"Nm": 1.0 / limit.value} if limit is not None and limit.value else {}
    return {
        name: _budget(name, row, inputs, before_gear, by_zero.get(row["unit"], 0.0))
        for name, row in fingerprint.si.items()
        if row.get("std") is not None and row["value"]
    }


def _budget(
    name: str, row: Mapping[str, Any], inputs: Mapping[str, float], before_gear: float, by_zero: float
) -> Budget:
    value, unit = float(row["value"]), str(row["unit"])
    powers = {**POWERS.get(unit, {}), **({"torque zero": by_zero} if by_zero else {})}
    if "gear ratio" in powers:
        # A quantity that refers to the shaft on which it was measured does not depend on the gear ratio.
        powers["gear ratio"] = 0.0 if "seen_from" in row else powers["gear ratio"] + before_gear
    parts = {FIT: float(row["std"])}
    parts |= {one: abs(power * value) * inputs[one] / 100.0 for one, power in powers.items() if inputs[one]}
    total = sum(part**2 for part in parts.values())
    halved = max(parts, key=lambda one: parts[one])
    contributions = sorted(
        (Contribution(one, inputs.get(one), part, part**2 / total) for one, part in parts.items() if part),
        key=lambda one: -one.u,
    )
    then = total - 0.75 * parts[halved] ** 2
    return Budget(name, value, total**0.5, unit, tuple(contributions), halved, then**0.5)
