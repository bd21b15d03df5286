"""The governor of a fingerprint as DEGOV and GGOV1 cards, in the format of PSS/E's .dyr files.

Source of the fields and their order: PSS/E's model library as published by PowerWorld ("Governor DEGOV", "Governor GGOV1"),
PowerSystems.jl (`DEGOV`, `GeneralGovModel`) and OpenIPSL (`Electrical.Controls.PSSE.TG.GGOV1`).
"""

from __future__ import annotations

from math import inf, sqrt
from textwrap import wrap

from shipfp_rs._core import __version__
from shipfp_rs.errors import InputError
from shipfp_rs.exports.drive import require_known
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.structures.linearised import loop_of
from shipfp_rs.structures.structure import Structure
from shipfp_rs.structures.transfer import DERIVATIVE_FILTER

HIGH = 99.0
"""Limit that never acts."""
HEADROOM = 2.0
"""Assumed fuel torque at the open valve, relative to the operating point's, if the data show no torque limit."""
NEEDED = ("vK_p", "vK_i", "vK_d", "K_p", "K_i", "K_d", "v", "g", "T_d", "tau_act", "T_f", "tau_eng", "droop")
"""Parameters that a card holds."""
Values = dict[str, float]


def _governor(fingerprint: Fingerprint) -> tuple[Values, list[str]]:
    """Return the governor's parameters, and comments on the base; `InputError` for an unknown parameter."""
    require_known(fingerprint)
    _, known = loop_of(Structure.from_dict(fingerprint.structure), fingerprint.optimum)
    for name, one in fingerprint.parameters.items():
        if name in NEEDED and one.value is None:
            raise InputError(
                f"{name}: found no value ({one.reason or one.status}), expected a fingerprint that has it; "
                "fix a parameter that is known, such as tau_n, or give torque ahead of the gauge"
            )
    v = known.get("v", 1.0)
    q = {name: known.get(f"v{name}", v * known.get(name, 0.0)) for name in ("K_p", "K_i", "K_d")}
    q |= {name: known.get(name, 0.0) for name in ("tau_act", "T_f", "tau_eng", "droop", "T_set", "set_rate")}
    q["T_d"] = known.get("T_d", 0.0) + 0.5 * known.get("T_s", 0.0)
    q |= {"g": known["g"], "rate": known.get("rate", inf), "M_max": known.get("M_max", inf)}
    point = fingerprint.data[0].get("operating_point", {}) if fingerprint.data else {}
    shown = ", ".join(f"{name} {value:.6g}" for name, value in point.items())
    inertia = fingerprint.parameters.get("tau_n")
    told = "The inertia H is not known: the fingerprint has no tau_n"
    if inertia is not None and inertia.value is not None:
        told = f"H, half of tau_n, is {0.5 * inertia.value:.5g} s, that of engine, shaft and propeller"
    notes = [
        f"{fingerprint.vessel or 'ship'}, governor of a fingerprint by shipfp_rs {__version__}",
        f"Base of power and speed: the operating point ({shown}).",
        "For a machine base S divide K, Kigov, Kpgov, Kdgov by S over the operating point's power.",
        told + "; H belongs to the generator's card.",
        "Bus 1 and identifier 1 are placeholders.",
        f"Droop {q['droop']:.4g}."
        if q["droop"]
        else "Droop is none: isochronous, as the fingerprint's PI governor.",
    ]
    if q["T_set"] or q["set_rate"]:
        notes.append("Dead time and rate limit of the set point have no field; they do not affect the loop.")
    return q, notes


def _card(name: str, fields: dict[str, float], notes: list[str]) -> str:
    """Return the text of a card, with its fields in a comment."""
    told = [*notes, "Fields: " + ", ".join(fields)]
    head = [line for note in told for line in wrap(note, 92, initial_indent="// ", subsequent_indent="//   ")]
    numbers = [f"{value:.7g}" for value in fields.values()]
    rows = [" ".join(numbers[place : place + 8]) for place in range(0, len(numbers), 8)]
    return "\n".join([*head, f"1 '{name}' 1 {rows[0]}", *(f"  {row}" for row in rows[1:])]) + " /\n"


