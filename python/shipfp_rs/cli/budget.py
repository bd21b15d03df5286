"""`shipfp budget`: uncertainty of the quantities in SI units due to each calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from shipfp_rs.cli.options import (
    Json,
    file_argument,
    not_negative,
    number_option,
    print_results,
    print_table,
    print_text,
)

if TYPE_CHECKING:
    from shipfp_rs.assessment.budget import Budget


def budget(
    fingerprint: Annotated[Path, file_argument("FINGERPRINT.json", "Fingerprint with SI units.")],
    torque: Annotated[
        float, number_option("PCT", "Standard uncertainty of the torque's scale, %.", not_negative)
    ] = 1.0,
    zero: Annotated[
        float, number_option("PCT", "That of its zero, % of the operating torque.", not_negative)
    ] = 0.5,
    speed: Annotated[float, number_option("PCT", "That of the speed's scale, %.", not_negative)] = 0.01,
    clock: Annotated[float, number_option("PCT", "That of the logger's clock, %.", not_negative)] = 0.005,
    ratio: Annotated[float, number_option("PCT", "That of the gear ratio, %.", not_negative)] = 0.0,
    json: Json = False,
) -> None:
    """Show how each calibration, and the fit, contribute to the uncertainty of the quantities in SI units."""
    from shipfp_rs.assessment.budget import budget as budgets
    from shipfp_rs.identification.fingerprint import Fingerprint

    found = budgets(
        Fingerprint.load(fingerprint),
        torque_pct=torque,
        zero_pct=zero,
        speed_pct=speed,
        clock_pct=clock,
        ratio_pct=ratio,
    )
    content = {name: one.to_dict() for name, one in found.items()}
    print_results(content, lambda: _print(found), json=json)


def _print(found: dict[str, Budget]) -> None:
    rows = []
    for one in found.values():
        rows.append([one.quantity, f"{one.value:.5g}", f"{one.u:.2g}", "100", one.unit])
        rows += [
            [f"  {part.input}", "", f"{part.u:.2g}", f"{100.0 * part.share:.0f}", one.unit]
            for part in one.contributions
        ]
    print_table("Uncertainty budget", ["quantity", "value", "u", "% of variance", "unit"], rows)
    for one in found.values():
        print_text(
            f"{one.quantity}: half the uncertainty of the {one.halved} leaves u = {one.then_u:.2g} {one.unit}."
        )
