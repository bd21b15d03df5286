"""The fit that a TRIAL.toml or a SWEEP.toml asks for: its structure, and the choice that the data make."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.fingerprint import Fingerprint
from shipfp_rs.identification.identify import identify
from shipfp_rs.processing.trial import Trial
from shipfp_rs.processing.trial_tables import Identify
from shipfp_rs.structures.structure import Structure, Torque
from shipfp_rs.vessel.vessel import Vessel


def chosen(
    trial: Trial, experiments: Sequence[Experiment], vessel: Vessel, *, seed: int | None
) -> Fingerprint:
    """Let the data choose the structure within what a trial's [identify] table leaves open."""
    torque, options = trial.channels.torque, trial.identify
    located: Torque | None = None if torque is None else torque.place
    outputs = list(options.outputs) if "outputs" in options.model_fields_set else None
    return identify(
        experiments,
        elements=options.elements,
        torque=options.torque or located,
        outputs=outputs if outputs is None else _measured(outputs, located),
        fixed=options.fixed,
        priors=options.priors,
        seed=options.seed if seed is None else seed,
        vessel=vessel.name,
    )


def structure_of(trial: Trial, vessel: Vessel) -> Structure:
    """Return the structure that a trial's [structure] table, or else its [identify] table, asks for.

    Raises
    ------
    InputError
        Where it names an unknown parameter or output, or an element that the vessel has not.
    """
    torque, box, options = trial.channels.torque, trial.structure, trial.identify
    located: Torque | None = None if torque is None else torque.place
    if box is None:
        return structure_from(options, located)
    structure = Structure.grey_box(
        vessel,
        box.free,
        torque=box.torque or located or "brake",
        outputs=_measured(box.outputs, located),
        pass_hz=box.pass_hz,
    )
    return structure.with_fixed(**options.fixed).with_prior(**options.priors).with_tied(**options.tied)


def structure_from(options: Identify, located: Torque | None) -> Structure:
    """Return the structure that an [identify] table asks for, the torque measured there, or not at all (None).

    Raises
    ------
    InputError
        Where it names an unknown parameter or output.
    """
    torque = options.torque or located or "brake"
    # The engine's torque is no part of three parameters unless it is asked for.
    asked = not options.three_parameters or torque == "gauge" or "outputs" in options.model_fields_set
    declare = (
        Structure.three_parameters
        if options.three_parameters
        else partial(Structure.linear, products=options.products, **options.linear_elements)
    )
    structure = declare(
        torque=torque,
        free_exponent=options.free_exponent,
        dead_time_loop=options.dead_time_loop,
        dead_time_set_point=options.dead_time_set_point,
        outputs=_measured(options.outputs, located if asked else None),
    )
    return structure.with_fixed(**options.fixed).with_prior(**options.priors).with_tied(**options.tied)


def _measured(outputs: Sequence[str], located: Torque | None) -> list[str]:
    """Outputs without the torque where none was measured."""
    return [output for output in outputs if output != "dM" or located is not None]