def degov(fingerprint: Fingerprint) -> str:
    """Return the DEGOV card: K (1 + T3 s)(1 + T4 s) exp(-s TD) / (s (1 + T1 s + T1 T2 s^2)(1 + T5 s)(1 + T6 s))."""
    # A PI governor with lags and dead time has this form exactly; a PID governor has it if its zeros are real.
    q, notes = _governor(fingerprint)
    if q["droop"]:
        raise InputError(f"droop: found {q['droop']:.4g}, expected none, since a DEGOV has none; use GGOV1")
    if not q["K_i"] > 0.0:
        raise InputError(
            f"K_i: found {q['K_i']:g}, expected a positive number, since a DEGOV integrates; use GGOV1"
        )
    total, product = q["K_p"] / q["K_i"], q["K_d"] / q["K_i"]
    if total**2 < 4.0 * product:
        raise InputError(
            f"K_d: found complex zeros of the governor, expected K_d of at most K_p^2 / (4 K_i) = "
            f"{q['K_p'] ** 2 / (4.0 * q['K_i']):.4g}, since those of a DEGOV are real; use GGOV1"
        )
    long = 0.5 * (total + sqrt(total**2 - 4.0 * product))
    fields = {"T1": q["T_f"], "T2": 0.0, "T3": long, "K": q["K_i"], "T4": total - long}
    fields |= {"T5": q["tau_act"], "T6": q["tau_eng"], "TD": q["T_d"]}
    fields |= {"Tmax": min(q["M_max"], HIGH), "Tmin": 0.0}
    notes.append(
        "From the fingerprint: K = vK_i, T3 + T4 = K_p over K_i, T1 = T_f, T5 = tau_act, T6 = tau_eng, TD = T_d."
    )
    notes.append(f"The engine's slope g = {q['g']:.5g} has no field: enter -g as the generator's damping D.")
    if q["rate"] < inf:
        notes.append(f"The actuator's rate limit, {q['rate']:.4g} per second, has no field.")
    notes.append(
        "Assumed: Tmin 0"
        + (", Tmax never reached" if q["M_max"] == inf else ", Tmax = M_max on the fuel alone")
    )
    return _card("DEGOV", fields, notes)


def ggov1(fingerprint: Fingerprint) -> str:
    """Return the GGOV1 card: a PID governor, rate-limited actuator, dead time and lag; no load or acceleration limiter."""
    # GGOV1 has no speed filter: T_f is added to the turbine's lag Tb, which is exact if the engine has no lag.
    q, notes = _governor(fingerprint)
    if q["g"] > 0.0:
        raise InputError(
            f"g: found {q['g']:.4g}, expected zero or less, since Dm below zero has another meaning; use DEGOV"
        )
    most = min(q["M_max"], HIGH) if q["M_max"] < inf else HEADROOM
    # Rselect -2: the droop's feedback is the governor's output, which is the fuel torque over Kturb.
    fields = {
        "Rselect": -2 if q["droop"] else 0,
        "Flag": 1,
        "R": most * q["droop"],
        "Tpelec": 1.0,
        "maxerr": HIGH,
        "minerr": -HIGH,
    }
    fields |= {"Kpgov": q["K_p"] / most, "Kigov": q["K_i"] / most, "Kdgov": q["K_d"] / most}
    fields |= {
        "Tdgov": DERIVATIVE_FILTER * q["K_d"] / q["K_p"] if q["K_d"] else 1.0,
        "Vmax": 1.0,
        "Vmin": 0.0,
        "Tact": q["tau_act"],
    }
    fields |= {"Kturb": most, "Wfnl": 0.0, "Tb": q["tau_eng"] + q["T_f"], "Tc": 0.0, "Teng": q["T_d"]}
    fields |= {"Tfload": 3.0, "Kpload": 2.0, "Kiload": 0.67, "Ldref": HIGH, "Dm": -q["g"]}
    fields |= {"Ropen": min(q["rate"] / most, HIGH), "Rclose": -min(q["rate"] / most, HIGH), "Kimw": 0.0}
    fields |= {"Aset": HIGH, "Ka": 10.0, "Ta": 0.1, "Trate": 0.0, "db": 0.0, "Tsa": 4.0, "Tsb": 5.0}
    fields |= {"Rup": HIGH, "Rdown": -HIGH}
    notes += [
        "From the fingerprint: Kpgov, Kigov, Kdgov = vK_p, vK_i, vK_d over Kturb, Tact = tau_act, "
        "Teng = T_d, Tb = tau_eng + T_f, Dm = -g, Ropen = rate over Kturb"
        + (", R = droop times Kturb." if q["droop"] else "."),
        "Flag 1: fuel follows the speed, as of a diesel engine, so the valve sets the torque.",
        f"Kturb {most:.5g}: "
        + ("M_max, on the fuel alone." if q["M_max"] < inf else "assumed, no torque limit was found."),
        "Assumed, off: load limiter (Ldref), acceleration limiter (Aset), deadband, errors' limits.",
        "Dm acts at once; in the fingerprint the engine's slope passes the lag tau_eng.",
    ]
    return _card("GGOV1", fields, notes)
