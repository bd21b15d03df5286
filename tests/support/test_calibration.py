"""Volts become rpm and Nm by lines whose numbers the thesis prints."""

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.support.units import Calibration, torque_factor

TABLE_6_11 = ([-3.0309, -4.035, -5.03475, -6.0236], [676.74, 927.77, 1184.4, 1427.9])

APPENDIX_D = {
    "shear_modulus": 77e9,
    "outer_diameter": 0.090,
    "gauge_factor": 2.08,
    "gauge_resistance": 350.0,
    "shunt_resistance": 437_400.0,
}


def test_table_6_11_gives_the_least_squares_line_of_numpy() -> None:
    line = Calibration.from_table(*TABLE_6_11, unit="rpm")
    expected, covariance = np.polyfit(*TABLE_6_11, 1, cov=True)
    assert (line.scale, line.offset) == pytest.approx(tuple(expected), rel=1e-12)
    assert (line.scale, line.offset) == pytest.approx((-251.57, -85.69), abs=0.005)
    assert np.array(line.covariance) == pytest.approx(covariance, rel=1e-9)


def test_inverse_undoes_the_line() -> None:
    line = Calibration(-251.38, -85.29)
    volts = np.array([-7.0, -3.0, 0.0])
    assert line.inverse(line(volts)) == pytest.approx(volts, abs=1e-13)


@pytest.mark.parametrize(
    ("readings", "values"),
    [([1.0], [2.0]), ([1.0, 1.0], [2.0, 3.0]), ([1.0, 2.0], [1.0]), ([1.0, np.nan], [1.0, 2.0])],
)
def test_tables_that_hold_no_line_are_refused(readings: list[float], values: list[float]) -> None:
    with pytest.raises(InputError, match="calibration table"):
        Calibration.from_table(readings, values)


def test_a_scale_of_zero_is_refused() -> None:
    with pytest.raises(InputError, match="scale"):
        Calibration(0.0, 1.0)


def test_appendix_d_shunt_stands_for_2118_nm_and_1_059_nm_per_mv() -> None:
    factor = torque_factor(**APPENDIX_D, shunt_voltage=2000.0)
    assert factor * 2000.0 == pytest.approx(2118.0, abs=0.5)
    assert factor == pytest.approx(1.059, abs=5e-4)
    assert 1.0 / factor * 1e-3 == pytest.approx(9.441e-4, abs=5e-8), "printed as IMC, V/Nm"


def test_appendix_d_mv_is_the_signal_at_rated_torque() -> None:
    rated = 221e3 / (2 * np.pi * 1800 / 60) * 3.82
    assert rated == pytest.approx(4480.0, abs=5.0)
    assert rated / torque_factor(**APPENDIX_D, shunt_voltage=2000.0) == pytest.approx(4229.0, abs=1.0)


def test_a_hollow_shaft_twists_more_for_the_same_torque() -> None:
    solid = torque_factor(**APPENDIX_D, shunt_voltage=2.0)
    hollow = torque_factor(**APPENDIX_D, inner_diameter=0.045, shunt_voltage=2.0)
    assert hollow / solid == pytest.approx(1.0 - 0.5**4, rel=1e-12)


@pytest.mark.parametrize("wrong", [{"gauge_factor": 0.0}, {"inner_diameter": 0.1}, {"shear_modulus": np.nan}])
def test_impossible_gauges_are_named(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        torque_factor(**{**APPENDIX_D, "shunt_voltage": 2000.0, **wrong})
