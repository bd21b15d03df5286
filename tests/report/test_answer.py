"""The first screen answers: usable for what, the ship in plain names and SI, its loop, what is open; in German, too."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from markupsafe import Markup, escape

import shipfp_rs as fp
from shipfp_rs.assessment.si import in_si
from shipfp_rs.identification.estimate import Estimate, Identifiability, rounded_rows
from shipfp_rs.identification.inertias import operating_point
from shipfp_rs.identification.input_checks import doubts
from shipfp_rs.identification.usability import BENT, MISSES, Case, usability
from shipfp_rs.identification.wording import rank
from shipfp_rs.report import render
from shipfp_rs.report.answer import interval, loop_rows, open_questions, ship_rows
from shipfp_rs.report.loop import _step, figures
from shipfp_rs.report.markup import Say
from shipfp_rs.report.pictures import Pictures
from shipfp_rs.support.sentences import Sentence, listed

TUG = fp.Vessel.load("stan-tug-1205")
ELEMENTS = {
    "dead_time_loop": {"state": "on", "evidence": 120.0, "limit": None, "words": "dead time in the loop"},
    "actuator_lag": {"state": "open", "evidence": 2.0, "limit": None, "words": "lag of the actuator"},
    "torque_limit": {
        "state": "off",
        "evidence": -3.0,
        "limit": {"parameter": "M_max", "value": 1.12, "unit": "-", "level": 0.95},
        "words": "upper torque limit",
    },
}


@pytest.fixture(scope="module")
def trial() -> fp.Experiment:
    chirp = fp.signals.chirp(0.05, 2.0, 80.0, 40.0, rate_hz=25.0, name="chirp")
    return fp.simulate(TUG, chirp, noise={"n_e": 0.001, "M_b": 0.005, "M_g": 0.01}, seed=2)


@pytest.fixture(scope="module")
def found(trial) -> fp.Fingerprint:
    structure = fp.Structure.linear(products=True, free_exponent=True)
    fitted = fp.identify(trial, structure, noise="white", starts=1, vessel=TUG.name)
    return replace(
        fitted,
        si=in_si(fitted, TUG),
        elements=ELEMENTS,
        usable="Usable for simulation, control tuning and comparison: the data determine every parameter.",
        usability="usable",
    )


@pytest.fixture(scope="module")
def page(found, trial) -> str:
    return render(found, [trial], simulated=[found.predict(trial)])


def text_of(page: str) -> str:
    """Return what a reader sees: no scripts, styles, pictures or tags."""
    bare = re.sub(r"<(script|style|svg)\b.*?</\1>|<a class=\"save\".*?</a>", " ", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", bare))


def test_the_first_screen_has_verdict_ship_loop_and_pictures_before_the_first_heading(page: str) -> None:
    screen = page[page.index("<main>") : page.index("<h2")]
    assert '<p class="answer good">Usable for simulation, control tuning and comparison' in screen
    assert screen.count("<svg") == 2
    assert "answer to a step of the set point" in screen
    for words in (
        "The drive train, with 95 % intervals",
        "inertia of the drive train",
        "load exponent",
        "bandwidth",
        "phase margin",
        "recovery time",
    ):
        assert words in screen
    assert "kg\u00a0m²" in screen
    assert "measurement, and the model" in screen


def test_the_ship_is_told_in_plain_names_with_intervals_and_in_si(found) -> None:
    rows = {name: rest for name, *rest in ship_rows(found, Say())}
    _, value, spread, more = rows["inertia of the drive train, seen from the load shaft"]
    inertia = found.si["inertia"]
    assert value.endswith("kg\u00a0m²")
    assert float(value.split()[0]) == pytest.approx(inertia["value"], rel=0.05)
    low, high = (float(text) for text in re.findall(r"\d[\d.]*", spread))
    assert (low, high) == pytest.approx(inertia["ci95"], rel=0.05)
    assert more.startswith("normalised: tau_n = ")
    assert float(more.split("=")[1].split()[0]) == pytest.approx(found["tau_n"].value, rel=0.05)
    assert rows["load exponent"][3] == ""  # a ratio is the same in SI


def test_the_loop_s_figures_are_those_of_the_linearisation(found) -> None:
    loop = figures(found, None)
    rows = {name: value for name, _, value, _, _ in loop_rows(loop, Say())}
    assert float(rows["bandwidth"].split()[0]) == pytest.approx(loop["bandwidth"].value, rel=0.01)
    assert rows["phase margin"].endswith("°")
    unlimited = {**loop, "gain margin": Estimate(None, status="unidentifiable", reason="there is none")}
    assert {row[0]: row[2] for row in loop_rows(unlimited, Say())}["gain margin"] == "no limit"
    limited = {**loop, "gain margin": Estimate(3.862, 0.1, (3.666, 4.058))}
    assert {row[0]: row[2] for row in loop_rows(limited, Say())}["gain margin"] == "3.86 times"
    for ends, told in (((2.1, 6.4), "2.1 to 6.4 times"), ((2.9, 812.0), "at least 2.9 times")):
        rough = {**loop, "gain margin": Estimate(3.9, (ends[1] - ends[0]) / 4.0, ends)}
        value, beside = next(row[2:4] for row in loop_rows(rough, Say()) if row[0] == "gain margin")
        assert (value, beside) == (told, "known only roughly")


def test_what_stands_in_the_way_is_told_in_the_order_in_which_one_looks(found) -> None:
    lost = Estimate(None, status="unidentifiable")
    missing = replace(
        found, parameters=dict.fromkeys(["vK_p", "tau_n", "T_d", "tau_prop"], lost), elements={}
    )
    (line,) = open_questions(missing, Say())
    order = ["(tau_prop)", "(T_d)", "(tau_n)", "(vK_p)"]
    assert sorted(order, key=line.index) == order
    known = {"p": Estimate(2.0, 0.01, (1.98, 2.02))}
    told = usability(Case(replace(missing, parameters={**missing.parameters, **known})))
    assert "do not determine tau_prop, T_d, tau_n and vK_p, for " in told.sentence


def test_a_sensor_in_doubt_stands_above_all_else_that_is_open(found, trial) -> None:
    point = {**trial.operating_point, "n_set": 1.05 * trial.operating_point["n_e"]}
    (doubt,) = doubts([replace(trial, operating_point=point)])
    bent = replace(found, usable=BENT, verdict=(BENT, doubt), usability="usable except")
    screen = text_of(first_screen(render(bent, [trial], simulated=[bent.predict(trial)])))
    assert screen.index("look at the set point") < screen.index("in the order in which to look: sensors")
    assert screen.index("sensors (") < screen.index("actuation (") < screen.index("then gains")
    assert "in the order in which to look" not in text_of(first_screen(render(found, [trial])))


def test_what_is_open_is_one_line_with_what_would_settle_it(found) -> None:
    decided = replace(found, elements={})
    assert all(line.startswith("Known only roughly") for line in open_questions(decided, Say()))
    gap = replace(found.identifiability, closes_gap=("v", "K_p"))
    lost = replace(
        found,
        parameters={"v": Estimate(None, status="unidentifiable"), "p": Estimate(2.0, 0.01, (1.98, 2.02))},
        identifiability=gap,
    )
    (line,) = open_questions(lost, Say())
    assert line.startswith("Not determined by the data: slope of drive torque with actuator (v). ")
    assert line.endswith(
        ": slope of drive torque with actuator (v), proportional gain of the governor (K_p)."
    )
    rough = {
        "tau_n": Estimate(1.2, 0.4, (0.4, 2.0), "s"),
        "T_set": Estimate(1e-4, 1e-3, (-0.001, 0.002), "s"),
    }
    (line,) = open_questions(replace(found, parameters=rough), Say())
    assert line.startswith("Known only roughly, the worst first: inertia of the drive train (tau_n).")
    assert "T_set" not in line  # that it is short is what is told of it


def test_what_would_sharpen_is_one_quantity_and_by_how_much(found) -> None:
    rough = {name: Estimate(4.0, 1.0, (2.0, 6.0)) for name in ("g", "vK_p", "p")}
    matrix = [[1.0, 0.8, 0.1], [0.8, 1.0, 0.96], [0.1, 0.96, 1.0]]
    known = {"names": ["p", "g", "vK_p"], "matrix": matrix}
    (line,) = open_questions(replace(found, parameters=rough, covariance=known), Say())
    assert line.count("were known from elsewhere") == 1
    assert line.endswith("would shrink to 28 % of its width.")  # the root of 1 - 0.96**2


def test_the_correlations_of_all_parameters_are_a_table(page: str, found) -> None:
    table = page[page.index("Correlations of the parameters") :]
    first, second = [*found.correlations][:2]
    row = re.search(rf"<code>{first}</code>.*?</tr>", table)[0]
    assert f"{found.correlations[first][second]:.2f}" in row


def test_the_choice_shows_what_acts_what_does_not_and_what_can_not_be_told(page: str, found) -> None:
    section = page[page.index('id="elements"') : page.index('id="loop"')]
    rows = {
        name: re.findall(r"<td[^>]*>([^<]*)</td>", line)
        for name, line in re.findall(r'<tr><th scope="row">([^<]*)</th>(.*?)</tr>', section)
    }
    assert rows["dead time in the loop"] == ["acts", "120", ""]
    assert rows["lag of the actuator"][0] == "undecided"
    torque = f"{1.12 * operating_point(found)[1]:.4g}"
    limit = f"M_max above 1.12 times the operating torque ({torque} Nm)"
    assert rows["upper torque limit"] == ["not found to act", "0", limit]


@pytest.mark.usefixtures("undrawn")
def test_a_torque_limit_says_what_it_is_measured_by_and_is_in_newton_metres_where_these_are_known(
    found,
) -> None:
    limited = replace(found, parameters={"M_max": Estimate(1.25, 0.01, (1.23, 1.27))}, si={}, settings={})
    told = f"times the operating torque ({1.25 * operating_point(found)[1]:.4g} Nm)"
    page = render(limited, [])
    assert page.count(told) == 2  # on the first screen and in the table
    assert "M_max above 1.12 times the operating torque<" in render(replace(limited, data=()), [])


@pytest.mark.parametrize("language", ["en", "de"])
def test_the_symbols_of_the_table_are_explained_below_it(found, language) -> None:
    say = Say(language)
    heading = say("What the symbols mean")
    told = re.search(rf"(?s)<h3>{heading}</h3>(.*?</ul>.*?)</p>", render(found, [], language=language))[1]
    assert say.meaning("g") in told
    assert told.count("<li>") == len(found.parameters)
    assert re.search(r"\bI: [^;]* \[kg m²\]; .*\bn_s0: .* M_s0: ", told)  # the other symbols of the formulas
    speed_rpm, torque_Nm, _ = operating_point(found)
    assert f"{speed_rpm:.4g} rpm" in told.replace(",", ".")  # what they are normalised to
    assert f"{torque_Nm:.4g} Nm" in told.replace(",", ".")


@pytest.mark.usefixtures("undrawn")
def test_the_verdict_has_names_for_symbols(found) -> None:
    page = render(replace(found, usable=SENTENCES["some"], **judged("some")), [])
    lead = re.search(r'<p class="answer[^>]*>([^<]*)', page)[1]
    assert "do not determine the inertia of the drive train and the slope of drive torque" in lead


def test_a_delay_that_may_be_zero_has_an_upper_limit(found) -> None:
    short = {
        "T_set": Estimate(5e-5, 6e-4, (0.0, 0.0014), "s"),
        "T_d": Estimate(0.05, 6e-4, (0.049, 0.051), "s"),
    }
    rows = {
        symbol: (value, told)
        for _, symbol, value, told, _ in ship_rows(replace(found, parameters=short), Say())
    }
    assert rows["T_set"] == ("at most 0.00140\u00a0s", "may be zero")
    assert rows["T_d"][0].startswith("0.05")


def test_nothing_moves_in_the_picture_before_the_dead_times_are_over() -> None:
    structure = fp.Structure.ship(["dead_time_loop", "dead_time_set_point"], torque="brake")
    values = {"tau_n": 1.0, "g": -0.5, "vK_p": 4.0, "vK_i": 6.0, "p": 2.0, "T_d": 0.06, "T_set": 0.25}
    times = np.arange(0.0, 3.0, 0.005)
    rows = _step(structure, values, times)
    for row in rows.values():
        assert not row[times < 0.31 - 1e-9].any()
    # Against the exact loop, by small steps of time.
    n, total, late, command = 0.0, 0.0, 60, np.zeros(3200)
    speed = np.zeros(3200)
    for k in range(3200):
        error = (1.0 if k >= 250 else 0.0) - n
        command[k] = 4.0 * error + 6.0 * total
        speed[k] = n
        total += 1e-3 * error
        n += 1e-3 * ((command[k - late] if k >= late else 0.0) - 0.5 * n - 2.0 * n)
    np.testing.assert_allclose(rows["dn"], speed[np.rint(times * 1000).astype(int)], atol=0.01)


def test_statistics_stand_behind_a_fold_with_plain_names(page: str, found) -> None:
    section = page[page.index('id="statistics"') :]
    assert section.index("<details>") < section.index("The model explains")
    share = f"{found.fit['dn']['nrmse_pct']:.1f}"
    assert (
        f"The model explains {share} % of the variation of the speed (root mean square), noise included."
        in section
    )


@pytest.mark.usefixtures("undrawn")
def test_parameters_that_the_data_do_not_determine_are_not_called_identifiable(found) -> None:
    told = {"p": Estimate(2.0, 0.01, (1.98, 2.02)), "T_d": Estimate(0.1, 0.2, (0.0, 0.8), "s")}
    partly = replace(found, parameters=told, identifiability=Identifiability(2, 2, 9.0), settings={})
    page = text_of(render(partly, []))
    assert "Not determined by the data: dead time in the loop (T_d)." in page
    assert "The data determine 1 of the 2 free parameters, but not T_d." in page
    assert "are identifiable" not in page


@pytest.mark.usefixtures("undrawn")
def test_what_a_comparison_compares_is_said_below_the_verdict(found) -> None:
    told = "Comparison: this fingerprint against earlier or later ones of the same drive train"
    assert told in first_screen(render(found, []))
    assert told not in render(replace(found, usable=SENTENCES["misfit"], **judged("misfit")), [])


@pytest.mark.usefixtures("undrawn")
def test_what_was_assumed_is_not_called_given(found) -> None:
    fixed = {name: Estimate(1.0, status="fixed", reason=name) for name in ("assumed", "given")}
    page = render(replace(found, parameters=fixed, settings={}), [])
    for name in fixed:
        row = re.search(rf'<th scope="row"><code>{name}</code>.*?</tr>', page)[0]
        assert re.findall(r"<td[^>]*>([^<]*)</td>", row)[-1] == name


def test_a_rank_without_a_condition_number_is_told_without_one() -> None:
    told = rank(Identifiability(3, 3, np.inf))
    assert told == "All 3 free parameters are identifiable."
    helped = rank(Identifiability(3, 3, np.inf), helped=["p", "g"])
    assert helped == f"{told} Of these, p and g are told only with the help of an expected range."
    assert "inf" not in told


@pytest.fixture(scope="module")
def partly(trial) -> fp.Fingerprint:
    """Return a fingerprint whose gains and inertia are known only together."""
    structure = fp.Structure.linear(torque="gauge", products=True, dead_time_loop=True, free_exponent=True)
    return fp.identify(trial, structure, noise="white", starts=1)


def test_where_parameters_are_open_their_combinations_are_told(partly) -> None:
    rows = {row[0]: row[2] for row in ship_rows(partly, Say())}
    assert rows["inertia time constant"] == "not identifiable"
    assert rows["proportional gain over inertia"].endswith("1/s")
    assert open_questions(partly, Say())[0].startswith(
        "Not determined by the data: inertia of the drive train (tau_n)"
    )


SENTENCES = {
    "all": Sentence(
        "Usable for simulation, control tuning and comparison: the data determine every parameter, but {rough} "
        "only roughly.",
        rough="g",
    ),
    "some": Sentence(
        "Usable for simulation and comparison, but not for control tuning: the data do not determine {unknown}, for "
        "which other values fit as well.",
        unknown=listed(["tau_n", "g"]),
    ),
    "misfit": Sentence("Not usable, because {what}.", what=Sentence(MISSES, share="12.5")),
    "nothing explained": Sentence(
        "Not usable, because {what}.",
        what=Sentence(
            "the model explains nothing of {outputs}", outputs=Sentence("the {name}", name=Sentence("torque"))
        ),
    ),
    "nothing told": "Not usable, because the data determine no parameter.",
    "no minimum": "Not usable, because the search did not end in a minimum; no figure is an estimate.",
}
STEPS = {
    "nothing explained": "a channel from another recording",
    "misfit": "Possible causes, in the order in which to look: sensors",
    "no minimum": "a longer recording",
    "nothing told": "a larger swing of the set point",
}
SMALL_MISSES = {"stands": True, "misses_pct": {"dn": 0.35, "dM": 0.98}}
SAME = {"PNG", "Hz", "kg", "Nm", "kW", "rpm", "Stan", "Tug", "Parameter", "Fingerprint", "chirp", "in", "was"}
"""Words that are the same in both languages: units, names, and what a user called the trial."""


def judged(which: str) -> dict[str, str]:
    """Return the fields that say the same as a sentence."""
    states = {"all": "usable", "some": "usable except"}
    return {"usability": states.get(which, "not usable"), "why_not": which if which in STEPS else ""}


def first_screen(page: str) -> str:
    return text_of(page[page.index("<header") : page.index("<h2")])


def words_of(text: str, symbols: frozenset[str]) -> set[str]:
    return {word for word in re.findall(r"[A-Za-zÄÖÜäöüß]{2,}", text) if word not in SAME} - symbols


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Leave pictures out: their captions alone are read."""
    monkeypatch.setattr(
        Pictures, "draw", lambda self, panels, paint, caption, **_: Markup("<p>{}</p>").format(caption)
    )


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("usable", SENTENCES)
@pytest.mark.parametrize("which", ["found", "partly"])
def test_no_english_word_is_left_on_the_german_first_screen(which, usable, trial, request) -> None:
    found = request.getfixturevalue(which)
    found = replace(
        found,
        usable=SENTENCES[usable],
        elements=ELEMENTS,
        verdict=(SENTENCES[usable],),
        adequate=SMALL_MISSES,
        **judged(usable),
        structure={**found.structure, "name": "ship: dead time in the loop, upper torque limit"},
    )
    screens = [
        first_screen(render(found, [trial], simulated=[found.predict(trial)], language=language))
        for language in ("en", "de")
    ]
    symbols = frozenset(re.findall(r"[A-Za-z]+", " ".join([*found.parameters, *found.derived])))
    english, german = (words_of(screen, symbols) for screen in screens)
    assert english & german == set()
    # Its numbers have a decimal comma, too; 12.5 is told as 12,5.
    assert re.findall(r"\d\.\d", screens[1]) == []
    assert len(re.findall(r"\d,\d", screens[1])) > 10 or usable == "no minimum"  # which shows no figure


