"""What a torsional calculation adds to a fit: intervals that hold, and a drawing that is wrong is told."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs.assessment.si import against_priors, parameters_of, torsional_priors, with_parameters
from shipfp_rs.simulation.raw_log import trial_toml
from shipfp_rs.vessel.torsion import Line

STD_PCT, TOLD = 5.0, ("tau_n", "tau_prop", "g", "vK_p", "vK_i")
CHIRP = fp.signals.chirp(0.02, 2.0, 60.0, 40.0, rate_hz=50.0)
NOISE = {"n_e": 0.003, "M_g": 0.02, "M_b": 0.02}
TUG = fp.Vessel.load("stan-tug-1205")


@cache
def line() -> Line:
    """The tug's line, with its inertias, on either side of the gauge, and without a twist."""
    ratio, whole, behind = TUG.gearbox.ratio, TUG.inertia, TUG.propeller_side_inertia
    discs = [(whole - behind) / ratio**2, 0.0, behind]
    return Line.model_validate(
        {
            "discs": [{"node": node, "inertia_kg_m2": inertia} for node, inertia in enumerate(discs)],
            "gears": [{"nodes": [0, 1], "ratio": ratio}],
            "shafts": [{"nodes": [1, 2]}],
        }
    )


def drawn(seed: int, torque: str, off: float | None = None) -> tuple[fp.Vessel, fp.Fingerprint, dict]:
    """A ship whose inertias scatter about the drawing, or are `off` by deviations; its fit, and the priors."""
    random, true, signal = (
        np.random.default_rng(seed),
        parameters_of(TUG),
        "M_b" if torque == "brake" else "M_g",
    )
    moves = random.standard_normal(2) if off is None else np.full(2, off * random.choice([-1.0, 1.0]))
    ship = with_parameters(
        TUG,
        {
            **{
                n: true[n] * (1.0 + 0.01 * STD_PCT * m)
                for n, m in zip(("tau_n", "tau_prop"), moves, strict=True)
            },
            **{name: true[name] * random.lognormal(0.0, 0.2) for name in ("K_p", "K_i", "T_set")},
        },
    )
    trial = fp.simulate(ship, CHIRP, noise=NOISE, seed=seed)
    kept = {name: trial.signals[name] for name in ("n_set", "n_e", signal)}
    trial = replace(trial, signals=kept, operating_point={name: trial.operating_point[name] for name in kept})
    priors = torsional_priors(line(), [trial], TUG, gauge="shaft 1", std_pct=STD_PCT)
    if torque == "brake":  # a stiff shaft tells nothing of the share behind it
        del priors["tau_prop"]
    return ship, fp.identify(trial, torque=torque, outputs=["dn", "dM"], priors=priors, seed=seed), priors


def coverage(seeds: range, torque: str) -> dict[str, list[bool]]:
    """Whether the interval of each parameter holds the true value, by ship."""
    found: dict[str, list[bool]] = {name: [] for name in TOLD}
    for seed in seeds:
        ship, fingerprint, _ = drawn(seed, torque)
        true = parameters_of(ship)
        true |= {f"v{name}": true["v"] * true[name] for name in ("K_p", "K_i")}
        for name in TOLD:
            if (ends := fingerprint[name].ci95) is not None:
                found[name].append(ends[0] <= true[name] <= ends[1])
    return found


def flagged(seeds: range, torque: str, off: float | None) -> list[set[str]]:
    """Names of the contradicted priors, by ship."""
    fits = (drawn(seed, torque, off)[1:] for seed in seeds)
    return [{one.values["name"] for one in against_priors(*fit)} for fit in fits]


@pytest.mark.parametrize("torque", ["gauge", "brake"])
def test_intervals_hold_on_ships_that_scatter_about_the_drawing(torque):
    for name, held in coverage(range(12), torque).items():
        assert sum(held) >= len(held) - 3, name  # at 95 % one set of twelve in fifty has more


@pytest.mark.parametrize("torque", ["gauge", "brake"])
def test_a_drawing_off_by_five_deviations_is_told_and_a_right_one_is_not(torque):
    assert all(flagged(range(6), torque, 5.0))
    assert sum(map(bool, flagged(range(6), torque, None))) <= 1


@pytest.mark.study
@pytest.mark.parametrize("torque", ["gauge", "brake"])
def test_study_of_drawings_on_200_ships(torque):
    """Blocks of 20 ships; the figures so far are printed, so that an interrupted study has told something."""
    held: dict[str, list[bool]] = {name: [] for name in TOLD}
    wrong: list[set[str]] = []
    right: list[set[str]] = []
    for first in range(0, 200, 20):
        seeds = range(first, first + 20)
        for name, more in coverage(seeds, torque).items():
            held[name] += more
        wrong += flagged(seeds, torque, 5.0)
        right += flagged(seeds, torque, None)
        shares = {name: f"{sum(of)} of {len(of)}" for name, of in held.items() if of}
        off = {name: sum(name in one for one in wrong) for name in ("tau_n", "tau_prop")}
        print(
            f"{torque}: held {shares}; off by five: told {sum(map(bool, wrong))} of {len(wrong)}, {off}; "
            f"right: told {sum(map(bool, right))} of {len(right)}",
            flush=True,
        )
    for name in ("tau_n", "vK_p", "vK_i"):
        # The intervals of a brake's inertia allow for errors of the sensors that these ships have not.
        assert 0.92 <= np.mean(held[name]) <= (0.98 if torque == "gauge" else 1.0), name
    assert sum(map(bool, wrong)) >= 0.95 * len(wrong)
    assert sum(map(bool, right)) <= 0.03 * len(right)


def test_a_run_takes_the_line_and_says_where_the_ship_is_another_one(tmp_path):
    """A log of a ship whose inertias are half as large again as in the drawing."""
    true = parameters_of(TUG)
    ship = with_parameters(TUG, {name: 1.5 * true[name] for name in ("tau_n", "tau_prop")})
    excitation = fp.signals.chirp(0.02, 2.0, 60.0, 40.0, rate_hz=500.0)
    log, made = fp.simulate_raw_log(
        ship, [excitation], sensors=(sensors := fp.Sensors(rate_hz=500.0)), seed=1
    )
    log.write(tmp_path / "log.parquet")
    (tmp_path / "line.json").write_text(line().model_dump_json())
    text = trial_toml("stan-tug-1205", "log.parquet", sensors, made)
    path = tmp_path / "TRIAL.toml"
    path.write_text(text + '\n[torsion]\nfile = "line.json"\ngauge = "shaft 1"\n')
    found = fp.run(path, out=tmp_path / "run").fingerprint
    assert found["tau_n"].status == "prior"
    assert any("Known beforehand: tau_prop" in line for line in found.verdict)
    path.write_text(text + '\n[torsion]\nfile = "line.json"\ngauge = "shaft 7"\n')
    with pytest.raises(fp.InputError, match=r"torsion\.gauge: found 'shaft 7'"):
        fp.Trial.load(path)


def test_a_line_with_another_gear_than_the_vessel_is_refused():
    trial = fp.simulate(TUG, CHIRP, seed=0)
    direct = TUG.replace({"gearbox.ratio": 2.0})
    with pytest.raises(fp.InputError, match=r"3\.82 times as fast as the propeller, expected 2"):
        torsional_priors(line(), [trial], direct)
