"""Equality relations known beforehand: one parameter follows another, in values, derivatives, intervals and files."""

from __future__ import annotations

import numpy as np
import pytest

from shipfp_rs import Fingerprint, Structure, compare, design
from shipfp_rs.assessment.closed_loop import closed_loop, structure_of
from shipfp_rs.assessment.profile_likelihood import profile_likelihood
from shipfp_rs.errors import InputError
from shipfp_rs.identification.identify import identify
from shipfp_rs.processing.trial import Identify
from shipfp_rs.runs.run import structure_from
from shipfp_rs.structures.structure import Parameter
from tests.identification.test_identifiability import (
    BAND,
    CHIRP,
    VALUES,
    experiment,
    response,
    started_near_truth,
)

PLAIN = Structure.linear(products=True)
TIED = PLAIN.with_tied(vK_i=("vK_p", 0.1))
"""As in VALUES: 1.583 = 0.1 * 15.83."""
DELAYED = Structure.linear(products=True, dead_time_loop=True, dead_time_set_point=True)
EXTENDED = Structure.ship(["actuator_lag", "dead_time_set_point"])
ANY = {
    "kernel": TIED,
    "dead times": DELAYED.with_tied(T_set=("T_d", 2.0)),
    "offset": DELAYED.with_tied(T_set=("T_d", -1.0, 0.15), vK_i=("vK_p", 0.1)),
    "chain": DELAYED.with_tied(T_set=("T_d", 2.0), T_d=("vK_p", 0.05 / 15.83)),
    "transfer functions": EXTENDED.with_tied(T_set=("tau_act", 2.0)),
    "ship": Structure.ship(["actuator_lag"]).with_tied(vK_i=("vK_p", 0.1), tau_act=("vK_i", 0.01)),
}


def complete(structure: Structure) -> dict[str, float]:
    return structure.complete({name: VALUES[name] for name in structure.names})


@pytest.mark.parametrize("case", ANY)
def test_a_derivative_is_that_along_with_all_that_follows(case):
    structure = ANY[case]
    # A dead time of a whole number of steps has two derivatives.
    values = structure.complete({name: 1.013 * value for name, value in complete(structure).items()})
    names = [parameter.name for parameter in structure.free]
    record = experiment(PLAIN)
    states = dict(zip(structure.equations.states, (0.001, 0.002), strict=False))
    simulated, slopes = structure.equations.sensitivities(values | states, record, [*names, *states])
    _, in_frequency = structure.equations.response(values, BAND, names)
    for place, name in enumerate(names):
        step = 1e-6 * abs(values[name])
        ahead, behind = (structure.complete(values | {name: values[name] + h}) for h in (step, -step))
        moved = [structure.equations.simulate(at | states, record) for at in (ahead, behind)]
        difference = (moved[0] - moved[1]) / (2 * step)
        assert np.allclose(slopes[place], difference, atol=2e-5 * np.abs(difference).max()), name
        there, here = (structure.equations.response(at, BAND, ())[0] for at in (ahead, behind))
        assert np.allclose(in_frequency[place], (there - here) / (2 * step), rtol=1e-4, atol=1e-7), name
    # What the tied parameter was given does not count.
    astray = values | dict.fromkeys(structure.ties, 7.0)
    assert np.array_equal(structure.equations.simulate(astray | states, record), simulated)


@pytest.mark.parametrize(
    ("case", "domain"),
    [
        *((case, "time") for case in ("kernel", "dead times", "offset", "transfer functions")),
        *((case, "frequency") for case in ("kernel", "transfer functions")),
    ],
)
def test_a_tie_that_holds_sharpens_and_its_interval_holds_the_truth(case, domain):
    tied = ANY[case]
    free = DELAYED if "T_d" in tied.names else EXTENDED if "tau_act" in tied.names else PLAIN
    options = {"starts": 1, "noise": "white" if domain == "time" else "std"}
    made = experiment(free, noise=1e-2) if domain == "time" else response(free)
    found, apart = (identify(made, started_near_truth(structure), **options) for structure in (tied, free))
    for name, tie in tied.ties.items():
        other, estimate = found[tie.to], found[name]
        assert estimate.value == pytest.approx(tie(other.value), rel=1e-12)
        assert estimate.std == pytest.approx(abs(tie.factor) * other.std, rel=1e-12)
        assert estimate.ci95[0] < estimate.value < estimate.ci95[1]
        assert abs(estimate.value - VALUES[name]) < 4 * estimate.std
        assert estimate.reason == f"tied as {tie}"
        assert estimate.std < apart[name].std
    for name in found.covariance["names"]:
        assert abs(found[name].value - VALUES[name]) < 4.5 * found[name].std
        assert found[name].std < 1.05 * apart[name].std  # either to a few per cent
    assert found.identifiability.free == apart.identifiability.free - len(tied.ties)


