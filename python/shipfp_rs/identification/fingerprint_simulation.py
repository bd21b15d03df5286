"""Simulation, prediction and linearisation (for python-control) with a fingerprint's model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import ss2tf

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.estimate import Estimate
from shipfp_rs.signals.excitation import Excitation
from shipfp_rs.structures.elements import LATE_CHANNELS
from shipfp_rs.structures.linearised import StateSpace, state_space
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import Count, checked
from shipfp_rs.support.tables import package

DELAYS = ("T_d", "T_set", "tau_act", "T_f", *LATE_CHANNELS)
"""Delays that a linearisation approximates."""
SHORT_S = 1e-3
"""Estimated delay below which a linearisation omits it, since it does not affect the loop [s]."""


class SimulationMixin:
    """Simulations with a fingerprint's model; mixed into `Fingerprint`."""

    structure: Mapping[str, Any]
    settings: Mapping[str, Any]
    parameters: Mapping[str, Estimate]
    data: tuple[Mapping[str, Any], ...]
    vessel: str | None
    experiments: tuple[Experiment, ...]

    @property
    def optimum(self) -> Mapping[str, float]:
        """Name to value of every parameter at the minimum of the search, whether determined or not.

        Raises
        ------
        InputError
            If the fingerprint was not made by a search, or its file lacks the values.
        """
        if "optimum" not in self.settings:
            raise InputError(
                "settings.optimum of the fingerprint: found nothing, expected every parameter's value"
            )
        found: Mapping[str, float] = self.settings["optimum"]
        return found

    def _model(self, structure: Structure | None) -> tuple[Structure, Mapping[str, float]]:
        return structure or Structure.from_dict(self.structure), self.optimum

    @checked
    def simulate(self, drive: Experiment | Excitation, structure: Structure | None = None) -> Experiment:
        """Simulate the fitted ship with noise-free sensors, from rest at the operating point.

        Parameters
        ----------
        drive
            An experiment, of which only the set point is used, or an excitation about the operating point of the data.
        structure
            The fingerprint's structure; None rebuilds it.

        Returns
        -------
        Experiment
            Set point and outputs in the units of the measured signals.

        Raises
        ------
        InputError
            If the structure has user equations and is not given, or an operating point is missing.
        SimulationError
            If the simulation overflows.
        """
        model, values = self._model(structure)
        record = self.data[0] if self.data else {}
        own = drive.operating_point if isinstance(drive, Experiment) else {}
        point = {**record.get("operating_point", {}), **own}
        names = {
            output: record.get("signals", {}).get(output, candidates[0])
            for output, candidates in model.signals.items()
        }
        by_command = drive.driver == "command" if isinstance(drive, Experiment) else "n_set" not in point
        driver = "command" if by_command else "n_set"
        for signal in (driver, *names.values()):
            if signal not in point:
                raise InputError(
                    f"simulate: no operating point of {signal!r}, found {', '.join(point) or 'none'}; give an experiment "
                    "that has it"
                )
        set_point = drive.signals[driver] if isinstance(drive, Experiment) else point[driver] + drive.samples
        # The simulation starts one sample earlier, at rest, so that a step at the start is not taken for the rest state.
        begun = {driver: np.concatenate([[point[driver]], set_point])}
        bare = Experiment(drive.name, drive.rate_hz, begun, point, drive.hold, drive.kind)
        rows = model.part(drive.name).equations.simulate(values, bare)[:, 1:]
        signals = {
            signal: point[signal] * (row if signal == "E_n" else 1.0 + row)
            for signal, row in zip(names.values(), rows, strict=True)
        }
        return Experiment(
            drive.name,
            drive.rate_hz,
            {driver: set_point, **signals},
            point,
            drive.hold,
            drive.kind,
            self._source(),
        )

    @checked
    def predict(self, experiment: Experiment | None = None, structure: Structure | None = None) -> Experiment:
        """Predict an experiment with the fitted model, its initial state and offsets fitted to the measured outputs.

        Parameters
        ----------
        experiment
            Set point and measured outputs; None: the first fitted experiment, which a file does not hold.
        structure
            The fingerprint's structure; None rebuilds it.

        Returns
        -------
        Experiment
            Set point and outputs in the units of the measured signals, at each sample.

        Raises
        ------
        InputError
            As `simulate`, or if an output was not measured.
        """
        record = self.first(experiment)
        model, values = self._model(structure)
        point = record.operating_point
        signals = {
            name: point[name] * (row if name == "E_n" else 1.0 + row)
            for name, row in simulated_about(model, values, record).items()
        }
        return replace(
            record,
            signals={record.driver: record.signals[record.driver], **signals},
            provenance=self._source(),
        )

    def first(self, experiment: Experiment | None = None) -> Experiment:
        """Return the given experiment, or the first fitted one.

        Raises
        ------
        InputError
            If none is given, and the fingerprint comes from a file or was fitted to responses.
        """
        if experiment is None and not self.experiments:
            raise InputError(
                "experiment: found none, and the fingerprint holds none; give the one that is meant"
            )
        return experiment or self.experiments[0]

    def _source(self) -> dict[str, str]:
        return {"simulated": f"fingerprint of {self.vessel or 'a drive train not named'}"}

    def _linearised(self, structure: Structure | None, order: int) -> tuple[StateSpace, str]:
        """Return the linearisation without negligible delays, and its name."""
        model, values = self._model(structure)
        short = [
            name
            for name in DELAYS
            if 0.0 < values.get(name, 0.0) < SHORT_S
            and name in self.parameters
            and self.parameters[name].status != "fixed"
        ]
        name = self.vessel or "drive train"
        if short:
            name += f", without {' and '.join(short)} below {1e3 * SHORT_S:g} ms"
        return state_space(model, {**values, **dict.fromkeys(short, 0.0)}, order), name

    @checked
    def to_ss(self, *, order: Count = 3, structure: Structure | None = None) -> Any:
        """Return the model linearised about the operating point, as a python-control state space with named signals.

        Delays below 1 ms are omitted, which its name says.

        Parameters
        ----------
        order
            Order of the Pade approximation of each dead time.
        structure
            The fingerprint's structure; None rebuilds it.

        Raises
        ------
        InputError
            If python-control is not installed, or the structure has no linearisation.
        """
        control = package("control", "python-control")
        space, name = self._linearised(structure, order)
        return control.ss(
            space.A,
            space.B[:, None],
            space.C,
            space.D[:, None],
            inputs=["dn_set"],
            outputs=list(space.outputs),
            name=name,
        )

    @checked
    def to_tf(self, *, order: Count = 3, structure: Structure | None = None) -> Any:
        """Return the linearised model as python-control transfer functions, one for each output; see `to_ss`."""
        control = package("control", "python-control")
        space, name = self._linearised(structure, order)
        numerators, denominator = ss2tf(space.A, space.B[:, None], space.C, space.D[:, None])
        rows = [[np.trim_zeros(row, "f")] for row in numerators]
        return control.tf(
            rows, [[denominator] for _ in rows], inputs=["dn_set"], outputs=list(space.outputs), name=name
        )
