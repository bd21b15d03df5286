"""Changes between two fingerprints of a ship and their significance; measured responses beside modelled ones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2, norm

from shipfp_rs.assessment.closed_loop import predict_response, structure_of
from shipfp_rs.assessment.comparable import require_comparable, with_common_elements
from shipfp_rs.errors import InputError, UnknownNameError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse, local_response
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.estimate import decimals, rounded
from shipfp_rs.identification.fingerprint import Estimate, Fingerprint
from shipfp_rs.identification.identifiability import gradient_of
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.ties import COMBINATIONS, declared
from shipfp_rs.support.arguments import checked
from shipfp_rs.support.arrays import DEVIATIONS_95, Array, Brief
from shipfp_rs.support.tables import shown, text_table
from shipfp_rs.support.threads import with_one_blas_thread
from shipfp_rs.support.units import unit_shown

SMOOTHED = 13
"""Number of bins over which the set point's power is averaged; `local_response` uses the same number for one point."""
EXCITED = 1e-4
"""Least power of the set point at an excited frequency, relative to its maximum."""
LOST = 0.3
"""Relative standard deviation above which a point carries no information."""


def compared_responses(
    fingerprint: Fingerprint, experiments: Sequence[Experiment], structure: Structure | None = None
) -> list[tuple[FrequencyResponse, FrequencyResponse]]:
    """Return the measured response of each experiment, and the model's.

    The measured response is independent of the model: local polynomials over the band excited by the set point. Points
    with a standard deviation above 30 % are omitted, and so are experiments without any point. The response of a
    nonlinear model depends on the excitation; it is estimated in the same way from a simulation with the experiment's set
    point.

    Parameters
    ----------
    fingerprint, structure
        See `predict`.
    experiments
        Experiments of the fit.

    Raises
    ------
    InputError
        See `predict`.
    """
    structure, pairs = structure or structure_of(fingerprint), []
    for experiment in experiments:
        measured = _measured(experiment, structure)
        if measured is None:
            continue
        try:
            model = predict_response(fingerprint, measured, structure=structure)
        except InputError:
            model = _simulated(fingerprint.predict(experiment, structure), measured)
        pairs.append((measured, replace(model, name=structure.name)))
    return pairs


def _simulated(model: Experiment, measured: FrequencyResponse) -> FrequencyResponse:
    """Response of the model that simulated an experiment, at the measured frequencies."""
    response = local_response(model, _band(model), signals=[*measured.response])
    return response.select(np.isin(response.frequency_hz, measured.frequency_hz))


def _measured(experiment: Experiment, structure: Structure) -> FrequencyResponse | None:
    chosen = [
        structure.signal_for(output, experiment.signals, experiment.name) for output in structure.outputs
    ]
    signals = [name for name in chosen if name in experiment.operating_point]
    try:
        response = local_response(experiment, _band(experiment), signals=signals)
    except InputError:
        return None  # the record holds only rest, or is too short
    known = np.all([response.amplitude_std[name] < LOST for name in signals], axis=0)
    return response.select(known) if known.any() else None


def _band(experiment: Experiment) -> tuple[float, float]:
    """Lowest and highest frequency excited by the set point [Hz]; `InputError` if it is constant."""
    power = np.abs(np.fft.rfft(experiment.dn_set - experiment.dn_set.mean())) ** 2
    smooth = uniform_filter1d(power, SMOOTHED, mode="constant")
    excited = np.flatnonzero(smooth > EXCITED * smooth.max())
    if not excited.size:
        raise InputError(f"{experiment.name}: the set point is constant, expected one that moves")
    resolution = experiment.rate_hz / len(experiment)
    return max(float(excited[0]), 1.0) * resolution, float(excited[-1]) * resolution


SAME_DIRECTION = 1e-8
"""Ratio of an eigenvalue of a correlation matrix to the largest eigenvalue, below which quantities are
linearly dependent.
"""

DAMAGED = "settings.possible of the fingerprint: expected a finite value of every parameter in each"


