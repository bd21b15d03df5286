"""Figures 3.2 to 5.18 of the thesis drawn from our own plant, and the sensitivity plots that its section 8.2 asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from shipfp_rs.reproduce import Reproduction
from shipfp_rs.reproduce import virtual_painters as painters
from shipfp_rs.reproduce.pictures import Painter, Picture, Stretch, save
from shipfp_rs.reproduce.virtual_painters import Material


def draw(folder: Path, found: Reproduction, progress: Callable[[int, int], None] | None = None) -> None:
    """Write every figure into a folder as PNG; `progress` gets (figures done, figures in all)."""
    save(PICTURES, Material(found), folder, progress)


_LOG = (
    "Logarithmic chirp, 0.0014 to 20 Hz in 1500 s, {amplitude}. Drawn as the smallest and largest sample of each "
    "pixel where it is denser than the picture."
)
_SMALL, _LARGE = _LOG.format(amplitude="13 rpm"), _LOG.format(amplitude="104 rpm")
_LINEAR = "Linear chirp, 0.0014 to 20 Hz in 1500 s, 13 rpm: 0.0133 Hz more each second."
_SINES = "Sixteen sines of four periods each, Table 5.1, 13 rpm. Above the slow ones, below the last minute."
_WHOLE, _LAST_MINUTE = Stretch(0.0, 2484.0), Stretch(2482.0, 2542.2)
_CHIRP, _FIRST_PART, _REST = Stretch(0.0, 1500.0), Stretch(0.0, 1000.0), Stretch(1000.0, 1500.0)
_TWELVE = Stretch(0.0, 12.0)


def _record_of(
    case: str,
    signals: Sequence[str],
    stretches: Sequence[Stretch],
    caption: str,
    points: Sequence[tuple[float, float, str]] = (),
) -> Painter[Material]:
    return partial(
        painters.record, case=case, signals=signals, stretches=stretches, caption=caption, points=points
    )


def _of_signals(first: int, painter: Callable[..., str]) -> Iterator[tuple[int, str, Painter[Material]]]:
    """Yield number, signal in words and painter of three figures, one a signal."""
    shown = (("n_e", "speed"), ("M_b", "torque"), ("E_n", "integrated error"))
    for number, (signal, words) in enumerate(shown, first):
        yield number, words, partial(painter, signal=signal)


PICTURES: tuple[Picture[Material], ...] = (
    Picture("fig_3_02.png", "Figure 3.2: bollard pull", painters.bollard_pull),
    Picture("fig_3_03.png", "Figure 3.3: brake power and the engine's limit", painters.brake_power),
    Picture("fig_3_04.png", "Figure 3.4: linear parameters from the plant", painters.parameters, 6.4),
    *(
        Picture(f"fig_3_0{number}.png", f"Figure 3.{number}: steps, {words}", painter, 7.0)
        for number, words, painter in _of_signals(5, painters.single_steps)
    ),
    *(
        Picture(f"fig_3_{number:02}.png", f"Figure 3.{number}: {words} over set point", painter, 6.0)
        for number, words, painter in _of_signals(8, painters.bode)
    ),
    Picture(
        "fig_4_01.png", "Figure 4.1: the unavoidable error of a linear structure", painters.unavoidable, 5.6
    ),
    Picture(
        "fig_5_01.png",
        "Figure 5.1: sine sequence",
        _record_of("ii", ["n_set"], [_WHOLE, _LAST_MINUTE], _SINES),
    ),
    Picture(
        "fig_5_02.png",
        "Figure 5.2: sine sequence, speed",
        _record_of("ii", ["n_set", "n_e"], [_WHOLE, _LAST_MINUTE], _SINES),
    ),
    Picture(
        "fig_5_03.png",
        "Figure 5.3: sine sequence, torque",
        _record_of("ii", ["n_set", "M_b"], [_WHOLE, _LAST_MINUTE], _SINES),
    ),
    Picture(
        "fig_5_04.png", "Figure 5.4: logarithmic chirp", _record_of("iv", ["n_set"], [_CHIRP], _SMALL), 4.0
    ),
    Picture(
        "fig_5_05.png",
        "Figure 5.5: logarithmic chirp, speed",
        _record_of("iv", ["n_set", "n_e"], [_CHIRP], _SMALL),
        4.0,
    ),
    Picture(
        "fig_5_06.png",
        "Figure 5.6: logarithmic chirp, torque",
        _record_of("iv", ["n_set", "M_b"], [_FIRST_PART, _REST], _SMALL),
    ),
    Picture(
        "fig_5_07.png",
        "Figure 5.7: linear chirp",
        _record_of("iii", ["n_set"], [Stretch(0.0, 50.0)], _LINEAR),
        4.0,
    ),
    Picture(
        "fig_5_08.png",
        "Figure 5.8: linear chirp, speed",
        _record_of(
            "iii",
            ["n_set", "n_e"],
            [_TWELVE],
            _LINEAR + " The text reads 0.9 of the set point at 6 s; here 0.89.",
            [(6.0, 0.009, "section 5.1.2")],
        ),
        4.4,
    ),
    Picture(
        "fig_5_09.png",
        "Figure 5.9: linear chirp, torque",
        _record_of(
            "iii",
            ["n_set", "M_b"],
            [_TWELVE],
            _LINEAR
            + " The text reads 1.9 times the set point at 6 s; here 1.84, and 1.90 at the crest half a second before.",
            [(6.0, 0.019, "section 5.1.2")],
        ),
        4.4,
    ),
    Picture(
        "fig_5_10.png",
        "Figure 5.10: logarithmic chirp of eight times the amplitude",
        _record_of("v", ["n_set"], [_CHIRP], _LARGE),
        4.0,
    ),
    Picture(
        "fig_5_11.png",
        "Figure 5.11: the same, speed",
        _record_of("v", ["n_set", "n_e"], [_CHIRP], _LARGE),
        4.0,
    ),
    Picture(
        "fig_5_12.png",
        "Figure 5.12: the same, torque",
        _record_of(
            "v",
            ["n_set", "M_b"],
            [_FIRST_PART, _REST],
            _LARGE
            + " From 1172 s on the engine's limit cuts the top of each swing: this is what biases case v.",
        ),
    ),
    Picture(
        "fig_5_13.png",
        "Figure 5.13: validation steps, speed",
        _record_of(
            "steps",
            ["n_set", "n_e"],
            [Stretch(0.0, 80.0)],
            "Three steps of 5 %, 20 s apart: with 1 % as section 5.1.3 says the printed validation can't be had.",
        ),
        4.0,
    ),
    Picture(
        "fig_5_14.png",
        "Figure 5.14: validation steps, torque",
        _record_of(
            "steps",
            ["n_set", "M_b"],
            [Stretch(0.0, 80.0)],
            "Three steps of 5 %, 20 s apart, as in Figure 5.13.",
        ),
        4.0,
    ),
    Picture("fig_5_15.png", "Figure 5.15: speed", partial(painters.identified_bode, signal="n_e"), 7.6),
    Picture("fig_5_16.png", "Figure 5.16: torque", partial(painters.identified_bode, signal="M_b"), 7.6),
    Picture(
        "fig_5_17.png",
        "Figure 5.17: estimates against the steps",
        painters.against_steps,
        6.4,
    ),
    Picture("fig_5_18.png", "Figure 5.18: the third step, torque", painters.third_step),
    *(
        Picture(
            f"sensitivity_{name}.png",
            f"Sensitivity to {name}, the others fixed",
            partial(painters.sensitivity, name=name),
            7.6,
        )
        for name in painters.PARAMETERS
    ),
)
FILES = tuple(picture.file for picture in PICTURES)
"""Names of the files that `draw` writes."""
