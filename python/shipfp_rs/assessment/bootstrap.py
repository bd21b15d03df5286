"""Bootstrap uncertainty without a noise model: fits to the model's output with resampled blocks of residuals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shipfp_rs.errors import IdentificationError, InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import Whole, checked
from shipfp_rs.support.arrays import Array, Brief, Mask
from shipfp_rs.support.tables import text_table
from shipfp_rs.support.threads import with_one_blas_thread

FEWEST_DRAWS = 20
MOST_DRAWS = 1_000_000
FEWEST_BLOCKS = 10
"""Least number of blocks in the shortest experiment; with fewer, the draws hardly differ."""
QUIET_LAGS = 5
"""Least number of successive insignificant lags after which the correlation counts as zero (K_N of Politis and White)."""


@dataclass(frozen=True, repr=False)
class Bootstrap(Brief):
    """Bootstrap estimates, for comparison with the fingerprint's intervals.

    Parameters
    ----------
    fingerprint
        The fit whose residuals were resampled.
    names
        Identifiable parameters and combinations.
    draws
        Estimates of the named quantities, shape (B, P); NaN if a draw does not determine the quantity.
    failed
        Number of draws whose search found no minimum; they are omitted.
    block_s
        Length of a block in each experiment [s].
    seed
        Seed of the draws.
    """

    fingerprint: Fingerprint
    names: tuple[str, ...]
    draws: Array
    failed: int
    block_s: tuple[float, ...]
    seed: int

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each quantity over the draws."""
        return dict(zip(self.names, np.nanstd(self.draws, axis=0, ddof=1).tolist(), strict=True))

    @property
    def covariance(self) -> Array:
        """Covariance of the draws in which all parameters are determined, shape (P, P)."""
        whole = self.draws[np.isfinite(self.draws).all(axis=1)]
        return np.atleast_2d(np.cov(whole, rowvar=False))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Return the percentile interval of the draws.

        Raises
        ------
        InputError
            For a name without estimates, or a level outside (0, 1).
        """
        if name not in self.names:
            raise InputError(f"bootstrap: no estimates of {name!r}, expected one of {', '.join(self.names)}")
        if not 0.0 < level < 1.0:
            raise InputError(f"level is {level:g}, expected a share between 0 and 1")
        tail = 50.0 * (1.0 - level)
        low, high = np.nanpercentile(self.draws[:, self.names.index(name)], [tail, 100.0 - tail])
        return float(low), float(high)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "draws": len(self.draws),
            "failed": self.failed,
            "block_s": list(self.block_s),
            "seed": self.seed,
            "std": self.std,
            "ci95": {name: list(self.interval(name)) for name in self.names},
        }

    def __str__(self) -> str:
        head, rows = ("", "estimate", "std", "bootstrap", "95 % interval by bootstrap"), []
        for name, deviation in self.std.items():
            estimate = self.fingerprint[name]
            own = "" if estimate.std is None else f"{estimate.std:.3g}"
            low, high = self.interval(name)
            rows.append((name, f"{estimate.value:.5g}", own, f"{deviation:.3g}", f"{low:.5g} to {high:.5g}"))
        return "\n".join(text_table(head, rows, left=1))


@checked
@with_one_blas_thread
def bootstrap(
    experiments: Experiment | Sequence[Experiment],
    structure: Structure,
    *,
    draws: int = 200,
    block_s: float | None = None,
    seed: Whole = 0,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Bootstrap:
    """Fit, resample the residuals in random blocks, and refit many times.

    The scatter of the estimates is their uncertainty for any coloured residuals, from noise or model error.
    The residuals must be stationary and correlated over less than a block. The bootstrap takes `draws` fits,
    and serves to check the intervals of `identify`.

    Parameters
    ----------
    experiments
        One experiment, or several that are fitted together.
    structure
        The model.
    draws
        Number of fits.
    block_s
        Length of a block [s]; by default from the correlation of the residuals.
    seed
        Seed of the draws.
    progress
        Called with (completed fits, all fits).
    options
        Options of `identify`.

    Returns
    -------
    Bootstrap

    Raises
    ------
    InputError
        For fewer than 20 draws, data other than experiments, or blocks too long for the shortest experiment.
    IdentificationError
        If the first fit fails.

    Notes
    -----
    Circular blocks of residuals, all outputs together: D. N. Politis and J. P. Romano, "A circular block-resampling
    procedure for stationary data", 1992, after H. R. Kunsch, 10.1214/aos/1176347265. The length of a block is the one
    of D. N. Politis and H. White, 10.1081/ETC-120028836, corrected in 10.1080/07474930802459016.
    """
    records = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    for record in records:
        if not isinstance(record, Experiment):
            raise InputError(f"bootstrap: data of type {type(record).__name__}, expected experiments")
    if not FEWEST_DRAWS <= draws <= MOST_DRAWS:
        raise InputError(f"draws is {draws}, expected {FEWEST_DRAWS} to {MOST_DRAWS}")
    fingerprint = identify(records, structure, **options)
    optimum = fingerprint.optimum
    parts = [_Residuals.of(record, structure, optimum, block_s) for record in records]
    started = structure.with_start(
        **{parameter.name: optimum[parameter.name] for parameter in structure.free}
    )
    names = tuple(name for name, one in _estimates(fingerprint).items() if one.std is not None)
    random = np.random.default_rng(seed)
    rows, failed = [], 0
    for done in range(draws):
        try:
            found = identify([part.drawn(random) for part in parts], started, **{**options, "starts": 1})
            rows.append([_value(_estimates(found).get(name)) for name in names])
        except IdentificationError:
            failed += 1
        if progress is not None:
            progress(done + 1, draws)
    if not rows:
        raise IdentificationError(f"the search found no minimum in any of {draws} draws")
    lengths = tuple(part.block / part.record.rate_hz for part in parts)
    return Bootstrap(fingerprint, names, np.array(rows), failed, lengths, seed)


def block_length(residuals: Array) -> int:
    """Length of a circular block for a series of residuals, shape (N,), in samples.

    Rule of Politis and White: from the correlogram with a flat-top taper, up to `QUIET_LAGS` successive
    insignificant lags.

    Examples
    --------
    >>> block_length(np.random.default_rng(0).standard_normal(10_000)) < 10
    True
    """
    count = len(residuals)
    centred = residuals - residuals.mean()
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    covariance = np.fft.irfft(spectrum, size)[: count // 2] / count
    if covariance[0] <= 0.0:
        return 1
    quiet = max(QUIET_LAGS, int(np.sqrt(np.log10(count))))
    significant = np.abs(covariance[1:] / covariance[0]) >= 2.0 * np.sqrt(np.log10(count) / count)
    runs = np.convolve(~significant, np.ones(quiet), "valid") >= quiet
    last = int(np.argmax(runs)) if runs.any() else len(significant) // 2
    reach = min(2 * max(last, 1), len(covariance) - 1)
    lags = np.arange(reach + 1)
    taper = np.minimum(1.0, 2.0 * (1.0 - lags / reach))
    both = np.where(lags > 0, 2.0, 1.0) * taper * covariance[: reach + 1]
    slope, level = float((lags * both).sum()), float(both.sum())
    if level <= 0.0:
        return 1
    return max(1, round(float((1.5 * count * (slope / level) ** 2) ** (1.0 / 3.0))))


@dataclass(frozen=True)
class _Residuals:
    """Model and residuals of an experiment, both as deviations (O, N), and the block length in samples."""

    record: Experiment
    signals: tuple[str, ...]
    model: Array
    residual: Array
    valid: Mask
    block: int

    @classmethod
    def of(
        cls, record: Experiment, structure: Structure, values: Mapping[str, float], block_s: float | None
    ) -> _Residuals:
        simulated = simulated_about(structure, values, record)
        model = np.array(list(simulated.values()))
        residual = structure.measured(record) - model
        valid = np.isfinite(residual).all(axis=0)
        kept = residual[:, valid]
        if block_s is not None and not 0.0 < block_s <= record.duration:
            raise InputError(
                f"block_s is {block_s:g}, expected more than 0 and at most {record.duration:g} s"
            )
        block = max(map(block_length, kept)) if block_s is None else round(block_s * record.rate_hz)
        if not 1 <= block <= kept.shape[1] // FEWEST_BLOCKS:
            raise InputError(
                f"{record.name!r}: blocks of {block / record.rate_hz:.3g} s, expected at least a sample and at most a tenth "
                f"of the record's {kept.shape[1] / record.rate_hz:.3g} s; give block_s or a longer record"
            )
        return cls(record, tuple(simulated), model, kept - kept.mean(axis=1, keepdims=True), valid, block)

    def drawn(self, random: np.random.Generator) -> Experiment:
        """Model output with resampled blocks of residuals; masked samples stay masked."""
        count = self.residual.shape[1]
        starts = random.integers(0, count, -(-count // self.block))
        order = ((starts[:, None] + np.arange(self.block)) % count).ravel()[:count]
        deviation = np.full_like(self.model, np.nan)
        deviation[:, self.valid] = self.model[:, self.valid] + self.residual[:, order]
        signals = dict(self.record.signals)
        for signal, row in zip(self.signals, deviation, strict=True):
            origin = 0.0 if signal == "E_n" else 1.0
            signals[signal] = self.record.operating_point[signal] * (origin + row)
        return replace(self.record, signals=signals)


def _estimates(fingerprint: Fingerprint) -> dict[str, Estimate]:
    return {**fingerprint.parameters, **fingerprint.derived}


def _value(found: Estimate | None) -> float:
    return np.nan if found is None or found.value is None else found.value
