"""report.html: one self-contained page: what was found, how sure it is, what happened to the data."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

from markupsafe import Markup

from shipfp_rs import plot
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.report import fate, findings, markup
from shipfp_rs.report.bode import compared_responses
from shipfp_rs.report.charts import charts
from shipfp_rs.report.pictures import Pictures
from shipfp_rs.support.files import write_text_atomically
from shipfp_rs.support.html import environment

__all__ = ["compared_responses", "render", "write_report"]

Responses = Sequence[tuple[FrequencyResponse, FrequencyResponse]]

STILL_PICTURES = 12
"""Experiments that have a picture for readers without JavaScript, too."""


def write_report(
    path: str | Path,
    fingerprint: Fingerprint,
    experiments: Sequence[Experiment],
    *,
    simulated: Sequence[Mapping[str, Any]] = (),
    responses: Responses = (),
    truth: Mapping[str, float] | None = None,
    title: str = "Fingerprint",
) -> Path:
    """Write the report of a fingerprint; the file appears whole or not at all.

    The page needs nothing from elsewhere, and no text of a log can run in it: its policy allows its own two scripts
    only and no request at all. An 8 h log makes less than 10 MB.

    Parameters
    ----------
    path
        File to write.
    fingerprint
        The result.
    experiments
        What it was fitted to.
    simulated
        For each experiment, signal name to the fitted model's normalised deviation, shape (N,); may be empty.
    responses
        Measured responses, each with the model's, for Bode plots; `compared_responses` makes them.
    truth
        Name to true value, for simulated logs.
    title
        Headline.

    Returns
    -------
    Path
        `path`.
    """
    return write_text_atomically(
        Path(path),
        render(fingerprint, experiments, simulated=simulated, responses=responses, truth=truth, title=title),
    )


def render(
    fingerprint: Fingerprint,
    experiments: Sequence[Experiment],
    *,
    simulated: Sequence[Mapping[str, Any]] = (),
    responses: Responses = (),
    truth: Mapping[str, float] | None = None,
    title: str = "Fingerprint",
) -> str:
    """Return the page of `write_report` as a string."""
    pictures = Pictures()
    contents: list[tuple[str, str, Iterable[str]]] = [
        ("verdict", "Verdict", findings.verdict(fingerprint)),
        ("samples", "The fate of every sample", fate.of_every_sample(fingerprint, experiments)),
        ("parameters", "Parameters", findings.parameters(fingerprint, truth, pictures)),
        ("identifiability", "What the data can tell", findings.identifiability(fingerprint)),
        ("fit", "Fit", [*findings.fits(fingerprint), *_signals(experiments, simulated, pictures)]),
        ("responses", "Frequency responses", _responses(responses, pictures)),
        ("residuals", "Residual tests", findings.residual_tests(fingerprint, pictures)),
        ("quality", "Log quality", fate.log_quality(experiments)),
        ("settings", "Settings and versions", _settings(fingerprint)),
    ]
    made = [(anchor, name, [part for part in parts if part]) for anchor, name, parts in contents]
    sections = [section for section in made if section[2]]
    ship = f"{fingerprint.vessel or 'ship not named'}, structure “{fingerprint.structure.get('name', '')}”"
    scripts = [_resource("sort.js"), _resource("zoom.js")]
    # Whatever slipped through the escaping could neither run nor call anyone.
    allowed = " ".join(f"'sha256-{_digest(script)}'" for script in scripts)
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src {allowed}"
    return (
        environment()
        .get_template("report.html")
        .render(
            title=title,
            ship=ship,
            policy=Markup(policy),
            style=Markup(_resource("page.css")),
            scripts=[Markup(script) for script in scripts],
            sections=sections,
        )
    )


def _resource(name: str) -> str:
    return resources.files("shipfp_rs.report").joinpath(name).read_text(encoding="utf-8")


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def _signals(
    experiments: Sequence[Experiment], simulated: Sequence[Mapping[str, Any]], pictures: Pictures
) -> Iterable[str]:
    for index, (experiment, chart) in enumerate(
        zip(experiments, charts(experiments, simulated), strict=True)
    ):
        yield markup.piece("heading", experiment.name)
        yield chart
        if index >= STILL_PICTURES:
            continue
        if simulated and simulated[index]:
            still = pictures.draw(
                len(simulated[index]),
                partial(plot.fit, experiment, simulated[index]),
                f"{experiment.name}: measured signals and what the fitted model makes of the same set point.",
            )
        else:
            still = pictures.draw(
                len(plot.signals.units(experiment)),
                partial(plot.time_series, experiment),
                f"{experiment.name}: signals; masked samples, marked at the bottom, are not fitted.",
            )
        yield markup.piece("unscripted", still)


def _responses(responses: Responses, pictures: Pictures) -> Iterable[str]:
    for measured, model in responses:
        yield pictures.draw(
            2,
            partial(plot.bode, measured, model),
            f"{measured.name}: measured response to the set point with bars of two standard deviations, and the "
            "fitted model's.",
            height=2.2,
        )


def _settings(fingerprint: Fingerprint) -> Iterable[str]:
    yield markup.table(
        "versions of the software that made this page",
        ["software", "version"],
        [[markup.Cell(name), markup.Cell(version)] for name, version in fingerprint.versions.items()],
    )
    content = {
        "structure": fingerprint.structure,
        "settings": fingerprint.settings,
        "seed": fingerprint.seed,
    }
    yield markup.details("Structure, settings and seed", markup.piece("preformatted", _outline(content)))


def _outline(content: Mapping[str, Any], indent: str = "") -> str:
    """Write nested settings one a line; what is not a table of its own stays on its line."""
    lines = []
    for key, value in content.items():
        if isinstance(value, Mapping) and any(isinstance(entry, Mapping) for entry in value.values()):
            lines += [f"{indent}{key}:", _outline(value, indent + "  ")]
        elif not indent and isinstance(value, Mapping):
            lines += [f"{key}:", _outline(value, "  ")]
        else:
            lines.append(f"{indent}{key}: {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(lines)
