"""Numerical results: parameters and combinations, and their statistics."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from shipfp_rs import plot
from shipfp_rs.identification import wording
from shipfp_rs.identification.estimate import OPEN, Estimate, is_rough, rounded_rows
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.fingerprint_content import ALARM
from shipfp_rs.identification.inertias import operating_point
from shipfp_rs.report.answer import at_an_end, interval, may_be_zero, of_what, undetermined
from shipfp_rs.report.markup import Cell, Row, Say, bullets, link, number, paragraph, piece, table
from shipfp_rs.report.pictures import NARROW, Pictures
from shipfp_rs.structures import glossary
from shipfp_rs.support.files import words_of
from shipfp_rs.support.sentences import Sentence
from shipfp_rs.support.units import unit_shown

TONES = {"on its bound": "warn", "not identifiable": "bad"}
FIGURES: Mapping[str, str] = words_of("report_words")["figures"]
"""Names of a fit's statistics in the report."""
UNEVEN = 1.5
"""Ratio of the longer to the shorter side of an interval from which the report explains the asymmetry."""
NORMALISED = ("g", "v", "K_p", "K_i", "vK_p", "vK_i")


STATES = {"on": "acts", "off": "not found to act", "open": "undecided"}
TONES_OF_STATES = {"on": "good", "off": "", "open": "warn"}


def parameters(
    fingerprint: Fingerprint, truth: Mapping[str, float] | None, pictures: Pictures, say: Say
) -> Iterable[str]:
    """Yield the tables of parameters and combinations and the picture of their intervals."""
    failed = bool(fingerprint.why_not)
    yield from not_to_be_used(fingerprint, say)
    about = say("parameters with their 95 % intervals")
    yield from _estimates(about, fingerprint, fingerprint.parameters, truth, say, formula=True, failed=failed)
    yield from _meanings(fingerprint, say)
    if fingerprint.derived:
        yield piece("heading", say("Combinations of parameters"))
        yield paragraph(
            say(
                "The data often determine a product, a ratio or a sum more closely than its single parameters."
            )
        )
        about = say("combinations with their 95 % intervals")
        yield from _estimates(about, fingerprint, fingerprint.derived, truth, say, failed=failed)
    text = fingerprint.to_csv()
    assert isinstance(text, str)
    yield link(say("These figures as CSV"), "fingerprint.csv", "text/csv", text.encode())
    drawn = [e for e in (*fingerprint.parameters.values(), *fingerprint.derived.values()) if e.ci95]
    # Intervals of an unusable model are omitted: a reader would mistake them for results.
    if drawn and not failed:
        reference = say("the truth that the log was simulated with") if truth else say("the estimate")
        caption = say("Estimates with their 95 % intervals, in per cent of {reference}.", reference=reference)
        caption += " " + say(
            "A value near zero is measured by what is small for a drive train: 0.05 s, or 0.5. Known well: half of the "
            "interval is at most 25 %, the grey band. Hardly known: more than 200 %. Beyond 1 % the axis is logarithmic. "
            "An arrow: the interval ends outside, at the figure beside it."
        )
        if any(map(_is_uneven, drawn)):
            caption += " " + say("Uneven intervals also cover other models that fit as well.")
        height = 0.3 + 0.3 * len(drawn)
        yield pictures.draw(
            1,
            lambda axes: plot.intervals(fingerprint, truth, axes[0]),
            caption,
            height=height,
            width=NARROW,
            table=text,
        )


def not_to_be_used(fingerprint: Fingerprint, say: Say) -> Iterable[str]:
    """Yield a warning above the numbers of an unusable fingerprint."""
    if fingerprint.why_not:
        yield paragraph(say("These figures are not to be used."), "bad")


def _is_uneven(estimate: Estimate) -> bool:
    if estimate.value is None or estimate.ci95 is None:
        return False
    below, above = estimate.value - estimate.ci95[0], estimate.ci95[1] - estimate.value
    return max(below, above) > UNEVEN * min(below, above)


