"""What goes into a raw log comes out of `process`: the ship's own signals, each fault repaired and on record."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy import signal

from shipfp_rs import signals
from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.logs.log import Log
from shipfp_rs.processing import conditioning
from shipfp_rs.processing.process import process
from shipfp_rs.processing.trial import Trial
from shipfp_rs.simulation.raw_log import Kind, Sensors, Truth, simulate_raw_log, trial_toml
from shipfp_rs.support.arrays import clipped_to, marks
from shipfp_rs.vessel.vessel import Vessel
from tests.logger_files import altered

TUG = Vessel.load("stan-tug-1205")
CLEAN = Sensors(set_point_noise_V=0.0, torque_noise_V=0.0, pulse_noise_V=0.0, ripple_Nm=(0.0, 0.0, 0.0, 0.0))
EXCITATIONS = [
    signals.chirp(0.05, 2.0, 60.0, 76.0, rate_hz=500.0),
    signals.steps([60.0, -60.0, -60.0], 8.0, rate_hz=500.0),
]


def recorded(
    sensors: Sensors, strikes: tuple[Kind, ...], excitations: Any = EXCITATIONS, seed: int = 2
) -> tuple[Log, Truth]:
    return simulate_raw_log(
        TUG, excitations, sensors=sensors, faults=strikes, steady_s=30.0, pause_s=10.0, seed=seed
    )


def trial_of(truth: Truth, tmp_path: Path, edits: Sequence[tuple[str, str]] = ()) -> Trial:
    """Return the simulated log's trial; `edits` are pairs of old and new text."""
    text = trial_toml("stan-tug-1205", "run.parquet", Sensors(), truth).replace(
        "rate_hz = 50.0", "rate_hz = 200.0"
    )
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "TRIAL.toml").write_text(text)
    return Trial.load(tmp_path / "TRIAL.toml")


def below_2_hz(values: np.ndarray, rate_hz: float) -> np.ndarray:
    return signal.sosfiltfilt(signal.butter(4, 2.0, fs=rate_hz, output="sos"), np.nan_to_num(values))


def slow_error(truth: Truth, experiment: Experiment, name: str) -> np.ndarray:
    """Return signal less truth, both below 2 Hz, without two seconds at either end."""
    rate, end = experiment.rate_hz, round(2.0 * experiment.rate_hz)
    values = experiment.signals[name]
    known = np.flatnonzero(np.isfinite(values))
    ours = below_2_hz(np.interp(np.arange(len(values)), known, values[known]), rate)
    first = round(experiment.provenance["window_s"][0] * truth.clean.rate_hz)
    stride = round(truth.clean.rate_hz / rate)
    true = below_2_hz(truth.clean.signals[name], truth.clean.rate_hz)[first::stride][: len(ours)]
    return (ours - true)[end:-end]


def faults(experiment: Experiment) -> dict[tuple[str, str], Any]:
    return {(f["kind"], f["channel"]): f for f in experiment.provenance["faults"]}


def within(spans_s: np.ndarray, window_s: list[float]) -> np.ndarray:
    return spans_s[(spans_s[:, 0] >= window_s[0]) & (spans_s[:, 0] < window_s[1])]


class Processed(NamedTuple):
    """A raw log, what is true of it, and its experiments."""

    log: Log
    truth: Truth
    experiments: list[Experiment]


@pytest.fixture(scope="module")
def processed(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Processed]:
    def of(sensors: Sensors, *strikes: Kind) -> Processed:
        log, truth = recorded(sensors, strikes)
        return Processed(log, truth, process(log, trial_of(truth, tmp_path_factory.mktemp("trial"))))

    return of


@pytest.fixture(scope="module")
def clean(processed: Callable[..., Processed]) -> Processed:
    return processed(CLEAN)


@pytest.fixture(scope="module")
def real(processed: Callable[..., Processed]) -> Processed:
    return processed(Sensors(), "A", "B", "C", "D1")


@pytest.fixture(scope="module")
def sound(processed: Callable[..., Processed]) -> Processed:
    return processed(Sensors())


def test_a_steady_shaft_is_told_exactly(tmp_path: Path) -> None:
    rest = signals.Excitation("rest", "steady", 100.0, np.zeros(3000))
    log, truth = recorded(CLEAN, (), rest)
    (experiment,) = process(log, trial_of(truth, tmp_path))
    # Edges of 1.5 ms sampled at 2 kHz are straight lines: single precision of the volts is all that is lost.
    assert experiment.signals["n_e"] == pytest.approx(1183.8, abs=1e-3)
    assert experiment.signals["n_set"] == pytest.approx(1183.8, abs=1e-3)
    assert experiment.signals["M_g"] == pytest.approx(1725.0, abs=1e-2)
    assert experiment.operating_point["n_e"] == pytest.approx(1183.8, abs=1e-3)


