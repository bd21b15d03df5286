"""The report's languages: every text has its own in each catalogue, and no verdict stays English."""

from __future__ import annotations

import gettext
import re

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.identification.fit_statistics import information_criteria
from shipfp_rs.report.findings import FIGURES
from shipfp_rs.report.markup import Say
from shipfp_rs.structures import glossary, names
from shipfp_rs.structures.elements import ELEMENTS
from shipfp_rs.support import sentences
from shipfp_rs.support.sentences import CATALOGUES, DOMAIN, FIELD, LANGUAGES, Sentence, joined, listed
from tests.report.catalogues import read, said, update

OTHERS = [language for language in LANGUAGES if language != "en"]
SAID = said()


@pytest.fixture(scope="module", params=OTHERS)
def texts(request) -> dict[str, str]:
    return {one.id: one.string for one in read(request.param) if one.id}


def test_every_text_of_a_report_is_translated_and_no_other_one(texts) -> None:
    assert len(SAID) > 400
    assert [text for text in SAID if not texts.get(text)] == []
    assert set(texts) - set(SAID) == set()


def test_a_translation_has_the_same_fields(texts) -> None:
    assert [text for text, own in texts.items() if {*FIELD.findall(text)} != {*FIELD.findall(own)}] == []


@pytest.mark.parametrize("language", OTHERS)
def test_what_is_read_at_run_time_is_compiled_from_the_texts(language) -> None:
    compiled = gettext.translation(DOMAIN, CATALOGUES, [language])
    assert {one.id: compiled.gettext(one.id) for one in read(language) if one.id} == {
        one.id: one.string for one in read(language) if one.id
    }


def test_a_language_is_added_by_its_own_files_alone(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("tests.report.catalogues.CATALOGUES", tmp_path)
    assert update("nl") == [*SAID]
    file = tmp_path / "nl" / "LC_MESSAGES" / f"{DOMAIN}.po"
    text = file.read_text().replace('msgid "speed"\nmsgstr ""', 'msgid "speed"\nmsgstr "toerental"')
    file.write_text(text.replace('msgid "1.5"\nmsgstr ""', 'msgid "1.5"\nmsgstr "1,5"'))
    assert len(update("nl")) == len(SAID) - 2
    assert sentences.found(tmp_path) == ("en", "nl")
    monkeypatch.setattr(sentences, "CATALOGUES", tmp_path)
    monkeypatch.setattr("shipfp_rs.report.markup.LANGUAGES", sentences.found(tmp_path))
    say = Say("nl")
    assert (say("speed"), say("torque"), say.number("0.25")) == ("toerental", "torque", "0,25")


def test_a_sentence_is_said_from_its_parts_whatever_they_hold() -> None:
    outputs = [Sentence("the {name}", name=Sentence(name)) for name in ("speed", "torque")]
    what = Sentence("the model explains nothing of {outputs}", outputs=listed(outputs))
    sentence = Sentence("Not usable, because {what}.", what=what)
    assert sentence == "Not usable, because the model explains nothing of the speed and the torque."
    assert Say()(sentence) == sentence
    german = Say("de")(sentence)
    assert "Drehzahl und Drehmoment" in german
    assert "nothing" not in german
    odd = Sentence("Known: {estimates}.", estimates=joined(["{estimates} = 1.25", "1.25"], "; "))
    assert Say("de")(odd) == "Bekannt: {estimates} = 1.25; 1,25."


@pytest.mark.parametrize(
    ("label", "german"),
    [
        ("speed $n_e$ [rpm]", "Drehzahl $n_e$ [rpm]"),
        ("set point n_set", "Sollwert n_set"),
        ("speed [rpm]", "Drehzahl [rpm]"),
        ("masked (0.25 %)", "ausgeblendet (0,25 %)"),
        ("lag [samples]", "Abstand [Messwerte]"),
        ("M_b", "M_b"),
    ],
)
def test_a_label_keeps_its_symbols_and_units(label, german) -> None:
    assert Say("de").label(label) == german
    assert Say().label(label) == label


def test_every_figure_of_a_fit_has_a_name() -> None:
    figures = information_criteria(np.eye(2), 100, 3)
    assert set(figures) <= set(FIGURES)


def test_every_symbol_in_a_formula_is_explained() -> None:
    named = {symbol for term in glossary.LINEAR for symbol in re.findall(r"[^\W\d]\w*", term.formula)}
    assert named - {term.symbol for term in glossary.LINEAR} - {"exp", "n", "π"} == {
        term.symbol for term in glossary.FORMULAS
    }


@pytest.mark.parametrize("language", LANGUAGES)
def test_names_go_with_a_generating_set_and_an_electric_motor(language) -> None:
    say = Say(language)
    told = [say.name(symbol) for symbol in names.NAMES]
    told += [say(one.words) for one in ELEMENTS.values()]
    told += [say.meaning(symbol) for symbol in names.NAMES]
    assert (
        re.findall(r"(?i)propeller\w*|engine|fuel|rack\b|\bmotor|füllung|kraftstoff\w*", " ".join(told)) == []
    )


def test_an_experiment_is_called_by_name_and_by_what_the_set_point_did() -> None:
    assert Say("en").called("X1", "chirp") == "X1 (set point: chirp, a gliding sine)"
    assert Say("en").called("X1", "steps", "load") == "X1 (load: steps)"
    assert Say("de").called("X1", "chirp") == "X1 (Sollwert: Gleitsinus)"
    assert Say("en").called("X1", "") == "X1"


def test_another_language_is_refused() -> None:
    with pytest.raises(InputError, match=f"language is 'xx', expected one of {', '.join(LANGUAGES)}"):
        Say("xx")
