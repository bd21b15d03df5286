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
        Sentences that say what is known, what is not known, and which measurement would determine it.
    covariance
        "names" of the searched parameters that are not held at a bound, and "matrix", their covariance in the directions
        that the data determine.
    residuals
        Output to {"autocorrelation": ..., "set_point": ...}: "lags" [samples], "correlation" [-] of the whitened residuals
        with themselves and with the earlier set point, and "band", the half width of their 95 % band by chance.
    elements
        Element of the ship model to {"state": "on" | "off" | "open", "limit": ..., "evidence": change of the deviance};
        empty where the structure was given.
    adequate
        "stands": whether the residuals are consistent with the model. "misses_pct": misfit of each output, in per cent of
        its spread. "sides": whether the model describes the "load", and the "engine" with its governor. "engine": effects on
        engine and governor that the model lacks, by kind. "limit": the level of a limit ("M_max" or "rate"), the standard
        deviation of the torque that it removes relative to that of the torque ("removed"), the "share" of the time at the
        limit, and the share of the excitation's "amplitude" that does not reach it. "engine_curves": the torque that the
        model lacks, as curves over the governor's "error" and over the rack's "slope" [1/s]; each bin has a mean abscissa
        "at", a mean "torque" and its standard error "std", relative to the operating point.
    load_side
        Name to estimate of the load's parameters from speed and torque alone, without a model of drive and governor (see
        `load_side`); empty if speed and torque determine none.
    behind_meter
        "p", "c_2" and "tau_prop" of the load behind a shaft's torque meter, if the model ends at that meter and the set
        point was moved; see `whole_ship`. They are relative to the torque before the meter.
    usable, usability
        What the fingerprint can be used for: `usable` is the verdict's first sentence; `usability` is "usable", "usable
        except" (for the parameters or intervals in that sentence) or "not usable". Both are empty where this was not judged,
        as for frequency responses.
    why_not
        Reason why a fingerprint is not usable: "no minimum", "nothing explained" (the model explains nothing of an output),
        "nothing told" (the data determine no parameter), or "misfit" (of the model).
    si
        Quantity to {"value", "std", "ci95", "unit"} in SI units, where a vessel gives the scale.
    held_out
        For each window that was left out of the fit, output to {"nrmse_pct": ..., "inside_pct": ...}: fit of the prediction,
        and share of the samples within the prediction's 95 % band [%].
    experiments
        The fitted experiments. A file does not contain them; `load` reads them from `experiments.parquet` beside it.
    """

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `fingerprint.json`; its key `sentences` has template and values of each text."""
        content = {"format": FORMAT, **finite({name: getattr(self, name) for name in IN_FILE})}
        return {**content, "sentences": parts_of(content)}

    def to_json(self) -> str:
        """Return the JSON document that `save` writes, with a final newline; numbers that are not finite are null."""
        return json_text(self.to_dict())

    @checked
    def save(self, path: str | Path) -> Path:
        """Write `fingerprint.json` atomically: an interrupted write leaves no partial file.

        Raises
        ------
        InputError
            If the suffix belongs to another kind of file, or the file can't be written.
        """
        return write_text_atomically(ending_in(path, ".json"), self.to_json())

    @checked
    def report(self, path: str | Path, **content: Any) -> Path:
        """Write `report.html` and return its path; options are `title`, `language`, `truth`, `vessel` and `structure`."""
        # The import is at run time, since the report imports this module.
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
        """Draw ships that the data allow, by the priors and bounds of the fit, also along valleys of the deviance.

        Each draw is the estimate that other noise of the same kind would give. Errors of the model widen the draws by the
        largest factor by which they widen an interval.

        Parameters
        ----------
        n, seed
            Number of draws, and random seed.
        structure
            The fingerprint's structure; None rebuilds it.

        Returns
        -------
        Draws
            Values of all parameters, shape (n, P). Parameters that the data do not determine follow their priors within
            their bounds. Fixed parameters are constant.

        Raises
        ------
        InputError
            If the fingerprint describes only the load, or the experiments are missing or are not those of the fit.
        IdentificationError
            If fewer than nine in ten draws end in a minimum.

        Notes
        -----
        Randomised maximum likelihood (Bardsley et al., doi:10.1137/140964023): each draw minimises the deviance plus a
        random slope. The minima follow the likelihood with Jeffreys' measure. Where every parameter has a prior, they are
        weighted and resampled to follow the posterior.

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
    """Return the sentences of a file by their text; refuse one whose template and values do not reproduce the text."""
    require(table, Mapping[str, Mapping[str, Any]], "sentences")
    made = {text: Sentence.from_dict(entry) for text, entry in table.items()}
    for text, sentence in made.items():
        expect(text == sentence, "sentences", str(sentence), f"parts that make {text[:60]!r}")
    return made


UNSETTLED = Sentence("the search was ended before it settled")


def versions() -> dict[str, str]:
    """Return the versions of shipfp_rs, Python, NumPy and SciPy."""
    return {"shipfp_rs": __version__, "python": platform.python_version()} | {
        name: version(name) for name in ("numpy", "scipy")
    }


def search_settings(fit: Minima, optimum: Mapping[str, float]) -> dict[str, Any]:
    """Return the results of a search for `Fingerprint.settings`; `optimum` are the parameters at the best minimum."""
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
    """Return the entry of an experiment or response in `Fingerprint.data`; `signals` and `fits` [%] are by output."""
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
