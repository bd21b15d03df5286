"""The report's two languages: every sentence has its German one, and no verdict stays English."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

import shipfp_rs.report
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fit_statistics import information_criteria
from shipfp_rs.report.charts import BUTTONS, HELP
from shipfp_rs.report.driven import replacements
from shipfp_rs.report.elements import STATES
from shipfp_rs.report.findings import FIGURES, IN_FORMULAS
from shipfp_rs.report.german import SENTENCES
from shipfp_rs.report.german_words import ELEMENTS as GERMAN_ELEMENTS
from shipfp_rs.report.language import Say
from shipfp_rs.structures import glossary, names
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.vessel.vessel import Vessel

SOURCES = sorted(Path(shipfp_rs.report.__file__).parent.glob("*.py"))


def said_in(source: Path) -> set[str]:
    """Return the sentences that a module of the report says, and the heads of its tables."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "say":
            first = node.args[0]
            texts = [first.body, first.orelse] if isinstance(first, ast.IfExp) else [first]
            found |= {text.value for text in texts if isinstance(text, ast.Constant)}
        is_head = isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "head"
        if is_head and isinstance(node.value, ast.List):
            found |= {part.value for part in node.value.elts if isinstance(part, ast.Constant) and part.value}
        if isinstance(node, ast.ListComp) and "say(text)" in ast.unparse(node):
            found |= {
                part.value
                for part in ast.walk(node.generators[0].iter)
                if isinstance(part, ast.Constant) and part.value
            }
    return found


def test_every_sentence_of_the_report_has_a_german_one() -> None:
    said = set().union(*map(said_in, SOURCES)) | {*BUTTONS, HELP, *STATES.values(), *FIGURES.values()}
    said |= {*IN_FORMULAS.values()}
    assert len(said) > 100
    assert said - set(SENTENCES) == set()


def test_every_figure_of_a_fit_has_a_name() -> None:
    figures = information_criteria(np.eye(2), 100, 3)
    assert set(figures) <= set(FIGURES)


def test_german_sentences_have_the_same_gaps() -> None:
    def gaps(text: str) -> set[str]:
        return {name for _, name, _, _ in Formatter().parse(text) if name}

    assert [text for text, german in SENTENCES.items() if gaps(text) != gaps(german)] == []


def test_every_element_has_a_german_name() -> None:
    assert {element.words for element in ELEMENTS.values()} <= set(GERMAN_ELEMENTS)


def test_every_symbol_in_a_formula_is_explained() -> None:
    named = {symbol for term in glossary.LINEAR for symbol in re.findall(r"[^\W\d]\w*", term.formula)}
    assert named - {term.symbol for term in glossary.LINEAR} - {"exp", "n", "π"} == set(IN_FORMULAS)


DIRECT = Vessel.load("direct-drive")
MEASURED_LOAD = Experiment(
    "S1", 10.0, {"n_set": np.ones(3), "M_load": np.ones(3)}, {"n_set": 1.0, "M_load": 1.0}
)


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_drive_without_propeller_and_engine_has_neither_in_any_word(language) -> None:
    say = Say(language, replacements(DIRECT, [], language))
    said = [text for text in (*SENTENCES, *IN_FORMULAS.values()) if "channel" not in text]
    told = [say(text) for text in said] + [say.word(element.words) for element in ELEMENTS.values()]
    told += [text for symbol in names.NAMES for text in (say.name(symbol), say.meaning(symbol))]
    assert re.findall(r"(?i)propeller\w*|engine|fuel|rack\b|füllung|kraftstoff\w*", " ".join(told)) == []


def test_a_ship_keeps_its_words_and_a_measured_load_has_no_propeller() -> None:
    assert replacements(Vessel.load("stan-tug-1205"), [], "en") == ()
    assert replacements(None, [], "en") == ()
    say = Say("en", replacements(None, [MEASURED_LOAD], "en"))
    assert say.name("p") == "load exponent"
    assert say.name("v") == "slope of engine torque with fuel rack"


def test_an_experiment_is_called_by_name_and_by_what_the_set_point_did() -> None:
    assert Say("en").called("X1", "chirp") == "X1 (set point: chirp, a gliding sine)"
    assert Say("de").called("X1", "chirp") == "X1 (Sollwert: Gleitsinus)"
    assert Say("en").called("X1", "") == "X1"


VERDICTS = [
    "Not usable, because the data determine no parameter.",
    "Not usable, because the model misses 12 % of the response to the set point.",
    "Not usable, because the search did not end in a minimum; no figure is an estimate.",
    "Not usable, because the model explains nothing of the torque.",
    "Not usable, because the model explains nothing of the speed and the torque.",
    "Usable for simulation and comparison, but the data do not determine v: other values fit as well.",
    "Usable for simulation and comparison, but the data do not determine tau_n, g and v: other values fit as well.",
    "Usable for simulation and comparison, but the data do not determine g and p, and determine tau_n and v only roughly: "
    "other values fit as well.",
    "Usable for simulation and comparison, but its intervals hold for the model, not for the drive train: the model misses "
    "4.2 % of the response to the set point.",
    "Usable for simulation and comparison, but the model misses 4.2 % of the response to the set point.",
    "Usable for simulation, control tuning and comparison: the data determine every parameter.",
    "Usable for simulation, control tuning and comparison: the data determine every parameter, tau_n and g only roughly.",
    "Known: tau_n = 1.13 (0.6627 to 1.597) s; g = -0.5158 (-1.623 to 0.5905).",
    "Acting elements: dead time of the set point, delay of the torque channel.",
    "Not found to act: lag of the fuel actuator (tau_act below 0.000717 s, 95 %), upper torque limit (M_max above 1.12, "
    "95 %).",
    "The residuals show that something small is missing (0.35 % of the speed, 0.98 % of the torque); every interval is "
    "widened by what that can do.",
    "The residuals show that something is missing (4.2 % of the speed); every interval is widened by what that can do.",
    "According to this model: tau_n = 1.13 (0.6627 to 1.597) s.",
    "Undecided, with and without it the model fits as well: torsionally flexible shaft; the intervals hold for both.",
    "Set point and speed lie apart at the operating point of 'W1', 1184 and 1243 rpm: a governor with an integral part "
    "leaves no difference; look at the set point's calibration.",
    "The torque M_b is 22.3 Nm at 1300 rpm, where the vessel's file makes 222.9 Nm: look at its scale; inertias and gains "
    "in SI units are wrong by the same factor.",
]


@pytest.mark.parametrize("sentence", VERDICTS)
def test_what_the_choice_by_the_data_says_is_said_in_german(sentence: str) -> None:
    german = Say("de").sentence(sentence)
    assert not re.search(r"\b(the|of|and|or|to|not|for|is|are|below|above|with|speed|torque)\b", german), (
        german
    )
    told = re.findall(r"-?\d+,?\d*", german.replace("95-%", "95 %"))
    assert [number.replace(",", ".") for number in told] == re.findall(r"-?\d+\.?\d*", sentence)
    assert Say("en").sentence(sentence) == sentence


def test_another_language_is_refused() -> None:
    with pytest.raises(InputError, match="language is 'fr', expected one of en, de"):
        Say("fr")