@dataclass(frozen=True)
class Change:
    """One parameter or combination in both fingerprints: values, difference with its 95 % interval, p, verdict.

    `p` is two-sided. `significant` compares it with a level corrected for the number of quantities (Holm's method):
    without any change, the probability of at least one false alarm is at most that level.
    """

    name: str
    unit: str
    before: float
    after: float
    change: float
    change_pct: float
    ci95: tuple[float, float]
    p: float
    significant: bool

    @property
    def places(self) -> int | None:
        """Digits after the point that the interval of the change justifies."""
        return decimals((self.ci95[1] - self.ci95[0]) / (2.0 * DEVIATIONS_95))

    @property
    def by(self) -> str:
        """The change in words, relative to the value before, or absolute if that was zero."""
        if math.isfinite(self.change_pct):
            return f" by {self.change_pct:+.1f} %"
        return f" by {rounded(self.change, self.places)} {unit_shown(self.unit)}".rstrip()


class Joint(NamedTuple):
    """Wald test of all quantities together: statistic, degrees of freedom, p, and the two that contribute most."""

    statistic: float
    freedom: int
    p: float
    most: tuple[str, ...] = ()


HEAD = ("quantity", "before", "after", "95 % of the change", "unit", "p")


@dataclass(frozen=True, repr=False)
class Comparison(Brief):
    """Changes by quantity, joint test, remarks on what weakens them, and verdict in plain words."""

    changes: tuple[Change, ...]
    joint: Joint
    level: float
    remarks: tuple[str, ...]
    verdict: tuple[str, ...]

    def __getitem__(self, name: str) -> Change:
        """Return the change of one quantity."""
        for change in self.changes:
            if change.name == name:
                return change
        known = ", ".join(change.name for change in self.changes)
        raise UnknownNameError(f"no quantity {name!r} known in both fingerprints; compared are {known}")

    def rows(self) -> list[list[str]]:
        """Return the changes as text, a row each under `HEAD`; a star after p marks a significant one."""
        return [
            [
                change.name,
                *(rounded(value, change.places) if value else "0" for value in (change.before, change.after)),
                " to ".join(rounded(value, change.places) for value in change.ci95),
                unit_shown(change.unit) or "-",
                f"{_chance(change.p).removeprefix('= ')}{' *' if change.significant else ''}",
            ]
            for change in self.changes
        ]

    def __str__(self) -> str:
        return "\n".join((*text_table(HEAD, self.rows()), "", *self.verdict, *self.remarks))

    def _repr_html_(self) -> str:
        return shown("Comparison", HEAD, self.rows(), (*self.verdict, *self.remarks))

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "changes": [asdict(change) | {"ci95": list(change.ci95)} for change in self.changes],
            "joint": self.joint._asdict() | {"most": list(self.joint.most)},
            "level": self.level,
            "remarks": list(self.remarks),
            "verdict": list(self.verdict),
        }


@checked
@with_one_blas_thread
def compare(
    before: Fingerprint,
    after: Fingerprint,
    *,
    level: float = 0.05,
    draws: tuple[Draws, Draws] | None = None,
) -> Comparison:
    """Compare the parameters of two fingerprints, with the significance of changes under both covariances.

    Parameters
    ----------
    before, after
        Fingerprints of the same ship, structure and operating speed, from separate data. If the data selected the
        structures, one fingerprint may lack an element, such as a torque limit; its experiments are then fitted with this
        element. A fingerprint loaded without its experiments is compared as it is, and a remark says so.
    level
        Probability of a false alarm, over all quantities, and for the joint test.
    draws
        Draws of both fingerprints, from which intervals and covariances are then computed; draws also follow
        curved valleys of the likelihood.

    Returns
    -------
    Comparison
        Every parameter and combination known in both fingerprints; the remarks list the quantities known in only one of
        them.

    Raises
    ------
    InputError
        If the fingerprints can't be compared: they differ in ship, structure, operating speed or given values, a
        search found no minimum, or no quantity is known in both.

    Notes
    -----
    The interval of a difference adds the half-widths of both intervals in quadrature, each on the relevant side (the
    square-and-add limits of Zou and Donner, 10.1002/sim.3095), which preserves skewness. The joint test weights the
    differences by the sum of both covariances, over the quantities in both and the non-singular eigenvectors. The
    spread along each is at least that of the ships compatible with the data.
    """
    if not 0.0 < level < 1.0:
        raise InputError(f"level {level}, expected a probability between 0 and 1")
    (before, after), again = with_common_elements((before, after))
    if again and draws is not None:
        raise InputError(
            "draws: one fingerprint was fitted again with an element of the other, expected draws of both with it; leave "
            "them out"
        )
    remarks = (*require_comparable(before, after), *again)
    names = _common(before, after)
    alone = [_change(name, before[name], after[name], draws) for name in names]
    significant = _holm([change.p for change in alone], level)
    changes = tuple(replace(change, significant=s) for change, s in zip(alone, significant, strict=True))
    together = [name for name in names if _is_correlated(before, name) and _is_correlated(after, name)]
    joint = _joint(together, before, after, draws)
    return Comparison(changes, joint, level, remarks, _verdict(changes, joint, level, len(together)))


