"""Pictures of reproduced tables: what is drawn is the distance from the printed value, with its interval."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.reproduce import Row
from shipfp_rs.reproduce.pictures import Responses, beside, bode, distances

PRINTED = Row("7.1", "ii", "printed", "thesis", {"tau_n": 0.5, "g": -0.4, "p": 0.0})
OTHER = Row("7.1", "iii", "printed", "thesis", {"tau_n": 2.0})


def ours(case: str, **values: float | None) -> Row:
    return Row("7.1", case, "ours", "ship: many", values, intervals={"tau_n": (0.6, 1.0)})


def test_distances_are_relative_to_the_printed_value_of_the_case() -> None:
    (points,) = distances([PRINTED, OTHER, ours("ii, weighted", tau_n=0.75, g=-0.2, p=1.0)]).values()
    assert [point.parameter for point in points] == ["tau_n", "g"]
    assert points[0][1:] == pytest.approx((50.0, 20.0, 100.0))
    assert points[1][1:] == pytest.approx((50.0, 50.0, 50.0))


def test_the_only_printed_row_is_that_of_every_case_and_values_without_one_are_left_out() -> None:
    assert [*distances([PRINTED, ours("v", tau_n=0.75)])] == ["v, ours, ship: many"]
    assert distances([PRINTED, OTHER, ours("v", tau_n=0.75)]) == {}
    assert distances([PRINTED, ours("ii", tau_n=None, T_d=1.0)]) == {}


def test_the_picture_has_a_point_at_each_distance_and_the_printed_value_beside_its_name() -> None:
    figure = beside([PRINTED, ours("ii", tau_n=0.75, g=-0.2), ours("v", tau_n=50.0)])
    (ax,) = figure.axes
    assert [label.get_text() for label in ax.get_yticklabels()] == ["tau_n = 0.5", "g = -0.4"]
    assert ax.get_xlabel() == "distance from the printed value [%]"
    assert [line.get_xdata().tolist() for line in ax.lines[:2]] == [[50.0, 50.0], [300.0]]
    assert [text.get_text() for text in ax.texts] == ["+9900 %"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ii, ours, ship", "v, ours, ship"]


def test_a_point_of_unknown_phase_has_an_amplitude_only() -> None:
    frequency = np.array([0.1, 0.2, 0.5])
    answer = {"n_e": 1.0 / (1.0 + 2j * frequency)}
    model = FrequencyResponse("model", frequency, answer)
    std = {"n_e": np.array([0.01, 0.01, 1.8])}
    measured = FrequencyResponse("sines", frequency, answer, std, std)
    amplitude, phase = bode(Responses(measured, {"ours": model})).axes
    assert np.isfinite(amplitude.lines[-1].get_ydata()).tolist() == [True, True, True]
    assert np.isfinite(phase.lines[-1].get_ydata()).tolist() == [True, True, False]
    assert (amplitude.get_ylabel(), phase.get_ylabel()) == ("amplitude ratio [-]", "phase [deg]")
