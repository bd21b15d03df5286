"""Frequency responses by averaged periodograms (H1 and H2), class `FrequencyResponse`, and the noise at a spectral line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.arguments import check_fields, checked, told
from shipfp_rs.support.arrays import Array, ComplexArray
from shipfp_rs.support.spikes import bridge
from shipfp_rs.support.tables import Columns, Tabular, shown

_OVERLAP = 0.5
_KEPT = 2
"""Step between the bins that are used: with a Hann window, every second bin is nearly independent (correlation 1/36)."""


@checked
def spectral_response(
    experiments: Experiment | Sequence[Experiment],
    segment_s: float,
    *,
    estimator: Literal["H1", "H2"] = "H1",
    signals: Sequence[str] | None = None,
    band_hz: tuple[float, float] | None = None,
) -> FrequencyResponse:
    """Estimate a response by averaged periodograms of half overlapping Hann windows (Welch), with coherence.

    Parameters
    ----------
    experiments
        One experiment, or several with the same rate, which are averaged together. Masked samples are interpolated.
    segment_s
        Length of the windows [s]; it should be much longer than the ship's transient response, which is truncated at
        the windows' ends.
    estimator
        "H1": cross spectrum over the set point's spectrum, unbiased by noise of the output; "H2": output's spectrum
        over the cross spectrum, unbiased by noise of the set point. The true response is between H1 and H2.
    signals
        Outputs; None: all outputs that every experiment has.
    band_hz
        Lowest and highest frequency [Hz] at which the set point has power; None: all.

    Returns
    -------
    FrequencyResponse
        Response at every second bin; these points are nearly independent.

    Raises
    ------
    InputError
        If fewer than two windows fit.

    Notes
    -----
    The relative standard deviation is sqrt((1 - c) / (2 c n)) with the coherence c and n independent windows (Bendat
    and Piersol, Random Data, 4th edition, table 9.6), where n allows for the overlap (Welch,
    doi:10.1109/TAU.1967.1161901).
    """
    given = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    names = chosen_signals(given, signals)
    rate = given[0].rate_hz
    if any(experiment.rate_hz != rate for experiment in given):
        raise InputError(f"experiments: found rates {sorted({e.rate_hz for e in given})} Hz, expected one")
    size = _samples_of(segment_s, given)
    step = round((1.0 - _OVERLAP) * size)
    window = np.hanning(size + 1)[:-1]

    def spectra(name: str) -> ComplexArray:
        parts = []
        for experiment in given:
            values = whole_signal(experiment, name)[0]
            if len(values) >= size:
                pieces = np.lib.stride_tricks.sliding_window_view(values, size)[::step]
                centred = pieces - pieces.mean(axis=1, keepdims=True)
                parts.append(np.fft.rfft(centred * window, axis=1))
        return np.concatenate(parts) if parts else np.empty((0, size // 2 + 1), dtype=np.complex128)

    U = spectra("n_set")
    if len(U) < 2:
        raise InputError(
            f"segment_s: {len(U)} windows of {segment_s:g} s in the record, expected two or more"
        )
    frequency = np.asarray(np.fft.rfftfreq(size, 1.0 / rate), dtype=np.float64)
    low, high = band_hz or (0.0, np.inf)
    bins = np.arange(_KEPT, len(frequency) - 1, _KEPT)
    bins = bins[(frequency[bins] >= low) & (frequency[bins] <= high)]
    if not bins.size:
        raise InputError(
            f"band_hz: {low:g} to {high:g} Hz holds none of the bins every {_KEPT * rate / size:g} Hz"
        )
    U = U[:, bins]
    # Neighbouring segments share half their samples, but less of their power, since the window tapers it.
    shared = float(np.sum(window[step:] * window[: size - step]) / np.sum(window**2))
    independent = len(U) / (1.0 + 2.0 * shared**2 * (len(U) - 1) / len(U))
    power_in = np.sum(np.abs(U) ** 2, axis=0)
    points = {}
    for name in names:
        Y = spectra(name)[:, bins]
        cross, power_out = np.sum(Y * U.conj(), axis=0), np.sum(np.abs(Y) ** 2, axis=0)
        if not (np.abs(cross) > 0.0).all():
            raise InputError(
                f"band_hz: no power of 'n_set' and {name!r} in common at {frequency[bins][np.abs(cross) == 0.0][0]:g} Hz"
            )
        coherence = np.minimum(np.abs(cross) ** 2 / (power_in * power_out), 1.0)
        response = cross / power_in if estimator == "H1" else power_out / cross.conj()
        points[name] = (response, np.sqrt((1.0 - coherence) / (2.0 * coherence * independent)), coherence)
    provenance = {
        "method": f"{estimator}, averaged periodograms",
        "segment_s": segment_s,
        "windows": len(U),
        "independent_windows": independent,
    }
    return to_response(given[0].name, frequency[bins], points, given[0].operating_point, provenance)


def _samples_of(segment_s: float, experiments: list[Experiment]) -> int:
    rate = experiments[0].rate_hz
    longest_s = max(experiment.duration for experiment in experiments)
    size = round(segment_s * rate) if 0.0 < segment_s <= longest_s else 0
    if size < 8:
        raise InputError(
            f"segment_s: found {segment_s}, expected 8 samples, {8 / rate:g} s, to {longest_s:g} s"
        )
    return size


Points = Mapping[str, tuple[ComplexArray, Array, Array | None]]
"""For each signal: its response, the relative standard deviation of real and imaginary part, and its coherence."""

_MOST_MASKED = 0.05
"""Largest fraction of a signal's samples that may be masked; for a spectrum these are interpolated linearly."""


