"""Writes report.html: one self-contained page with the results, their intervals, and the treatment of the data."""

from __future__ import annotations

import base64
import hashlib
import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, TypedDict, Unpack

from markupsafe import Markup

from shipfp_rs import plot
from shipfp_rs.assessment.comparison import compared_responses
from shipfp_rs.assessment.validation import HeldOut
from shipfp_rs.errors import SimulationError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.estimate import rounded_rows
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.ship_estimates import FULL_SHIP
from shipfp_rs.identification.whole_ship import whole_ship
from shipfp_rs.plot.frequency import windows
from shipfp_rs.plot.traces import units
from shipfp_rs.report import answer, fate, findings, loop, markup, operating
from shipfp_rs.report.markup import Say
from shipfp_rs.report.operating import facts
from shipfp_rs.report.pictures import Pictures, charts, of_the_tachometer
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.files import write_text_atomically
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.tables import environment
from shipfp_rs.support.units import unit_shown
from shipfp_rs.vessel.vessel import Vessel

__all__ = ["render", "write_report"]

LOGGER = logging.getLogger("shipfp_rs")

Responses = Sequence[tuple[FrequencyResponse, FrequencyResponse]]

Also = tuple[str, str, Fingerprint, Responses]
"""Another fit to show at the end: heading, sentence, fingerprint, and pairs of measured and modelled responses."""

STILL_PICTURES = 1
"""Number of experiments with a static picture, for readers without JavaScript. One picture takes half the page's time.
"""


class Content(TypedDict, total=False):
    """Optional content of a report besides a fingerprint and its experiments; see `write_report`."""

    simulated: Sequence[Experiment]
    responses: Responses
    also: Also | None
    truth: Mapping[str, float] | None
    title: str
    language: str
    structure: Structure | None
    vessel: Vessel | None
    held_out: Sequence[HeldOut]


def write_report(
    path: str | Path,
    fingerprint: Fingerprint,
    experiments: Sequence[Experiment] | None = None,
    **content: Unpack[Content],
) -> Path:
    """Write the report of a fingerprint; the file is written atomically.

    The page is self-contained. Its content security policy allows only its own scripts and no requests, so text from
    a log can't run as a script. For an 8 h log it is smaller than 10 MB.

    Parameters
    ----------
    path
        File to write.
    fingerprint
        The result.
    experiments
        Experiments of the fit. None: the experiments and the model's outputs stored in the fingerprint.
    simulated
        The fitted model's outputs for each experiment, from `Fingerprint.predict`; may be empty.
    responses
        Pairs of measured and modelled responses for Bode plots, from `assessment.compared_responses`.
    also
        Another fit to show beside this one.
    truth
        True values by name, for simulated logs.
    title
        Headline.
    language
        One of `shipfp_rs.support.sentences.LANGUAGES`.
    structure
        Structure of the fingerprint, needed if the user wrote its equations; None: rebuilt from the fingerprint.
    vessel
        The trial's vessel, for its gear ratio and its kind of load.
    held_out
        Experiments that were not fitted, with their predictions.

    Returns
    -------
    Path
        `path`.
    """
    if experiments is None:
        experiments, structure = fingerprint.experiments, content.get("structure")
        content.setdefault("simulated", _simulated(fingerprint, experiments, structure))
        content.setdefault("responses", compared_responses(fingerprint, experiments, structure))
    return write_text_atomically(Path(path), render(fingerprint, experiments, **content))


def _simulated(
    fingerprint: Fingerprint, experiments: Sequence[Experiment], structure: Structure | None
) -> list[Experiment]:
    """Outputs of the fitted model; empty if the model diverges for any experiment."""
    try:
        return [fingerprint.predict(one, structure) for one in experiments]
    except SimulationError as error:
        LOGGER.warning("no simulation in the report: %s", error)
        return []


