"""First screen of the report: verdict, tables of ship and speed loop, and one picture of model and measurement."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from shipfp_rs import plot
from shipfp_rs.assessment.si import QUANTITIES
from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.identification.estimate import (
    ALONG,
    KNOWN,
    OPEN,
    Estimate,
    Row,
    is_rough,
    roughness,
    rounded_rows,
)
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.inertias import operating_point
from shipfp_rs.identification.ship_found import BELIEVED
from shipfp_rs.identification.whole_ship import whole_ship
from shipfp_rs.identification.wording import DOUBT
from shipfp_rs.plot.style import COLOURS, LABELS, dress, envelope
from shipfp_rs.report.markup import Say, piece
from shipfp_rs.report.pictures import NARROW, Pictures, columns_csv
from shipfp_rs.structures.elements import LAGS, LATE_CHANNELS
from shipfp_rs.structures.names import OF_WHAT, as_looked_at
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.sentences import Sentence, joined
from shipfp_rs.support.units import unit_shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COMPARISON = Sentence(
    "Comparison: this fingerprint against earlier or later ones of the same drive train, to see what has changed."
)
SHOWN_S = (8.0, 30.0)
"""Shortest and longest stretch of the picture [s]; the stretch is a twentieth of the record within these limits."""
TONES: Mapping[str, str] = {"usable": "good", "usable except": "warn", "not usable": "bad"}
"""Colour of the verdict's first sentence, by usability."""
KNOWN_WELL = 0.2
"""Largest relative half-width of an interval shown in green."""
OPEN_ABOVE = 3.0
"""Ratio of an interval's upper end to the value, above which only the lower end is shown."""
RELATED = 0.9
"""Correlation above which the report states that knowing one parameter would narrow the other's interval."""
AT_AN_END = 0.05
"""Distance from an interval's end, as a fraction of its width, within which an estimate counts as at that end."""
AT_REST = 1e-4
"""Largest standard deviation of a constant set point, relative to the operating speed."""
CHANNELS = (*LATE_CHANNELS, "T_0")
"""Parameters of the measurement, not of the ship."""
WORTH = ("bandwidth", "phase margin", "gain margin", "recovery time")
DELAYS = (*LAGS, "T_s")
"""Parameters that may be zero, for which the data give only an upper limit."""
NONE = 0.02
"""Fraction of a delay's upper limit below which its lower limit counts as zero."""


def answer(
    fingerprint: Fingerprint,
    experiments: Sequence[Experiment],
    simulated: Sequence[Experiment],
    loop: Mapping[str, Estimate],
    beside: str,
    pictures: Pictures,
    say: Say,
    top: Sequence[tuple[str, str, str, str, str]] = (),
) -> Iterable[str]:
    """Yield the verdict's first sentence, tables of ship and loop beside the pictures, and undetermined parameters."""
    lead = _with_names(fingerprint.usable, fingerprint.parameters, say)
    if not lead and fingerprint.verdict:
        lead = say(fingerprint.verdict[0])
    failed = fingerprint.usability == "not usable"
    tone = TONES.get(fingerprint.usability, "")
    if tone == "good" and any(is_rough(one, KNOWN_WELL) for one in fingerprint.parameters.values()):
        tone = "warn"
    yield piece("lead", lead or say("No verdict was given."), tone)
    if fingerprint.usability in TONES and not failed:
        yield piece("paragraph", say(COMPARISON), "note")
    heading = (
        say("Figures of the model, not to be used") if failed else say("The drive train, with 95 % intervals")
    )
    # If the search found no minimum, there are no results to show, not even for the model.
    told = fingerprint.why_not != "no minimum"
    tables = (
        [piece("facts", heading, [*top, *ship_rows(whole_ship(fingerprint), say)], failed)] if told else []
    )
    # The loop is omitted for a failed fit: a reader would mistake the model's loop for the ship's.
    if loop and not failed:
        rows = loop_rows(loop, say, of_ship=not whole_ship(fingerprint).ends_at_meter)
        tables.append(piece("facts", say("What it means for the speed loop"), rows, False))
    drawn = [_picture(experiments, simulated, pictures, say), "" if failed else beside]
    if not fingerprint.engine_described:  # the picture of why gains are refused comes first
        drawn.reverse()
    columns = [Markup("\n").join(part for part in parts if part) for parts in (tables, drawn)]
    yield piece("columns", [column for column in columns if column])
    doubts = [say(line) for line in fingerprint.verdict if DOUBT in line]
    for line in (
        *doubts,
        *next_steps(fingerprint, say),
        *acting(fingerprint, say),
        *open_questions(fingerprint, say),
    ):
        yield piece("paragraph", line, "open")


