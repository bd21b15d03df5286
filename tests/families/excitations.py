"""What is put on the engine-speed set point, as a function of time that integrators can ask anywhere.

Every excitation is relative: 1 is the steady set point. It stands at 1 up to `start_s`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

KINDS = ("sines", "chirp", "steps", "multisine")
_SINES, _CHIRP, _STEPS, _MULTISINE = range(4)
FADE_S = 3.0
"""Over which a multisine comes in, so that it does not begin with a step [s]."""


@njit(cache=True)
def asked(kind, start, table, t):
    """Set point over the steady one at time `t`; a step counts half at its own instant."""
    late = t - start
    if late <= 0.0 and not (kind == _STEPS and late == 0.0):
        return 1.0
    if kind == _CHIRP:
        low, growth, amplitude = table[0]
        return 1.0 + amplitude * np.sin(2.0 * np.pi * low * np.expm1(growth * late) / growth)
    if kind == _MULTISINE:
        total = 0.0
        for k in range(table.shape[0]):
            total += table[k, 1] * np.sin(2.0 * np.pi * table[k, 0] * late + table[k, 2])
        if late < FADE_S:
            total *= 0.5 - 0.5 * np.cos(np.pi * late / FADE_S)
        return 1.0 + total
    k = np.searchsorted(table[:, 0], late, side="right") - 1
    if k < 0:
        return 1.0
    if kind == _SINES:
        return 1.0 + table[k, 2] * np.sin(2.0 * np.pi * table[k, 1] * (late - table[k, 0]))
    if late == table[k, 0]:
        before = table[k - 1, 1] if k else 1.0
        return 0.5 * (before + table[k, 1])
    return table[k, 1]


@njit(cache=True)
def asked_at(kind, start, table, times):
    out = np.empty(len(times))
    for i in range(len(times)):
        out[i] = asked(kind, start, table, times[i])
    return out


@dataclass(frozen=True)
class Excitation:
    """One experiment on the set point."""

    kind: str
    """One of `KINDS`."""
    start_s: float
    """End of the steady running before it [s]."""
    stop_s: float
    """End of the record [s]."""
    table: np.ndarray
    """chirp: (first frequency [Hz], growth [1/s], amplitude); multisine: frequency, amplitude, phase a row;
    sines: start after `start_s` [s], frequency, amplitude a row; steps: time after `start_s`, level a row."""
    keeps_time: bool = True
    """Whether its steps keep the time of a clock, the governor's where it samples."""

    @property
    def code(self) -> int:
        return KINDS.index(self.kind)

    @property
    def swing(self) -> float:
        """Largest distance from the steady set point."""
        times = np.arange(self.start_s, self.stop_s, 0.01)
        return float(np.abs(self(times) - 1.0).max())

    def __call__(self, times):
        return asked_at(self.code, self.start_s, self.table, np.asarray(times, dtype=float))

    def mean(self, times, width_s):
        """Return its mean over `width_s` about each instant where it steps, its value where it does not."""
        if self.kind != "steps":
            return self(times)
        at = np.r_[self.start_s + self.table[:, 0], np.inf]
        levels = np.r_[0.0, self.table[:, 1] - 1.0]
        whole = np.r_[0.0, np.cumsum(levels[1:-1] * np.diff(at[:-1]))]

        def integral(t):
            k = np.searchsorted(at[:-1], t, side="right")
            since = np.maximum(k - 1, 0)
            return np.where(k > 0, whole[since] + levels[k] * (t - at[since]), 0.0)

        times = np.asarray(times, dtype=float)
        return 1.0 + (integral(times + 0.5 * width_s) - integral(times - 0.5 * width_s)) / width_s

    def in_time(self, period_s: float, phase_s: float) -> Excitation:
        """Return steps that a governor sees half a period before it takes a sample."""
        late = np.round((self.start_s + self.table[:, 0] - phase_s) / period_s - 0.5) + 0.5
        at = np.maximum(late * period_s + phase_s - self.start_s, 0.0)
        return replace(self, table=np.column_stack([at, self.table[:, 1]]))

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which it or its slope jumps [s], shape (B,)."""
        if self.kind in ("sines", "steps"):
            return self.start_s + self.table[:, 0]
        ends = [self.start_s] if self.kind == "chirp" else [self.start_s, self.start_s + FADE_S]
        return np.array(ends)

    def described(self) -> dict:
        return {
            "kind": self.kind,
            "start_s": self.start_s,
            "stop_s": self.stop_s,
            "swing": self.swing,
            "keeps_time": self.keeps_time,
        }


def drawn(random: np.random.Generator, kind: str | None = None, longest_s: float = 600.0) -> Excitation:
    """Draw an excitation: 20 to 40 s of rest, then 200 to `longest_s` seconds with swings of 4 to 8 per cent."""
    kind = KINDS[random.integers(4)] if kind is None else kind
    start = float(np.round(random.uniform(20.0, 40.0), 2))
    duration = float(np.round(random.uniform(200.0, longest_s), 1))
    swing = random.uniform(0.04, 0.08)
    make = {"sines": _sines, "chirp": _chirp, "steps": _steps, "multisine": _multisine}[kind]
    table, duration = make(random, duration, swing)
    keeps_time = kind != "steps" or bool(random.random() < 0.5)
    if not keeps_time:
        table[:, 0] += random.uniform(0.0, 1.0, len(table))
    return Excitation(kind, start, start + duration, table, keeps_time)


def _chirp(random, duration, swing):
    low = 10.0 ** random.uniform(-3.0, -2.0)
    high = random.uniform(1.0, 4.0)
    return np.array([[low, np.log(high / low) / duration, swing]]), duration


def _sines(random, duration, swing):
    frequencies = np.geomspace(
        random.uniform(0.01, 0.03), random.uniform(1.0, 4.0), int(random.integers(10, 17))
    )
    rows, at = [], 0.0
    for frequency in frequencies:
        periods = max(4, int(np.ceil(8.0 * frequency)))
        rows.append((at, frequency, swing))
        at += periods / frequency
    # The slow ones take most of the time: stretch or shrink all frequencies to fit the duration.
    scale = at / duration
    table = np.array([(row[0] / scale, row[1] * scale, row[2]) for row in rows])
    return table, duration


def _steps(random, duration, swing):
    rows, at, level = [], 0.0, 1.0
    while at < duration - 5.0:
        new = 1.0 + random.choice([-1.0, -0.5, 0.0, 0.5, 1.0]) * swing
        if new != level:
            rows.append((np.round(at, 3), new))
            level = new
            at += random.uniform(5.0, 20.0)
    return np.array(rows), duration


def _multisine(random, duration, swing):
    lines = int(random.integers(20, 41))
    wanted = np.geomspace(random.uniform(0.004, 0.01), random.uniform(1.0, 3.0), lines)
    frequencies = np.unique(np.maximum(np.round(wanted * duration), 1.0)) / duration
    times = np.arange(0.0, duration, 0.05)
    best, crest = np.zeros(len(frequencies)), np.inf
    for _ in range(12):
        phases = random.uniform(0.0, 2.0 * np.pi, len(frequencies))
        peak = np.abs(np.sin(2.0 * np.pi * np.outer(times, frequencies) + phases).sum(axis=1)).max()
        if peak < crest:
            best, crest = phases, peak
    return np.column_stack([frequencies, np.full(len(frequencies), swing / crest), best]), duration
