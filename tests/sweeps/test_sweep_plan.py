"""SWEEP.toml and its designs: mistakes are named, and every draw follows from its index alone."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.support.toml import template, validated
from shipfp_rs.sweeps import Plan
from shipfp_rs.sweeps.plan import BLOCK, place, seed_of

TWO_FACTORS: dict[str, Any] = {
    "excitation.amplitude_rpm": {"low": 10.0, "high": 1000.0, "scale": "log"},
    "noise.level": {"low": 0.0, "high": 4.0},
}


def plan(factors: dict[str, Any] | None = None, **sweep: Any) -> Plan:
    header = {"vessel": "stan-launch-804", "draws": 8} | sweep
    header = {key: value for key, value in header.items() if value is not None}
    return validated({"sweep": header, "factors": factors or {}}, Plan, "SWEEP.toml").checked("SWEEP.toml")


def drawn(of: Plan, key: str) -> np.ndarray:
    return np.array([of.factor_values(index)[key] for index in range(of.draws)])


LOG = {"chain": "log"}


class TestFile:
    def test_the_template_is_valid_as_it_stands(self, tmp_path: Path) -> None:
        path = tmp_path / "SWEEP.toml"
        path.write_text(template("SWEEP"), encoding="utf-8")
        assert Plan.load(path).draws == 1000

    def test_every_line_of_the_template_that_is_commented_out_is_valid_too(self, tmp_path: Path) -> None:
        text = "\n".join(
            line.removeprefix("# ") if line.startswith(('# "', "# [")) or " = " in line[:20] else line
            for line in template("SWEEP").splitlines()[2:]
        )
        assert "operating_point.n_e_rpm" in tomllib.loads(text)["factors"]
        path = tmp_path / "SWEEP.toml"
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=r"faults\.A: found it with chain 'experiment'"):
            Plan.load(path)
        text = re.sub(r"\[noise\].*?(?=\n\[)", "", text, flags=re.DOTALL).replace('"experiment"', '"log"', 1)
        kept = [line for line in text.splitlines() if not line.startswith(('"noise', "rate_hz = 50.0"))]
        path.write_text("\n".join(kept), encoding="utf-8")
        stated = Plan.load(path)
        assert stated.faults.A == 6.0
        assert stated.sweep.time_limit_s == 60.0

    @pytest.mark.parametrize("name", Plan.names())
    def test_the_built_in_studies_load(self, name: str) -> None:
        assert Plan.load(name).draws > 0

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            ({"sweep": {}, "nois": {}}, "nois: found an unknown key, did you mean 'noise'?"),
            ({"factors": {"noise.levl": {"values": [1.0]}}}, "did you mean 'noise.level'?"),
            ({"factors": {"nose.level": {"values": [1.0]}}}, "did you mean 'noise'?"),
            ({"factors": {"identify.products": {"values": [True]}}}, "expected a key of the file"),
            ({"factors": {"noise.level": {"low": 1.0}}}, "expected values, or low and high, or mean and std"),
            ({"factors": {"noise.level": {"low": 2.0, "high": 1.0}}}, "expected more than low, 2"),
            ({"factors": {"noise.level": {"low": 0.0, "high": 1.0, "scale": "log"}}}, "a positive number"),
            ({"factors": {"noise.level": {"low": -1.0, "high": 1.0}}}, "noise.level: found -0.98"),
            ({"factors": {"vessel.shaft.inertia": {"values": [20.0]}}}, "did you mean 'inertia_kg_m2'?"),
            ({"sweep": {"design": "grid"}}, "expected repeats for a grid, draws for any other design"),
            ({"sweep": {"draws": None}}, "expected repeats for a grid, draws for any other design"),
            (
                {"sweep": {"design": "grid", "draws": None}, "factors": TWO_FACTORS},
                "values or points for a grid",
            ),
            ({"sweep": {"vessel": "stan-lunch-804"}}, "did you mean 'stan-launch-804'?"),
            ({"sweep": LOG, "sensors": {"receiver_limit_V": 1e15}}, "receiver_limit_V: found 1000"),
            ({"sweep": LOG, "sensors": {"rate_hz": 1e6}}, "found 180 s at 1e+06 Hz"),
            ({"sweep": LOG, "noise": {"n_e": 0.1}}, "noise.n_e: found it with chain 'log'"),
            ({"sweep": LOG, "excitation": {"rate_hz": 20.0}}, "excitation.rate_hz: found it"),
            ({"factors": {"sensors.edge_s": {"values": [0.1]}}}, "sensors.edge_s: found it with chain 'exp"),
            ({"excitation": {"duration_s": 1e6}}, "1e+06 s at 50 Hz, expected at most 5000000 samples"),
            ({"identify": {"seed": 3}}, "identify.seed: found 3, expected none"),
            ({"identify": {"fixed": {"tau_m": 1.0}}}, "has no parameter 'tau_m'"),
        ],
    )
    def test_a_mistake_is_named_before_the_first_draw(self, content: dict[str, Any], words: str) -> None:
        header = {"vessel": "stan-launch-804", "draws": 8} | content.get("sweep", {})
        content = content | {"sweep": {key: value for key, value in header.items() if value is not None}}
        with pytest.raises(InputError) as caught:
            validated(content, Plan, "SWEEP.toml").checked("SWEEP.toml")
        assert str(caught.value).startswith("SWEEP.toml: ")
        assert words in str(caught.value)


class TestDesign:
    def test_a_grid_is_gone_through_whole_before_it_is_repeated(self) -> None:
        grid = plan(
            {"noise.level": {"values": [1.0, 2.0]}, "noise.n_e": {"low": 0.1, "high": 0.3, "points": 3}},
            design="grid",
            draws=None,
            repeats=2,
        )
        cells = [tuple(grid.factor_values(index).values()) for index in range(grid.draws)]
        assert cells[:6] == cells[6:]
        assert len(set(cells)) == 6
        np.testing.assert_allclose(sorted({cell[1] for cell in cells}), [0.1, 0.2, 0.3])

    def test_a_latin_hypercube_meets_every_stratum_of_every_factor_once(self) -> None:
        latin = plan(TWO_FACTORS, design="latin", draws=50)
        decades = np.log10(drawn(latin, "excitation.amplitude_rpm") / 10.0) / 2.0
        assert sorted(np.floor(50 * decades)) == list(range(50))
        assert sorted(np.floor(50 * drawn(latin, "noise.level") / 4.0)) == list(range(50))

    def test_a_sobol_design_has_one_draw_in_every_cell_of_its_elementary_boxes(self) -> None:
        sobol = plan(TWO_FACTORS, design="sobol", draws=64)
        x = np.log10(drawn(sobol, "excitation.amplitude_rpm") / 10.0) / 2.0
        y = drawn(sobol, "noise.level") / 4.0
        cells = set(zip(np.floor(8 * x), np.floor(8 * y), strict=True))
        assert len(cells) == 64

    @pytest.mark.parametrize("design", ["random", "latin", "sobol"])
    def test_a_normal_factor_has_its_mean_and_deviation(self, design: str) -> None:
        inertia = drawn(
            plan({"vessel.shaft.inertia_kg_m2": {"mean": 21.0, "std": 2.0}}, design=design, draws=1000),
            "vessel.shaft.inertia_kg_m2",
        )
        # Five standard errors of a random draw; the other designs are closer.
        assert abs(inertia.mean() - 21.0) < 5.0 * 2.0 / np.sqrt(1000)
        assert abs(inertia.std() - 2.0) < 5.0 * 2.0 / np.sqrt(2000)

    def test_words_are_drawn_evenly(self) -> None:
        kinds = drawn(plan({"excitation.kind": {"values": ["chirp", "steps"]}}, draws=40), "excitation.kind")
        assert sorted(kinds) == ["chirp"] * 20 + ["steps"] * 20

    def test_the_order_of_the_lines_in_a_file_is_no_part_of_the_design(self) -> None:
        turned = plan(dict(reversed(TWO_FACTORS.items())))
        assert [plan(TWO_FACTORS).factor_values(k) for k in range(8)] == [
            turned.factor_values(k) for k in range(8)
        ]

    def test_another_seed_is_another_design(self) -> None:
        assert plan(TWO_FACTORS).factor_values(0) != plan(TWO_FACTORS, seed=1).factor_values(0)

    @pytest.mark.parametrize("design", ["random", "latin", "sobol"])
    def test_a_draw_far_out_in_a_huge_sweep_is_had_without_those_before_it(self, design: Any) -> None:
        draws = 1_000_000_000
        last = place(design, 3, draws, 0, draws - 1)
        assert last.shape == (3,)
        assert np.all((last >= 0.0) & (last < 1.0))
        assert not np.array_equal(last, place(design, 3, draws, 0, (draws - 1) % BLOCK))

    def test_seeds_are_those_of_the_children_of_the_sweep_s_seed_sequence(self) -> None:
        children = np.random.SeedSequence(5).spawn(4)
        assert [seed_of(5, index) for index in range(4)] == [
            int(child.generate_state(1, np.uint64)[0]) // 2 for child in children
        ]
