"""Simulation, prediction and linearisation (for python-control) with a fingerprint's model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, overload

import numpy as np
from scipy.signal import ss2tf

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.identification.draws import Draws
from shipfp_rs.identification.fingerprint_content import Content
from shipfp_rs.signals.excitation import Excitation
from shipfp_rs.structures.elements import LAGS, LATE_CHANNELS
from shipfp_rs.structures.linearised import StateSpace, state_space
from shipfp_rs.structures.prediction import simulated_about
from shipfp_rs.structures.structure import Structure
from shipfp_rs.support.arguments import Count, checked
from shipfp_rs.support.arrays import Array
from shipfp_rs.support.tables import package

DELAYS = (*LAGS, *LATE_CHANNELS)
"""Delays that a linearisation approximates."""
SHORT_S = 1e-3
"""Estimated delay below which a linearisation omits it, since it does not affect the loop [s]."""


class FingerprintSimulation(Content):
    """Simulations with a fingerprint's model."""

    def _model(self, structure: Structure | None) -> tuple[Structure, Mapping[str, float]]:
        return structure or Structure.from_dict(self.structure), self.optimum

    @overload
    def simulate(self, drive: Experiment | Excitation, structure: Structure | None = None) -> Experiment: ...
    @overload
    def simulate(
        self, drive: Experiment | Excitation, structure: Structure | None = None, *, draws: Draws
    ) -> tuple[Experiment, Experiment]: ...
    @checked
    def simulate(
        self,
        drive: Experiment | Excitation,
        structure: Structure | None = None,
        *,
        draws: Draws | None = None,
    ) -> Experiment | tuple[Experiment, Experiment]:
        """Simulate the fitted ship with noise-free sensors, from steady state at the operating point.

        Parameters
        ----------
        drive
            An experiment, from which only the set point is used, or an excitation about the operating point of the data.
        structure
            The fingerprint's structure; None rebuilds it.
        draws
            Ships of `Fingerprint.draws`, of which the first 400 are simulated.

        Returns
        -------
        Experiment or tuple of Experiment
            Set point and outputs in the units of the measured signals. With `draws`, two experiments: the lower and upper
            end of the band that contains 95 % of the drawn ships at each sample.

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
        # The simulation starts one sample earlier, so that a step at the first sample is not taken for the steady state.
        begun = {driver: np.concatenate([[point[driver]], set_point])}
        bare = Experiment(drive.name, drive.rate_hz, begun, point, drive.hold, drive.kind)
        equations = model.part(drive.name).equations

        def simulated(known: Mapping[str, float]) -> dict[str, Array]:
            return dict(zip(names.values(), equations.simulate(known, bare)[:, 1:], strict=True))

        return self._with_band(bare, set_point, simulated, values, draws)

    @overload
    def predict(
        self, experiment: Experiment | None = None, structure: Structure | None = None
    ) -> Experiment: ...
    @overload
    def predict(
        self, experiment: Experiment | None = None, structure: Structure | None = None, *, draws: Draws
    ) -> tuple[Experiment, Experiment]: ...
    @checked
    def predict(
        self,
        experiment: Experiment | None = None,
        structure: Structure | None = None,
        *,
        draws: Draws | None = None,
    ) -> Experiment | tuple[Experiment, Experiment]:
        """Predict an experiment with the fitted model; initial state and offsets are fitted to the measured outputs.

        Parameters
        ----------
        experiment
            Set point and measured outputs. None: the first fitted experiment, which a file does not contain.
        structure
            The fingerprint's structure; None rebuilds it.
        draws
            See `simulate`.

        Returns
        -------
        Experiment or tuple of Experiment
            Set point and outputs, or two ends of a band, as for `simulate`.
        """
        record = self.first(experiment)
        model, values = self._model(structure)

        def predicted(known: Mapping[str, float]) -> Mapping[str, Array]:
            return simulated_about(model, known, record)

        return self._with_band(record, record.signals[record.driver], predicted, values, draws)

    def _with_band(
        self,
        record: Experiment,
        set_point: Array,
        simulated: Callable[[Mapping[str, float]], Mapping[str, Array]],
        values: Mapping[str, float],
        draws: Draws | None,
    ) -> Experiment | tuple[Experiment, Experiment]:
        """Return the simulation with the best values, or both ends of the 95 % band of the draws."""
        if draws is None:
            return self._simulated(record, set_point, simulated(values))
        every = draws.of(lambda drawn: simulated({**values, **drawn}))
        bands = {name: np.quantile([one[name] for one in every], [0.025, 0.975], axis=0) for name in every[0]}
        low, high = ({name: band[end] for name, band in bands.items()} for end in (0, 1))
        return self._simulated(record, set_point, low), self._simulated(record, set_point, high)

    def first(self, experiment: Experiment | None = None) -> Experiment:
        """Return the given or the first fitted experiment; `InputError` if neither exists, as after reading from a file."""
        if experiment is None and not self.experiments:
            raise InputError(
                "experiment: found none, and the fingerprint holds none; give the one that is meant"
            )
        return experiment or self.experiments[0]

    def _simulated(self, record: Experiment, set_point: Array, rows: Mapping[str, Array]) -> Experiment:
        """Return an experiment with this set point, and with deviations by signal converted to the signals' units."""
        point = record.operating_point
        outputs = {name: point[name] * (row if name == "E_n" else 1.0 + row) for name, row in rows.items()}
        source = {"simulated": f"fingerprint of {self.vessel or 'a drive train not named'}"}
        return replace(record, signals={record.driver: set_point, **outputs}, provenance=source)

    def linearised(self, structure: Structure | None = None, order: int = 3) -> tuple[StateSpace, str]:
        """Return the linearised model without negligible delays, and its name."""
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

        Delays below 1 ms are omitted; the name of the system says so.

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
        space, name = self.linearised(structure, order)
        matrices = space.A, space.B[:, None], space.C, space.D[:, None]
        return control.ss(*matrices, inputs=["dn_set"], outputs=list(space.outputs), name=name)

    @checked
    def to_tf(self, *, order: Count = 3, structure: Structure | None = None) -> Any:
        """Return the linearised model as python-control transfer functions, one for each output; see `to_ss`."""
        control = package("control", "python-control")
        space, name = self.linearised(structure, order)
        numerators, denominator = ss2tf(space.A, space.B[:, None], space.C, space.D[:, None])
        rows = [[np.trim_zeros(row, "f")] for row in numerators]
        names = {"inputs": ["dn_set"], "outputs": list(space.outputs), "name": name}
        return control.tf(rows, [[denominator]] * len(rows), **names)