@pytest.mark.usefixtures("undrawn")
def test_a_fingerprint_that_can_not_be_used_says_what_to_do_and_shows_no_loop(found, trial) -> None:
    for why_not, step in STEPS.items():
        unusable = replace(found, usable=SENTENCES[why_not], **judged(why_not))
        page = render(unusable, [trial], simulated=[found.predict(trial)])
        screen = first_screen(page)
        assert f'<p class="answer bad">{escape(SENTENCES[why_not])}' in page
        assert step in screen
        assert "phase margin" not in screen
        assert "Elements that act" not in screen
        # No figure of it looks like a result anywhere on the page.
        parameters = page[page.index('id="parameters"') : page.index('id="signals"')]
        assert '<table class="facts">' not in page
        assert not re.search(r">estimated|phase margin|class=\"good", parameters)
        assert "not to be used" in parameters
        assert "Estimates with their 95 % intervals" not in page


@pytest.mark.usefixtures("undrawn")
def test_the_colour_goes_by_the_state_and_not_by_words(found) -> None:
    for which, tone in (("all", "good"), ("some", "warn"), ("misfit", "bad")):
        page = render(replace(found, usable="Any sentence.", **judged(which)), [])
        assert f'<p class="answer {tone}">Any sentence.' in page


@pytest.mark.usefixtures("undrawn")
def test_the_german_page_is_german_for_a_saved_fingerprint_too(partly, trial, tmp_path) -> None:
    saved = replace(partly, usable=SENTENCES["all"]).save(tmp_path / "fingerprint.json")
    page = render(fp.Fingerprint.load(saved), [trial], simulated=[partly.predict(trial)], language="de")
    assert '<html lang="de">' in page
    told = text_of(page[page.index("<main>") : page.index('id="settings"')])
    assert "Brauchbar für Simulation" in told
    assert Say("de").name("tau_n") in told
    english = re.findall(
        r"\b(?:the|of|and|with|from|speed|torque|model|measured|interval|loop|samples)\b", told
    )
    assert english == []


def test_a_loop_that_can_not_be_linearised_is_left_out(found) -> None:
    joint = fp.Structure.joint({"a": fp.Structure.ship(), "b": fp.Structure.ship()}, ["p"])
    page = render(replace(found, structure=joint.to_dict()), [])
    assert 'id="loop"' not in page
    assert "phase margin" not in page


def test_an_estimate_at_an_end_of_its_interval_is_said_to_lie_there() -> None:
    rough = {"": Estimate(1.0, 0.5, (0.99, 3.0)), "middle": Estimate(2.0, 0.5, (1.0, 3.0))}
    told = [interval(row, rough[row.name], Say()) for row in rounded_rows(rough)]
    assert told == ["0.99 to 3.00, estimate at its lower end", "1.00 to 3.00"]


def test_figures_have_no_more_digits_than_their_interval_tells() -> None:
    (row,) = rounded_rows({"I": Estimate(12_345.0, 3_210.0, (6_053.0, 18_637.0), "kg m2")})
    assert (row.value, row.low, row.high) == ("12300", "6100", "18600")