def _meanings(fingerprint: Fingerprint, say: Say) -> Iterable[str]:
    """Yield the meaning of each symbol, and the normalisation of gains and slopes."""
    told = [f"{name}: {meaning}." for name in fingerprint.parameters if (meaning := say.meaning(name))]
    if not told:
        return
    yield piece("heading", say("What the symbols mean"))
    formulas = " ".join(glossary.term(name).formula for name in fingerprint.parameters)
    named = set(re.findall(r"[^\W\d]\w*", formulas))
    others = [
        f"{term.symbol}: {say(term.meaning)}" + (f" [{unit_shown(term.unit)}]" if term.unit != "-" else "")
        for term in glossary.FORMULAS
        if term.symbol in named
    ]
    notes = []
    if set(NORMALISED) & set(fingerprint.parameters):
        notes.append(
            say(
                "Gains and slopes are normalised: they relate changes in per cent of the value at the operating point."
            )
        )
        point = operating_point(fingerprint)
        if point is not None:
            speed_rpm, torque_Nm, _ = point
            notes.append(
                say(
                    "Operating point: {speed} rpm, measured torque {torque} Nm.",
                    speed=f"{speed_rpm:.4g}",
                    torque=f"{torque_Nm:.4g}",
                )
            )
    if "vK_p" in fingerprint.parameters:
        notes.append(
            say(
                "v is the per cent of drive torque that 1 % more actuator travel brings. From speed and torque follow only "
                "the products vK_p and vK_i with the governor's gains K_p and K_i; a channel of the actuator "
                "(X_f, the fuel rack of an engine) would give v."
            )
        )
    if notes:
        yield paragraph(" ".join(notes))
    yield bullets(told)
    if others:
        yield paragraph(f"{say('In the formulas')} – {'; '.join(others)}.")


def _estimates(
    about: str,
    fingerprint: Fingerprint,
    estimates: Mapping[str, Estimate],
    truth: Mapping[str, float] | None,
    say: Say,
    *,
    formula: bool = False,
    failed: bool = False,
) -> Iterable[str]:
    """Yield a table of estimates, followed by the reasons that apply to several of them."""
    value = say("value of the model") if failed else say("estimate")
    head = [*say.each("symbol", "name"), value, *say.each("std", "95 % interval", "unit")]
    head += [say("truth")] if truth else []
    head += [say("formula")] if formula else []
    head.append(say("status"))
    rows: list[Row] = []
    named: dict[str, list[str]] = {}
    for name, estimate in estimates.items():
        if estimate.status == "unidentifiable":
            named.setdefault(estimate.reason, []).append(name)
    shared = {why: names for why, names in named.items() if why and len(names) > 1 and not failed}
    for row in rounded_rows(estimates, truth):
        estimate = estimates[row.name]
        none = may_be_zero(row, estimate)
        cells: list[Cell | str] = [
            Cell(row.name, code=True),
            say.name(row.name),
            number(say("at most {high}", high=row.high) if none else row.value, key=estimate.value),
            number("" if none else row.std, key=estimate.std),
            number(
                say("may be zero") if none else interval(row, estimate, say, with_end=False),
                key=estimate.ci95 and estimate.ci95[1] - estimate.ci95[0],
            ),
            of_what(row.name, estimate.value, fingerprint, say) or unit_shown(row.unit),
        ]
        if truth:
            cells.append(
                number(f"{row.truth} ✗", "bad", key=truth.get(row.name))
                if row.holds_truth is False
                else number(row.truth, key=truth.get(row.name))
            )
        if formula:
            cells.append(Cell(glossary.term(row.name).formula, tone="note"))
        reason = row.reason not in ("", "given", row.status) and row.reason not in shared
        end = "" if none or row.status != "estimated" else at_an_end(estimate, say)
        told = say(row.status) + (f": {say(row.reason)}" if reason else "") + (f", {end}" if end else "")
        if failed and row.status != "given":
            told = say("not to be used")
        tone = "bad" if is_rough(estimate, OPEN) else "warn" if is_rough(estimate) else "good"
        tone = tone if row.status == "estimated" else TONES.get(row.status, "")
        if tone == "warn" and row.status == "estimated" and not failed:
            told += f", {say('known only roughly')}"
        cells.append(Cell(told, tone="" if failed else tone))
        rows.append(cells)
    yield table(about, head, rows)
    for why, names in shared.items():
        yield paragraph(say("{names}: {reason}.", names=", ".join(names), reason=why))