def test_a_ratio_known_from_the_manual_closes_a_gap():
    # Speed alone tells three combinations of four; with the ratio it is (p-g)/tau_n and vK_p/tau_n of three unknowns.
    speed = Structure.linear(outputs=("dn",), products=True)
    made = experiment(speed)
    open_ = identify(made, started_near_truth(speed))
    tied = identify(made, started_near_truth(speed.with_tied(g=("tau_n", VALUES["g"] / VALUES["tau_n"]))))
    assert open_["tau_n"].value is None
    assert tied["tau_n"].status == "free"
    for name in ("tau_n", "g", "vK_p", "vK_i"):
        assert tied[name].ci95[0] < VALUES[name] < tied[name].ci95[1]


def test_what_is_not_told_is_not_told_of_its_follower_either():
    tied = started_near_truth(Structure.linear().with_tied(K_i=("K_p", 0.1)))
    found = identify(experiment(PLAIN), tied)
    assert (found["K_i"].value, found["K_i"].status) == (None, "unidentifiable")
    assert found["vK_i"].value == pytest.approx(VALUES["vK_i"], rel=5e-3)
    # 2 sigma of vK_i = v K_i with K_i = 0.1 K_p: as well known as vK_p.
    assert found["vK_i"].std == pytest.approx(0.1 * found["vK_p"].std, rel=1e-3)


def test_a_follower_of_what_is_given_is_given():
    found = identify(experiment(PLAIN), TIED.with_fixed(vK_p=15.83))
    assert (found["vK_i"].status, found["vK_i"].value) == ("fixed", pytest.approx(1.583))


def test_everything_that_starts_from_a_fingerprint_knows_its_ties(tmp_path):
    made = experiment(PLAIN)
    found = identify(made, TIED)
    loaded = Fingerprint.load(found.save(tmp_path / "fingerprint.json"))
    assert structure_of(loaded).ties == TIED.ties
    assert loaded["vK_i"] == found["vK_i"]
    assert np.array_equal(loaded.predict(made).signals["M_b"], found.predict(made, TIED).signals["M_b"])
    same = compare(found, loaded)
    assert [change.name for change in same.changes] == ["tau_n", "g", "vK_p"]
    assert same.joint.freedom == 3
    with pytest.raises(InputError, match=r"vK_i was 0\.1 vK_p in the first .* on its own in the second"):
        compare(found, identify(made, PLAIN))
    # vK_i follows vK_p in the loop's figures, too: the torque's fast gain is vK_p, the slow pole needs both.
    apart = closed_loop(identify(made, PLAIN))
    for name, figure in closed_loop(loaded).items():
        if figure.value is not None:
            assert figure.value == pytest.approx(apart[name].value, rel=1e-2)
            assert figure.std <= 1.1 * apart[name].std  # each fit estimates its own noise
    (profile,) = profile_likelihood(made, TIED, ["vK_p"])
    assert profile.kind == "bounded"


def test_a_design_takes_ties():
    plan = design("stan-launch-804", structure=TIED, duration_s=150.0, amplitude_rpm=13.0)
    parameters = plan.prediction.parameters
    assert parameters["vK_i"].std == pytest.approx(0.1 * parameters["vK_p"].std)


