"""A fingerprint in other tools is the ship that `simulate` steps, and its governor on a card the one of the loop."""

from __future__ import annotations

import json
import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from scipy.io import loadmat

import shipfp_rs as fp
from shipfp_rs import Structure
from shipfp_rs.cli import main
from shipfp_rs.errors import InputError
from shipfp_rs.exports import export
from shipfp_rs.exports.blocks import Block, Model
from shipfp_rs.exports.drive import Drive
from shipfp_rs.exports.simulink import LIBRARY
from shipfp_rs.identification.estimate import Estimate, Identifiability
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.linearised import loop_of
from shipfp_rs.structures.transfer import _Loop

POINT = {"n_set": 1300.0, "n_e": 1300.0, "n_s": 7.2222, "M_b": 222.93, "M_g": 635.35, "M_load": 50.0}
RIGID = {"tau_n": 1.5, "g": -0.6, "vK_p": 5.0, "vK_i": 4.0, "p": 2.1}
SHIPS: dict[str, tuple[str, dict[str, float]]] = {
    "rigid": ("brake", {}),
    "late": ("brake", {"T_d": 0.044, "T_set": 0.212, "tau_act": 0.06, "T_f": 0.011}),
    "sampled": ("brake", {"T_d": 0.06, "T_s": 0.04, "tau_eng": 0.12}),
    "gauge": ("gauge", {"tau_prop": 0.6, "T_d": 0.03, "tau_act": 0.02, "c_2": 0.3, "damping": 0.2}),
    "twisted": (
        "gauge",
        {"tau_prop": 0.7, "tau_twist": 3e-3, "zeta_twist": 0.8, "tau_act": 0.05, "T_d": 0.02},
    ),
    "limited": ("brake", {"M_max": 1.12, "M_soft": 0.01, "rate": 2.0, "tau_act": 0.05, "T_d": 0.03}),
    "ramped": ("brake", {"set_rate": 0.05, "T_d": 0.02, "rate": 1.0}),
    "slope": ("brake", {"vK_d": 0.2, "T_d": 0.028}),
    "derivative": ("brake", {"vK_d": 0.2, "T_f": 0.02, "T_d": 0.02, "tau_act": 0.03}),
    "drooping": ("brake", {"droop": 0.05, "T_d": 0.02, "tau_act": 0.05}),
}
"""Kind of the torque, and parameters beside the rigid ship's."""
OF_PARAMETER = {
    "T_d": "dead_time_loop",
    "T_set": "dead_time_set_point",
    "tau_act": "actuator_lag",
    "T_f": "speed_filter",
    "tau_eng": "engine_lag",
    "vK_d": "derivative",
    "droop": "droop",
    "T_s": "sampling",
    "M_max": "torque_limit",
    "rate": "rack_rate",
    "set_rate": "set_rate",
    "tau_twist": "twist",
    "damping": "damping",
    "c_2": "curvature",
    "k_L": "load",
}


def known_ship(torque: str = "brake", unknown: str = "", **more: float) -> Fingerprint:
    """Return the fingerprint of a ship with these parameters; the data do not determine `unknown`."""
    elements = [OF_PARAMETER[name] for name in more if name in OF_PARAMETER]
    structure = Structure.ship(elements, torque=torque, mean_sampling=True)
    values = {**{one.name: one.start for one in structure.parameters}, **RIGID, **more}
    rows: dict[str, Any] = {
        name: Estimate(None, status="unidentifiable", reason="the data allow any value")
        if name == unknown
        else Estimate(value, status="fixed")
        for name, value in values.items()
    }
    return Fingerprint(
        parameters=rows,
        derived={},
        identifiability=Identifiability(rank=0, free=0, condition=1.0),
        fit={},
        structure=structure.to_dict(),
        vessel="tug",
        data=(
            {
                "name": "trial",
                "signals": {"dn": "n_e", "dM": "M_g" if torque == "gauge" else "M_b"},
                "operating_point": POINT,
            },
        ),
        settings={"optimum": values, "criterion": 0.0, "converged": True, "message": "", "minima": []},
    )


RATE_HZ = 50.0
TORQUES = {"gauge": "M_g", "brake": "M_b"}


