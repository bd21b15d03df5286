"""Tables 3.4 to 3.6, 4.2 and 5.1 of the thesis: what holds before anything is fitted to a trial."""

from __future__ import annotations

import math

import numpy as np

from shipfp_rs import published
from shipfp_rs.frequency import FrequencyResponse
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.identification.wording import rank
from shipfp_rs.reproduce import Row, Way
from shipfp_rs.reproduce.virtual_data import launch, searched_as_printed
from shipfp_rs.signals import published_sine_sequence
from shipfp_rs.structures.structure import Structure
from shipfp_rs.vessel.linear_model import LinearModel, linearise, linearise_numerically
from shipfp_rs.vessel.steady_state import steady_state

SYMBOLS = {
    "engine_speed_n0": "n_0",
    "fuel_rack_X0": "X_0",
    "brake_torque_Mb0": "M_b0",
    "shaft_torque_Ms0": "M_s0",
    "shaft_speed_ns0": "n_s0",
    "brake_power_Pb0": "P_b0",
    "Kp": "K_p",
    "Ki": "K_i",
}
CORRECTIONS = (
    "eq. 4.15 reads (s + e)/(s^2 + as + b) and eq. 4.16 (fs^2 + hs + i)/(s^2 + as + b) to agree with eq. B.1 to B.3; "
    "so the last line of Table 4.2 is vK_p = f, the first once more, and its entry g is no coefficient"
)
MEASURED = {
    "n": ("dn",),
    "n, E_n": ("dn", "dE"),
    "n, M_b": ("dn", "dM"),
    "n, E_n, M_b": ("dn", "dE", "dM"),
    "n, M_b, X_f": ("dn", "dM", "dX"),
}
"""Sets of measured signals whose internal relations are counted."""
SIGNALS = {"dn": "n_e", "dE": "E_n", "dM": "M_b", "dX": "X_f"}


def rows() -> tuple[list[Row], dict[str, Fingerprint]]:
    """Return the rows of these tables and the fingerprints behind Table 4.2."""
    relations, fingerprints = _internal_relations()
    return [*_gains(), *_operating_point(), *_normalised(), *relations, *_schedule()], fingerprints


def relations_of(values: LinearModel) -> dict[str, tuple[float, float]]:
    """Return both sides of every line of Table 4.2, corrected, with the coefficients of eq. B.1 to B.3."""
    tau, g, vK_p, vK_i = values.tau_n, values.g, values.v * values.K_p, values.v * values.K_i
    a, b, c, d, e = (2 - g + vK_p) / tau, vK_i / tau, vK_p / tau, vK_i / tau, (2 - g) / tau
    f, h, i = vK_p, (vK_i * tau + 2 * vK_p) / tau, 2 * vK_i / tau
    return {
        "vK_p = f": (vK_p, f),
        "vK_p = c tau_n": (vK_p, c * tau),
        "-g = e tau_n - 2": (-g, e * tau - 2),
        "vK_i = b tau_n": (vK_i, b * tau),
        "2 vK_i = i tau_n": (2 * vK_i, i * tau),
        "vK_i = d tau_n": (vK_i, d * tau),
        "2/tau_n vK_p + vK_i = h": (2 / tau * vK_p + vK_i, h),
        "vK_p - g = a tau_n - 2": (vK_p - g, a * tau - 2),
    }


def _gains() -> list[Row]:
    """Table 3.4, with the parameters of eq. 5.1 where it is printed as a formula."""
    model, structure = linearise(launch()), "linear, eq. 3.31, 3.35, 3.38"
    printed = {"dn(0)": 1.0, "dE(0)": 2.583 / 1.583, "dM(0)": 2.0, "dM(inf)": 15.83}
    found = [
        model.dc_gain("dn"),
        model.dc_gain("dE"),
        model.dc_gain("dM_b"),
        model.high_frequency_gain("dM_b"),
    ]
    gains = (
        "gains of n*, E_n*, M_s* to a slow set point, and of M_s* to a fast one (eq. 3.32, 3.36, 3.39, 3.40)"
    )
    ours = dict(zip(printed, found, strict=True))
    return [
        Row("3.4", "gains", "printed", structure, printed, gains),
        Row("3.4", "gains", "ours", structure, ours, "gain of E_n* in s, the others without unit"),
    ]


def _printed_point() -> dict[str, float]:
    return {SYMBOLS.get(row.quantity, row.quantity): row.value for row in published.virtual_operating_point()}