def elements(fingerprint: Fingerprint, say: Say) -> Iterable[str]:
    """Yield the table of elements."""
    if not fingerprint.elements:
        return
    yield from not_to_be_used(fingerprint, say)
    yield paragraph(
        say(
            "An element is a part of the model that may act or not, such as a dead time. It acts if its interval "
            "excludes zero. It is undecided if its interval holds both zero and values that would matter."
        )
    )
    rows: list[Row] = []
    for name, row in fingerprint.elements.items():
        found = Cell(
            say(STATES[row["state"]]), tone="" if fingerprint.why_not else TONES_OF_STATES[row["state"]]
        )
        # If the element made the fit worse, its gain is shown as zero.
        gain = "" if row["evidence"] is None else f"{max(row['evidence'], 0.0):.3g}"
        limit = _limit(name, row, fingerprint, say)
        rows.append([say(row["words"]), found, number(gain, key=row["evidence"]), limit])
    head = say.each("element", "found", "change of the deviance", "limit at 95 %")
    yield table(say("elements of the model"), head, rows)


def _limit(name: str, row: Mapping[str, Any], fingerprint: Fingerprint, say: Say) -> str:
    limit = row["limit"]
    if not limit:
        return ""
    side = say("above") if name == "torque_limit" else say("below")
    value = say.number(f"{limit['value']:.3g}")
    unit = of_what(limit["parameter"], limit["value"], fingerprint, say)
    return f"{limit['parameter']} {side} {value} {unit or unit_shown(limit['unit'])}".strip()


def statistics(fingerprint: Fingerprint, pictures: Pictures, say: Say) -> Iterable[str]:
    """Yield a collapsible section with the full verdict, rank, fits and residual tests."""
    if fingerprint.verdict:
        yield piece("heading", say("The verdict in full"))
        yield bullets(say(line) for line in fingerprint.verdict)
    yield piece("heading", say("How well the model follows"))
    yield from _fits(fingerprint, say)
    yield piece("heading", say("Identifiable parameters"))
    yield from _rank(fingerprint, say)
    yield from _correlations(fingerprint, say)
    yield piece("heading", say("What the residuals say"))
    yield from _residual_tests(fingerprint, pictures, say)


def _rank(fingerprint: Fingerprint, say: Say) -> Iterable[str]:
    found = fingerprint.identifiability
    unknown = undetermined(fingerprint)
    helped = [
        name for name, one in fingerprint.parameters.items() if one.status == "prior" and name not in unknown
    ]
    yield paragraph(say(wording.rank(found, unknown, helped)))
    if found.null_space:
        yield paragraph(
            say("The model's outputs stay the same when these change together, in the proportion given:")
        )
        yield bullets(say(entry["combination"]) for entry in found.null_space)
    if found.closes_gap:
        yield paragraph(say("Any one of these, known from elsewhere, would settle the rest:"))
        yield bullets(say(names) for names in found.closes_gap)


def _correlations(fingerprint: Fingerprint, say: Say) -> Iterable[str]:
    related = fingerprint.correlations
    if len(related) < 2:
        return
    yield piece("heading", say("Correlations of the parameters"))
    yield table(
        say("correlation of each two parameters"),
        [say("symbol"), *related],
        [
            [Cell(name, code=True), *(number(f"{value:.2f}", key=value) for value in row.values())]
            for name, row in related.items()
        ],
    )


def _fits(fingerprint: Fingerprint, say: Say) -> Iterable[str]:
    lines = [
        (str(record.get("name", "")), output, row)
        for record in fingerprint.data
        for output, row in record.get("fit", {}).items()
    ]
    lines += [(say("all data"), output, row) for output, row in fingerprint.fit.items() if "nrmse_pct" in row]
    if not lines:
        return
    for output, row in fingerprint.fit.items():
        if output != "overall" and row.get("nrmse_pct") is not None:
            yield paragraph(
                say(
                    "The model explains {share} % of the variation of the {output} (root mean square), noise included.",
                    share=f"{row['nrmse_pct']:.1f}",
                    output=say(wording.OUTPUTS.get(output, output)),
                )
            )
    rows: list[Row] = [
        [name, say(wording.OUTPUTS.get(output, output)), number(_two(row["nrmse_pct"]))]
        for name, output, row in lines
    ]
    yield table(
        say("fit of each output in each experiment"),
        [say("experiment"), say("output"), say("explained [%]")],
        rows,
    )
    overall = {key: value for key, value in fingerprint.fit.get("overall", {}).items() if value is not None}
    if overall:
        rows = [
            [Cell(say(FIGURES[key]) if key in FIGURES else key), number(f"{value:.6g}", key=value)]
            for key, value in overall.items()
            if key != "nrmse_pct"
        ]
        yield table(say("figures of all outputs together"), [say("figure"), say("value")], rows)


