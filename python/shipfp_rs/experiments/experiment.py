"""Experiments: calibrated signals with a common time base, an operating point and provenance."""

from __future__ import annotations

import math
from collections.abc import ItemsView, Iterator, KeysView, Mapping, Sequence, ValuesView
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from types import MappingProxyType
from typing import Any, Literal, Self, overload

import numpy as np

from shipfp_rs.errors import InputError, UnknownNameError
from shipfp_rs.support import hints
from shipfp_rs.support.arguments import check_fields, checked, positive, told
from shipfp_rs.support.arrays import Array, EvenlySampled, unmasked
from shipfp_rs.support.tables import Columns, Tabular, shown

Hold = Literal["zero", "first"]

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "n_set": "rpm",
        "command": "",
        "n_e": "rpm",
        "n_s": "rev/s",
        "M_s": "Nm",
        "M_b": "Nm",
        "M_g": "Nm",
        "X_f": "mm",
        "E_n": "rev",
        "M_load": "Nm",
    }
)
"""Unit of each known signal."""
DRIVES: Mapping[str, str] = MappingProxyType(
    {"n_set": "set point", "command": "command", "M_load": "load torque"}
)
"""Signals that are inputs of a model, with their names in words."""
UNLOADED = 0.02
"""Largest load, relative to the operating point's torque, that counts as no load; the sign of such a load is ignored."""
TIME = "time_s"
_FACTS = ("name", "rate_hz", "operating_point", "hold", "kind", "provenance")
_SLIPS = {"rpm": hints.SPEED_RPM, "rev/s": hints.SPEED_RPS, "Nm": hints.TORQUE}


