"""Spectra of a record, computed once: all that the two equations of a ship need of an experiment.

A taper w and an operator H do not commute: F[w (H x)] = sum_k (-1)^k / k! H^(k)(s) F[w^(k) x]. So each signal has one
spectrum with the taper and one with each of the taper's first three derivatives, which are exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, prev_fast_len, rfft
from scipy.interpolate import CubicSpline
from scipy.signal import firwin, upfirdn

from shipfp_rs import _core
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.coordinates import loop_of
from shipfp_rs.identification.gaps import kriged
from shipfp_rs.identification.sampling import BAND_HZ, SHORTEST_S, Between, down_of, excited_hz
from shipfp_rs.structures.transfer import TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray

QUICK, MOMENTS = 0.1, 0.03
"""A set point goes in steps if it moves faster than `QUICK` times its fastest motion in at most `MOMENTS` of the samples."""
ORDERS: int = _core.EQUATION_ORDERS
"""Number of terms of the series: the taper and the derivatives of it that are used."""
EDGE_S, EDGE_SHARE, BEFORE_S = 3.0, 0.025, 2.0
"""Least length of the taper's edges [s], their least share of the record, and time at its beginning that is left out [s].
Dead times carry into that time what went on before the record began. Both equations followed by the inverse of their loop
leave noise unchanged, except at the edges: steep edges turn much noise of one output into noise of the other."""
GRID_S = 0.05
"""Step of the delays by which a signal is moved before it is tapered [s]; a series does the rest of a delay."""
TAPS_A_SAMPLE, PASSED, WINDOW_80_DB = 24, 0.43, ("kaiser", 9.0)
"""Low-pass before a decimation: its length in decimated samples, its passband edge over the decimated rate, its window."""
RISE = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
"""Edge of the taper: from 0 to 1 with three continuous derivatives."""
PAD_S = 6.0
"""Padding at either end of a signal that is moved by a delay [s]."""
IMAGES = {"held": 24, "straight": 4}
"""Number of multiples of the sample rate, on either side of zero, whose images of the set point are computed."""

KRIGED_S, MOST_KRIGED = 0.6, 100
"""Stretch on either side of a gap from which the missing samples are estimated [s], and the most samples of it."""
FEW = 13
"""Number of frequencies at which images are computed for a comparison: apart from a delay they vary slowly."""
AT_ONCE = 1e4
"""Frequency over the sample rate at which a frequency response equals the instant response to a jump."""
SLOW_PACE, QUICK_PACE = 5.0, 16.0
"""Bandwidths of loops [rad/s]: above the first a record may be shorter than `SHORTEST_S`; above the second more frequencies
are compared."""
WHOLE_EDGES_S = 24.0
"""Length of a record from which its edges have full length [s]; a shorter record has shorter edges in proportion."""
PACES, DEAD_TIMES_S, STRONGEST = np.geomspace(1.0, 400.0, 32), np.arange(0.0, 0.6, 0.02), 300
"""Bandwidths [rad/s] and dead times [s] of the first-order loops that are compared with the speed, and the number of
frequencies, the strongest of the set point, at which they are compared."""


Respond = Callable[[Mapping[str, float], Array], ComplexArray]
"""Maps parameters and frequencies [Hz] to the outputs' response (O, F) to the ship's input."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Signals of an experiment as tapered spectra.

    Parameters
    ----------
    name, outputs
        The experiment's name; its outputs, "dn", "dM" or "dX".
    set_point, load
        Deviation of the set point (N,) and of a measured load (N,) or (0,).
    measured
        Normalised deviations of the outputs (O, N), NaN where masked.
    data_hz, seen_hz, band_hz
        Rate of the data, highest frequency that the low-pass keeps and highest that is compared [Hz].
    between
        How the set point runs between its samples.
    model
        Model's outputs (O, N), which stand in for masked samples; None: masked samples are estimated from the data alone.
    images
        Part of the outputs (O, N) that the set point's images about multiples of the sample rate cause; None: not known yet.
    shown
        Spectra (O, F) of the images of a held set point that were taken off; None: none were.
    limited
        What limits of torque and rate take off the outputs (O, N), by a model; None: nothing.
    slip
        Difference in speed between the engine's and the propeller's end of a shaft that twists, decimated (K,); None: a
        stiff shaft.
    is_linear
        Whether the load's law is a straight line, without squares of the speed.
    """

    name: str
    outputs: tuple[str, ...]
    set_point: Array
    load: Array
    measured: Array
    data_hz: float
    seen_hz: float
    band_hz: float
    between: Between
    model: Array | None = None
    images: Array | None = None
    shown: ComplexArray | None = None
    limited: Array | None = None
    slip: Array | None = None
    is_linear: bool = False
    _delayed: dict[tuple[str, float], Array] = field(default_factory=dict, repr=False)
    _low_passed: dict[str, Array] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        outputs: tuple[str, ...],
        measured: Array,
        *,
        load: bool = False,
        between: Between | None = None,
        wide: bool = False,
    ) -> Spectra:
        """Make an experiment ready.

        Parameters
        ----------
        experiment, outputs, measured
            The recorded experiment, the names of its outputs, and the normalised outputs (O, N).
        load
            Whether the experiment's load torque drives the ship, too.
        between
            How the set point runs between its samples; None: band-limited where processing low-passed it, else as the
            experiment says.
        wide
            Whether the band goes up to the highest frequency that the inputs excite. It must for a user's own structure,
            whose bandwidth is unknown.

        Raises
        ------
        InputError
            Where the record is too short for a spectrum.
        """
        set_point = np.asarray(experiment.dn_set, dtype=float)
        loads = experiment.normalised("M_load") if load else np.empty(0)
        speed = measured[outputs.index("dn") if "dn" in outputs else 0]
        pace = _pace(set_point, speed, experiment.rate_hz)
        least_s = SHORTEST_S * min(SLOW_PACE / max(pace, SLOW_PACE), 1.0)
        if experiment.duration < least_s:
            raise InputError(
                f"experiment {experiment.name!r}: {experiment.duration:.3g} s, expected {least_s:.2g} s or more of a "
                "drive of this pace; take a longer window, or give a structure and noise='white'"
            )
        most_hz = np.inf if wide else BAND_HZ * max(pace / QUICK_PACE, 1.0)
        seen_hz = min(most_hz, 0.4 * experiment.rate_hz)
        band_hz = excited_hz([set_point, loads], experiment.rate_hz, seen_hz)
        if between is None:
            low_passed: Between = "band-limited" if experiment.is_low_passed else "straight"
            between = "held" if experiment.hold == "zero" else low_passed
        return cls(
            name=experiment.name,
            outputs=outputs,
            set_point=set_point,
            load=loads,
            measured=measured,
            data_hz=experiment.rate_hz,
            seen_hz=band_hz if wide else seen_hz,
            band_hz=band_hz,
            between=between,
        )

    @cached_property
    def down(self) -> int:
        """Samples of the data for one decimated sample."""
        return down_of(self.data_hz, self.seen_hz)

    @property
    def rate_hz(self) -> float:
        """Rate of the decimated data [Hz]."""
        return self.data_hz / self.down

    @cached_property
    def count(self) -> int:
        """Number of decimated samples, chosen so that the Fourier transform is fast."""
        return int(prev_fast_len(-(-self.measured.shape[1] // self.down), real=True))

    @cached_property
    def frequency_hz(self) -> Array:
        """Frequencies that are compared [Hz], shape (F,); the first is 0, the mean."""
        frequency = np.fft.rfftfreq(self.count, 1.0 / self.rate_hz)
        return np.asarray(frequency[: np.searchsorted(frequency, self.band_hz, side="right")])

    @cached_property
    def spacing(self) -> float:
        """Spacing of the frequencies [rad/s]."""
        return 2.0 * np.pi * self.rate_hz / self.count

    @cached_property
    def padded(self) -> int:
        """Number of frequencies, padded to whole blocks of the kernel."""
        block = _core.EQUATION_BLOCK
        return -(-len(self.frequency_hz) // block) * block

    @cached_property
    def masked(self) -> npt.NDArray[np.bool_]:
        """Whether each sample of each output is missing, shape (N, O)."""
        return np.ascontiguousarray(np.isnan(self.measured).T)

    @cached_property
    def tapers(self) -> Array:
        """The taper and its time derivatives, shape (ORDERS, K)."""
        return _tapers(self.count, self.rate_hz)

    def tapered(self, signal: Array, orders: int = ORDERS) -> ComplexArray:
        """Return spectra of a decimated signal (K,) with each order of the taper, shape (orders, F)."""
        return self._scaled(rfft(signal * self.tapers[:orders], axis=-1))

    def low_passed(self, signals: Array) -> Array:
        """Low-pass and decimate signals (..., N), shape (..., K)."""
        if self.down == 1:
            return signals[..., : self.count]
        taps = _low_pass(self.down)
        half = len(taps) // 2
        wide = np.pad(signals, [(0, 0)] * (signals.ndim - 1) + [(half, half + self.down)], mode="edge")
        return np.asarray(upfirdn(taps, wide, axis=-1)[..., 2 * half :: self.down][..., : self.count])

    @cached_property
    def whole(self) -> Array:
        """The data (O, N) without images; masked samples are the model's, plus the residual estimated from those beside."""
        measured = self.measured if self.images is None else self.measured - self.images
        if not self.masked.any():
            return measured
        model = np.zeros_like(measured) if self.model is None else self.model
        reach = min(round(KRIGED_S * self.data_hz), MOST_KRIGED)
        return model + kriged(measured - model, self.masked.T, reach)

    @cached_property
    def decimated(self) -> Array:
        """The data behind the low-pass, without images, shape (O, K)."""
        if self.masked.any():
            return self.low_passed(self.whole)
        low = self._once("measured", self.measured)
        return low if self.images is None else low - self.images[:, :: self.down][:, : self.count]

    @cached_property
    def taken(self) -> Array:
        """What limits take off the outputs, behind the low-pass, shape (O, K); zero, shape (1, 1), without limits."""
        return np.zeros((1, 1)) if self.limited is None else self.low_passed(self.limited)

    @cached_property
    def unlimited(self) -> Array:
        """The data that a ship without limits would have given, shape (O, K)."""
        return self.decimated - self.taken

    def _once(self, name: str, signals: Array) -> Array:
        """Signals behind the low-pass, computed once for all records of the same data."""
        if name not in self._low_passed:
            self._low_passed[name] = self.low_passed(signals)
        return self._low_passed[name]

    @cached_property
    def spectrum(self) -> ComplexArray:
        """Spectra of the data that a ship without limits would have given, shape (O, F)."""
        return self.see(self.unlimited)

    def in_time(self, spectra: ComplexArray) -> Array:
        """Return the tapered signals (..., K), at the decimated rate, that have the spectra (..., F)."""
        spectra = spectra * np.sqrt(0.5 * self.count)
        spectra[..., 0] *= np.sqrt(2.0)
        return np.asarray(irfft(spectra, self.count, axis=-1))

    def see(self, signals: Array) -> ComplexArray:
        """Tapered spectra (..., F) of decimated signals (..., K)."""
        return self._scaled(rfft(signals * self.tapers[0], axis=-1))

    def _scaled(self, found: ComplexArray) -> ComplexArray:
        found = found[..., : len(self.frequency_hz)] / np.sqrt(0.5 * self.count)
        # The mean is real; its variance is twice that of the real part of any other frequency.
        found[..., 0] *= np.sqrt(0.5)
        return found

    @cached_property
    def goes_in_steps(self) -> bool:
        """Whether the set point rests except at a few moments."""
        moves = np.abs(np.diff(self.set_point))
        return bool(np.mean(moves > QUICK * moves.max()) < MOMENTS)

    @cached_property
    def set_point_low(self) -> Array:
        """Deviation of the set point behind the low-pass, decimated (K,)."""
        return self._once("set point", self.set_point)

    @cached_property
    def signals(self) -> Array:
        """Spectra as the kernel takes them, shape (8, ORDERS, 2, padded)."""
        named = dict(zip(self.outputs, self.unlimited, strict=True))
        speed = named["dn"]
        propeller = speed if self.slip is None else speed - self.slip
        rows = {
            "N": speed,
            "M": named.get("dM"),
            "X": named.get("dX"),
            "load": self.low_passed(self.load) if len(self.load) else None,
            "N2": None if self.is_linear else propeller**2,
            "N3": None if self.is_linear else propeller**3,
            "one": np.ones_like(speed),
            "M_b": named.get("dM_b"),
        }
        found = np.zeros((len(_core.EQUATION_SIGNALS), ORDERS, 2, self.padded))
        for index, name in enumerate(_core.EQUATION_SIGNALS):
            if rows[name] is not None:
                found[index] = self._laid_out(self.tapered(rows[name]))
        return found

    def _laid_out(self, spectra: ComplexArray) -> Array:
        """Spectra (ORDERS, F) as real and imaginary parts, signs of the orders included, (ORDERS, 2, padded)."""
        found = np.zeros((ORDERS, 2, self.padded))
        signed = spectra * (-1.0) ** np.arange(ORDERS)[:, None]
        found[:, 0, : spectra.shape[1]], found[:, 1, : spectra.shape[1]] = signed.real, signed.imag
        return found

    def delayed(self, signal: Literal["speed", "set point", "torque"], delay_s: float) -> tuple[Array, float]:
        """Return the signal delayed by a whole number of `GRID_S` (ORDERS, 2, padded), and the rest of the delay [s]."""
        steps = round(delay_s / GRID_S)
        if (signal, steps) not in self._delayed:
            if signal == "set point":
                row = self.set_point_low
            else:
                row = self.unlimited[self.outputs.index("dn" if signal == "speed" else "dM")]
            moved = steps * GRID_S
            late = self.through(row, lambda s: np.exp(-s * moved), 1.0, -moved)
            spectra = self.tapered(late)
            if signal == "set point":
                spectra = spectra * self._between_samples(self.frequency_hz)
            self._delayed[signal, steps] = self._laid_out(spectra)
        return self._delayed[signal, steps], delay_s - steps * GRID_S

    def through(
        self, row: Array, transfer: Callable[[ComplexArray], ComplexArray], gain: float, slope: float
    ) -> Array:
        """Filter a decimated signal (K,) by a transfer function of s, whose value at s = 0 is `gain`, its slope `slope`."""
        pad = int(PAD_S * self.rate_hz)
        wide = _beyond(row, pad)
        line = np.linspace(wide[0], wide[-1], len(wide))
        s = np.asarray(2j * np.pi * np.fft.rfftfreq(len(wide), 1.0 / self.rate_hz), dtype=complex)
        turned = rfft(wide - line) * transfer(s)
        per_second = (wide[-1] - wide[0]) / (len(wide) - 1) * self.rate_hz
        found = irfft(turned, len(wide)) + gain * line + slope * per_second
        return np.asarray(found[pad : pad + len(row)])

    def inputs(self) -> tuple[ComplexArray, ComplexArray | None]:
        """Return the spectra (F,) of the set point, and of the load where one was measured."""
        set_point = self.tapered(self.set_point_low, 1)[0] * self._between_samples(self.frequency_hz)
        return set_point, self.tapered(self.low_passed(self.load), 1)[0] if len(self.load) else None

    def _between_samples(self, frequency_hz: Array) -> ComplexArray:
        """Frequency response (F,) of the hold, or the straight lines, between the set point's samples."""
        at = frequency_hz / self.data_hz
        if self.between == "held":
            return np.asarray(np.sinc(at) * np.exp(-1j * np.pi * at))
        return np.asarray((np.sinc(at) ** 2 if self.between == "straight" else np.ones_like(at)) + 0j)

    def corrected(
        self,
        values: Mapping[str, float],
        respond: Respond,
        model: Array | None,
        limited: Array | None = None,
        *,
        slips: bool = False,
    ) -> Spectra:
        """Return the record corrected by a model: without images, masked samples filled, the effect of limits undone.

        `respond` gives the outputs' response to the set point, `model` the outputs (O, N) for masked samples, `limited`
        what limits take off the outputs (O, N). With `slips`, squares in the load's law are of the propeller's own speed.

        A set point that is held, or straight, between its samples has images about multiples of the sample rate. They
        pass through the closed loop and, where the data are not low-passed, fold into the band.
        """
        images = None if self.between == "band-limited" else self._images(values, respond)
        shown = self.stairs(values, respond) if self.between == "held" else None
        known = {key: late for key, late in [*self._delayed.items()] if key[0] == "set point"}
        found = replace(
            self, model=model, images=images, shown=shown, limited=limited, slip=None, _delayed=known
        )
        return replace(found, slip=found._slip(values)) if slips else found

    def _slip(self, values: Mapping[str, float]) -> Array:
        """Rate of twist of the shaft (K,) in the model's response to the set point: the measured torque is too noisy."""
        known = loop_of(values)

        def transfer(s: ComplexArray) -> ComplexArray:
            frequency = s.imag / (2.0 * np.pi)
            engine, propeller = (
                TransferFunctions(("dn",), False, place).response(known, frequency, ())[0][0]
                for place in ("engine", "propeller")
            )
            return np.asarray((engine - propeller) * self._between_samples(frequency))

        return self.through(self.set_point_low, transfer, 0.0, values["tau_twist"] * values["p"])

    def running(self, between: Between) -> Spectra:
        """Return the record with another course of the set point between its samples, and without corrections."""
        none: dict[str, Any] = dict.fromkeys(("model", "images", "shown", "limited", "slip"))
        return replace(self, between=between, _delayed={}, **none)

    def _images(self, values: Mapping[str, float], respond: Respond) -> Array:
        """Part of the outputs that the set point's images cause, (O, N)."""
        pad = int(PAD_S * self.data_hz)
        wide = _beyond(self.set_point, pad)
        frequency = np.fft.rfftfreq(len(wide), 1.0 / self.data_hz)
        answer = np.zeros((len(self.outputs), len(frequency)), complex)
        kept = frequency <= 1.25 * self.band_hz
        answer[:, kept] = self._folded(values, respond, np.asarray(frequency[kept], dtype=np.float64))
        # The mean has no images: they would lie at the multiples themselves, where the hold has no gain.
        answer[:, 0] = 0.0
        found = irfft(answer * rfft(wide), len(wide), axis=-1)
        return np.asarray(found[:, pad : pad + len(self.set_point)])

    def _folded(self, values: Mapping[str, float], respond: Respond, frequency_hz: Array) -> ComplexArray:
        """Response of the sampled outputs to the set point's samples through its images, folded into the band (O, F)."""
        most = IMAGES[self.between]
        # Gain of the hold, or the straight lines, at an image: its sine is the same at all images, its divisor is not.
        at, order = frequency_hz / self.data_hz, 1 if self.between == "held" else 2
        course = (np.sin(np.pi * at) / np.pi) ** order
        course = course * np.exp(-1j * np.pi * at) if self.between == "held" else course
        multiples = np.array([*range(-most, 0), *range(1, most + 1)])[:, None]
        there = at + multiples
        every = respond(values, np.abs(there).ravel() * self.data_hz).reshape(-1, *there.shape)
        every = np.where(multiples > 0, every, every.conj())
        answer = np.sum(every * (course / there**order), axis=1)
        late_s = sum(values.get(name, 0.0) for name in ("T_d", "T_set", "tau_act"))
        if self.between == "held" and late_s < 0.5 / (most * self.data_hz):
            # A sample at a jump has the value after the jump; a Fourier sum has the mean of both values.
            at_once = {**values, "T_d": 0.0, "T_set": 0.0, "tau_act": 0.0}
            jump = respond(at_once, np.array([AT_ONCE * self.data_hz])).real
            answer = answer - 0.5 * jump * np.expm1(-2j * np.pi * at)
        return np.asarray(answer)

    def stairs(self, values: Mapping[str, float], respond: Respond) -> ComplexArray:
        """Spectra (O, F) of what a held set point's images add to the outputs, interpolated from few frequencies."""
        few, between = self._few
        late_s = values.get("T_d", 0.0) + values.get("T_set", 0.0)
        turned = self._folded(values, respond, few) * np.exp(2j * np.pi * late_s * few)
        return np.asarray(turned @ between * np.exp(-2j * np.pi * late_s * self.frequency_hz) * self._asked)

    @cached_property
    def _few(self) -> tuple[Array, Array]:
        """Few frequencies [Hz], and the matrix (FEW, F) of cubic splines that interpolates from them to all frequencies."""
        few: Array = np.linspace(0.0, float(self.frequency_hz[-1]), FEW)
        return few, np.ascontiguousarray(CubicSpline(few, np.eye(FEW))(self.frequency_hz).T)

    @cached_property
    def _asked(self) -> ComplexArray:
        """Spectrum (F,) of the set point's samples; the mean has no images."""
        found = self.see(self.set_point_low)
        found[0] = 0.0
        return found


