"""Interface of a structure's equations, with defaults."""

from __future__ import annotations

from abc import ABC, abstractmethod

from shipfp_rs.errors import InputError
from shipfp_rs.experiments.experiment import Experiment
from shipfp_rs.support.arrays import Array, ComplexArray, Names, Values


class Equations(ABC):
    """Outputs of a structure and their derivatives; all other members have default implementations."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of initial states that may be estimated and are zero if not given; the names start with "initial"."""
        return ()

    @property
    def linear_in(self) -> tuple[str, ...]:
        """Names of the initial states on which the outputs depend linearly."""
        return ()

    @property
    def own_offsets(self) -> bool:
        """Whether the states include errors of the operating point; `identify` then adds no offsets to the outputs."""
        return False

    @abstractmethod
    def simulate(self, values: Values, experiment: Experiment) -> Array:
        """Return the normalised outputs, shape (O, N)."""

    @abstractmethod
    def sensitivities(self, values: Values, experiment: Experiment, names: Names) -> tuple[Array, Array]:
        """Return the outputs (O, N) and their derivatives by `names`, shape (W, O, N)."""

    def response(
        self, values: Values, frequency_hz: Array, names: Names
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the response (O, F) and its derivatives by `names`, shape (W, O, F); `InputError` if there is none."""
        raise InputError("this structure has no frequency response; fit it to an Experiment")

    def stable(self, values: Values) -> bool:
        """Whether the closed loop is stable; True if unknown."""
        return True
