"""Measured responses beside the model's: experiments without any excitation have none."""

import csv

import numpy as np
from matplotlib.figure import Figure

from shipfp_rs import plot
from shipfp_rs.assessment.comparison import compared_responses
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability
from shipfp_rs.report.pictures import curves_csv
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


def test_the_points_of_a_bode_plot_are_told_with_their_bars():
    frequency = np.array([0.1, 1.0, 2.0])
    measured = FrequencyResponse(
        "chirp",
        frequency,
        {"n_e": np.array([1.0, 0.5j, -0.25])},
        {"n_e": np.full(3, 0.1)},
        {"n_e": np.full(3, 0.05)},
    )
    axes = Figure().subplots(2, 1)
    plot.bode(measured, measured, axes)
    rows = list(csv.DictReader(curves_csv([*axes]).splitlines()))
    points = [row for row in rows if row["low"] and row["value_of"].startswith("amplitude")]
    assert [float(row["place"]) for row in points] == frequency.tolist()
    assert [float(row["value"]) for row in points] == [1.0, 0.5, 0.25]
    assert [float(row["high"]) for row in points] == [1.2, 0.6, 0.3]
    assert {row["against"] for row in rows} == {"frequency [Hz]"}
    assert len(rows) == 2 * 2 * 3  # amplitude and phase, measured and modelled
