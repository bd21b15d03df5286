"""A fingerprint's model at work: simulations, predictions, and its linearisation for python-control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.signal import ss2tf

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.signals.excitation import Excitation
from shipfp_rs.structures.linearised import StateSpace, state_space
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import Count, checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.tables import package


class Modelled:
    """Simulations with a fingerprint's model; mixed into `Fingerprint`."""

    structure: Mapping[str, Any]
    settings: Mapping[str, Any]
    data: tuple[Mapping[str, Any], ...]
    vessel: str | None

    @property
    def optimum(self) -> Mapping[str, float]:
        """Name to value where the search ended, of every parameter, told or not.

        Raises
        ------
        InputError
            Where the fingerprint was not made by a search, or its file lacks them.
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
        """Return what noise-free sensors would record of the fitted ship, from rest at the operating point.

        Parameters
        ----------
        drive
            An experiment, whose set point is taken and whose measured signals are not, or an excitation about the
            operating point of the data.
        structure
            The fingerprint's; None rebuilds it.

        Returns
        -------
        Experiment
            Set point and outputs in the units of the measured signals.

        Raises
        ------
        InputError
            Where the structure has equations of a user's own and is not given, or an operating point is missing.
        SimulationError
            Where the model leaves the range of finite numbers.
        """
        model, values = self._model(structure)
        record = self.data[0] if self.data else {}
        own = drive.operating_point if isinstance(drive, Experiment) else {}
        point = {**record.get("operating_point", {}), **own}
        names = {
            output: record.get("signals", {}).get(output, candidates[0])
            for output, candidates in model.signals.items()
        }
        for signal in ("n_set", *names.values()):
            if signal not in point:
                raise InputError(
                    f"simulate: no operating point of {signal!r}, found {', '.join(point) or 'none'}; give an experiment "
                    "that has it"
                )
        set_point = (
            drive.signals["n_set"] if isinstance(drive, Experiment) else point["n_set"] + drive.samples
        )
        bare = Experiment(drive.name, drive.rate_hz, {"n_set": set_point}, point, drive.hold, drive.kind)
        rows = model.part(drive.name).equations.simulate(values, bare)
        signals = {
            signal: point[signal] * (row if signal == "E_n" else 1.0 + row)
            for signal, row in zip(names.values(), rows, strict=True)
        }
        source = {"simulated": f"fingerprint of {self.vessel or 'a drive train not named'}"}
        return Experiment(
            drive.name, drive.rate_hz, {"n_set": set_point, **signals}, point, drive.hold, drive.kind, source
        )

    @checked
    def predict(self, experiment: Experiment, structure: Structure | None = None) -> Mapping[str, Array]:
        """Return what the fitted model makes of an experiment, its initial state and offsets fitted to what was measured.

        Parameters
        ----------
        experiment
            Set point and measured outputs.
        structure
            The fingerprint's; None rebuilds it.

        Returns
        -------
        dict
            Signal name to normalised deviation, shape (N,).

        Raises
        ------
        InputError
            As `simulate`, or where an output was not measured.
        """
        model, values = self._model(structure)
        return simulated_about(model, values, experiment)

    def _linearised(self, structure: Structure | None, order: int) -> StateSpace:
        return state_space(*self._model(structure), order)

    @checked
    def to_ss(self, *, order: Count = 3, structure: Structure | None = None) -> Any:
        """Return the model linearised about the operating point as a state space of python-control, signals named.

        Parameters
        ----------
        order
            Order of the Pade approximation of each dead time.
        structure
            The fingerprint's; None rebuilds it.

        Raises
        ------
        InputError
            Where python-control is not installed, or the structure has no linearisation.
        """
        control = package("control", "python-control")
        space = self._linearised(structure, order)
        return control.ss(
            space.A,
            space.B[:, None],
            space.C,
            space.D[:, None],
            inputs=["dn_set"],
            outputs=list(space.outputs),
        )

    @checked
    def to_tf(self, *, order: Count = 3, structure: Structure | None = None) -> Any:
        """Return the same as transfer functions of python-control, one for each output; see `to_ss`."""
        control = package("control", "python-control")
        space = self._linearised(structure, order)
        numerators, denominator = ss2tf(space.A, space.B[:, None], space.C, space.D[:, None])
        rows = [[np.trim_zeros(row, "f")] for row in numerators]
        return control.tf(rows, [[denominator] for _ in rows], inputs=["dn_set"], outputs=list(space.outputs))
