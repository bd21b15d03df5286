"""Tables of the treatment of every sample (kept, repaired or cut, with the reason) and of the log's quality."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import numpy.typing as npt

from shipfp_rs.experiments.experiment import UNITS, Experiment
from shipfp_rs.identification import wording
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.report.markup import Cell, Row, Say, bullets, count, details, number, paragraph, plain, table
from shipfp_rs.support.arrays import Array

FATES = {2: "kept", 3: "repaired", 4: "cut", 1: "another sensor used", 0: "outside windows"}
"""Treatments of a recorded sample by code; if several apply, the highest code counts."""
SPANS_SHOWN = 100
"""Largest number of listed spans per kind of repair; experiments.parquet has all spans."""


@dataclass(frozen=True)
class Fault:
    """Fault of a channel in one experiment; with `cut`, fits omit the signal at these times, even if it was repaired."""

    kind: str
    channel: str
    method: str
    signal: str
    spans: npt.NDArray[np.int64]
    spans_s: Array
    cut: bool = True

    @property
    def kept(self) -> bool:
        """Whether the samples were reported and kept unchanged."""
        return not self.cut and self.method.startswith("kept")

    @property
    def samples(self) -> int:
        """Number of affected samples."""
        return int((self.spans[:, 1] - self.spans[:, 0]).sum())


def faults(experiment: Experiment) -> list[Fault]:
    """Faults recorded in an experiment."""
    provenance = experiment.provenance
    found = []
    for record in provenance.get("faults", ()):
        spans = np.asarray(record["spans"], dtype=np.int64).reshape(-1, 2)
        if not len(spans):
            continue
        clock = provenance.get("recorded", {}).get(record["channel"])
        spans_s = np.empty((0, 2))
        if clock is not None:
            spans_s = clock["start_s"] + spans / clock["rate_hz"] - provenance["window_s"][0]
        signal = clock["signal"] if clock is not None and len(spans_s) else ""
        cut = bool(record.get("excluded", True))
        found.append(Fault(record["kind"], record["channel"], record["method"], signal, spans, spans_s, cut))
    return found


def of_every_sample(fingerprint: Fingerprint, experiments: Sequence[Experiment], say: Say) -> Iterable[str]:
    """Yield the treatment of the logs' samples, of the experiments' samples and of each fault."""
    yield _recorded(experiments, say)
    yield _fitted(fingerprint, experiments, say)
    yield _faults(experiments, say)


def _recorded(experiments: Sequence[Experiment], say: Say) -> str:
    """Table of recorded samples by channel; each sample is in exactly one column."""
    rows: list[Row] = []
    for log, group in groupby(experiments, key=lambda e: str(e.provenance.get("log", ""))):
        cut_from = [e for e in group if "recorded" in e.provenance]
        for channel in dict.fromkeys(name for e in cut_from for name in e.provenance["recorded"]):
            fate = _fates(channel, cut_from)
            by_code = (count(int(np.count_nonzero(fate == code)), len(fate)) for code in FATES)
            rows.append([Cell(channel, code=True), log, count(len(fate)), *by_code])
    if not rows:
        return ""
    head = say.each("channel", "log", "recorded", *FATES.values())
    return paragraph(
        say(
            "Samples as the logger recorded them; each is counted once. Repaired ones are fitted; cut ones are not, "
            "even where something was put in their place so that the filter passes over them."
        )
    ) + table(say("fate of the recorded samples of each channel"), head, rows)


def _fates(channel: str, experiments: Sequence[Experiment]) -> npt.NDArray[np.uint8]:
    """Code in `FATES` of each recorded sample of a channel, shape (N,); if several apply, the highest."""
    fate = np.zeros(experiments[0].provenance["recorded"][channel]["samples"], dtype=np.uint8)

    def raise_to(code: int, first: int, stop: int) -> None:
        part = fate[max(first, 0) : stop]
        np.maximum(part, np.uint8(code), out=part)

    for experiment in experiments:
        clock = experiment.provenance["recorded"].get(channel)
        if clock is None:
            continue
        raise_to(2 if clock["signal"] else 1, *clock["rows"])
        for fault in faults(experiment):
            if fault.channel == channel and clock["signal"] and not fault.kept:
                for first, stop in fault.spans:
                    raise_to(4 if fault.cut else 3, first, stop)
    return fate


def _fitted(fingerprint: Fingerprint, experiments: Sequence[Experiment], say: Say) -> str:
    """Table of fitted samples; a masked sample also removes its neighbours within the filter's length."""
    records = {str(record.get("name", "")): record for record in fingerprint.data}
    rows: list[Row] = []
    for experiment in experiments:
        masked = {name: np.isnan(samples) for name, samples in experiment.signals.items()}
        why = ", ".join(
            say("{name} masked in {share} %", name=name, share=f"{100.0 * mask.mean():.2g}")
            for name, mask in masked.items()
            if mask.any()
        )
        samples = len(experiment)
        held = experiment.name in fingerprint.held_out
        left_out = samples - (0 if held else int(records.get(experiment.name, {}).get("used", samples)))
        why = say("held out") if held else why
        shares = (count(samples - left_out, samples), count(left_out, samples))
        about = (number(f"{experiment.duration:g}"), number(f"{experiment.rate_hz:g}"), count(samples))
        rows.append([experiment.name, experiment.kind, *about, *shares, Cell(why, tone="note")])
    if not rows:
        return ""
    head = say.each("experiment", "kind", "length [s]", "rate [Hz]", "samples", "fitted", "left out", "why")
    return paragraph(say("Samples of the experiments that were cut from the logs, after filtering.")) + table(
        say("samples of each experiment in the fit"), head, rows
    )