def test_edges_between_two_samples_limit_speed_as_the_sampling_says(tmp_path: Path) -> None:
    rest = signals.Excitation("rest", "steady", 100.0, np.zeros(6000))
    sensors = dataclasses.replace(CLEAN, edge_s=0.0)
    log, truth = recorded(sensors, (), rest)
    (experiment,) = process(log, trial_of(truth, tmp_path))
    error = experiment.signals["n_e"] / 1183.8 - 1.0
    # Each edge is off by Ts / sqrt(12); what that makes of the slope of the angle up to half the pulse rate.
    pulse_hz = 4 * 1183.8 / 60.0 / 3.82
    largest = 2 * np.pi * (pulse_hz / 2) / np.sqrt(3) / (2000.0 * np.sqrt(12.0))
    assert np.sqrt(np.mean(error**2)) < largest
    assert abs(error.mean()) < 1e-5


def test_signals_keep_gain_and_phase(clean: Processed) -> None:
    truth = clean.truth
    for experiment in clean.experiments:
        for name in ("n_set", "n_e", "M_g"):
            swing = np.ptp(experiment.signals[name])
            assert np.abs(slow_error(truth, experiment, name)).max() < 1e-3 * swing, name


def test_a_real_log_gives_the_plants_signals_within_stated_bounds(real: Processed) -> None:
    truth, sensors = real.truth, Sensors()
    for experiment in real.experiments:
        error = {name: slow_error(truth, experiment, name) for name in ("n_set", "n_e", "M_g")}
        assert np.abs(error["n_e"]).max() < 5e-4 * 1183.8
        # The share of the noise that lies below 2 Hz; Butterworth noise bandwidths are a few percent wider.
        telemetry = sensors.torque_noise_V * sensors.torque.scale * np.sqrt(2.0 / sensors.telemetry_hz)
        assert error["M_g"].std() < 1.5 * telemetry
        assert error["n_set"].std() < 1.0


def test_relay_jumps_are_bridged(real: Processed, sound: Processed) -> None:
    for experiment, reference in zip(real.experiments, sound.experiments, strict=True):
        true = within(real.truth.faults["D1"]["U_setpoint"], experiment.provenance["window_s"])
        assert faults(experiment)["D1", "U_setpoint"]["count"] == len(true) > 0
        assert ("D1", "U_setpoint") not in faults(reference)
        # A jump is 250 rpm or more; what stays is a chirp's bend over 40 ms.
        difference = experiment.signals["n_set"] - reference.signals["n_set"]
        assert np.abs(difference).max() < 8.0


def test_mains_hum_leaves_nothing_about_relay_jumps(tmp_path: Path) -> None:
    still, humming = recorded(Sensors(), ("D1",)), recorded(Sensors(), ("D1", "D2"))
    reference, chirp = (process(log, trial_of(truth, tmp_path))[0] for log, truth in (still, humming))
    assert faults(chirp)["D1", "U_setpoint"]["count"] == faults(reference)["D1", "U_setpoint"]["count"] > 0
    difference = below_2_hz(chirp.signals["n_set"] - reference.signals["n_set"], chirp.rate_hz)
    inner = slice(100, -100)  # the hum begins and ends with the chirp, between blocks
    assert np.std(difference[inner]) < 0.02  # rpm, of 76


def test_double_crossings_leave_no_trace_in_the_speed(sound: Processed, tmp_path: Path) -> None:
    log, truth = recorded(Sensors(), ("A",))
    for experiment, reference in zip(process(log, trial_of(truth, tmp_path)), sound.experiments, strict=True):
        train = experiment.provenance["speed"]["train"]
        assert faults(experiment)["A", train]["count"] > 0
        # Levels are found anew only where a window is not like the one before, so those of the two logs differ by a part
        # of the noise; a third of the deviation of a single interval's speed.
        assert np.nanmax(np.abs(experiment.signals["n_e"] - reference.signals["n_e"])) < 0.1


def test_a_steps_kick_is_no_fault(sound: Processed, clean: Processed) -> None:
    for experiment in (*sound.experiments, *clean.experiments):
        assert faults(experiment) == {}