def next_steps(fingerprint: Fingerprint, say: Say) -> list[str]:
    """Advice on a fingerprint that is unusable, or whose intervals hold only for the model; empty for any other."""
    # If the intervals hold only for the model, the advice lists possible causes instead of missing data.
    bent = not fingerprint.adequate.get("stands", True) or "hold for the model" in fingerprint.usable
    if not fingerprint.why_not and not fingerprint.engine_described:
        return [
            say(
                "What drive and governor do beyond the model is drawn beside the figures. "
                "Gains need a structure of your own that has it."
            )
        ]
    if not fingerprint.why_not and not bent:
        return []
    part = say(
        "Possible causes, in the order in which to look: sensors (a channel from another recording, the side of the shaft "
        "that a gauge is on, scale, offset, delay), actuation (dead time, lag, limits), then gains that change, "
        "or a load that the model lacks."
    )
    more = say(
        "What would help: a longer recording, a larger swing of the set point, a torque channel, or a parameter known "
        "from elsewhere."
    )
    if fingerprint.why_not == "nothing told":
        return [more]
    if fingerprint.why_not == "no minimum":
        return [f"{part} {more}"]
    return [part]


def acting(fingerprint: Fingerprint, say: Say) -> list[str]:
    """Sentences on the elements that act, may act, or were not found; empty for an unusable fingerprint."""
    if fingerprint.why_not:
        return []
    named: dict[str, list[str]] = {"on": [], "open": [], "off": []}
    fit_along = all(
        (row["evidence"] or 0.0) <= BELIEVED
        for row in fingerprint.elements.values()
        if row["state"] == "open"
    )
    for row in fingerprint.elements.values():
        named[row["state"]].append(say(row["words"]))
    sentences = {
        "on": say("Elements that act: {names}.", names=", ".join(named["on"])),
        "open": say(
            "Elements that may act or not: {names}. The intervals cover both cases.",
            names=", ".join(named["open"]),
        )
        if fit_along
        else say("Elements that may act or not: {names}.", names=", ".join(named["open"])),
        "off": say("Elements absent, or too weak to show: {names}.", names=", ".join(named["off"])),
    }
    told = [sentence for state, sentence in sentences.items() if named[state]]
    return [" ".join(told)] if told else []


def interval(row: Row, estimate: Estimate, say: Say, *, with_end: bool = True) -> str:
    """Format an interval, with a remark if the estimate is at its end; an estimate on a bound shows only the other end."""
    if estimate.ci95 is None:
        return ""
    if estimate.ci95[1] == np.inf:
        return say.number(f"≥ {row.low}")
    if estimate.status == "at_bound" and estimate.value is not None:
        below, above = estimate.value - estimate.ci95[0], estimate.ci95[1] - estimate.value
        return say.number(f"≤ {row.high}" if above >= below else f"≥ {row.low}")
    told = say("{low} to {high}", low=row.low, high=row.high)
    end = at_an_end(estimate, say) if with_end else ""
    return f"{told}, {end}" if end else told


def at_an_end(estimate: Estimate, say: Say) -> str:
    """Remark that an estimate lies at an end of its interval, since a reader may take this for a mistake."""
    if estimate.value is None or estimate.ci95 is None:
        return ""
    low, high = estimate.ci95
    share = (estimate.value - low) / (high - low) if low < high < np.inf else 0.5
    if AT_AN_END <= share <= 1.0 - AT_AN_END:
        return ""
    return say("estimate at its lower end") if share < 0.5 else say("estimate at its upper end")


