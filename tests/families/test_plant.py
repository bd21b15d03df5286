"""The truth of a draw against the thesis' own tables."""

from __future__ import annotations

import pytest

from tests.families.plant import Plant, normalised


def test_truth_is_normalised_at_the_operating_point():
    """Stan Launch 804 (Table 3.5): tau_n = 2 pi 21.2 * 7.222 / 635.77 = 1.513 s; A1, A2 and the gains of section 2."""
    n_e = 1300.0 / 60.0
    plant = Plant(
        engine_speed=n_e,
        ratio=3.0,
        efficiency=635.77 / (3.0 * 222.93),
        shaft_torque=635.77,
        engine_inertia=15.0,
        load_inertia=6.2,
        exponent=2.0,
        load_damping=0.0,
        engine_slope=-0.100 * 60.0,
        rack=13.07,
        rack_slope=27.0,
        gain=0.1005 * 60.0,
        integral_gain=0.01005 * 60.0,
    )
    found = normalised(plant)
    assert found["tau_n"] == pytest.approx(1.513, abs=1e-3)
    assert found["tau_prop"] == pytest.approx(1.513 * 6.2 / 21.2, abs=1e-3)
    assert found["g"] == pytest.approx(-0.583, abs=1e-3)
    assert found["vK_p"] == pytest.approx(15.83, abs=0.02)
    assert found["vK_i"] == pytest.approx(1.583, abs=0.002)
    assert plant.brake_torque == pytest.approx(222.93)