def test_the_train_with_most_good_intervals_is_taken(real: Processed) -> None:
    truth, account = real.truth, real.experiments[0].provenance["speed"]
    assert account["train"] == "PTM_4"
    assert account["bandwidth_hz"] == pytest.approx(0.5 * 4 * 1183.8 / 60 / 3.82, rel=0.05)
    true = np.diff(np.append(truth.reflector_angles["PTM_4"], 1.0))
    assert min(np.abs(account["reflectors"]["fractions"] - np.roll(true, k)).max() for k in range(4)) < 1e-4
    medians = list(account["median_rpm"].values())
    assert max(medians) / min(medians) - 1 < 1e-3


FUSED = [("rate_hz = 200.0", 'rate_hz = 200.0\nspeed = "fused"')]


def test_all_trains_together_tell_the_speed_better_than_the_best_one_and_how_well(tmp_path: Path) -> None:
    sensors = dataclasses.replace(CLEAN, edge_s=0.0)
    log, truth = recorded(sensors, (), signals.chirp(0.05, 1.0, 60.0, 40.0, rate_hz=500.0))
    ways = [process(log, trial_of(truth, tmp_path, edits))[0] for edits in ([], FUSED)]
    best, fused = (np.sqrt(np.mean(slow_error(truth, way, "n_e") ** 2)) for way in ways)
    assert fused < 0.9 * best
    account = ways[1].provenance["speed"]
    assert all(train["agrees"] for train in account["fused"].values())
    assert account["fused"]["PTM_e"]["ratio"][0] == pytest.approx(3.82, rel=1e-4)
    first, stride = round(truth.windows[0].start_s * truth.clean.rate_hz), round(truth.clean.rate_hz / 200.0)
    speed = ways[1].signals["n_e"]
    error = speed - truth.clean.signals["n_e"][first::stride][: len(speed)]
    assert np.sqrt(np.mean(error[400:-400] ** 2)) == pytest.approx(account["std_rpm"], rel=0.4)


def test_a_fused_speed_keeps_the_bounds_and_the_gaps(real: Processed, tmp_path: Path) -> None:
    log, truth, _ = real
    for best, fused in zip(real.experiments, process(log, trial_of(truth, tmp_path, FUSED)), strict=True):
        assert np.abs(slow_error(truth, fused, "n_e")).max() < 2.0
        assert fused.provenance["faults"] == best.provenance["faults"]
        assert np.count_nonzero(np.isnan(fused.signals["n_e"])) <= np.count_nonzero(
            np.isnan(best.signals["n_e"])
        )


def test_operating_point_is_the_steady_mean_unless_given(real: Processed, tmp_path: Path) -> None:
    log, truth, _ = real
    auto = real.experiments[0].operating_point
    assert auto["n_e"] == pytest.approx(1183.8, rel=1e-4)
    assert auto["M_g"] == pytest.approx(1725.0, rel=2e-3)
    edits = [('n_e_rpm = "auto"', "n_e_rpm = 1180.0"), ('M_Nm = "auto"', "M_Nm = 1700.0")]
    given = process(log, trial_of(truth, tmp_path, edits=edits))[0].operating_point
    assert dict(given) == {"n_set": 1180.0, "n_e": 1180.0, "M_g": 1700.0}
    with pytest.raises(
        InputError, match=r"operating_point\.n_e_rpm: found 1100, expected the 118\d\.\d rpm of steady_s"
    ):
        process(log, trial_of(truth, tmp_path, edits=[('n_e_rpm = "auto"', "n_e_rpm = 1100.0")]))


@pytest.mark.parametrize(("location", "name"), [("brake", "M_b"), ("shaft", "M_s")])
def test_the_torque_is_named_by_its_place(sound: Processed, tmp_path: Path, location: str, name: str) -> None:
    log, truth, _ = sound
    edits = [('location = "gauge"', f'location = "{location}"')]
    if location == "brake":
        edits.append(("scale = 1059.0", "scale = 277.0"))
    experiment = process(log, trial_of(truth, tmp_path, edits=edits))[0]
    assert set(experiment.signals) == {"n_set", "n_e", name}


