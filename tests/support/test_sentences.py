"""Sentences keep the parts that they were made of: through pickle, through JSON, and whatever the parts hold."""

from __future__ import annotations

import copy
import json
import pickle

from shipfp_rs.support.sentences import Sentence, joined, listed, parts_of, with_parts

INNER = Sentence("{others} and {last}", others=joined(["tau_n", "{last}"]), last="g")
OUTER = Sentence("Known: {estimates}.", estimates=INNER, unused="nothing")


def test_a_sentence_is_its_english_text() -> None:
    assert OUTER == "Known: tau_n, {last} and g."
    assert listed(["tau_n", "{last}", "g"]) == INNER
    assert (listed([]), listed(["g"])) == ("", "g")
    assert set(OUTER.values) == {"estimates"}


def test_its_parts_survive_copies_and_json() -> None:
    for made in (pickle.loads(pickle.dumps(OUTER)), copy.deepcopy(OUTER)):
        assert made == OUTER
        assert made.template == OUTER.template
        assert made.values["estimates"].values == INNER.values
    content = {"verdict": [OUTER, "No part of it."], "count": 3}
    parts = json.loads(json.dumps(parts_of(content)))
    read = with_parts(
        json.loads(json.dumps(content)), {text: Sentence.from_dict(entry) for text, entry in parts.items()}
    )
    assert read == content
    assert read["verdict"][0].to_dict() == OUTER.to_dict()
