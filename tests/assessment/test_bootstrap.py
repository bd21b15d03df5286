"""Blocks of residuals put back tell the scatter of the estimates, also where the noise model of the fit is wrong."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.assessment.bootstrap import block_length, bootstrap
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.structure import Structure
from tests.launch import TRUTH, noise, noisy_record

CHIRP = signals.chirp(0.02, 5.0, 60.0, 13.0, rate_hz=25.0)
STRUCTURE = Structure.linear(products=True)


@pytest.fixture(scope="module")
def coloured():
    """Coloured noise taken for white, and a gap: masked samples stay masked."""
    found = noisy_record(CHIRP, 0.05, 0.9, 1)
    speed = found.signals["n_e"].copy()
    speed[1000:1020] = np.nan
    return replace(found, signals={**found.signals, "n_e": speed})


@pytest.fixture(scope="module")
def drawn(coloured):
    return bootstrap(coloured, STRUCTURE, draws=40, noise="white", seed=2)


def test_the_scatter_of_the_draws_is_that_of_repeated_trials_where_the_fit_takes_coloured_noise_for_white(
    drawn,
):
    trials = [
        identify(noisy_record(CHIRP, 0.05, 0.9, seed), STRUCTURE, noise="white", intervals="symmetric")
        for seed in range(100, 140)
    ]
    own = drawn.fingerprint
    too_small = []
    for name in TRUTH:
        scatter = np.std([trial[name].value for trial in trials], ddof=1)
        # Both are standard deviations of 40 values: their ratio scatters by 16 %.
        assert drawn.std[name] == pytest.approx(scatter, rel=0.45)
        too_small.append(own[name].std / scatter)
    assert min(too_small) < 0.6


@pytest.mark.parametrize("correlation", [0.5, 0.9, 0.98])
def test_the_block_is_as_long_as_the_closed_form_for_first_order_noise(correlation):
    count = 200_000
    best = (1.5 * count * (2.0 * correlation / (1.0 - correlation**2)) ** 2) ** (1.0 / 3.0)
    lengths = [block_length(noise((1, count), correlation, seed)[0]) for seed in range(8)]
    assert np.median(lengths) == pytest.approx(best, rel=0.15)


def test_white_residuals_need_no_blocks():
    lengths = [block_length(np.random.default_rng(seed).standard_normal(20_000)) for seed in range(8)]
    assert np.median(lengths) < 12
    assert block_length(np.zeros(1000)) == 1


def test_intervals_hold_the_truth_and_their_level_counts(drawn):
    for name, truth in TRUTH.items():
        low, high = drawn.interval(name, 0.99)
        inner = drawn.interval(name, 0.5)
        assert low < inner[0] < inner[1] < high
        assert abs(truth - drawn.fingerprint[name].value) < 4.0 * drawn.std[name]
    assert drawn.failed == 0
    assert drawn.covariance.shape == (len(drawn.names), len(drawn.names))
    assert np.sqrt(np.diag(drawn.covariance)) == pytest.approx(list(drawn.std.values()), rel=1e-9)


def test_the_same_seed_gives_the_same_draws(coloured, drawn):
    again = bootstrap(coloured, STRUCTURE, draws=20, noise="white", seed=2)
    np.testing.assert_array_equal(again.draws, drawn.draws[:20])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"draws": 5}, "draws is 5, expected 20 to 1000000"),
        (
            {"block_s": 40.0},
            "blocks of 40 s, expected at least a sample and at most a tenth of the record's 59.2 s",
        ),
        ({"block_s": 0.001}, "blocks of 0 s, expected at least a sample"),
    ],
)
def test_what_can_not_be_drawn_is_refused(coloured, change, message):
    with pytest.raises(InputError, match=message):
        bootstrap(coloured, STRUCTURE, **{"draws": 20, **change})


def test_an_unknown_name_is_refused(drawn):
    with pytest.raises(InputError, match="no estimates of 'K_p', expected one of tau_n"):
        drawn.interval("K_p")
    with pytest.raises(InputError, match="level is 95, expected a share"):
        drawn.interval("tau_n", 95.0)


def test_it_is_shown_as_a_table_and_as_json(drawn):
    lines = str(drawn).splitlines()
    assert len(lines) == 1 + len(drawn.names)
    assert len({len(line) for line in lines}) == 1
    content = json.loads(json.dumps(drawn.to_dict(), allow_nan=False))
    assert content["draws"] == 40
    assert set(content["ci95"]) == set(drawn.names)
