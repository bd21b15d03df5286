"""A simulated log holds what a logger aboard would have recorded, and knows the truth behind it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import Log
from shipfp_rs.processing.trial import Trial
from shipfp_rs.simulation.raw_log import Sensors, Truth, simulate_raw_log, trial_toml
from shipfp_rs.tacho import pulse_times, reflector_angles
from shipfp_rs.vessel.linear_model import linearise
from shipfp_rs.vessel.vessel import Vessel

TUG = Vessel.load("stan-tug-1205")
QUIET = Sensors(set_point_noise_V=0.0, torque_noise_V=0.0, pulse_noise_V=0.0)
RIPPLE_FREE = dataclasses.replace(QUIET, ripple_Nm=(0.0, 0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def quiet() -> tuple[Log, Truth]:
    excitation = signals.chirp(0.1, 2.0, 40.0, 76.0)
    return simulate_raw_log(TUG, excitation, sensors=QUIET, faults=(), steady_s=20.0, pause_s=5.0)


def test_pulses_stand_at_the_reflectors_places_on_the_turning_shaft(quiet: tuple[Log, Truth]) -> None:
    log, truth = quiet
    n_s, rate = truth.clean.signals["n_s"], truth.clean.rate_hz
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (n_s[1:] + n_s[:-1])) / rate])
    for name, gear in (("PTM_1", 1.0), ("PTM_4", 1.0), ("PTM_e", TUG.gearbox.ratio)):
        crossings = pulse_times(log.read(name), rate).times_s
        turned = gear * np.interp(crossings, np.arange(len(angle)) / rate, angle)
        places = truth.reflector_angles[name]
        pulses = np.arange(len(crossings))
        start = next(
            k
            for k in range(len(places))
            if np.ptp(turned - (pulses + k) // len(places) - places[(pulses + k) % len(places)]) < 1e-3
        )
        misplaced = turned - (pulses + start) // len(places) - places[(pulses + start) % len(places)]
        assert np.ptp(misplaced) < 1e-5, "one hundredth of a sample at 20 pulses a second"


def test_unequal_reflectors_are_measured_as_they_were_placed(quiet: tuple[Log, Truth]) -> None:
    log, truth = quiet
    found = reflector_angles(pulse_times(log.read("PTM_4"), 2000.0).times_s, 4)
    true = np.diff(np.append(truth.reflector_angles["PTM_4"], 1.0))
    assert min(np.abs(found.fractions - np.roll(true, k)).max() for k in range(4)) < 2e-5
    assert np.abs(4 * true - 1).max() == pytest.approx(0.02), "up to 2 % of a pitch"


def test_torque_ripples_at_shaft_blade_engine_and_firing_rate(quiet: tuple[Log, Truth]) -> None:
    log, _ = quiet
    steady = 1059.0 * log.read("U_torque", 0.0, 20.0).astype(float)
    spectrum = (
        2.0 * np.abs(np.fft.rfft((steady - steady.mean()) * np.hanning(len(steady)))) / (0.5 * len(steady))
    )
    frequency = np.fft.rfftfreq(len(steady), 1.0 / 2000.0)
    # Table 6.9 prints 5.15, 15.49, 19.68, 59.08 Hz at about 1184 rpm; at 1183.8 rpm the orders give these.
    n_s = 1183.8 / 60.0 / 3.82
    for order, amplitude in zip((1.0, 3.0, 3.82, 3 * 3.82), QUIET.ripple_Nm, strict=True):
        near = np.abs(frequency - order * n_s) < 0.5
        assert spectrum[near].max() == pytest.approx(amplitude, rel=0.2)
        assert frequency[near][spectrum[near].argmax()] == pytest.approx(order * n_s, abs=0.05)


def test_set_point_volts_are_the_inverse_of_eq_6_7(quiet: tuple[Log, Truth]) -> None:
    log, truth = quiet
    rpm = -251.38 * log.read("U_setpoint").astype(float) - 85.29
    assert rpm == pytest.approx(truth.clean.signals["n_set"], abs=1e-3)


def test_noise_has_the_size_asked_for() -> None:
    rest = signals.Excitation("rest", "steady", 100.0, np.zeros(2000))
    sensors = Sensors(ripple_Nm=(0.0,) * 4)
    log, _ = simulate_raw_log(TUG, rest, sensors=sensors, faults=())
    assert log.read("U_setpoint").std() == pytest.approx(sensors.set_point_noise_V, rel=0.05)
    assert log.read("U_torque").std() == pytest.approx(sensors.torque_noise_V, rel=0.05)


def test_a_fault_changes_nothing_but_its_own_samples() -> None:
    rest = signals.Excitation("rest", "steady", 100.0, np.zeros(6000))
    sound, _ = simulate_raw_log(TUG, rest, faults=(), seed=3)
    faulty, truth = simulate_raw_log(TUG, rest, faults=("A", "C", "D1"), seed=3)
    for channel, kind in {"U_setpoint": "D1", "U_torque": "C", "PTM_4": "A"}.items():
        changed = np.flatnonzero(sound.read(channel) != faulty.read(channel))
        true = [np.arange(*span) for span in np.rint(truth.faults[kind][channel] * 2000.0).astype(int)]
        assert len(true) == int(Sensors().faults_per_minute[kind] * truth.clean.duration / 60.0)
        np.testing.assert_array_equal(changed, np.concatenate(true))


def test_lost_pulses_are_lost() -> None:
    rest = signals.Excitation("rest", "steady", 100.0, np.zeros(6000))
    sound, _ = simulate_raw_log(TUG, rest, faults=(), seed=3)
    faulty, truth = simulate_raw_log(TUG, rest, faults=("B",), seed=3)
    all_times, times = (pulse_times(log.read("PTM_4"), 2000.0).times_s for log in (sound, faulty))
    apart = np.abs(np.subtract.outer(all_times, times)).min(axis=1)
    lost = all_times[apart > 1e-4]
    assert lost == pytest.approx(truth.faults["B"]["PTM_4"][:, 0], abs=1e-4)


def test_the_seed_decides_everything() -> None:
    chirp = signals.chirp(0.1, 1.0, 10.0, 50.0)
    first, again, other = (simulate_raw_log(TUG, chirp, seed=seed, steady_s=5.0)[0] for seed in (1, 1, 2))
    for name in first.channels:
        np.testing.assert_array_equal(first.read(name), again.read(name))
        assert (first.read(name) != other.read(name)).any()


def test_excitations_follow_one_another_each_on_its_window() -> None:
    parts = [signals.chirp(0.1, 1.0, 10.0, 50.0, rate_hz=100.0), signals.steps([40.0], 7.0, rate_hz=50.0)]
    _, truth = simulate_raw_log(TUG, parts, sensors=RIPPLE_FREE, faults=(), steady_s=20.0, pause_s=6.0)
    assert [(w.name, w.start_s, w.stop_s) for w in truth.windows] == [
        ("chirp", 20.0, 30.0),
        ("steps", 36.0, 43.0),
    ]
    n_set = truth.clean.signals["n_set"] - 1183.8
    assert not n_set[: 20 * 2000].any()
    assert n_set[20 * 2000 : 30 * 2000 : 20] == pytest.approx(parts[0].samples, abs=1e-9)
    assert n_set[36 * 2000 : 43 * 2000] == pytest.approx(40.0)


def test_the_truth_holds_the_linear_parameters_at_the_operating_point() -> None:
    rest = signals.Excitation("rest", "steady", 100.0, np.zeros(2000))
    _, truth = simulate_raw_log(TUG, rest, n_e_rpm=1000.0)
    assert truth.linear == dataclasses.asdict(linearise(TUG, 1000.0))


def test_log_and_trial_file_go_together(tmp_path: Path) -> None:
    log, truth = simulate_raw_log(TUG, signals.chirp(0.1, 1.0, 10.0, 50.0), steady_s=10.0)
    log.write(tmp_path / "run.parquet")
    (tmp_path / "TRIAL.toml").write_text(trial_toml("stan-tug-1205", "run.parquet", Sensors(), truth))
    trial = Trial.load(tmp_path / "TRIAL.toml")
    recorded = Log.open(trial.trial.log[0])
    assert {tacho.column for tacho in trial.channels.tachos.values()} <= set(recorded.channels)
    assert trial.operating_point.steady_s == (0.0, 10.0)
    assert [(w.start_s, w.stop_s) for w in trial.windows] == [(10.0, 20.0)]


def test_an_unknown_fault_is_named() -> None:
    with pytest.raises(InputError, match=r"faults\[1\] is 'Z', expected 'A', 'B', 'C', 'D1'"):
        simulate_raw_log(TUG, signals.steps([10.0], 60.0), faults=("A", "Z"))  # type: ignore[arg-type]


@pytest.mark.parametrize("excitations", [[], [signals.steps([10.0], 1.0)]])
def test_too_little_excitation_is_refused(excitations: list[signals.Excitation]) -> None:
    with pytest.raises(InputError, match="excitations"):
        simulate_raw_log(TUG, excitations, steady_s=1.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("torque_noise_V", -1.0),
        ("receiver_limit_V", 1e15),
        ("ripple_Nm", (0.0, 0.0, np.nan, 0.0)),
        ("reflector_errors", (0.0, 2.0, 0.0, 0.0)),
        ("faults_per_minute", {"A": 1e15}),
    ],
)
def test_breakage_d_sensors_that_nobody_has_are_refused(name, value) -> None:
    with pytest.raises(InputError, match=f"sensors: {name}.* is .*, expected .* to "):
        Sensors(**{name: value})
