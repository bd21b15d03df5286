"""What was found: verdict, parameters, what the data can tell, fits and residual tests."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from shipfp_rs import plot
from shipfp_rs.identification import wording
from shipfp_rs.identification.estimate import Estimate, Row, rounded_rows
from shipfp_rs.identification.fingerprint import ALARM, Fingerprint
from shipfp_rs.report.markup import Cell, bullets, number, paragraph, piece, table
from shipfp_rs.report.pictures import Pictures
from shipfp_rs.structures.glossary import meaning

TONES = {"estimated": "good", "on its bound": "warn", "not identifiable": "bad"}


def verdict(fingerprint: Fingerprint) -> Iterable[str]:
    """Yield the figures at a glance and the sentences of the verdict."""
    yield _glance(fingerprint)
    yield piece("verdict", [_led(line) for line in fingerprint.verdict or ("No verdict was given.",)])


def _led(line: str) -> tuple[str, str]:
    """Return what a sentence is about, its words before the colon, and the rest."""
    lead, colon, rest = line.partition(": ")
    return ("", line) if not colon or "'" in lead else (lead, rest)  # a colon may be part of a name


def _glance(fingerprint: Fingerprint) -> str:
    status = [estimate.status for estimate in fingerprint.parameters.values()]
    known = sum(
        e.status in ("free", "prior") and e.value is not None for e in fingerprint.parameters.values()
    )
    tiles = [
        ("known", str(known), "good"),
        ("known only together", str(len(fingerprint.derived)), ""),
        ("on a bound", str(status.count("at_bound")), "warn"),
        ("not identifiable", str(status.count("unidentifiable")), "bad"),
    ]
    for output, row in fingerprint.fit.items():
        value = row.get("nrmse_pct")
        if value is not None and output != "overall":
            tiles.append((f"fit of {wording.OUTPUTS.get(output, output)}", f"{value:.1f} %", ""))
    used = sum(int(record.get("used", 0)) for record in fingerprint.data)
    samples = sum(int(record.get("samples", 0)) for record in fingerprint.data)
    if samples:
        tiles.append(("samples fitted", f"{100.0 * used / samples:.3g} %", ""))
    return piece("glance", tiles)


def parameters(
    fingerprint: Fingerprint, truth: Mapping[str, float] | None, pictures: Pictures
) -> Iterable[str]:
    """Yield the tables of parameters and combinations and the picture of their intervals."""
    yield _estimates("parameters with their 95 % intervals", fingerprint.parameters, truth)
    if fingerprint.derived:
        yield piece("heading", "Combinations")
        yield paragraph("Known together, though their members are not known one by one.")
        yield _estimates("combinations with their 95 % intervals", fingerprint.derived, truth)
    caption = "Estimates with their 95 % intervals, in per cent of the " + (
        "true values that the log was simulated with; red where the interval does not hold the truth."
        if truth
        else "estimate."
    )
    drawn = [e for e in (*fingerprint.parameters.values(), *fingerprint.derived.values()) if e.ci95]
    if drawn:
        height = 0.4 + 0.25 * len(drawn)
        yield pictures.draw(
            1, lambda axes: plot.intervals(fingerprint, truth, axes[0]), caption, height=height
        )


def _estimates(about: str, estimates: Mapping[str, Estimate], truth: Mapping[str, float] | None) -> str:
    truths = ["truth"] if truth else []
    head = ["parameter", "status", "estimate", "std", "95 % interval", "unit", *truths, "meaning or reason"]
    rows = []
    for row in rounded_rows(estimates, truth):
        estimate = estimates[row.name]
        cells = [
            Cell(row.name, code=True),
            Cell(row.status, tone=TONES.get(row.status, "")),
            number(row.value, key=estimate.value),
            number(row.std, key=estimate.std),
            number(_interval(row, estimate), key=estimate.ci95 and estimate.ci95[1] - estimate.ci95[0]),
            Cell(row.unit),
        ]
        if truth:
            cells.append(
                number(row.truth, "bad" if row.holds_truth is False else "", key=truth.get(row.name))
            )
        rows.append([*cells, Cell(row.reason or meaning(row.name), tone="note")])
    return table(about, head, rows)


def _interval(row: Row, estimate: Estimate) -> str:
    """Write an interval; one that begins on a bound has one end only."""
    if estimate.ci95 is None:
        return ""
    if estimate.status == "at_bound" and estimate.value is not None:
        below, above = estimate.value - estimate.ci95[0], estimate.ci95[1] - estimate.value
        return f"≤ {row.high}" if above >= below else f"≥ {row.low}"
    return f"{row.low} … {row.high}"


def identifiability(fingerprint: Fingerprint) -> Iterable[str]:
    """Yield what the data tell apart, what they leave open, and what would settle it."""
    found = fingerprint.identifiability
    yield paragraph(wording.rank(found))
    if found.null_space:
        yield paragraph(
            "The model's outputs stay the same when these change together, in the proportion given:"
        )
        yield bullets(str(entry["combination"]) for entry in found.null_space)
    if found.closes_gap:
        yield paragraph("Any one of these, known from elsewhere, would settle the rest:")
        yield bullets(found.closes_gap)


def fits(fingerprint: Fingerprint) -> Iterable[str]:
    """Yield the table of fits."""
    lines = [
        (str(record.get("name", "")), output, row)
        for record in fingerprint.data
        for output, row in record.get("fit", {}).items()
    ]
    lines += [("all data", output, row) for output, row in fingerprint.fit.items() if "nrmse_pct" in row]
    if not lines:
        return
    yield paragraph(
        "100 % is a perfect fit, 0 % one no better than the mean (normalised root mean square error)."
    )
    rows = [
        [Cell(name), Cell(wording.OUTPUTS.get(output, output)), number(_two(row["nrmse_pct"]))]
        for name, output, row in lines
    ]
    yield table("fit of each output in each experiment", ["experiment", "output", "fit [%]"], rows)
    overall = {key: value for key, value in fingerprint.fit.get("overall", {}).items() if value is not None}
    if overall:
        told = ", ".join(
            f"{key.replace('_', ' ')} {value:.6g}" for key, value in overall.items() if key != "nrmse_pct"
        )
        yield paragraph(f"All outputs together: {told}.", "lead")


def residual_tests(fingerprint: Fingerprint, pictures: Pictures) -> Iterable[str]:
    """Yield what the residuals say of structure and noise model, and their correlations by lag."""
    tested = {
        output: row
        for output, row in fingerprint.fit.items()
        if "whiteness_p" in row or "input_correlation_p" in row
    }
    if not tested:
        yield paragraph("No residual test: what was fitted has no order in time.")
        return
    threshold = ALARM / len(tested)
    yield paragraph(
        "What a right model leaves over is noise: unlike the set point, or a dynamic part is missing, and, once "
        "whitened, unlike its own past, or the intervals may be too narrow (Ljung 1999, section 16.6). A test fails "
        f"below p = {threshold:.2g}; on long records it finds parts that do not matter: the last column says how much."
    )
    rows = [
        [
            Cell(wording.OUTPUTS.get(output, output)),
            *_tested(
                row.get("input_correlation_p"), threshold, "free of the set point", "follows the set point"
            ),
            number(_two(row.get("input_explained_pct"))),
            *_tested(row.get("whiteness_p"), threshold, "white", "coloured"),
        ]
        for output, row in tested.items()
    ]
    head = ["output", "set point, p", "verdict", "explains of what was left [%]", "whiteness, p", "verdict"]
    yield table("residual tests of each output", head, rows)
    for output, correlations in fingerprint.residuals.items():
        own, by_set_point = (_outside(correlations[kind]) for kind in ("autocorrelation", "set_point"))
        yield pictures.draw(
            2,
            partial(plot.correlogram, fingerprint, output),
            f"Whitened residuals of {wording.OUTPUTS.get(output, output)}: correlation with their own past, {own}, and "
            f"with the set point, {by_set_point}. Of noise one lag in twenty is outside.",
            height=1.7,
            sharex=False,
        )


def _outside(test: Mapping[str, Sequence[float]]) -> str:
    count = sum(abs(size) > band for size, band in zip(test["correlation"], test["band"], strict=True))
    return f"{count or 'none'} of {len(test['lags'])} lags outside the band"


def _tested(p: float | None, threshold: float, passed: str, failed: str) -> tuple[Cell, Cell]:
    if p is None:
        return number(""), Cell("")
    text = f"{p:.2g}" if p > 1e-6 else "< 1e-6"
    return number(text, key=p), Cell(passed, tone="good") if p >= threshold else Cell(failed, tone="warn")


def _two(value: Any) -> str:
    return "" if value is None else f"{value:.2f}"