def render(
    fingerprint: Fingerprint,
    experiments: Sequence[Experiment],
    *,
    simulated: Sequence[Experiment] = (),
    responses: Responses = (),
    also: Also | None = None,
    truth: Mapping[str, float] | None = None,
    title: str = "Fingerprint",
    language: str = "en",
    structure: Structure | None = None,
    vessel: Vessel | None = None,
    held_out: Sequence[HeldOut] = (),
) -> str:
    """Page of `write_report` as a string."""
    say = Say(language)
    pictures = Pictures(say)
    figures = loop.figures(fingerprint, structure)
    whole = whole_ship(fingerprint)
    if fingerprint.engine_described:
        beside = loop.step_response(
            whole, structure if whole is fingerprint else None, figures, pictures, say
        )
    else:  # the package refuses to advise on gains; the picture shows why
        beside = operating.beyond(fingerprint, pictures, say)
    top = facts(fingerprint, experiments, vessel, say)
    contents: list[tuple[str, str, Iterable[str]]] = [
        (
            "answer",
            "",
            answer.answer(fingerprint, experiments, simulated, figures, beside, pictures, say, top),
        ),
        ("parameters", say("Parameters"), findings.parameters(fingerprint, truth, pictures, say)),
        ("elements", say("Elements of the model"), findings.elements(fingerprint, say)),
        ("sides", say("Load and drive, each by itself"), operating.section(fingerprint, pictures, say)),
        (
            "loop",
            say("The speed loop"),
            [*loop.section(fingerprint, figures, say), *loop.steps(experiments, say)],
        ),
        ("signals", say("Signals and model"), _signals(experiments, simulated, pictures, say)),
        ("held-out", say("Windows held out"), _held_out(held_out, pictures, say)),
        ("responses", say("Frequency responses"), _responses(responses, pictures, say)),
        ("also", say(also[0]) if also else "", _also(also, pictures, say)),
        (
            "samples",
            say("Samples used and left out"),
            fate.of_every_sample(fingerprint, [*experiments, *(one.measured for one in held_out)], say),
        ),
        (
            "quality",
            say("Log quality"),
            _folded(say("Sensors and how the signals were made"), fate.log_quality(experiments, say)),
        ),
        (
            "statistics",
            say("Statistics"),
            _folded(
                say("Verdict in full, fits, residual tests"), findings.statistics(fingerprint, pictures, say)
            ),
        ),
        ("settings", say("Settings and versions"), _settings(fingerprint, say)),
    ]
    made = [(anchor, name, [part for part in parts if part]) for anchor, name, parts in contents]
    sections = [section for section in made if section[2]]
    ship = say(
        "{vessel}; model: {name}",
        vessel=fingerprint.vessel or say("drive train not named"),
        name=_structure_name(fingerprint, say),
    )
    return say.cells(_page(title, ship, sections, say))


def _page(title: str, ship: str, sections: Sequence[tuple[str, str, Sequence[str]]], say: Say) -> str:
    """Page with its sections, its scripts, and a policy that permits no other scripts."""
    scripts = [_resource(name) for name in ("sort.js", "save.js", "zoom.js")]
    # With this policy, text from a log can't run scripts or send requests, even if escaping fails.
    digests = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src {allowed}"
    return (
        environment()
        .get_template("report.html")
        .render(
            language=say.language,
            title=title,
            ship=ship,
            skip=say("Skip to the parameters"),
            contents=say("Contents"),
            policy=Markup(policy),
            style=Markup(_resource("page.css")),
            scripts=[Markup(script) for script in scripts],
            sections=sections,
        )
    )


def _structure_name(fingerprint: Fingerprint, say: Say) -> str:
    """Name of a structure in the report's language; the name of a ship's structure lists the elements of its drive train."""
    if fingerprint.settings.get("structure") == FULL_SHIP:
        return say("the whole drive train")
    name = str(fingerprint.structure.get("name", ""))
    kind, _, elements = name.partition(": ")
    if kind != "ship":
        return say(name)
    if not elements:
        return say("drive train without further elements")
    named = ", ".join(say(element) for element in elements.split(", "))
    return say("drive train with {elements}", elements=named)


def _folded(summary: str, parts: Iterable[str]) -> Iterable[str]:
    """Yield the given elements in a collapsible section; nothing without elements."""
    content = Markup("\n").join(part for part in parts if part)
    if content:
        yield markup.details(summary, content)


def _resource(name: str) -> str:
    return resources.files("shipfp_rs.report").joinpath(name).read_text(encoding="utf-8")


