"""A whole drive train on the ship's stepper: its NumPy twin, the plain ship, and what physics demands."""

import math

import numpy as np
import pytest

from shipfp_rs import _core
from shipfp_rs.errors import InputError, SimulationError
from shipfp_rs.signals import Excitation
from shipfp_rs.simulation.simulate import simulate
from shipfp_rs.vessel.steady_state import steady_state
from shipfp_rs.vessel.vessel import Vessel
from tests.kernels.test_plant_kernel import wander
from tests.twins import drive_train as twin
from tests.twins.drive_train import detail
from tests.twins.plant import N_E
from tests.twins.ship import vector
from tests.vessel.test_drive_train import ELEMENTS, FOUR_QUADRANT, FULL, SHIP, SMOOTH, TUG

NONE = np.empty((3, 0))
HOLDS = ("zero", "first")
ALL = [0, 1, 2, 3, 4, 5]
DAMPED = {"shaft.stiffness_Nm_rad": 8e4, "shaft.damping_Nms_rad": 65.0}
LIMITS = {"governor.minimum_rack_mm": 8.0, "governor.maximum_rack_mm": 11.0, "governor.anti_windup": True}
LATE = {"actuator.dead_time_s": 0.033}
# What jumps at a sample is seen before it by one, behind it by the other: no period that meets the record's samples.
CLOCK = {"governor.sample_rate_hz": 47.3}
SLOW = {"actuator.rate_mm_s": 20.0, "actuator.lag_s": 0.05, "engine.torque_rate_Nm_s": 500.0}
SHIPS = {name: TUG.replace(changes) for name, changes in {**ELEMENTS, "sampled governor": CLOCK}.items()} | {
    "dead times and lag": TUG.replace(
        {**LATE, "actuator.lag_s": 0.04, "governor.set_point_dead_time_s": 0.137}
    ),
    "sampled governor and dead time": TUG.replace({**CLOCK, **LATE}),
    "sampled PID": TUG.replace({**CLOCK, "governor.K_d": 0.1}),
    "stops with anti-windup": TUG.replace(LIMITS),
    "sampled stops with anti-windup": TUG.replace({**LIMITS, **CLOCK}),
    "rates": TUG.replace({**SLOW, "engine.smoke_margin_mm": 0.5}),
    "damped shaft": TUG.replace(DAMPED),
    "governor once a firing, late": TUG.replace(
        {**ELEMENTS["governor once a firing"], "actuator.dead_time_s": 0.025}
    ),
    "ship in four quadrants": TUG.replace({"ship": SHIP, "propeller.four_quadrant": FOUR_QUADRANT}),
    "all": FULL,
    "all but firing": SMOOTH.replace(CLOCK),
}
JUMP = ("sampled", "stops", "rate", "firing", "all")
"""Parts of names of ships in which something jumps."""


def excitation(hold, size_rpm=40.0, samples=60):
    wave = size_rpm * (wander(samples) / N_E - 1.0) / 0.06
    return Excitation("wander", "wander", 50.0, wave - wave[0], hold)


def detailed(u, dt=0.01, substeps=4, hold="zero", outputs=ALL, more=None, **changes):
    """Rows by name, of a ship with some detail."""
    rows = _core.simulate_detailed_ship(
        vector(**changes), detail(**(more or {})), np.ones(6), NONE, u, dt, substeps, hold, outputs
    )
    return dict(zip(_core.SHIP_OUTPUTS, rows, strict=True))


DAILY = {
    "sampled PID",
    "sampled stops with anti-windup",
    "rates",
    "damped shaft",
    "governor once a firing, late",
    "dead times and lag",
    "ship in four quadrants",
    "all",
    "all but firing",
}
"""Ships that have all elements between them; the others come at night."""


# Each ship with one of both holds, all elements with both.
@pytest.mark.parametrize(
    ("name", "hold"),
    [
        *(
            pytest.param(name, HOLDS[place % 2], marks=() if name in DAILY else pytest.mark.slow)
            for place, name in enumerate(SHIPS)
            if name != "all"
        ),
        *(("all", hold) for hold in HOLDS),
    ],
)
def test_agrees_with_the_equations_as_they_stand(name, hold):
    ship, wave = SHIPS[name], excitation(hold)
    found, expected = simulate(ship, wave), twin.simulate(ship, wave, 20)
    jumps = any(part in name for part in JUMP)
    for signal, level in steady_state(ship).levels.items():
        if signal != "n_set":
            bound = (1e-5 if signal in ("n_e", "n_s", "E_n") else 3e-5) * (10.0 if jumps else 1.0)
            assert np.abs(found.signals[signal] - expected[signal]).max() < bound * level, signal


@pytest.mark.parametrize(
    "name", [name for name in SHIPS if name not in ("rack stops", "ship", "four quadrants")]
)
def test_every_element_does_something(name):
    plain, found = (simulate(ship, excitation("zero")).signals for ship in (TUG, SHIPS[name]))
    assert max(np.abs(found[key] / plain[key] - 1.0).max() for key in ("n_e", "M_g")) > 1e-4


