"""The tug's trial on simulated ships whose parameters are known.

The study (`pytest -m study -k twin -s`) identifies the chirp C11 of 200 ships in as many seas, each drawn; TWIN_DRAWS
sets another number, TWIN_PART another part of the trial ("sines S2-S12", "chirps C21-C23", "all").
"""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from scipy.stats import binom

from shipfp_rs import cli
from shipfp_rs.reproduce import twin
from shipfp_rs.reproduce.twin import CHIRP, FREE, PARTS, Outcome, Ship


@pytest.fixture(scope="module")
def tug() -> Ship:
    return Ship.drawn(0)


@pytest.mark.study
def test_twin_study_of_many_ships_in_many_seas():
    draws, part = int(os.environ.get("TWIN_DRAWS", "200")), os.environ.get("TWIN_PART", CHIRP)
    outcomes = []
    for seed in range(draws):
        outcomes.append(Outcome.of(Ship.drawn(seed), seed, part))
        if (seed + 1) % 20 == 0 or seed + 1 == draws:
            print(f"\n{part}, {seed + 1} ships", *twin.table(twin.scores(outcomes)), sep="\n", flush=True)
    found = twin.scores(outcomes)
    low = binom.ppf(1e-3, draws, 0.95) / draws
    # The gains and dead times are a standard deviation off already in still water, for what the structure lacks.
    for name in ("p", "tau_prop"):
        assert found[name].inside >= low
    for score in found.values():
        assert score.std_pct > 3.0 or score.error_pct < 5.0


def test_what_gauge_and_speed_tell_of_the_propeller_is_known_within_a_percent(tug):
    outcomes = [Outcome.of(tug, seed, CHIRP) for seed in range(3)]
    found = twin.scores(outcomes)
    for name in ("p", "tau_prop"):
        assert found[name].inside >= 2 / 3
        assert found[name].error_pct < 2.0
        assert found[name].std_pct < 2.0


def test_the_structure_of_the_thesis_is_called_wrong_and_misses_the_truth(tug):
    fingerprint = twin.fitted_as_the_thesis(tug, 0, CHIRP)
    estimates = fingerprint.parameters
    bound = [name for name, estimate in estimates.items() if estimate.status == "at_bound"]
    missed = [
        name
        for name, estimate in estimates.items()
        if estimate.ci95 is not None and not estimate.ci95[0] <= tug.truth[name] <= estimate.ci95[1]
    ]
    assert fingerprint.model_adequate is False
    assert bound or missed


def test_the_chirp_is_cut_where_it_passes_the_frequency_up_to_which_the_ship_is_linear():
    first, last = twin.window_s("C11")
    samples = twin.at_rest_before_and_after("C11").samples[round((last + twin.PAUSE_S - 5.0) * 200.0) :][
        :1000
    ]
    crossings = np.count_nonzero(np.diff(np.sign(samples)) > 0)
    assert crossings / 5.0 == pytest.approx(twin.LAST_HZ, abs=0.25)
    assert first < 0.0


@pytest.mark.usefixtures("only_the_chirp")
def test_the_command_puts_the_truth_beside_both_structures(capsys):
    assert cli.main(["reproduce", "twin", "--draws", "2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["way"] for row in found["rows"]] == ["truth", "thesis", "ours", "ours"]
    truth, ours = found["rows"][0]["parameters"], found["rows"][2]["parameters"]
    assert ours["tau_prop"] == pytest.approx(truth["tau_prop"], rel=0.05)
    assert any(line.startswith("thesis's structure") and "called wrong" in line for line in found["verdict"])


@pytest.fixture
def only_the_chirp(monkeypatch):
    monkeypatch.setattr(twin, "PARTS", {CHIRP: PARTS[CHIRP]})


def test_ships_are_drawn_about_the_tug_and_again_the_same():
    one, other = Ship.drawn(5), Ship.drawn(5)
    assert one.truth == other.truth
    tug = Ship.drawn(0).truth
    ratios = [one.truth[name] / tug[name] for name in FREE]
    assert all(0.6 < ratio < 1.6 for ratio in ratios)
    assert max(abs(ratio - 1.0) for ratio in ratios) > 0.01