def _signals(
    experiments: Sequence[Experiment], simulated: Sequence[Experiment], pictures: Pictures, say: Say
) -> Iterable[str]:
    for index, (experiment, chart) in enumerate(
        zip(experiments, charts(experiments, simulated, say), strict=True)
    ):
        driver = answer.driver_of(experiment)
        name = say.called(experiment.name, experiment.kind, driver)
        yield markup.piece("heading", name)
        yield chart
        if simulated and (said := of_the_tachometer(experiment, simulated[index].outputs, say)):
            yield markup.paragraph(said)
        if index >= STILL_PICTURES:
            continue
        if simulated:
            panels, paint = len(simulated[index].outputs), partial(plot.fit, experiment, simulated[index])
            said = Sentence("{name}: measured signals, and the model's answer to the same {driver}.")
        else:
            panels, paint = len(units(experiment)), partial(plot.signals, experiment)
            said = Sentence("{name}: signals; masked samples, marked at the bottom, are not fitted.")
        still = pictures.draw(panels, paint, say(said, name=name, driver=driver), saved=False)
        yield markup.piece("unscripted", still)


def _held_out(held_out: Sequence[HeldOut], pictures: Pictures, say: Say) -> Iterable[str]:
    """Yield the predictions of the experiments that were not fitted."""
    if not held_out:
        return
    yield markup.paragraph(
        say("These windows were not fitted. The fit predicts them; a good one has 95 % in its band.")
    )
    rows: list[markup.Row] = []
    for one in held_out:
        for output, row in one.score.items():
            figures = [markup.number(f"{value:.4g}") for value in row.values() if value is not None]
            rows.append([one.measured.name, markup.Cell(output, code=True), *figures])
    head = say.each("experiment", "output", "predicted [%]", "samples in the band [%]")
    yield markup.table(say("prediction of the windows held out"), head, rows)
    for one in held_out:
        said = say("{name}, held out: what the prediction misses, and its 95 % band.", name=one.measured.name)
        yield pictures.draw(len(one.band), partial(plot.held_out, one), said, saved=False)


def _responses(responses: Responses, pictures: Pictures, say: Say) -> Iterable[str]:
    if responses:
        yield pictures.draw(
            2,
            partial(windows, responses),
            say(
                "{name}: measured response to the set point with bars of two standard deviations, and the fitted "
                "model's.",
                name=", ".join(measured.name for measured, _ in responses),
            ),
            height=2.6,
        )


def _also(also: Also | None, pictures: Pictures, say: Say) -> Iterable[str]:
    """Yield the results of another fit: estimates with an interval, and frequency responses."""
    if also is None:
        return
    _, sentence, fingerprint, pairs = also
    yield markup.paragraph(say(sentence))
    yield from _responses(pairs, pictures, say)
    rows: list[markup.Row] = []
    for row in rounded_rows({**fingerprint.parameters, **fingerprint.derived}):
        figures = (markup.number(row.value), markup.number(operating.ends(row, say)), unit_shown(row.unit))
        if row.low:
            rows.append([markup.Cell(row.name, code=True), say.name(row.name), *figures])
    head = say.each("symbol", "name", "estimate", "95 % interval", "unit")
    yield markup.table(say(also[0]), head, rows)


def _settings(fingerprint: Fingerprint, say: Say) -> Iterable[str]:
    yield markup.table(
        say("versions of the software that made this page"),
        [say("software"), say("version")],
        [[name, version] for name, version in fingerprint.versions.items()],
    )
    content = {"structure": fingerprint.structure, "settings": fingerprint.settings, "seed": fingerprint.seed}
    yield markup.details(
        say("Structure, settings and seed"), markup.piece("preformatted", _outline(content)), printed=False
    )


def _outline(content: Mapping[str, Any], indent: str = "") -> str:
    """Format nested settings, one per line; inner values stay on one line."""
    lines = []
    for key, value in content.items():
        if isinstance(value, Mapping) and any(isinstance(entry, Mapping) for entry in value.values()):
            lines += [f"{indent}{key}:", _outline(value, indent + "  ")]
        elif not indent and isinstance(value, Mapping):
            lines += [f"{key}:", _outline(value, "  ")]
        else:
            lines.append(f"{indent}{key}: {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(lines)