def test_bounds_of_what_follows_count_for_what_it_follows():
    structure = DELAYED.with_bounds(T_set=(0.0, 0.1, 0.3)).with_tied(T_set=("T_d", 2.0))
    (T_d,) = [parameter for parameter in structure.free if parameter.name == "T_d"]
    assert (T_d.lower, T_d.upper) == (0.0, 0.15)
    tight = structure.with_bounds(T_d=(0.0, 0.01, 0.5))
    assert next(p for p in tight.free if p.name == "T_d").upper == 0.15


def test_a_tie_is_given_up_for_a_value_a_prior_or_bounds():
    assert TIED.with_fixed(vK_i=1.0).ties == {}
    assert [p.name for p in TIED.with_bounds(vK_i=(0.1, 9.0)).free] == ["tau_n", "g", "vK_p", "vK_i"]
    assert TIED.with_prior(vK_i=(1.5, 0.1))["vK_i"].prior == (1.5, 0.1)
    assert TIED.with_start(vK_p=10.0)["vK_i"].start == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("ties", "says"),
    [
        ({"vK_i": ("vK_q", 2.0)}, "no parameter 'vK_q'"),
        ({"nothing": ("vK_p", 2.0)}, "no parameter 'nothing'"),
        ({"vK_i": ("vK_i", 2.0)}, "circle"),
        (
            {"vK_i": ("vK_p", 2.0), "vK_p": ("tau_n", 1.0), "tau_n": ("vK_i", 1.0)},
            "vK_i to vK_p|tau_n to vK_i",
        ),
        ({"vK_i": ("vK_p", 0.0)}, "not 0"),
        ({"vK_i": ("vK_p", float("nan"))}, "finite"),
        ({"vK_i": ("vK_p",)}, r"expected \(a text, a number\)"),
        ({"vK_i": ("vK_p", 1e6)}, "starts at 5e.06, outside its bounds 0.0001 to 1000"),
    ],
)
def test_what_makes_no_sense_is_one_line(ties, says):
    with pytest.raises(InputError, match=says) as error:
        PLAIN.with_tied(**ties)
    assert "\n" not in str(error.value)


def test_a_tied_parameter_takes_no_start():
    with pytest.raises(InputError, match="give one to vK_p"):
        TIED.with_start(vK_i=2.0)


def test_a_trial_file_says_it_too():
    options = Identify.model_validate({"products": True, "tied": {"vK_i": ["vK_p", 0.1]}})
    assert structure_from(options, "brake").ties == TIED.ties


def test_a_trial_file_declares_the_ship_with_the_elements_that_act():
    elements = {"sampling": True, "actuator_lag": True, "twist": False}
    options = Identify.model_validate({"elements": elements, "starts": 2, "fixed": {"T_s": 0.1}})
    structure = structure_from(options, "gauge")
    assert not options.chooses
    assert (structure["T_s"].start, structure["T_s"].fixed) == (0.1, True)
    assert structure == Structure.ship(["actuator_lag", "sampling"], torque="gauge").with_fixed(T_s=0.1)
    assert structure_from(options, None).outputs == ("dn",)


def test_structures_of_a_users_own_take_ties():
    def matrices(q):
        A = np.array([[-1 / q["slow"], 0.0], [1 / q["fast"], -1 / q["fast"]]])
        return A, np.array([1 / q["slow"], 0.0]), np.array([[0.0, 1.0]]), np.zeros(1)

    own = Structure.from_matrices(
        matrices,
        [Parameter("slow", "s", 1.0, 0.01, 9.0), Parameter("fast", "s", 0.3, 0.001, 9.0)],
        ["dn"],
        name="two lags",
    ).with_tied(fast=("slow", 0.25))
    record = experiment(PLAIN, CHIRP)
    still = dict.fromkeys(own.equations.states, 0.0)
    (dn,) = own.equations.simulate({"slow": 0.8} | still, record)
    made = type(record)(
        "own",
        record.rate_hz,
        {"n_set": record.signals["n_set"], "n_e": 1300.0 * (1 + dn)},
        record.operating_point,
        record.hold,
    )
    found = identify(made, own, noise="white")
    assert found["fast"].value == pytest.approx(0.2, rel=1e-6)