def chosen_signals(experiments: Sequence[Experiment], signals: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the outputs: those given, or all signals that every experiment has, without set point and command."""
    if not experiments:
        raise InputError("experiments: found none, expected at least one")
    common = [name for name in experiments[0].signals if all(name in e.signals for e in experiments)]
    names = (
        tuple(name for name in common if name not in ("n_set", "command"))
        if signals is None
        else tuple(signals)
    )
    for name in names:
        if name not in common:
            raise InputError(f"signals: found {name!r}, expected some of {', '.join(common)}")
    if not names:
        raise InputError("signals: the experiments have no output in common, only the set point")
    return names


def whole_signal(experiment: Experiment, name: str) -> tuple[Array, float]:
    """Return the normalised deviation with masked samples interpolated, and their share."""
    values = experiment.normalised(name)
    missing = np.isnan(values)
    share = float(missing.mean())
    if share > _MOST_MASKED:
        raise InputError(
            f"experiment {experiment.name!r}: {share:.0%} of {name!r} is masked, at most {_MOST_MASKED:.0%} can be "
            "bridged for a spectrum; cut the window, or use stepped_sine_response or multisine_response, which need "
            "no interpolation"
        )
    return bridge(values, missing), share


def to_response(
    name: str,
    frequency_hz: Array,
    points: Points,
    operating_point: Mapping[str, float],
    provenance: Mapping[str, Any],
) -> FrequencyResponse:
    """Assemble a response; real and imaginary part give the standard deviations of both amplitude and phase."""
    # The residuals of exact data are only rounding errors. A lower limit avoids zero deviations with infinite weights.
    std = {key: np.maximum(deviation, np.finfo(np.float64).eps) for key, (_, deviation, _) in points.items()}
    return FrequencyResponse(
        name=name,
        frequency_hz=frequency_hz,
        response={key: response for key, (response, _, _) in points.items()},
        amplitude_std=std,
        phase_std=std,
        operating_point=operating_point,
        provenance=provenance,
        coherence={key: coherence for key, (_, _, coherence) in points.items() if coherence is not None},
    )


_REACH = 10
"""Number of bins on either side of a line for its noise estimate."""


def line_noise(residual: npt.ArrayLike, rate_hz: float, frequencies_hz: npt.ArrayLike) -> Array:
    """Return for each line the variance of white noise with the same power as the residuals have near the line.

    A power law is fitted to the periodogram at neighbouring bins by maximum likelihood (Whittle). The periodogram has
    no window, so that leakage of a steep spectrum affects it in the same way as the fitted line.

    Parameters
    ----------
    residual
        Samples minus the fitted lines, shape (N,), NaN where missing.
    rate_hz
        Sample rate [Hz].
    frequencies_hz
        Frequencies of all fitted lines [Hz], shape (L,).

    Returns
    -------
    ndarray
        Noise variance, shape (L,), unit of the residual squared. An estimate from few bins is uncertain; it is
        increased to the variance of Student's distribution with the same degrees of freedom. For a line with neighbours
        on only one side, the noise is the mean of these bins; without neighbours, it is the variance of the residuals.

    Notes
    -----
    GUM Supplement 1 (JCGM 101:2008), section 6.4.9: v / (v - 2) for v degrees of freedom.
    """
    values = np.asarray(residual, dtype=np.float64)
    lines = np.asarray(frequencies_hz, dtype=np.float64) * len(values) / rate_hz
    present = np.isfinite(values)
    spectrum = np.abs(np.fft.rfft(np.where(present, values, 0.0))) ** 2 / present.sum()
    found = np.empty(len(lines))
    for k, line in enumerate(lines):
        # At most an octave: over a wider band, the noise does not follow a power law.
        first, last = (
            max(round(line) - _REACH, int(line / 2), 1),
            min(round(line) + _REACH, int(2 * line) + 2),
        )
        bins = np.arange(first, min(last + 1, len(spectrum) - 1))
        # Only bins at least one bin away from every line: there the fit removes no noise from the residuals.
        beside = bins[np.abs(bins[:, None] - lines).min(axis=1, initial=np.inf) > 1.0 - 1e-6]
        below = int(np.sum(beside < line))
        if min(below, len(beside) - below) >= 2:
            found[k] = _power_law(beside / line, spectrum[beside])
        elif beside.size:
            found[k] = _student(spectrum[beside].mean(), 2.0 * len(beside))
        else:
            found[k] = np.sum(values[present] ** 2) / max(present.sum() - 2 * len(lines) - 1, 1)
    return found


def _power_law(ratio: Array, power: Array) -> float:
    """Fit a power law to exponentially distributed periodogram values; return its value at a frequency ratio of 1."""
    floor = np.finfo(np.float64).tiny + 1e-12 * power.max()
    design = np.column_stack([np.ones(len(ratio)), np.log(ratio)])
    # The mean logarithm of an exponential variable is Euler's constant below the logarithm of its mean.
    best = np.linalg.lstsq(design, np.log(power + floor) + np.euler_gamma)[0]
    for _ in range(8):
        model = np.exp(np.clip(design @ best, -700.0, 700.0))
        best = best + np.linalg.lstsq(design, np.clip(power / model - 1.0, -1.0, 2.0))[0]
    # The logarithm of chi-squared of v degrees of freedom has the variance 2 / v.
    return _student(float(np.exp(best[0])), 2.0 / float(np.linalg.inv(design.T @ design)[0, 0]))


def _student(variance: float, freedom: float) -> float:
    return float(variance * freedom / max(freedom - 2.0, 1.0))


FREQUENCY = "frequency_hz"
_PARTS = ("amplitude_std", "phase_std", "coherence")
UNKNOWN_AMPLITUDE, UNKNOWN_PHASE = 1.0, math.pi / math.sqrt(3.0)
"""Standard deviations of an unknown amplitude (relative) and of an unknown phase [rad]."""
MOST_TURNS = 4.0
"""Number of turns (phase / 2 pi) above which a given phase is assumed to be in degrees."""


@dataclass(frozen=True, eq=False)
class FrequencyResponse(Tabular):
    """Measured responses of the outputs to the set point, eq. 7.1 and 7.2.

    Parameters
    ----------
    name
        Label in tables and plots.
    frequency_hz
        Frequencies [Hz], shape (F,), positive.
    response
        Complex ratio of a signal's normalised deviation to that of the set point, shape (F,), by signal name ("n_e",
        "M_g", ...); NaN where a point is missing.
    amplitude_std, phase_std
        Relative standard deviation of the amplitude [-], and that of the phase [rad], by signal name, shape (F,), where
        known. The two differ if an error of a sine fit's frequency affects the phase but not the amplitude.
    operating_point
        Value by which each signal was normalised, by signal name.
    provenance
        Source and processing of the numbers.
    coherence
        Coherence [-] by signal name, shape (F,), where known: the share of the signal's power explained by the set
        point.
    """

    name: str
    frequency_hz: Array
    response: Mapping[str, ComplexArray]
    amplitude_std: Mapping[str, Array] = field(default_factory=dict)
    phase_std: Mapping[str, Array] = field(default_factory=dict)
    operating_point: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    coherence: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self, f"response {told(self.name)}")
        frequency = _frozen(self.frequency_hz, np.float64)
        if frequency.ndim != 1 or frequency.size == 0:
            raise InputError(
                f"response {self.name!r}: frequency_hz has shape {frequency.shape}, expected (F,), F > 0"
            )
        if not (np.isfinite(frequency).all() and (frequency > 0).all()):
            raise InputError(
                f"response {self.name!r}: frequency_hz must be finite and positive, found {frequency.min()}"
            )
        object.__setattr__(self, "frequency_hz", frequency)
        for attribute, dtype in (
            ("response", np.complex128),
            ("amplitude_std", np.float64),
            ("phase_std", np.float64),
            ("coherence", np.float64),
        ):
            group = {key: _frozen(value, dtype) for key, value in getattr(self, attribute).items()}
            for key, values in group.items():
                if values.shape != frequency.shape:
                    raise InputError(
                        f"response {self.name!r}: {attribute} of {key!r} has shape {values.shape}, expected "
                        f"{frequency.shape} as frequency_hz"
                    )
            object.__setattr__(self, attribute, MappingProxyType(group))
        if set(self.amplitude_std) != set(self.phase_std):
            raise InputError(
                f"response {self.name!r}: amplitude_std of {sorted(self.amplitude_std)} but phase_std of "
                f"{sorted(self.phase_std)}; give both of the same outputs"
            )
        for attribute in ("amplitude_std", "phase_std"):
            for key, values in getattr(self, attribute).items():
                if key not in self.response:
                    raise InputError(f"response {self.name!r}: {attribute} of {key!r}, which has no response")
                if not (values > 0).all():
                    raise InputError(
                        f"response {self.name!r}: {attribute} of {key!r} must be positive, found {np.min(values)}"
                    )
        for attribute, most, slip in (
            ("amplitude_std", UNKNOWN_AMPLITUDE, "percent for a fraction"),
            ("phase_std", UNKNOWN_PHASE, "degrees for radians"),
        ):
            for key, values in getattr(self, attribute).items():
                if len(values) > 1 and values.min() > most:
                    raise InputError(
                        f"response {self.name!r}: {attribute} of {key!r} is {values.min():.3g} at best, expected less "
                        f"than {most:.3g} at some frequency; {slip}?"
                    )
        if not self.response:
            raise InputError(f"response {self.name!r}: no output")

    def __len__(self) -> int:
        return len(self.frequency_hz)

    def __repr__(self) -> str:
        low, high = self.frequency_hz.min(), self.frequency_hz.max()
        signals = ", ".join(self.response)
        return (
            f"FrequencyResponse({self.name!r}, {len(self)} points from {low:.4g} to {high:.4g} Hz: {signals})"
        )

    def _repr_html_(self) -> str:
        head = ["frequency [Hz]"]
        for name in self.response:
            head += [f"|{name}| [-]", f"arg {name} [deg]"]
        rows = []
        for index, frequency in enumerate(self.frequency_hz):
            cells = [f"{frequency:.4g}"]
            for values in self.response.values():
                cells += [f"{abs(values[index]):.4g}", f"{math.degrees(np.angle(values[index])):.1f}"]
            rows.append(cells)
        return shown(f"Frequency response {self.name}", head, rows)

    def _columns(self) -> Columns:
        values, units = {FREQUENCY: self.frequency_hz}, {FREQUENCY: "Hz"}
        for name, response in self.response.items():
            values |= {f"{name}.real": response.real, f"{name}.imag": response.imag}
            values |= {f"{name}.{part}": group[name] for part, group in self._parts() if name in group}
            units |= {
                f"{name}.{part}": "rad" if part == "phase_std" else "1" for part in ("real", "imag", *_PARTS)
            }
        facts = {
            "name": self.name,
            "operating_point": dict(self.operating_point),
            "provenance": dict(self.provenance),
        }
        return Columns(values, units, facts)

    def _parts(self) -> tuple[tuple[str, Mapping[str, Array]], ...]:
        return tuple((part, getattr(self, part)) for part in _PARTS)

    @classmethod
    def _from_columns(cls, values: Mapping[str, Array], facts: Mapping[str, Any]) -> Self:
        index, *columns = values
        names = list(dict.fromkeys(column.rpartition(".")[0] for column in columns))
        groups: dict[str, dict[str, Any]] = {part: {} for part in ("response", *_PARTS)}
        for name in names:
            missing = [f"{name}.{part}" for part in ("real", "imag") if f"{name}.{part}" not in values]
            if not name or missing:
                raise InputError(
                    f"columns {', '.join(columns)}: expected pairs such as n_e.real and n_e.imag; add them or leave "
                    "the others out"
                )
            groups["response"][name] = values[f"{name}.real"] + 1j * values[f"{name}.imag"]
            for part in _PARTS:
                if f"{name}.{part}" in values:
                    groups[part][name] = values[f"{name}.{part}"]
        given: dict[str, Any] = {"name": "response", **facts, **groups}
        return cls(frequency_hz=values[index], **given)

    @checked
    def select(self, keep: npt.ArrayLike, *, name: str | None = None) -> FrequencyResponse:
        """Return the points where a mask is true.

        Parameters
        ----------
        keep
            Boolean mask, shape (F,).
        name
            Label; None: unchanged.

        Raises
        ------
        InputError
            If the mask has another shape.
        """
        mask = np.asarray(keep, dtype=bool)
        if mask.shape != self.frequency_hz.shape:
            raise InputError(
                f"response {self.name!r}: mask has shape {mask.shape}, expected {self.frequency_hz.shape}"
            )
        return FrequencyResponse(
            name=name or self.name,
            frequency_hz=self.frequency_hz[mask],
            response={key: values[mask] for key, values in self.response.items()},
            amplitude_std={key: values[mask] for key, values in self.amplitude_std.items()},
            phase_std={key: values[mask] for key, values in self.phase_std.items()},
            operating_point=self.operating_point,
            provenance=self.provenance,
            coherence={key: values[mask] for key, values in self.coherence.items()},
        )


@checked
def sine_response(
    output: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike],
    set_point: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike],
) -> ComplexArray:
    """Return the complex response from fitted sines a + b sin(ct + d): (b/a of the output) over (b/a of the set point).

    Parameters
    ----------
    output, set_point
        (offset, amplitude, phase [rad]) of each sine, arrays of the same shape. Each channel is normalised by its offset,
        the local operating point. The phase of the response is d_out - d_in; appendix E of the thesis prints sin(ct -
        d), with which the response would lead.

    Returns
    -------
    ndarray
        Complex response, same shape as the inputs.

    Raises
    ------
    InputError
        If the phases are so large that they must be degrees.
    """
    a_out, b_out, d_out = (np.asarray(part, dtype=np.float64) for part in output)
    a_in, b_in, d_in = (np.asarray(part, dtype=np.float64) for part in set_point)
    for name, phase in (("output", d_out), ("set_point", d_in)):
        if phase.size and np.nanmax(np.abs(phase)) > MOST_TURNS * 2.0 * math.pi:
            raise InputError(
                f"sine_response: the phases of {name} reach {np.nanmax(np.abs(phase)):.4g}, expected radians; degrees for "
                "radians? convert them with numpy.radians"
            )
    return np.asarray((b_out / a_out) / (b_in / a_in) * np.exp(1j * (d_out - d_in)), dtype=np.complex128)


def _frozen(values: npt.ArrayLike, dtype: type) -> npt.NDArray[Any]:
    array: npt.NDArray[Any] = np.array(values, dtype=dtype)
    array.flags.writeable = False
    return array
