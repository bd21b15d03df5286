"""Logs after troubles that people report in public are read with every sample at its own time."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.inspection import inspect_log
from shipfp_rs.inspection.pictures import draw
from shipfp_rs.logs.channel import Channel, in_blocks
from shipfp_rs.logs.log import Log

CASES = Path(__file__).parents[1] / "data" / "cases"


def test_cases_invalid_samples_of_mdf_are_gaps_at_their_place() -> None:
    pytest.importorskip("asammdf")
    log = Log.open(CASES / "inval.mf4")
    rpm = log.read("rpm")
    expected = 900.0 + 50.0 * np.sin(log.channel("rpm").start_s + np.arange(2000) * 0.01)
    expected[300:330] = np.nan
    np.testing.assert_allclose(rpm, expected, atol=0.01)  # the stamps jitter
    np.testing.assert_array_equal(np.concatenate(list(log.chunks("rpm", 64))), rpm)
    assert inspect_log(log).channels


def test_cases_a_block_shorter_than_asked_for_is_an_error() -> None:
    short = in_blocks(lambda name: 10, lambda name, first, stop: np.zeros(stop - first - (first == 4)))
    log = Log("log", [Channel("u", "V", 1.0, 10)], short)
    with pytest.raises(InputError, match="channel 'u' gives 3 samples from sample 4 on, expected 4"):
        list(log.chunks("u", 4))


def test_cases_a_channel_that_ends_early_is_an_error() -> None:
    log = Log("log", [Channel("u", "V", 1.0, 10)], lambda name, first, size: iter([np.zeros(9 - first)]))
    with pytest.raises(InputError, match="log: channel 'u' gives 9 samples from sample 0 on, expected 10"):
        log.read("u")


def test_cases_segments_of_tdms_keep_their_own_times() -> None:
    pytest.importorskip("nptdms")
    with pytest.warns(LogWarning, match="between segments of the file"):
        log = Log.open(CASES / "restart.tdms")
    torque = log.read("Torque")
    assert len(torque) == 20_300
    known = np.flatnonzero(np.isfinite(torque))
    np.testing.assert_array_equal(known, [k + 10_000 * part for part in range(3) for k in range(300)])
    joined = Log.open(CASES / "restart.tdms", rate_hz=1000.0)
    np.testing.assert_array_equal(joined.read("Torque"), torque[known])


def test_cases_a_channel_of_zeros_is_drawn_without_a_warning(tmp_path: Path) -> None:
    log = Log.open(CASES / "zero.csv")
    inspection = inspect_log(log)
    assert "Sync" in inspection.spectra
    assert len(draw(inspection, log, tmp_path)) == 2