@checked
@with_one_blas_thread
def trend(fingerprints: Mapping[float, Fingerprint], name: str) -> tuple[float, float, float]:
    """Fit a line through one quantity of many fingerprints, each weighted by its inverse variance (condition monitoring).

    Parameters
    ----------
    fingerprints
        Three or more fingerprints by time (any unit).
    name
        Parameter or combination.

    Returns
    -------
    slope, std, p
        Slope per unit of time, its standard deviation, and the two-sided probability of such a slope without a trend.
        If the values scatter about the line more than by their standard deviations, the scatter determines
        `std`.

    Raises
    ------
    InputError
        For fewer than three fingerprints, or if one does not determine the quantity.
    """
    if len(fingerprints) < 3:
        raise InputError(
            f"{len(fingerprints)} fingerprints, expected three or more for a trend; use compare for two"
        )
    times = np.array(list(fingerprints), dtype=float)
    (first, *others), _ = with_common_elements(list(fingerprints.values()))
    for other in others:
        require_comparable(first, other)
    found = [fingerprint[name] for fingerprint in (first, *others)]
    for time, estimate in zip(times, found, strict=True):
        if estimate.value is None or estimate.std is None:
            raise InputError(f"{name!r} is not known in the fingerprint at {time:g}: {estimate.reason}")
    values = np.array([estimate.value for estimate in found], dtype=float)
    deviations = np.array([estimate.std for estimate in found], dtype=float)
    columns = np.column_stack([np.ones_like(times), times - times.mean()]) / deviations[:, None]
    line, *_ = np.linalg.lstsq(columns, values / deviations, rcond=None)
    scatter = float(np.sum((values / deviations - columns @ line) ** 2)) / (len(times) - 2)
    std = float(np.sqrt(max(scatter, 1.0) * np.linalg.inv(columns.T @ columns)[1, 1]))
    return float(line[1]), std, float(2.0 * norm.sf(abs(line[1]) / std))


def _common(before: Fingerprint, after: Fingerprint) -> list[str]:
    tied = declared(before.structure)
    names = [
        name
        for name, estimate in {**before.parameters, **before.derived}.items()
        if estimate.std  # for an estimate on a bound, `std` may be missing or zero
        and name not in tied
        and (name in after.parameters or name in after.derived)
        and after[name].std
    ]
    if not names:
        raise InputError("no parameter or combination is known in both fingerprints; nothing to compare")
    return names


