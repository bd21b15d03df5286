"""Structure for experiments in open loop: a drive that follows a command, with the measured outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.input_checks import is_loaded
from shipfp_rs.identification.question import OF_SIGNALS, PRIORS, SIGNALS, Options
from shipfp_rs.identification.structure_fit import StructureQuestion
from shipfp_rs.structures.parameter import Torque
from shipfp_rs.structures.ship import commanded
from shipfp_rs.structures.structure import Structure


def in_open_loop(experiments: Sequence[Experiment]) -> bool:
    """Whether the experiments have a command instead of a set point; `InputError` if only some of them have."""
    drivers = {one.driver for one in experiments}
    if len(drivers) > 1:
        raise InputError(
            "identify: some experiments have a set point, others a command; expected all in closed or all in open loop"
        )
    return drivers == {"command"}


def require_driver(data: Sequence[object], structure: Structure) -> None:
    """Refuse a governor's structure for experiments with a command, and vice versa."""
    expected = {"commanded": "command", "linear": "n_set", "ship": "n_set"}.get(structure.settings["kind"])
    for one in data:
        if isinstance(one, Experiment) and expected not in (None, one.driver):
            raise InputError(
                f"experiment {one.name!r}: driven by {one.driver!r}, structure {structure.name!r} expects {expected!r}; "
                "leave the structure out, or give another one"
            )


def question_in_open_loop(
    experiments: Sequence[Experiment],
    *,
    torque: Torque | None = None,
    outputs: Sequence[str] | None = None,
    elements: Mapping[str, bool] | None = None,
    fixed: Mapping[str, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    options: Options,
) -> StructureQuestion:
    """Return the question of a drive in open loop with the outputs of all experiments; arguments as in `identify`."""
    common = set.intersection(*(set(one.signals) for one in experiments))
    measured = next((name for name in SIGNALS if name in common), None)
    if outputs is None:
        outputs = ["dn", *(["dM"] if measured else [])]
    outputs = [OF_SIGNALS.get(output, output) for output in outputs]
    acts = {"dead_time_loop": True, "actuator_lag": True, "load": is_loaded(experiments)}
    acts |= dict.fromkeys(("curvature", "late_torque"), "dM" in outputs)
    acting = [name for name, on in {**acts, **(elements or {})}.items() if on]
    place = torque or (SIGNALS[measured] if measured else "brake")
    structure: Structure = commanded(Structure, acting, torque=place, outputs=outputs)
    known = {name: PRIORS[name] for name in structure.names if name in ("c_2", "T_M")}
    structure = structure.with_prior(**{**known, **(priors or {})})
    # Without a torque only tau_n / v and (p - g) / v are identifiable. Then v is 1 and g is 0 unless given, as for a drive
    # whose torque follows the command; v is free where the inertia is known.
    given = {} if "dM" in outputs else {"g": 0.0} | ({"k_L": 1.0} if "load" in acting else {})
    if "dM" not in outputs and not {"tau_n", "v"} & {*(fixed or {}), *(priors or {})}:
        given["v"] = 1.0
    assumed = tuple(name for name in given if name not in (fixed or {}))
    structure = structure.with_fixed(**{**given, **(fixed or {})})
    return StructureQuestion(tuple(experiments), structure, options, assumed)
