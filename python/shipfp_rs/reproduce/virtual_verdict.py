"""What the reproduction of chapters 3 to 5 says, in sentences made of its own figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict

from shipfp_rs.reproduce import Row, Way
from shipfp_rs.reproduce.virtual_data import (
    STEP_S,
    euler_bias,
    fit_pct,
    launch_of_the_thesis,
    model_of,
    thesis_structure,
    trial,
)
from shipfp_rs.reproduce.virtual_tables import CORRECTIONS
from shipfp_rs.vessel.linear_model import linearise

Figures = Mapping[str, float]
Found = Mapping[tuple[str, Way, str], Figures]
SMALL = ("ii", "iii", "iv")


def of(rows: Iterable[Row]) -> tuple[str, ...]:
    """Return the verdict on all rows, one sentence group an entry."""
    found = {(row.case, row.way, row.structure): _figures(row) for row in rows if row.table == "5.2"}
    return (
        *_bias(found),
        _accurate(found),
        _saturation(found),
        _misprint(found),
        _validation(found),
        "Table 3.5: n_0 is 21.667 rev/s, not 21.677; M_s0 and M_b0 are 0.07 % apart.",
        f"Table 4.2: {CORRECTIONS}.",
    )


def _figures(row: Row) -> Figures:
    figures = {**row.parameters, **{f"fit {output}": value for output, value in row.fit.items()}}
    return {name: value for name, value in figures.items() if value is not None}


def _bias(found: Found) -> tuple[str, str]:
    printed, biased = found["ii", "printed", "linear"], found["ii", "thesis", "linear, sampled exactly"]
    repaired = found["ii, Euler model", "thesis", "linear, sampled by Euler"]
    true, ours = found["i", "thesis", "linear"], found["i", "ours", "linear"]
    below = 100.0 * (1.0 - printed["tau_n"] / true["tau_n"])
    return (
        f"tau_n: the printed {printed['tau_n']} s is {below:.1f} % below its true value {true['tau_n']:.3f} s because "
        f"the data were simulated by forward Euler with h = {STEP_S} s and fitted with an exact model. So done again: "
        f"{biased['tau_n']:.4f} s; closed form tau h a/-ln(1 - h a): "
        f"{euler_bias(linearise(launch_of_the_thesis())):.4f} s. A model with the same error finds "
        f"{repaired['tau_n']:.4f} s in the same data.",
        f"The true value itself is {ours['tau_n']:.3f} s by eq. 3.23: 1.442 s leaves out the losses of the gearbox "
        "(M_s0 = 3 x 222.93 Nm gives 1.438 s; for the rest the thesis holds no explanation).",
    )


def _accurate(found: Found) -> str:
    linear, plant = (
        ", ".join(f"{found[case, 'ours', structure]['tau_n']:.{digits}f}" for case in SMALL)
        for structure, digits in (("linear", 4), ("plant", 5))
    )
    ratio = found["iii", "ours", "linear"]["K_p/K_i"]
    return (
        f"Accurate data: tau_n {linear} s from sine sequence, linear and logarithmic chirp with the linear structure, "
        f"{plant} s with the plant. The linear chirp puts K_p/K_i at {ratio:.3f} s (true 10; printed 10.03): it "
        "spends one second below 0.015 Hz, and there the propeller's curvature counts."
    )


def _saturation(found: Found) -> str:
    again, printed = found["v", "thesis", "linear"], found["v", "printed", "linear"]
    cut, free = found["v", "ours", "linear"], found["v, no torque limit", "ours", "linear"]
    plant = found["v", "ours", "plant"]
    return (
        f"Case v is off because the torque limit cuts the answer: tau_n {again['tau_n']:.3f} s, g {again['g']:.3f}, "
        f"torque {again['fit dM']:.1f} % as the thesis did (printed {printed['tau_n']} s, {printed['g']}, "
        f"{printed['fit dM']} %). Accurate data give {cut['tau_n']:.3f} s and {cut['g']:.3f}, without the limit "
        f"{free['tau_n']:.3f} s and {free['g']:.3f}; the plant, which contains the limit, {plant['tau_n']:.4f} s and "
        f"{plant['g']:.4f}. The limit is configuration, for Figure 3.3 has no numbers, so these come near the printed "
        f"figures only; K_p/K_i {printed['K_p/K_i']} s does not (here {again['K_p/K_i']:.2f} s)."
    )


def _misprint(found: Found) -> str:
    printed, again = found["iv", "printed", "linear"], found["iv", "thesis", "linear"]
    data = trial(launch_of_the_thesis(), "iv", "euler")
    fits = [
        fit_pct(thesis_structure(), asdict(model_of({**again, "vK_p": vK_p})), data)["dM"]
        for vK_p in (printed["vK_p"], again["vK_p"])
    ]
    return (
        f"Case iv's vK_p {printed['vK_p']} is a misprint of 15.83: with it the model would fit the torque to "
        f"{fits[0]:.2f} %, with {again['vK_p']:.2f} to {fits[1]:.2f} % (printed {printed['fit dM']} %)."
    )


def _validation(found: Found) -> str:
    ours, euler = found["i", "ours", "linear"], found["i", "thesis", "linear"]
    small = found["i, steps of 1 %", "ours", "linear"]
    shown = [
        f"{row['fit validation dn']:.2f} and {row['fit validation dM']:.2f} %" for row in (ours, euler, small)
    ]
    return (
        f"Validation: steps of 5 % give {shown[0]}, by Euler {shown[1]} (printed 99.53 and 90.72 %); steps of 1 %, as "
        f"section 5.1.3 has it, {shown[2]}."
    )
