"""A fingerprint in Python: printed, reported, asked by name, handed to pandas, LaTeX and python-control, at work."""

from __future__ import annotations

import csv
import io
import json
import sys
from dataclasses import replace

import control
import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.closed_loop import structure_of
from shipfp_rs.designs.subject import Subject
from shipfp_rs.identification.fingerprint import Estimate, Identifiability
from shipfp_rs.identification.question import question_of
from shipfp_rs.structures.elements import ELEMENTS

LAUNCH = fp.Vessel.load("stan-launch-804")
SHIP = (
    fp.Structure.ship(["dead_time_loop", "actuator_lag"], outputs=("dn", "dM", "dX"), products=False)
    .with_fixed(tau_act=0.02, v=1.5)
    .with_prior(g=(-0.5, 0.2))
    .with_bounds(p=(1.0, 2.2, 3.0))
    .with_start(tau_n=1.4)
    .with_tied(K_i=("K_p", 0.1))
)


@pytest.fixture(scope="module")
def trial() -> fp.Experiment:
    clean = fp.signals.chirp(0.02, 2.0, 60.0, 13.0, rate_hz=50.0)
    return fp.simulate(LAUNCH, clean, noise={"n_e": 0.001, "M_b": 0.003}, seed=1)


@pytest.fixture(scope="module")
def found(trial) -> fp.Fingerprint:
    structure = fp.Structure.linear(products=True, dead_time_loop=True).with_fixed(T_d=0.02)
    return fp.identify(trial, structure, noise="white", vessel="Stan Launch 804")


def test_breakage_e3_print_gives_an_aligned_table_below_the_verdict(found) -> None:
    lead, table = str(found).split("\n\n")
    assert lead.replace("\n", " ") == (found.usable or found.verdict[0])
    head, *rows = table.splitlines()
    assert head.split() == ["symbol", "value", "95", "%", "interval", "unit"]
    assert [row.split()[0] for row in rows] == list(found)
    column = head.index("value")
    assert all(row[column - 2 : column] == "  " and row[column] != " " for row in rows)
    assert next(row for row in rows if row.startswith("T_d")).endswith("given")
    assert "inertia time constant" in found._repr_html_()
    squared = replace(found, parameters={"K_i": replace(found["tau_n"], unit="1/s2")}, derived={})
    assert str(squared).endswith("1/s²")
    assert "1/s²" in squared._repr_html_()


def test_print_fits_a_terminal_says_each_reason_once_and_no_figure_beyond_its_error(found) -> None:
    long = "the data allow any value, " * 8
    lost = Estimate(None, status="unidentifiable", reason=long.strip())
    parameters = {
        "g": lost,
        "v": lost,
        "p": Estimate(2.0, 0.1, (1.8, 2.2), status="prior"),
        "T_d": Estimate(1e-9, 1e-4, (0.0, 2.9e-4), "s"),
    }
    text = str(replace(found, parameters=parameters, derived={}, load_side={"p": parameters["p"]}))
    assert max(map(len, text.splitlines())) <= 80
    assert " ".join(text.split()).count(long.strip()) == 1
    rows = [" ".join(row.split()) for row in text.splitlines()]
    assert {"g - - [1]", "v - - [1]", "p 2.00 1.80 to 2.20 - [2]", "T_d < 0.00029 s"} <= {*rows}


def test_breakage_e2_a_fingerprint_is_asked_by_name(found) -> None:
    assert "tau_n" in found
    assert "tau_m" not in found
    assert list(found) == list(found.keys()) == [*found.parameters, *found.derived]
    assert dict(found)["tau_n"] is found["tau_n"]
    assert dict(found.items()).keys() == dict(found).keys()
    assert len(list(found.values())) == len(list(found))
    assert found.get("tau_m") is None
    assert len(found) == len([*found])
    for kind in (KeyError, fp.InputError):
        with pytest.raises(kind, match=r"no parameter 'tau_m'.*did you mean 'tau_n'"):
            found["tau_m"]


