"""The score of a fingerprint beside the truth of a draw."""

from __future__ import annotations

import pytest

from tests.families import score
from tests.families.score import agreement, apart

BASE = {"tau_n": 1.2, "g": -0.5, "vK_p": 4.5, "vK_i": 10.0, "p": 2.15, "tau_prop": 0.38}


def answer(**parameters):
    return {
        "parameters": {
            name: {"value": value, "std": std, "ci95": [value - 2 * std, value + 2 * std], "status": status}
            for name, (value, std, status) in parameters.items()
        }
    }


def test_score_of_an_answer_with_sums_apart_and_an_alias_as_such():
    truth = BASE | {"T_d": 0.05, "T_set": 0.0, "T_s": 0.0, "damping": 0.0, "K_p/K_i": 0.45}
    given = answer(
        tau_n=(1.21, 0.01, "free"),
        p=(2.3, 0.01, "free"),
        T_d=(0.054, 0.0001, "free"),
        vK_p=(50.0, 1.0, "at_bound"),
        T_set=(0.0, 0.01, "at_bound"),
        g=(-0.5, 0.1, "prior"),
    )
    given["derived"] = {"(p-g)/tau_n": {"value": 2.2, "std": 0.01, "ci95": [2.18, 2.22]}}
    given["elements"] = {"T_d": {"state": "on"}, "sampling": {"state": "on"}, "T_set": {"state": "off"}}
    found = score.score(given, {"parameters": truth, "on": ["T_d"]})
    rows = found["parameters"]
    assert {name for name in rows if rows[name].get("inside")} == {"tau_n", "(p-g)/tau_n"}
    # 4 ms are below the 5 ms that count; T_set is on the bound, and so is the truth.
    assert {name for name in rows if rows[name]["gross"]} == {"p", "vK_p"}
    assert set(rows) == {"tau_n", "p", "T_d", "vK_p", "T_set", "(p-g)/tau_n"}
    kinds = {name: row["kind"] for name, row in found["elements"].items()}
    assert (kinds["T_d"], kinds["T_s"], kinds["T_set"]) == ("found", "false", "rightly not on")
    truth = BASE | {"T_d": 0.0, "T_set": 0.0, "T_s": 0.04, "update": 1.0, "damping": 0.0}
    given = answer(T_d=(0.02, 0.001, "free"), vK_p=(4.7, 0.01, "free"))
    verdicts = {"T_s": {"verdict": "idle"}, "M_max": {"verdict": "matters"}}
    found = score.score(given, {"parameters": truth, "on": ["T_s", "M_max"]}, verdicts)
    rows = found["parameters"]
    keys = ("inside", "inside_as_told", "gross", "gross_as_told")
    assert [rows["T_d"][key] for key in keys] == [False, True, True, False]
    assert rows["vK_p"]["inside_as_told"]
    kinds = {name: row["kind"] for name, row in found["elements"].items()}
    assert (kinds["T_d"], kinds["T_s"], kinds["M_max"]) == ("alias", "unseen", "missed")
    counts = score.summary([found, found])
    assert counts["parameters"]["T_d"]["known"] == 2
    assert counts["elements"]["M_max"] == {"missed": 2}
    assert "T_d" in score.table(counts)


def test_binomial_intervals_are_clopper_and_pearson_s():
    """Clopper and Pearson (1934): 0 of 10 up to 0.308, 9 of 10 from 0.555 to 0.997."""
    assert score.binomial(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)
    assert score.binomial(9, 10) == pytest.approx((0.5550, 0.9975), abs=1e-4)


def test_combinations_are_read_as_arithmetic_only():
    assert score.evaluated("(p-g)/tau_n", BASE) == pytest.approx(2.65 / 1.2)
    assert score.evaluated("(p-g)/(vK_i)+T_set-T_f", BASE | {"T_set": 0.1, "T_f": 0.0}) == pytest.approx(
        0.365
    )
    assert score.evaluated("v", BASE) is None
    assert score.evaluated("__import__('os')", BASE) is None


def test_windows_agree_where_each_value_lies_within_every_interval():
    one = answer(tau_n=(1.0, 0.1, "free"), p=(2.0, 0.1, "free"), g=(-0.5, 0.1, "prior"))
    near = answer(tau_n=(1.15, 0.1, "free"), p=(2.0, 0.1, "free"), g=(3.0, 0.1, "prior"))
    surer = answer(tau_n=(1.15, 0.05, "free"), p=(2.3, 0.2, "free"))
    assert apart([one, near]) == []
    assert apart([one, near, surer]) == ["tau_n", "p"]
    ships = [
        ("tug", 1, one),
        ("tug", 1, near),
        ("tug", 2, one),
        ("tug", 2, None),
        ("tug", 3, one),
        ("tug", 3, surer),
    ]
    told = agreement([{"family": family, "seed": seed, "answer": given} for family, seed, given in ships])
    assert told.splitlines()[-1].endswith("1 of 3 ships")
    assert "tug 2: 1 of 2 windows without an answer" in told
