"""Identification from experiments: the truth comes back, with offsets and initial states estimated along."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs import _core, signals
from shipfp_rs.experiment import Experiment
from shipfp_rs.identification import identify
from shipfp_rs.linearise import linearise
from shipfp_rs.structure import Structure
from shipfp_rs.vessel import Vessel


def test_the_parameters_come_back_from_a_chirp_though_it_starts_off_balance_and_the_gauge_has_an_offset():
    launch = linearise(Vessel.load("stan-launch-804"))
    excitation = signals.chirp(0.01, 10.0, 60.0, 13.0)
    dn, dM = _core.simulate_linear(
        launch.kernel_parameters(),
        excitation.samples / 1300.0,
        1.0 / excitation.rate_hz,
        excitation.hold,
        np.array([0.01, 0.02]),
        [_core.LINEAR_OUTPUTS.index("dn"), _core.LINEAR_OUTPUTS.index("dM_b")],
    )
    experiment = Experiment(
        "chirp",
        excitation.rate_hz,
        {"n_set": 1300.0 + excitation.samples, "n_e": 1300.0 * (1.0 + dn), "M_b": 220.0 * (1.05 + dM)},
        {"n_set": 1300.0, "n_e": 1300.0, "M_b": 220.0},
        hold=excitation.hold,
    )
    fingerprint = identify(experiment, Structure.linear(products=True))
    for name, truth in {
        "tau_n": launch.tau_n,
        "g": launch.g,
        "vK_p": launch.v * launch.K_p,
        "vK_i": launch.v * launch.K_i,
    }.items():
        assert fingerprint[name].value == pytest.approx(truth, rel=1e-6)
