"""What Python users meet: every name through `fp`, wrong arguments told in one line, objects that compare and pickle."""

from __future__ import annotations

import inspect
import pickle
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.profile_likelihood import profile_likelihood
from shipfp_rs.support.toml import template

DOCS = Path(__file__).parents[2] / "docs"
PAGES = [DOCS / "background" / "api.md", *sorted((DOCS / "reference").glob("*.md"))]
LISTED = re.findall(
    r"auto(?:function|class):: shipfp_rs\.([\w.]+)",
    "".join(page.read_text(encoding="utf-8") for page in PAGES),
)
LAUNCH = fp.Vessel.load("stan-launch-804")
SHORT = fp.signals.steps([13.0], 1.0)
TRIAL = fp.simulate(LAUNCH, SHORT)
LINEAR = fp.Structure.linear(products=True)


def listed_on_page(path: str) -> object:
    """Return what stands on the page under a path."""
    module, _, name = path.rpartition(".")
    return getattr(import_module(f"shipfp_rs.{module}".rstrip(".")), name)


def test_the_api_page_has_every_name_of_fp_and_no_more_than_there_is() -> None:
    shown = {path.rpartition(".")[2] for path in LISTED} | {"InputError", "ShipfpError", "__version__"}
    assert set(fp.__all__) - shown - set(fp._MODULES) == set()
    assert [path for path in LISTED if listed_on_page(path).__name__ != path.rpartition(".")[2]] == []
    assert all(getattr(fp, name) is not None for name in fp.__all__)


@pytest.mark.parametrize("name", sorted(fp._WHERE))
def test_each_name_of_fp_has_a_page_with_an_example_under_its_public_path(name: str) -> None:
    page = (DOCS / "reference" / f"{name}.md").read_text(encoding="utf-8")
    assert f":: shipfp_rs.{name}\n" in page
    assert re.search(r"```python\n[^`]*```\n\n```text\n", page)


def test_a_page_can_hold_the_names_of_fp() -> None:
    assert len(fp.__all__) <= 34
    assert {"Estimate", "ladder"}.isdisjoint(fp.__all__)


FUNCTIONS = [listed for listed in LISTED if inspect.isroutine(listed_on_page(listed))]


@pytest.mark.parametrize("listed", FUNCTIONS)
def test_breakage_e1_every_public_function_refuses_a_wrong_argument_in_one_line(listed: str) -> None:
    function = listed_on_page(listed)
    needed = [one for one in inspect.signature(function).parameters.values() if one.default is one.empty]
    by_place = (
        inspect.Parameter.POSITIONAL_ONLY,
        inspect.Parameter.POSITIONAL_OR_KEYWORD,
        inspect.Parameter.VAR_POSITIONAL,
    )
    required = [object() for one in needed if one.kind in by_place]
    keyword_only = {one.name: object() for one in needed if one.kind is one.KEYWORD_ONLY}
    with pytest.raises(fp.InputError, match=r"[\w\]] is an object, expected") as found:
        function(*required, **keyword_only)
    assert "\n" not in str(found.value)