def _faults(experiments: Sequence[Experiment], say: Say) -> str:
    rows: list[Row] = []
    places = []
    for experiment in experiments:
        for fault in faults(experiment):
            kind = say(wording.FAULTS.get(fault.kind, fault.kind))
            treated = "" if fault.kept else f"{say('cut' if fault.cut else 'repaired')}: "
            per_minute = f"{60.0 * len(fault.spans) / experiment.duration:.3g}"
            counts = map(number, (str(len(fault.spans)), per_minute, str(fault.samples)))
            where = (experiment.name, Cell(fault.channel, code=True))
            rows.append([kind, *where, treated + say(fault.method), *counts])
            shown = ", ".join(f"{first}–{stop - 1}" for first, stop in fault.spans[:SPANS_SHOWN])
            rest = len(fault.spans) - SPANS_SHOWN
            more = say(" and {rest} more", rest=rest) if rest > 0 else ""
            places.append(f"{experiment.name}, {kind}, {fault.channel}: {shown}{more}")
    if not rows:
        return paragraph(say("No fault is on record."))
    head = say.each("fault", "experiment", "channel", "what was done", "count", "a minute", "samples")
    return table(say("faults by experiment and channel"), head, rows) + details(
        say("Which samples, counted from each channel's first"), bullets(places), printed=False
    )


def log_quality(experiments: Sequence[Experiment], say: Say) -> Iterable[str]:
    """Yield the quality of the log's sensors: pulse trains, calibrations, filter, operating points."""
    rows: list[Row] = []
    for experiment in experiments:
        speed = experiment.provenance.get("speed", {})
        if not isinstance(speed.get("median_rpm"), Mapping):
            continue
        medians = speed["median_rpm"]
        apart = f"{100.0 * (max(medians.values()) / min(medians.values()) - 1.0):.2g}" * (len(medians) > 1)
        reflectors = speed.get("reflectors", {})
        fractions = np.asarray(reflectors.get("fractions", ()), dtype=np.float64)
        off = f"{100.0 * np.abs(fractions * fractions.size - 1.0).max():.2f}" if fractions.size > 1 else ""
        bandwidth = f"{speed.get('bandwidth_hz', float('nan')):.3g}"
        figures = (speed.get("pulses_per_rev", ""), bandwidth, apart, off)
        why = Cell(str(reflectors.get("reason") or ""), tone="note")
        train = Cell(str(speed.get("train", "")), code=True)
        rows.append([experiment.name, train, *(number(str(figure)) for figure in figures), why])
    if rows:
        head = say.each(
            "experiment",
            "pulse train",
            "pulses a turn",
            "bandwidth of the speed [Hz]",
            "difference between trains [%]",
            "largest deviation of reflectors from even spacing [%]",
            "",
        )
        yield table(say("pulse trains that the speed was taken from"), head, rows)
    for experiment in experiments:
        about = ", ".join(
            f"{name} = {value:.6g} {UNITS.get(name, '')}".rstrip()
            for name, value in experiment.operating_point.items()
        )
        yield paragraph(
            say("{name}: operating point {point}.", name=experiment.name, point=say.number(about))
        )
        account = [
            [str(key), plain(value)]
            for key, value in experiment.provenance.items()
            if key not in ("faults", "recorded") and value is not None and plain(value)
        ]
        if account:
            made = say("How the signals of {name} were made", name=experiment.name)
            yield details(made, table(made, say.each("part", "account"), account))
