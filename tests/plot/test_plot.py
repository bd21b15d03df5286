"""Pictures name what they show with its unit, and keep what matters when they thin a signal."""

from __future__ import annotations

import re
from dataclasses import replace

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.figure import Figure

from shipfp_rs import plot
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint, Identifiability
from shipfp_rs.plot import style
from shipfp_rs.plot.frequency import windows
from shipfp_rs.tacho import PulseTimes, ReflectorAngles

UNIT = re.compile(r"\[(rpm|Nm|rev|rev/s|mm|s|Hz|deg|-|%)\]$")


@pytest.fixture
def trial() -> Experiment:
    time = np.arange(0.0, 100.0, 0.02)
    wave = np.sin(0.5 * time)
    torque = 1725.0 + 200.0 * wave
    torque[100] = np.nan
    torque[1000:1500] = np.nan
    return Experiment(
        name="S2 $100",  # a lone dollar sign is not the start of a formula
        rate_hz=50.0,
        signals={"n_set": 1183.8 + 76.0 * wave, "n_e": 1183.8 + 70.0 * wave, "M_g": torque},
        operating_point={"n_set": 1183.8, "n_e": 1183.8, "M_g": 1725.0},
    )


@pytest.fixture
def fingerprint() -> Fingerprint:
    return Fingerprint(
        parameters={
            "tau_n": Estimate(1.17, 0.02, (1.13, 1.21), "s"),
            "p": Estimate(2.17, 0.005, (2.16, 2.18)),
            "v": Estimate(None, status="unidentifiable"),
            "T_set": Estimate(0.3, unit="s", status="fixed"),
        },
        derived={"vK_p": Estimate(10.0, 0.1, (9.8, 10.2))},
        identifiability=Identifiability(3, 4, np.inf),
        fit={},
        structure={},
    )


def labels_have_units(axes) -> bool:
    return all(UNIT.search(label) for ax in axes for label in (ax.get_xlabel(), ax.get_ylabel()) if label)


def legend(ax) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_signals_of_one_unit_share_a_panel_and_masked_samples_are_counted(trial) -> None:
    speed, torque = plot.signals(trial)
    assert labels_have_units([speed, torque])
    assert legend(speed) == ["set point $n_{set}$", "speed $n_e$"]
    assert legend(torque) == ["gauge torque $M_g$", "masked (10 %)"]
    speed.figure.canvas.draw()


def test_the_fit_is_drawn_in_the_unit_of_the_measurement(trial) -> None:
    panels = plot.fit(trial, trial)
    assert labels_have_units(panels)
    asked, measured, model = panels[0].get_lines()
    asked = asked.get_ydata()  # thinned, no peak lost
    assert (asked.min(), asked.max()) == (trial.signals["n_set"].min(), trial.signals["n_set"].max())
    np.testing.assert_allclose(model.get_ydata(), measured.get_ydata(), rtol=1e-12)


def test_intervals_are_drawn_in_per_cent_of_the_truth_and_a_miss_is_red(fingerprint) -> None:
    ax = plot.intervals(fingerprint, {"tau_n": 1.3, "p": 2.17, "vK_p": 10.0})
    assert labels_have_units([ax])
    assert [text.get_text() for text in ax.get_yticklabels()] == ["vK_p = 10", "p = 2.17", "tau_n = 1.17 s"]
    bars = [line for line in ax.get_lines() if len(line.get_xdata()) == 2 and line.get_linewidth() == 2.0]
    assert [line.get_color() for line in bars] == [style.BLUE, style.BLUE, style.RED]
    np.testing.assert_allclose(bars[2].get_xdata(), [100.0 * (1.13 / 1.3 - 1.0), 100.0 * (1.21 / 1.3 - 1.0)])


def test_without_a_truth_intervals_surround_the_estimate(fingerprint) -> None:
    ax = plot.intervals(fingerprint)
    assert "from the estimate" in ax.get_xlabel()
    assert len(ax.get_yticklabels()) == 3


