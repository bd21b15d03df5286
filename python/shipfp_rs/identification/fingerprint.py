"""Fingerprints: fitted parameters, their uncertainty, and what the data can't determine. Saved as JSON."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from shipfp_rs._core import __version__
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.basins import Minima
from shipfp_rs.identification.estimate import Estimate as Estimate
from shipfp_rs.identification.estimate import Identifiability as Identifiability
from shipfp_rs.identification.estimate import Usable, WhyNot, estimate_of
from shipfp_rs.identification.fingerprint_file import FingerprintTables, require_layout, sentences_of
from shipfp_rs.identification.fingerprint_simulation import SimulationMixin
from shipfp_rs.support.arguments import check_fields, checked
from shipfp_rs.support.files import ending_in, json_text, read_json, write_text_atomically
from shipfp_rs.support.sentences import Sentence, parts_of, with_parts

FORMAT = 1
"""Version of the JSON layout; raised when a key changes its meaning."""
WRITTEN = "a fingerprint, as `shipfp run` writes it"
ALARM = 0.01
"""False alarm probability of each residual test, over all outputs."""


@dataclass(frozen=True, repr=False)
class Fingerprint(FingerprintTables, SimulationMixin):
    """The result of an identification.

    Parameters
    ----------
    parameters
        Name to estimate of every parameter of the structure, free or not.
    derived
        Combinations that are identifiable although their parameters are not.
    identifiability
        Rank and null directions.
    fit
        Output to {"nrmse_pct": ..., ...}; "overall" has the figures of all outputs together.
    structure, vessel, data, settings, versions
        Structure, ship, experiments and settings of the fit, and versions of the software.
    seed
        Seed of the random starts.
    verdict
        Plain sentences: what is known, what is not, and what would settle it.
    covariance
        "names" of the searched parameters that no bound holds, and "matrix", their covariance in the directions that the
        data determine.
    residuals
        Output to {"autocorrelation": ..., "set_point": ...}: "lags" [samples], "correlation" [-] of the whitened residuals
        with themselves and with the earlier set point, and "band", the half width of their 95 % band by chance.
    elements
        Element of the ship model to {"state": "on" | "off" | "open", "limit": ..., "evidence": change of the deviance};
        empty where the structure was given.
    adequate
        "stands": whether the residuals are consistent with the model. "misses_pct": misfit of each output, in per cent of
        its spread. "sides": whether the model describes the "load", and
        the "engine" with its governor. "engine": effects on the engine's side that the model lacks, by kind of shape.
        "limit": of a ship with a limit its level ("M_max" or "rate"), the torque that it removes over what the torque moves
        ("removed"), the "share" of the time, and the share of the "amplitude" that stays clear of it.
        "engine_curves": the torque that the model lacks over the governor's "error" and over the rack's "slope".
    load_side
        Name to estimate of the load from speed and torque alone, without a model of engine and governor, see `load_side`;
        empty if speed and torque determine nothing.
    usable
        First sentence of the verdict: what the fingerprint can be used for.
    usability
        What the fingerprint can be used for, in a word: "usable", "usable except" (the parameters or intervals in the
        sentence) or "not usable"; empty where this is unknown, as for a structure fitted to frequency responses.
    why_not
        Reason why a fingerprint is not usable: "no minimum", "nothing explained" (of an output), "nothing told" (of any
        parameter), or "misfit" (of the model).
    si
        Quantity to {"value", "std", "ci95", "unit"} in SI units, where a vessel gives the scale.
    experiments
        The fitted experiments, which a file does not hold.
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
    load_side: Mapping[str, Estimate] = field(default_factory=dict)
    usable: str = ""
    usability: Usable = ""
    why_not: WhyNot = ""
    si: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    experiments: tuple[Experiment, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        check_fields(self, "fingerprint")

    @property
    def model_adequate(self) -> bool | None:
        """Whether the residuals are consistent with the model, by `adequate` or `structure_test`; None without such a test.

        A correct structure is rejected in one fit of a hundred.
        """
        p = self.fit.get("overall", {}).get("structure_p")
        return self.adequate.get("stands") if p is None else p >= ALARM

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form, the contract of `fingerprint.json`; `sentences` has the parts of its texts."""
        content = {
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
            "load_side": {name: estimate.to_dict() for name, estimate in self.load_side.items()},
            "usable": self.usable,
            "usability": self.usability,
            "why_not": self.why_not,
            "si": {name: dict(row) for name, row in self.si.items()},
        }
        return {**content, "sentences": parts_of(content)}

    def to_json(self) -> str:
        """Return the JSON document that `save` writes, with a final newline; numbers that are not finite are null.

        Examples
        --------
        >>> json.loads(fingerprint.to_json())["format"]  # doctest: +SKIP
        1
        """
        return json_text(self.to_dict())

    @checked
    def save(self, path: str | Path) -> Path:
        """Write `fingerprint.json`; the file appears whole or not at all.

        Raises
        ------
        InputError
            If the suffix belongs to another kind of file, or the file can't be written.
        """
        return write_text_atomically(ending_in(path, ".json"), self.to_json())

    @checked
    def report(self, path: str | Path, **content: Any) -> Path:
        """Write `report.html`: the estimates, their uncertainty, and the processing of the data.

        Parameters
        ----------
        path
            File to write.
        content
            "title", "language", "truth", "vessel" and "structure", as of `report.write_report`.

        Returns
        -------
        Path
            `path`.
        """
        # Imported by name, since this module does not depend on the report.
        write: Callable[..., Path] = import_module("shipfp_rs.report").write_report
        return write(ending_in(path, ".html"), self, **content)

    @checked
    def plot(self, **options: Any) -> Any:
        """Plot measured and modelled outputs; see `plot.fit`, which takes the options and returns the axes."""
        return import_module("shipfp_rs.plot").fit(self, **options)

    @classmethod
    @checked
    def load(cls, path: str | Path) -> Fingerprint:
        """Read a fingerprint written by `save`.

        Raises
        ------
        InputError
            If the file is missing, is not JSON, or lacks a key.
        """
        path = Path(path)
        content = read_json(path, WRITTEN)
        if not isinstance(content, dict) or "format" not in content:
            raise InputError(f"{path}: found no key 'format', expected {WRITTEN}")
        try:
            return cls._from_dict(content)
        except KeyError as error:
            raise InputError(f"{path}: found no key {error}, expected {WRITTEN}") from error
        except (TypeError, AttributeError, ValueError, IndexError, RecursionError) as error:
            raise InputError(f"{path}: {error}; expected {WRITTEN}") from error

    @classmethod
    def _from_dict(cls, content: dict[str, Any]) -> Fingerprint:
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']}, expected {FORMAT}")
        require_layout(content)
        content = with_parts(content, sentences_of(content.get("sentences", {})))
        rank = content["identifiability"]
        return cls(
            parameters={name: estimate_of(entry) for name, entry in content["parameters"].items()},
            derived={name: estimate_of(entry) for name, entry in content["derived"].items()},
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
            residuals=content.get("residuals", {}),  # absent in older files, like the following keys
            elements=content.get("elements", {}),
            adequate=content.get("adequate", {}),
            load_side={name: estimate_of(entry) for name, entry in content.get("load_side", {}).items()},
            usable=content.get("usable", ""),
            usability=content.get("usability", ""),
            why_not=content.get("why_not", ""),
            si=content.get("si", {}),
        )


UNSETTLED = Sentence("the search was ended before it settled")


def versions() -> dict[str, str]:
    """Return the versions of what computed a fingerprint."""
    others = {name: version(name) for name in ("numpy", "scipy")}
    return {"shipfp_rs": __version__, "python": platform.python_version(), **others}


def search_settings(fit: Minima, optimum: Mapping[str, float]) -> dict[str, Any]:
    """Return the settings of a fingerprint that a search leads to; `optimum` are the parameters of the best minimum."""
    c, above = fit.likelihood.coordinates, fit.total - fit.best.cost
    minima = [
        {
            "criterion": float(end.cost + above) if math.isfinite(end.cost + above) else None,
            "converged": end.settled,
            "parameters": {name: c.values(end.vector)[name] for name in c.names},
        }
        for end in fit.basins
    ]
    return {
        "optimum": dict(optimum),
        "criterion": fit.total,
        "converged": fit.best.settled,
        "message": "" if fit.best.settled else UNSETTLED,
        "minima": minima,
    }


def record_row(
    data: Experiment | FrequencyResponse, signals: Mapping[str, str], fits: Sequence[float], used: int
) -> dict[str, Any]:
    """Return the row of fitted data in a fingerprint; `signals` and `fits` [%] are those of the outputs."""
    row: dict[str, Any] = {
        "name": data.name,
        "domain": "time" if isinstance(data, Experiment) else "frequency",
        "signals": dict(signals),
        "operating_point": dict(data.operating_point),
        "fit": {output: {"nrmse_pct": value} for output, value in zip(signals, fits, strict=True)},
        "samples": len(data),
        "used": used,
    }
    if isinstance(data, Experiment):
        row |= {"rate_hz": data.rate_hz, "duration_s": data.duration, "kind": data.kind}
        row |= {"load": data.load} if data.load else {}
    return row
