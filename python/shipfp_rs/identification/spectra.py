"""Spectra of a record for the two equations of a ship, computed once.

A taper w and an operator H do not commute: F[w (H x)] = sum_k (-1)^k / k! H^(k)(s) F[w^(k) x]. Each signal therefore has a
spectrum with the taper and one with each of the taper's first three derivatives, which are known exactly.
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
from shipfp_rs.identification.sampling import BAND_HZ, SHORTEST_S, Between, down_of, excitation, kriged
from shipfp_rs.structures.parameter import BRAKE
from shipfp_rs.structures.transfer import TransferFunctions
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.derivatives import interpolated

ORDERS: int = _core.EQUATION_ORDERS
"""Number of terms of the series: the taper and its derivatives."""
EDGE_S, EDGE_SHARE, BEFORE_S = 3.0, 0.025, 2.0
"""Least length of the taper's edges [s], their least share of the record, and initial time that is omitted [s], since its
samples depend, through dead times, on inputs before the record. The residuals of the equations, multiplied by the inverse of
the loop's matrix, have the outputs' noise, except at the taper's edges: steep edges mix the noise of the outputs."""
GRID_S = 0.05
"""Delays are applied before the taper in multiples of this step [s]; the series gives the remaining delay."""
TAPS_A_SAMPLE, PASSED, WINDOW_80_DB = 24, 0.43, ("kaiser", 9.0)
"""Low-pass before decimation: length in decimated samples, passband edge over the decimated rate, window."""
RISE = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
"""Edge of the taper: from 0 to 1 with three continuous derivatives."""
PAD_S = 6.0
"""Padding at each end of a delayed or filtered signal [s]."""
IMAGES = {"held": 24, "straight": 4}
"""Number of multiples of the sample rate, on either side of zero, whose images of the set point are computed."""

KRIGED_S, MOST_KRIGED = 0.6, 100
"""Time on either side of a gap whose samples are used for interpolation [s], and largest number of these samples."""
FEW = 13
"""Number of frequencies between which images are interpolated: apart from a delay they vary slowly with frequency."""
LATE = {"dn": "T_n", "dM": "T_M", BRAKE: "T_B"}
"""Delay parameter of each output's sensor."""
DELAYS, LAGS, ON_TIME = ("T_d", "T_set"), ("tau_act", "tau_eng"), 0.05
"""Delays and lags between the set point and the torque; delay in samples up to which an output counts as on time."""
AT_ONCE = 1e4
"""Frequency, over the sample rate, at which the frequency response equals the instantaneous response to a step."""
SLOW_PACE, QUICK_PACE = 5.0, 16.0
"""Bandwidths of loops [rad/s]: above the first a record may be shorter than `SHORTEST_S`, above the second the compared band
is wider."""
LEAST_FOLLOWED = 0.1
"""Share of the power of the speed's slope that the set point must explain for the speed to follow it; noise explains a few
hundredths."""
WHOLE_EDGES_S = 24.0
"""Length of a record [s] from which the taper's edges have full length; shorter records have proportionally shorter
edges."""
PACES, DEAD_TIMES_S, STRONGEST = np.geomspace(1.0, 400.0, 32), np.arange(0.0, 0.6, 0.02), 300
"""Bandwidths [rad/s] and dead times [s] of the first-order loops that are compared with the speed, and number of compared
frequencies, those at which the set point is strongest."""


