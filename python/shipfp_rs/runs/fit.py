"""Fit requested by a TRIAL.toml or a SWEEP.toml: a declared structure, or a selection within the full ship."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shipfp_rs.processing.trial import Trial
from shipfp_rs.processing.trial_tables import Identify
from shipfp_rs.structures.outputs import Torque
from shipfp_rs.structures.structure import Structure


def choice(trial: Trial) -> dict[str, Any]:
    """Arguments of `identify` from a trial's [identify] table, for a selection by the data."""
    options, place = trial.identify, located(trial)
    outputs = list(options.outputs) if "outputs" in options.model_fields_set else None
    return {
        "elements": options.elements,
        "torque": options.torque or place,
        "outputs": outputs if outputs is None else _measured(outputs, place),
        "fixed": {**({"v": 1.0, "g": 0.0} if trial.channels.asks_for_torque else {}), **options.fixed},
        "priors": options.priors,
    }


def structure_from(options: Identify, located: Torque | None) -> Structure:
    """Ship declared by an [identify] table; `located` is where its torque was measured, None if it was not.

    Raises
    ------
    InputError
        If it names an unknown element, parameter or output.
    """
    structure = Structure.ship(
        options.acting,
        torque=options.torque or located or "brake",
        outputs=_measured(options.outputs, located),
        products=options.products,
    )
    return structure.with_fixed(**options.fixed).with_prior(**options.priors).with_tied(**options.tied)


def located(trial: Trial) -> Torque | None:
    """Location of a trial's measured torque; None without one."""
    return None if trial.channels.torque is None else trial.channels.torque.place


def _measured(outputs: Sequence[str], located: Torque | None) -> list[str]:
    """Outputs, without the torque if none was measured."""
    return [output for output in outputs if output != "dM" or located is not None]
