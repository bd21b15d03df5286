"""Channels of one nominal rate whose clocks run apart, as those of a bus's nodes do, come to one clock."""

import numpy as np
import pytest

from shipfp_rs.logs.channel import Channel
from shipfp_rs.processing.conditioning import LowPass, on_a_simple_rate


@pytest.mark.parametrize("apart", [2e-6, 5e-5, -4e-4])
def test_a_clock_that_runs_apart_costs_a_thousandth(apart: float) -> None:
    rate = 100.0 * (1.0 + apart)
    samples = np.sin(2.0 * np.pi * 15.0 * np.arange(20_000) / rate + 0.3)
    channel, source = on_a_simple_rate(
        Channel("u", "V", rate, len(samples), 0.0), lambda first, stop: samples[first:stop], 50.0
    )
    assert channel.rate_hz == pytest.approx(100.0, rel=1e-12)
    found = LowPass(channel, 50.0, 100.0)(source, 9800)
    expected = np.sin(2.0 * np.pi * 15.0 * (1.0 + np.arange(9800) / 50.0) + 0.3)
    assert np.abs(found - expected).max() < 2e-3


def test_what_is_masked_stays_masked() -> None:
    samples = np.ones(20_000)
    samples[5000:5100] = np.nan
    channel, source = on_a_simple_rate(
        Channel("u", "V", 100.01, len(samples), 0.0), lambda first, stop: samples[first:stop], 50.0
    )
    found = LowPass(channel, 50.0, 0.0)(source, 9000)
    masked = np.flatnonzero(np.isnan(found))
    assert masked.min() == pytest.approx(2500, abs=4)
    assert masked.max() == pytest.approx(2549, abs=4)
    np.testing.assert_allclose(found[np.isfinite(found)], 1.0, atol=1e-3)


def test_another_rate_is_no_clock_that_runs_apart() -> None:
    channel = Channel("u", "V", 101.0, 1000, 0.0)
    assert on_a_simple_rate(channel, lambda first, stop: np.zeros(stop - first), 50.0)[0] is channel