def _change(name: str, before: Estimate, after: Estimate, draws: tuple[Draws, Draws] | None = None) -> Change:
    assert before.value is not None
    assert after.value is not None
    (low_before, high_before), (low_after, high_after) = (
        _sides(one, None if drawn is None else drawn.parameters.get(name))
        for one, drawn in zip((before, after), draws or (None, None), strict=True)
    )
    change = after.value - before.value
    down, up = float(np.hypot(low_after, high_before)), float(np.hypot(high_after, low_before))
    # The hypothesis of no change is tested with the half-width of the interval on the side of zero change.
    facing = down if change > 0.0 else up
    return Change(
        name=name,
        unit=before.unit,
        before=before.value,
        after=after.value,
        change=change,
        change_pct=100.0 * change / abs(before.value) if before.value else float("nan"),
        ci95=(change - down, change + up),
        p=float(2.0 * norm.sf(DEVIATIONS_95 * abs(change) / facing))
        if facing > 0.0
        else float(change == 0.0),
        significant=False,
    )


def _sides(estimate: Estimate, drawn: Array | None = None) -> tuple[float, float]:
    """Distances from the value to the interval's ends; a side that a bound cuts short gets the other side's distance."""
    value, ends = estimate.value, estimate.ci95
    assert value is not None
    assert estimate.std is not None
    if drawn is not None:
        first, last = np.quantile(drawn, [0.025, 0.975]).tolist()
        ends = min(first, value), max(last, value)
    half = DEVIATIONS_95 * estimate.std
    if ends is None:
        return half, half
    low, high = value - ends[0], ends[1] - value
    return (high if low < 0.5 * half else low), (low if high < 0.5 * half else high)


def _holm(probabilities: Sequence[float], level: float) -> list[bool]:
    """Which probabilities are significant by Holm's step-down method (Holm 1979)."""
    significant = [False] * len(probabilities)
    for rank, index in enumerate(np.argsort(probabilities)):
        if probabilities[index] > level / (len(probabilities) - rank):
            break
        significant[index] = True
    return significant


def _is_correlated(fingerprint: Fingerprint, name: str) -> bool:
    """Whether the covariance contains a quantity, or all members of a combination that are not fixed."""
    known, values = fingerprint.covariance["names"], fingerprint.optimum
    if name in known or name not in COMBINATIONS:
        return name in known
    try:
        slopes = gradient_of(COMBINATIONS[name][1], values, [*values], declared(fingerprint.structure))
    except (KeyError, ZeroDivisionError):
        return True  # `covariance_of` raises the error
    members = [member for member, slope in zip(values, slopes, strict=True) if slope]
    return all(one in known or fingerprint[one].status == "fixed" for one in members)


def _joint(
    names: Sequence[str],
    before: Fingerprint,
    after: Fingerprint,
    draws: tuple[Draws, Draws] | None = None,
) -> Joint:
    if draws is not None:
        names = [name for name in names if all(name in one.names for one in draws)]
    if not names:
        return Joint(0.0, 0, 1.0)
    change = np.array([(after[name].value or 0.0) - (before[name].value or 0.0) for name in names])
    if draws is None:
        both = covariance_of(before, names), covariance_of(after, names)
    else:
        first, second = (np.atleast_2d(np.cov([one.parameters[name] for name in names])) for one in draws)
        both = first, second
    # A quantity that depends linearly on others adds no degree of freedom. The ranks of the two covariances may differ,
    # and the smaller one is used.
    told = min(_rank(covariance) for covariance in both)
    size = np.sqrt(np.diag(both[0] + both[1]))
    strength, direction = (
        rows[..., -told:] for rows in np.linalg.eigh((both[0] + both[1]) / np.outer(size, size))
    )
    reached = (_reached(one, names) @ (direction / size[:, None]) for one in (before, after))
    strength = np.maximum(strength, sum(np.max(rows**2, axis=0) for rows in reached) / DEVIATIONS_95**2)
    along = direction.T @ (change / size) / np.sqrt(strength)
    statistic = float(along @ along)
    strongest = direction[:, int(np.argmax(np.abs(along)))]
    most = tuple(names[place] for place in np.argsort(-np.abs(strongest))[:2])
    return Joint(statistic, told, float(chi2.sf(statistic, told)), most)


