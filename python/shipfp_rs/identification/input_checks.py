"""Plausibility checks before a fit: whether the ship is excited, and whether channels match their names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import butter, sosfiltfilt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import DRIVES, Experiment
from shipfp_rs.identification.sampling import LEAST_SWING
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.sentences import Sentence

LEAST_SAMPLES = 200
"""Least number of samples of an experiment."""
LEAST_CORRELATION = 0.3
"""Least correlation of set point and speed, at the best delay, for the speed to follow the set point."""
LONGEST_DELAY_S = 5.0
"""Longest tested delay of the speed behind its set point [s]."""
EARLY_S, CLEARLY, BY_CHANCE = 0.15, 0.03, 3.0
"""A speed moves before its set point if it leads by more than `EARLY_S`, and if the correlation of the slopes at this lead
exceeds that at any other delay by `CLEARLY` plus `BY_CHANCE` standard deviations of chance."""
SAME_SPEED, SAME_RACK = 5e-3, 1e-4
"""Least difference, relative to the swing, of a speed from its set point, and of a rack from a torque. Below
it the two are one channel: no governor is that fast, and no rack has exactly the torque's noise."""
APART = 0.02
"""Relative difference of set point and speed at the operating point that is reported; integrating governors leave none."""
STILL = 1e-7
"""Relative standard deviation of a torque below which it counts as constant."""
SLOW_HZ = 1.0
"""Upper limit of the band in which channels are compared [Hz]."""
SAMPLES_A_PERIOD = 8.0
"""Samples per period of `SLOW_HZ`; more samples do not improve a correlation."""
LEAST_AGREEMENT = 0.5
"""Size of a negative correlation from which a torque counts as opposite to the load."""
LEAST_OWN = 0.2
"""Least share of the torque's power caused by the set point, for a check of the torque's sign."""
POINT_OFF = 0.3
"""Largest relative difference between a signal's mean and its operating point."""


def require_excited(experiments: Sequence[Experiment], *, follows: bool = True) -> None:
    """Refuse experiments without excitation, or with channels that do not match their names."""
    # With `follows`, a speed that hardly follows its set point is refused. Ships at a limit are checked without it.
    for experiment in experiments:
        if len(experiment) < LEAST_SAMPLES:
            raise InputError(
                f"{experiment.name!r}: {len(experiment)} samples, expected at least {LEAST_SAMPLES}; widen the window"
            )
        _require_operating_point(experiment)
    moving = [experiment for experiment in experiments if _swing(experiment) >= LEAST_SWING]
    if not moving:
        worst = max(experiments, key=_swing)
        raise InputError(
            f"{worst.name!r}: the {DRIVES[worst.driver]} moves by {100 * _swing(worst):.2g} % of the operating point, "
            f"expected at least {100 * LEAST_SWING:.2g} %; a constant set point needs a measured load that changes"
        )
    for experiment in moving:
        _require_following(experiment, follows)
        _require_moving_torque(experiment)
        _require_own_rack(experiment)
        _require_torque_sign(experiment)


def require_plausible(experiments: Sequence[Experiment]) -> None:
    """Refuse a wrong operating point or a constant torque, whether or not the speed follows its set point."""
    for experiment in experiments:
        _require_operating_point(experiment)
        _require_moving_torque(experiment)


def _swing(experiment: Experiment) -> float:
    return max(float(np.std(experiment.dn_set)), _load_swing(experiment))


def _load_swing(experiment: Experiment) -> float:
    """Standard deviation of the measured load relative to its operating point; 0 without a measured load."""
    return float(np.std(experiment.normalised("M_load"))) if "M_load" in experiment.signals else 0.0


def set_point_moves(experiments: Sequence[Experiment]) -> bool:
    """Whether the set point moves in one of the experiments, so that its dead time is identifiable."""
    return max(float(np.std(one.dn_set)) for one in experiments) >= LEAST_SWING


def is_loaded(experiments: Sequence[Experiment]) -> bool:
    """Whether every experiment has a measured load, and it moves in one of them."""
    measured = all("M_load" in experiment.signals for experiment in experiments)
    return measured and max(map(_load_swing, experiments)) >= LEAST_SWING


def _slow(values: Array, rate_hz: float) -> Array:
    whole = np.isfinite(values)
    index = np.arange(len(values))
    bridged = np.interp(index, index[whole], values[whole])
    filt = butter(2, min(SLOW_HZ / (0.5 * rate_hz), 0.9), output="sos")
    return np.asarray(sosfiltfilt(filt, bridged - bridged.mean()))


def _speed(experiment: Experiment) -> tuple[str, Array] | None:
    for name in ("n_e", "n_s"):
        if name in experiment.signals and np.isfinite(experiment.signals[name]).sum() > LEAST_SAMPLES // 2:
            return name, experiment.normalised(name)
    return None


