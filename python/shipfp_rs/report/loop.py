"""Speed loop at the estimate: step response, poles and margins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from shipfp_rs.assessment.closed_loop import closed_loop
from shipfp_rs.assessment.validation import measured_steps
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification import wording
from shipfp_rs.identification.estimate import Estimate, rounded_rows
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.plot.style import BLUE, GREY, ORANGE, SET_POINT, dress
from shipfp_rs.report.answer import at_an_end, interval
from shipfp_rs.report.markup import Cell, Row, Say, number, paragraph, piece, table
from shipfp_rs.report.pictures import NARROW, Pictures, columns_csv
from shipfp_rs.structures.elements import LATE_CHANNELS
from shipfp_rs.structures.linearised import loop_of, state_space
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.units import unit_shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INSTANTS = 400
LONGER = 2.5
"""Duration of the pictured step response, relative to the recovery time."""
PADE = 5
SHOWN = ("dn", "dM")
"""Outputs in the picture."""


def figures(fingerprint: Fingerprint, structure: Structure | None) -> Mapping[str, Estimate]:
    """Poles, margins and times of the loop; empty without a linearisation, or if the model does not describe the engine."""
    if "optimum" not in fingerprint.settings or not fingerprint.engine_described:
        return {}
    try:
        return closed_loop(fingerprint, structure)
    except InputError:
        return {}


def section(fingerprint: Fingerprint, loop: Mapping[str, Estimate], say: Say) -> Iterable[str]:
    """Yield the table of the loop's figures; empty for an unusable model."""
    if not loop or fingerprint.why_not:
        return
    yield paragraph(say("Computed from the model linearised about the operating point, for small motions."))
    loop = {name: scaled(one, 100.0, "%") if name == "overshoot" else one for name, one in loop.items()}
    rows: list[Row] = []
    for row in rounded_rows(loop):
        one = loop[row.name]
        figures = (number(row.value, key=one.value), number(interval(row, one, say, with_end=False)))
        note = Cell(say(row.reason) or at_an_end(one, say), tone="note")
        rows.append([say.name(row.name) or say(row.name), *figures, unit_shown(row.unit), note])
    head = say.each("figure", "estimate", "95 % interval", "unit", "note")
    yield table(say("poles, margins and gains of the loop"), head, rows)


def scaled(estimate: Estimate, factor: float, unit: str) -> Estimate:
    """Estimate in another unit."""
    value, std = (None if one is None else factor * one for one in (estimate.value, estimate.std))
    ends = None if estimate.ci95 is None else (factor * estimate.ci95[0], factor * estimate.ci95[1])
    return replace(estimate, value=value, std=std, ci95=ends, unit=unit)


def steps(experiments: Iterable[Experiment], say: Say) -> Iterable[str]:
    """Yield the table of measured load steps; empty if there are none."""
    experiments = list(experiments)
    rows: list[Row] = []
    for experiment in experiments:
        for one in measured_steps(experiment):
            at = f"{experiment.start_s + one.at_s:.1f}"
            figures = map(number, (at, f"{one.step:+.3g}", f"{one.deviation_pct:.2g}"))
            back = number(_recovered(one.recovery_s, say), key=one.recovery_s)
            rows.append([experiment.name, *figures, back])
    if rows:
        known = all(experiment.unit("M_load") for experiment in experiments)
        step = say("load step [Nm]" if known else "load step [unit of the load]")
        head = [*say.each("experiment", "at [s]"), step]
        head += say.each("speed deviates by [%]", "back within 2 % after [s]")
        yield piece("heading", say("Load steps as measured"))
        yield table(say("measured load steps"), head, rows)


def _recovered(seconds: float | None, say: Say) -> str:
    if seconds is None:
        return say("not before the next step or the end")
    return f"{seconds:.2g}" if seconds else say("never outside")


def step_response(
    fingerprint: Fingerprint,
    structure: Structure | None,
    loop: Mapping[str, Estimate],
    pictures: Pictures,
    say: Say,
) -> str:
    """Draw the loop's response to a step of the set point; empty for a loop that does not recover."""
    recovery = loop["recovery time"].value if loop else None
    if not recovery:
        return ""
    model = structure or Structure.from_dict(fingerprint.structure)
    times = np.linspace(0.0, LONGER * recovery, INSTANTS)
    rows = {name: row for name, row in _step(model, fingerprint.optimum, times).items() if name in SHOWN}
    return pictures.draw(
        len(rows),
        lambda axes: _draw(axes, times, rows, recovery, say),
        say(
            "The model's answer to a step of the set point by 1 %. Dashed: the set point. Dotted: from here on the speed "
            "stays within 5 % of the step."
        ),
        height=1.6,
        width=NARROW,
        table=columns_csv({"time_s": times, **{f"{output}_pct": row for output, row in rows.items()}}),
    )


def _step(structure: Structure, optimum: Mapping[str, float], times: Array) -> dict[str, Array]:
    """Outputs after a step of the set point at time 0; zero in the dead time, where the Pade approximation is not."""
    known = loop_of(structure, optimum)[1]
    space = state_space(structure, {**optimum, "T_set": 0.0, **dict.fromkeys(LATE_CHANNELS, 0.0)}, PADE)
    since = times - known.get("T_set", 0.0)
    rows = space.step(np.maximum(since, 0.0))
    rows[:, since < known.get("T_d", 0.0) + 0.5 * known.get("T_s", 0.0)] = 0.0
    return dict(zip(space.outputs, rows, strict=True))


def _draw(axes: Sequence[Axes], times: Array, rows: Mapping[str, Array], recovery: float, say: Say) -> None:
    for ax, (output, row) in zip(axes, rows.items(), strict=True):
        ax.plot(times, row, color=BLUE if output == "dn" else ORANGE, lw=1.6)
        if output == "dn":
            ax.axhline(1.0, color=SET_POINT, lw=1.0, ls="--")
            ax.axvline(recovery, color=GREY, lw=1.0, ls=":")
        dress(ax, f"{say(wording.OUTPUTS.get(output, output))} [%]", legend=False)
    axes[-1].set_xlabel(say("time [s]"))
    axes[-1].set_xlim(0.0, times[-1])