def test_breakage_e3_each_repr_is_shorter_than_200_characters(found, trial) -> None:
    wide = fp.Structure.ship([*ELEMENTS], torque="gauge", products=False)
    for thing in (
        found,
        trial,
        SHIP,
        wide,
        fp.Structure.ship(["twist", "actuator_lag"], torque="gauge"),
    ):
        assert "\n" not in repr(thing)
        assert len(repr(thing)) < 200
    assert repr(fp.Structure.linear()) == "Structure('linear', free: tau_n, g, v, K_p, K_i; outputs: dn, dM)"


def test_a_structure_shows_itself_in_a_notebook_and_escapes_what_a_user_named() -> None:
    page = fp.Structure.linear(name="<script>")._repr_html_()
    assert "&lt;script&gt;" in page
    assert "<script>" not in page
    assert "inertia time constant" in page


def test_breakage_e3_the_fit_report_is_laid_out_as_lmfits(found) -> None:
    report = found.fit_report()
    assert [line for line in report.splitlines() if line.startswith("[[")][:3] == [
        "[[Model]]",
        "[[Fit Statistics]]",
        "[[Variables]]",
    ]
    assert f"tau_n: {found['tau_n'].value:.8g} +/- {found['tau_n'].std:.8g}" in " ".join(report.split())
    assert "(init = 1.2)" in report
    assert "0.02 (fixed)" in report
    assert "C(tau_n, vK_p)" in report
    assert "[[Correlations]]" not in found.fit_report(min_correl=1.0)


def test_breakage_e3_correlations_are_those_of_the_covariance(found) -> None:
    related = found.correlations
    assert related["tau_n"]["tau_n"] == pytest.approx(1.0)
    assert related["tau_n"]["vK_p"] == pytest.approx(related["vK_p"]["tau_n"])
    assert abs(related["tau_n"]["vK_p"]) <= 1.0


def test_breakage_e3_pandas_and_csv_hold_every_estimate(found, tmp_path, monkeypatch) -> None:
    pytest.importorskip("pandas")
    frame = found.to_pandas()
    assert list(frame.index) == list(found)
    assert frame.loc["tau_n", "value"] == found["tau_n"].value
    assert frame.loc["tau_n", "name"] == "inertia time constant"
    rows = list(csv.DictReader(io.StringIO(found.to_csv())))
    assert [row["symbol"] for row in rows] == list(found)
    assert float(rows[0]["value"]) == found["tau_n"].value
    assert found.to_csv(tmp_path / "ship.csv").read_text() == found.to_csv()
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(fp.InputError, match=r"pandas is not installed.*pip install 'shipfp_rs\[pandas\]'"):
        found.to_pandas()


def test_simulate_gives_what_the_ship_would_do_and_predict_what_it_did(found, trial) -> None:
    again = found.simulate(trial)
    assert list(again.signals) == ["n_set", "n_e", "M_b"]
    quiet = fp.simulate(LAUNCH, fp.signals.chirp(0.02, 2.0, 60.0, 13.0, rate_hz=50.0))
    assert np.std(again.signals["n_e"] - quiet.signals["n_e"]) < 0.1 * np.std(quiet.signals["n_e"] - 1800.0)
    excited = found.simulate(fp.signals.steps([13.0], 10.0, rate_hz=50.0))
    assert excited.signals["n_e"][-1] == pytest.approx(trial.operating_point["n_e"] + 13.0, abs=1.0)
    told = found.predict(trial)
    share = np.std(told.normalised("n_e") - trial.normalised("n_e")) / np.std(trial.normalised("n_e"))
    assert share == pytest.approx(1.0 - 0.01 * found.fit["dn"]["nrmse_pct"], rel=0.1)
    bare = fp.Experiment("S1", 50.0, {"n_set": [1.0, 1.0, 1.0]}, {"n_set": 1.0})
    assert found.simulate(bare).signals["n_e"][0] == pytest.approx(trial.operating_point["n_e"])


