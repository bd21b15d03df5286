"""Plans of trials: optimal spectra, limits kept, null directions named, files for crew and signal generator."""

from __future__ import annotations

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest

import shipfp_rs as fp
from shipfp_rs import cli
from shipfp_rs.designs import Generator, Noise, Subject, predict
from shipfp_rs.designs import subject as subjects
from shipfp_rs.designs.plan import Plan
from shipfp_rs.designs.spectrum import Lines, candidates, optimal_shares
from shipfp_rs.designs.subject import sensors_of
from shipfp_rs.designs.waveforms import steepest_rpm_s
from shipfp_rs.identification.identifiability import Sensitivity
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.units import Calibration

TUG = "stan-tug-1205"
CALIBRATION = Calibration(-251.38, -85.29, "rpm")  # eq. 6.7


def tug_lines(frequency: np.ndarray) -> Lines:
    subject = Subject.of(TUG, None, None)
    noises = sensors_of(None, subject.signals)
    return candidates(subject, noises, frequency, np.full(len(frequency), 76.0), 100.0)


class TestOptimalShares:
    def test_a_straight_line_is_measured_at_its_ends(self) -> None:
        # The textbook D-optimal design for a straight line: half of the measurements at each end.
        places = np.linspace(-1.0, 1.0, 21)
        rows = np.stack([np.ones(21), places], axis=1)
        lines = Lines(
            np.arange(1.0, 22.0),
            np.ones(21),
            rows[:, :, None] * rows[:, None, :],
            np.eye(2),
            Sensitivity.of(rows, ("a", "b"), np.ones(2)),
        )
        shares, efficiency = optimal_shares(lines, "D")
        assert efficiency > 0.999
        assert shares[[0, -1]] == pytest.approx(0.5, abs=0.01)

    @pytest.mark.parametrize("criterion", ["D", "A"])
    def test_no_other_shares_are_better(self, criterion) -> None:
        lines = tug_lines(np.geomspace(0.005, 5.0, 60))
        shares, _ = optimal_shares(lines, criterion)
        others = np.random.default_rng(1).dirichlet(np.full(60, 0.1), 300)
        best = lines.cost(shares, criterion)
        assert best <= 1.001 * lines.cost(others, criterion).min()
        mixed = 0.9 * shares + 0.1 * others
        assert best <= 1.001 * lines.cost(mixed, criterion).min()

    def test_information_of_a_line_is_that_of_a_long_sine(self) -> None:
        # The frequency formula against the kernel's sensitivities in time, once the transient has died away.
        frequency, rate, seconds = 0.5, 100.0, 200.0
        subject = Subject.of(TUG, None, None)
        noises = sensors_of(None, subject.signals)
        lines = tug_lines(np.array([frequency]))
        sine = fp.signals.sine_sequence([frequency], 2 * seconds * frequency, 76.0, rate_hz=rate)
        prediction_of = subject.structure.equations.sensitivities(
            subject.values, subject.respond(sine), subject.free
        )[1][:, :, -round(seconds * rate) :]
        total = 0.0
        for index, output in enumerate(subject.structure.outputs):
            correlation = noises[output].correlation(rate)
            part = prediction_of[:, index, 1:] - correlation * prediction_of[:, index, :-1]
            total = total + part @ part.T / noises[output].innovation(rate) ** 2
        told = lines.sensitivity.right[: lines.sensitivity.rank] * subject.scale
        expected = lines.information[0]
        assert told @ total @ told.T / seconds == pytest.approx(expected, abs=1e-3 * expected.max())


