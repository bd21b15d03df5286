"""Inertias and stiffness of torsional lines, beside hand calculations and openTorsion's own examples."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import shipfp_rs as fp
from shipfp_rs.vessel.torsion import Line

EXACT = 1e-12


def line_of(count: int, seed: int) -> tuple[dict, int, list[float]]:
    """A line of discs with a gear after every few shafts: the list, its gauge, and the speed of each node."""
    random = np.random.default_rng(seed)
    gears = set(random.choice(np.arange(1, count - 1), min(3, count - 3), replace=False).tolist())
    found: dict = {"discs": [], "shafts": [], "gears": []}
    for node in range(count):
        found["discs"].append({"node": node, "inertia_kg_m2": float(random.lognormal(0.0, 2.0))})
    speeds = [1.0]
    for node in range(count - 1):
        if node in gears:
            ratio = float(random.uniform(0.3, 5.0))
            turned = bool(random.integers(2))  # a ratio may be told from either side
            nodes, told = ([node + 1, node], 1.0 / ratio) if turned else ([node, node + 1], ratio)
            found["gears"].append({"nodes": nodes, "ratio": told})
            speeds.append(speeds[-1] / ratio)
            continue
        stiffness, inertia = float(random.lognormal(12.0, 2.0)), float(random.lognormal(-3.0, 1.0))
        found["shafts"].append(
            {"nodes": [node, node + 1], "stiffness_Nm_rad": stiffness, "inertia_kg_m2": inertia}
        )
        speeds.append(speeds[-1])
    return found, int(random.integers(len(found["shafts"]))), speeds


@given(st.integers(5, 25), st.integers(0, 2**32 - 1))
def test_a_line_has_the_kinetic_and_elastic_energy_of_its_parts(count, seed):
    found, gauge, speeds = line_of(count, seed)
    seen = Line.model_validate(found).seen(f"shaft {gauge + 1}")
    # The whole line turns with 1 rad/s at the propeller, so twice its kinetic energy is its inertia there.
    turn = np.array(speeds) / speeds[-1]
    masses = np.array([disc["inertia_kg_m2"] for disc in found["discs"]])
    for shaft in found["shafts"]:
        masses[shaft["nodes"]] += 0.5 * shaft["inertia_kg_m2"]
    energy = masses * turn**2
    assert seen.inertia == pytest.approx(math.fsum(energy), rel=EXACT)
    behind = math.fsum(energy[found["shafts"][gauge]["nodes"][1] :])
    assert seen.propeller_side_inertia == pytest.approx(behind, rel=EXACT)
    # A torque of 1 Nm at the propeller is 1 / turn on a shaft: twice the elastic energy is the compliance there.
    elastic = math.fsum((1.0 / turn[s["nodes"][0]]) ** 2 / s["stiffness_Nm_rad"] for s in found["shafts"])
    assert 1.0 / seen.stiffness == pytest.approx(elastic, rel=EXACT)
    assert seen.ratio == pytest.approx(speeds[0] / speeds[-1], rel=EXACT)


def test_a_tug_of_five_discs_by_hand():
    discs = [
        ("crank", 0, 0.9),
        ("flywheel", 1, 2.1),
        ("pinion", 2, 0.05),
        ("wheel", 3, 1.4),
        ("propeller", 4, 18.0),
    ]
    line = Line.model_validate(
        {
            "discs": [{"name": n, "node": k, "inertia_kg_m2": i} for n, k, i in discs],
            "shafts": [
                {"nodes": [0, 1], "stiffness_Nm_rad": 4e5},
                {"nodes": [1, 2], "stiffness_Nm_rad": 1e4},
                {"name": "tail shaft", "nodes": [3, 4], "stiffness_Nm_rad": 2e5},
            ],
            "gears": [{"nodes": [2, 3], "ratio": 4.0}],
        }
    )
    # Ahead of the gear an inertia counts sixteen times, and a stiffness, too: 16 * 3.05 + 1.4 + 18 = 68.2 kg m2.
    seen = line.seen("tail shaft")
    assert seen.inertia == pytest.approx(68.2, rel=EXACT)
    assert seen.propeller_side_inertia == pytest.approx(18.0, rel=EXACT)
    assert seen.stiffness == pytest.approx(1.0 / (1 / 6.4e6 + 1 / 1.6e5 + 1 / 2e5), rel=EXACT)
    assert line.seen("wheel") == line.seen("tail shaft")
    assert line.seen("flywheel").propeller_side_inertia == pytest.approx(16.0 * 0.05 + 19.4, rel=EXACT)
    assert line.seen().propeller_side_inertia is None


def test_a_branch_turns_along_and_carries_no_torque_to_the_propeller():
    """Friswell et al. 2010, the geared system of openTorsion's own test_friswell_pagex."""
    line = Line.model_validate(
        {
            "discs": [
                {"node": 0, "inertia_kg_m2": 400e-6},
                {"node": 1, "inertia_kg_m2": 25e-6},
                {"node": 2, "inertia_kg_m2": 25e-6},
                {"node": 3, "inertia_kg_m2": 700e-6},
                {"node": 4, "inertia_kg_m2": 700e-6},
            ],
            "shafts": [
                {"nodes": [0, 1], "stiffness_Nm_rad": 10e3},
                {"nodes": [2, 3], "stiffness_Nm_rad": 5e3},
                {"nodes": [1, 4], "stiffness_Nm_rad": 5e3},
            ],
            "gears": [{"nodes": [1, 2], "ratio": 1.0}],
        }
    )
    seen = line.seen("shaft 3")
    assert seen.inertia == pytest.approx(1850e-6, rel=EXACT)
    assert seen.propeller_side_inertia == pytest.approx(700e-6, rel=EXACT)
    assert seen.stiffness == pytest.approx(1.0 / (1 / 10e3 + 1 / 5e3), rel=EXACT)