def test_firings_do_not_beat_with_the_steps():
    wave = excitation("first")
    coarse, fine = (simulate(FULL, wave, substeps=steps).signals for steps in (24, 200))
    for name, bound in (("n_s", 3e-6), ("M_g", 3e-5)):
        assert np.abs(coarse[name] / fine[name] - 1.0).max() < bound


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(
    "changes", [{}, {"T_d": 0.04, "tau_act": 0.03}, {"tau_twist": 0.004, "zeta_twist": 0.3}, {"T_s": 0.033}]
)
def test_with_no_detail_it_is_the_ship(changes, hold):
    u = wander(200) / N_E
    u[0] = 1.0
    found = detailed(u, dt=0.02, substeps=20, hold=hold, **changes)
    plain = _core.simulate_ship(vector(**changes), u, np.empty(0), 0.02, 20, hold, ALL)
    for row, expected in zip(found.values(), plain, strict=True):
        np.testing.assert_allclose(row, expected, atol=2e-5 if changes.get("T_s") else 3e-6)


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_a_set_point_that_stands_leaves_all_but_the_ripple_at_rest(hold):
    more = {"margin": 1.0, "torque_rate": 1.0, "drag": 0.1, "drag_exponent": 1.5, "bollard": 0.9}
    rows = detailed(np.ones(200), hold=hold, more=more, tau_act=0.03, T_s=0.02)
    for name in ("dn", "dM_b", "dX", "dE"):
        assert np.abs(rows[name]).max() < 1e-12, name
    np.testing.assert_allclose(1.0 + rows["dM_g"], 0.9, rtol=1e-12)


def test_a_step_of_the_set_point_arrives_after_its_dead_time():
    u = np.where(np.arange(100) < 20, 1.0, 1.02)
    late, now = detailed(u, T_set=0.15), detailed(u)
    for name in ("dn", "dM_b", "dX"):
        np.testing.assert_allclose(late[name][15:], now[name][:-15], atol=1e-9)


def test_a_set_point_jumps_from_the_operating_point_at_the_first_sample():
    rows, later = detailed(np.full(50, 1.02)), detailed(np.full(50, 1.02), T_set=0.1)
    assert rows["dX"][0] == pytest.approx(0.02 * 4.0)
    np.testing.assert_allclose(later["dn"][10:], rows["dn"][:-10], atol=1e-9)
    assert not later["dn"][:10].any()


def test_a_fuel_dead_time_holds_the_torque_for_so_long_and_then_gives_it_all():
    rows = detailed(np.full(60, 1.02), T_d=0.1)
    assert np.abs(rows["dM_b"][:10]).max() < 1e-12
    assert rows["dM_b"][10] - rows["dM_b"][9] == pytest.approx(1.58 * 4.0 * 0.02, rel=1e-9)


def test_rate_limits_by_hand():
    """A step of the set point asks at once for more than the rate of the torque gives."""
    torque = detailed(np.full(11, 1.05), more={"torque_rate": 1.5})["dM_b"]
    np.testing.assert_allclose(torque, 1.5 * 0.01 * np.arange(11), rtol=1e-9)


def test_a_smoke_limiter_lets_the_rack_grow_with_the_charge_air():
    """Held at a margin m over the charge air c, dc/dt = m / lag: a ramp of the rack."""
    rack = detailed(np.full(40, 1.2), K_p=10.0, more={"margin": 0.1, "tau_air": 2.0})["dX"]
    np.testing.assert_allclose(rack, 0.1 * (1.0 + 0.01 * np.arange(40) / 2.0), rtol=2e-5)


def test_steady_firing_has_the_mean_torque_it_was_fuelled_for():
    """Without a load's slope nor a governor's hold on it the speed tells the mean torque."""
    rows = detailed(np.ones(201), dt=1e-3, substeps=2, more={"interval": 1.0 / 3.0}, K_p=0.0, K_i=0.0, v=1e-9)
    # Twelve firings, two turns of the shaft of 20 rev/s.
    assert (1.0 + rows["dM_b"][:-1]).mean() == pytest.approx(1.0, rel=1e-4)
    assert rows["dM_b"].max() > 0.3


@pytest.mark.parametrize("late", [1e300, 1e18, 2.0**63 * 0.01])
def test_breakage_b5_a_set_point_later_than_any_record_never_comes(late):
    dn_set = np.concatenate([np.zeros(50), np.ones(50)])
    assert np.abs(detailed(1.0 + 0.1 * dn_set, T_set=late)["dn"]).max() < 1e-12


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"interval": 0.3, "width": 0.0}, "width = 0, expected more than 0 and at most a cycle"),
        ({"once_a_firing": 1.0}, "interval = 0, expected a positive angle"),
        ({"margin": 1.0, "tau_air": 0.0}, "tau_air = 0, expected a positive number beside a margin"),
        ({"drag": -0.1}, "drag = -0.1, expected zero or more"),
        ({"torque_rate": math.nan}, "torque_rate = NaN, expected zero or more"),
        ({"T_f": 0.0}, "T_f = 0, expected a positive number beside K_d"),
    ],
)
def test_parameters_without_sense_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        detailed(np.ones(10), more=changes, K_d=0.1)


@pytest.mark.parametrize("name", _core.SHIP_DETAIL)
@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf, 0.0, -1.0, 1e300, 1e-300])
def test_no_odd_number_ends_the_process(name, odd):
    more = {"interval": 0.3, "margin": 0.1, "torque_rate": 1.0, "shaft_ripple": 0.01, name: odd}
    try:
        rows = detailed(np.linspace(1.0, 1.1, 20), more=more)
    except (InputError, SimulationError):
        return
    assert all(np.isfinite(row).all() for row in rows.values())


def test_a_vessel_of_ones_own_needs_no_more_than_its_file():
    assert len(simulate(Vessel.load("stan-launch-804").replace({"actuator.lag_s": 0.1}), excitation("zero")))
