"""Fingerprints: fitted parameters, their uncertainty, and what the data can't determine. Saved as JSON."""

from __future__ import annotations

import contextlib
import math
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from shipfp_rs._core import __version__
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.experiments.parquet import read_experiments
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.basins import Minima
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.estimate import Estimate as Estimate
from shipfp_rs.identification.estimate import Identifiability as Identifiability
from shipfp_rs.identification.fingerprint_content import Content, require_agreement
from shipfp_rs.identification.fingerprint_simulation import FingerprintSimulation
from shipfp_rs.identification.fingerprint_tables import FingerprintTables
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import Count, Whole, checked, expect
from shipfp_rs.support.files import ending_in, finite, json_text, read_json, write_text_atomically
from shipfp_rs.support.sentences import Sentence, parts_of, with_parts
from shipfp_rs.support.validation import require

FORMAT = 1
"""Version of the JSON layout; raised when a key changes its meaning."""
WRITTEN = "a fingerprint, as `shipfp run` writes it"
IN_FILE = [one.name for one in fields(Content) if one.name != "experiments"]


class Fingerprint(FingerprintTables, FingerprintSimulation):
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
    structure, vessel, data, settings, seed, versions
        Structure, ship, experiments, settings and random seed of the fit, and versions of the software.
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
        Name to estimate of the load from speed and torque alone, without a model of drive and governor, see `load_side`;
        empty if speed and torque determine nothing.
    behind_meter
        "p", "c_2" and "tau_prop" of the load behind the meter of a shaft's torque, where the model ends at such a meter and
        the set point moves; see `whole_ship`. Relative to the torque before the meter.
    usable, usability
        What the fingerprint can be used for, in the verdict's first sentence, and in a word: "usable", "usable except" (the
        parameters or intervals in the sentence) or "not usable"; empty where unknown, as for frequency responses.
    why_not
        Reason why a fingerprint is not usable: "no minimum", "nothing explained" (of an output), "nothing told" (of any
        parameter), or "misfit" (of the model).
    si
        Quantity to {"value", "std", "ci95", "unit"} in SI units, where a vessel gives the scale.
    held_out
        Name of each window that was not fitted to output to {"nrmse_pct": ..., "inside_pct": ...}: how well it is predicted,
        and the share of its samples within the prediction's 95 % band [%].
    experiments
        The fitted experiments. They are no part of a file; `load` reads them from `experiments.parquet` beside it.
    """

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form, the contract of `fingerprint.json`; `sentences` has template and values of each text."""
        content = {"format": FORMAT, **finite({name: getattr(self, name) for name in IN_FILE})}
        return {**content, "sentences": parts_of(content)}

    def to_json(self) -> str:
        """Return the JSON document that `save` writes, with a final newline; numbers that are not finite are null."""
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
        """Write `report.html` and return its path; `content` is "title", "language", "truth", "vessel" and "structure"."""
        # Imported by name, since this module does not depend on the report.
        write: Callable[..., Path] = import_module("shipfp_rs.report").write_report
        return write(ending_in(path, ".html"), self, **content)

    @checked
    def plot(self, **options: Any) -> Any:
        """Plot measured and modelled outputs; see `plot.fit`, which takes the options and returns the axes."""
        return import_module("shipfp_rs.plot").fit(self, **options)

    def margins(self, draws: Draws | None = None) -> dict[str, Estimate]:
        """Return crossover, phase margin and the other figures of the speed loop; see `assessment.closed_loop`."""
        of = import_module("shipfp_rs.assessment.closed_loop").closed_loop
        found: dict[str, Estimate] = of(self, draws=draws)
        return found

    @checked
    def draws(
        self,
        n: Count = 1000,
        seed: Whole = 0,
        *,
        structure: Structure | None = None,
    ) -> Draws:
        """Draw ships that the data allow, with the fit's priors and bounds, valleys included.

        Each draw is the estimate that other noise of the same kind would give. Errors of the model widen draws as they widen
        intervals, by the largest widening of any interval.

        Parameters
        ----------
        n, seed
            Number of draws, and seed.
        structure
            The fingerprint's structure; None rebuilds it.

        Returns
        -------
        Draws
            Values of all parameters, shape (n, P). Those that the data leave unknown follow their priors within their
            bounds, those that are fixed stay.

        Raises
        ------
        InputError
            If only the load's side is told, or the fitted experiments are missing or others.
        IdentificationError
            If fewer than nine in ten draws end in a minimum.

        Notes
        -----
        Randomised maximum likelihood, Bardsley et al., 10.1137/140964023: minima of the deviance with a draw of its slope
        added. They follow the likelihood with Jeffreys' measure; where every parameter has a prior they are weighted and
        resampled to follow the posterior.

        Examples
        --------
        >>> import shipfp_rs as fp
        >>> chirp = fp.signals.chirp(0.02, 2.0, 60.0, 40.0, rate_hz=20.0)
        >>> launch = fp.Vessel.load("stan-launch-804")
        >>> trial = fp.simulate(launch, chirp, noise={"n_e": 0.05, "M_b": 0.1}, seed=0)
        >>> found = fp.identify(trial, fp.Structure.ship(products=True)).draws(500)
        >>> found.table.shape[0]
        500
        """
        of: Callable[..., Draws] = import_module("shipfp_rs.identification.perturbed").draws_of
        return of(self, n, seed, structure)

    @classmethod
    @checked
    def load(cls, path: str | Path) -> Fingerprint:
        """Read a fingerprint written by `save`, with the fitted experiments if `experiments.parquet` lies beside it.

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
            found = cls._from_dict(content)
        except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
            said = str(error).removeprefix("fingerprint: ")
            raise InputError(f"{path}: {said}; expected {WRITTEN}") from error
        with contextlib.suppress(InputError):  # without the experiments, or with a damaged file of them
            experiments = read_experiments(path.with_name("experiments.parquet"))
            if [one.name for one in experiments] == [row["name"] for row in found.data]:
                return replace(found, experiments=experiments)
        return found

    @classmethod
    def _from_dict(cls, content: dict[str, Any]) -> Fingerprint:
        expect(content["format"] == FORMAT, "format", content["format"], str(FORMAT))
        content = with_parts(content, _sentences_of(content.get("sentences", {})))
        found = cls(**{name: content[name] for name in IN_FILE if name in content})
        require_agreement(found)
        return found


def _sentences_of(table: Any) -> dict[str, Sentence]:
    """Return the sentences of a file by their text, which their parts must reproduce."""
    require(table, Mapping[str, Mapping[str, Any]], "sentences")
    made = {text: Sentence.from_dict(entry) for text, entry in table.items()}
    for text, sentence in made.items():
        expect(text == sentence, "sentences", str(sentence), f"parts that make {text[:60]!r}")
    return made


UNSETTLED = Sentence("the search was ended before it settled")


def versions() -> dict[str, str]:
    """Return the versions of what computed a fingerprint."""
    return {"shipfp_rs": __version__, "python": platform.python_version()} | {
        name: version(name) for name in ("numpy", "scipy")
    }


def search_settings(fit: Minima, optimum: Mapping[str, float]) -> dict[str, Any]:
    """Return the settings that a fingerprint has from a search; `optimum` are the parameters of the best minimum."""
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