@cache
def _low_pass(down: int) -> Array:
    """Taps of the low-pass before a decimation by `down`."""
    return np.asarray(firwin(TAPS_A_SAMPLE * down + 1, PASSED / down, window=WINDOW_80_DB, fs=1.0))


@lru_cache(maxsize=16)
def _tapers(count: int, rate_hz: float) -> Array:
    """The taper of `count` samples and its time derivatives, shape (ORDERS, K)."""
    at = np.arange(count) / rate_hz
    shorter = min(at[-1] / WHOLE_EDGES_S, 1.0)
    edge_s = max(EDGE_S * shorter, EDGE_SHARE * at[-1])
    up, down = (at - BEFORE_S * shorter) / edge_s, (at[-1] - at) / edge_s
    rows = [RISE(np.clip(np.minimum(up, down), 0.0, 1.0))]
    for order in range(1, ORDERS):
        slope = RISE.deriv(order)
        rising, falling = (np.where((x > 0.0) & (x < 1.0), slope(x), 0.0) for x in (up, down))
        rows.append((rising + (-1.0) ** order * falling) / edge_s**order)
    found = np.array(rows)
    found.setflags(write=False)
    return found


def _beyond(row: Array, pad: int) -> Array:
    """Extend a signal by constant values, at least `pad` samples at either end, to a length with a fast transform."""
    length = next_fast_len(len(row) + 2 * pad, real=True)
    return np.pad(row, (pad, length - len(row) - pad), mode="edge")


def _pace(set_point: Array, speed: Array, rate_hz: float) -> float:
    """Return the bandwidth [rad/s] of the first-order loop with dead time that explains most of a speed; 0: none does."""
    kept, at = np.isfinite(speed), np.arange(len(speed))
    taper = np.hanning(len(speed))
    driver, answer = (
        rfft((row - row.mean()) * taper) for row in (set_point, np.interp(at, at[kept], speed[kept]))
    )
    frequency = np.fft.rfftfreq(len(speed), 1.0 / rate_hz)
    power = np.where(frequency <= 0.4 * rate_hz, np.abs(frequency * driver), 0.0)
    strong = np.argsort(power)[-STRONGEST:]
    if not power[strong].any():
        return 0.0
    s, driver, answer = 2j * np.pi * frequency[strong], driver[strong], answer[strong]
    # Time derivatives are compared: all frequencies of a step then have the same weight.
    shapes = s * driver / (1.0 + s / PACES[:, None])
    along = ((shapes.conj() * s * answer) @ np.exp(s * DEAD_TIMES_S[:, None]).T).real
    told = np.where(along > 0.0, along**2, 0.0).max(axis=1) / np.sum(np.abs(shapes) ** 2, axis=1)
    return float(PACES[np.argmax(told)])
