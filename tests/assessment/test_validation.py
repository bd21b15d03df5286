"""Validation: a fingerprint of the right structure explains other experiments as well as its own."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.assessment.validation import cross_validation, validate
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.structure import Structure
from tests.launch import LAUNCH, noisy_record, outputs_of

STRUCTURE = Structure.linear(products=True)
CHIRP = noisy_record(signals.chirp(0.05, 5.0, 30.0, 13.0, rate_hz=50.0), 0.05, 0.0, 1)
STAIRS = signals.steps([13.0, -13.0, 13.0], 10.0, rate_hz=50.0)
STEPS = noisy_record(STAIRS, 0.05, 0.0, 2)


def test_a_fit_of_the_right_structure_leaves_only_the_noise_of_another_experiment():
    fits = validate(identify(CHIRP, STRUCTURE), STEPS)
    for output, clean in zip(("dn", "dM"), outputs_of(STAIRS), strict=True):
        noise = 0.05 * np.sqrt(np.mean(clean**2))
        spread = np.hypot(np.std(clean), noise)
        assert fits[output] == pytest.approx(100.0 * (1.0 - noise / spread), abs=0.5)


def test_the_fit_is_that_of_the_definition():
    fingerprint = identify(CHIRP, STRUCTURE)
    fits = validate(fingerprint, CHIRP)
    for output in ("dn", "dM"):
        assert fits[output] == pytest.approx(fingerprint.fit[output]["nrmse_pct"], abs=0.2)


def test_a_constant_offset_or_a_masked_sample_of_the_other_experiment_does_not_count():
    fingerprint = identify(CHIRP, STRUCTURE)
    speed = STEPS.signals["n_e"] + 2.0
    shifted = replace(STEPS, signals={**STEPS.signals, "n_e": speed})
    assert validate(fingerprint, shifted)["dn"] == pytest.approx(validate(fingerprint, STEPS)["dn"], abs=1e-6)
    speed = np.where(np.arange(len(STEPS)) == 700, np.nan, STEPS.signals["n_e"])
    masked = replace(STEPS, signals={**STEPS.signals, "n_e": speed})
    assert validate(fingerprint, masked)["dn"] == pytest.approx(validate(fingerprint, STEPS)["dn"], abs=0.05)


def test_a_changed_ship_shows_in_the_table_off_the_diagonal_only():
    heavier = replace(LAUNCH, tau_n=1.5 * LAUNCH.tau_n)
    after = noisy_record(
        signals.chirp(0.05, 5.0, 30.0, 13.0, rate_hz=50.0, name="after"), 0.05, 0.0, 3, heavier
    )
    seen = []
    table = cross_validation(
        [CHIRP, after], STRUCTURE, noise="white", progress=lambda *done: seen.append(done)
    )
    fits = table.to_dict()
    assert json.loads(json.dumps(fits)) == fits
    for output in ("dn", "dM"):
        for own, other in (("chirp", "after"), ("after", "chirp")):
            assert fits[output][own][own] > 93.0
            assert fits[output][own][other] < 85.0
    assert seen == [(1, 2), (2, 2)]
    lines = str(table).splitlines()
    assert lines[0] == "fit of dn [%]"
    assert lines[1].split() == ["fitted", "to", "chirp", "after"]
    assert lines[2].split() == [
        "chirp",
        f"{fits['dn']['chirp']['chirp']:.2f}",
        f"{fits['dn']['chirp']['after']:.2f}",
    ]


@pytest.mark.parametrize("experiments", [[], [CHIRP, CHIRP]])
def test_experiments_need_names_of_their_own(experiments):
    with pytest.raises(InputError, match="expected at least one and each name once"):
        cross_validation(experiments, STRUCTURE)