def test_a_wrong_rate_of_a_log_without_times_is_named(sound: Processed, tmp_path: Path) -> None:
    log, truth, _ = sound
    for rate_hz, edits, said in (
        (4000.0, [], "is empty or outside"),
        (1300.0, [], "where the engine turns 769.5 rpm"),
        (2000.0, [("steady_s = [0.0, 30.0]", "steady_s = [0.0, 80.0]")], "the set point varies by"),
    ):
        fast = Log.from_arrays(
            {name: log.read(name) for name in log.channels}, rate_hz=rate_hz, units={"U_torque": "V"}
        )
        given = [("log = ", f"rate_hz = {rate_hz}\nlog = "), *edits]
        with pytest.raises(InputError, match=rf"{said}.*trial\.rate_hz, {rate_hz:g}, the logger's"):
            process(fast, trial_of(truth, tmp_path, edits=given))


def test_pieces_make_no_difference(real: Processed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording, truth, _ = real
    log = altered(recording, {"U_torque": (slice(100_000, 115_000), np.nan)})
    trial = trial_of(truth, tmp_path)
    whole = process(log, trial)
    assert faults(whole[0])["gap", "U_torque"]["spans"] == [[100_000, 115_000]]
    monkeypatch.setattr(conditioning, "PIECE", 7000)
    for experiment, reference in zip(process(log, trial), whole, strict=True):
        assert faults(experiment) == faults(reference)
        for name, values in reference.signals.items():
            # Beside a gap the bridge ends where the piece does, and a side lobe of the filter sees it.
            np.testing.assert_allclose(experiment.signals[name], values, atol=1e-3)


def test_the_answer_is_the_same_bits_however_the_log_is_read(real: Processed, tmp_path: Path) -> None:
    recording, truth, _ = real
    log = Log.open(recording.write(tmp_path / "run.parquet"))
    trial = trial_of(truth, tmp_path)
    for reference, *others in zip(
        real.experiments, *(process(log, trial, chunk=chunk) for chunk in (1000, 1 << 20)), strict=True
    ):
        for experiment in others:
            assert faults(experiment) == faults(reference)
            assert experiment.operating_point == reference.operating_point
            for name, values in reference.signals.items():
                np.testing.assert_array_equal(experiment.signals[name], values)


def test_windows_in_any_order_and_one_within_another(real: Processed, tmp_path: Path) -> None:
    log, truth, _ = real
    trial = trial_of(truth, tmp_path)
    first, second = trial.windows
    inner = first.model_copy(
        update={"name": "inner", "start_s": first.start_s + 10.0, "stop_s": first.stop_s - 10.0}
    )
    shuffled = trial.model_copy(update={"windows": (second, inner, first)})
    whole = {experiment.name: experiment for experiment in real.experiments}
    for experiment in process(log, shuffled):
        reference = whole.get(experiment.name) or whole[first.name].window(
            10.0, first.stop_s - first.start_s - 10.0
        )
        for name in ("n_set", "n_e"):
            # A relay jump is bridged to the sample or to the next; that moves the line by a part of a rpm.
            np.testing.assert_allclose(experiment.signals[name], reference.signals[name], atol=0.5)


def test_channels_of_other_rates_and_starts_are_aligned(clean: Processed, tmp_path: Path) -> None:
    log, truth, _ = clean
    time = truth.clean.time
    faster = np.arange(0.5, time[-1], 1.0 / 5000.0)
    volts = np.interp(faster, time, truth.clean.signals["M_g"]) / 1059.0
    other = Log.from_arrays({"U_torque": volts}, rate_hz=5000.0, units={"U_torque": "V"}, start_s=0.5)
    channels = {**log.channels, **other.channels}
    mixed = Log(
        "mixed",
        list(channels.values()),
        lambda name, first, size: (other if name == "U_torque" else log)._blocks(name, first, size),
    )
    trial = trial_of(truth, tmp_path, edits=[("steady_s = [0.0", "steady_s = [1.0")])
    for experiment, reference in zip(process(mixed, trial), process(log, trial), strict=True):
        # The same low-pass at two rates: its passband ripple is 1e-4, and a step's kick reaches its edge.
        difference = experiment.signals["M_g"] - reference.signals["M_g"]
        assert np.abs(difference).max() < 0.5
        assert np.abs(below_2_hz(difference, 200.0)[400:-400]).max() < 0.05


def test_a_gap_in_torque_or_pulses_is_masked_and_on_record(sound: Processed, tmp_path: Path) -> None:
    log, truth, _ = sound
    first = round((truth.windows[0].start_s + 20.0) * 2000.0)
    lost = dict.fromkeys(("PTM_1", "PTM_4", "PTM_e"), (slice(first + 8000, first + 10_000), np.nan))
    lost["U_torque"] = (slice(first, first + 3000), np.nan)
    experiment = process(altered(log, lost), trial_of(truth, tmp_path))[0]
    torque, speed = (np.isnan(experiment.signals[name]) for name in ("M_g", "n_e"))
    assert torque[4000:4300].all()
    assert not torque[:3995].any()
    assert not torque[4305:].any()
    assert speed[4800:5000].all()
    assert not speed[:4770].any()
    assert not speed[5030:].any()
    assert faults(experiment)["gap", "U_torque"]["spans"] == [[first, first + 3000]]
    assert faults(experiment)["gap", "PTM_4"]["spans"] == [[first + 8000, first + 10000]]


def test_an_odd_rate_becomes_the_nearest_simple_part(sound: Processed, tmp_path: Path) -> None:
    log, truth, _ = sound
    edits = [("rate_hz = 200.0", "rate_hz = 49.99")]
    experiment = process(log, trial_of(truth, tmp_path, edits=edits))[0]
    assert experiment.rate_hz == 50.0
    assert len(experiment) == 50 * 60


def test_speed_alone_is_an_experiment(sound: Processed, tmp_path: Path) -> None:
    log, truth, _ = sound
    text = trial_toml("stan-tug-1205", "run.parquet", Sensors(), truth)
    text = text[: text.index("[channels.torque]")] + text[text.index("[channels.PTM_1]") :]
    (tmp_path / "TRIAL.toml").write_text(text)
    experiment = process(log, Trial.load(tmp_path / "TRIAL.toml"))[0]
    assert set(experiment.signals) == set(experiment.operating_point) == {"n_set", "n_e"}


@pytest.mark.parametrize(
    ("edits", "message"),
    [
        ([('column = "U_torque"', 'column = "torque"')],
         "channels.torque.column: .*no channel 'torque', found .*did you mean 'U_torque'"),
        ([('column = "PTM_1"', 'column = "PTM_2"')], "channels.PTM_1.column: .*no channel 'PTM_2'"),
        ([('unit = "V"', 'unit = "mV"')], "channel 'U_setpoint' is in 'V', channels.set_point.unit says 'mV'"),
        ([("scale = 1059.0", "scale = 1.059")], "channels.torque: 1.72.* Nm on average.*kNm for Nm\\?"),
        ([("scale = -251.38", "scale = -4.18967"), ("offset = -85.29", "offset = -1.4215")],
         "channels.set_point: 19.7.* rpm on average.*rev/s for rpm\\?"),
        ([("scale = -251.38", "scale = -200.0")], "channels.set_point: 924.* rpm on average"),
        ([("start_s = 30.0", "start_s = 30000.0"), ("stop_s = 90.0", "stop_s = 30100.0")], "'chirp'.*runs from 0 to"),
        ([("stop_s = 90.0", "stop_s = 30.004")], "window 'chirp': 30 to 30.004 s hold 0 samples at 200 Hz"),
        ([("pulses_per_rev = 4", "pulses_per_rev = 3")], "'PTM_4' .* check pulses_per_rev|check pulses_per_rev"),
        ([('shaft = "engine"', 'shaft = "propeller"')], "check pulses_per_rev, shaft and the gear ratio"),
        ([("steady_s = [0.0, 30.0]", "steady_s = [30.0, 90.0]")], "steady_s: the set point varies by 4"),
        ([("steady_s = [0.0, 30.0]", "steady_s = [0.0, 3000.0]")], "operating_point.steady_s: .*runs from 0 to"),
        ([("rate_hz = 200.0", "rate_hz = 3000.0")], "processing.rate_hz is 3000"),
    ],
)  # fmt: skip
def test_trials_that_can_t_be_right_are_refused_in_one_line(
    sound: Processed, tmp_path: Path, edits: list[tuple[str, str]], message: str
) -> None:
    log, truth, _ = sound
    with pytest.raises(InputError, match=message) as caught:
        process(log, trial_of(truth, tmp_path, edits=edits))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("channel", "samples", "value", "message"),
    [
        ("U_setpoint", slice(100_000, 100_800), np.nan,
         r"set point 'U_setpoint' has a fault, missing samples, from 50 to 50.4 s \(samples 100000 to 100799\)"),
        ("U_torque", slice(None), np.nan, "all samples of 'M_g' are masked"),
        ("PTM_4", slice(None), np.nan, "channels.PTM_4"),
        ("PTM_4", slice(None), 0.0, r"channels\.PTM_4, .* constant at 0"),
    ],
)  # fmt: skip
def test_logs_without_the_samples_needed_are_refused(
    sound: Processed, tmp_path: Path, channel: str, samples: slice, value: float, message: str
) -> None:
    log, truth, _ = sound
    with pytest.raises(InputError, match=message) as caught:
        process(altered(log, {channel: (samples, value)}), trial_of(truth, tmp_path))
    assert "\n" not in str(caught.value)


