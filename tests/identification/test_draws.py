"""Draws are ships that the data allow: ranks of true parameters among them, bounds, valleys, and what is refused.

The study (`pytest -m study -k draws -s`) draws ships from the priors of their fit, DRAWS_SHIPS of them (500), in two
families; each ship's ranks go to a file in DRAWS_FOLDER at once, so that a study that was stopped goes on.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from shipfp_rs import signals
from shipfp_rs.errors import IdentificationError, InputError, ShipfpError, SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.parquet import write_experiments
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.likelihood import Likelihood
from shipfp_rs.identification.rebuilt import rebuilt
from shipfp_rs.structures.structure import Structure
from tests.families.draw import draw
from tests.price import SMOOTH

RPM, TORQUE, BINS, DRAWN = 1000.0, 2000.0, 10, 199
PRIORS = {
    "tau_n": (1.5, 0.3),
    "g": (-0.5, 0.5),
    "vK_p": (4.0, 0.8),
    "vK_i": (6.0, 1.5),
    "p": (2.2, 0.2),
    "tau_prop": (0.4, 0.08),
    "T_d": (0.06, 0.015),
    "T_set": (0.2, 0.04),
}
WIDE = {**PRIORS, "tau_n": (1.5, 0.5), "g": (-0.5, 1.5)}
FAMILIES = {"narrow": (PRIORS, 0.02), "valley": (WIDE, 0.004)}
"""Priors and amplitude of the chirp: a small one leaves a valley of tau_n, g and gains."""
CHIRP = signals.chirp(0.02, 3.0, 100.0, 1.0, rate_hz=50.0)


def ship(priors: dict[str, tuple[float, float]]) -> Structure:
    made = Structure.ship(["dead_time_loop", "dead_time_set_point"], torque="gauge", products=True)
    known = {name: prior for name, prior in priors.items() if name in made.names}
    return replace(
        made,
        parameters=tuple(
            replace(one, start=known[one.name][0], prior=known[one.name]) if one.name in known else one
            for one in made.parameters
        ),
    )


def truth_of(structure: Structure, random: np.random.Generator) -> dict[str, float]:
    """A ship from the fit's prior."""
    free = {one.name: one for one in structure.free}
    while True:
        found = {name: random.normal(*parameter.prior) for name, parameter in free.items()}
        inside = all(free[name].lower < value < free[name].upper for name, value in found.items())
        if inside and found["tau_prop"] < found["tau_n"]:
            return found


def trial(
    structure: Structure,
    values: dict[str, float],
    amplitude: float,
    random: np.random.Generator,
    noisy: float = 1.0,
) -> Experiment:
    count = len(CHIRP.samples)
    moved = RPM * (1.0 + amplitude * CHIRP.samples)
    point = {"n_set": RPM, "n_e": RPM, "M_g": TORQUE}
    bare = Experiment("trial", CHIRP.rate_hz, {"n_set": moved}, point, hold="first")
    rows = structure.equations.simulate(values, bare)
    noise = (
        lfilter([1.0], [1.0, -0.5], random.standard_normal((2, count))) * np.array([[5e-4], [2e-3]]) * noisy
    )
    outputs = {"n_e": RPM * (1.0 + rows[0] + noise[0]), "M_g": TORQUE * (1.0 + rows[1] + noise[1])}
    exact = {"source": "simulation", "gauge_accuracy": {"n_e": 0.0, "M_g": 0.0}}
    return replace(bare, signals={"n_set": moved, **outputs}, provenance=exact)


def ranks(family: str, seed: int) -> dict[str, int] | None:
    """Number of draws below the truth, of 199, for each parameter; None where the draws are refused."""
    priors, amplitude = FAMILIES[family]
    structure, random = ship(priors), np.random.default_rng([seed, list(FAMILIES).index(family)])
    truth = truth_of(structure, random)
    found = identify(trial(structure, truth, amplitude, random), structure)
    try:
        drawn = found.draws(DRAWN, seed)
    except (IdentificationError, InputError) as error:
        print(seed, error)
        return None
    return {name: int((drawn.parameters[name] < value).sum()) for name, value in truth.items()}