def trial(rate_hz: float = RATE_HZ, samples: int = 300, amplitude_rpm: float = 20.0) -> fp.Experiment:
    """Return steps of the set point, a random one every half second."""
    held = round(0.5 * rate_hz)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], -(-samples // held))
    set_point = 1300.0 + amplitude_rpm * np.repeat(signs, held)[:samples]
    return fp.Experiment("steps", rate_hz, {"n_set": set_point}, POINT, "zero", "steps")


def stepped(blocks: Any, parameters: Any, record: fp.Experiment) -> np.ndarray:
    """Return speed and torque (2, N) of a block diagram, each sample before the set point jumps at it."""
    model, rows = Model(blocks, parameters), []
    for value in record.signals["n_set"]:
        found = model.signals()
        rows.append([found["speed"], found["torque"]])
        model.feed(n_set=value)
        model.advance(1.0 / record.rate_hz)
    return 1.0 + np.array(rows).T


def largest(found: np.ndarray, record: fp.Experiment, torque: str, *, at_once: bool = False) -> float:
    """Return the largest relative difference from a simulation; a torque that jumps at a sample is left out there."""
    jumps = np.flatnonzero(np.diff(record.signals["n_set"], prepend=1300.0))
    kept = np.setdiff1d(np.arange(len(record)), jumps) if at_once else np.arange(len(record))
    rows = [record.signals[name] / POINT[name] for name in ("n_e", TORQUES[torque])]
    return max(
        float(np.abs(ours[kept] / row[kept] - 1.0).max()) for ours, row in zip(found, rows, strict=True)
    )


@pytest.mark.parametrize("name", SHIPS)
def test_the_block_diagram_is_the_ship_of_simulate(name: str) -> None:
    torque, more = SHIPS[name]
    found, record = known_ship(torque, **more), trial()
    if (
        name == "ramped"
    ):  # `simulate` takes a held set point that is rate limited for straight between samples
        record = trial(2000.0, 3000)
    drive = Drive.of(found)
    ours = stepped(drive.blocks, drive.parameters, record)
    at_once = not {"T_d", "tau_act"} & {*more}
    usual = largest(ours, found.simulate(record), torque, at_once=at_once)
    structure = fp.Structure.from_dict(found.structure)
    fine = replace(structure, equations=replace(structure.equations, substeps=40))
    exact = largest(ours, found.simulate(record, fine), torque, at_once=at_once)
    print(f"{name}: {usual:.1e} from simulate, {exact:.1e} from simulate with 40 steps a sample")
    # Without a filter, jumps come back through the derivative, and the usual steps of `simulate` smear each of them.
    bare = "vK_d" in more and "T_f" not in more
    assert usual < (1e-3 if bare else 1e-4)
    assert exact < (1e-4 if bare or "rate" in more or "set_rate" in more else 5e-6)


@pytest.mark.parametrize("name", ["late", "twisted", "limited"])
def test_the_fmu_answers_in_fmpy_as_simulate_does(name: str, tmp_path: Path) -> None:
    torque, more = SHIPS[name]
    found, record = known_ship(torque, **more), trial()
    path = export(found, "fmu", tmp_path / "tug.fmu")
    answer = simulated(path, record, TORQUES[torque])
    ours = np.array([answer["n_e"] / POINT["n_e"], answer[TORQUES[torque]] / POINT[TORQUES[torque]]])
    difference = largest(ours, found.simulate(record), torque)
    print(f"{name}: FMU in FMPy {difference:.1e} from simulate")
    assert difference < 1e-4
    told = {one.name: one for one in fmpy.read_model_description(str(path)).modelVariables}
    assert float(told["tau_n"].start) == 1.5
    assert told["tau_n"].causality == "parameter"
    assert told["n_set"].causality == "input"


def simulated(path: Path, record: fp.Experiment, torque: str, **options: Any) -> Any:
    """Return what FMPy computes, a row a sample."""
    times = record.time
    asked = np.array([*zip(times, record.signals["n_set"], strict=True)], [("time", float), ("n_set", float)])
    step = 1.0 / record.rate_hz
    found = fmpy.simulate_fmu(
        str(path),
        stop_time=times[-1],
        step_size=step,
        output_interval=step,
        input=asked,
        output=["n_e", torque],
        **options,
    )
    np.testing.assert_allclose(found["time"], times, atol=1e-9)
    return found


def test_parameters_of_an_fmu_can_be_set(tmp_path: Path) -> None:
    found, record = known_ship(**SHIPS["late"][1]), trial(samples=100)
    path = export(found, "fmu", tmp_path / "tug.fmu")
    other = known_ship(**SHIPS["late"][1] | {"tau_n": 2.5})
    answer = simulated(path, record, "M_b", start_values={"tau_n": 2.5})
    np.testing.assert_allclose(answer["n_e"], other.simulate(record).signals["n_e"], rtol=1e-4)
    assert np.abs(answer["n_e"] / found.simulate(record).signals["n_e"] - 1.0).max() > 1e-3


def test_a_measured_load_is_an_input() -> None:
    found = known_ship(k_L=1.5, T_d=0.02)
    drive = Drive.of(found)
    assert drive.inputs == {"n_set": "n_set", "load": "M_load"}
    load = POINT["M_load"] + 20.0 * (np.arange(200) >= 50)
    record = fp.Experiment("load", 50.0, {"n_set": np.full(200, 1300.0), "M_load": load}, POINT, "zero")
    equations = fp.Structure.from_dict(found.structure).equations
    wanted = equations.simulate(found.optimum, record)
    model, speeds = Model(drive.blocks, drive.parameters), []
    for value in load:
        speeds.append(model.signals()["speed"])
        model.feed(load=value)
        model.advance(0.02)
    assert np.abs(wanted[0]).max() > 0.05
    np.testing.assert_allclose(speeds, wanted[0], atol=2e-5)


ADDED = re.compile(r"add_block\('([^']+)', \[model '/([^']+)'\](.*)\);")
LINE = re.compile(r"add_line\(model, '([^']+)/(\d)', '([^']+)/(\d)', 'autorouting', 'on'\);")
PORTS = {"input": 0, "product": 2}


@pytest.mark.parametrize("name", SHIPS)
def test_the_simulink_script_connects_every_port_and_is_the_same_ship(name: str, tmp_path: Path) -> None:
    torque, more = SHIPS[name]
    found = known_ship(torque, **more)
    path = export(found, "simulink", tmp_path / "tug.m")
    blocks = read_script(path.read_text())
    mat = {
        key: value.item() for key, value in loadmat(tmp_path / "tug.mat").items() if not key.startswith("__")
    }
    drive, record = Drive.of(found), trial(samples=150)
    assert mat == drive.parameters
    outputs = [block.name for block in blocks if block.kind == "output"]
    assert outputs == ["n_e", TORQUES[torque]]
    bare = [block for block in blocks if block.kind != "output"]
    ours, same = stepped(bare, mat, record), stepped(drive.blocks, drive.parameters, record)
    np.testing.assert_allclose(ours, same, rtol=2e-3 if "M_soft" in more else 1e-12)


def read_script(text: str) -> list[Block]:
    """Return the blocks of a script, whose lines must connect each input port once, and ports that exist."""
    kinds = {library: kind for kind, (library, _) in LIBRARY.items() if kind not in ("clip", "limit")}
    found: dict[str, tuple[str, str]] = {}
    for library, name, dialog in ADDED.findall(text):
        values = re.findall(r"'[^']*', '([^']*)'", dialog)
        kind, value = kinds.get(library, "clip"), values[0] if values else ""
        if library.endswith("Saturation") and values[1] == "-inf":
            kind = "limit"
        if kind == "input":
            value = f"{name}_0"
        value = {"lag": values[-1][1:-2], "power": value[8:-5]}.get(kind, value) if values else value
        assert name not in found
        found[name] = kind, value
    inputs: dict[str, dict[int, str]] = {name: {} for name in found}
    for source, out, name, port in LINE.findall(text):
        assert out == "1"
        assert found[source][0] != "output"
        assert int(port) not in inputs[name]
        inputs[name][int(port)] = source
    assert text.count("add_block(") == len(found)
    assert text.count("add_line(") == sum(map(len, inputs.values()))
    for name, (kind, value) in found.items():
        ports = len(value) if kind == "sum" else PORTS.get(kind, 1)
        assert sorted(inputs[name]) == [*range(1, ports + 1)], name
    return [
        Block(name, kind, tuple(inputs[name][port] for port in sorted(inputs[name])), value)
        for name, (kind, value) in found.items()
    ]


def test_the_control_script_is_the_linearised_ship(tmp_path: Path) -> None:
    found = known_ship(T_d=0.05, tau_act=0.03)
    path = export(found, "control", tmp_path / "tug.py")
    ship, same = runpy.run_path(str(path))["ship"], found.to_ss()
    for part in "ABCD":
        np.testing.assert_array_equal(getattr(ship, part), getattr(same, part))
    assert ship.output_labels == ["dn", "dM"]


DEGOV = ("T1", "T2", "T3", "K", "T4", "T5", "T6", "TD", "Tmax", "Tmin")
GGOV1 = re.findall(
    r"\w+",
    "Rselect Flag R Tpelec maxerr minerr Kpgov Kigov Kdgov Tdgov Vmax Vmin Tact Kturb Wfnl Tb Tc Teng Tfload Kpload Kiload "
    "Ldref Dm Ropen Rclose Kimw Aset Ka Ta Trate db Tsa Tsb Rup Rdown",
)
"""Fields in the order of PSS/E's model library."""


def card(path: Path, names: Any) -> dict[str, float]:
    """Return the fields of a card, by the order of the model library."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("//")]
    assert max(map(len, path.read_text().splitlines())) < 120
    bus, model, identifier, *numbers = " ".join(lines).removesuffix(" /").split()
    assert (bus, model.strip("'").lower(), identifier) == ("1", path.stem, "1")
    return {name: float(number) for name, number in zip(names, numbers, strict=True)}


def governor(of: str, q: dict[str, float], s: np.ndarray) -> np.ndarray:
    """Return the torque over the speed by a card: the block diagrams that PowerWorld publishes."""
    if of == "degov":
        box = (1 + q["T3"] * s) / (1 + q["T1"] * s + q["T1"] * q["T2"] * s**2)
        actuator = q["K"] * (1 + q["T4"] * s) / (s * (1 + q["T5"] * s) * (1 + q["T6"] * s))
        return -box * actuator * np.exp(-s * q["TD"])
    pid = q["Kpgov"] + q["Kigov"] / s + q["Kdgov"] * s / (1 + q["Tdgov"] * s)
    pid = pid / (1 + pid * q["R"]) if q["Rselect"] == -2 else pid
    turbine = q["Kturb"] * (1 + q["Tc"] * s) / (1 + q["Tb"] * s) * np.exp(-s * q["Teng"])
    return -pid * turbine / (1 + q["Tact"] * s) - q["Dm"]


@pytest.mark.parametrize(
    ("more", "differs"),
    [
        pytest.param({"T_d": 0.05, "tau_act": 0.06}, {"degov": 1e-6, "ggov1": 1e-6}, id="lag"),
        pytest.param({"T_d": 0.05, "T_f": 0.02}, {"degov": 1e-6, "ggov1": 1e-6}, id="filter"),
        pytest.param(
            {"tau_act": 0.05, "tau_eng": 0.15, "T_f": 0.01}, {"degov": 1e-6, "ggov1": 0.15}, id="engine"
        ),
        pytest.param({"T_d": 0.06, "T_s": 0.04}, {"degov": 5e-3, "ggov1": 5e-3}, id="sampled"),
        pytest.param(
            {"vK_d": 0.2, "T_f": 0.02, "T_d": 0.02}, {"degov": 0.01, "ggov1": 1e-6}, id="derivative"
        ),
    ],
)
def test_a_card_has_the_governor_of_the_loop_up_to_its_crossover(
    more: dict[str, float], differs: dict[str, float], tmp_path: Path
) -> None:
    found = known_ship(**more)
    _, q = loop_of(fp.Structure.from_dict(found.structure), found.optimum)
    s = 2j * np.pi * np.geomspace(0.01, 10.0, 400)
    speed_to_torque = _Loop(q, s).answer(1.0, 0.0)[2]
    band = np.abs(speed_to_torque / (q["p"] + q["tau_n"] * s)) > 0.5
    for of, names in (("degov", DEGOV), ("ggov1", GGOV1)):
        ours = governor(of, card(export(found, of, tmp_path / f"{of}.dyr"), names), s)
        slope = q["g"] / (1 + q.get("tau_eng", 0.0) * s) if of == "degov" else 0.0
        wanted = speed_to_torque - slope
        largest_one = float((np.abs(ours - wanted) / np.abs(speed_to_torque))[band].max())
        print(
            f"{of} of {more}: {largest_one:.1e} from the loop's governor up to {s[band][-1].imag / 2 / np.pi:.2f} Hz"
        )
        assert largest_one < differs[of]


def test_a_card_says_what_it_assumes_and_the_inertia(tmp_path: Path) -> None:
    limited = card(export(known_ship(M_max=1.4, rate=2.8), "ggov1", tmp_path / "ggov1.dyr"), GGOV1)
    assert (limited["Kturb"], limited["Ropen"], limited["Rclose"]) == (1.4, 2.0, -2.0)
    drooping = card(export(known_ship(droop=0.04), "ggov1", tmp_path / "droop" / "ggov1.dyr"), GGOV1)
    assert (drooping["Rselect"], drooping["R"]) == (-2.0, 0.08)
    text = export(known_ship(unknown="tau_n"), "degov", tmp_path / "degov.dyr").read_text()
    assert "no tau_n" in text
    assert "H, half of tau_n, is 0.75 s" in (tmp_path / "ggov1.dyr").read_text()


@pytest.mark.parametrize(
    ("to", "found", "said"),
    [
        pytest.param("ggov1", known_ship(unknown="vK_i"), r"vK_i: found no value \(the data", id="gain"),
        pytest.param("degov", known_ship(vK_d=2.0, T_f=0.02), r"K_d: found complex zeros", id="zeros"),
        pytest.param("degov", known_ship(droop=0.04), r"droop: found 0.04, expected none", id="droop"),
        pytest.param("ggov1", known_ship(g=0.3), r"g: found 0.3, expected zero", id="slope"),
        pytest.param("fmu", replace(known_ship(), usability="not usable", usable="Not"), "expected a usable one", id="use"),
        pytest.param("degov", replace(known_ship(), adequate={"sides": {"engine": False}}), "the load alone", id="load"),
        pytest.param("simulink", replace(known_ship(), data=()), "no operating point of n_set", id="point"),
        pytest.param("fmu", known_ship(vK_d=0.2), "vK_d: found .* depends on itself", id="at-once"),
        pytest.param("fmu", replace(known_ship(), structure=fp.Structure.linear().to_dict()), "no ship", id="linear"),
    ],
)  # fmt: skip
def test_what_a_tool_can_not_be_given_is_refused_by_name(
    to: Any, found: Fingerprint, said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=said):
        export(found, to, tmp_path / "tug")
    assert not [*tmp_path.iterdir()]


def test_an_fmu_says_which_parameters_the_data_leave_open() -> None:
    drive = Drive.of(known_ship("gauge", "tau_n", tau_prop=0.5))
    assert drive.described("tau_n") == "[s], determined only together with others"
    assert drive.described("n_e_0") == "[rpm]"


def test_without_pythonfmu_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pythonfmu", None)
    with pytest.raises(InputError, match=r"pip install 'shipfp_rs\[fmu\]'"):
        export(known_ship(), "fmu", tmp_path / "tug.fmu")


def test_the_command_writes_and_replaces_only_when_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    known_ship(T_d=0.02).save("tug.json")
    for to, files in (
        ("simulink", ["ship.m", "ship.mat"]),
        ("control", ["ship.py"]),
        ("ggov1", ["ggov1.dyr"]),
    ):
        assert main(["export", "tug.json", "--to", to, "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == {"to": to, "files": files}
        assert main(["export", "tug.json", "--to", to]) == 2
        assert f"{files[0]}: exists already" in capsys.readouterr().err
        assert main(["export", "tug.json", "--to", to, "--force"]) == 0
        assert f"wrote {files[0]}" in capsys.readouterr().out
    assert main(["export", "tug.json", "--to", "fmu", "--out", "ship.dyr"]) == 2
    assert "expected a name ending in .fmu" in capsys.readouterr().err
    assert main(["export", "tug.json", "--to", "simulink", "--out", "2 tugs.m"]) == 2
    assert "letters, digits and _" in capsys.readouterr().err