class TestPlan:
    @pytest.mark.parametrize("kind", ["sines", "multisine", "chirp", "mix"])
    def test_the_waveform_keeps_to_amplitude_rate_of_change_and_time(self, kind) -> None:
        plan = fp.design(TUG, duration_s=240.0, amplitude_rpm=50.0, rate_rpm_s=60.0, kind=kind)
        assert plan.excitation.amplitude_rpm <= 50.0 * (1.0 + 1e-9)
        assert steepest_rpm_s(plan.excitation) <= 60.0 * (1.0 + 1e-9)
        assert plan.excitation.duration <= 240.0
        assert plan.excitation.samples[0] == plan.excitation.samples[-1] == 0.0

    @pytest.mark.parametrize("kind", ["sines", "multisine", "chirp", "mix"])
    def test_bands_around_resonances_are_left_out(self, kind) -> None:
        free = fp.design(TUG, duration_s=400.0, amplitude_rpm=50.0, kind=kind)
        # Around a line that the plan would use.
        line = max(free.spectrum)[0]
        band = (0.8 * line, 1.25 * line)
        plan = fp.design(TUG, duration_s=400.0, amplitude_rpm=50.0, kind=kind, avoid_hz=[band])
        assert not any(band[0] <= frequency <= band[1] for frequency, _ in plan.spectrum)
        # What begins and ends has side lobes: some of a line beside the band, or of a step, leaks in.
        assert plan.excitation.power_in(*band) < 0.06
        assert plan.excitation.power_in(*band) < 0.2 * free.excitation.power_in(*band)

    def test_a_band_above_all_that_is_used_changes_nothing(self) -> None:
        free, kept = (
            fp.signals.chirp(0.1, 1.0, 20.0, 13.0, avoid_hz=bands) for bands in ((), ((1.2, 1.5), (3.0, 4.0)))
        )
        assert np.array_equal(free.samples, kept.samples)

    def test_a_short_waveform_lowers_the_sample_rate(self) -> None:
        plan = fp.design(TUG, duration_s=300.0, amplitude_rpm=50.0, longest_samples=8192)
        assert len(plan.excitation) <= 8192
        assert plan.excitation.rate_hz == 20.0
        assert any("nothing above 2 Hz" in note for note in plan.notes)

    def test_what_small_motions_tell_is_designed_for_and_the_rest_named(self) -> None:
        plan = fp.design(TUG, duration_s=200.0, amplitude_rpm=76.0)
        assert {"p", "tau_prop", "vK_p/tau_n"} <= set(plan.designed_for)
        assert "tau_n" not in plan.designed_for
        # Behind a gauge the whole inertia follows from the curvature of the propeller's law, and no better than that.
        assert plan.prediction.relative_pct["tau_n"] > 5.0 * plan.prediction.relative_pct["vK_p/tau_n"]
        assert any("tau_n, g, vK_p, vK_i follow" in note for note in plan.notes)

    def test_a_known_parameter_closes_the_gap(self) -> None:
        structure = Structure.linear(torque="gauge", products=True, free_exponent=True).with_fixed(tau_n=1.17)
        plan = fp.design(TUG, duration_s=200.0, amplitude_rpm=76.0, structure=structure)
        assert plan.prediction.identifiability.rank == plan.prediction.identifiability.free
        assert "vK_p" in plan.prediction.relative_pct

    def test_twice_the_noise_is_up_to_twice_the_deviation(self) -> None:
        quiet, loud = (
            fp.design(
                TUG,
                duration_s=200.0,
                amplitude_rpm=76.0,
                sensors={"n_e": Noise(factor * 0.002, 5.0, 0.0), "M_g": Noise(factor * 0.01, 5.0, 0.0)},
                structure=Structure.linear(torque="gauge", products=True).with_fixed(tau_n=1.17),
            ).prediction.relative_pct
            for factor in (1.0, 2.0)
        )
        for name, value in quiet.items():
            assert loud[name] == pytest.approx(2.0 * value, rel=0.02)

    def test_what_calibration_leaves_open_no_length_takes_away(self) -> None:
        with pytest.raises(fp.InputError, match="would take for ever"):
            fp.design(
                TUG,
                amplitude_rpm=76.0,
                accuracy_pct=1.0,
                parameters=["p"],
                sensors={name: Noise(0.001, 10.0, accuracy=0.1) for name in ("n_e", "M_g")},
            )

    @pytest.mark.parametrize(("kind", "settle_s"), [("mix", 10.0), ("sines", 60.0)])
    def test_an_accuracy_met_at_once_still_leaves_the_ship_time_to_settle(self, kind, settle_s) -> None:
        plan = fp.design(TUG, amplitude_rpm=76.0, accuracy_pct=50.0, kind=kind, settle_s=settle_s)
        assert plan.needed is not None
        assert plan.needed.met
        first, *_, last = plan.excitation.segments
        assert first.start_s >= settle_s - 0.02
        assert plan.excitation.duration - last.stop_s >= settle_s - 0.02

    def test_the_time_for_an_accuracy_is_found_and_kept(self) -> None:
        exact = {"n_e": Noise(0.003, 10.0, 0.0), "M_g": Noise(0.01, 10.0, 0.0)}
        plan = fp.design(TUG, amplitude_rpm=76.0, accuracy_pct=5.0, kind="sines", sensors=exact)
        assert max(plan.prediction.relative_pct[name] for name in plan.designed_for) <= 5.0
        assert plan.needed.met
        half = 0.5 * plan.excitation.duration
        shorter = fp.design(
            TUG, amplitude_rpm=76.0, accuracy_pct=5.0, duration_s=half, kind="sines", sensors=exact
        )
        assert not shorter.needed.met
        assert shorter.needed.duration_s == pytest.approx(plan.excitation.duration, rel=0.12)
        assert shorter.needed.duration_s == pytest.approx(plan.needed.duration_s, rel=0.06)

    def test_a_prediction_does_not_hang_on_the_noise_drawn(self, monkeypatch) -> None:
        # At the values expected all delays are off: a draw's slope there pressed them on their bounds, or did not.
        subject = Subject.of(TUG, None, None)
        plan = fp.design(TUG, amplitude_rpm=76.0, duration_s=300.0, kind="sines")
        found = []
        for seed in range(4):
            monkeypatch.setattr(subjects, "SEED", seed)
            found.append(predict(subject, plan.excitation, plan.sensors).relative_pct)
        for name in plan.designed_for:
            each = [one[name] for one in found]
            assert max(each) < 1.05 * min(each), name

    def test_a_fingerprint_can_be_what_is_expected(self, tmp_path) -> None:
        excitation = fp.signals.chirp(0.01, 2.0, 60.0, 39.0, rate_hz=20.0)
        experiment = fp.simulate(
            fp.Vessel.load("stan-launch-804"), excitation, noise={"n_e": 0.01, "M_b": 0.01}, seed=1
        )
        path = fp.identify(experiment, Structure.linear(products=True)).save(tmp_path / "f.json")
        plan = fp.design(path, duration_s=120.0, amplitude_rpm=13.0)
        assert plan.set_point_rpm == 1300.0
        assert plan.prediction.parameters["tau_n"].value == pytest.approx(1.51, rel=0.05)

    def test_leaving_the_engine_s_envelope_is_said(self) -> None:
        assert not any(
            "torque limit" in note for note in fp.design(TUG, duration_s=100.0, amplitude_rpm=20.0).notes
        )
        assert any(
            "torque limit" in note for note in fp.design(TUG, duration_s=100.0, amplitude_rpm=600.0).notes
        )