def _operating_point() -> list[Row]:
    point, printed = steady_state(launch()), _printed_point()
    values = (point.n_e, point.X_f, point.M_b, point.M_s, point.n_s, point.brake_power / 1e3)
    ours = dict(zip(("n_0", "X_0", "M_b0", "M_s0", "n_s0", "P_b0"), values, strict=True))
    shown = {name: printed[name] for name in ours}
    ratio = printed["M_s0"] / printed["M_b0"]
    notes = (
        f"n_0 is 1300/60 = {point.n_e:.3f} rev/s, printed {printed['n_0']} with its last digits wrong; the "
        f"printed torques are {ratio:.4f} apart, 3 x 0.95 is 2.85: M_b0 or M_s0 is off by {100 * (ratio / 2.85 - 1):.2f} %"
    )
    return [
        Row("3.5", "1300 rpm", "printed", "plant", shown, "rev/s, mm, Nm, Nm, rev/s, kW"),
        Row("3.5", "1300 rpm", "ours", "plant", ours, notes),
    ]


def _normalised() -> list[Row]:
    vessel, printed = launch(), _printed_point()
    exact, numerical = (
        {name: getattr(model, name) for name in ("v", "g", "K_p", "K_i", "tau_n")}
        for model in (linearise(vessel), linearise_numerically(vessel))
    )
    shown = {name: printed[name] for name in exact}
    per_torque = 2.0 * math.pi * vessel.shaft.inertia_kg_m2 * vessel.nominal_shaft_speed
    lossless = {**shown, "tau_n": per_torque / (vessel.gearbox.ratio * printed["M_b0"])}
    rows: tuple[tuple[str, Way, dict[str, float], str], ...] = (
        ("", "printed", shown, ""),
        (
            "",
            "thesis",
            lossless,
            "eq. 3.23 with M_s0 = 3 x 222.93 Nm, no loss in the gearbox; eq. 5.1 has 1.442 s",
        ),
        (
            "",
            "ours",
            exact,
            f"eq. 3.23 with M_s0 = 2.85 x 222.93 Nm; with the printed M_s0 {printed['M_s0']} Nm "
            f"{per_torque / printed['M_s0']:.4f} s",
        ),
        (
            ", central differences",
            "ours",
            numerical,
            "from the plant's own right-hand side, in place of the Linearisation Tool",
        ),
    )
    return [Row("3.6", f"1300 rpm{by}", way, "linear", values, notes) for by, way, values, notes in rows]


def _internal_relations() -> tuple[list[Row], dict[str, Fingerprint]]:
    """Table 4.2: what each set of signals tells of five unknowns, as the rank of the sensitivities."""
    model = linearise(launch())
    known: dict[str, float | None] = {"tau_n": model.tau_n, "g": model.g}
    known |= {"vK_p": model.v * model.K_p, "vK_i": model.v * model.K_i}
    known |= dict.fromkeys(("v", "K_p", "K_i"))
    worst = max(abs(left - right) for left, right in relations_of(model).values())
    printed = "tau_n, g, vK_p, vK_i from c, e, b, f; values of ours"
    corrected = f"{CORRECTIONS}; corrected, every line holds to {worst:.0e}"
    found = [
        Row("4.2", "n, M_b", "printed", "linear", known, printed),
        Row("4.2", "n, M_b", "thesis", "linear", known, corrected),
    ]
    frequency = np.array([segment.frequency_hz for segment in published_sine_sequence().segments])
    exact = model.response(frequency, ("dn", "dE", "dM_b", "dX"))
    response = FrequencyResponse("exact", frequency, dict(zip(SIGNALS.values(), exact, strict=True)))
    fingerprints = {}
    for case, outputs in MEASURED.items():
        structure = searched_as_printed(Structure.linear(outputs=outputs, name="linear"))
        fingerprint = fingerprints[f"4.2 {case}"] = identify(response, structure, noise="white")
        notes = str(rank(fingerprint.identifiability))
        if closing := fingerprint.identifiability.closes_gap:
            notes += f" One known from elsewhere would settle the rest: {', '.join(closing)}."
        estimates = {**fingerprint.parameters, **fingerprint.derived}
        values = {name: estimate.value for name, estimate in estimates.items()}
        found.append(Row("4.2", case, "ours", "linear", values, notes))
    return found, fingerprints


def _schedule() -> list[Row]:
    """Table 5.1: the frequencies that the printed times imply."""
    rows = published.virtual_schedule()
    printed = {f"{row.begin_s:g} s": row.frequency_hz for row in rows}
    exact = {f"{row.begin_s:g} s": 4.0 / (row.end_s - row.begin_s) for row in rows}
    notes = "four periods between the printed times, each of whole hundredths of a second"
    return [
        Row("5.1", "frequency [Hz]", "printed", "", printed),
        Row("5.1", "frequency [Hz]", "ours", "", exact, notes),
    ]