@pytest.mark.parametrize("kind", ["linear", "ship"])
def test_python_control_gets_the_linearisation(found, kind) -> None:
    if kind == "ship":
        structure = fp.Structure.ship(["dead_time_loop", "actuator_lag", "derivative"]).with_fixed(
            T_d=0.03, tau_act=0.05, vK_d=0.05
        )
        found = _at_starts(found, structure)
    space, transfer = found.to_ss(order=4), found.to_tf(order=4)
    assert isinstance(space, control.StateSpace)
    assert space.output_labels == ["dn", "dM"]
    frequency = np.geomspace(0.01, 3.0, 12)
    exact, _ = structure_of(found).equations.response(found.settings["optimum"], frequency, ())
    for made in (space, transfer):
        np.testing.assert_allclose(np.squeeze(made(2j * np.pi * frequency)), exact, rtol=1e-5)


def _at_starts(found: fp.Fingerprint, structure: fp.Structure) -> fp.Fingerprint:
    """Return a fingerprint of a structure at its starts."""
    content = found.to_dict()
    content["structure"] = structure.to_dict()
    content["settings"]["optimum"] = {one.name: one.start for one in structure.parameters}
    return fp.Fingerprint._from_dict(json.loads(json.dumps(content)))


STRUCTURES = {
    "linear": fp.Structure.linear(torque="gauge", dead_time_loop=True).with_fixed(T_d=0.02),
    "ship": SHIP,
    "joint": fp.Structure.joint({"a": fp.Structure.linear(), "b": fp.Structure.linear()}, ["g"]).with_tied(
        **{"K_i (b)": ("K_i (a)", 1.0)}
    ),
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_breakage_a9_a_structure_comes_back_from_json_with_all_that_was_declared(name: str) -> None:
    structure = STRUCTURES[name]
    again = fp.Structure.from_dict(json.loads(json.dumps(structure.to_dict(), allow_nan=False)))
    assert again.parameters == structure.parameters
    assert again.free == structure.free
    assert again.ties == structure.ties
    assert again.name == structure.name
    assert again.signals == structure.signals
    assert type(again.equations) is type(structure.equations)
    assert again.to_dict() == structure.to_dict()


def test_breakage_a9_a_structure_of_a_users_own_says_that_a_file_can_not_hold_it() -> None:
    own = fp.Structure.from_function(
        lambda q, e: None, [fp.Parameter("a", "-", 1.0, 0.0, 2.0)], {"dM": "M_b"}, name="own"
    )
    with pytest.raises(fp.InputError, match=r"'own'.*which a file can't hold; give structure="):
        fp.Structure.from_dict(own.to_dict())
    with pytest.raises(fp.InputError, match=r"expected what Structure\.to_dict writes"):
        fp.Structure.from_dict({"kind": "linear", "name": "x"})


def test_breakage_a9_a_plan_from_a_fingerprint_holds_what_the_fingerprint_held(found, tmp_path) -> None:
    loaded = fp.Fingerprint.load(found.save(tmp_path / "fingerprint.json"))
    assert structure_of(loaded)["T_d"].fixed
    subject = Subject.of(loaded, None, None)
    assert "T_d" not in subject.free
    assert subject.values["T_d"] == 0.02
    plan = fp.design(loaded, duration_s=120.0)
    assert plan.prediction.parameters["T_d"].status == "fixed"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"status": True}, "status: found True, expected"),
        ({"status": "lost"}, "status: found 'lost', expected 'free', 'fixed'"),
        ({"value": float("nan")}, "value: found nan, expected a finite number"),
        ({"value": True}, "value: found True, expected a number"),
        ({"std": -0.1}, "std: found -0.1, expected 0 or more"),
        ({"ci95": (2.0, 1.0)}, "ci95: found (2.0, 1.0), expected its lower end first"),
        ({"unit": "a\nb"}, "unit: found 'a\\nb', expected a text without control characters"),
    ],
)
def test_breakage_e2_an_estimate_holds_what_its_fields_say(given, said) -> None:
    with pytest.raises(fp.InputError) as caught:
        Estimate(**({"value": 1.0} | given))
    assert said in str(caught.value)


