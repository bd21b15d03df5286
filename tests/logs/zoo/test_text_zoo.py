"""Text logs as people export them: each is read to the samples, units and times it was made of, or refused in one line."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from tests.logs.zoo.text_layouts import LAYOUTS, SPEED, START, TORQUE, Layout


def test_the_zoo_is_large() -> None:
    assert len(LAYOUTS) >= 80
    assert len({layout.name for layout in LAYOUTS}) == len(LAYOUTS)


@pytest.mark.parametrize("layout", LAYOUTS, ids=[layout.name for layout in LAYOUTS])
def test_breakage_c4_text_layouts(layout: Layout, tmp_path: Path) -> None:
    path = tmp_path / f"log{layout.suffix}"
    path.write_bytes(layout.content)
    if layout.refused:
        with pytest.raises(InputError) as caught:
            Log.open(path, rate_hz=layout.rate_hz, time=layout.time)
        assert layout.refused in str(caught.value)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
        return
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        log = Log.open(path, rate_hz=layout.rate_hz, time=layout.time)
    said = " | ".join([*log.notes, *(str(warning.message) for warning in told)])
    assert layout.says in said
    np.testing.assert_allclose(log.read(layout.torque), TORQUE, rtol=1e-12)
    np.testing.assert_allclose(log.read(layout.speed), SPEED, rtol=1e-12)
    channel, speed = log.channels[layout.torque], log.channels[layout.speed]
    assert (channel.unit, speed.unit) == layout.units
    assert channel.rate_hz == pytest.approx(layout.rate, rel=2e-3 if layout.within_s > 1e-5 else 1e-6)
    if layout.start_utc is not None:
        assert log.start_utc is not None
        first = (log.start_utc - layout.start_utc).total_seconds() + channel.start_s
        assert first == pytest.approx(0.0, abs=max(layout.within_s, 2e-6))
    elif layout.start_s is not None:
        assert channel.start_s == pytest.approx(layout.start_s, abs=layout.within_s)
        assert log.start_utc is None or abs((log.start_utc - START).total_seconds()) < 1.0
