"""One simulated rotation through every kind of speed source: the same speed, within what each says of itself."""

from pathlib import Path

import numpy as np
import pytest

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.process import process
from shipfp_rs.processing.speed_sources import with_missing
from shipfp_rs.processing.trial import Trial

RATE_HZ = 4000.0
LENGTH_S = 14.0
TIME = np.arange(round(LENGTH_S * RATE_HZ)) / RATE_HZ
RPM = 1184.0 + 30.0 * np.sin(2 * np.pi * 0.4 * TIME)
TURNED = 1184.0 / 60.0 * TIME + 0.5 / (2 * np.pi * 0.4) * (1.0 - np.cos(2 * np.pi * 0.4 * TIME))
DRAW = np.random.default_rng(7)


def wheel(teeth: int, missing: int = 0, late: float = 0.0) -> np.ndarray:
    place = (TURNED + late / teeth) * teeth
    there = np.floor(place) % teeth < teeth - missing
    return np.where((place % 1.0 < 0.5) & there, 5.0, 0.0).astype(np.float32)


def bus(step: float, rate_hz: float) -> tuple[np.ndarray, float]:
    every = round(RATE_HZ / rate_hz)
    return np.round(RPM[::every] / step) * step, rate_hz


CHANNELS = {
    "pulses": wheel(4),
    "marked": wheel(36, 1),
    "marked_60": wheel(24, 2),
    "wrapped": np.floor((TURNED % 1.0) * 4096) / 4096 * 360.0,
    "counts": np.floor(TURNED * 1024),
    "radians": (TURNED * 2 * np.pi) % (2 * np.pi) + DRAW.normal(0.0, 1e-3, len(TIME)),
    "A": wheel(16),
    "B": wheel(16, late=-0.25),
    "volts": (RPM + DRAW.normal(0.0, 3.0, len(TIME))) / 200.0,
    "share": RPM / 20.0 + DRAW.normal(0.0, 0.05, len(TIME)),
    "drive": RPM / 60.0 * 2 * np.pi + DRAW.normal(0.0, 0.2, len(TIME)),
    "U_set": RPM,
}
TABLES = {
    "pulses": 'column = "pulses"\npulses_per_rev = 4\nshaft = "engine"',
    "36-1": 'column = "marked"\npulses_per_rev = 36\nmissing = 1\nshaft = "engine"',
    "24-2": 'column = "marked_60"\npulses_per_rev = 24\nmissing = 2\nshaft = "engine"',
    "wrapped degrees": 'column = "wrapped"\nunit = "deg"\nshaft = "engine"',
    "counts": 'column = "counts"\nunit = "counts"\ncounts_per_rev = 1024\nshaft = "engine"',
    "radians with noise": 'column = "radians"\nunit = "rad"\nshaft = "engine"',
    "quadrature": 'column = "A"\nquadrature = "B"\npulses_per_rev = 16\nshaft = "engine"',
    "edges": 'file = "edges.csv"\npulses_per_rev = 4\nshaft = "engine"',
    "edges with levels": 'file = "levels.csv"\nlevel = "level"\npulses_per_rev = 4\nshaft = "engine"',
    "analogue": 'column = "volts"\nunit = "rpm"\ncalibration = { scale = 200.0 }',
    "analogue as read": 'column = "volts"\nunit = "V"\ncalibration = { scale = 200.0 }',
    "per cent": 'column = "share"\nunit = "%"\ncalibration = { scale = 20.0 }\nstd = 1.0',
    "drive": 'column = "drive"\nunit = "rad/s"',
}


@pytest.fixture(scope="module")
def log() -> Log:
    return Log.from_arrays(CHANNELS, rate_hz=RATE_HZ, units={"U_set": "rpm"})