def test_breakage_e2_parts_of_a_fingerprint_hold_what_their_fields_say() -> None:
    with pytest.raises(fp.InputError, match="identifiability: rank: found 3, expected 0 to 2"):
        Identifiability(3, 2, 1.0)
    with pytest.raises(fp.InputError, match=r"fingerprint: parameters\.tau_n: found 1.0, expected a"):
        fp.Fingerprint({"tau_n": 1.0}, {}, Identifiability(0, 0, 1.0), {}, {})
    with pytest.raises(fp.InputError, match=r"linear model: .*nan.*, expected finite numbers"):
        type(fp.linearise(LAUNCH))(float("nan"), -0.5, 1.5, 10.0, 1.0, 2.0, 0.4)


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        ("si.inertia.value", "21", "si.inertia.value: found '21', expected a number"),
        ("si.inertia.ci95", [1.0], "si.inertia.ci95: found [1.0], expected two values"),
        ("si.inertia.unit", "a\nb", "si.inertia.unit: found 'a\\nb', expected a text"),
        ("si.inertia.value", None, "si.inertia.value: found None, expected a number, since"),
        ("fit.overall.structure_p", 1.5, "fit.overall.structure_p: found 1.5, expected 1 or less"),
        ("fit.overall.nrmse_pct", 101.0, "fit.overall.nrmse_pct: found 101.0, expected 100 or less"),
        ("elements.twist.state", 1, "elements.twist.state: found 1, expected 'on', 'off' or 'open'"),
        ("parameters.tau_n.value", 1e4, "parameters.tau_n.ci95: found ("),
        ("settings.optimum.tau_n", 50.0, "settings.optimum.tau_n: found 50.0, expected a number within"),
        ("settings.optimum.T_d", 0.1, "settings.optimum.T_d: found 0.1, expected a number within what"),
        ("settings.noise", "loud", "settings.noise: found 'loud', expected 'coloured', 'white' or 'std'"),
        ("settings.starts", 0, "settings.starts: found 0, expected 1 or more"),
        ("settings.converged", "yes", "settings.converged: found 'yes', expected true or false"),
        ("settings.minima", [1.0], "settings.minima.0: found 1.0, expected a table"),
        ("parameters.tau_n.std", 1e-300, "parameters.tau_n.std: found 1e-300, expected null, 0 or a number"),
        (
            "adequate",
            {"misses_pct": {"dM": -1.0}},
            "adequate.misses_pct.dM: found -1.0, expected 0 or more",
        ),
        ("versions.scipy", 1, "versions.scipy: found 1, expected a text"),
        ("seed", -1, "seed: found -1, expected 0 or more"),
        ("structure.outputs", ["x"], "structure: "),
        (
            "structure.parameters.tau_n.bounds",
            [2.0, 1.0],
            "structure.parameters: parameter tau_n: bounds 2 to 1 hold no value between them",
        ),
        (
            "structure.parameters.tau_n.tied",
            {"to": "tau", "factor": 1.0, "offset": 0.0},
            "structure.parameters.tau_n.tied.to: no parameter 'tau'",
        ),
        (
            "sentences",
            {"Known.": {"template": "Known: {one}.", "values": {"one": "g"}}},
            "sentences: found 'Known: g.', expected parts that make 'Known.'",
        ),
    ],
)
def test_breakage_d3_a_damaged_fingerprint_is_refused_by_its_key(found, tmp_path, place, value, said) -> None:
    content = found.to_dict()
    inertia = {"value": 21.2, "std": 0.1, "ci95": [21.0, 21.4], "unit": "kg m2"}
    content |= {"si": {"inertia": inertia}, "elements": {"twist": {"state": "on"}}}
    path = tmp_path / "ship.json"
    path.write_text(json.dumps(content))
    fp.Fingerprint.load(path)
    content = json.loads(path.read_text())
    *way, last = place.split(".")
    owner = content
    for key in way:
        owner = owner[key]
    owner[last] = value
    path.write_text(json.dumps(content))
    with pytest.raises(fp.InputError) as caught:
        fp.Fingerprint.load(path)
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_breakage_d3_what_a_search_writes_stands_together(found, tmp_path) -> None:
    content = found.to_dict()
    del content["settings"]["converged"]
    path = tmp_path / "ship.json"
    path.write_text(json.dumps(content))
    with pytest.raises(fp.InputError, match=r"settings\.converged: found None, expected a value"):
        fp.Fingerprint.load(path)