def ship_rows(fingerprint: Fingerprint, say: Say) -> list[tuple[str, str, str, str, str]]:
    """Name, symbol, value, interval and value in other units of each parameter; SI units first if the vessel is known."""
    rows = []
    known = dict(fingerprint.parameters)
    if any(estimate.value is None or is_rough(estimate, OPEN) for estimate in known.values()):
        known |= fingerprint.derived
    for row in rounded_rows(known):
        untold = (
            not fingerprint.engine_described and not row.value
        )  # the report's first sentence gives the reason
        if row.name in CHANNELS or row.status == ALONG or untold:
            continue
        value, told = _value_and_interval(row, known[row.name], "\u00a0", say)
        name = say.name(row.name)
        quantity = fingerprint.si.get(QUANTITIES.get(row.name, ("",))[0])
        if (
            quantity is None
            or "seen_from" in quantity
            or not row.value
            or quantity["unit"] in ("-", row.unit)
        ):
            more = of_what(row.name, known[row.name].value, fingerprint, say) if row.value else ""
            rows.append((name or row.name, row.name if name else "", value, told, more))
            continue
        inertia = name
        if row.name in ("tau_n", "tau_prop"):
            inertia = say("{inertia}, seen from the load shaft", inertia=short_name(row.name, say))
        # The remark on an estimate at the end of its interval appears only beside the interval in SI units.
        none = may_be_zero(row, known[row.name])
        alone = told if none else interval(row, known[row.name], say, with_end=False)
        normalised = f"{say('normalised')}: {row.name} {value if none else f'= {value}'}"
        normalised += f" ({alone})" if alone else ""
        rows.append((inertia, "", *_in_si(known[row.name], quantity, say), normalised))
    return rows


def _in_si(estimate: Estimate, quantity: Mapping[str, Any], say: Say) -> tuple[str, str]:
    """Value of a quantity with its SI unit, and its interval."""
    ends = quantity["ci95"]
    told = replace(
        estimate, value=quantity["value"], std=quantity["std"], ci95=None if ends is None else tuple(ends)
    )
    (row,) = rounded_rows({"": replace(told, unit=quantity["unit"])})
    # The space may break: if value and unit do not fit on one line, the whole unit moves to the next line.
    return _value_and_interval(row, told, " ", say)


def _value_and_interval(row: Row, estimate: Estimate, gap: str, say: Say) -> tuple[str, str]:
    """Value with its unit, and its interval; for a value that may be zero, the upper limit instead."""
    unit = unit_shown(row.unit).replace(" ", "\u00a0")
    if not row.value:
        return say(row.status), ""
    if may_be_zero(row, estimate):
        return f"{say('at most {high}', high=row.high)}{gap}{unit}".strip(), say("may be zero")
    return f"{say.number(row.value)}{gap}{unit}".strip(), interval(row, estimate, say) or say(row.status)


def may_be_zero(row: Row, estimate: Estimate) -> bool:
    """Whether the data give only an upper limit: a delay that may be zero, or a value that rounds to zero."""
    if estimate.ci95 is None or not 0.0 < estimate.ci95[1] < np.inf:
        return False
    low, high = estimate.ci95
    if row.name in DELAYS:
        return low < NONE * high
    return low >= 0.0 and float(row.value) == 0.0


def loop_rows(
    loop: Mapping[str, Estimate], say: Say, *, of_ship: bool = True
) -> list[tuple[str, str, str, str, str]]:
    """Name, no symbol, value, interval and meaning of the loop's main figures; without `of_ship`, of the unloaded drive."""
    meanings = {
        "bandwidth": say("up to this frequency the speed follows the set point"),
        "phase margin": _damped(loop["phase margin"].value, say) if of_ship else say("of the drive alone"),
        "gain margin": say("factor on the gains at which the loop begins to oscillate")
        if loop["gain margin"].value is not None
        else say("no gain was found at which the loop oscillates"),
        "recovery time": say("after a step of the set point, until the speed stays within 5 % of it"),
    }
    rows = []
    for row in rounded_rows({name: loop[name] for name in WORTH if name in loop}):
        estimate = loop[row.name]
        value, told = say.number(row.value), interval(row, estimate, say)
        if row.value and told and is_rough(estimate, KNOWN_WELL):
            # The interval replaces a rough value, which a reader would take for an accurate one.
            value, told = interval(row, estimate, say, with_end=False), say("known only roughly")
            if estimate.ci95 is not None and estimate.ci95[1] > OPEN_ABOVE * abs(estimate.value or 0.0):
                value = say("at least {low}", low=say.number(f"{estimate.ci95[0]:.2g}"))
        value = f"{value}\u00a0{unit_shown(row.unit)}".strip().replace("\u00a0°", "°")
        value = value if row.value else say("none")
        if row.value and row.name == "gain margin":
            value = say("{factor} times", factor=value.strip())
        if not row.value and row.name == "gain margin" and estimate.reason == "there is none":
            value = say("no limit")
        rows.append((say(row.name), "", value, told, meanings[row.name]))
    return rows


