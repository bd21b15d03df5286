"""A record: an experiment made ready for a fit once, then frozen.

The ship is driven by the set point at a fine rate and seen as the data are: at the same samples, through the same low-pass
and the same taper, as spectra at the frequencies of a band. No filter stands between model and data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.fft import prev_fast_len, rfft
from scipy.signal import firwin, resample_poly, upfirdn

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment, Hold
from shipfp_rs.support.arrays import Array, ComplexArray

Between = Literal["band-limited", "straight", "held"]
"""How inputs run between their samples: through all of them without a corner, along lines, or as stairs."""
BAND_HZ = 4.0
"""Highest frequency that is compared at most [Hz]: tachometers and loops of ships tell little above."""
EXCITED = 0.99
"""Part of the inputs' power times frequency that lies below the band's end: above it the data are noise."""
LEAST_HZ, LEAST_PERIODS = 0.5, 40
"""Least end of a band [Hz], and least number of the record's own frequencies in it, from which the noise is estimated."""
EDGE_S = 2.0
"""Over which a record fades in and out [s], so that its ends leave nothing in the band."""
SHORTEST_S = 10.0 * EDGE_S
"""Shortest record that has a spectrum [s]."""
BEFORE_S = 2.0
"""First stretch that is simulated but not compared [s]: a record that begins in the middle of an excitation does not tell
what went on before, and dead times carry that into it."""
STEP_S = 0.005
"""Longest step of the last descent [s]; at 4 Hz straight lines between its ends lack 0.02 per cent of the loop's motions."""
SHARPENED = np.array([-1.0, 14.0, -1.0]) / 12.0
"""Samples behind this have in straight lines what the signal has: 1 + (pi f / rate)^2 / 3 of it, which such lines take off
(Unser 1999, doi:10.1109/79.799930, on the spline of first degree)."""
EITHER_SIDE, RIPPLE_1E_5 = 32, ("kaiser", 10.0)
"""Samples on either side that an interpolation takes, and its window: flat to 1e-5 up to 0.45 of the rate. The torque
follows from a small difference of set point and speed: a ripple of 0.1 per cent moves a parameter beyond its interval."""
TAPS_A_STEP = 6
"""Half of the low-pass's length in samples of the decimated rate; 60 dB with the window below."""