def test_a_delay_of_almost_nothing_is_known_well_and_a_coefficient_of_almost_anything_is_not(
    fingerprint,
) -> None:
    estimates = {
        "tau_twist": Estimate(2e-4, 4e-4, (0.0, 1e-3), "s"),
        "c_2": Estimate(-0.03, 0.1, (-0.23, 0.17)),
        "vK_p": Estimate(9.0, 11.0, (2.0, 46.0)),
    }
    ax = plot.intervals(replace(fingerprint, parameters=estimates, derived={}))
    bars = [line for line in ax.get_lines() if len(line.get_xdata()) == 2 and line.get_linewidth() == 2.0]
    lengths = [np.ptp(line.get_xdata()) for line in bars]
    assert lengths == sorted(lengths, reverse=True)  # from below: vK_p, c_2, tau_twist
    assert lengths[2] == pytest.approx(2.0)  # 1 ms of 50 ms
    assert legend(ax) == ["hardly known", "known roughly", "known well"]
    marks = [line for line in ax.get_lines() if line.get_label() in legend(ax)]
    assert len({line.get_marker() for line in marks}) == len({line.get_color() for line in marks}) == 3
    assert [text.get_text() for text in ax.texts] == ["+411 %"]  # where the arrow ends


def test_the_models_of_several_signals_are_told_apart_in_the_legend() -> None:
    frequency = np.array([0.05, 0.2, 1.0])
    response = dict.fromkeys(("n_e", "M_g"), 1.0 / (1.0 + 1j * frequency))
    one = FrequencyResponse("a", frequency, response)
    ax = windows([(one, one)], style.panels_of(None, 2, sharex=True))[0]
    shown = dict(zip(legend(ax), ax.get_legend().legend_handles, strict=True))
    for name, symbol in (("n_e", "$n_e$"), ("M_g", "$M_g$")):
        assert shown[f"model of {symbol}"].get_color() == style.COLOURS[name]


def test_axes_that_are_given_are_used_and_their_number_is_checked(trial) -> None:
    before = pyplot.get_fignums()
    axes = Figure().subplots(2, 1)
    assert plot.signals(trial, [*axes])[0] is axes[0]
    assert pyplot.get_fignums() == before
    with pytest.raises(InputError, match="3 axes given, expected 2"):
        plot.signals(trial, [axes[0]] * 3)


def test_thinning_keeps_every_extreme_and_every_long_gap() -> None:
    time = np.arange(100_000.0)
    samples = np.sin(time / 1000.0)
    samples[54_321] = 9.0
    samples[77] = -9.0
    samples[20_000:40_000] = np.nan
    samples[60_000] = np.nan
    thin_time, thin = style.envelope(time, samples, bins=500)
    assert thin.size == thin_time.size == 1000
    assert np.nanmax(thin) == 9.0
    assert np.nanmin(thin) == -9.0
    assert thin_time[np.nanargmax(thin)] == 54_321
    gap = (thin_time >= 20_000) & (thin_time < 40_000)
    assert np.isnan(thin[gap]).all()
    assert np.isfinite(thin[~gap]).all()
    assert (np.diff(thin_time) >= 0).all()


def test_a_short_signal_is_drawn_as_it_is() -> None:
    time, samples = np.arange(10.0), np.arange(10.0)
    assert style.envelope(time, samples)[1] is samples


def test_a_response_is_drawn_with_bars_of_two_standard_deviations_and_on_the_model_s_turn() -> None:
    frequency = np.geomspace(0.01, 3.0, 9)
    model = FrequencyResponse("model", frequency, {"n_e": np.exp(-1j * 2.0 * np.pi * frequency)})
    # The same response measured one turn on: a phase is known up to whole turns only.
    measured = FrequencyResponse(
        "S2 to S14",
        frequency[-2:],
        {"n_e": model.response["n_e"][-2:]},
        amplitude_std={"n_e": np.array([0.1, 0.2])},
        phase_std={"n_e": np.array([0.01, 3.0])},
    )
    amplitude, phase = plot.bode(measured, model)
    assert labels_have_units([amplitude, phase])
    points, curve = phase.containers[0], phase.get_lines()[0]
    np.testing.assert_allclose(points.lines[0].get_ydata(), curve.get_ydata()[-2:])
    (bars,) = points.lines[2]
    heights = [np.ptp(segment[:, 1]) for segment in bars.get_segments()]
    np.testing.assert_allclose(heights, [np.degrees(0.04), 360.0])  # a lost phase is anywhere on the circle
    (bars,) = amplitude.containers[0].lines[2]
    np.testing.assert_allclose([np.ptp(segment[:, 1]) for segment in bars.get_segments()], [0.4, 0.8])


