"""One viewed log: channels at any zoom, faults, windows, spectra, and processed signals."""

from __future__ import annotations

import contextlib
import threading
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import UNITS
from shipfp_rs.logs.channel import Channel
from shipfp_rs.logs.faults.record import KINDS
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial import Trial
from shipfp_rs.processing.trial_template import moved, operating_rest
from shipfp_rs.processing.windows import FoundWindow
from shipfp_rs.support.arrays import attributes
from shipfp_rs.tacho import pulse_times
from shipfp_rs.view import pyramid
from shipfp_rs.view.jobs import Background, Progress
from shipfp_rs.view.results import Series

SPECTRUM_S = 300.0
"""Longest stretch for a spectrum [s]; a longer selection is cut to this stretch about its middle."""
SPECTRUM_POINTS = 2000
LEAST_SPECTRUM = 64
"""Fewest samples for a spectrum."""
DRAWN_RATES = 400  # points of a train's rate
OTHER_SIGNALS = ("n_set", "n_e", "M_g", "M_b", "M_s", "X_f")


class Document:
    """One log that a page shows, with or without a trial."""

    def __init__(self, path: Path, rate_hz: float | None = None, trial: Path | None = None) -> None:
        self.path, self.rate_hz, self.trial = path, rate_hz, trial
        self._lock = threading.Lock()
        self._log: Log | None = None
        self.pyramid = Background(self._pyramid)
        self.raw = Background(self._raw)
        self.faults = Background(self._faults)
        self._windows: dict[tuple[str, str | None], Background[tuple[str, list[FoundWindow]]]] = {}
        self._edges: dict[str, Background[npt.NDArray[np.float64]]] = {}
        self._processed: Background[list[Series]] | None = None
        self.processed: list[Series] = []
        self.processed_version = 0

    def log(self) -> Log:
        """The log, opened on first use."""
        with self._lock:
            if self._log is None:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # defects of the file are among its faults
                    self._log = Log.open(self.path, rate_hz=self.rate_hz)
            return self._log

    def _pyramid(self, tell: Progress) -> pyramid.Pyramid:
        found = pyramid.stored(self.path, self.rate_hz)
        return found or pyramid.made(self.log(), self.path, self.rate_hz, tell)

    def _raw(self, _: Progress) -> list[Series]:
        channels = self.pyramid.wait().channels
        # Opening a text log takes as long as reading it, so it is opened before samples are needed.
        threading.Thread(target=self._opened_ahead, daemon=True).start()
        return [Series.of_channel(one, self.log) for one in channels]

    def _opened_ahead(self) -> None:
        with contextlib.suppress(InputError, OSError):
            self.log()

    def series(self) -> list[Series]:
        """All series that are drawn: raw channels, then processed signals."""
        return [*self.raw.wait(), *self.processed]

    def facts(self) -> dict[str, Any]:
        """Data that the page needs before it can draw."""
        told = {
            "name": self.path.name,
            "trial": self.trial and self.trial.name,
            "layer": self.processed_version,
        }
        self.raw.begin()
        if not self.raw.done.is_set():
            self.raw.done.wait(0.05)
        state = {**self.raw.state(), "progress": self.pyramid.progress}
        if state["state"] != "done":
            return {**told, **state}
        start = self.pyramid.wait().start_utc
        return {
            **told,
            **state,
            "start_utc": None if start is None else start.timestamp(),
            "series": [_told(one) for one in self.series()],
        }

    def _faults(self, _: Progress) -> dict[str, Any]:
        """Faults that `shipfp inspect` finds, given the trial if any, and the kinds of fault not looked for."""
        from shipfp_rs.inspection import inspect_log  # SciPy takes long to load

        trial = None
        if self.trial is not None:
            with contextlib.suppress(InputError):  # an incomplete trial is ignored
                trial = Trial.load(self.trial)
        found = inspect_log(self.log(), trial)
        left_out = found.checks["looked_for"]["left_out"]
        channels = {one.channel.name: one.channel for one in self.raw.wait()}
        faults = []
        for fault in found.faults:
            # The clock is no channel: spans of its faults count samples at the first channel's rate.
            about = channels.get(fault["channel"]) or next(iter(channels.values()))
            times = [[about.start_s + edge / about.rate_hz for edge in span] for span in fault["spans"]]
            faults.append({**fault, "label": KINDS.get(fault["kind"], fault["kind"]), "times": times})
        return {"faults": faults, "left_out": [KINDS[kind] for kind in left_out]}

    def windows(self, driver: str, load: str | None = None) -> Background[tuple[str, list[FoundWindow]]]:
        """Search for the exciting channel (set point or load) and its windows, started only once."""
        self.log().channel(driver)
        with self._lock:
            if (driver, load) not in self._windows:
                self._windows[driver, load] = Background(lambda _: moved(self.log(), driver, load))
            return self._windows[driver, load].begin()

    def told_windows(self, driver: str, load: str | None = None) -> dict[str, Any]:
        """State of the search for windows, and its result."""
        search = self.windows(driver, load)
        search.done.wait(0.2)
        mover, found = search.result or (driver, [])
        rest = operating_rest(found, by_load=mover == load) if found else None
        return {
            **search.state(),
            "column": mover,
            "windows": [_found(window) for window in found],
            "rest": None if rest is None else [rest.start_s, rest.stop_s],
        }

    def within(self, driver: str, load: str | None, start_s: float, stop_s: float) -> dict[str, Any]:
        """Windows in a stretch, and the longest of those in which set point or load moves."""
        _, found = moved(self.log(), driver, load, start_s, stop_s)
        moving = [one for one in found if one.kind != "steady"]
        main = max(moving or found, key=lambda one: one.stop_s - one.start_s, default=None)
        return {"found": [_found(one) for one in found], "main": main and _found(main)}

    def mean(self, index: int, start_s: float, stop_s: float) -> dict[str, float | None]:
        """Mean of a stretch of a series, used as a reading in a calibration."""
        values = self._stretch(self._one(index), start_s, stop_s)
        values = values[np.isfinite(values)]
        return {"mean": float(values.mean()) if values.size else None}

    def spectrum(self, index: int, start_s: float, stop_s: float) -> dict[str, Any]:
        """Amplitude spectrum of a stretch and its peaks; too many lines to draw are reduced to the largest of each group."""
        from shipfp_rs.inspection.checks import amplitude_spectrum, find_peaks

        series = self._one(index)
        middle, half = 0.5 * (start_s + stop_s), 0.5 * min(stop_s - start_s, SPECTRUM_S)
        values = self._stretch(series, middle - half, middle + half)
        finite = np.count_nonzero(np.isfinite(values))
        if finite < max(LEAST_SPECTRUM, len(values) // 2):
            raise InputError(
                f"{series.channel.name}: {finite} samples in this stretch, expected {LEAST_SPECTRUM} or more and few gaps"
            )
        with np.errstate(all="ignore"):
            frequency, amplitude = amplitude_spectrum(values, series.channel.rate_hz)
        wide_enough = frequency[-1] > 10.0 and len(frequency) > 100
        peaks = find_peaks(frequency, amplitude) if wide_enough else []
        step = -(-len(frequency) // SPECTRUM_POINTS)
        firsts = np.arange(0, len(frequency), step)
        return {
            "name": series.channel.name,
            "unit": series.channel.unit,
            "from": middle - half,
            "to": middle + half,
            "frequency": frequency[firsts].tolist(),
            "amplitude": np.maximum.reduceat(amplitude, firsts).tolist(),
            "peaks": [peak.to_dict() for peak in peaks],
        }

    def pulses(self, index: int, start_s: float, stop_s: float) -> dict[str, Any]:
        """Pulse rate [1/s] along a stretch; empty if its pulses are few enough to be drawn one by one."""
        channel = self._one(index).channel
        search = Background(lambda _: pulse_times(self.log().chunks(channel.name), channel.rate_hz).times_s)
        edges = channel.start_s + self._edges.setdefault(channel.name, search).wait()
        bounds = np.searchsorted(edges, np.linspace(start_s, stop_s, DRAWN_RATES + 1))
        bounds = np.unique(np.minimum(bounds, max(len(edges) - 1, 0)))
        if bounds[-1] - bounds[0] < 2 * DRAWN_RATES:
            return {"time": [], "rate": []}
        ends = edges[bounds]
        middle, rate = 0.5 * (ends[1:] + ends[:-1]), np.diff(bounds) / np.diff(ends)
        return {"time": middle.tolist(), "rate": rate.tolist()}

    def process(self, trial: Trial) -> dict[str, Any]:
        """Start to process the windows of a trial, unless a trial is being processed, and return the state."""
        with self._lock:
            if self._processed is not None and not self._processed.done.is_set():
                return self._processed.state()
            self._processed = Background(lambda _: self._process(trial))
        return self._processed.begin().state()

    def _process(self, trial: Trial) -> list[Series]:
        from shipfp_rs.processing.process import process

        windows = trial.windows_of(self.path.name)
        made = process(self.log(), trial) if windows else []
        signals = []
        for experiment in made:
            start_s = float(experiment.provenance["window_s"][0])
            for name in OTHER_SIGNALS:
                if name in experiment.signals:
                    values = experiment.signals[name]
                    label = f"{name} in {experiment.name}"
                    channel = Channel(label, UNITS[name], experiment.rate_hz, len(values), start_s)
                    signals.append(Series.of_array(channel, values, f"processed {name}"))
        self.processed = signals
        self.processed_version += 1
        return signals

    def process_state(self) -> dict[str, Any]:
        """Progress of the processing."""
        work = self._processed
        return {"state": "none"} if work is None else {**work.state(), "layer": self.processed_version}

    def _one(self, index: int) -> Series:
        every = self.series()
        if not 0 <= index < len(every):
            raise InputError(f"series {index}: expected 0 to {len(every) - 1}")
        return every[index]

    def _stretch(self, series: Series, start_s: float, stop_s: float) -> npt.NDArray[np.float64]:
        channel = series.channel
        first = max(round((start_s - channel.start_s) * channel.rate_hz), 0)
        stop = min(round((stop_s - channel.start_s) * channel.rate_hz), channel.samples)
        if not first < stop:
            raise InputError(f"{channel.name}: no samples from {start_s:g} to {stop_s:g} s")
        return series.read(first, stop).astype(np.float64)


def _told(series: Series) -> dict[str, Any]:
    channel = series.channel
    return {
        **channel.told,
        "levels": series.depth,
        "gaps": (channel.start_s + series.gaps / channel.rate_hz).tolist(),
        "gap_count": series.gap_count,
        "layer": series.layer,
    }


def _found(window: FoundWindow) -> dict[str, Any]:
    return attributes(window, "name", "kind", "start_s", "stop_s", "frequency_hz")