@dataclass(frozen=True, eq=False)
class Record:
    """One experiment, frozen.

    Parameters
    ----------
    name
        The experiment's.
    u, load
        Set point over the operating point's, and deviation of a measured load, at `rate_hz`, shapes (N,) and (N,) or (0,).
    rate_hz, stride, substeps, hold
        Rate of the inputs [Hz], their samples between two of the data, steps between two of them, and how they run between.
    measured
        Normalised deviations of the outputs (O, M) at the data's rate, NaN where masked.
    data_hz, seen_hz, band_hz
        Rate of the data, the highest frequency that the low-pass keeps, and the highest that is compared [Hz].
    """

    name: str
    u: Array
    load: Array
    rate_hz: float
    stride: int
    substeps: int
    hold: Hold
    measured: Array
    data_hz: float
    seen_hz: float
    band_hz: float

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        measured: Array,
        *,
        load: bool = False,
        between: Between | None = None,
        band_hz: float = BAND_HZ,
        step_s: float = STEP_S,
    ) -> Record:
        """Make an experiment ready.

        Parameters
        ----------
        experiment, measured
            What was recorded, and of it the normalised outputs (O, M).
        load
            Whether the experiment's load torque drives the ship, too.
        between
            How the inputs run between their samples; None: band-limited where processing low-passed them, else as the
            experiment says.
        band_hz, step_s
            Highest frequency compared at most [Hz], if the inputs reach so far, and longest step of the simulation [s].

        Raises
        ------
        InputError
            Where the record is too short for a spectrum.
        """
        rate_hz = experiment.rate_hz
        u, loads = 1.0 + experiment.dn_set, experiment.normalised("M_load") if load else np.empty(0)
        seen_hz = min(band_hz, 0.4 * rate_hz)
        top_hz = excited_hz([u, loads], rate_hz, seen_hz)
        held = between == "held" or experiment.hold == "zero"
        smooth = experiment.is_low_passed if between is None else between == "band-limited"
        # Samples that a step leaves out, but none of those that the decimated data keep.
        down = down_of(rate_hz, seen_hz)
        # A step keeps its instant.
        thin = (
            1
            if held
            else max(
                one for one in range(1, down + 1) if down % one == 0 and one <= max(step_s * rate_hz, 1.0)
            )
        )
        if thin > 1:
            u, loads = (_thinned(values, thin) for values in (u, loads))
            measured = np.array([_thinned(row, thin) for row in measured])
            rate_hz, smooth = rate_hz / thin, True
        fine = max(1, int(np.ceil(1.0 / (step_s * rate_hz) - 1e-9)))
        stride, substeps = 1, fine
        if smooth and not held:
            # Straight lines between fine samples are near what a low-pass leaves between coarse ones.
            u, loads = (_sharpened(interpolated(values, fine)) for values in (u, loads))
            stride, substeps = fine, 1
        if experiment.duration < SHORTEST_S:
            raise InputError(
                f"experiment {experiment.name!r}: {experiment.duration:.3g} s, expected {SHORTEST_S:g} s or more; "
                "take a longer window, or give a structure and noise='white'"
            )
        return cls(
            name=experiment.name,
            u=np.ascontiguousarray(u),
            load=np.ascontiguousarray(loads),
            rate_hz=rate_hz * stride,
            stride=stride,
            substeps=substeps,
            hold="zero" if held else "first",
            measured=measured,
            data_hz=rate_hz,
            seen_hz=seen_hz,
            band_hz=top_hz,
        )

    @cached_property
    def down(self) -> int:
        """Samples of the data between two that are kept."""
        return down_of(self.data_hz, self.seen_hz)

    @cached_property
    def taps(self) -> Array:
        """Low-pass before the decimation, shape (T,)."""
        if self.down == 1:
            return np.ones(1)
        length = 2 * TAPS_A_STEP * self.down + 1
        kept = self.data_hz / self.down
        return np.asarray(firwin(length, 0.5 * kept, window=("kaiser", 6.0), fs=self.data_hz))

    @cached_property
    def masked(self) -> npt.NDArray[np.bool_]:
        """What the data have not, shape (M, O)."""
        return np.ascontiguousarray(np.isnan(self.measured).T)

    @cached_property
    def _kept(self) -> tuple[Array, npt.NDArray[np.intp], Array]:
        """Frequencies [Hz] (F,), their places, and the taper."""
        # A length that the transform is quick at; the last second or so fades out anyhow.
        count = prev_fast_len(-(-self.measured.shape[1] // self.down), real=True)
        rate = self.data_hz / self.down
        at = np.arange(count) / rate
        edge = np.clip(np.minimum(at - BEFORE_S, at[-1] - at) / EDGE_S, 0.0, 1.0)
        frequency = np.fft.rfftfreq(count, 1.0 / rate)
        places = np.flatnonzero(frequency <= self.band_hz)
        return np.asarray(frequency[places]), places, np.asarray(0.5 - 0.5 * np.cos(np.pi * edge))

    @property
    def frequency_hz(self) -> Array:
        """Frequencies that are compared [Hz], from the mean at 0 on, shape (F,)."""
        return self._kept[0]

    @cached_property
    def decimated(self) -> Array:
        """The data behind the low-pass, shape (O, K)."""
        return self.as_recorded(self.measured)

    def as_recorded(self, signals: Array) -> Array:
        """Bridge signals (..., O, N) where the data have gaps, low-pass and decimate them, shape (..., O, K)."""
        if self.masked.any():
            signals = signals.copy()
            samples = np.arange(signals.shape[-1])
            for output, gaps in enumerate(self.masked.T):
                kept = np.flatnonzero(~gaps)
                after = np.clip(np.searchsorted(kept, samples[gaps]), 1, max(len(kept) - 1, 1))
                first, last = kept[after - 1], kept[np.minimum(after, len(kept) - 1)]
                share = np.clip((samples[gaps] - first) / np.maximum(last - first, 1), 0.0, 1.0)
                one = signals[..., output, :]
                one[..., gaps] = (1.0 - share) * one[..., first] + share * one[..., last]
        half = len(self.taps) // 2
        wide = np.pad(signals, [(0, 0)] * (signals.ndim - 1) + [(half, half + self.down)], mode="edge")
        seen = upfirdn(self.taps, wide, axis=-1)[..., 2 * half :: self.down]
        return np.asarray(seen[..., : len(self._kept[2])])

    @property
    def set_point_low(self) -> Array:
        """Deviation of the set point behind the low-pass, decimated (K,)."""
        half = len(self.taps) // 2
        wide = np.pad(self.u[:: self.stride] - 1.0, (half, half + self.down), mode="edge")
        return np.asarray(upfirdn(self.taps, wide)[2 * half :: self.down][: len(self._kept[2])])

    @cached_property
    def spectrum(self) -> ComplexArray:
        """Spectra of the data, shape (O, F)."""
        return self.see(self.decimated)

    def see(self, decimated: Array) -> ComplexArray:
        """Return the tapered spectra of decimated signals (..., K), shape (..., F)."""
        _, places, taper = self._kept
        found = rfft(decimated * taper, axis=-1)[..., places] / np.sqrt(0.5 * len(taper))
        # The mean is a real number, with twice the variance of either part of the others.
        found[..., 0] *= np.sqrt(0.5)
        return np.asarray(found)

    def driven_by(self, water: Array) -> Record:
        """Return the record with what moving water adds to the load's torque, at the decimated data's rate, shape (K,)."""
        fine = interpolated(water, self.stride * self.down)
        count = len(self.u)
        fine = np.pad(fine, (0, max(count - len(fine), 0)), mode="edge")[:count]
        return replace(self, load=np.ascontiguousarray(fine + self.load if self.load.size else fine))

    def simulated(self, parameters: Array, outputs: Sequence[int], wrt: Sequence[int]) -> Array:
        """Return the decimated outputs and their derivatives, shape (O, 1 + W, K).

        Raises
        ------
        SimulationError
            Where the ship runs away.
        """
        seen = _core.ship_observed(
            parameters,
            self.u,
            self.load,
            1.0 / self.rate_hz,
            self.substeps,
            self.hold,
            self.stride,
            outputs,
            wrt,
            self.masked,
            self.taps,
            self.down,
        )
        return seen[..., : len(self._kept[2])]


def down_of(rate_hz: float, seen_hz: float) -> int:
    """Samples of data at a rate between two that are kept: three or more a period of the highest frequency seen."""
    return max(1, int(rate_hz / (3.0 * seen_hz) + 1e-9))


def _thinned(values: Array, factor: int) -> Array:
    """Every so manieth sample of a signal behind a low-pass; masked where one of its own was."""
    if not len(values):
        return values
    kept, at = np.isfinite(values), np.arange(len(values))
    bridged = np.interp(at, at[kept], values[kept])
    pad = 20 * factor
    wide = np.pad(bridged - bridged[0], pad, mode="edge")
    found = resample_poly(wide, 1, factor)[pad // factor :][: -(-len(values) // factor)] + bridged[0]
    torn = np.add.reduceat(~kept, np.arange(0, len(values), factor)) > 0
    return np.where(torn, np.nan, found)


def excited_hz(inputs: Sequence[Array], rate_hz: float, most_hz: float) -> float:
    """Return the frequency [Hz] up to which the inputs have `EXCITED` of their power times frequency, at most `most_hz`."""
    found = LEAST_HZ
    for one in inputs:
        if not len(one):
            continue
        count = prev_fast_len(len(one), real=True)
        fade = np.minimum(np.arange(count), np.arange(count)[::-1]) / (EDGE_S * rate_hz)
        power = np.abs(rfft((one[:count] - one[:count].mean()) * np.clip(fade, 0.0, 1.0))) ** 2
        frequency = np.fft.rfftfreq(count, 1.0 / rate_hz)
        grown = np.cumsum(np.where(frequency <= most_hz, power * frequency, 0.0))
        found = max(
            found,
            float(frequency[np.searchsorted(grown, EXCITED * grown[-1])]),
            LEAST_PERIODS * rate_hz / count,
        )
    return min(found, most_hz)


def interpolated(values: Array, factor: int) -> Array:
    """Samples of a band-limited signal at `factor` times its rate, at its ends as they were."""
    if factor == 1 or not len(values):
        return values
    pad = 200
    wide = np.pad(values, pad, mode="edge")
    taps = firwin(2 * EITHER_SIDE * factor + 1, 1.0 / factor, window=RIPPLE_1E_5)
    fine = resample_poly(wide - wide[0], factor, 1, window=taps)
    return np.asarray(fine[pad * factor : (pad + len(values)) * factor] + wide[0])


def _sharpened(values: Array) -> Array:
    """Return samples which, joined by straight lines, have the amplitudes of the band-limited signal."""
    return np.convolve(np.pad(values, 1, mode="edge"), SHARPENED, "valid") if len(values) else values
