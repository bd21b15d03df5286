"""Fingerprints: fitted parameters with their uncertainty, and what the data can't tell. Saved as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from shipfp_rs.errors import InputError
from shipfp_rs.support.files import write_text_atomically
from shipfp_rs.support.html import shown
from shipfp_rs.support.json_files import json_text, read_json

Status = Literal["free", "fixed", "prior", "at_bound", "unidentifiable"]

FORMAT = 1
"""Version of the JSON layout; raised when a key changes its meaning."""
WRITTEN = "a fingerprint, as `shipfp run` writes it"
ALARM = 0.01
"""Probability of a false alarm of each residual test, all outputs together."""

STATUS: Mapping[str, str] = {
    "free": "estimated",
    "fixed": "given",
    "prior": "estimated, with prior",
    "at_bound": "on its bound",
    "unidentifiable": "not identifiable",
}


@dataclass(frozen=True)
class Estimate:
    """One parameter or combination: value, standard deviation, 95 % interval, unit, status.

    `value`, `std` and `ci95` are None where the data do not determine them; `reason` then says why.
    """

    value: float | None
    std: float | None = None
    ci95: tuple[float, float] | None = None
    unit: str = "-"
    status: Status = "free"
    reason: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "value": self.value,
            "std": self.std,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "unit": self.unit,
            "status": self.status,
            "reason": self.reason,
        }


@dataclass(frozen=True)
class Identifiability:
    """Numerical rank of the sensitivities at the estimate, and the directions that the data leave open.

    `null_space` holds one entry a direction: {"combination": text, "direction": {parameter: relative change}};
    `closes_gap` the parameters any of which, once known, makes the rest identifiable.
    """

    rank: int
    free: int
    condition: float
    null_space: tuple[Mapping[str, Any], ...] = ()
    closes_gap: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "rank": self.rank,
            "free": self.free,
            "condition": self.condition if math.isfinite(self.condition) else None,
            "null_space": [dict(entry) for entry in self.null_space],
            "closes_gap": list(self.closes_gap),
        }


@dataclass(frozen=True)
class Fingerprint:
    """The result of an identification.

    Parameters
    ----------
    parameters
        Name to estimate, every parameter of the structure, free or not.
    derived
        Combinations that are identifiable though their members are not.
    identifiability
        Rank and null directions.
    fit
        Output to {"nrmse_pct": ..., ...}; "overall" holds the figures of all outputs together.
    structure, vessel, data, settings, versions
        What was fitted, to which ship and experiments, how, and with which software.
    seed
        Seed of the random starts.
    verdict
        Plain sentences: what is known, what is not, what would settle it.
    covariance
        "names" of the parameters searched for and not held by a bound, and the "matrix" of their covariances on the
        directions that the data tell.
    residuals
        Output to {"autocorrelation": ..., "set_point": ...}: "lags" [samples], "correlation" [-] of the whitened residuals
        with themselves and with the set point that long before, and the half width of the "band" of 95 % by chance.
    elements
        Element of the ship model to {"state": "on" | "off" | "open", "limit": ..., "evidence": change of the deviance};
        empty where the structure was given.
    adequate
        "stands": whether the residuals leave the model unchallenged; "misses_pct": what it misses of each output, in
        per cent of its spread; "bias": how far that can move each parameter.
    usable
        The verdict's first sentence: what the fingerprint can be used for.
    si
        Quantity to {"value", "std", "ci95", "unit"} in SI units, where a vessel gives the scale.
    """

    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    identifiability: Identifiability
    fit: Mapping[str, Mapping[str, float | None]]
    structure: Mapping[str, Any]
    vessel: str | None = None
    data: tuple[Mapping[str, Any], ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)
    verdict: tuple[str, ...] = ()
    covariance: Mapping[str, Any] = field(default_factory=lambda: {"names": [], "matrix": []})
    residuals: Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]] = field(default_factory=dict)
    elements: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    adequate: Mapping[str, Any] = field(default_factory=dict)
    usable: str = ""
    si: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Estimate:
        """Return a parameter or derived combination by name."""
        for group in (self.parameters, self.derived):
            if name in group:
                return group[name]
        known = ", ".join([*self.parameters, *self.derived])
        raise InputError(f"no parameter {name!r} in the fingerprint; it holds {known}")

    @property
    def model_adequate(self) -> bool | None:
        """Whether the residuals leave the structure unchallenged, `verdict.structure_test`; None where nothing tests it.

        A structure that suits the ship is called wrong in one fit of a hundred.
        """
        p = self.fit.get("overall", {}).get("structure_p")
        return None if p is None else p >= ALARM

    def _ipython_key_completions_(self) -> list[str]:
        return [*self.parameters, *self.derived]

    def __repr__(self) -> str:
        found = ", ".join(
            f"{name}={estimate.value:.4g}" if estimate.value is not None else f"{name}=?"
            for name, estimate in self.parameters.items()
        )
        return f"Fingerprint({found}; rank {self.identifiability.rank}/{self.identifiability.free})"

    def _repr_html_(self) -> str:
        return shown(
            f"Fingerprint of {self.vessel or 'a ship not named'}",
            ["parameter", "estimate", "std", "95 % from", "to", "unit", "status"],
            [
                [row.name, row.value, row.std, row.low, row.high, row.unit, row.status]
                for row in rounded_rows({**self.parameters, **self.derived})
            ],
            self.verdict,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form, the contract of `fingerprint.json`."""
        return {
            "format": FORMAT,
            "parameters": {name: estimate.to_dict() for name, estimate in self.parameters.items()},
            "derived": {name: estimate.to_dict() for name, estimate in self.derived.items()},
            "identifiability": self.identifiability.to_dict(),
            "fit": {output: dict(figures) for output, figures in self.fit.items()},
            "structure": dict(self.structure),
            "vessel": self.vessel,
            "data": [dict(entry) for entry in self.data],
            "settings": dict(self.settings),
            "seed": self.seed,
            "versions": dict(self.versions),
            "verdict": list(self.verdict),
            "covariance": dict(self.covariance),
            "residuals": {output: dict(tests) for output, tests in self.residuals.items()},
            "elements": {name: dict(row) for name, row in self.elements.items()},
            "adequate": dict(self.adequate),
            "usable": self.usable,
            "si": {name: dict(row) for name, row in self.si.items()},
        }

    def save(self, path: str | Path) -> Path:
        """Write `fingerprint.json`; the file appears whole or not at all."""
        return write_text_atomically(Path(path), json_text(self.to_dict()))

    @classmethod
    def load(cls, path: str | Path) -> Fingerprint:
        """Read a fingerprint written by `save`.

        Raises
        ------
        InputError
            Where the file is missing, is not JSON, or lacks a key.
        """
        path = Path(path)
        content = read_json(path, WRITTEN)
        if not isinstance(content, dict) or "format" not in content:
            raise InputError(f"{path}: found no key 'format', expected {WRITTEN}")
        try:
            return cls._from_dict(content)
        except KeyError as error:
            raise InputError(f"{path}: found no key {error}, expected {WRITTEN}") from error
        except (TypeError, AttributeError, ValueError, IndexError) as error:
            raise InputError(f"{path}: not a fingerprint ({error}), expected {WRITTEN}") from error

    @classmethod
    def _from_dict(cls, content: dict[str, Any]) -> Fingerprint:
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']}, expected {FORMAT}")
        rank = content["identifiability"]
        return cls(
            parameters={name: _estimate(entry) for name, entry in content["parameters"].items()},
            derived={name: _estimate(entry) for name, entry in content["derived"].items()},
            identifiability=Identifiability(
                rank=int(rank["rank"]),
                free=int(rank["free"]),
                condition=math.inf if rank["condition"] is None else float(rank["condition"]),
                null_space=tuple(rank["null_space"]),
                closes_gap=tuple(rank["closes_gap"]),
            ),
            fit=content["fit"],
            structure=content["structure"],
            vessel=content["vessel"],
            data=tuple(content["data"]),
            settings=content["settings"],
            seed=content["seed"],
            versions=content["versions"],
            verdict=tuple(content["verdict"]),
            covariance=content["covariance"],
            residuals=content.get("residuals", {}),  # older files have none of these
            elements=content.get("elements", {}),
            adequate=content.get("adequate", {}),
            usable=content.get("usable", ""),
            si=content.get("si", {}),
        )