@dataclass(frozen=True, eq=False)
class Experiment(Tabular, EvenlySampled):
    """Uniformly sampled signals of a time range of a trial, NaN where masked.

    Parameters
    ----------
    name
        Label in tables and plots.
    rate_hz
        Sample rate [Hz], the same for every signal.
    signals
        Samples by signal name, each of shape (N,), in the units of `UNITS`.
    operating_point
        Operating value by signal name, in the signal's unit; signals are normalised by it.
    hold
        Interpolation of the set point between samples: "first" (linear; measured signals) or "zero" (stepwise).
    kind
        Kind of excitation, for tables ("chirp", "steps", ...).
    provenance
        Source and processing of the samples.
    """

    name: str
    rate_hz: float
    signals: Mapping[str, Array]
    operating_point: Mapping[str, float]
    hold: Literal["zero", "first"] = "first"
    kind: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self, f"experiment {told(self.name)}")
        positive(f"experiment {self.name!r}: rate_hz", self.rate_hz)
        if ("n_set" in self.signals) == ("command" in self.signals):
            raise InputError(
                f"experiment {self.name!r}: {'both' if 'n_set' in self.signals else 'neither'} of 'n_set' and 'command' "
                f"among {sorted(self.signals)}; expected a governor's set point, or the command of a drive without one"
            )
        frozen: dict[str, Array] = {}
        length = len(self.signals[self.driver])
        if length < 2:
            raise InputError(
                f"experiment {self.name!r}: {length} samples, expected at least 2; check its window"
            )
        for name, samples in self.signals.items():
            if name not in UNITS:
                raise InputError(
                    f"experiment {self.name!r}: signal {name!r} is unknown, {hints.suggestion(name, list(UNITS))}"
                )
            values = unmasked(samples)
            if values.shape != (length,):
                raise InputError(
                    f"experiment {self.name!r}: signal {name!r} has shape {values.shape}, expected ({length},)"
                )
            bad = np.flatnonzero(np.isinf(values))
            if bad.size:
                raise InputError(f"experiment {self.name!r}: signal {name!r} is infinite at sample {bad[0]}")
            values.flags.writeable = False
            frozen[name] = values
        for name, what in DRIVES.items():
            missing = np.flatnonzero(np.isnan(frozen.get(name, np.empty(0))))
            if missing.size:
                raise InputError(
                    f"experiment {self.name!r}: the {what} {name!r} is NaN at sample {missing[0]}; an input of the "
                    "model can't have gaps, bridge them or cut the window"
                )
        for name, value in self.operating_point.items():
            may_be_zero = name == "M_load" and self._load_torque() is not None
            if not np.isfinite(value) or (value == 0.0 and not may_be_zero):
                raise InputError(
                    f"experiment {self.name!r}: operating point of {name!r} is {value}, expected finite, not zero"
                )
        _require_sense(self.name, frozen, self.operating_point)
        object.__setattr__(self, "signals", MappingProxyType(frozen))
        object.__setattr__(self, "operating_point", MappingProxyType(dict(self.operating_point)))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @property
    def driver(self) -> str:
        """Name of the model's input, "n_set", or "command" of a drive in open loop."""
        return "n_set" if "n_set" in self.signals else "command"

    @property
    def outputs(self) -> dict[str, Array]:
        """Output signals: all signals except set point, command and load."""
        return {name: row for name, row in self.signals.items() if name not in DRIVES}

    def __repr__(self) -> str:
        signals = ", ".join(self.signals)
        return f"Experiment({self.name!r}, {len(self)} samples at {self.rate_hz:g} Hz: {signals})"

    def _repr_html_(self) -> str:
        rows = []
        for name, samples in self.signals.items():
            whole = samples[~np.isnan(samples)]
            low, high = (f"{whole.min():.5g}", f"{whole.max():.5g}") if whole.size else ("", "")
            point = f"{self.operating_point[name]:.5g}" if name in self.operating_point else ""
            rows.append([name, UNITS[name], point, low, high, str(len(samples) - whole.size)])
        return shown(
            f"Experiment {self.name}: {self.duration:g} s at {self.rate_hz:g} Hz {self.kind}",
            ["signal", "unit", "operating point", "low", "high", "masked"],
            rows,
            [
                f"{key}: {value}"
                for key, value in self.provenance.items()
                if isinstance(value, str | int | float)
            ],
        )

    def __len__(self) -> int:
        return len(self.signals[self.driver])

    @overload
    def __getitem__(self, name: str) -> Array: ...
    @overload
    def __getitem__(self, name: slice) -> Experiment: ...
    def __getitem__(self, name: str | slice) -> Array | Experiment:
        """Return a signal by name, ``experiment["n_e"]``, or a window in seconds, ``experiment[10.0:20.0]``."""
        if isinstance(name, slice):
            if name.step is not None:
                raise InputError(
                    f"experiment {self.name!r}: a slice with step {name.step!r}, expected start and stop in seconds alone"
                )
            stop = self.duration if name.stop is None else name.stop
            return self.window(name.start or 0.0, stop)
        if name not in self.signals:
            raise UnknownNameError(
                f"experiment {self.name!r}: no signal {name!r}; found {', '.join(self.signals)}"
            )
        return self.signals[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def keys(self) -> KeysView[str]:
        """Names of the signals."""
        return self.signals.keys()

    def values(self) -> ValuesView[Array]:
        """Samples of each signal."""
        return self.signals.values()

    def items(self) -> ItemsView[str, Array]:
        """Name and samples of each signal."""
        return self.signals.items()

    def get(self, name: str, default: Any = None) -> Any:
        """Return a signal by name, or `default`."""
        return self.signals.get(name, default)

    def _ipython_key_completions_(self) -> list[str]:
        return [*self.signals]

    def plot(self, axes: Sequence[Any] | None = None) -> Sequence[Any]:
        """Draw the signals against time; see `plot.signals`."""
        # The plot module is imported at run time by name, since this module must not depend on plots.
        drawn: Sequence[Any] = import_module("shipfp_rs.plot").signals(self, axes)
        return drawn

    @property
    def speed_side(self) -> Literal["engine", "propeller"]:
        """End of the shaft at which the speed is measured; `n_e` may be measured at either end."""
        told = (self.provenance.get("speed") or {}).get("shaft")
        return "propeller" if told == "propeller" or "n_e" not in self.signals else "engine"

    @property
    def start_s(self) -> float:
        """Time of the first sample [s] on the clock of the log from which the experiment was cut; zero without a log."""
        return float((self.provenance.get("window_s") or (0.0,))[0])

    @property
    def gauge_accuracy(self) -> Mapping[str, float]:
        """Relative systematic error that remains after calibration, by signal, if the trial gives it."""
        return {name: float(value) for name, value in (self.provenance.get("gauge_accuracy") or {}).items()}

    @property
    def is_low_passed(self) -> bool:
        """Whether processing applied the same low-pass to all signals."""
        return "filter" in self.provenance

    @cached_property
    def dn_set(self) -> Array:
        """Normalised deviation of the set point (in open loop: of the command), shape (N,); the input of simulations."""
        values = self.normalised(self.driver)
        values.flags.writeable = False
        return values

    @checked
    def normalised(self, name: str) -> Array:
        """Return the relative deviation of a signal from its operating point, as in eq. 3.14 and following, shape (N,).

        A load may be zero at the operating point, so it is divided by its shaft's torque at the operating point, if
        measured. If only the engine torque is measured, the divisor is this torque times `load["torque_ratio"]` of the
        provenance, or the load itself if larger. A load that is not a torque is divided by its own operating value.
        The integrated error E_n is zero at the operating point. It is divided by `operating_point["E_n"]`, the engine
        speed in rev/s, which makes d(dE)/dt = dn_set - dn (eq. 3.15).

        Raises
        ------
        InputError
            If the experiment has no such signal, or no operating point for it.
        """
        samples = self[name]
        if name not in self.operating_point:
            raise InputError(
                f"experiment {self.name!r}: no operating point for {name!r}; give operating_point[{name!r}]"
            )
        value = self.operating_point[name]
        if name == "M_load":
            torque = self._load_torque() or value
            # The scale has the load's sign, so that a growing magnitude is positive for a negative load, too.
            scale = math.copysign(torque, value if abs(value) > UNLOADED * abs(torque) else 1.0)
            return np.asarray((samples - value) / scale)
        return np.asarray(samples / value - (0.0 if name == "E_n" else 1.0))

    def _load_torque(self) -> float | None:
        """Torque of the load's shaft at the operating point; None if unknown, or if the load is not a torque."""
        torque, told = _torque_point(self.signals, self.operating_point), self.provenance.get("load", {})
        if torque is None or told.get("quantity") == "other" or {"M_s", "M_g"} & set(self.signals):
            return None if told.get("quantity") == "other" else torque
        # A steady load is at most its shaft's torque, so it replaces a smaller torque, as for an unknown gear ratio.
        return float(max(abs(torque) * told.get("torque_ratio", 1.0), abs(self.operating_point["M_load"])))

    @property
    def load(self) -> dict[str, Any]:
        """Quantity of the measured load (None: unknown), and its share of its shaft's torque; empty without a load."""
        if not (point := self.operating_point.get("M_load")) or "M_load" not in self.signals:
            return {}
        told = self.provenance.get("load", {}).get("quantity")
        return {"quantity": told, "share": abs(point / (self._load_torque() or point))}

    def unit(self, name: str) -> str:
        """Unit of a signal; empty for a load that is neither torque nor power."""
        return "" if name == "M_load" and self.load.get("quantity") == "other" else UNITS[name]

    def _columns(self) -> Columns:
        own = {name: getattr(self, name) for name in _FACTS}
        facts = {name: dict(one) if isinstance(one, Mapping) else one for name, one in own.items()}
        return Columns({TIME: self.time, **self.signals}, {TIME: "s", **UNITS}, facts)

    @classmethod
    def _from_columns(cls, values: Mapping[str, Array], facts: Mapping[str, Any]) -> Self:
        unknown = [name for name in facts if name not in _FACTS]
        if unknown:
            raise InputError(
                f"{unknown[0]!r} is not a field of an experiment, {hints.suggestion(unknown[0], _FACTS)}"
            )
        index, *names = values
        given: dict[str, Any] = {"name": "experiment", "rate_hz": None, **facts}
        if "operating_point" not in facts:
            given["operating_point"] = _means({name: values[name] for name in names})
            given["provenance"] = {"operating_point": "means of the record", **given.get("provenance", {})}
        if given["rate_hz"] is None:
            given["rate_hz"] = _rate(index, values[index])
        return cls(signals={name: values[name] for name in names}, **given)

    @checked
    def window(self, start_s: float, stop_s: float, *, name: str | None = None) -> Experiment:
        """Return the samples from `start_s` up to, but not including, `stop_s`.

        Parameters
        ----------
        start_s, stop_s
            Time from the first sample [s].
        name
            Label of the result; None: unchanged.

        Raises
        ------
        InputError
            If the window is empty or exceeds the experiment.
        """
        known = -1.0 < start_s < stop_s < self.duration + 1.0  # false for NaN
        first, last = (round(time * self.rate_hz) if known else 0 for time in (start_s, stop_s))
        if not 0 <= first < last <= len(self):
            raise InputError(
                f"experiment {self.name!r}: window {start_s:g} to {stop_s:g} s is empty or outside 0 to "
                f"{self.duration:g} s"
            )
        cut = {key: values[first:last] for key, values in self.signals.items()}
        told = dict(self.provenance)
        if "window_s" in told:
            told["window_s"] = [self.start_s + row / self.rate_hz for row in (first, last)]
        return replace(self, name=name or self.name, signals=cut, provenance=told)


def _torque_point(signals: Mapping[str, Any], operating_point: Mapping[str, float]) -> float | None:
    """Operating point's torque, if measured; the shaft torque comes first, since a load changes it directly."""
    measured = (name for name in ("M_s", "M_g", "M_b") if name in signals and name in operating_point)
    return next((operating_point[name] for name in measured), None)


def _means(signals: Mapping[str, Array]) -> dict[str, float]:
    """Operating point from the signals' means; for the integrated error E_n, the engine speed [rev/s]."""
    means = {
        name: float(np.nanmean(row))
        for name, row in signals.items()
        if name != "E_n" and not np.isnan(row).all()
    }
    if "E_n" in signals and "n_e" in means:
        means["E_n"] = means["n_e"] / 60.0
    return {name: mean for name, mean in means.items() if mean or name == "M_load"}


def _rate(name: str, time: Array) -> float:
    """Sample rate of a column of times [Hz]."""
    steps = np.diff(time)
    if not steps.size or not (np.isfinite(steps).all() and steps.min() > 0.0):
        raise InputError(f"column {name!r} does not ascend; give the time in seconds, or rate_hz")
    rate = steps.size / float(time[-1] - time[0])
    worst = int(np.argmax(np.abs(steps * rate - 1.0)))
    if abs(steps[worst] * rate - 1.0) > 1e-3:
        raise InputError(
            f"column {name!r} steps by {steps[worst]:.6g} s at row {worst}, expected {1.0 / rate:.6g} s throughout; "
            "resample it first"
        )
    # Rounding removes errors of the times, such as 99.99999999999 for 100.
    return float(f"{rate:.9g}")


def _require_sense(label: str, signals: Mapping[str, Array], operating_point: Mapping[str, float]) -> None:
    """Raise an error for a signal in another unit than its operating point, or already normalised."""
    for name, value in operating_point.items():
        if name == "M_load" and _torque_point(signals, operating_point) is not None:
            continue
        # An operating point of exactly 1 means that the signal is already normalised on purpose.
        if name not in signals or name == "E_n" or value == 1.0 or np.isnan(signals[name]).all():
            continue
        mean, most = float(np.nanmean(signals[name])), float(np.nanmax(np.abs(signals[name])))
        known = _SLIPS.get(UNITS[name], ())
        for what, ratio in (("signal", mean / value), ("operating point", value / mean if mean else 0.0)):
            if hint := hints.likely_ratio(ratio, known):
                raise InputError(
                    f"experiment {label!r}: signal {name!r} is {mean:.4g} on average, its operating point {value:g}, "
                    f"expected both in {UNITS[name]}; is the {what} in {hint[2:]}"
                )
        # The mean of a torque or a load may be zero: a gauge may measure only changes, and a load may be switched off.
        # The mean of a speed is near the speed's operating point.
        # A constant signal counts as a placeholder and is not checked.
        is_speed, size = UNITS[name] in ("rpm", "rev/s"), abs(value)
        low, high = (0.4, 2.5) if is_speed else (0.0, 10.0)
        moves = np.nanmin(signals[name]) < np.nanmax(signals[name])
        if moves and (not low * size <= abs(mean) <= high * size or most < 0.01 * size):
            raise InputError(
                f"experiment {label!r}: signal {name!r} is {mean:.4g} {UNITS[name]} on average and {most:.4g} at most, "
                f"its operating point {value:g}, expected an operating point near the signal"
            )
