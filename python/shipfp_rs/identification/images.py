"""What the set point does between its samples that the ship model at the rate of the record does not show.

The model takes straight lines between samples. Their spectrum repeats itself above half the sample rate, weaker by
sinc(f / f_s)^2: these are the images of the signal. The proportional gain hands them on to the torque at once, and the
samples of the simulated torque hold them. A record that was low-passed before it was sampled has none.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.structures.equations import Equations
from shipfp_rs.structures.ship import ShipEquations
from shipfp_rs.structures.ties import bare
from shipfp_rs.support.arrays import Array, ComplexArray

IMAGES = 12
"""Images to either side; those beyond are weaker than a thousandth of the signal."""
GRID_HZ = 0.05
"""Steps of frequency at which the response is worked out, less its delays: it is smooth in between."""
ABOVE = 0.01
"""The same above half the sample rate, over the sample rate."""
SETTLES_S = 8.0
"""Time that is added to a record, over which it fades out at its end, and in at its start."""
BEGINNINGS = 32
"""Times within a period at which the age of a held set point may begin anew."""
LATE = {"dn": "T_n", "dM": "T_M", "dX": ""}
"""Delays of channels."""


def between_samples(
    equations: Equations,
    values: Mapping[str, float],
    experiment: Experiment,
    told: Array,
    measured: Mapping[str, Array],
    *,
    has_images: bool = True,
) -> Array:
    """What outputs have of a low-passed set point beyond those of straight lines, shape (O, N).

    A set point that the engine holds, and a governor that does not sample, is of another age at every sample of the torque.

    Parameters
    ----------
    equations, values
        The ship and its parameters, the experiment's own unknowns among them.
    experiment
        Its set point is prefiltered, see `band_limited`.
    told
        Deviation of the set point as it was sampled, shape (N,).
    measured
        Deviation of each output, nothing but images taken from it, shape (N,). The torque shows when the age of a held set
        point begins anew: the delays together are hardly ever known to a small part of the period.
    has_images
        Whether the images of straight lines are still to be taken from the outputs.
    """
    model = bare(equations)
    change = np.zeros((len(measured), len(told)))
    if experiment.hold != "first" or not isinstance(model, ShipEquations):
        return change
    if has_images:
        change += _less_images(model, values, experiment, told)
    limit, held = values.get("M_max"), experiment.held_set_point is not None and "T_s" not in values
    if "dM" not in measured or (limit is None and not held):
        return change
    row = list(measured).index("dM")
    plain = model.simulate(values, experiment)[row]
    if held:
        change[row] += _stairs(model, values, experiment, told, measured["dM"] - plain - change[row])
    if limit is not None:
        change[row] = np.minimum(plain + change[row], max(limit - 1.0, plain.max())) - plain
    return change


def _less_images(
    model: ShipEquations, values: Mapping[str, float], experiment: Experiment, told: Array
) -> Array:
    """The linear ship's answer to the signal less that to straight lines, shape (O, N)."""
    count, rate = len(told), experiment.rate_hz
    length = next_fast_len(count + round(SETTLES_S * rate), real=True)
    signal, lines = (rfft(_closed(one, length)) for one in (told, experiment.dn_set))
    base: Array = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    # Above half the sample rate the loop hardly acts; the delays' phases are exact.
    grid = np.append(np.arange(0.0, 0.5 * rate, GRID_HZ), np.arange(0.5, IMAGES + 1.0, ABOVE) * rate)
    delay = values.get("T_set", 0.0) + values.get("T_d", 0.0)
    late = np.array([delay + values.get(LATE[output], 0.0) for output in model.outputs])
    given, _ = model.response(values, grid, ())
    smooth = given * np.exp(2j * np.pi * grid * delay)

    def response(image: int) -> ComplexArray:
        """At the frequencies of an image, less the phases that all images have."""
        found = np.stack([np.interp(np.abs(base + image * rate), grid, one) for one in smooth])
        phases = np.exp(-2j * np.pi * late * image * rate)
        return np.asarray((found.conj() if image < 0 else found) * phases[:, None])

    answer = response(0) * (signal - np.sinc(base / rate) ** 2 * lines)
    lines = lines * np.sin(np.pi * base / rate) ** 2
    for image in (*range(-IMAGES, 0), *range(1, IMAGES + 1)):
        answer -= response(image) * (lines / (np.pi * (base / rate + image)) ** 2)
    answer *= np.exp(-2j * np.pi * np.outer(late, base))
    return np.asarray(irfft(answer, length)[:, :count])


def _closed(signal: Array, length: int) -> Array:
    """A signal that goes on as it went, turned about its ends, fades out and goes back to its start."""
    more = length - len(signal)
    each = min(more // 4, len(signal) - 1)
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, each + 1) / each)
    after = signal[-1] + fade * (signal[-1] - signal[-2 : -2 - each : -1])
    before = signal[0] + fade * (signal[0] - signal[1 : 1 + each])
    back = np.linspace(signal[-1], signal[0], more - 2 * each + 2)[1:-1]
    return np.concatenate([signal, after, back, before[::-1]])


def _stairs(
    model: ShipEquations, values: Mapping[str, float], experiment: Experiment, told: Array, rest: Array
) -> Array:
    """Torque of a set point that the engine holds less that of one that is late by half a period, shape (N,)."""
    gain = values["vK_p"] if "vK_p" in values else values["v"] * values["K_p"]
    if model.gauge:
        # A rigid shaft hands its part of the inertia on; a flexible one nothing so fast.
        gain *= 0.0 if "tau_twist" in values else values["tau_prop"] / values["tau_n"]
    lag = values.get("tau_act", 0.0)
    time = np.arange(len(told)) / experiment.rate_hz
    late = time - sum(values.get(name, 0.0) for name in ("T_set", "T_d", "T_M"))
    asked = CubicSpline(time, told)
    smooth = asked(np.clip(late, 0.0, time[-1]))
    assert experiment.held_set_point is not None
    period, phase, slip = experiment.held_set_point

    def stairs(begin: float) -> Array:
        age = (phase + slip * time - begin) % period
        older = age - 0.5 * period
        if lag > 0.0:
            older += period * np.exp(-age / lag) / -np.expm1(-period / lag) - lag
        return np.asarray(gain * (asked(np.clip(late - older, 0.0, time[-1])) - smooth))

    begin, step = 0.5 * period, period / BEGINNINGS
    for _ in range(2):  # clocks drift slowly: a hundredth of a period may be a second of the record
        ways = begin + step * (np.arange(BEGINNINGS) - 0.5 * BEGINNINGS)
        begin = min(ways, key=lambda way: float(np.nansum(np.diff(rest - stairs(way)) ** 2)))
        step *= 2.0 / BEGINNINGS
    return stairs(begin)
