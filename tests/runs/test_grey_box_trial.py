"""A trial whose TRIAL.toml asks for the plant itself: run, report, what is read back, and mistakes of one line."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import (
    Fingerprint,
    Structure,
    Vessel,
    cli,
    compare,
    identify,
    plot,
    signals,
    simulate,
    validate,
)
from shipfp_rs.assessment.prediction import predict, structure_of
from shipfp_rs.processing.trial import Trial
from shipfp_rs.report import compared_responses
from shipfp_rs.support.toml import template, validated

FREE = ["propeller_inertia", "Kp_abs", "Ki_abs", "torque_exponent"]
LIMITED = Vessel.load("stan-launch-804").replace({"engine.torque_rate_Nm_s": 110.0})


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A simulated log and its TRIAL.toml, with the plant in place of the linear structure."""
    folder = tmp_path_factory.mktemp("trial")
    made = ["--raw", "--duration", "60", "--out", str(folder / "log.parquet"), "--seed", "3"]
    assert cli.main(["simulate", "stan-tug-1205", *made]) == 0
    text = (folder / "log.toml").read_text()
    text += f'\n[structure]\nkind = "grey_box"\nfree = {json.dumps(FREE)}\n'
    (folder / "TRIAL.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def found(folder) -> Fingerprint:
    assert cli.main(["run", str(folder / "TRIAL.toml"), "--out", str(folder / "result")]) == 0
    return Fingerprint.load(folder / "result" / "fingerprint.json")


def test_a_run_finds_the_ship_in_its_own_terms(found):
    for name in FREE:
        start = found.structure["parameters"][name]["start"]
        assert found[name].value == pytest.approx(start, rel=0.05), name
    assert [found[name].unit for name in FREE] == ["kg m2", "mm/(rev/s)", "mm/rev", "-"]
    assert (found.structure["kind"], found.structure["torque"]) == ("grey box", "gauge")


def test_a_pass_band_of_the_trial_file_is_the_structure_s(folder, capsys):
    text = (folder / "TRIAL.toml").read_text() + "pass_hz = 3.0\n"
    (folder / "banded.toml").write_text(text)
    assert cli.main(["run", str(folder / "banded.toml"), "--out", str(folder / "banded")]) == 0
    banded = Fingerprint.load(folder / "banded" / "fingerprint.json")
    assert banded.structure["pass_hz"] == 3.0
    assert banded["torque_exponent"].value == pytest.approx(
        banded.structure["parameters"]["torque_exponent"]["start"], rel=0.05
    )
    (folder / "wrong.toml").write_text(text.replace("pass_hz = 3.0", "pass_hz = -3.0"))
    capsys.readouterr()
    assert cli.main(["run", str(folder / "wrong.toml"), "--out", str(folder / "wrong")]) == 2
    assert "structure.pass_hz" in capsys.readouterr().err
    assert not (folder / "wrong").exists()


def test_the_report_has_the_names_in_words_and_the_model_s_response_to_the_trial(folder, found):
    page = (folder / "result" / "report.html").read_text()
    assert "proportional gain of the governor" in page
    assert "Frequency responses" in page


def test_a_file_holds_all_that_the_plant_is(folder, found, capsys):
    again = structure_of(found)
    assert [parameter.name for parameter in again.free] == [
        name for name in found.parameters if found[name].status != "fixed"
    ]
    assert again.equations.vessel == Vessel.load("stan-tug-1205")
    assert all(change.change == 0.0 for change in compare(found, found).changes)
    path = str(folder / "result" / "fingerprint.json")
    assert cli.main(["compare", path, path]) == 0
    capsys.readouterr()
    assert cli.main(["compare", path, path, "--out", str(folder / "no.png")]) == 2
    assert "has no frequency response" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"Kp_abs"', '"Kp_asb"', "did you mean 'Kp_abs'"),
        ('"Kp_abs"', '"torque_rate"', "give vessel 'Stan Tug 1205' its engine.torque_rate_Nm_s"),
        ("grey_box", "gray_box", "structure.kind: found 'gray_box', expected 'grey_box'"),
        ("free", "fere", "structure.fere: found an unknown key, did you mean 'free'"),
        ("[structure]", "[identify]\nproducts = true\n[structure]", "identify.products: found a key of the"),
        ("[structure]", "[identify.fixed]\ntau_n = 1.0\n[structure]", "no parameter 'tau_n'"),
    ],
)
def test_a_mistake_costs_one_line_and_status_2(folder, tmp_path, capsys, old, new, message):
    text = (folder / "TRIAL.toml").read_text().replace("log.parquet", str(folder / "log.parquet"))
    assert old in text
    (tmp_path / "TRIAL.toml").write_text(text.replace(old, new))
    assert cli.main(["run", str(tmp_path / "TRIAL.toml"), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_the_template_s_table_is_one_that_can_be_uncommented():
    head, table = template("TRIAL").split("# [structure]")
    table = "[structure]" + table.replace("\n# ", "\n")
    trial = validated(tomllib.loads(head + table), Trial, "template")
    assert Structure.grey_box(Vessel.load(trial.trial.vessel), trial.structure.free, torque="gauge")


def test_a_saved_fit_predicts_and_is_validated_from_any_initial_state(tmp_path):
    """The limit acts, and the record begins in the middle of a motion."""
    chirp = signals.chirp(0.02, 0.8, 90.0, 26.0, rate_hz=25.0)
    log = simulate(LIMITED, chirp, noise={"n_e": 0.02, "M_b": 0.02}, seed=5).window(9.0, 90.0)
    structure = Structure.grey_box(LIMITED, ["inertia", "Kp_abs", "Ki_abs", "torque_rate"])
    identify(log, structure).save(tmp_path / "fingerprint.json")
    again = Fingerprint.load(tmp_path / "fingerprint.json")
    fits = validate(again, log)
    for output, fit in fits.items():
        assert fit == pytest.approx(again.fit[output]["nrmse_pct"], abs=0.05), output
    ((measured, model),) = compared_responses(again, [log])
    assert (model.frequency_hz == measured.frequency_hz).all()
    near = np.searchsorted(model.frequency_hz, 0.1)
    assert abs(model.response["n_e"][near] / measured.response["n_e"][near] - 1.0) < 0.02
    plot.bode(measured, model)
    assert set(predict(again, log)) == {"n_e", "M_b"}