def test_windows_may_be_about_their_own_means_and_free_of_drift(sound: Processed, tmp_path: Path) -> None:
    log, truth, _ = sound
    arrays = {name: log.read(name).copy() for name in log.channels}
    arrays["U_torque"] += np.linspace(0.0, 0.1, len(arrays["U_torque"]), dtype=np.float32)
    drifting = Log.from_arrays(arrays, rate_hz=2000.0)
    plain = process(drifting, trial_of(truth, tmp_path))[0]
    edits = [("rate_hz = 200.0", 'rate_hz = 200.0\nnormalise = "local"\ndetrend = 1')]
    local, stairs = process(drifting, trial_of(truth, tmp_path, edits=edits))
    assert (local.provenance["detrend"], stairs.provenance["detrend"]) == (1, 0), "a stair is a trend itself"
    assert local.operating_point["M_g"] == pytest.approx(np.nanmean(plain.signals["M_g"]))
    assert local.provenance["normalise"] == "local"
    drift = plain.signals["M_g"] - local.signals["M_g"]
    expected = 0.1 * 1059.0 * plain.duration / (len(arrays["U_torque"]) / 2000.0)
    # The answer to a chirp's slow beginning looks a little like drift, as a share of its swing.
    assert drift[-1] - drift[0] == pytest.approx(expected, abs=0.04 * np.ptp(plain.signals["M_g"]))
    assert drift[-1] - drift[0] > 0.5 * expected


