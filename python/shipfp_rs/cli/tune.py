"""`shipfp tune`: advises the governor's next gains."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from shipfp_rs.cli.options import (
    Json,
    Replace,
    Seed,
    as_typed,
    file_argument,
    file_option,
    new_file,
    not_negative,
    number_option,
    print_results,
    print_table,
    print_text,
    progress,
)

if TYPE_CHECKING:
    from shipfp_rs.assessment.tuning import Tuning

TYPED = {
    "phase_margin_deg": "--phase-margin",
    "overshoot_pct": "--overshoot",
    "dip_pct": "--dip",
    "recovery_s": "--recovery",
    "droop_pct": "--droop",
}
"""Command-line options by argument of `tune`."""
DIALS = {"gain": "gain on the dial", "reset": "reset on the dial", "droop_pct": "droop on the dial [%]"}


def tune(
    fingerprint: Annotated[
        Path, file_argument("FINGERPRINT.json", "Fingerprint in the folder that `shipfp run` wrote.")
    ],
    phase_margin: Annotated[float, number_option("DEG", "Least phase margin, deg.")] = 45.0,
    overshoot: Annotated[
        float, number_option("PCT", "Largest overshoot of a set-point step, % of the step.")
    ] = 20.0,
    dip: Annotated[
        float | None, number_option("PCT", "Largest dip after a load step, % of the speed.")
    ] = None,
    recovery: Annotated[
        float | None, number_option("S", "Longest time until the speed has recovered from a load step, s.")
    ] = None,
    droop: Annotated[
        float | None,
        number_option("PCT", "Droop to set, % of the speed at the operating torque.", not_negative),
    ] = None,
    load_step: Annotated[float, number_option("PCT", "Step of the load, % of the operating torque.")] = 10.0,
    band: Annotated[float, number_option("PCT", "Band of the recovered speed, % of the speed.")] = 1.0,
    plot: Annotated[Path | None, file_option("FILE.png", "Picture of the map of gains.")] = None,
    force: Replace = False,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Advise governor gains that meet limits for nearly all ships consistent with a trial's data."""
    from shipfp_rs.assessment.tuning import tune as advise
    from shipfp_rs.identification.fingerprint import Fingerprint

    found = Fingerprint.load(fingerprint)
    if plot is not None:
        new_file(plot, force=force)
    with as_typed(TYPED), progress() as tell:
        tell("trying gains")
        advice = advise(
            found,
            phase_margin_deg=phase_margin,
            overshoot_pct=overshoot,
            dip_pct=dip,
            recovery_s=recovery,
            droop_pct=droop,
            load_step_pct=load_step,
            band_pct=band,
            seed=seed,
        )
    if plot is not None:
        from shipfp_rs.plot.gain_map import gains
        from shipfp_rs.support.files import replacing

        with replacing(plot) as temporary:
            figure = gains(advice).figure
            figure.savefig(temporary, format="png", dpi=110)  # type: ignore[union-attr]
    print_results(advice.to_dict(), lambda: _print(advice), plot, json=json)


def _print(advice: Tuning) -> None:
    from shipfp_rs.assessment.tuning import UNITS

    told = {**advice.gains, **{DIALS[name]: row for name, row in advice.dials.items()}}
    rows = [[name, f"{today:.4g}", f"{then:.4g}"] for name, (today, then) in told.items()]
    print_table("Gains", ["gain", "today", "advised"], rows)
    rows = [
        [
            name,
            *(f"{one[name][0]:.3g} ({one[name][1]:.3g})" for one in (advice.figures_today, advice.figures)),
            f"{advice.limits[name]:.3g}" if name in advice.limits else "",
            unit,
        ]
        for name, unit in UNITS.items()
    ]
    head = ["figure: median (95 % keep to)", "today", "advised", "limit", "unit"]
    print_table("Steps of set point and load", head, rows)
    print_text(
        f"The advised gains meet the limits for {100.0 * advice.share:.0f} % of the ships that the data allow, today's for "
        f"{100.0 * advice.share_today:.0f} %. Both gains may rise by {100.0 * (advice.rise - 1.0):.0f} % together before "
        "fewer than 95 % meet them. Change them in steps, and look at the speed after each."
    )