def _residual_tests(fingerprint: Fingerprint, pictures: Pictures, say: Say) -> Iterable[str]:
    tested = {
        output: row
        for output, row in fingerprint.fit.items()
        if "whiteness_p" in row or "input_correlation_p" in row
    }
    if not tested:
        yield paragraph(
            say(
                "No correlation tests: they are made only for given structures that are fitted to experiments."
            )
        )
        if missed := wording.missed(fingerprint.adequate):
            yield paragraph(say("Missed share of the drive train's response: {outputs}.", outputs=missed))
        return
    threshold = ALARM / len(tested)
    yield paragraph(
        say(
            "The residuals of a right model are noise. Residuals that follow the set point show that a dynamic "
            "part is missing. Whitened residuals that follow their own past show that the intervals may be too "
            "narrow (Ljung 1999, section 16.6). A test fails below p = {threshold}. On long records it also finds"
            " parts too small to matter: the share explained says how large they are.",
            threshold=f"{threshold:.2g}",
        )
    )
    rows: list[Row] = []
    passed = (say("independent of the set point"), say("white"))
    failed = (say("follows the set point"), say("coloured"))
    for output, row in tested.items():
        told = [row.get(name) for name in ("input_correlation_p", "whiteness_p")]
        by_set_point, white = map(partial(_tested, threshold), told, passed, failed)
        share = number(_two(row.get("input_explained_pct")))
        rows.append([say(wording.OUTPUTS.get(output, output)), *by_set_point, share, *white])
    head = say.each(
        "output", "set point, p", "verdict", "share of the residuals explained [%]", "whiteness, p", "verdict"
    )
    yield table(say("residual tests of each output"), head, rows)
    for output in fingerprint.residuals:
        yield _correlogram(fingerprint, output, pictures, say)


def _correlogram(fingerprint: Fingerprint, output: str, pictures: Pictures, say: Say) -> str:
    correlations = fingerprint.residuals[output]
    said = (
        Sentence(
            "Whitened residuals of the {output}: correlation with their own past, {own}, and with the set point, "
            "{by_set_point}. With noise alone one lag in twenty is outside the band."
        )
        if "autocorrelation" in correlations
        else Sentence(
            "Whitened residuals of the {output}: correlation with the set point, {by_set_point}. With noise alone"
            " one lag in twenty is outside the band."
        )
    )
    own = _outside(correlations["autocorrelation"], say) if "autocorrelation" in correlations else ""
    by_set_point = _outside(correlations["set_point"], say)
    return pictures.draw(
        len(correlations),
        partial(plot.correlogram, fingerprint, output),
        say(said, output=say(wording.OUTPUTS.get(output, output)), own=own, by_set_point=by_set_point),
        height=1.7,
        sharex=False,
    )


def _outside(test: Mapping[str, Sequence[float]], say: Say) -> str:
    count = sum(abs(size) > band for size, band in zip(test["correlation"], test["band"], strict=True))
    return say("{count} of {lags} lags outside the band", count=count or say("none"), lags=len(test["lags"]))


def _tested(threshold: float, p: float | None, passed: str, failed: str) -> tuple[Cell, Cell | str]:
    if p is None:
        return number(""), ""
    text = f"{p:.2g}" if p > 1e-6 else "< 1e-6"
    return number(text, key=p), Cell(passed, tone="good") if p >= threshold else Cell(failed, tone="warn")


def _two(value: Any) -> str:
    return "" if value is None else f"{value:.2f}"