def _damped(margin: float | None, say: Say) -> str:
    if margin is None:
        return ""
    if margin >= 60.0:
        return say("well damped")
    return say("lively") if margin >= 30.0 else say("close to oscillation")


def _told_of(fingerprint: Fingerprint) -> dict[str, Estimate]:
    """Parameters included in the report."""
    described = fingerprint.engine_described  # if not, the report's first sentence names the missing data
    return {name: one for name, one in fingerprint.parameters.items() if described or one.value is not None}


def undetermined(fingerprint: Fingerprint) -> list[str]:
    """Names of undetermined parameters, the most important to an engineer first."""
    return as_looked_at(
        name
        for name, estimate in _told_of(fingerprint).items()
        if (estimate.status in ("unidentifiable", "at_bound") and estimate.ci95 is None)
        or is_rough(estimate, OPEN)
    )


def of_what(name: str, value: float | None, fingerprint: Fingerprint, say: Say) -> str:
    """Words for the reference of a dimensionless parameter; for M_max with the operating torque, if known."""
    point = operating_point(fingerprint)
    if name != "M_max" or point is None or value is None:
        return say(OF_WHAT.get(name, ""))
    return say("times the operating torque ({torque} Nm)", torque=f"{value * abs(point[1]):.4g}")


def open_questions(fingerprint: Fingerprint, say: Say) -> list[str]:
    """A line for each undetermined or roughly known parameter, with a remedy; empty for an unusable model."""
    if fingerprint.why_not not in ("", "nothing told"):
        return []
    estimates, unknown = _told_of(fingerprint), undetermined(fingerprint)
    rough = as_looked_at(
        name
        for name, estimate in estimates.items()
        if estimate.status in KNOWN and is_rough(estimate) and name not in unknown
    )
    rough = sorted(rough, key=lambda name: -roughness(estimates[name]))
    lines = []
    if unknown:
        closing = fingerprint.identifiability.closes_gap
        settled = say(
            "One of these would settle it, known from elsewhere (torsional calculation, factory test): {names}."
        )
        told = (
            settled.format(names=_listed(closing, say))
            if closing
            else _sharpened(fingerprint, [*unknown, *rough], say)
            or say("More excitation or another signal may help.")
        )
        lines.append(say("Not determined by the data: {names}.", names=_listed(unknown, say)) + " " + told)
    if rough:
        sharpened = "" if unknown else _sharpened(fingerprint, rough, say)
        said = say("Known only roughly, the worst first: {names}.", names=_listed(rough, say))
        lines.append(f"{said} {sharpened}".strip())
    return lines


def _sharpened(fingerprint: Fingerprint, names: Sequence[str], say: Say) -> str:
    """Sentence on how far the interval would shrink if its most correlated parameter were known; empty below `RELATED`."""
    related = fingerprint.correlations
    pairs = [
        (abs(related.get(one, {}).get(other, 0.0)), one, other)
        for one in names
        for other in related
        if other != one and other not in CHANNELS
    ]
    strength, one, other = max(pairs, default=(0.0, "", ""))
    if not RELATED < strength < 1.0:
        return ""
    return say(
        "If the {other} were known from elsewhere, the interval of the {one} would shrink to {share} % of its width.",
        one=f"{short_name(one, say)} ({one})",
        other=f"{short_name(other, say)} ({other})",
        share=f"{100.0 * np.sqrt(1.0 - strength**2):.2g}",
    )


def short_name(symbol: str, say: Say) -> str:
    """Name of a parameter in a sentence: for an inertia time constant the rotating part, else the plain name."""
    turning = {"tau_n": say("inertia of the drive train"), "tau_prop": say("inertia behind the torque gauge")}
    return turning.get(symbol) or say.name(symbol) or symbol