def unevenness(found: list[dict[str, int]], bins: int = BINS) -> dict[str, float]:
    """Probability of so uneven a histogram of ranks by chance, for each parameter."""
    result = {}
    for name in found[0]:
        counts = np.bincount([one[name] * bins // (DRAWN + 1) for one in found], minlength=bins)
        expected = len(found) / bins
        result[name] = float(chi2.sf(np.sum((counts - expected) ** 2) / expected, bins - 1))
    return result


@pytest.mark.study
@pytest.mark.parametrize("family", FAMILIES)
def test_ranks_of_true_parameters_among_their_draws_are_uniform(family: str, tmp_path: Path) -> None:
    folder = Path(os.environ.get("DRAWS_FOLDER", tmp_path))
    folder.mkdir(exist_ok=True)
    found, refused = [], 0
    ships = int(os.environ.get("DRAWS_SHIPS", "500"))
    for seed in range(ships):
        path = folder / f"{family}-{seed}.json"
        if not path.exists():
            path.write_text(json.dumps(ranks(family, seed)))
        one = json.loads(path.read_text())
        refused += one is None
        found += [one] if one else []
        if seed % 20 == 19:
            print(f"{family}: {seed + 1} of {ships} ships, {refused} refused", flush=True)
    told = unevenness(found)
    for name, chance in told.items():
        counts = np.bincount([one[name] * BINS // (DRAWN + 1) for one in found], minlength=BINS)
        print(f"{family:8} {name:9} p = {chance:.3f}  {counts.tolist()}")
    print(f"{family}: {len(found)} ships, {refused} refused, least p {min(told.values()):.3f}")
    inside = {name: float(np.mean([5 <= one[name] <= 194 for one in found])) for name in told}
    print(
        f"{family}: the middle 95 % of the draws hold the truth", {n: round(v, 3) for n, v in inside.items()}
    )
    assert refused <= 0.02 * ships
    assert min(inside.values()) > 0.91
    assert min(told.values()) > 0.01 / len(told)


def held(family: str, seed: int) -> dict[str, list[bool]] | None:
    """Whether the middle 50 % and 95 % of the draws of a full ship hold the truth; None where the draws are refused."""
    made = draw(family, seed)
    experiment, truth = Experiment(**made.experiment()), made.truth()["parameters"]
    try:
        drawn = identify(experiment).draws(400, seed)
    except ShipfpError as error:
        print(family, seed, error)
        return None
    shares = [(0.25, 0.75), (0.025, 0.975)]
    return {
        name: [drawn.quantile(low, name) <= truth[name] <= drawn.quantile(high, name) for low, high in shares]
        for name in ("tau_n", "g", "vK_p", "vK_i", "p", "tau_prop")
        if name in drawn.names and np.ptp(drawn.parameters[name]) > 0.0
    }


@pytest.mark.study
def test_draws_of_full_ships_hold_the_truth(tmp_path: Path) -> None:
    folder = Path(os.environ.get("DRAWS_FOLDER", tmp_path))
    folder.mkdir(exist_ok=True)
    found, refused = [], 0
    smooth = [(family, seed) for family, seeds in SMOOTH.items() if family != "strangers" for seed in seeds]
    for number, (family, seed) in enumerate(smooth):
        path = folder / f"full-{family}-{seed}.json"
        if not path.exists():
            path.write_text(json.dumps(held(family, seed)))
        one = json.loads(path.read_text())
        refused += one is None
        found += list(one.values()) if one else []
        half, most = np.mean(found or [[0.0, 0.0]], axis=0)
        print(
            f"full: {number + 1} ships, {refused} refused, held by 50 %: {half:.2f}, by 95 %: {most:.2f}",
            flush=True,
        )
    assert refused <= 0.1 * len(smooth)
    assert most > 0.85


@pytest.fixture(scope="module")
def fitted() -> Fingerprint:
    structure, random = ship(WIDE), np.random.default_rng(3)
    values = {name: mean for name, (mean, _) in WIDE.items()}
    return identify(trial(structure, values, 0.004, random), structure)


def test_ranks_of_ten_ships_are_not_uneven() -> None:
    found = [one for seed in range(10) if (one := ranks("narrow", seed))]
    assert len(found) == 10
    assert min(unevenness(found, bins=4).values()) > 1e-4


def test_draws_stay_within_bounds_and_span_the_intervals(fitted: Fingerprint) -> None:
    drawn = fitted.draws(2000, 1)
    assert drawn.table.shape == (2000, len(drawn.names))
    assert 1000 < drawn.effective <= 2000
    assert len(np.unique(drawn.table[:, 0])) > 1000
    for one in ship(WIDE).free:
        low, high = drawn.quantile(0.0, one.name), drawn.quantile(1.0, one.name)
        assert one.lower <= low < high <= one.upper
        # The middle half of the draws holds the likeliest value.
        assert drawn.quantile(0.02, one.name) < fitted[one.name].value < drawn.quantile(0.98, one.name)
    ratio = drawn.parameters["vK_p"] / drawn.parameters["tau_n"]
    np.testing.assert_allclose(drawn.parameters["vK_p/tau_n"], ratio, rtol=1e-12)
    # Along the valley the gain is known by its ratio to the inertia.
    assert np.std(ratio) / np.mean(ratio) < 0.4 * np.std(drawn.parameters["vK_p"]) / np.mean(
        drawn.parameters["vK_p"]
    )


def test_draws_of_one_parameter_have_its_posterior() -> None:
    """The posterior of a single parameter is integrated over a grid, far beyond where the model is straight."""
    free = "g"
    structure, random = ship(WIDE), np.random.default_rng(4)
    values = {name: mean for name, (mean, _) in WIDE.items()}
    alone = structure.with_fixed(**{name: value for name, value in values.items() if name != free})
    found = identify(trial(structure, values, 4e-3, random, noisy=15.0), alone)
    fit, grid = rebuilt(found), np.linspace(-4.0, 2.0, 800)
    likelihood, c = fit.likelihood, fit.likelihood.coordinates
    lowest = np.array([_eliminated(likelihood, c.vector({**values, free: one})) for one in grid])
    density = np.exp(-0.5 * (lowest - lowest.min()) / fit.widening**2)
    sums = np.cumsum(density) / density.sum()
    drawn = found.draws(4000, 3)
    for share in (0.05, 0.25, 0.5, 0.75, 0.95):
        below = float(np.interp(drawn.quantile(share, free), grid, sums))
        assert below == pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / drawn.effective))


def _eliminated(likelihood: Likelihood, vector: np.ndarray) -> float:
    """Minus twice the log of the likelihood integrated over the record's unknowns, in which it is nearly Gaussian."""
    states = slice(len(likelihood.coordinates.names), None)
    for _ in range(3):
        try:
            now = likelihood.products(vector)
        except SimulationError:  # no stable loop
            return np.inf
        vector[states] += np.linalg.solve(now.matrix[states, states], now.downhill[states])
    return float(likelihood.cost(vector) + np.linalg.slogdet(now.matrix[states, states])[1])


def test_a_saved_fingerprint_draws_the_same_from_its_experiments(fitted: Fingerprint, tmp_path: Path) -> None:
    path = fitted.save(tmp_path / "fingerprint.json")
    with pytest.raises(
        InputError, match=r"found none, expected trial.*experiments.parquet of its run beside"
    ):
        Fingerprint.load(path).draws(10)
    write_experiments(tmp_path / "experiments.parquet", fitted.experiments)
    again = Fingerprint.load(path).draws(300, 5)
    np.testing.assert_allclose(again.table, fitted.draws(300, 5).table, rtol=1e-6)
    (own,) = fitted.experiments
    other = replace(own, signals={**own.signals, "n_e": own.signals["n_e"][::-1]})
    write_experiments(tmp_path / "experiments.parquet", [other])
    with pytest.raises(InputError, match="deviance"):
        Fingerprint.load(path).draws(10)
    write_experiments(tmp_path / "experiments.parquet", [replace(own, name="another")])
    assert Fingerprint.load(path).experiments == ()


def test_a_fingerprint_of_the_load_alone_is_refused(fitted: Fingerprint) -> None:
    alone = replace(fitted, adequate={"sides": {"load": True, "engine": False}})
    with pytest.raises(InputError, match="load's side alone"):
        alone.draws(10)


def test_bands_and_margins_of_draws_hold_the_likeliest_ship(fitted: Fingerprint) -> None:
    drawn = fitted.draws(80, 2)
    step = signals.steps([20.0], 5.0, rate_hz=50.0)
    low, high = fitted.simulate(step, draws=drawn)
    best = fitted.simulate(step)
    for name in ("n_e", "M_g"):
        assert (low.signals[name] <= high.signals[name]).all()
        inside = (low.signals[name] <= best.signals[name]) & (best.signals[name] <= high.signals[name])
        assert inside.mean() > 0.9
    low, high = fitted.predict(draws=drawn)
    assert (high.signals["n_e"] - low.signals["n_e"]).max() > 0.0
    told = fitted.margins(draws=drawn)
    assert told["overshoot"].ci95[0] >= 0.0
    assert told["phase margin"].ci95[0] < told["phase margin"].value < told["phase margin"].ci95[1]
