"""Figures 6.10 to 7.23 of the thesis as far as published numbers allow; records are those of the simulated tug."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from shipfp_rs.reproduce import Reproduction, fullscale_sensors
from shipfp_rs.reproduce import fullscale_painters as painters
from shipfp_rs.reproduce.fullscale_painters import Material
from shipfp_rs.reproduce.pictures import Painter, Picture, Stretch, save


def draw(folder: Path, found: Reproduction, progress: Callable[[int, int], None] | None = None) -> None:
    """Write every figure into a folder as PNG; `progress` gets (figures done, figures in all)."""
    save(PICTURES, Material(found), folder, progress)


def _record(experiment: str, signals: tuple[str, ...], *stretches: Stretch) -> Painter[Material]:
    return partial(painters.record, experiment=experiment, signals=signals, stretches=stretches)


def _against(experiment: str, stretch: Stretch, *cases: str) -> Painter[Material]:
    return partial(painters.against, experiment=experiment, stretch=stretch, cases=cases)


_SET, _SPEED, _TORQUE = ("n_set",), ("n_set", "n_e"), ("n_set", "M_g")
_SINES, _FAST = Stretch(0.0, 2791.0), Stretch(2640.0, 2665.0)
_SHORT, _LONG, _STEPS = Stretch(0.0, 500.0), Stretch(0.0, 1500.0), Stretch(0.0, 450.0)
_THIRD = Stretch(170.0, 180.0)
_ALL = ("i", "ii", "iii", "iv", "ours")

PICTURES: tuple[Picture[Material], ...] = (
    Picture("fig_6_11.png", "Figure 6.11: one pulse and four pulses a turn", fullscale_sensors.two_trains),
    Picture(
        "fig_6_13.png", "Figure 6.13: torque at a constant set point", fullscale_sensors.steady_torque, 4.0
    ),
    Picture("fig_6_14.png", "Figure 6.14: its spectrum", fullscale_sensors.spectrum, 4.6),
    Picture("fig_6_15.png", "Figure 6.15: fault A, double crossings", fullscale_sensors.double_crossing),
    Picture(
        "fig_6_16.png", "Figure 6.16: fault B, broken pulses at high speed", fullscale_sensors.broken_pulses
    ),
    Picture("fig_6_17.png", "Figure 6.17: fault C, radio on the torque", fullscale_sensors.radio, 4.4),
    Picture(
        "fig_6_18.png", "Figure 6.18: faults D1 and D2 on the set point", fullscale_sensors.set_point_faults
    ),
    Picture("fig_6_19.png", "Figure 6.19: fault D3, a chirp that stays", fullscale_sensors.even_chirp, 4.0),
    Picture("fig_6_20.png", "Figure 6.20: speed and set-point voltage", painters.set_point_line),
    Picture("fig_7_01.png", "Figure 7.1: sines S2 to S13", _record("sines", _SET, _SINES), 4.0),
    Picture("fig_7_02.png", "Figure 7.2: the same, speed", _record("sines", _SPEED, _SINES), 4.0),
    Picture("fig_7_03.png", "Figure 7.3: from S12 to S13", _record("sines", _SPEED, _FAST), 4.0),
    Picture("fig_7_04.png", "Figure 7.4: the same, torque", _record("sines", _TORQUE, _SINES), 4.0),
    Picture("fig_7_05.png", "Figure 7.5: what elements do to the torque", painters.lively, 4.8),
    Picture(
        "fig_7_06.png", "Figure 7.6: speed over set point", partial(painters.measured_bode, signal="n_e"), 6.0
    ),
    Picture(
        "fig_7_07.png",
        "Figure 7.7: torque over set point",
        partial(painters.measured_bode, signal="M_g"),
        6.0,
    ),
    Picture("fig_7_08.png", "Figure 7.8: short chirp C11", _record("short chirp", _SET, _SHORT), 4.0),
    Picture("fig_7_09.png", "Figure 7.9: the same, speed", _record("short chirp", _SPEED, _SHORT), 4.0),
    Picture("fig_7_10.png", "Figure 7.10: the same, torque", _record("short chirp", _TORQUE, _SHORT), 4.0),
    Picture("fig_7_11.png", "Figure 7.11: long chirp C21 to C23", _record("long chirp", _SET, _LONG), 4.0),
    Picture("fig_7_12.png", "Figure 7.12: the same, speed", _record("long chirp", _SPEED, _LONG), 4.0),
    Picture("fig_7_13.png", "Figure 7.13: the same, torque", _record("long chirp", _TORQUE, _LONG), 4.0),
    Picture("fig_7_14.png", "Figure 7.14: steps St1", painters.step_record, 5.6),
    Picture("fig_7_15.png", "Figure 7.15: speed", partial(painters.identified_bode, signal="n_e"), 6.0),
    Picture("fig_7_16.png", "Figure 7.16: torque", partial(painters.identified_bode, signal="M_g"), 6.0),
    Picture("fig_7_17.png", "Figure 7.17: sets against steps", _against("steps", _STEPS, *_ALL), 6.0),
    Picture("fig_7_18.png", "Figure 7.18: the third step", _against("steps", _THIRD, *_ALL), 6.0),
    Picture(
        "fig_7_19.png",
        "Figure 7.19: sets against sines, S12 and S13",
        _against("sines", _FAST, "i", "iii", "iv", "ours"),
        6.0,
    ),
    Picture(
        "fig_7_20.png",
        "Figure 7.20: sets against the short chirp near 1 Hz",
        _against("short chirp", Stretch(408.0, 422.0), "i", "ii", "iv", "ours"),
        6.0,
    ),
    Picture(
        "fig_7_21.png",
        "Figure 7.21: sets against the long chirp near 1 Hz",
        _against("long chirp", Stretch(1304.0, 1318.0), "i", "ii", "iii", "ours"),
        6.0,
    ),
    Picture("fig_7_22.png", "Figure 7.22: inertia on either side of the gauge", painters.inertias, 4.0),
    Picture("fig_7_23.png", "Figure 7.23: why the fits failed", painters.causes, 4.2),
)
FILES = tuple(picture.file for picture in PICTURES)
"""Names of the files that `draw` writes."""
