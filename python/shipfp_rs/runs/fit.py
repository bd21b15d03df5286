"""The fit that a TRIAL.toml or a SWEEP.toml asks for: its structure, or what it leaves open of the full ship."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shipfp_rs.processing.trial import Trial
from shipfp_rs.processing.trial_tables import Identify
from shipfp_rs.structures.outputs import Torque
from shipfp_rs.structures.structure import Structure


def choice(trial: Trial) -> dict[str, Any]:
    """Return what a trial's [identify] table leaves open of the full ship, as arguments of `identify`."""
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
    """Return the ship that an [identify] table declares, the torque measured there, or not at all (None).

    Raises
    ------
    InputError
        Where it names an unknown element, parameter or output.
    """
    structure = Structure.ship(
        options.acting,
        torque=options.torque or located or "brake",
        outputs=_measured(options.outputs, located),
        products=options.products,
    )
    return structure.with_fixed(**options.fixed).with_prior(**options.priors).with_tied(**options.tied)


def located(trial: Trial) -> Torque | None:
    """Return where a trial's torque was measured; None where it was not."""
    return None if trial.channels.torque is None else trial.channels.torque.place


def _measured(outputs: Sequence[str], located: Torque | None) -> list[str]:
    """Outputs without the torque where none was measured."""
    return [output for output in outputs if output != "dM" or located is not None]
