"""Information on engine and governor from moving water: the ratio of torque to speed in the residuals.

Wake and waves load the propeller alone. In the motion that they cause, the ratio of torque to speed is the response of
drive and governor: -((tau_n - tau_prop) s - g + L) for a gauge. A set point determines only ratios of its terms to the
inertia. Sensor noise makes speed over torque, or torque over speed, look smaller than it is. The coherence bounds both
errors (Frisch 1934; Anderson 1985, doi:10.1016/0304-4076(85)90025-2). Half of that bound is an error that all bands share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipfp_rs.support.arrays import Array, ComplexArray, Numbers

SCALE = 0.01
"""Standard deviation of the ratio's error that all bands share: means of torque and speed over a minute in moving water, and
their calibrations, are good to 1 % on eight simulated trials with a whole measurement chain."""
BAND, LEAST_BINS = 1.3, 12
"""Ratio of the upper to the lower end of a band, and least number of frequencies in a band."""
COHERENT = 0.8
"""Least squared coherence of a band's residuals."""


@dataclass(frozen=True)
class Water:
    """Ratios of torque to speed in the residuals of B frequency bands, measured over modelled."""

    s: ComplexArray  # centres of the bands (B,) [rad/s]
    model: ComplexArray  # modelled ratio (B,), at the parameters for which the residuals were computed
    ratio: ComplexArray  # measured over modelled ratio (B,)
    root: Array  # root of the inverse covariance of the ratios' real and imaginary parts (2 B, 2 B)

    def rows(self, ratio: ComplexArray, slopes: ComplexArray) -> Array:
        """Residual and derivatives (1 + W, 2 B) in standard deviations, for a model's ratio (B,) and slopes (W, B)."""
        both = np.concatenate([(self.ratio - ratio / self.model)[None], slopes / self.model])
        return np.concatenate([both.real, both.imag], axis=1) @ self.root.T


def water_of(
    frequency_hz: Array,
    speed: Numbers,
    torque: Numbers,
    model: ComplexArray,
    load: ComplexArray,
    accuracy: float,
    late_s: float,
) -> Water | None:
    """Return the ratios of torque to speed in residuals (F,), for a model's ratio (F,); None if no band is informative."""
    # `load` is the ratio by the load's law. Disturbances of the engine, and errors of the governor's model, move torque and
    # speed in the same direction, by this law; disturbances of the load move them in opposite directions. `accuracy` and
    # `late_s` are the standard deviations of the ratio's systematic errors, and of a delay between both channels that the
    # model lacks.
    expected, rows, first = model * speed, [], 1
    while first + LEAST_BINS <= len(frequency_hz):
        last = max(int(first * BAND), first + LEAST_BINS)
        part = slice(first, min(last, len(frequency_hz)))
        first, count = last, part.stop - part.start
        cross = complex(np.vdot(expected[part], torque[part]))
        power, total = (float(np.vdot(one[part], one[part]).real) for one in (expected, torque))
        coherence = abs(cross) ** 2 / max(power * total, 1e-300)
        ratio = cross / abs(cross) * np.sqrt(total / power) if coherence > 0.0 else 0.0
        middle = (part.start + part.stop) // 2
        opposite = (ratio * model[middle] * load[middle].conjugate()).real < 0.0
        if count >= LEAST_BINS and coherence > COHERENT and opposite:
            centre = np.average(np.arange(part.start, part.stop), weights=np.abs(expected[part]) ** 2)
            lost = (1.0 - coherence) / coherence
            rows.append(
                (centre, ratio, np.hypot(np.sqrt(lost / (2.0 * count)), accuracy), np.hypot(lost, SCALE))
            )
    if not rows:
        return None
    centres, ratios, scatter, common = (np.array(column) for column in zip(*rows, strict=True))
    covariance = np.diag(np.tile(scatter * np.abs(ratios), 2) ** 2)
    hz = np.interp(centres, np.arange(len(frequency_hz)), frequency_hz)
    for shape in (ratios * common, 1j * ratios * common, 2j * np.pi * hz * late_s * ratios):
        error = np.concatenate([shape.real, shape.imag])
        covariance += np.outer(error, error)
    at = np.interp(hz, frequency_hz, model.real) + 1j * np.interp(hz, frequency_hz, model.imag)
    return Water(
        2j * np.pi * hz,
        at,
        ratios,
        np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64),
    )
