"""The report on each side of the drive train, and what stands above all figures: where it ran, and how heavy it is."""

import re
from dataclasses import replace

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.identification.estimate import Estimate
from shipfp_rs.report import render
from shipfp_rs.report.answer import _picture
from shipfp_rs.report.loop import scaled, steps
from shipfp_rs.report.markup import Say
from shipfp_rs.report.operating import facts
from shipfp_rs.report.pictures import Pictures
from tests.assessment.test_measured_steps import record
from tests.families import other_governors
from tests.report.test_answer import first_screen, text_of


@pytest.fixture(scope="module")
def undescribed() -> fp.Fingerprint:
    ship = other_governors.draw("dead_band", 150000)
    return fp.identify(fp.Experiment(**ship.experiment()), torque=ship.place)


def rendered(found: fp.Fingerprint, **options) -> str:
    return render(found, found.experiments, simulated=[found.predict()], **options)


@pytest.fixture(scope="module")
def page(undescribed) -> str:
    return rendered(undescribed)


def section(page: str) -> str:
    return page[page.index('id="sides"') : page.index('id="signals"')]


def test_an_engine_that_is_not_described_has_its_picture_and_no_loop(page) -> None:
    sides, shown = section(page), page[page.index("<main>") : page.index("<h2")]
    why = shown.index("What the drive&#39;s torque has beyond the model")
    assert why < shown.index(
        "measurement, and the model&#39;s answer"
    )  # refused gains have their reason first
    assert shown.count("<svg") == 2
    assert "<svg" not in sides
    assert "A dead band, or a gain that grows in steps, makes an S through zero error" in shown
    assert "those of the load&#39;s side by itself are given" in sides
    assert 'id="loop"' not in page
    screen = text_of(first_screen(page))
    assert "phase margin" not in screen
    assert "not identifiable" not in screen
    assert "More excitation" not in screen
    assert "What drive and governor do beyond the model is drawn beside" in screen


def test_the_load_s_side_stands_beside_the_whole(undescribed, page) -> None:
    row = re.search(r"<code>p</code>.*?</tr>", section(page))[0]
    alone, whole = undescribed.load_side["p"], undescribed.optimum["p"]
    assert f"{alone.value:.3f}" in row
    assert f"{whole:.4g}" in row
    text = str(undescribed)
    assert "The load's side by itself (speed and torque alone, no model of the drive):" in text
    assert "torque scale" not in text
    described = replace(
        undescribed, adequate={**undescribed.adequate, "sides": {"load": True, "engine": True}}
    )
    assert str(described).endswith("Both agree within their errors.")


def test_a_fingerprint_without_sides_says_nothing_of_them(undescribed) -> None:
    older = replace(undescribed, adequate={}, load_side={})
    assert 'id="sides"' not in rendered(older)
    assert "by itself" not in str(older)


def test_operating_point_and_inertia_stand_on_top(undescribed, page) -> None:
    point = undescribed.data[0]["operating_point"]
    screen = text_of(first_screen(page))
    power_kW = point["M_b"] * point["n_e"] * np.pi / 30.0 / 1e3
    assert (
        f"{point['n_e']:.4g}\u00a0rpm, {point['M_b']:.4g}\u00a0Nm, {power_kW:.3g}\u00a0kW"
        in screen.replace(" rpm", "\u00a0rpm").replace(" Nm", "\u00a0Nm").replace(" kW", "\u00a0kW")
    )
    tau = undescribed.parameters["tau_n"].value
    inertia = next(row for row in facts(undescribed, [], None, Say()) if "kg" in row[2])
    expected = tau * point["M_b"] / (point["n_e"] * np.pi / 30.0)
    assert float(inertia[2].split("\u00a0")[0]) == pytest.approx(expected, rel=1e-2)


def test_a_large_torque_is_in_kNm_and_a_large_power_without_powers_of_ten(undescribed) -> None:
    data = [
        {**row, "operating_point": {**row["operating_point"], "M_b": 241_100.0, "n_e": 150.0}}
        for row in undescribed.data
    ]
    row = facts(replace(undescribed, data=tuple(data)), [], None, Say())[0]
    assert row[2] == "150\u00a0rpm, 241.1\u00a0kNm, 3787\u00a0kW"


def test_a_generating_set_has_its_inertia_constant(undescribed) -> None:
    load = {**undescribed.first().signals, "M_load": undescribed.first().signals["M_b"]}
    loaded = replace(
        undescribed.first(), signals=load, operating_point={**undescribed.first().operating_point}
    )
    told = {row[1]: row[2] for row in facts(undescribed, [loaded], None, Say())}
    tau = undescribed.parameters["tau_n"].value
    assert float(told["H"].split("\u00a0")[0]) == pytest.approx(0.5 * tau, rel=1e-2)


@pytest.mark.parametrize(("half", "tone"), [(0.1, "good"), (0.22, "warn")])
def test_green_is_only_what_is_known_to_a_fifth(undescribed, half, tone) -> None:
    known = {"vK_p": Estimate(4.0, 2.0 * half, (4.0 - 4.0 * half, 4.0 + 4.0 * half))}
    found = replace(undescribed, parameters=known, derived={}, usability="usable", usable="Any sentence.")
    assert f'<p class="answer {tone}">Any sentence.' in render(found, [])


def test_a_load_is_shown_above_what_it_drives() -> None:
    time = np.arange(0.0, 40.0, 0.05)
    load = 1000.0 + 100.0 * (np.sin(0.7 * time) > 0.0)
    signals = {"n_set": np.full_like(time, 1500.0), "n_e": 1500.0 - 0.01 * load, "M_load": load}
    trial = fp.Experiment("S1", 20.0, signals, {"n_set": 1500.0, "n_e": 1500.0, "M_load": 1000.0})
    drawn = _picture([trial], [replace(trial, signals=signals)], Pictures(Say()), Say())
    assert "model&#39;s answer to the same load" in drawn
    assert drawn.count('id="picture1-axes_') == 1 + len(trial.outputs)


def test_a_reason_that_several_parameters_share_is_told_once(page) -> None:
    table = page[page.index('id="parameters"') : page.index("What the symbols mean")]
    assert table.count("drive and governor are not described") == 1
    names = re.search(r"(g, vK_p[^:<]*): drive and governor are not described", table)[1].split(", ")
    assert {"vK_i", "T_d", "T_set", "tau_act"} <= set(names)
    assert table.count(">not identifiable</td>") == len(names)


def test_measured_load_steps_are_a_table() -> None:
    (heading, told) = steps([record()], Say())
    assert "Load steps as measured" in heading
    assert re.findall(r'class="number"[^>]*>([^<]*)</td>', told)[:3] == ["10.0", "+360", "5"]
    assert "load step [Nm]" in told
    assert [*steps([replace(record(), signals={"n_set": np.ones(9), "n_e": np.ones(9)})], Say())] == []


def test_an_overshoot_is_told_in_per_cent() -> None:
    told = scaled(Estimate(0.38, 0.01, (0.36, 0.40)), 100.0, "%")
    assert (told.value, told.ci95, told.unit) == (pytest.approx(38.0), pytest.approx((36.0, 40.0)), "%")
    assert scaled(Estimate(None), 100.0, "%").value is None