def trial(
    folder: Path,
    *tables: str,
    n_e_rpm: float = 1184.0,
    rate_hz: float = 20.0,
    window: tuple[float, float] = (2.5, 11.0),
    speed: str = "fused",
    set_point: str = "U_set",
    more: str = "",
) -> Trial:
    place = np.arange(1, np.floor(TURNED[-1] * 4)) / 4
    rises = np.interp(place, TURNED, TIME)
    (folder / "edges.csv").write_text("time [s]\n" + "".join(f"{t:.6f}\n" for t in rises))
    falls = np.interp(place + 0.1, TURNED, TIME)
    both = np.sort(np.concatenate([rises, falls]))
    rows = "".join(f"{t:.6f},{k % 2 == 0:d}\n" for k, t in enumerate(both))
    (folder / "levels.csv").write_text("time,level\n" + rows)
    path = folder / "TRIAL.toml"
    sources = "\n".join(
        f"[channels.{'speed' if k == 0 else f'speed_{k}'}]\n{table}" for k, table in enumerate(tables)
    )
    path.write_text(
        '[trial]\nname = "t"\nvessel = "stan-tug-1205"\nlog = "none.csv"\n'
        f'[channels.set_point]\ncolumn = "{set_point}"\nunit = "rpm"\ncalibration = {{ scale = 1.0 }}\n'
        f"{sources}\n"
        f"[operating_point]\nn_e_rpm = {n_e_rpm}\n[processing]\nspeed = '{speed}'\nrate_hz = {rate_hz}\n"
        f"[[windows]]\nname = 'W'\nstart_s = {window[0]}\nstop_s = {window[1]}\n{more}"
    )
    return Trial.load(path)


def error_and_std(log: Log, described: Trial) -> tuple[float, float]:
    (experiment,) = process(log, described)
    told = experiment.signals["n_e"]
    time = 2.5 + np.arange(len(told)) / experiment.rate_hz
    truth = 1184.0 + 30.0 * np.sin(2 * np.pi * 0.4 * time)
    known = np.isfinite(told)
    assert known.mean() > 0.98
    return float(np.std((told - truth)[known])), float(experiment.provenance["speed"]["std_rpm"])


@pytest.mark.parametrize("kind", TABLES)
def test_every_source_tells_the_same_speed_within_its_deviation(kind: str, log: Log, tmp_path: Path) -> None:
    error, std = error_and_std(log, trial(tmp_path, TABLES[kind]))
    assert error < 1.5 * std + 0.02
    assert error < 0.001 * 1184.0  # the deviation is that before the low-pass of 20 Hz


def test_sources_fuse_to_a_better_speed(log: Log, tmp_path: Path) -> None:
    alone = error_and_std(log, trial(tmp_path, TABLES["pulses"]))
    both = error_and_std(log, trial(tmp_path, TABLES["pulses"], TABLES["counts"], TABLES["analogue"]))
    assert both[1] < alone[1]
    assert both[0] < 1.5 * both[1] + 0.02


def test_missing_teeth_are_put_in_where_they_would_be() -> None:
    whole = np.cumsum(0.01 + 1e-5 * np.arange(240))
    lacking = np.delete(whole, [k for k in range(240) if k % 60 in (58, 59)])
    found = with_missing(lacking, 60, 2)
    np.testing.assert_allclose(found, whole[: len(found)], atol=1e-9)


