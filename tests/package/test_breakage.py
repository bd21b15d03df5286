"""What was found when everything was tried hard, where it spans rooms: one meaning, one unit, one default, no dead code."""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
import re
from abc import ABCMeta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

import shipfp_rs as fp
from shipfp_rs import _core, cli
from shipfp_rs.assessment.si import in_si, parameters_of, with_parameters
from shipfp_rs.identification.fingerprint import Estimate, Identifiability
from shipfp_rs.processing.trial import Identify
from shipfp_rs.structures.structure import Structure
from shipfp_rs.sweeps import Plan
from shipfp_rs.vessel.steady_state import steady_state

FOLDER = Path(fp.__file__).parent
TUG = fp.Vessel.load("stan-tug-1205-full")
LOOP = ("dead_time_loop", "dead_time_set_point")


def test_breakage_b8_every_kernel_has_a_caller() -> None:
    sources = "\n".join(path.read_text(encoding="utf-8") for path in FOLDER.rglob("*.py"))
    kernels = {name for name in dir(_core) if not name.startswith("_")}
    called = set(re.findall(r"\b_core\.(\w+)", sources))
    for line in re.findall(r"from shipfp_rs\._core import ([^\n(]+|\([^)]+\))", sources):
        called |= set(re.findall(r"\w+", line))
    assert kernels <= called


@pytest.fixture(scope="module")
def chirp() -> fp.Experiment:
    asked = fp.signals.chirp(0.01, 2.0, 60.0, 40.0, law="logarithmic", rate_hz=50.0)
    return fp.simulate(TUG, asked, noise={"n_e": 0.02, "M_g": 0.02}, seed=3)


def test_breakage_a10_tau_n_has_one_meaning_beside_a_drag(chirp) -> None:
    """Eq. 3.23: the inertia's torque is that of the shaft, behind the drag, wherever tau_n is computed or taken apart."""
    assert TUG.gearbox.drag_Nm > 0.0
    point, model = steady_state(TUG), fp.linearise(TUG)
    expected = 2.0 * math.pi * point.n_s * TUG.inertia / point.M_s
    assert model.tau_n == pytest.approx(expected, rel=1e-12)
    assert parameters_of(TUG)["tau_n"] == pytest.approx(expected, rel=1e-12)
    twice = with_parameters(TUG, {"tau_n": 2.0 * expected})
    assert twice.inertia == pytest.approx(2.0 * TUG.inertia, rel=1e-9)
    found = fp.Fingerprint(
        {"tau_n": Estimate(expected, unit="s", status="fixed")},
        {},
        Identifiability(0, 0, 1.0),
        {},
        {},
        data=({"operating_point": dict(chirp.operating_point), "signals": {"dM": "M_g"}},),
    )
    assert in_si(found, TUG)["inertia"]["value"] == pytest.approx(TUG.inertia, rel=1e-3)


def test_breakage_a10_the_rack_is_the_same_place_in_every_structure() -> None:
    """dX is the fuel that the torque follows: behind the dead time in the loop."""
    values = {
        "tau_n": 1.17,
        "g": -0.6,
        "v": 1.4,
        "K_p": 3.8,
        "K_i": 9.0,
        "p": 2.17,
        "T_d": 0.09,
        "T_set": 0.25,
    }
    outputs, frequency = ("dn", "dM", "dX"), np.geomspace(0.02, 3.0, 12)
    model = type(fp.linearise(TUG))(**values, tau_prop=0.4)
    one = model.response(frequency, ("dn", "dM_b", "dX"))
    ship = Structure.ship(LOOP, outputs=outputs, products=False)
    other = ship.equations.response(values, frequency, ())[0]
    np.testing.assert_allclose(one, other, rtol=1e-9)
    with pytest.raises(fp.InputError, match="the governor's command, not the rack behind its dead time"):
        Structure.linear(outputs=outputs, dead_time_loop=True)
    speed, torque, rack = other
    np.testing.assert_allclose(torque, values["g"] * speed + values["v"] * rack, rtol=1e-9)


def test_breakage_e4_accuracy_is_in_per_cent_everywhere() -> None:
    group: Any = typer.main.get_command(cli.app)
    for command in ("design", "sweep"):
        (option,) = (one for one in group.commands[command].params if "--accuracy" in one.opts)
        assert option.metavar == "PERCENT"
        assert "%" in option.help
    for function in (fp.design, fp.sweep):
        assert "accuracy_pct" in inspect.signature(function).parameters
    for percent in (1e-9, 1e9):
        with pytest.raises(fp.InputError, match=re.escape(f"accuracy_pct is {percent:g}, expected")):
            fp.design("stan-launch-804", duration_s=60.0, accuracy_pct=percent)
        with pytest.raises(fp.InputError, match=re.escape(f"accuracy_pct is {percent:g}, expected")):
            fp.sweep("duration", "nowhere", accuracy_pct=percent)


def test_breakage_e4_defaults_of_starts_and_products_are_the_same_everywhere() -> None:
    asked = inspect.signature(fp.identify).parameters["starts"].default
    trial, sweep = Identify(), Plan.load("duration").identify
    assert trial.starts is sweep.starts is asked is None
    products = inspect.signature(Structure.ship).parameters["products"].default
    assert trial.products is products is True


def test_breakage_e4_what_has_abstract_methods_can_not_be_made() -> None:
    for module in pkgutil.walk_packages([str(FOLDER)], "shipfp_rs."):
        if ".cli.__main__" in module.name or module.name.endswith(("_core", "child_process")):
            continue
        for _, owner in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if owner.__module__.startswith("shipfp_rs") and any(
                getattr(member, "__isabstractmethod__", False) for member in vars(owner).values()
            ):
                assert isinstance(owner, ABCMeta) or getattr(owner, "_is_protocol", False), owner


def test_breakage_a4_a_fingerprint_whose_dead_times_are_told_as_a_sum_is_compared(chirp, tmp_path) -> None:
    structure = Structure.linear(
        torque="gauge", products=True, free_exponent=True, **dict.fromkeys(LOOP, True)
    )
    path, picture = tmp_path / "ship.json", tmp_path / "change.png"
    found = fp.identify(chirp.window(0.0, 20.0), structure, starts=1)
    found.save(path)
    assert cli.main(["compare", str(path), str(path), "--out", str(picture)]) == 0
    assert picture.stat().st_size > 10_000
    # What has a value has an interval of its size, and no bounded quantity is left out.
    for name, estimate in found.items():
        if estimate.std is not None:
            assert estimate.std < 10.0 * max(abs(estimate.value), 1.0), name


def test_breakage_a11_what_is_missed_by_nothing_is_no_contradiction() -> None:
    """A noise-free record tells any error of the simulation; one of a millionth is none of the structure's."""
    asked = fp.signals.chirp(0.002, 10.0, 300.0, 13.0, law="logarithmic", rate_hz=200.0)
    found = fp.identify(
        fp.simulate(fp.Vessel.load("stan-launch-804"), asked), Structure.linear(), noise="white"
    )
    assert not any("contradict" in line for line in found.verdict)
    assert found.fit["dn"]["whiteness_p"] < 1e-6


def test_breakage_a11_a_missing_dead_time_stays_one(chirp) -> None:
    structure = Structure.linear(torque="gauge", products=True, free_exponent=True)
    assert any("contradict" in line for line in fp.identify(chirp, structure, starts=1).verdict)