Respond = Callable[[Mapping[str, float], Array], ComplexArray]
"""Maps parameters and frequencies [Hz] to the outputs' response (O, F) to the ship's input."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Tapered spectra of an experiment's signals."""

    name: str
    outputs: tuple[str, ...]
    set_point: Array  # deviation (N,)
    load: Array  # deviation of a measured load (N,), or empty
    measured: Array  # normalised deviations of the outputs (O, N), NaN where masked
    data_hz: float
    seen_hz: float  # highest frequency that the low-pass keeps
    band_hz: float  # highest frequency that is compared
    between: Between  # course of the set point between samples
    model: Array | None = None  # modelled outputs (O, N) for masked samples; None: interpolation
    images: Array | None = None  # effect on the outputs (O, N) of the set point's images; None: not yet known
    shown: ComplexArray | None = None  # spectra (O, F) of the subtracted images of a held set point
    slip: Array | None = None  # difference of engine and propeller speed (K,), decimated; None: a stiff shaft
    is_linear: bool = False  # whether the load's law is a straight line, without squares of the speed
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
        wide: bool = False,  # up to the highest excited frequency, for a structure of unknown bandwidth
    ) -> Spectra:
        """Return the spectra of an experiment with normalised outputs (O, N); `InputError` if the record is too short."""
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
        set_point, own_hz = excitation(set_point, experiment.rate_hz, seen_hz)
        loads, load_hz = excitation(loads, experiment.rate_hz, seen_hz)
        band_hz = max(own_hz, load_hz)
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

    def with_set_point(self, set_point: Array) -> Spectra:
        """Return the spectra with another set point (N,); the other signals stay as they are."""
        kept = {name: row for name, row in self._low_passed.items() if name != "set point"}
        return replace(self, set_point=set_point, _delayed={}, _low_passed=kept)

    @cached_property
    def down(self) -> int:
        """Decimation factor."""
        return down_of(self.data_hz, self.seen_hz)

    @property
    def rate_hz(self) -> float:
        """Rate of the decimated data [Hz]."""
        return self.data_hz / self.down

    @cached_property
    def count(self) -> int:
        """Number of decimated samples, suitable for a fast Fourier transform."""
        return int(prev_fast_len(-(-self.measured.shape[1] // self.down), real=True))

    @cached_property
    def frequency_hz(self) -> Array:
        """Compared frequencies [Hz], shape (F,); the first is 0, the mean."""
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
        """Return spectra of a decimated signal (K,) with the taper and its derivatives, shape (orders, F)."""
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
        """The data (O, N) without images; masked samples are the model's plus the interpolated residual."""
        measured = self.measured if self.images is None else self.measured - self.images
        if not self.masked.any():
            return measured
        model = np.zeros_like(measured) if self.model is None else self.model
        reach = min(round(KRIGED_S * self.data_hz), MOST_KRIGED)
        return model + kriged(measured - model, self.masked.T, reach)

    @cached_property
    def decimated(self) -> Array:
        """The low-passed data without images, shape (O, K)."""
        if self.masked.any():
            return self.low_passed(self.whole)
        low = self._once("measured", self.measured)
        return low if self.images is None else low - self.images[:, :: self.down][:, : self.count]

    def at_data_rate(self, row: Array) -> Array:
        """Interpolate a decimated signal (K,) to the data's rate, shape (N,)."""
        count = self.measured.shape[1]
        fine = interpolated(np.ascontiguousarray(row), self.down)[:count]
        return np.pad(fine, (0, count - len(fine)), mode="edge")

    def _once(self, name: str, signals: Array) -> Array:
        """Return low-passed signals from a store that all records of the same data share."""
        if name not in self._low_passed:
            self._low_passed[name] = self.low_passed(signals)
        return self._low_passed[name]

    @cached_property
    def spectrum(self) -> ComplexArray:
        """Spectra of the data, shape (O, F)."""
        return self.see(self.decimated)

    def in_time(self, spectra: ComplexArray) -> Array:
        """Return tapered signals (..., K) at the decimated rate from spectra (..., F)."""
        spectra = spectra * np.sqrt(0.5 * self.count)
        spectra[..., 0] *= np.sqrt(2.0)
        return np.asarray(irfft(spectra, self.count, axis=-1))

    def see(self, signals: Array) -> ComplexArray:
        """Tapered spectra (..., F) of decimated signals (..., K)."""
        return self._scaled(rfft(signals * self.tapers[0], axis=-1))

    def _scaled(self, found: ComplexArray) -> ComplexArray:
        found = found[..., : len(self.frequency_hz)] / np.sqrt(0.5 * self.count)
        # The mean is real; its variance is twice that of the real component of any other frequency.
        found[..., 0] *= np.sqrt(0.5)
        return found

    @cached_property
    def set_point_low(self) -> Array:
        """Low-passed deviation of the set point, decimated (K,)."""
        return self._once("set point", self.set_point)

    @cached_property
    def signals(self) -> Array:
        """Spectra in the kernel's layout, shape (8, ORDERS, 2, padded)."""
        named = dict(zip(self.outputs, self.decimated, strict=True))
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
        """Real and imaginary parts (ORDERS, 2, padded) of spectra (ORDERS, F), with the alternating signs of the series."""
        found = np.zeros((ORDERS, 2, self.padded))
        signed = spectra * (-1.0) ** np.arange(ORDERS)[:, None]
        found[:, 0, : spectra.shape[1]], found[:, 1, : spectra.shape[1]] = signed.real, signed.imag
        return found

    def delayed(self, signal: Literal["speed", "set point", "torque"], delay_s: float) -> tuple[Array, float]:
        """Return a signal delayed by a multiple of `GRID_S` (ORDERS, 2, padded), and the remaining delay [s]."""
        steps = round(delay_s / GRID_S)
        if (signal, steps) not in self._delayed:
            if signal == "set point":
                row = self.set_point_low
            else:
                row = self.decimated[self.outputs.index("dn" if signal == "speed" else "dM")]
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
        """Filter a decimated signal (K,) by a transfer function with value `gain` and derivative `slope` at s = 0."""
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
        """Frequency response (F,) of the interpolation between the set point's samples."""
        at = frequency_hz / self.data_hz
        if self.between == "held":
            return np.asarray(np.sinc(at) * np.exp(-1j * np.pi * at))
        return np.asarray((np.sinc(at) ** 2 if self.between == "straight" else np.ones_like(at)) + 0j)

    def corrected(
        self,
        values: Mapping[str, float],
        respond: Respond,
        model: Array | None,
        *,
        slips: bool = False,  # whether squares in the load's law are of the propeller's speed
    ) -> Spectra:
        """Return the record corrected by a model: without images, and with masked samples from `model` (O, N)."""
        # A set point that is held or linear between samples has images about multiples of the sample rate. They pass through
        # the closed loop and, where the data are not low-passed, fold into the band.
        images = None if self.between == "band-limited" else self._images(values, respond)
        shown = self.stairs(values, respond) if self.between == "held" else None
        known = {key: late for key, late in [*self._delayed.items()] if key[0] == "set point"}
        found = replace(self, model=model, images=images, shown=shown, slip=None, _delayed=known)
        return replace(found, slip=found._slip(values)) if slips else found

    def _below_nyquist(self, values: Mapping[str, float]) -> dict[str, float]:
        """Parameters, with a stiff shaft if the shaft's resonance is above half the sample rate."""
        # No spectrum contains such a resonance, so no data determine its damping, which would scale the images.
        twist, whole, behind = (values.get(name, 0.0) for name in ("tau_twist", "tau_n", "tau_prop"))
        below = behind * (whole - behind) * twist * (np.pi * self.data_hz) ** 2 > whole
        return {**values} if below else {**values, "tau_twist": 0.0}

    def _slip(self, values: Mapping[str, float]) -> Array:
        """Modelled difference of engine and propeller speed (K,), since the measured torque is too noisy to give it."""
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
        """Return the record without corrections, with another course of the set point between samples."""
        none: dict[str, Any] = dict.fromkeys(("model", "images", "shown", "slip"))
        return replace(self, between=between, _delayed={}, **none)

    def _images(self, values: Mapping[str, float], respond: Respond) -> Array:
        """Effect of the set point's images on the outputs, (O, N)."""
        pad = int(PAD_S * self.data_hz)
        wide = _beyond(self.set_point, pad)
        frequency = np.fft.rfftfreq(len(wide), 1.0 / self.data_hz)
        answer = np.zeros((len(self.outputs), len(frequency)), complex)
        kept = frequency <= 1.25 * self.band_hz
        answer[:, kept] = self._folded(values, respond, np.asarray(frequency[kept], dtype=np.float64))
        # The mean has no images: they would be at the multiples themselves, where the hold has zero gain.
        answer[:, 0] = 0.0
        found = irfft(answer * rfft(wide), len(wide), axis=-1)
        return np.asarray(found[:, pad : pad + len(self.set_point)])

    def _folded(self, values: Mapping[str, float], respond: Respond, frequency_hz: Array) -> ComplexArray:
        """Response (O, F) of the sampled outputs to the set point's samples through images that fold into the band."""
        most, values = IMAGES[self.between], self._below_nyquist(values)
        # Gain of the interpolation at an image, without its divisor, which differs between images.
        at, order = frequency_hz / self.data_hz, 1 if self.between == "held" else 2
        course = (np.sin(np.pi * at) / np.pi) ** order
        course = course * np.exp(-1j * np.pi * at) if self.between == "held" else course
        multiples = np.array([*range(-most, 0), *range(1, most + 1)])[:, None]
        there = at + multiples
        every = respond(values, np.abs(there).ravel() * self.data_hz).reshape(-1, *there.shape)
        every = np.where(multiples > 0, every, every.conj())
        course = course / there**order
        answer = np.sum(every * course, axis=1)
        near = 1.0 - 2.0 * most * self.data_hz * sum(values.get(name, 0.0) for name in LAGS)
        if near > 0.0:
            # A torque without lag follows the samples exactly: a sample at a jump has the value after the jump. A sum over
            # few images does not reach this value.
            at_once = dict(values) | dict.fromkeys((*DELAYS, *LAGS, *LATE.values()), 0.0)
            jump = near * respond(at_once, np.array([AT_ONCE * self.data_hz])).real
            delay_s = sum(values.get(name, 0.0) for name in DELAYS)
            sensors_s = np.array([values.get(LATE.get(name, ""), 0.0) for name in self.outputs])
            late = (self.data_hz * (delay_s + sensors_s))[:, None]
            steps = np.ceil(late - ON_TIME)
            exact = np.exp(-2j * np.pi * at * steps)
            if self.between == "straight":
                exact = exact * (1.0 + (steps - late) * np.expm1(2j * np.pi * at))
            images = np.sum(course * np.exp(-2j * np.pi * there * late[..., None]), axis=1)
            base = self._between_samples(frequency_hz) * np.exp(-2j * np.pi * at * late)
            answer = answer + jump * (exact - base - images)
        return np.asarray(answer)

    def stairs(self, values: Mapping[str, float], respond: Respond) -> ComplexArray:
        """Spectra (O, F) of the responses to a held set point's images (aliases), interpolated from few frequencies."""
        few, between = self._few
        late_s = values.get("T_d", 0.0) + values.get("T_set", 0.0)
        turned = self._folded(values, respond, few) * np.exp(2j * np.pi * late_s * few)
        return np.asarray(turned @ between * np.exp(-2j * np.pi * late_s * self.frequency_hz) * self._asked)

    @cached_property
    def _few(self) -> tuple[Array, Array]:
        """Few frequencies [Hz], and the cubic-spline matrix (FEW, F) that interpolates from these to all frequencies."""
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
    """Extend a signal by constants, at least `pad` samples at each end, to a length with a fast transform."""
    length = next_fast_len(len(row) + 2 * pad, real=True)
    return np.pad(row, (pad, length - len(row) - pad), mode="edge")


def _pace(set_point: Array, speed: Array, rate_hz: float) -> float:
    """Return the bandwidth [rad/s] of the first-order loop with dead time that best explains a speed; 0 if none does."""
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
    # Time derivatives are compared, so that all frequencies of a step have equal weight.
    shapes = s * driver / (1.0 + s / PACES[:, None])
    along = ((shapes.conj() * s * answer) @ np.exp(s * DEAD_TIMES_S[:, None]).T).real
    told = np.where(along > 0.0, along**2, 0.0).max(axis=1) / np.sum(np.abs(shapes) ** 2, axis=1)
    if told.max() < LEAST_FOLLOWED * np.sum(np.abs(s * answer) ** 2):
        return 0.0
    return float(PACES[np.argmax(told)])