class TestRunSheet:
    def test_swings_are_those_of_the_response(self) -> None:
        plan = fp.design(TUG, duration_s=300.0, amplitude_rpm=76.0, kind="sines")
        subject = Subject.of(TUG, None, None)
        model = fp.linearise(fp.Vessel.load(TUG))
        sine = next(stretch for stretch in plan.sheet if stretch.frequency_hz)
        gains = np.abs(model.response(sine.frequency_hz, ("dn", "dM_g")))[:, 0]
        # The swing holds the start's transient, too.
        assert sine.speed_rpm == pytest.approx(76.0 * gains[0], rel=0.1)
        expected = 76.0 / plan.set_point_rpm * gains[1] * subject.operating_point["M_g"]
        assert sine.torque_Nm == pytest.approx(expected, rel=0.1)

    def test_the_sheet_covers_the_whole_time_in_order(self) -> None:
        plan = fp.design(TUG, duration_s=300.0, amplitude_rpm=76.0)
        starts = [stretch.start_s for stretch in plan.sheet]
        assert starts == sorted(starts)
        assert starts[0] == 0.0
        assert plan.sheet[-1].stop_s == pytest.approx(plan.excitation.duration, abs=0.05)
        assert {"hold the operating point", "steps"} <= {stretch.what for stretch in plan.sheet}


class TestGenerator:
    def test_volts_give_the_set_point_back(self) -> None:
        plan = fp.design(TUG, duration_s=100.0, amplitude_rpm=76.0)
        assert CALIBRATION(plan.volts()) == pytest.approx(1183.8 + plan.excitation.samples, abs=1e-9)
        # 0.6 V peak to peak is 76 rpm of amplitude (Table 6.7).
        assert np.ptp(plan.volts()) == pytest.approx(0.6, rel=0.02)

    def test_a_range_that_is_too_small_is_refused(self) -> None:
        with pytest.raises(fp.InputError, match=r"expected -5 to 5 V"):
            fp.design(TUG, duration_s=100.0, amplitude_rpm=76.0, generator=Generator(CALIBRATION, -5.0, 5.0))


class TestCommand:
    def test_it_writes_everything_and_prints_json(self, tmp_path, capsys) -> None:
        out = tmp_path / "plan"
        asked = "--duration 200 --amplitude 76 --accuracy 3 --json"
        assert cli.main(["design", TUG, *asked.split(), "--out", str(out)]) == 0
        printed = json.loads(capsys.readouterr().out)
        written = json.loads((out / "plan.json").read_text())
        assert printed == {"folder": str(out), **written}
        assert written["needed"]["accuracy_pct"] == 3.0
        with (out / "volts.csv").open() as file:
            rows = list(csv.DictReader(file))
        points = (out / "volts_points.csv").read_text().split()
        assert [row["volts"] for row in rows] == points
        assert len(points) == written["excitation"]["samples"]
        assert "hold the operating point" in (out / "run_sheet.txt").read_text()
        assert "<table>" in (out / "run_sheet.html").read_text()
        assert (out / "plan.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("samples", "said"), [(11_992, "10 min 0 s"), (1_189, "0 min 59 s"), (1_191, "1 min 0 s")]
)
def test_minutes_and_seconds_are_rounded_together(samples: int, said: str) -> None:
    signal = fp.signals.Excitation("sine", "sine", 20.0, np.sin(np.arange(samples) / 50.0))
    plan = SimpleNamespace(excitation=signal, volts=lambda: None, set_point_rpm=1184.0, notes=())
    assert Plan.heading(plan)[0].startswith(f"{said}, ")
