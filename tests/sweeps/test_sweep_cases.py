"""Sweeps as people meet them in a notebook: how far they are, and a short word at the end."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.support.progress import heard_by
from shipfp_rs.sweeps import sweep
from tests.sweep_folders import cheap_plan


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Notebook(io.StringIO):
    __module__ = "ipykernel.iostream"


@pytest.mark.parametrize("kind", [Terminal, Notebook])
def test_cases_a_sweep_says_how_far_it_is(
    kind: type[io.StringIO], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", stream := kind())
    found = sweep(cheap_plan(4), tmp_path / "out", executor="threads", workers=1)
    said = stream.getvalue().split("\r")[1:]
    assert [line.split(",")[0] for line in said] == [f"{25 * k} %: {k} of 4 draws" for k in range(5)]
    assert "0 failed, about " in said[2]
    assert said[4].rstrip().endswith("about 0 s left")
    assert str(found).count("\n") < 10


def test_cases_a_pipe_stays_empty_and_a_listener_hears(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    heard: list[tuple[str, float]] = []
    with heard_by(lambda what, share: heard.append((what, share))):
        sweep(cheap_plan(2), tmp_path / "heard", executor="threads", workers=1)
    assert heard == [(f"{k} of 2 draws, 0 failed", 0.5 * k) for k in range(3)]
    sweep(cheap_plan(2), tmp_path / "silent", executor="threads", workers=1)
    assert capsys.readouterr().err == ""


OWN = """
name = "own"
[gearbox]
ratio = 2.5
"""
REST = {
    "water.density_kg_m3": 1025.0,
    "gearbox.efficiency": 0.96,
    "engine.rated_speed_rpm": 2000.0,
    "shaft.propeller_side_inertia_kg_m2": 8.0,
    "propeller.torque_exponent": 2.0,
    "propeller.diameter_m": 1.2,
    "propeller.blades": 4,
    "engine.cylinders": 6,
    "propeller.K_T": 0.4,
    "governor.K_p": 8.0,
    "governor.K_i": 2.0,
    "operating_point.n_e_rpm": 1500.0,
    "operating_point.X_0_mm": 10.0,
    "operating_point.M_b_Nm": 400.0,
    "operating_point.v": 1.4,
    "operating_point.g": -0.5,
}


def test_cases_a_sweep_of_one_s_own_vessel_names_all_that_its_file_lacks(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(OWN)
    factors = {"vessel.shaft.inertia_kg_m2": {"low": 20.0, "high": 30.0}}
    own = {"vessel": str(tmp_path / "own.toml")}
    with pytest.raises(InputError, match=r"lacks gearbox.efficiency, governor.K_p, .* add them to its file"):
        cheap_plan(2, sweep=own, factors=factors)
    with pytest.raises(InputError, match=r"found no section 'shat'; did you mean 'shaft'\?"):
        cheap_plan(2, sweep=own, factors={"vessel.shat.inertia_kg_m2": factors["vessel.shaft.inertia_kg_m2"]})
    for key, said in (
        ("operating_point.M_b_Nm", "expected M_b_Nm or M_s_Nm"),
        ("water.density_kg_m3", "water"),
    ):
        given = {name: value for name, value in REST.items() if name != key}
        with pytest.raises(InputError, match=f"SWEEP.toml: vessel .*{said}"):
            cheap_plan(2, sweep=own, factors=factors, vessel=given)


def test_cases_a_sweep_gives_tables_that_the_vessel_s_file_lacks(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(OWN)
    plan = cheap_plan(
        2,
        sweep={"vessel": str(tmp_path / "own.toml")},
        vessel=REST,
        factors={"vessel.shaft.inertia_kg_m2": {"low": 20.0, "high": 30.0}},
    )
    found = sweep(plan, tmp_path / "out", executor="threads", workers=1)
    assert found.summary["draws"]["done"] == 2, found.table(["message"]).to_pylist()