KINDS_OF_CHANNEL = {
    **dict.fromkeys(("A", "B"), "PTM_4"),
    **dict.fromkeys(("C", "gap", "dropout", "stuck", "clipped"), "U_torque"),
    **dict.fromkeys(("D1", "D2", "D3", "repeated"), "U_setpoint"),
}
ANSWERS = {"U_setpoint": ["n_e", "M_g"], "U_torque": ["M_g"], "PTM_4": ["n_e"]}
"""Signals that no fit may see where a channel has a fault: what the set point asks for is answered by both."""


@pytest.mark.parametrize(("kind", "channel"), KINDS_OF_CHANNEL.items())
def test_every_kind_of_fault_is_told_with_its_samples_and_no_fit_sees_them(
    kind: Kind, channel: str, tmp_path: Path
) -> None:
    log, truth = recorded(Sensors(), (kind,), EXCITATIONS[:1], seed=5)
    volts = log.read(channel)
    told = 0
    for experiment in process(log, trial_of(truth, tmp_path)):
        start_s, stop_s = experiment.provenance["window_s"]
        true = np.rint(truth.faults[kind][channel] * 2000.0).astype(np.int64)
        true = clipped_to(true, round(start_s * 2000.0), round(stop_s * 2000.0))
        spans = faults(experiment).get((kind, channel), {"spans": []})["spans"]
        inside = marks(np.array(spans, dtype=np.int64).reshape(-1, 2), 0, log.channel(channel).samples)
        for first, stop in true.tolist():
            # A double crossing that stays above the lower threshold, at 0.3 of -0.1 to 5.1 V, never was one.
            swallowed = kind == "A" and volts[first:stop].min() > -0.1 + 0.3 * 5.2
            assert swallowed or inside[first:stop].all(), f"{kind} at {first} to {stop}"
        assert kind not in ("B", "C") or len(spans) == len(true) > 0
        told += len(spans)
        if kind in ("D2", "D3"):  # what hum touches is mended, and a chirp that stands is no loss
            continue
        for fault in experiment.provenance["faults"]:
            assert fault["excluded"]
            at = (np.array(fault["spans"]) / 2000.0 - start_s) * experiment.rate_hz
            within_span = np.column_stack([np.ceil(at[:, 0]), np.floor(at[:, 1])]).astype(np.int64)
            touched = marks(within_span, 0, len(experiment))
            for name in ANSWERS.get(fault["channel"], []):
                assert np.isnan(experiment.signals[name][touched]).all()
        assert np.isfinite(experiment.signals["n_set"]).all(), "the model is driven all along"
        assert max(np.isnan(experiment.signals[name]).mean() for name in ("n_e", "M_g")) < 0.07
    assert told > 0
