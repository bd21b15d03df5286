"""How much each point of a weighted frequency response counts: known answers and the published sine fits."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs.assessment.profile_likelihood import leverage
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identify import identify
from shipfp_rs.reproduce.fullscale import extended_structure, measured_response

STRUCTURE = extended_structure()


@pytest.fixture(scope="module")
def fitted():
    data = measured_response(1.637)
    return data, identify(data, STRUCTURE, noise="std", starts=8)


def total(found) -> float:
    return sum(float(part.sum()) for pair in found.values() for part in pair)


def test_all_points_together_make_the_rank(fitted):
    data, fingerprint = fitted
    found = leverage(data, STRUCTURE, fingerprint)
    assert total(found) == pytest.approx(fingerprint.identifiability.rank, rel=1e-6)
    for pair in found.values():
        for part in pair:
            assert part.shape == (len(data),)
            assert (part >= -1e-12).all()
            assert (part <= 1.0 + 1e-9).all()


def test_lost_phases_count_for_nothing(fitted):
    data, fingerprint = fitted
    for signal, (_, phase) in leverage(data, STRUCTURE, fingerprint).items():
        lost = data.phase_std[signal] > 1.0
        assert phase[lost].max() < 0.05
    _, phase = leverage(data, STRUCTURE, fingerprint)["n_e"]
    assert phase[data.phase_std["n_e"] < 0.1].max() > 0.3


def test_a_point_ten_times_as_sure_draws_the_fit_to_itself(fitted):
    data, fingerprint = fitted
    before = leverage(data, STRUCTURE, fingerprint)["M_g"][0]
    surer = {name: std.copy() for name, std in data.amplitude_std.items()}
    surer["M_g"][5] /= 10.0
    after = leverage(
        type(data)(data.name, data.frequency_hz, data.response, surer, data.phase_std), STRUCTURE, fingerprint
    )["M_g"][0]
    assert before[5] < 0.5
    assert after[5] > 0.9
    assert np.delete(after, 5).sum() < np.delete(before, 5).sum()


def test_a_prior_takes_its_share(fitted):
    data, _ = fitted
    structure = STRUCTURE.with_prior(tau_n=(1.17, 0.06))
    fingerprint = identify(data, structure, noise="std", starts=8)
    assert total(leverage(data, structure, fingerprint)) < fingerprint.identifiability.rank - 0.5


def test_a_fit_that_was_not_weighed_by_deviations_is_refused(fitted):
    data, _ = fitted
    fingerprint = identify(data, STRUCTURE, noise="white")
    with pytest.raises(InputError, match="the fit's noise is 'white', expected 'std'"):
        leverage(data, STRUCTURE, fingerprint)