def _estimate(entry: dict[str, Any]) -> Estimate:
    status = entry["status"]
    if status not in get_args(Status):
        raise ValueError(f"status {status!r}, expected one of {', '.join(get_args(Status))}")
    interval = entry["ci95"]
    return Estimate(
        value=_figure(entry, "value"),
        std=_figure(entry, "std"),
        ci95=None if interval is None else (_end(interval[0], -math.inf), _end(interval[1], math.inf)),
        unit=entry["unit"],
        status=status,
        reason=entry["reason"],
    )


def _figure(entry: Mapping[str, Any], key: str) -> float | None:
    value = entry[key]
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise ValueError(f"{key}: {str(value)[:40]!r}, expected a number or null")
    return value


def _end(value: float | None, open_end: float) -> float:
    """End of an interval; null in JSON is none."""
    return open_end if value is None else float(value)


@dataclass(frozen=True)
class Row:
    """One line of a table of estimates, rounded to what its uncertainty allows; empty text where None."""

    name: str
    value: str
    std: str
    low: str
    high: str
    unit: str
    status: str
    reason: str
    truth: str = ""
    holds_truth: bool | None = None


def rounded_rows(
    estimates: Mapping[str, Estimate], truth: Mapping[str, float] | None = None
) -> Iterator[Row]:
    """Give a line for each estimate, with the true value, and whether its interval holds it, where known."""
    for name, estimate in estimates.items():
        places = decimals(estimate.std)
        real = (truth or {}).get(name)
        low, high = estimate.ci95 if estimate.ci95 is not None else (None, None)
        yield Row(
            name=name,
            value=rounded(estimate.value, places),
            std=rounded(estimate.std, places),
            low=rounded(low, places),
            high=rounded(high, places),
            unit=estimate.unit,
            status=STATUS[estimate.status],
            reason=estimate.reason,
            truth=rounded(real, places),
            holds_truth=None if real is None or low is None or high is None else low <= real <= high,
        )


def decimals(std: float | None) -> int | None:
    """Digits behind the point that leave two significant ones of a standard deviation; None where there is none."""
    if not std or not math.isfinite(std):
        return None
    return min(max(1 - math.floor(math.log10(std)), 0), 9)


def rounded(value: float | None, places: int | None) -> str:
    """Write a value with that many digits behind the point, or four significant ones; empty text for None."""
    if value is None:
        return ""
    return f"{value:.4g}" if places is None else f"{value:.{places}f}"