def _reached(fingerprint: Fingerprint, names: Sequence[str]) -> Array:
    """Distance of each parameter set compatible with the data from the estimate, for each quantity, shape (sets, K)."""
    # A covariance is an ellipsoid; sets along a curve, as for delays, lie partly outside it.
    try:
        rows = [
            [values[name] if name in values else COMBINATIONS[name][1](values) for name in names]
            for values in (fingerprint.optimum, *fingerprint.settings.get("possible", ()))
        ]
        found: Array = np.array(rows, dtype=np.float64) - np.array(rows[0], dtype=np.float64)
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise InputError(DAMAGED) from error
    if not np.isfinite(found).all():
        raise InputError(DAMAGED)
    return found


def _rank(covariance: Array) -> int:
    size = np.sqrt(np.diag(covariance))
    strength = np.linalg.eigvalsh(covariance / np.outer(size, size))
    return int(np.sum(strength > SAME_DIRECTION * strength[-1]))


def covariance_of(fingerprint: Fingerprint, names: Sequence[str]) -> Array:
    """Covariance of parameters and combinations, shape (K, K).

    Correlations are from the linearised problem, standard deviations from the intervals.

    Raises
    ------
    InputError
        For a quantity that the fingerprint does not determine.
    """
    known, matrix = (
        fingerprint.covariance["names"],
        np.array(fingerprint.covariance["matrix"], dtype=np.float64),
    )
    values = fingerprint.optimum
    rows = []
    for name in names:
        std = fingerprint[name].std
        if std is None or not std > 0.0:
            reason = fingerprint[name].reason or f"found {std}, expected a positive one"
            raise InputError(f"{name!r} has no standard deviation in the fingerprint: {reason}")
        if name in known:
            rows.append((np.array(known) == name).astype(float))
        else:
            try:
                rows.append(
                    gradient_of(COMBINATIONS[name][1], values, known, declared(fingerprint.structure))
                )
            except (KeyError, ZeroDivisionError) as error:
                raise InputError(
                    f"{name!r} does not follow from the fingerprint's parameters, since one of them is missing or zero"
                ) from error
    linear = np.array(rows) @ matrix @ np.array(rows).T
    variances = np.diag(linear)
    if not (linear**2 <= (1.0 + 1e-6) * np.outer(variances, variances)).all() or not (variances > 0.0).all():
        raise InputError(
            "covariance.matrix of the fingerprint: expected positive variances, correlations within 1"
        )
    scale = np.array([fingerprint[name].std for name in names], dtype=float) / np.sqrt(variances)
    return np.asarray(linear * np.outer(scale, scale))


def _chance(p: float) -> str:
    """Probability with the sign "=" or "<"; the digits of a probability below a millionth have no meaning."""
    return "< 1e-6" if p < 1e-6 else f"= {p:.2g}"


def _verdict(changes: Sequence[Change], joint: Joint, level: float, count: int) -> tuple[str, ...]:
    found = [change for change in changes if change.significant]
    lines = [
        f"{change.name} changed{change.by} ({rounded(change.before, change.places)} to "
        f"{rounded(change.after, change.places)}{f' {unit_shown(change.unit)}'.rstrip()}; p {_chance(change.p)})."
        for change in found
    ]
    together = f"{'all ' if count == len(changes) else ''}{count} quantities together: "
    together += f"chi-squared {joint.statistic:.3g} at {joint.freedom}"
    together += f", p {_chance(joint.p)}"
    if found:
        lines.append(f"The rest did not change by more than chance ({together}).")
    elif joint.p < level:
        both = [change for change in changes if change.name in joint.most]
        moved = " and ".join(f"{change.name}{change.by}" for change in both)
        lines.append(
            f"Something changed ({together}), though no quantity alone by more than chance: {moved}, which the errors of "
            "both trials would not move so together."
        )
    else:
        lines.append(f"No change beyond what the uncertainties allow ({together}).")
        least = min(
            changes, key=lambda change: (change.ci95[1] - change.ci95[0]) / max(abs(change.before), 1e-300)
        )
        seen = 50.0 * (least.ci95[1] - least.ci95[0]) / max(abs(least.before), 1e-300)
        lines.append(
            f"A change of {least.name} by less than {seen:.2g} % could not have been distinguished from chance."
        )
    return tuple(lines)
