"""The words of drive-train identification: symbol, meaning, formula, unit, and what others call it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Term:
    """One entry of the glossary.

    Parameters
    ----------
    symbol
        As in code, results and reports.
    meaning
        What it is, in a few words.
    unit
        As a fingerprint gives it; "-" for a ratio.
    formula
        Definition, in the symbols of the glossary; empty where the meaning says it all.
    elsewhere
        Word of the thesis, of MATLAB's System Identification Toolbox or of python-control.
    """

    symbol: str
    meaning: str
    unit: str = "-"
    formula: str = ""
    elsewhere: str = ""


SIGNALS = (
    Term("n_set", "set point of the engine speed", "rpm", "", "input u of iddata"),
    Term("n_e", "engine speed", "rpm", "gear_ratio n_s", "output y of iddata"),
    Term("n_s", "shaft speed", "rev/s", "", ""),
    Term("M_b", "brake torque of the engine", "Nm", "A1 X_f + A2 n_e + A3", "thesis: eq. 3.5"),
    Term(
        "M_s", "brake torque at the shaft", "Nm", "gear_ratio transmission_efficiency M_b", "thesis: eq. 3.6"
    ),
    Term(
        "M_g",
        "torque at the strain gauge",
        "Nm",
        "M_p + (M_s - M_p) tau_prop / tau_n",
        "thesis: taken for M_s",
    ),
    Term("X_f", "fuel rack", "mm", "", "thesis: X_f"),
    Term("M_load", "measured torque of the load at the shaft", "Nm", "P_load / (2π n_s)", ""),
    Term("E_n", "integrated speed error", "rev", "∫ (n_set - n_e) dt", "thesis: the integral state"),
    Term("dn", "speed deviation", "-", "n_e / n_e0 - 1", "thesis: n*"),
    Term("dM", "torque deviation", "-", "M / M_0 - 1", "thesis: M*"),
    Term("dE", "integrated deviation", "s", "E_n / n_e0", ""),
    Term("dX", "rack deviation", "-", "X_f / X_0 - 1", "thesis: X*"),
)
"""Measured signals, and the normalised outputs of the linear structure."""

LINEAR = (
    Term(
        "tau_n",
        "time in which the operating torque brings the whole drive train's inertia to the operating speed",
        "s",
        "2π I n_s0 / M_s0",
        "thesis: τ_n, eq. 3.23",
    ),
    Term(
        "tau_prop",
        "part of tau_n that belongs to the inertia on the propeller's side of the torque gauge",
        "s",
        "2π I_prop n_s0 / M_s0",
        "not in the thesis",
    ),
    Term(
        "g",
        "per cent of engine torque that 1 % more speed brings, the fuel rack held",
        "-",
        "(n_e0 / M_b0) ∂M_b/∂n_e",
        "thesis: g, eq. 3.25",
    ),
    Term(
        "v",
        "per cent of engine torque that 1 % more fuel rack brings, the speed held",
        "-",
        "(X_0 / M_b0) ∂M_b/∂X_f",
        "thesis: v, eq. 3.24",
    ),
    Term(
        "K_p",
        "per cent of fuel rack that the governor gives for 1 % of speed error",
        "-",
        "Kp_abs n_e0 / X_0",
        "MATLAB: Kp of pid",
    ),
    Term(
        "K_i",
        "per cent of fuel rack that the governor adds in a second for 1 % of speed error",
        "1/s",
        "Ki_abs n_e0 / X_0",
        "MATLAB: Ki of pid",
    ),
    Term(
        "vK_p",
        "per cent of engine torque for 1 % of speed error: the engine's v times the governor's K_p",
        "-",
        "v K_p",
        "",
    ),
    Term(
        "vK_i",
        "per cent of engine torque added in a second for 1 % of speed error: v times K_i",
        "1/s",
        "v K_i",
        "thesis: v K_i",
    ),
    Term(
        "p",
        "power of the speed with which the propeller's torque grows",
        "-",
        "M_p ∝ n_s^p",
        "thesis: 2, eq. 3.8",
    ),
    Term(
        "T_d",
        "dead time in the fuel path, inside the loop",
        "s",
        "exp(-s T_d)",
        "MATLAB: InputDelay; python-control: pade",
    ),
    Term(
        "T_set",
        "dead time in the set-point path, before the governor",
        "s",
        "exp(-s T_set)",
        "MATLAB: InputDelay",
    ),
    Term(
        "K_d",
        "per cent of fuel rack that the governor gives while the speed error grows by 1 % a second",
        "s",
        "Kd_abs n_e0 / X_0",
        "MATLAB: Kd of pid",
    ),
    Term(
        "vK_d",
        "per cent of engine torque while the speed error grows by 1 % a second: v times K_d",
        "s",
        "v K_d",
        "",
    ),
    Term(
        "tau_act", "time constant of the fuel actuator", "s", "1 / (1 + tau_act s)", "MATLAB: Tp1 of idproc"
    ),
    Term("T_s", "period at which the governor samples", "s", "", "MATLAB: Ts; python-control: dt"),
    Term("T_0", "when the governor's first sample of a record falls", "s", "", "MATLAB: Tstart"),
    Term("tau_twist", "give of the shaft, M_s0 / (2π n_s0 k)", "s", "M_s0 / (2π n_s0 shaft_stiffness)", ""),
    Term(
        "zeta_twist",
        "torque of the torsionally flexible shaft's damper for a slip of the operating speed, over the operating torque",
        "-",
        "zeta_twist (n_e - n_s) / n_0",
        "",
    ),
    Term(
        "M_max",
        "upper limit of the engine torque over its operating point",
        "-",
        "M_b ≤ M_max M_b0",
        "Simulink: Saturation",
    ),
    Term(
        "rate",
        "how fast the fuel's torque can change, over its operating point",
        "1/s",
        "-rate ≤ dX/dt ≤ rate",
        "Simulink: Rate Limiter",
    ),
    Term(
        "damping",
        "per cent of torque by which a load beside the propeller's grows with 1 % of speed",
        "-",
        "damping (n - n_0) / n_0",
        "",
    ),
    Term("T_M", "delay of the torque channel", "s", "exp(-s T_M)", "MATLAB: OutputDelay"),
    Term("T_n", "delay of the speed channel", "s", "exp(-s T_n)", "MATLAB: OutputDelay"),
    Term("k_L", "gain of the measured load torque", "-", "k_L (M_load / M_load0 - 1)", ""),
)
"""Parameters of the linear structure and of the ship."""

COMBINATIONS = (
    Term("K_p/K_i", "reset time of the governor", "s", "K_p / K_i", "MATLAB: Ti of pidstd"),
    Term("p-g", "self-regulation: how strongly the shaft resists a change of speed", "-", "p - g", ""),
    Term(
        "(p-g)/tau_n",
        "corner frequency of the shaft without governor",
        "1/s",
        "(p - g) / tau_n",
        "thesis: eq. 3.31",
    ),
    Term("vK_p/tau_n", "proportional loop gain over the inertia", "1/s", "v K_p / tau_n", "thesis: eq. 3.31"),
    Term("vK_i/tau_n", "integral loop gain over the inertia", "1/s2", "v K_i / tau_n", "thesis: eq. 3.31"),
    Term(
        "tau_prop/tau_n",
        "share of the inertia on the propeller's side of the gauge",
        "-",
        "tau_prop / tau_n",
        "",
    ),
    Term(
        "(p-g)/(vK_i)",
        "how far slow motions stay behind the set point",
        "s",
        "(p - g) / (v K_i)",
        "thesis: Table 3.4",
    ),
    Term(
        "(p-g)/(vK_i)+T_set", "the same with the set point's dead time", "s", "(p - g) / (v K_i) + T_set", ""
    ),
)
"""What is known where its members are not."""

OBJECTS = (
    Term("Experiment", "signals on one time base with their operating point", "", "", "MATLAB: iddata"),
    Term(
        "FrequencyResponse",
        "complex ratio of an output to the set point",
        "",
        "",
        "MATLAB: idfrd; python-control: FRD",
    ),
    Term("Excitation", "what is put on the set point", "", "", "MATLAB: idinput"),
    Term("Structure", "parametric model with bounds and starts", "", "", "MATLAB: idgrey"),
    Term(
        "Fingerprint",
        "estimates with intervals, rank and verdict",
        "",
        "",
        "MATLAB: greyest's result, getcov",
    ),
    Term("nrmse_pct", "fit of an output", "%", "100 (1 - |y - ŷ| / |y - mean y|)", "MATLAB: fit of compare"),
)
"""What the package hands around, and the figure that a fit is judged by."""

GLOSSARY: Mapping[str, Term] = {term.symbol: term for term in (*SIGNALS, *LINEAR, *COMBINATIONS, *OBJECTS)}
"""All terms by symbol."""


def term(symbol: str) -> Term:
    """Return a symbol's entry; of a part of a joint structure its own, and an empty one where there is none."""
    return GLOSSARY.get(symbol.partition(" (")[0], Term(symbol, ""))


def meaning(symbol: str) -> str:
    """Return what a symbol means, in a few words; empty where the glossary has none."""
    return GLOSSARY[symbol].meaning if symbol in GLOSSARY else ""