def _with_names(sentence: str, symbols: Container[str], say: Say) -> str:
    """Replace the given symbols in a sentence by plain names."""

    def named(value: str) -> str:
        return say("the {name}", name=short_name(value, say)) if value in symbols else say.figure(value)

    return say.told(sentence, named)


def _listed(symbols: Iterable[str], say: Say) -> str:
    def named(symbol: str) -> str:
        return f"{short_name(symbol, say)} ({symbol})"

    return say.told(joined([*symbols]), named)


def _picture(
    experiments: Sequence[Experiment], simulated: Sequence[Experiment], pictures: Pictures, say: Say
) -> str:
    """Draw measurement and model in the stretch of the first experiment where the speed varies most."""
    if not experiments or not simulated:
        return ""
    experiment, model = experiments[0], dict(list(simulated[0].outputs.items())[:2])
    stretch = _liveliest(experiment, next(iter(model.values())))
    loaded = "M_load" in experiment.signals

    def paint(axes: Sequence[Axes]) -> None:
        if loaded:
            _draw_load(axes[0], experiment, stretch)
        plot.fit(experiment, simulated[0], axes[loaded:], stretch_s=stretch, signals=[*model])

    return pictures.draw(
        len(model) + loaded,
        paint,
        say(
            "{name}, {start} to {stop} s: measurement, and the model's answer to the same {driver}. Shaded: 95 % of the "
            "measured samples lie this close to the model.",
            driver=driver_of(experiment),
            name=say.called(experiment.name, experiment.kind, driver_of(experiment)),
            start=f"{stretch[0]:.0f}",
            stop=f"{stretch[1]:.0f}",
        ),
        width=NARROW,
        height=2.1,
        table=_stretch_csv(experiment, model, stretch),
    )


def driver_of(experiment: Experiment) -> Sentence:
    """Input that excites the drive in an experiment: set point, load or both."""
    if "M_load" not in experiment.signals:
        return Sentence("set point")
    if "n_set" not in experiment.signals or float(np.nanstd(experiment.dn_set)) < AT_REST:
        return Sentence("load")
    return Sentence("set point and load")


def _draw_load(ax: Axes, experiment: Experiment, stretch: tuple[float, float]) -> None:
    rows = slice(*(round((edge - experiment.start_s) * experiment.rate_hz) for edge in stretch))
    load = experiment.signals["M_load"][rows]
    ax.plot(
        *envelope(experiment.start_s + experiment.time[rows], load),
        color=COLOURS["M_load"],
        lw=1.4,
        label="measured",
    )
    unit = experiment.unit("M_load")
    dress(ax, f"{LABELS['M_load']} [{unit}]" if unit else "load")


def _stretch_csv(experiment: Experiment, model: Mapping[str, Array], stretch: tuple[float, float]) -> str:
    """Measured and modelled signals of a stretch as CSV."""
    rows = slice(*(round((edge - experiment.start_s) * experiment.rate_hz) for edge in stretch))
    columns = {"time_s": experiment.start_s + experiment.time}
    for name in ("n_set", "M_load"):
        if name in experiment.signals:
            columns[f"{name}_{experiment.unit(name)}".rstrip("_")] = experiment.signals[name]
    for name, fitted in model.items():
        columns[f"{name}_{UNITS[name]}"] = experiment.signals[name]
        columns[f"{name}_model"] = fitted
    return columns_csv({name: column[rows] for name, column in columns.items()}, 7)


def _liveliest(experiment: Experiment, model: Array) -> tuple[float, float]:
    """Start and stop [s, log's clock] of the stretch where a model's output varies most."""
    shortest, longest = SHOWN_S
    length = min(max(experiment.duration / 20.0, shortest), longest, experiment.duration)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(model)))])
    begins = np.arange(0.0, experiment.duration - length + 1e-9, length / 4.0)
    rows = np.rint(begins * experiment.rate_hz).astype(np.intp)
    last = np.minimum(rows + round(length * experiment.rate_hz), len(way) - 1)
    begin = float(begins[int(np.argmax(way[last] - way[rows]))])
    return experiment.start_s + begin, experiment.start_s + begin + length