WRONG = {
    "a rate in quotes": (
        lambda: fp.Experiment("S1", "25", TRIAL.signals, TRIAL.operating_point),
        "experiment 'S1': rate_hz is '25', expected a number",
    ),
    "samples in quotes": (
        lambda: fp.Experiment("S1", 25.0, {"n_set": ["1", "2"]}, {"n_set": 1.0}),
        r"experiment 'S1': signals\['n_set'\] is a list of str, expected an array of real numbers",
    ),
    "complex samples": (
        lambda: fp.Experiment("S1", 25.0, {"n_set": np.ones(9) * 1j}, {"n_set": 1.0}),
        r"signals\['n_set'\] is an array of complex128, expected an array of real numbers",
    ),
    "a list for a mapping": (
        lambda: fp.Experiment("S1", 25.0, [1.0], {"n_set": 1.0}),
        "signals is a list of float, expected a mapping from a text to an array",
    ),
    "complex deviations": (
        lambda: replace(SHORT, samples=SHORT.samples * 1j),
        "samples is an array of complex128, .*real numbers",
    ),
    "swapped arguments": (lambda: fp.identify(LINEAR, TRIAL), "data is a Structure, .*; swap it with structure"),
    "a ship and its excitation swapped": (lambda: fp.simulate(SHORT, LAUNCH), "; swap it with excitation"),
    "an empty array for a list": (lambda: fp.signals.join(np.empty(0)), "excitations is empty, expected at least one"),
    "a seed below zero": (
        lambda: fp.identify(TRIAL, LINEAR, seed=-1),
        "identify: seed is -1, expected a whole number of 0 or more",
    ),
    "a time limit below zero": (
        lambda: fp.identify(TRIAL, LINEAR, time_limit_s=-1),
        "time_limit_s is -1, expected a positive number",
    ),
    "a value in quotes": (lambda: LINEAR.with_fixed(tau_n="1"), "with_fixed: tau_n is '1', expected a number"),
    "a value below zero": (lambda: LINEAR.with_fixed(tau_n=-5), "tau_n: fixed at -5 s, expected 0.01 to 10 s"),
    "a value that is no number": (lambda: LINEAR.with_fixed(g=float("nan")), "parameter g: start is nan"),
    "truth for a count": (lambda: fp.identify(TRIAL, LINEAR, starts=True), "starts is True, expected a whole number"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_breakage_e1_e2_wrong_arguments_cost_one_line(case: str) -> None:
    call, line = WRONG[case]
    with pytest.raises(fp.InputError, match=line) as found:
        call()
    assert "\n" not in str(found.value)


def test_numbers_of_any_kind_are_numbers() -> None:
    for rate in (25, np.float32(25.0), np.int64(25), np.array(25.0)):
        made = fp.Experiment("S1", rate, {"n_set": [1.0, 2, 3]}, {"n_set": 1.0})
        assert (made.rate_hz, type(made.rate_hz) in (int, float)) == (25.0, True)


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> list[object]:
    """What public functions return, and what they take."""
    path = tmp_path_factory.mktemp("trial") / "TRIAL.toml"
    path.write_text(template("TRIAL"), encoding="utf-8")
    long = fp.simulate(
        LAUNCH, fp.signals.chirp(0.05, 2.0, 60.0, 40.0, rate_hz=20.0), noise={"n_e": 0.2}, seed=1
    )
    found = fp.identify(long, LINEAR, intervals="symmetric")
    return [
        LAUNCH, SHORT, long, found, found["tau_n"], found.identifiability, fp.Sensors(), fp.Trial.load(path),
        fp.linearise(LAUNCH), fp.compare(found, found), fp.design(LAUNCH, duration_s=100.0), fp.Calibration(2.0, 1.0),
        profile_likelihood(long, LINEAR, ["tau_n"])[0],
    ]  # fmt: skip


def test_everything_is_shown_in_a_few_lines(results) -> None:
    assert [repr(one)[:300] for one in results if repr(one).count("\n") >= 10 or len(repr(one)) > 600] == []


RESPONSE = fp.linearise(LAUNCH).frequency_response([0.1, 1.0])


@pytest.mark.parametrize("thing", [TRIAL, RESPONSE, SHORT], ids=lambda thing: type(thing).__name__)
def test_breakage_e2_what_was_pickled_is_equal_and_what_differs_is_not(thing) -> None:
    again = pickle.loads(pickle.dumps(thing))
    assert again == thing
    assert hash(again) == hash(thing)
    assert len({thing, again}) == 1
    assert replace(thing, name="another") != thing
    assert thing != "another"


def test_breakage_e2_masked_samples_are_equal_and_a_single_other_one_is_not() -> None:
    masked = replace(
        TRIAL, signals={**TRIAL.signals, "n_e": np.where(TRIAL.time < 0.5, np.nan, TRIAL.signals["n_e"])}
    )
    assert pickle.loads(pickle.dumps(masked)) == masked
    assert masked != TRIAL
