"""A ship of one's own from the page: a file that `shipfp init --vessel` would have begun, judged by the vessel's loader."""

import tomllib

import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.support.toml import template
from shipfp_rs.vessel.vessel import Vessel
from shipfp_rs.view.draft import fields, vessel_file
from tests.view.serving import served

SHIP = {"name": "Meine Möwe", "gearbox.ratio": "3,5", "engine.cylinders": "6", "engine.strokes": "4"}


def test_the_form_asks_for_every_key_of_the_template_and_its_examples_are_a_ship():
    examples = {one["key"]: one["example"].strip('"') for one in fields() if not one["is_table"]}
    assert all(one["about"] for one in fields() if one["key"].endswith(("K_T", "K_p", "K_i", ".v", ".g")))
    text = vessel_file(examples, "vessel.toml")
    assert len(examples) == text.count(" = ") == template("VESSEL").count(" = ")
    assert Vessel.model_validate(tomllib.loads(text)).governor.K_i == 1.0


def test_what_is_not_given_stays_a_comment(tmp_path):
    path = tmp_path / "vessel.toml"
    path.write_text(vessel_file(SHIP, path.name), encoding="utf-8")
    vessel = Vessel.load(str(path))
    assert (vessel.name, vessel.gearbox.ratio, vessel.engine.cylinders) == ("Meine Möwe", 3.5, 6)
    assert tomllib.loads(path.read_text()).keys() == {"name", "gearbox", "engine"}
    assert "# diameter_m = 1.05" in path.read_text()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"gearbox.ratio": ""}, "vessel.toml: gearbox.ratio: found nothing"),
        ({"gearbox.ratio": "four"}, "vessel.toml: gearbox.ratio: found 'four', expected a valid number"),
        ({"engine.cylinders": "5.5"}, "vessel.toml: engine.cylinders: found 5.5"),
        ({"propeller.wings": "4"}, "vessel.toml: propeller.wings: found an unknown key"),
        ({"name": ""}, "vessel.toml: name: found nothing"),
    ],
)
def test_a_field_that_is_wrong_is_named(changes, told):
    with pytest.raises(InputError) as raised:
        vessel_file(SHIP | changes, "vessel.toml")
    assert told in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_ship_is_written_beside_the_trial_once_and_offered_from_then_on(tmp_path):
    with served(tmp_path) as caller:
        told = caller.post("vessel", {"file": "möwe.toml", "values": SHIP})
        assert told["vessels"][0] == told["file"] == "möwe.toml"
        again = caller.post("vessel", {"file": "möwe.toml", "values": SHIP})
        assert "exists already" in again["error"]
        outside = caller.post("vessel", {"file": "../möwe.toml", "values": SHIP})
        assert outside["status"] == 400
        caller.post("vessel", {"file": "other.toml", "values": {"name": "x"}})
    assert [path.name for path in tmp_path.iterdir()] == ["möwe.toml"]
