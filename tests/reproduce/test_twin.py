"""The tug's trial on simulated ships whose parameters are known, from raw logs.

The study (`pytest -m study -k twin -s`) makes the trials of 200 ships in as many seas, each drawn, and identifies the
short chirp, in ten minutes on two cores; with TWIN_PARTS=joint also all parts together (half an hour), with
TWIN_PARTS=everything each part by itself, too (40 minutes). TWIN_DRAWS sets another number, TWIN_SEED the first seed.
"""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from scipy.stats import binom

from shipfp_rs import cli
from shipfp_rs.assessment.si import parameters_of
from shipfp_rs.identification.fingerprint import Estimate
from shipfp_rs.reproduce import twin
from shipfp_rs.reproduce.trial import LAST_HZ, PAUSE_S, STEADY_S, Twin, drawn
from shipfp_rs.reproduce.twin import ALL, CHIRP, FREE, PARTS, Outcome
from shipfp_rs.simulation.simulate import replay
from shipfp_rs.support.arrays import DEVIATIONS_95

CHOICES = {"": (CHIRP,), "joint": (CHIRP, ALL), "everything": (*PARTS, ALL)}
SEED = 80_000
"""First of the study; nothing about it was chosen while looking at these."""


@pytest.mark.study
def test_twin_study_of_many_ships_in_many_seas() -> None:
    draws, first = int(os.environ.get("TWIN_DRAWS", "200")), int(os.environ.get("TWIN_SEED", str(SEED)))
    parts = CHOICES[os.environ.get("TWIN_PARTS", "")]
    found = []
    for outcome in twin.outcomes(range(first, first + draws), parts):
        found.append(outcome)
        if len(found) % 20 == 0 or len(found) == draws:
            for part in parts:
                print(
                    f"\n{part}, {len(found)} ships",
                    *twin.table(twin.scores(found, part)),
                    f"the residuals leave the structure standing in {twin.standing(found, part):.1%}",
                    sep="\n",
                    flush=True,
                )
            if set(PARTS) <= set(parts):
                shares = ", ".join(f"{name} {share:.1%}" for name, share in agreements(found).items())
                print("\nPairs of sines, short and long chirps that agree at 95 %:", shares, flush=True)
    low, high = (binom.ppf(q, draws, 0.95) / draws for q in (1e-3, 0.999))
    for part in parts:
        assert twin.standing(found, part) >= 0.95
        for name, score in twin.scores(found, part).items():
            assert score.trials >= 0.97 * draws
            assert low <= score.inside <= high, (part, name)
            assert draws < 200 or part not in (CHIRP, ALL) or 0.92 <= score.inside <= 0.98, (part, name)
            assert score.std_pct > 3.0 or score.error_pct < 5.0, (part, name)


@pytest.fixture(scope="module")
def tug() -> Twin:
    return Twin.of(0, PARTS[CHIRP])


def test_the_short_chirp_of_raw_logs_tells_the_ship() -> None:
    found = [twin.outcome(1, (CHIRP,))]
    for name, score in twin.scores(found, CHIRP).items():
        assert score.trials == 1
        assert score.std_pct < 8.0, name
    inside = [score.inside for score in twin.scores(found, CHIRP).values()]
    assert np.mean(inside) >= 0.75


def test_the_structure_of_the_thesis_is_called_wrong_and_misses_the_truth(tug: Twin) -> None:
    fingerprint = twin.fitted_as_the_thesis(tug, CHIRP)
    bound = [name for name, estimate in fingerprint.parameters.items() if estimate.status == "at_bound"]
    missed = [
        name
        for name, estimate in fingerprint.parameters.items()
        if estimate.ci95 is not None and not estimate.ci95[0] <= tug.truth[name] <= estimate.ci95[1]
    ]
    assert fingerprint.model_adequate is False
    assert bound or missed


def test_a_log_shows_what_the_ship_did() -> None:
    """Pulses, calibrations and filters of the raw log change a simulated answer by less than a part in a thousand."""
    still = Twin.of(3, ("S11",), still=True)
    (record,) = still.experiments(("S11",), 6.25)  # without the ripple of the shaft
    answer = replay(still.vessel, record, at_the_shaft=True)
    inner = slice(None, -8)  # the low-pass looks ahead, beyond the record's end
    for name in ("n_e", "M_g"):
        difference = answer.normalised(name)[inner] - record.normalised(name)[inner]
        assert np.std(difference) < 1e-3 * np.std(record.normalised(name))


def test_faults_and_moving_water_are_in_the_log(tug: Twin) -> None:
    assert set(tug.recorded.faults) == {"A", "B", "C", "D1", "D2", "gap", "dropout"}
    (record,) = tug.experiments(PARTS[CHIRP])
    kinds = {fault["kind"] for fault in record.provenance["faults"]}
    assert {"A", "C"} <= kinds
    rest = record.window(0.0, 2.0).normalised("M_g")
    assert np.nanstd(rest) > 1e-3


def test_the_chirp_is_cut_where_it_passes_the_frequency_up_to_which_the_ship_is_linear(tug: Twin) -> None:
    (record,) = tug.experiments(PARTS[CHIRP])
    window = tug.recorded.windows[0]
    assert window.start_s == STEADY_S
    assert tug.log.channels["U_torque"].samples == pytest.approx((window.stop_s + PAUSE_S) * 2000.0, abs=20)
    last = record.normalised("n_set")[-round(5.0 * record.rate_hz) :]
    crossings = np.count_nonzero(np.diff(np.sign(last)) > 0)
    assert crossings / 5.0 == pytest.approx(LAST_HZ, abs=0.25)


@pytest.mark.slow
@pytest.mark.usefixtures("only_the_chirp")
def test_the_command_puts_the_truth_beside_both_structures(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce", "twin", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["way"] for row in found["rows"]] == ["truth", "thesis", "ours", "ours"]
    truth, ours = found["rows"][0]["parameters"], found["rows"][2]["parameters"]
    assert ours["tau_prop"] == pytest.approx(truth["tau_prop"], rel=0.05)
    assert any(line.startswith("thesis's structure") and "called wrong" in line for line in found["verdict"])
    assert any(line.startswith("Steps, by the simulated ship") for line in found["verdict"])


@pytest.fixture
def only_the_chirp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twin, "PARTS", {CHIRP: PARTS[CHIRP]})
    monkeypatch.setattr(twin, "EVERYTHING", ("C11", *twin.STEPS))


def test_ships_are_drawn_about_the_tug_and_again_the_same() -> None:
    assert drawn(5) == drawn(5)
    tug, one = (parameters_of(drawn(seed)) for seed in (0, 5))
    ratios = [one[name] / tug[name] for name in FREE]
    assert all(0.6 < ratio < 1.6 for ratio in ratios)
    assert max(abs(ratio - 1.0) for ratio in ratios) > 0.01


def agreements(found: list[Outcome]) -> dict[str, float]:
    """For each free parameter the share of pairs of parts whose estimates agree at 95 %."""
    told = [outcome.told for outcome in found if outcome.told]
    return {
        name: np.mean([apart < DEVIATIONS_95 for each in told for apart in twin.agreement(each, name)])
        for name in FREE
    }


def test_parts_that_disagree_are_counted() -> None:
    class Told:
        def __init__(self, value: float) -> None:
            self.parameters = {name: Estimate(value, 1.0) for name in FREE}

    found = [
        Outcome(0, {}, {part: Told(value) for part, value in zip(PARTS, values, strict=True)})
        for values in ((0.0, 1.0, 2.0), (0.0, 0.0, 4.0))
    ]
    assert agreements(found)["p"] == pytest.approx(4 / 6)
