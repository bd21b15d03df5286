"""Faults that an inspection searched in each channel, since without a trial the channels' roles are unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from shipfp_rs.inspection.channels import ChannelReport
from shipfp_rs.logs.faults.record import KINDS
from shipfp_rs.processing.trial import Trial

OF_ANY = ("gap", "dropout", "stuck", "clipped", "repeated", "spike")
"""Faults of level and spikes, searched in any channel except pulse trains."""
OF_A_TRAIN = ("gap",)
SPIKES: Mapping[str, str] = {"set_point": "D1", "torque": "C"}
"""Kind of a spike in a channel of this role."""
OF_ROLES: Mapping[str, tuple[str, ...]] = {
    "set_point": ("D2", "D3"),
    "torque": ("sign",),
    "train": ("A", "B", "faint"),
}
"""Faults specific to channels of a role, which a trial assigns."""


def looked_for(reports: Sequence[ChannelReport], trial: Trial | None) -> dict[str, Any]:
    """JSON form: "channels", the fault kinds searched in each, and "left_out", the kinds searched in none."""
    found = {
        report.channel.name: [*(OF_ANY if report.pulses_hz is None else OF_A_TRAIN)]
        for report in reports
        if report.channel.samples
    }
    if trial is not None:
        roles = {trial.channels.driver.column: "set_point"}
        if trial.channels.torque is not None:
            roles[trial.channels.torque.column] = "torque"
        roles |= {tacho.column: "train" for tacho in trial.channels.tachos.values() if tacho.kind == "pulses"}
        for name, role in roles.items():
            if name in found:
                kinds = [SPIKES.get(role, kind) if kind == "spike" else kind for kind in found[name]]
                found[name] = [*kinds, *OF_ROLES[role]]
    told = {kind for kinds in found.values() for kind in kinds}
    left_out = [kind for kinds in OF_ROLES.values() for kind in kinds if kind not in told]
    return {"channels": found, "left_out": left_out}


def sentences(told: Mapping[str, Any], *, trial: bool) -> list[str]:
    """Sentences on which faults were searched; channels with the same faults share one."""
    together: dict[tuple[str, ...], list[str]] = {}
    for name, kinds in told["channels"].items():
        together.setdefault(tuple(kinds), []).append(name)
    lines = [
        f"Looked for {', '.join(KINDS[kind] for kind in kinds)} in {', '.join(names)}."
        for kinds, names in together.items()
    ]
    if told["left_out"] and not trial:
        kinds = ", ".join(KINDS[kind] for kind in told["left_out"])
        lines.append(
            f"Not looked for: {kinds}; "
            "a log does not tell which channel is what, its trial does (shipfp inspect LOG TRIAL.toml)"
        )
    return lines