def test_a_shaft_that_turns_back_is_refused(tmp_path: Path) -> None:
    half = len(TIME) // 2
    back = np.concatenate([CHANNELS["B"][:half], wheel(16, late=0.25)[half:]])
    odd = Log.from_arrays({**CHANNELS, "B": back}, rate_hz=RATE_HZ, units={"U_set": "rpm"})
    with pytest.raises(
        InputError, match=r"window 'W': channels\.speed and its quadrature change order at [67]\."
    ):
        process(odd, trial(tmp_path, TABLES["quadrature"]))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('column = "x"\nunit = "counts"\nshaft = "engine"', "speed.counts_per_rev: found nothing"),
        ('kind = "speed"\ncolumn = "x"\nunit = "kg"', "speed.unit: found 'kg', expected one of rpm"),
        ('column = "x"\nunit = "%"', r"speed.calibration: found nothing, expected channel 'x' from % to rpm: \{"),
        ('column = "x"\nunit = "%"\ncalibration = "to be given"', r"calibration: found 'to be .* from % to rpm"),
        ('kind = "speed"\ncolumn = "x"\nunit = "V"', "speed.calibration: found nothing"),
        ('column = "x"\nshaft = "engine"', "speed.pulses_per_rev: found nothing"),
        ('file = "none.csv"\npulses_per_rev = 4\nshaft = "engine"', "none.csv: no such file, expected a list of edges"),
        ('column = "pulses"\npulses_per_rev = 1\nshaft = "engine"', r"wrong by 4\? check pulses_per_rev"),
        ('column = "pulses"\npulses_per_rev = 4\nshaft = "propeller"', "check shaft of the pulse trains"),
        ('column = "x"\npulses_per_rev = 4\nmissing = 2\nshaft = "engine"', "speed.missing: found 2"),
    ],
)  # fmt: skip
def test_a_slip_in_a_source_is_named(table: str, message: str, log: Log, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        process(log, trial(tmp_path, table))


def test_a_mean_over_more_than_a_sample_is_undone(tmp_path: Path) -> None:
    """A swing of 5 Hz, each sample the mean over 20 ms before it, told every 10 ms."""
    rate, frequency, mean = 100.0, 5.0, 0.02
    time = np.arange(3000) / rate
    less = np.sinc(frequency * mean)
    rpm = 1200.0 + 10.0 * less * np.sin(2.0 * np.pi * frequency * (time - 0.5 * mean))
    log = Log.from_arrays({"n": rpm, "U_set": np.full(len(time), 1200.0)}, rate_hz=rate)

    def height(extra: str) -> float:
        table = f'column = "n"\nunit = "rpm"\ndelay_s = {0.5 * mean}\n{extra}'
        described = trial(tmp_path, table, n_e_rpm=1200.0, rate_hz=50.0, window=(2.0, 28.0), speed="best")
        told = process(log, described)[0].signals["n_e"] - 1200.0
        return float(np.sqrt(2.0 * np.nanmean(told**2))) / 10.0

    assert height("") < 0.99
    assert abs(height(f"mean_s = {mean}") - 1.0) < 2e-3


@pytest.mark.parametrize(("rate_hz", "held"), [(10.0, 1), (20.0, 1), (50.0, 1), (50.0, 5), (100.0, 5)])
def test_spikes_of_a_slow_or_held_speed_are_masked_and_nothing_after_a_step(
    rate_hz: float, held: int, tmp_path: Path
) -> None:
    """The frequency of a generator, as a power analyser tells it, behind steps of the set point."""
    time, draw = np.arange(round(300.0 * rate_hz)) / rate_hz, np.random.default_rng(3)
    steps = np.arange(10.0, 295.0, 15.0)
    answers = np.array([-np.expm1(-np.maximum(time - at, 0.0) / 0.15) for at in steps])
    signs = np.resize([1.0, -1.0], len(steps))
    asked = 1500.0 + 60.0 * signs @ (time > steps[:, None])
    frequency = 50.0 + 2.0 * signs @ answers + draw.normal(0.0, 0.01, len(time))
    sound = np.repeat(frequency[::held], held)[: len(time)]
    struck = sound.copy()
    starts = held * (np.linspace(8.0, 285.0, 12) * rate_hz / held).astype(int)
    for place, start in enumerate(starts):
        struck[start : start + held] *= 1.08 if place % 2 else 0.92
    table = 'column = "f"\nunit = "Hz"\npole_pairs = 2'
    found = []
    for values in (sound, struck):
        log = Log.from_arrays(
            {"U_set": asked, "f": values}, rate_hz=rate_hz, units={"U_set": "rpm", "f": "Hz"}
        )
        described = trial(tmp_path, table, n_e_rpm=1500.0, rate_hz=min(rate_hz, 50.0), window=(3.0, 295.0))
        found.append(process(log, described))
    told = [[f["spans"] for f in one[0].provenance["faults"] if f["channel"] == "f"] for one in found]
    assert told == [[], [[[start, start + held] for start in starts.tolist()]]]