def _require_operating_point(experiment: Experiment) -> None:
    for name in ("n_set", "command", "n_e", "n_s", "M_g", "M_s", "M_b"):
        if name not in experiment.signals or name not in experiment.operating_point:
            continue
        values = experiment.normalised(name)
        if not np.isfinite(values).any():
            continue
        mean = float(np.nanmean(values))
        # Torque follows the load, and a mean deviation of the load is no error.
        loads = name.startswith("M_") and "M_load" in experiment.signals
        loaded = abs(float(np.mean(experiment.normalised("M_load")))) if loads else 0.0
        if abs(mean) > POINT_OFF + loaded:
            raise InputError(
                f"{experiment.name!r}: {name} is {100 * (1 + mean):.3g} % of its operating point on average, expected about "
                "100 %; check the calibration, the unit and the operating point"
            )


def _require_following(experiment: Experiment, follows: bool) -> None:
    if _load_swing(experiment) > float(np.std(experiment.dn_set)):
        return
    found = _speed(experiment)
    if found is None:
        return
    name, values = found
    what = DRIVES[experiment.driver]
    rate = experiment.rate_hz
    asked, speed = _slow(experiment.dn_set, rate), _slow(values, rate)
    if _apart(asked, speed) < SAME_SPEED:
        raise InputError(
            f"{experiment.name!r}: {experiment.driver} equals {name} within {100 * SAME_SPEED:g} % of its swing, expected "
            f"a {what} that the speed follows with a delay; is its column that of the measured speed?"
        )
    _require_cause(experiment, name, asked, speed)
    longest = min(round(LONGEST_DELAY_S * rate), len(speed) // 4)
    lags = np.unique(np.linspace(0, longest, 41).astype(int))
    apart = max(int(rate / (SAMPLES_A_PERIOD * SLOW_HZ)), 1)
    with np.errstate(invalid="ignore"):  # a constant speed has no correlation
        pairs = [
            float(np.corrcoef(asked[: len(asked) - lag : apart], speed[lag::apart])[0, 1]) for lag in lags
        ]
    # Half a period later a sine has the opposite sign: the sign is wrong only if no delay gives a positive correlation.
    best = max(pairs) if max(pairs) >= LEAST_CORRELATION else min(pairs)
    if not np.isfinite(best) or (follows and abs(best) < LEAST_CORRELATION):
        raise InputError(
            f"{experiment.name!r}: {name} does not follow the {what} (correlation {best:.2g} at best within "
            f"{LONGEST_DELAY_S:g} s), expected at least {LEAST_CORRELATION:g}; is the {what}'s column the right one?"
        )
    if best < -LEAST_CORRELATION:
        raise InputError(
            f"{experiment.name!r}: {name} falls when the {what} rises (correlation {best:.2g}), expected it to rise; "
            f"reverse the sign of the {what}'s calibration"
        )


def _apart(one: Array, other: Array) -> float:
    """Norm of the component of a signal that is orthogonal to another signal, relative to the norm of the first."""
    one, other = one - one.mean(), other - other.mean()
    factor = float(one @ other) / max(float(other @ other), 1e-300)
    return float(np.linalg.norm(one - factor * other) / max(float(np.linalg.norm(one)), 1e-300))


def _require_own_rack(experiment: Experiment) -> None:
    """Refuse a rack channel that is a scaled copy of a torque channel."""
    if "X_f" not in experiment.signals:
        return
    rack = experiment.normalised("X_f")
    for name in ("M_b", "M_s", "M_g"):
        if name not in experiment.signals:
            continue
        torque = experiment.normalised(name)
        both = np.isfinite(rack) & np.isfinite(torque)
        if both.sum() > LEAST_SAMPLES // 2 and _apart(rack[both], torque[both]) < SAME_RACK:
            raise InputError(
                f"{experiment.name!r}: X_f is a scaled copy of {name}, noise included, expected the rack's own channel; "
                "leave X_f out or give the column of the rack"
            )


def doubts(experiments: Sequence[Experiment]) -> list[Sentence]:
    """Return a sentence for each experiment whose set point differs from the speed in steady state."""
    lines = []
    for experiment in experiments:
        asked, speed = (experiment.operating_point.get(name, np.nan) for name in ("n_set", "n_e"))
        if abs(asked / speed - 1.0) > APART:
            lines.append(
                Sentence(
                    "Set point and speed differ at the operating point of {name}, {asked} and {speed} rpm. A "
                    "governor with an integral part leaves no difference; look at the set point's calibration.",
                    name=repr(experiment.name),
                    asked=f"{asked:.4g}",
                    speed=f"{speed:.4g}",
                )
            )
    return lines


def _require_cause(experiment: Experiment, name: str, asked: Array, speed: Array) -> None:
    """Refuse a speed that moves before its set point does."""
    rate = experiment.rate_hz
    causes, answers = np.gradient(asked), np.gradient(speed)
    step = max(1, round(0.05 * rate))
    longest = min(round(LONGEST_DELAY_S * rate), len(speed) // 4)
    size = max(float(np.linalg.norm(causes) * np.linalg.norm(answers)), 1e-300)
    padded = np.pad(answers, longest)  # so that the whole window counts, also a step near its start
    agreement = {
        lag / rate: float(causes @ padded[longest + lag :][: len(causes)]) / size
        for lag in range(-longest, longest + 1, step)
    }
    early = max((lag for lag in agreement if lag < -EARLY_S), key=agreement.__getitem__, default=None)
    if early is None:
        return
    late = max(value for lag, value in agreement.items() if lag >= -EARLY_S)
    rest = max(1.0 - agreement[early] ** 2, 0.0)
    chance = np.sqrt(rest) * _chance(causes, answers)
    if agreement[early] > late + CLEARLY + BY_CHANCE * chance:
        raise InputError(
            f"{experiment.name!r}: {name} moves {-early:.2g} s before the {DRIVES[experiment.driver]}, expected after it; "
            "check the clocks of the two channels and delay_s"
        )


def _chance(one: Array, other: Array) -> float:
    """Standard deviation of the correlation of two independent signals (Bartlett)."""
    powers = [np.abs(np.fft.fft(values, 2 * len(values))) ** 2 for values in (one, other)]
    sizes = float(one @ one) * float(other @ other) * len(one)
    return float(np.sqrt(np.mean(powers[0] * powers[1]) / max(sizes, 1e-300)))


def _require_moving_torque(experiment: Experiment) -> None:
    name = next((name for name in ("M_b", "M_s", "M_g") if name in experiment.signals), None)
    if name is None or not np.isfinite(experiment.signals[name]).any():
        return
    if float(np.nanstd(experiment.normalised(name))) < STILL:
        raise InputError(
            f"{experiment.name!r}: {name} stands still at {np.nanmean(experiment.signals[name]):.4g} Nm while the set point "
            "moves, expected it to move; is the channel connected?"
        )


def _require_torque_sign(experiment: Experiment) -> None:
    found = _speed(experiment)
    name = next((name for name in ("M_g", "M_s", "M_b") if name in experiment.signals), None)
    if found is None or name is None:
        return
    torque = experiment.normalised(name)
    if not np.isfinite(torque).any():
        return
    rate = experiment.rate_hz
    slow, speed = _slow(torque, rate), _slow(found[1], rate)
    load = _slow(experiment.normalised("M_load"), rate) if _load_swing(experiment) >= LEAST_SWING else None
    if load is not None and _correlation(slow, load) < -LEAST_AGREEMENT:
        raise InputError(
            f"{experiment.name!r}: {name} falls while the load rises, expected it to rise; reverse the "
            "sign of its scale"
        )
    if not set_point_moves([experiment]):
        return
    # Under a load the shaft slows down while the torque rises: only the response to the set point shows the sign.
    asked = _delayed(_slow(experiment.dn_set, rate), rate)
    causes = asked if load is None else np.column_stack([asked, _delayed(load, rate)])
    motions = np.column_stack([slow, speed, np.gradient(speed) * rate])
    by_cause = np.linalg.lstsq(causes, motions, rcond=None)[0][: asked.shape[1]]
    own, *answers = (asked @ by_cause).T
    columns = np.column_stack(answers)
    fitted = np.linalg.lstsq(columns, own, rcond=None)[0]
    rest = own - columns @ fitted
    told = float(own @ own) > LEAST_OWN * float(slow @ slow)
    if told and fitted[1] < 0.0 and float(rest @ rest) < 0.5 * float(own @ own):
        raise InputError(
            f"{experiment.name!r}: {name} falls while the shaft speeds up, expected it to rise; reverse the "
            "sign of its scale"
        )


def _delayed(values: Array, rate_hz: float) -> Array:
    """Copies of a signal at delays up to the longest, (N, K); a response to the signal is a sum of these."""
    at = np.arange(len(values))
    delays = np.arange(0.0, min(LONGEST_DELAY_S, 0.1 * len(values) / rate_hz), 0.5 / SLOW_HZ) * rate_hz
    return np.column_stack([np.interp(at - delay, at, values) for delay in delays])


def _correlation(one: Array, other: Array) -> float:
    return float(one @ other) / max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-300)
