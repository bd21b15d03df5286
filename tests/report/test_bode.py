"""Measured responses beside the model's: experiments without any excitation have none."""

import numpy as np

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability
from shipfp_rs.report.bode import compared_responses
from shipfp_rs.structures.structure import Structure


def test_breakage_c3_a_constant_set_point_has_no_response():
    rng = np.random.default_rng(0)
    speed = 1183.8 + rng.normal(0.0, 1.0, 6000)
    still = Experiment(
        name="R1",
        rate_hz=50.0,
        signals={"n_set": np.full(6000, 1183.8), "n_e": speed, "M_g": 1.45 * speed},
        operating_point={"n_set": 1183.8, "n_e": 1183.8, "M_g": 1725.0},
        kind="steady",
    )
    fingerprint = Fingerprint(
        parameters={"tau_n": Estimate(1.2, 0.1, (1.0, 1.4), "s")},
        derived={},
        identifiability=Identifiability(1, 1, 1.0, ()),
        fit={},
        structure={"kind": "linear", "name": "linear"},
        vessel="stan-tug-1205",
        data=(),
        settings={},
        seed=0,
        versions={},
        verdict=(),
    )
    assert compared_responses(fingerprint, [still], Structure.linear()) == []
