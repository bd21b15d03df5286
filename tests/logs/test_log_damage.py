"""A damaged log is refused, repaired or masked, and which of its samples: never used in silence."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from shipfp_rs import signals
from shipfp_rs.errors import InputError, LogWarning
from shipfp_rs.logs.faults import simulated
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.simulation.raw_log import Sensors, simulate_raw_log, trial_toml
from shipfp_rs.support.arrays import Spans, marks
from shipfp_rs.vessel.vessel import Vessel

RATE_HZ = 2000.0
SLACK = 60
"""Samples by which a record may miss the damage at either end: 30 ms."""
HUM_SLACK = 500
"""The same for hum, which is told in blocks of ten cycles."""
TUG = Vessel.load("stan-tug-1205")
UNITS = {"U_setpoint": "V", "U_torque": "V", "PTM_1": "V", "PTM_4": "V", "PTM_e": "V"}

Arrays = dict[str, np.ndarray]


@dataclass
class Damaged:
    """A damaged log.

    Parameters
    ----------
    arrays
        Channels as recorded.
    kinds
        Records of any of these kinds tell the damage.
    channel
        On which channel they stand; "" for any.
    spans
        Samples touched, shape (K, 2).
    refusal
        What an error says that names the damage; "" where none would.
    """

    arrays: Arrays
    kinds: tuple[str, ...] = ()
    channel: str = ""
    spans: Spans = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    refusal: str = ""
    slack: int = SLACK
    trial: tuple[tuple[str, str], ...] = ()
    units: Mapping[str, str] = field(default_factory=lambda: UNITS)
    time: np.ndarray | None = None
    text: Callable[[str], str] | None = None
    """What is done to the lines of a CSV file of the first seconds."""


@cache
def sound(seed: int = 0) -> tuple[Arrays, str, tuple[int, int]]:
    """Channels of a sound log, its trial, and the samples of its window."""
    chirp = signals.chirp(0.2, 2.0, 15.0, 76.0, rate_hz=500.0)
    log, truth = simulate_raw_log(TUG, chirp, faults=(), steady_s=12.0, pause_s=3.0, seed=seed)
    window = truth.windows[0]
    # Processed at 200 Hz the tests' masks are sharper than at 50.
    text = trial_toml("stan-tug-1205", "run.parquet", Sensors(), truth)
    arrays = {name: log.read(name).copy() for name in log.channels}
    return arrays, text, (round(window.start_s * RATE_HZ), round(window.stop_s * RATE_HZ))


def damaged(kind: str, seed: int) -> Damaged:
    """Return the sound log with one class of damage."""
    arrays, _, window = sound(seed % 3)
    return CLASSES[kind]({name: x.copy() for name, x in arrays.items()}, np.random.default_rng(seed), window)


def _stretch(
    draw: np.random.Generator, window: tuple[int, int], shortest: int, longest: int
) -> tuple[int, int]:
    """Draw a stretch that lies within the window, a second from its ends."""
    length = int(np.exp(draw.uniform(np.log(shortest), np.log(longest))))
    start = int(draw.integers(window[0] + 2000, window[1] - 2000 - length))
    return start, start + length


def _span(start: int, stop: int) -> Spans:
    return np.array([[start, stop]])


def _missing_rows(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    start, stop = _stretch(draw, window, 20, 3000)
    rows = np.delete(np.arange(len(arrays["PTM_1"])), slice(start, stop))
    kept = {name: x[rows] for name, x in arrays.items()}
    refusal = rf"samples {start} to {stop - 1}"
    return Damaged(kept, ("time_gap",), "time", _span(start, stop), refusal, time=rows / RATE_HZ)


def _repeated(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    start, stop = _stretch(draw, window, 20, 3000)
    rows = np.insert(np.arange(len(arrays["PTM_1"])), stop, np.arange(start, stop))
    return Damaged(
        {name: x[rows] for name, x in arrays.items()},
        ("repeated",),
        "time",
        _span(start, stop),
        time=rows / RATE_HZ,
    )


def _repeated_without_time(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    start, stop = _stretch(draw, window, 256, 1500)
    twice = simulated.write_twice(arrays, start, stop - start, over=True)
    refusal = rf"rows recorded more than once, .*\(samples {stop} to {2 * stop - start - 1}\)"
    return Damaged(twice, ("repeated",), "U_setpoint", _span(stop, 2 * stop - start), refusal)


def _clock_back(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    start, _ = _stretch(draw, window, 200, 9000)
    time = np.arange(len(arrays["PTM_1"])) / RATE_HZ
    time[start:] -= draw.uniform(0.01, 3.0)
    return Damaged(arrays, refusal="the clock was reset within it", spans=_span(start, len(time)), time=time)


def _clock_rate(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    """A clock that runs fast or slow: the file alone knows no other."""
    time = np.arange(len(arrays["PTM_1"])) / RATE_HZ * (1.0 + 1e-4 * draw.uniform(-1.0, 1.0))
    return Damaged(arrays, ("drift",), time=time, spans=_span(*window))


def _lost(kind: str, value: float | None = None) -> Callable[..., Damaged]:
    def make(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
        shortest = {"stuck": 520, "dropout": 40}.get(kind, 1)
        start, stop = _stretch(draw, window, shortest, 4000)
        name = str(draw.choice(["U_torque", "U_setpoint"])) if kind != "dropout" else "U_torque"
        arrays[name] = simulated.lose(arrays[name], kind, [(start, stop)])
        if value is not None:
            arrays[name][start:stop] = value
        told = (kind, "C") if kind == "dropout" else (kind,)
        return Damaged(
            arrays, told, name, _span(start, stop), rf"\(samples ({start - 1}|{start}) to {stop - 1}\)"
        )

    return make


def _clipped(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    cut, spans = simulated.clip(arrays["U_torque"][slice(*window)], draw.uniform(0.003, 0.1))
    limit = cut.max()
    arrays["U_torque"] = np.minimum(arrays["U_torque"], limit)
    return Damaged(arrays, ("clipped",), "U_torque", spans + window[0])


def _swapped(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    names = list(arrays)
    one, other = draw.choice(5, 2, replace=False)
    arrays[names[one]], arrays[names[other]] = arrays[names[other]], arrays[names[one]]
    return Damaged(
        arrays, (), spans=_span(*window), refusal=r"channels\.|gives an engine speed|are masked|set point"
    )


def _text(change: Callable[[str, int], str], refusal: str) -> Callable[..., Damaged]:
    def make(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
        line = int(draw.integers(100, 3000))

        def edited(text: str) -> str:
            lines = text.split("\n")
            lines[line] = change(lines[line], int(draw.integers(1, 6)))
            return "\n".join(lines)

        return Damaged(arrays, refusal=refusal.format(line=line + 1), text=edited)

    return make


def _word(line: str, column: int) -> str:
    cells = line.split(",")
    cells[column] = "overload"
    return ",".join(cells)


def _comma(line: str, column: int) -> str:
    cells = line.split(",")
    cells[column] = cells[column].replace(".", ",") if "." in cells[column] else cells[column] + ",0"
    return ",".join(cells)


def _truncated(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    """Cut within a line: a file that ends with a whole line may as well have been stopped there."""
    part = draw.uniform(0.3, 0.95)

    def cut(text: str) -> str:
        kept = text[: int(part * len(text))]
        return kept[:-1] if kept.endswith("\n") else kept

    return Damaged(arrays, refusal="the last line has no line end and may be cut", text=cut)


def _wrong_unit(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    name = str(draw.choice(["U_torque", "U_setpoint"]))
    arrays[name] *= np.float32(1000.0)
    units = UNITS | ({name: "mV"} if draw.random() < 0.5 else {})
    return Damaged(arrays, refusal=r"channels\.|is in 'mV'", units=units, spans=_span(*window))


def _sign(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    arrays["U_torque"] *= -1.0
    return Damaged(arrays, ("sign",), "U_torque", _span(*window))


def _scaled(name: str, low: float, high: float) -> Callable[..., Damaged]:
    def make(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
        factor = np.float32(np.exp(draw.uniform(np.log(low), np.log(high))))
        arrays[name] *= factor if draw.random() < 0.5 else np.float32(1.0) / factor
        return Damaged(arrays, spans=_span(*window), refusal=r"channels\.(set_point|torque)")

    return make


def _spikes(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    name, kind, height = (("U_torque", "C", 1.0), ("U_setpoint", "D1", 1.5))[draw.integers(2)]
    places = np.sort(draw.choice(np.arange(window[0] + 2000, window[1] - 2000, 400), 8, replace=False))
    arrays[name][places] += np.float32(height) * draw.choice(np.array([-1.0, 1.0], dtype=np.float32), 8)
    return Damaged(arrays, (kind,), name, np.column_stack([places, places + 1]))


def _missing_channel(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    name = str(draw.choice(list(arrays)))
    del arrays[name]
    return Damaged(arrays, refusal=f"no channel '{name}'", spans=_span(*window))


def _missing_pulses(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    start, stop = _stretch(draw, window, 1000, 6000)
    arrays["PTM_4"][start:stop] = draw.normal(0.0, 0.02, stop - start)
    # What is lost are whole pulses: a pitch at either end may be sound.
    return Damaged(arrays, ("B", "faint"), "PTM_4", _span(start, stop), slack=110)


def _pulses_per_rev(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    wrong = int(draw.choice([1, 2, 3, 5, 8]))
    return Damaged(
        arrays,
        refusal=r"check pulses_per_rev",
        trial=(("pulses_per_rev = 4", f"pulses_per_rev = {wrong}"),),
        spans=_span(*window),
    )


def _same_names(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    one, other = (f"{name}" for name in draw.choice(list(arrays), 2, replace=False))

    def renamed(text: str) -> str:
        head, rest = text.split("\n", 1)
        return head.replace(other, one) + "\n" + rest

    return Damaged(arrays, refusal=f"'{one}( .V.)?' appears twice", text=renamed)


def _hum(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    start, stop = _stretch(draw, window, 4000, 20_000)
    volts = simulated.hum(arrays["U_setpoint"], RATE_HZ, 50.0, draw.uniform(0.02, 0.1), start, stop)
    return Damaged(arrays | {"U_setpoint": volts}, ("D2",), "U_setpoint", _span(start, stop), slack=HUM_SLACK)


def _no_chirp(arrays: Arrays, draw: np.random.Generator, window: tuple[int, int]) -> Damaged:
    log, _ = simulate_raw_log(
        TUG, signals.chirp(0.2, 2.0, 15.0, 76.0, rate_hz=500.0), faults=("D3",), steady_s=12.0, pause_s=3.0,
        seed=int(draw.integers(1000)),
    )  # fmt: skip
    return Damaged({name: log.read(name) for name in arrays}, ("D3",), "U_setpoint", _span(*window))


CLASSES: dict[str, Callable[..., Damaged]] = {
    "gap: rows missing": _missing_rows,
    "rows written twice, with time": _repeated,
    "rows written twice, no time": _repeated_without_time,
    "clock set back": _clock_back,
    "clock fast or slow by 100 ppm": _clock_rate,
    "stuck sensor": _lost("stuck"),
    "swapped columns": _swapped,
    "clipped torque": _clipped,
    "NaN stretch": _lost("gap"),
    "infinite values": _lost("gap", np.inf),
    "text among numbers": _text(_word, r"no numbers and taken as missing: 'overload'"),
    "decimal comma in a line": _text(_comma, r"line {line}"),
    "truncated file": _truncated,
    "wrong unit": _wrong_unit,
    "torque of the opposite sign": _sign,
    "set point scaled": _scaled("U_setpoint", 1.15, 10.0),
    "torque scaled beyond its rating": _scaled("U_torque", 600.0, 5000.0),
    "torque scaled by up to 2": _scaled("U_torque", 1.05, 2.0),
    "dropout to zero": _lost("dropout"),
    "single spikes": _spikes,
    "missing channel": _missing_channel,
    "missing pulses": _missing_pulses,
    "wrong pulses per turn": _pulses_per_rev,
    "two channels of one name": _same_names,
    "mains hum on the set point": _hum,
    "chirp of one frequency": _no_chirp,
}
"""Class of damage to how it is drawn from (channels, draw, window)."""

UNTOLD = ("clock fast or slow by 100 ppm", "torque scaled by up to 2")
"""Nothing within one log contradicts these: another logger (see `shipfp_rs.processing.alignment`), or a static torque of
known torque coefficient (`shipfp inspect`), does."""


def outcome(kind: str, seed: int, folder: Path) -> str:
    """Return "refused", "told", or what went wrong, for one damaged log from opening to experiments."""
    case = damaged(kind, seed)
    _, text, _ = sound(seed % 3)
    for old, new in case.trial:
        assert old in text
        text = text.replace(old, new)
    if case.text is not None:
        text = text.replace("run.parquet", "run.csv")
    (folder / "TRIAL.toml").write_text(text)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", LogWarning)
        try:
            trial = Trial.load(folder / "TRIAL.toml")
            experiments = process(_log(case, folder), trial)
        except InputError as error:
            if _says(case.refusal, str(error)):
                return "refused"
            if any(_says(case.refusal, str(warning.message)) for warning in told):
                return "told"
            return f"unnamed: {error}"
    records = [fault for experiment in experiments for fault in experiment.provenance["faults"]]
    spans = [
        np.array(record["spans"])
        for record in records
        if record["kind"] in case.kinds and case.channel in ("", record["channel"])
    ]
    if case.refusal and any(_says(case.refusal, str(warning.message)) for warning in told):
        return "told"
    if not spans:
        return f"silent, {sorted({record['kind'] for record in records})}"
    return "told" if _covers(np.concatenate(spans), case) else "told elsewhere"


def _covers(spans: Spans, case: Damaged) -> bool:
    """Whether all damaged samples within the window are told, and none further away than the slack."""
    _, _, window = sound()
    size = window[1] + 10 * SLACK
    touched = marks(case.spans, 0, size)
    found = marks(spans, 0, size)
    near = marks(case.spans + np.array([-case.slack, case.slack]), 0, size)
    inner = (
        marks(case.spans + np.array([case.slack, -case.slack]), 0, size) if case.slack > SLACK else touched
    )
    inside = slice(*window)
    return bool(found[inside][inner[inside]].all() and not (found & ~near)[inside].any())


def _log(case: Damaged, folder: Path) -> Log:
    if case.text is not None:
        lines = [",".join(["time [s]", *(f"{name} [V]" for name in case.arrays)])]
        columns = [np.arange(4000) / RATE_HZ, *(x[:4000] for x in case.arrays.values())]
        lines += [",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True)]
        path = folder / "run.csv"
        path.write_text(case.text("\n".join(lines) + "\n"))
        log = Log.open(path)
        for name in log.channels:
            log.read(name)
        return log
    if case.time is not None:
        path = folder / "run.parquet"
        names = {"time [s]": case.time} | {f"{name} [V]": x for name, x in case.arrays.items()}
        pa.parquet.write_table(pa.table(names), path)
        return Log.open(path)
    return Log.from_arrays(case.arrays, rate_hz=RATE_HZ, units=case.units, name="run.parquet")


def _says(pattern: str, message: str) -> bool:
    return bool(pattern) and re.search(pattern, message) is not None


FOLLOWED = {
    "stuck sensor", "clipped torque", "NaN stretch", "dropout to zero", "single spikes", "mains hum on the set point",
}  # fmt: skip
"""Classes that test_processing.py follows sample by sample in every check; here they are drawn in the study alone."""
TELLABLE = [kind for kind in CLASSES if kind not in {*UNTOLD, *FOLLOWED}]
GOOD = {"refused", "told"}


@pytest.mark.parametrize("kind", TELLABLE)
def test_damage_is_never_silent(kind: str, tmp_path: Path) -> None:
    assert outcome(kind, 1, tmp_path) in GOOD


@pytest.mark.study
def test_study_of_log_damage(tmp_path: Path) -> None:
    seeds = 50
    print(f"\n{'class of damage':34s} {'refused':>8s} {'told':>6s} {'not told':>9s}   of {seeds} seeds")
    missed = {}
    for kind in CLASSES:
        found = Counter(outcome(kind, seed, tmp_path) for seed in range(100, 100 + seeds))
        bad = {what: count for what, count in found.items() if what not in GOOD}
        note = "nothing in one log tells it" if kind in UNTOLD else ""
        print(f"{kind:34s} {found['refused']:8d} {found['told']:6d} {sum(bad.values()):9d}   {note}")
        if bad and kind not in UNTOLD:
            missed[kind] = bad
    assert not missed, missed