def test_an_assembly_is_as_heavy_as_its_own_mass_matrix():
    """The rigid turn of an assembly lies in the null space of its stiffness, with openTorsion's own reduction of gears."""
    ot = pytest.importorskip("opentorsion")
    shafts = [
        ot.Shaft(0, 1, k=4e5, I=0.01),
        ot.Shaft(1, 2, L=600.0, odl=80.0),
        ot.Shaft(3, 4, L=3000.0, odl=120.0, idl=20.0),
    ]
    pinion = ot.Gear(2, 0.05, 20.0)
    gears = [pinion, ot.Gear(3, 1.4, 76.4, parent=pinion)]
    discs = [ot.Disk(0, 0.9), ot.Disk(1, 2.1), ot.Disk(4, 18.0)]
    assembly = ot.Assembly(shafts, disk_elements=discs, gear_elements=gears)
    seen = Line.of_assembly(assembly).seen("shaft 3")
    turn = np.linalg.svd(assembly.K)[2][-1]
    assert seen.inertia == pytest.approx(turn @ assembly.M @ turn / turn[-1] ** 2, rel=1e-9)
    assert seen.ratio == pytest.approx(3.82, rel=EXACT)
    J = [math.pi * (od**4 - bore**4) / 32 for od, bore in ((0.08, 0.0), (0.12, 0.02))]
    soft = 3.82**-2 * (1 / 4e5 + 0.6 / (80e9 * J[0])) + 3.0 / (80e9 * J[1])
    assert 1.0 / seen.stiffness == pytest.approx(soft, rel=EXACT)


def test_a_tors_file_of_opentorsion_is_read(tmp_path: Path):
    pytest.importorskip("opentorsion")
    elements = [
        {"name": "engine", "type": "Disk", "inertia": 211.4, "damping": 0},
        {"name": "shaft", "type": "ShaftDiscrete", "stiffness": 9.775e6, "damping": 0},
        {"name": "propeller", "type": "Disk", "inertia": 8.3, "damping": 0},
    ]
    path = tmp_path / "line.json"
    path.write_text(json.dumps({"structure": [], "components": [{"name": "all", "elements": elements}]}))
    assert Line.read(path).seen("shaft 1") == pytest.approx((219.7, 8.3, 9.775e6, 1.0), rel=EXACT)
    del elements[0]["inertia"]
    path.write_text(json.dumps({"structure": [], "components": [{"name": "all", "elements": elements}]}))
    with pytest.raises(fp.InputError, match="openTorsion can't read it"):
        Line.read(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"gauge": "shaft 9"}, "torsion.gauge: found 'shaft 9', did you mean"),
        ({"gauge": "disc 2"}, "torsion.gauge: found 'disc 2', the propeller"),
        (
            {"discs": [{"node": 0, "inertia_kg_m2": 1.0}, {"node": 7, "inertia_kg_m2": 1.0}]},
            "node 0 is apart",
        ),
        ({"shafts": [{"nodes": [0, 1]}, {"nodes": [1, 0]}]}, "in a loop"),
        ({"discs": []}, "discs: found 0 values"),
        ({"discs": [{"node": 0, "inertia": 1.0}]}, "inertia_kg_m2"),
    ],
)
def test_a_line_that_cannot_be_is_refused_in_one_line(tmp_path, change, said):
    content = {
        "discs": [{"node": 0, "inertia_kg_m2": 1.0}, {"node": 1, "inertia_kg_m2": 2.0}],
        "shafts": [{"nodes": [0, 1], "stiffness_Nm_rad": 1e5}],
        **change,
    }
    gauge = content.pop("gauge", None)
    path = tmp_path / "line.json"
    path.write_text(json.dumps(content))
    with pytest.raises(fp.InputError, match=said) as refused:
        Line.read(path).seen(gauge)
    assert "\n" not in str(refused.value)
