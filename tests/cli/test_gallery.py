"""Inputs of the gallery, five hundred at night: every one is status 0 or 2, in one line, without a word of the code."""

from __future__ import annotations

from typing import Any, Literal, get_args, get_origin

import pytest

from shipfp_rs.support.arguments import _hints
from tests.gallery.calls import Call, table
from tests.gallery.inputs import inputs
from tests.gallery.outcome import outcome

COUNT = 500


@pytest.mark.parametrize(
    ("seed", "count"), [(0, 30), *(pytest.param(one, COUNT // 5, marks=pytest.mark.slow) for one in range(5))]
)
def test_breakage_d_slips_of_any_kind_cost_one_line(folder, seed, count):
    for given in inputs(folder, count, seed):
        found = outcome(given, folder)
        assert not found.broken, (given, found)


def test_inputs_without_a_slip_pass(folder):
    kept = [given for given in inputs(folder, 600, 0) if given.about == "nothing"]
    assert kept
    assert all(outcome(given, folder).status == 0 for given in kept[:2])


def test_breakage_d_a_word_that_is_none_of_those_known_is_refused(folder):
    tried = []
    for name, (function, arguments) in table(folder).items():
        hints = _hints(getattr(function, "__wrapped__", function))
        for key in [key for key, hint in hints.items() if key != "return" and _has_words(hint)]:
            given: list[Any] = ["auto", ""]
            if get_origin(hints[key]) is not Literal:
                given += [["auto"]]
            for value in given:
                call = Call(name, function, {**arguments, key: value}, f"{key} = {value!r}")
                found = outcome(call, folder)
                assert found.status == 2, (call, found)
            tried.append((name, key))
    assert {("Experiment", "hold"), ("identify, chosen", "noise"), ("chirp", "law")} <= set(tried)


def _has_words(hint: Any) -> bool:
    return get_origin(hint) is Literal or any(_has_words(inner) for inner in get_args(hint))
