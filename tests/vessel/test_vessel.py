"""The built-in ships hold the published numbers, and a wrong configuration gets one line that helps."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.support.toml import built_in, template
from shipfp_rs.vessel.vessel import Vessel
from tests.twins import plant

LAUNCH = Vessel.load("stan-launch-804")
TUG = Vessel.load("stan-tug-1205")
LAUNCH_TOML = built_in("vessels")["stan-launch-804"].read_text(encoding="utf-8")


def test_the_ships_that_are_built_in() -> None:
    assert Vessel.names() == ("direct-drive", "stan-launch-804", "stan-tug-1205", "stan-tug-1205-full")


def test_plant_parameters_of_the_launch_are_those_of_the_reference_solution() -> None:
    # The plane through n_e 1300 rpm, X 13.07 mm, M_b 222.93 Nm with v 1.583, g -0.583 (Table 3.5, eq. 5.1).
    np.testing.assert_allclose(LAUNCH.plant_parameters(), plant.vector(), rtol=1e-14, atol=1e-12)


def test_torque_coefficients_agree_with_propeller_data() -> None:
    assert LAUNCH.K_Q_over_eta_r == pytest.approx(0.0450, abs=5e-5)
    # Ka4-70 in nozzle 19A at P/D 1.11, J = 0 has K_Q 0.0561; the tug ran astern, 0.92 of it.
    assert TUG.K_Q_over_eta_r == pytest.approx(0.92 * 0.0561, rel=0.03)


def test_entrained_water_by_schwanecke() -> None:
    assert LAUNCH.entrained_water_inertia() == pytest.approx(0.63, abs=0.005)
    assert TUG.entrained_water_inertia() == pytest.approx(5.75, abs=0.005)
    # Table 3.3's dry propeller, 2.18 kg m2, and its water.
    assert LAUNCH.shaft.propeller_side_inertia_kg_m2 == pytest.approx(2.18 + 0.63, abs=0.005)


@pytest.mark.parametrize("ship", [LAUNCH, TUG], ids=lambda ship: ship.name)
def test_torque_limit_ends_at_the_rating(ship: Vessel) -> None:
    speed, torque = ship.envelope()
    assert 60 * speed[-1] == pytest.approx(ship.engine.rated_speed_rpm)
    assert 2e-3 * np.pi * speed[-1] * torque[-1] == pytest.approx(ship.engine.rated_power_kW, rel=1e-3)


def test_torque_limit_of_the_launch_is_twice_its_operating_torque() -> None:
    speed, torque = LAUNCH.envelope()
    assert np.interp(1300 / 60, speed, torque) == pytest.approx(2.0 * 222.93, rel=1e-3)


def test_a_ship_without_envelope_is_unlimited() -> None:
    speed, torque = LAUNCH.replace({"engine.envelope": None}).envelope()
    assert speed.size == torque.size == 0


def test_replace_changes_one_value_and_nothing_else() -> None:
    heavier = LAUNCH.replace({"shaft.inertia_kg_m2": 30.0, "governor.K_p": 5.0})
    changed = heavier.plant_parameters() != LAUNCH.plant_parameters()
    assert np.flatnonzero(changed).tolist() == [0, 9]
    assert LAUNCH.shaft.inertia_kg_m2 == 21.2


def test_a_ship_of_ones_own_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(LAUNCH_TOML.replace('"Stan Launch 804"', '"Mine"'), encoding="utf-8")
    assert Vessel.load(path).name == "Mine"
    assert Vessel.load(str(path)).shaft == LAUNCH.shaft


def test_missing_and_unreadable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.toml: No such file or directory; expected a TOML file"):
        Vessel.load(tmp_path / "absent.toml")
    latin = tmp_path / "latin.toml"
    latin.write_bytes("name = 'Bö'".encode("latin-1"))
    with pytest.raises(InputError, match=r"latin\.toml: found bytes that are not UTF-8 at 9"):
        Vessel.load(latin)
    marked = tmp_path / "marked.toml"
    marked.write_text("name = 'Bö'", encoding="utf-8-sig")
    with pytest.raises(InputError, match="gearbox: found nothing"):
        Vessel.load(marked)


def test_replace_names_the_ship_and_the_key() -> None:
    with pytest.raises(
        InputError, match=r"^vessel 'Stan Launch 804': shaft\.inertia_kg_m2: found 0.0, expected greater"
    ):
        LAUNCH.replace({"shaft.inertia_kg_m2": 0.0})
    with pytest.raises(InputError, match="no section 'shat'"):
        LAUNCH.replace({"shat.inertia_kg_m2": 1.0})


def test_breakage_c7_a_gear_ratio_is_enough_until_more_is_asked(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('name = "tug"\n[gearbox]\nratio = 3.82\n')
    tug = Vessel.load(path)
    assert tug.gearbox.ratio == 3.82
    assert not tug.given("propeller.blades")
    assert "gear 3.82" in repr(tug)
    with pytest.raises(
        InputError, match=r"lacks gearbox.efficiency, shaft.inertia_kg_m2, governor.K_p, governor.K_i, "
    ):
        tug.plant_parameters()
    with pytest.raises(InputError, match="vessel file: propeller: found nothing"):
        _ = tug.propeller.blades


def test_breakage_c7_an_electric_motor_has_no_cylinders(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "ferry"\n[gearbox]\nratio = 1.0\n[engine]\nrated_power_kW = 500.0\nrated_speed_rpm = 900.0\n'
    )
    assert "500 kW at 900 rpm" in repr(Vessel.load(path))
    with pytest.raises(InputError, match=r"engine\.strokes: found nothing"):
        _ = Vessel.load(path).firing_interval


def test_breakage_c7_all_missing_keys_are_told_at_once(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('description = "nothing else"\n')
    with pytest.raises(InputError, match="name, gearbox: found nothing, expected these keys"):
        Vessel.load(path)


def test_breakage_c7_the_template_is_valid_with_any_of_its_keys(tmp_path: Path) -> None:
    path = tmp_path / "vessel.toml"
    path.write_text(template("VESSEL"))
    assert Vessel.load(path).gearbox.ratio == 3.82
    whole = re.sub(r"(?m)^# (?=\[|\w+ = )", "", template("VESSEL"))
    path.write_text(whole)
    assert len(Vessel.load(path).plant_parameters()) == 12