def test_a_step_at_the_first_sample_is_a_step(found) -> None:
    steps = fp.Excitation("S1", "steps", 50.0, np.full(500, 13.0), "zero")
    speed = found.simulate(steps).signals["n_e"]
    point = found.data[0]["operating_point"]["n_e"]
    assert speed[0] == pytest.approx(point, abs=0.05)
    assert speed[-1] == pytest.approx(point + 13.0, abs=1.0)


def test_delays_that_no_loop_notices_are_left_out_of_the_linearisation_and_named(found) -> None:
    structure = fp.Structure.ship(["dead_time_loop", "dead_time_set_point"])
    late = _at_starts(found, structure)
    parameters = {
        **late.parameters,
        **dict.fromkeys(("T_d", "T_set"), Estimate(8e-5, 1e-4, (0.0, 3e-4), "s")),
    }
    optimum = {**late.settings["optimum"], "T_d": 0.05, "T_set": 8e-5}
    late = replace(late, parameters=parameters, settings={**late.settings, "optimum": optimum})
    transfer = late.to_tf(order=5)
    assert "without T_set below 1 ms" in transfer.name
    # T_d alone is approximated; a step of the set point reaches the torque through it, and not at once.
    assert len(transfer.poles()) == 7
    assert np.abs(late.to_ss(order=5).D).max() == 0.0


def test_a_fingerprint_draws_and_predicts_what_it_was_fitted_to(found, trial) -> None:
    assert found.experiments == (trial,)
    np.testing.assert_array_equal(found.predict().signals["n_e"], found.predict(trial).signals["n_e"])
    measured, model = found.plot()[0].get_lines()[1:]
    assert np.ptp(model.get_ydata()) == pytest.approx(np.ptp(measured.get_ydata()), rel=0.1)
    amplitude, _ = fp.plot.bode(found)
    assert amplitude.get_xlabel() or amplitude.get_ylabel()
    loaded = fp.Fingerprint._from_dict(json.loads(json.dumps(found.to_dict())))
    for call in (loaded.predict, lambda: fp.plot.fit(loaded), lambda: fp.plot.bode(loaded)):
        with pytest.raises(fp.InputError, match="give the one that is meant"):
            call()


def test_a_fingerprint_writes_its_report_with_signals_and_responses(found, tmp_path) -> None:
    page = found.report(tmp_path / "report.html", title="Launch").read_text(encoding="utf-8")
    assert "<title>Launch" in page
    assert all(f'id="{anchor}"' in page for anchor in ("signals", "responses"))
    with pytest.raises(fp.InputError, match="html"):
        found.report(tmp_path / "report.pdf")


def test_outputs_can_be_asked_for_by_the_names_of_signals(trial) -> None:
    question = question_of([trial], outputs=["n_e", "M_b"])
    assert question.outputs == ("dn", "dM")
    with pytest.raises(fp.InputError, match="outputs: no 'M_x'"):
        question_of([trial], outputs=["n_e", "M_x"])


def test_a_fingerprint_tells_its_margins(found) -> None:
    assert found.margins()["phase margin"].unit == "deg"