def test_intervals_between_pulses_lie_on_one_line_for_each_reflector() -> None:
    fractions = np.array([0.26, 0.24, 0.255, 0.245])
    times = np.concatenate([[0.0], np.cumsum(np.tile(fractions, 100) / 5.0)])
    pulses = PulseTimes(times, np.empty((0, 2)), 1.0, 2.0, 3.0, 2000.0)
    ax = plot.pulse_intervals(pulses, 4, ReflectorAngles(fractions, np.full(4, 1e-4), True))
    assert labels_have_units([ax])
    for reflector, share in enumerate(fractions):
        dots = next(line for line in ax.get_lines() if line.get_label() == f"interval {reflector + 1} of 4")
        np.testing.assert_allclose(dots.get_ydata(), 400.0 * share - 100.0, atol=1e-9)
    lost = PulseTimes(np.delete(times, 201), np.empty((0, 2)), 1.0, 2.0, 3.0, 2000.0)
    (mark,) = (line for line in plot.pulse_intervals(lost, 4).get_lines() if line.get_label() == "beyond, 1")
    assert mark.get_xdata() == pytest.approx(times[202])
    with pytest.raises(InputError, match="3 pulses, expected more than the 4"):
        plot.pulse_intervals(PulseTimes(times[:3], np.empty((0, 2)), 1.0, 2.0, 3.0, 2000.0), 4)


def test_a_bar_never_reaches_zero_on_the_logarithmic_axis() -> None:
    spread = {"n_e": np.array([0.1, 3.0])}
    measured = FrequencyResponse("noisy", np.array([1.0, 2.0]), {"n_e": np.ones(2)}, spread, spread)
    amplitude, _ = plot.bode(measured)
    (bars,) = amplitude.containers[0].lines[2]
    np.testing.assert_allclose([segment[:, 1] for segment in bars.get_segments()], [[0.8, 1.2], [0.1, 7.0]])


def test_a_correlogram_shows_every_lag_the_band_and_what_is_outside(fingerprint):
    test = {"lags": [0, 1, 2, 4], "correlation": [0.01, 0.3, -0.02, -0.4], "band": [0.1, 0.1, 0.1, 0.1]}
    found = replace(
        fingerprint, residuals={"dn": {"autocorrelation": test, "set_point": test}}, data=({"rate_hz": 50.0},)
    )
    own, by_set_point = plot.correlogram(found, "dn")
    for ax in (own, by_set_point):
        within, outside = (line.get_xydata() for line in ax.lines[:2])
        np.testing.assert_allclose(within, [[0.0, 0.01], [0.04, -0.02]])
        np.testing.assert_allclose(outside, [[0.02, 0.3], [0.08, -0.4]])
        assert UNIT.search(ax.get_xlabel())
        assert UNIT.search(ax.get_ylabel())
    left, right = by_set_point.get_xlim()
    assert left < 0.0 < 0.08 < right
    with pytest.raises(InputError, match="residuals of 'dM' are not in the fingerprint, found dn"):
        plot.correlogram(found, "dM")


def test_a_single_point_has_its_whole_numbers_at_the_axes() -> None:
    figure = Figure()
    ax = figure.add_subplot()
    ax.plot([1183.8], [1725.0], "o")
    style.dress(ax, "torque [Nm]", legend=False)
    figure.canvas.draw()
    for axis in (ax.xaxis, ax.yaxis):
        assert axis.get_major_formatter().get_offset() == ""


def test_the_set_point_has_one_colour_that_no_other_signal_has() -> None:
    assert style.COLOURS["n_set"] == style.SET_POINT
    assert list(style.COLOURS.values()).count(style.SET_POINT) == 1


def test_windows_share_one_bode_plot_with_marks_of_their_own_and_plain_ticks() -> None:
    frequency = np.array([0.05, 0.2, 1.0])
    one = FrequencyResponse("a", frequency, {"n_e": 1.0 / (1.0 + 1j * frequency)})
    axes = windows([(one, one), (replace(one, name="b"), one)], style.panels_of(None, 2, sharex=True))
    marks = [line.get_marker() for line in axes[0].lines if line.get_linestyle() == "None"]
    assert len(set(marks)) == 2
    assert {"model of $n_e$", "a: $n_e$"} <= set(legend(axes[0]))
    assert axes[1].xaxis.get_major_formatter()(0.05) == "0.05"


def test_measured_set_point_and_model_are_told_apart(trial) -> None:
    ax = plot.fit(trial, trial, stretch_s=(1.0, 3.0), signals=["n_e"])[0]
    lines = {line.get_label(): line for line in ax.lines}
    assert len({lines[name].get_color() for name in ("measured", "model", "set point")}) == 3
    assert lines["measured"].get_linewidth() > 2.0 * lines["model"].get_linewidth()
